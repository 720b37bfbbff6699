//! Elementary functions that give the same bits with and without `std`.
//!
//! `sqrt` is correctly rounded everywhere; sine and cosine always come from the `libm` crate, never from
//! the platform's C library, so that a robot controller and a laptop agree to the last bit.
//! NaN and infinity pass through as IEEE 754 says.

/// Square root, correctly rounded.
#[inline(always)]
#[must_use]
pub fn sqrt(x: f64) -> f64 {
    #[cfg(feature = "std")]
    {
        extern crate std;
        x.sqrt()
    }
    #[cfg(not(feature = "std"))]
    {
        libm::sqrt(x)
    }
}

/// Sine and cosine of an angle in radians.
#[inline]
#[must_use]
pub fn sin_cos(angle_rad: f64) -> (f64, f64) {
    libm::sincos(angle_rad)
}

/// A number, or several side by side: what a formula needs that runs in single and in batch.
pub trait Real:
    Copy
    + core::ops::Add<Output = Self>
    + core::ops::Sub<Output = Self>
    + core::ops::Mul<Output = Self>
    + core::ops::Div<Output = Self>
{
    /// The same value everywhere.
    fn splat(value: f64) -> Self;
    /// Square root.
    #[must_use]
    fn root(self) -> Self;
    /// Absolute value.
    #[must_use]
    fn size(self) -> Self;
    /// The same size with the sign of another number.
    #[must_use]
    fn signed(self, like: Self) -> Self;
    /// `yes` where this is greater than `other`, else `no`: a choice without a branch.
    #[must_use]
    fn above(self, other: Self, yes: Self, no: Self) -> Self;
    /// `yes` where this is at least `other`, else `no`, also for a NaN.
    #[must_use]
    fn at_least(self, other: Self, yes: Self, no: Self) -> Self;
}

impl Real for f64 {
    #[inline(always)]
    fn splat(value: f64) -> Self {
        value
    }
    #[inline(always)]
    fn root(self) -> Self {
        sqrt(self)
    }
    #[inline(always)]
    fn size(self) -> Self {
        self.abs()
    }
    #[inline(always)]
    fn signed(self, like: Self) -> Self {
        self.copysign(like)
    }
    #[inline(always)]
    fn above(self, other: Self, yes: Self, no: Self) -> Self {
        if self > other { yes } else { no }
    }
    #[inline(always)]
    fn at_least(self, other: Self, yes: Self, no: Self) -> Self {
        if self >= other { yes } else { no }
    }
}

/// `L` numbers side by side. Every operation is a loop over the lanes, which the compiler turns into vector
/// instructions of whatever width the processor has; each lane rounds exactly as a single number does.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(align(64))]
pub struct Lanes<const L: usize>(pub [f64; L]);

macro_rules! lanewise {
    ($($trait:ident $method:ident $op:tt),*) => {$(
        impl<const L: usize> core::ops::$trait for Lanes<L> {
            type Output = Self;
            #[inline(always)]
            #[allow(clippy::assign_op_pattern, reason = "one macro for all four operators")]
            fn $method(mut self, other: Self) -> Self {
                for lane in 0..L {
                    self.0[lane] = self.0[lane] $op other.0[lane];
                }
                self
            }
        }
    )*};
}
lanewise!(Add add +, Sub sub -, Mul mul *, Div div /);

impl<const L: usize> Real for Lanes<L> {
    #[inline(always)]
    fn splat(value: f64) -> Self {
        Self([value; L])
    }
    #[inline(always)]
    fn root(mut self) -> Self {
        for lane in 0..L {
            self.0[lane] = sqrt(self.0[lane]);
        }
        self
    }
    #[inline(always)]
    fn size(mut self) -> Self {
        for lane in 0..L {
            self.0[lane] = self.0[lane].abs();
        }
        self
    }
    #[inline(always)]
    fn signed(mut self, like: Self) -> Self {
        for lane in 0..L {
            self.0[lane] = self.0[lane].copysign(like.0[lane]);
        }
        self
    }
    #[inline(always)]
    fn above(mut self, other: Self, yes: Self, no: Self) -> Self {
        for lane in 0..L {
            self.0[lane] = if self.0[lane] > other.0[lane] {
                yes.0[lane]
            } else {
                no.0[lane]
            };
        }
        self
    }
    #[inline(always)]
    fn at_least(mut self, other: Self, yes: Self, no: Self) -> Self {
        for lane in 0..L {
            self.0[lane] = if self.0[lane] >= other.0[lane] {
                yes.0[lane]
            } else {
                no.0[lane]
            };
        }
        self
    }
}

/// Three components.
pub type Triple<T> = [T; 3];

/// `a + b`.
#[inline(always)]
#[must_use]
pub fn add<T: Real>(a: Triple<T>, b: Triple<T>) -> Triple<T> {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `a - b`.
#[inline(always)]
#[must_use]
pub fn subtract<T: Real>(a: Triple<T>, b: Triple<T>) -> Triple<T> {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `s a`.
#[inline(always)]
#[must_use]
pub fn scale<T: Real>(a: Triple<T>, s: T) -> Triple<T> {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// `a · b`.
#[inline(always)]
#[must_use]
pub fn dot<T: Real>(a: Triple<T>, b: Triple<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// `a × b`.
#[inline(always)]
#[must_use]
pub fn cross<T: Real>(a: Triple<T>, b: Triple<T>) -> Triple<T> {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
