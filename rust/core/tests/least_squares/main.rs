//! The triangle, its decomposition, the nonlinear iteration and the losses, against nalgebra's dense algebra
//! and against problems whose minima are known.

#[path = "../common/mod.rs"]
mod common;
mod decomposition;
mod fits;
mod levenberg;
mod losses;
#[path = "../nist/mod.rs"]
mod nist;
mod reference;
mod stack;
mod systems;
