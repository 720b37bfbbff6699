//! The paper's Kalman filters of the flexible tool: insertion depth, and tip.
//!
//! Source: Eqs. 4 to 8 and 10 to 14 of the tool paper. [`filter`] is the linear filter of a fixed size that all
//! of them stand on; [`noise`] what their noise is; [`track`] time stamps and bookkeeping. Every step takes bounded
//! time, allocates nothing, and answers with a [`Status`]: a measurement that is missing, late or not finite is never
//! used and never silently dropped. What a loop runs on a calibrated tool is [`super::tracker`].
//!
//! Lengths are mm, forces mN, times s. Matrices are arrays of rows.

pub mod depth;
pub mod filter;
mod ldl;
pub mod measurement;
pub mod noise;
pub mod status;
pub mod tip;
pub mod track;

pub use depth::DepthFilter;
pub use filter::{Filter, Innovation};
pub use measurement::Measurement;
pub use noise::{Noise, Trust};
pub use status::{Consistency, Counts, Status};
pub use tip::TipFilter;
