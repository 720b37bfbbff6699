//! Numbers, vectors and rotations: what every other floor computes with, and nothing of robots.

pub mod inverse;
pub mod jacobi;
pub mod math;
pub mod play;
pub mod registration;
pub mod rigid;
pub mod trig;
pub mod wide;
