//! Least squares of any number of rows in constant memory.
//!
//! [`stack`] folds rows into a triangle as they come (Eqs. 10 and 11 of the delta paper without ever holding
//! the stacked matrix); [`decomposition`] reads rank, directions and covariance off that triangle;
//! [`descent`] finds the way to the nonlinear minimum and [`levenberg`] iterates carefully from there, as state machines, so
//! that rows may come from memory, from a file in pieces, or from a model written in another language; [`robust`] weighs
//! outliers down; [`back_substitute`] solves a triangle for several right-hand sides at once.

mod decomposition;
mod descent;
mod levenberg;
mod robust;
mod stack;
mod triangle;

pub use decomposition::{Decomposition, decomposition_len};
pub use descent::{Descended, Descent, descent_len};
pub use levenberg::{Levenberg, Progress, Settings, levenberg_len};
pub use robust::Loss;
pub use stack::{BLOCK_ROWS, Fold, Stack, stack_len};
pub use triangle::back_substitute;
