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
