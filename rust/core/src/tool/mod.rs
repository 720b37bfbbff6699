//! The flexible tool: a needle with fibre Bragg gratings that bends where it passes the sclera.
//!
//! Source: Ebrahimi et al., "Stochastic force-based insertion depth and tip position estimations of flexible
//! FBG-equipped instruments", 2020 (the tool paper). [`sensing`] turns wavelengths into force and depth, [`beam`]
//! force and depth into where the tip is; [`paper`] are the paper's
//! filters on them; [`filter`] is what a control loop runs.
//!
//! Wavelengths are nm, forces mN, lengths mm, moments mN·mm. The tool frame has its z axis along the unbent
//! shaft, pointing out of the tip, and its origin where the unbent tip would be. Depth is counted from the tip
//! up the shaft: zero where the sclera touches the tip.

pub mod beam;
pub mod filter;
pub mod paper;
mod poses;
pub mod rod;
pub mod sensing;
pub mod status;
pub mod trusted;
