//! Least squares of any number of rows in constant memory.
//!
//! [`stack`] folds rows into a triangle as they come (Eqs. 10 and 11 of the delta paper without ever holding
//! the stacked matrix); [`decomposition`] reads rank, directions and covariance off that triangle;
//! [`levenberg`] iterates to the nonlinear minimum as a state machine, so that rows may come from memory,
//! from a file in pieces, or from a model written in another language; [`robust`] weighs outliers down;
//! [`back_substitute`] solves a triangle for several right-hand sides at once.

mod decomposition;
mod levenberg;
mod robust;
mod stack;
mod triangle;

pub use decomposition::{Decomposition, decomposition_len};
pub use levenberg::{Levenberg, Progress, Settings, levenberg_len};
pub use robust::Loss;
pub use stack::{BLOCK_ROWS, Stack, stack_len};
pub use triangle::back_substitute;
