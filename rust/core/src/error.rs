//! What can go wrong in the numerics, as values that name the culprit.

use core::fmt;

/// Result of the core's functions.
pub type Result<T> = core::result::Result<T, Error>;

/// Where a spherical robot loses a freedom or a coordinate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Singularity {
    /// The elbow axes coincide or are opposite: the tool axis may turn about them freely.
    ElbowsAligned,
    /// The cones of the two limbs touch: tool axis and elbow axes lie in one plane.
    ConesTouch,
    /// The tool axis lies on the actuated axis: it has no azimuth.
    Pole,
    /// A limb is stretched or folded: its joint cannot move the tool axis.
    LimbStretched {
        /// Limb, from zero.
        limb: usize,
    },
}

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
    /// No step of the joints brings the target of an arm nearer to where it should be.
    TargetOutOfReach {
        /// By how much it is missed, mm.
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
    /// The limbs of a spherical robot cannot meet at these joints.
    LimbsApart {
        /// How much too far apart (positive) or too near (negative) the elbow axes are, rad.
        miss_rad: f64,
    },
    /// A limb of a spherical robot does not reach this tool axis.
    AxisOutOfReach {
        /// Limb, from zero.
        limb: usize,
        /// How much too far from (positive) or too near to (negative) the actuated axis, rad.
        miss_rad: f64,
    },
    /// The tool axis is reached by the other assembly of a spherical robot alone.
    OtherAssembly,
    /// A spherical robot in a singular pose.
    SingularPose(Singularity),
    /// A point that is not in front of the camera.
    BehindCamera {
        /// Its depth along the optical axis, mm.
        depth_mm: f64,
    },
    /// The line of sight passes the sphere.
    RayMisses {
        /// By how much, mm.
        miss_mm: f64,
    },
    /// The lens distortion folds over here: no single direction belongs to the pixel.
    LensFolds,
    /// Numbers that are no camera.
    InvalidCamera {
        /// What is wrong.
        what: &'static str,
    },
    /// An optimum at the end of the range or nowhere.
    NoOptimum,
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
            Self::TargetOutOfReach { miss_mm } => write!(
                f,
                "out of reach: from this posture and within the limits of the joints the target comes no nearer than \
                 {miss_mm:.4} mm"
            ),
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
            Self::LimbsApart { miss_rad } => {
                let (by, what) = far_or_near(miss_rad);
                write!(
                    f,
                    "out of reach: the limbs cannot meet, their elbow axes are {by:.6} rad too {what}"
                )
            }
            Self::AxisOutOfReach { limb, miss_rad } => {
                let (by, what) = far_or_near(miss_rad);
                write!(
                    f,
                    "out of reach: for limb {} the tool axis is {by:.6} rad too {what} the actuated axis",
                    limb + 1,
                    what = if what == "near" {
                        "near to"
                    } else {
                        "far from"
                    }
                )
            }
            Self::OtherAssembly => write!(
                f,
                "out of reach: only the other assembly of the limbs has its tool axis there"
            ),
            Self::SingularPose(which) => write_singularity(f, which),
            Self::BehindCamera { depth_mm } => write!(
                f,
                "not seen: the point is behind the camera, at a depth of {depth_mm:.4} mm"
            ),
            Self::RayMisses { miss_mm } => {
                write!(f, "not seen: the ray misses the sphere by {miss_mm:.4} mm")
            }
            Self::LensFolds => write!(
                f,
                "the lens distortion folds over at this pixel, so that no direction belongs to it"
            ),
            Self::InvalidCamera { what } => write!(f, "camera: {what}"),
            Self::NoOptimum => write!(f, "there is no optimum inside the range"),
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

fn far_or_near(miss: f64) -> (f64, &'static str) {
    if miss >= 0.0 {
        (miss, "far")
    } else {
        (-miss, "near")
    }
}

fn write_singularity(f: &mut fmt::Formatter<'_>, which: Singularity) -> fmt::Result {
    match which {
        Singularity::ElbowsAligned => write!(
            f,
            "singular: the elbow axes coincide, so the tool may turn about them"
        ),
        Singularity::ConesTouch => write!(
            f,
            "singular: tool axis and elbow axes lie in one plane, so the joints do not fix the tool axis"
        ),
        Singularity::Pole => write!(
            f,
            "singular: the tool axis lies on the actuated axis, where it has no azimuth"
        ),
        Singularity::LimbStretched { limb } => write!(
            f,
            "singular: limb {} is stretched or folded, so its joint cannot follow the tool axis",
            limb + 1
        ),
    }
}

impl core::error::Error for Error {}
