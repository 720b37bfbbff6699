//! What can go wrong in the numerics, as values that name the culprit.

use core::fmt;

/// Result of the core's functions.
pub type Result<T> = core::result::Result<T, Error>;

/// A failure that a caller can act on. Limbs are counted from zero here and from one in the text.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Error {
    /// The three rods cannot meet: this limb's rod lacks (or exceeds by) `miss_mm`.
    OutOfReach {
        /// Limb, from zero.
        limb: usize,
        /// How much the rod is too short (positive) or too long (negative), mm.
        miss_mm: f64,
    },
    /// The rod of this limb stands on the other side of the horizontal than the assembly mode says.
    LimbReversed {
        /// Limb, from zero.
        limb: usize,
        /// How far the carriage is beyond its platform joint, mm.
        beyond_mm: f64,
    },
    /// The rods lie in one plane: position does not follow from the joints here.
    Singular,
    /// An input is NaN or infinite.
    NotFinite {
        /// Index of the component.
        index: usize,
    },
    /// A geometry that is no robot, with the parameter at fault.
    InvalidGeometry {
        /// Limb, from zero.
        limb: usize,
        /// What is wrong.
        what: &'static str,
    },
    /// An iteration did not settle.
    NotConverged {
        /// Iterations made.
        iterations: usize,
    },
    /// A buffer of the caller has the wrong length.
    WrongLength {
        /// What was expected.
        expected: usize,
        /// What was given.
        found: usize,
    },
    /// Fewer points or rows than the unknowns need.
    TooFew {
        /// Least number that would do.
        needed: usize,
        /// Number there was.
        found: usize,
    },
    /// Points on a line: the turn about it is open.
    Collinear {
        /// Width across the line over length along it.
        ratio: f64,
    },
    /// A parameter of a tool, a beam or a filter that means nothing.
    Invalid {
        /// What is wrong.
        what: &'static str,
    },
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::OutOfReach { limb, miss_mm } => {
                let (by, what) = if miss_mm >= 0.0 {
                    (miss_mm, "short")
                } else {
                    (-miss_mm, "long")
                };
                write!(
                    f,
                    "out of reach: the rod of limb {} is {by:.4} mm too {what}",
                    limb + 1
                )
            }
            Self::LimbReversed { limb, beyond_mm } => write!(
                f,
                "out of reach: limb {} has passed the horizontal, its carriage is {beyond_mm:.4} mm \
                 beyond its platform joint",
                limb + 1
            ),
            Self::Singular => write!(
                f,
                "singular: the three rods lie in one plane, so the joints do not fix the position"
            ),
            Self::NotFinite { index } => {
                write!(f, "component {} is not a finite number", index + 1)
            }
            Self::InvalidGeometry { limb, what } => write!(f, "limb {}: {what}", limb + 1),
            Self::NotConverged { iterations } => {
                write!(f, "no convergence after {iterations} iterations")
            }
            Self::WrongLength { expected, found } => {
                write!(f, "expected {expected} numbers, got {found}")
            }
            Self::TooFew { needed, found } => {
                write!(f, "too few: at least {needed} are needed, got {found}")
            }
            Self::Collinear { ratio } => write!(
                f,
                "collinear: the points are {ratio:.1e} times as wide as they are long, so the turn about \
                 their line does not follow from them"
            ),
            Self::Invalid { what } => f.write_str(what),
        }
    }
}

impl core::error::Error for Error {}
