//! Eight numbers side by side in the vectors of whatever processor this is.
//!
//! A kernel is written once over [`Wide`], and [`widest`] runs it with the widest vectors there are. Each is a type of its
//! own, made of the processor's instructions: with a compiler that puts scalar lanes together by itself a million poses of
//! a delta take 24 ms in place of 6 (`python benchmarks/kinematics.py`); a fit takes the same. Every operation rounds as that of a single number and nothing is fused, so all give the same bits.

use super::math::{Lanes, Real};

/// Numbers side by side.
pub const LANES: usize = 8;

/// [`LANES`] numbers side by side.
pub trait Wide: Real {
    /// From the numbers.
    fn of(numbers: [f64; LANES]) -> Self;
    /// The numbers.
    fn numbers(self) -> [f64; LANES];

    /// The columns of as many rows as there are lanes.
    #[inline(always)]
    #[must_use]
    fn columns<const N: usize>(rows: &[[f64; N]; LANES]) -> [Self; N] {
        let mut out = [Self::splat(0.0); N];
        for (k, out) in out.iter_mut().enumerate() {
            let mut numbers = [0.0; LANES];
            for lane in 0..LANES {
                numbers[lane] = rows[lane][k];
            }
            *out = Self::of(numbers);
        }
        out
    }

    /// The rows of columns.
    #[inline(always)]
    fn rows<const N: usize>(columns: [Self; N]) -> [[f64; N]; LANES] {
        let mut out = [[0.0; N]; LANES];
        for (k, column) in columns.into_iter().enumerate() {
            let numbers = column.numbers();
            for lane in 0..LANES {
                out[lane][k] = numbers[lane];
            }
        }
        out
    }

    /// Which of them are above zero.
    #[inline(always)]
    fn positive(self) -> [bool; LANES] {
        self.numbers().map(|v| v > 0.0)
    }

    /// Itself where another is not zero, else zero.
    #[inline(always)]
    #[must_use]
    fn where_any(self, other: Self) -> Self {
        let zero = Self::splat(0.0);
        other.size().above(zero, self, zero)
    }

    /// Their sum, in an order of its own that is the same for all.
    #[inline(always)]
    fn sum(self) -> f64 {
        let [a, b, c, d, e, f, g, h] = self.numbers();
        ((a + e) + (c + g)) + ((b + f) + (d + h))
    }
}

impl Wide for Lanes<LANES> {
    #[inline(always)]
    fn of(numbers: [f64; LANES]) -> Self {
        Self(numbers)
    }
    #[inline(always)]
    fn numbers(self) -> [f64; LANES] {
        self.0
    }
}

/// Something to be computed with vectors. Implementations of `run`, and all that it calls with vectors, are inlined whole:
/// what is not inlined is not compiled for the vectors.
pub trait Kernel {
    /// What is found.
    type Output;
    /// Computes it.
    fn run<V: Wide>(self) -> Self::Output;
}

/// Runs a kernel with the widest vectors that this processor has.
#[inline]
pub fn widest<K: Kernel>(kernel: K) -> K::Output {
    #[cfg(all(feature = "std", target_arch = "x86_64"))]
    {
        extern crate std;
        if std::arch::is_x86_feature_detected!("avx512f")
            && std::arch::is_x86_feature_detected!("avx512dq")
        {
            // SAFETY: the processor was just asked for the features.
            return unsafe { x86::avx512(kernel) };
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor was just asked for the feature.
            return unsafe { x86::avx2(kernel) };
        }
    }
    kernel.run::<Lanes<LANES>>()
}

/// The vectors of x86-64. Their types stay within this file, where only [`widest`] hands them out: so the processor has
/// the instructions wherever one is used.
#[cfg(all(any(feature = "std", test), target_arch = "x86_64"))]
mod x86 {
    use super::{Kernel, LANES, Real, Wide};
    use core::arch::x86_64::{
        __m256d, __m512d, __m512i, _CMP_GE_OQ, _CMP_GT_OQ, _mm256_add_pd, _mm256_and_pd,
        _mm256_andnot_pd, _mm256_blendv_pd, _mm256_cmp_pd, _mm256_div_pd, _mm256_mul_pd,
        _mm256_or_pd, _mm256_set1_pd, _mm256_sqrt_pd, _mm256_sub_pd, _mm512_add_pd, _mm512_and_pd,
        _mm512_andnot_pd, _mm512_cmp_pd_mask, _mm512_div_pd, _mm512_mask_blend_pd, _mm512_mul_pd,
        _mm512_or_pd, _mm512_permutex2var_pd, _mm512_set1_pd, _mm512_sqrt_pd, _mm512_sub_pd,
    };
    use core::mem::transmute;
    use core::ops::{Add, Div, Mul, Sub};

    #[target_feature(enable = "avx512f,avx512dq")]
    pub fn avx512<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Avx512>()
    }

    #[target_feature(enable = "avx2")]
    pub fn avx2<K: Kernel>(kernel: K) -> K::Output {
        kernel.run::<Avx2>()
    }

    #[derive(Clone, Copy)]
    pub struct Avx512(__m512d);

    #[derive(Clone, Copy)]
    pub struct Avx2([__m256d; 2]);

    macro_rules! operators {
        ($($name:ident $method:ident $wide:ident $narrow:ident),*) => {$(
            impl $name for Avx512 {
                type Output = Self;
                #[inline(always)]
                fn $method(self, other: Self) -> Self {
                    // SAFETY: see the module
                    Self(unsafe { $wide(self.0, other.0) })
                }
            }
            impl $name for Avx2 {
                type Output = Self;
                #[inline(always)]
                fn $method(self, other: Self) -> Self {
                    // SAFETY: see the module
                    unsafe { self.zip(other, |a, b| $narrow(a, b)) }
                }
            }
        )*};
    }
    operators!(
        Add add _mm512_add_pd _mm256_add_pd,
        Sub sub _mm512_sub_pd _mm256_sub_pd,
        Mul mul _mm512_mul_pd _mm256_mul_pd,
        Div div _mm512_div_pd _mm256_div_pd
    );

    // SAFETY of all below: see the module; arrays of numbers and vectors of the same length have the same layout

    impl Real for Avx512 {
        #[inline(always)]
        fn splat(value: f64) -> Self {
            Self(unsafe { _mm512_set1_pd(value) })
        }
        #[inline(always)]
        fn root(self) -> Self {
            Self(unsafe { _mm512_sqrt_pd(self.0) })
        }
        #[inline(always)]
        fn size(self) -> Self {
            Self(unsafe { _mm512_andnot_pd(_mm512_set1_pd(-0.0), self.0) })
        }
        #[inline(always)]
        fn signed(self, like: Self) -> Self {
            let sign = Self::splat(-0.0).0;
            Self(unsafe {
                _mm512_or_pd(_mm512_andnot_pd(sign, self.0), _mm512_and_pd(sign, like.0))
            })
        }
        #[inline(always)]
        fn above(self, other: Self, yes: Self, no: Self) -> Self {
            Self(unsafe {
                let is = _mm512_cmp_pd_mask::<_CMP_GT_OQ>(self.0, other.0);
                _mm512_mask_blend_pd(is, no.0, yes.0)
            })
        }
        #[inline(always)]
        fn at_least(self, other: Self, yes: Self, no: Self) -> Self {
            Self(unsafe {
                let is = _mm512_cmp_pd_mask::<_CMP_GE_OQ>(self.0, other.0);
                _mm512_mask_blend_pd(is, no.0, yes.0)
            })
        }
    }

    impl Wide for Avx512 {
        #[inline(always)]
        fn of(numbers: [f64; LANES]) -> Self {
            Self(unsafe { transmute::<[f64; LANES], __m512d>(numbers) })
        }
        #[inline(always)]
        fn numbers(self) -> [f64; LANES] {
            unsafe { transmute::<__m512d, [f64; LANES]>(self.0) }
        }
        #[inline(always)]
        fn columns<const N: usize>(rows: &[[f64; N]; LANES]) -> [Self; N] {
            let mut vectors = [Self::splat(0.0); N];
            for (vector, numbers) in vectors.iter_mut().zip(rows.as_flattened().as_chunks().0) {
                *vector = Self::of(*numbers);
            }
            dealt(vectors, |place| place % LANES * N + place / LANES)
        }
        #[inline(always)]
        fn rows<const N: usize>(columns: [Self; N]) -> [[f64; N]; LANES] {
            let dealt = dealt(columns, |place| place % N * LANES + place / N);
            let mut out = [[0.0; N]; LANES];
            for (numbers, vector) in out
                .as_flattened_mut()
                .as_chunks_mut()
                .0
                .iter_mut()
                .zip(dealt)
            {
                *numbers = vector.numbers();
            }
            out
        }
        #[inline(always)]
        fn positive(self) -> [bool; LANES] {
            let mask = unsafe { _mm512_cmp_pd_mask::<_CMP_GT_OQ>(self.0, Self::splat(0.0).0) };
            // each bit into a byte of its own
            let apart = (u64::from(mask) * 0x0101_0101_0101_0101) & 0x8040_2010_0804_0201;
            let ones = ((apart + 0x7f7f_7f7f_7f7f_7f7f) >> 7) & 0x0101_0101_0101_0101;
            ones.to_le_bytes().map(|byte| byte == 1)
        }
    }

    #[allow(clippy::cast_possible_wrap, reason = "places within a few vectors")]
    /// The numbers of several vectors in another order: at each place that from `source`. Loops, since a closure that makes
    /// an array is not always inlined.
    #[inline(always)]
    fn dealt<const N: usize>(from: [Avx512; N], source: impl Fn(usize) -> usize) -> [Avx512; N] {
        let mut all = from;
        for k in 0..N {
            let mut out = from[0].0;
            for vector in usize::from(N > 1)..N {
                // a number from this vector, or what is there: in the first turn what is in the first vector
                let mut index = [0_i64; LANES];
                for lane in 0..LANES {
                    let place = source(k * LANES + lane);
                    let within = (place % LANES) as i64;
                    index[lane] = match place / LANES {
                        at if at == vector => LANES as i64 + within,
                        0 if vector == 1 => within,
                        _ => lane as i64,
                    };
                }
                out = unsafe {
                    let index = transmute::<[i64; LANES], __m512i>(index);
                    _mm512_permutex2var_pd(out, index, from[vector].0)
                };
            }
            all[k] = Avx512(out);
        }
        all
    }

    impl Avx2 {
        #[inline(always)]
        fn zip(self, other: Self, of: impl Fn(__m256d, __m256d) -> __m256d) -> Self {
            Self([of(self.0[0], other.0[0]), of(self.0[1], other.0[1])])
        }

        /// `yes` where a mask is set.
        #[inline(always)]
        fn choice(mask: Self, yes: Self, no: Self) -> Self {
            Self(core::array::from_fn(|k| unsafe {
                _mm256_blendv_pd(no.0[k], yes.0[k], mask.0[k])
            }))
        }
    }

    impl Real for Avx2 {
        #[inline(always)]
        fn splat(value: f64) -> Self {
            Self([unsafe { _mm256_set1_pd(value) }; 2])
        }
        #[inline(always)]
        fn root(self) -> Self {
            Self(self.0.map(|v| unsafe { _mm256_sqrt_pd(v) }))
        }
        #[inline(always)]
        fn size(self) -> Self {
            Self::splat(-0.0).zip(self, |sign, v| unsafe { _mm256_andnot_pd(sign, v) })
        }
        #[inline(always)]
        fn signed(self, like: Self) -> Self {
            let sign = Self::splat(-0.0);
            let like = sign.zip(like, |sign, v| unsafe { _mm256_and_pd(sign, v) });
            self.size()
                .zip(like, |v, sign| unsafe { _mm256_or_pd(v, sign) })
        }
        #[inline(always)]
        fn above(self, other: Self, yes: Self, no: Self) -> Self {
            let is = self.zip(other, |a, b| unsafe { _mm256_cmp_pd::<_CMP_GT_OQ>(a, b) });
            Self::choice(is, yes, no)
        }
        #[inline(always)]
        fn at_least(self, other: Self, yes: Self, no: Self) -> Self {
            let is = self.zip(other, |a, b| unsafe { _mm256_cmp_pd::<_CMP_GE_OQ>(a, b) });
            Self::choice(is, yes, no)
        }
    }

    impl Wide for Avx2 {
        #[inline(always)]
        fn of(numbers: [f64; LANES]) -> Self {
            Self(unsafe { transmute::<[f64; LANES], [__m256d; 2]>(numbers) })
        }
        #[inline(always)]
        fn numbers(self) -> [f64; LANES] {
            unsafe { transmute::<[__m256d; 2], [f64; LANES]>(self.0) }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use std::vec::Vec;

    /// Every operation on eight triples of numbers, down to the bits; a NaN is a NaN, whichever.
    struct Everything([[f64; 3]; LANES]);

    impl Kernel for Everything {
        type Output = Vec<u64>;
        fn run<V: Wide>(self) -> Vec<u64> {
            let [a, b, c] = V::columns(&self.0);
            let results = [
                a + b,
                a - b,
                a * b,
                a / b,
                a.root(),
                a.size(),
                a.signed(b),
                a.above(b, c, V::splat(2.0)),
                a.at_least(b, c, V::splat(2.0)),
                V::splat(a.sum()),
            ];
            let mut out: Vec<f64> = results.into_iter().flat_map(V::numbers).collect();
            out.extend(V::rows([a, b, c]).as_flattened());
            out.extend(V::rows([c, a]).as_flattened());
            out.extend(V::rows([b]).as_flattened());
            let [one] = V::columns(&V::rows([b]));
            out.extend(one.numbers());
            out.extend(a.positive().map(|p| f64::from(u8::from(p))));
            out.iter()
                .map(|v| if v.is_nan() { f64::NAN } else { *v }.to_bits())
                .collect()
        }
    }

    /// Catches vectors that round otherwise, choose otherwise at a NaN or a signed zero, or put rows into another order.
    #[test]
    fn all_vectors_give_the_same_bits() {
        let odd = [
            f64::NAN,
            f64::INFINITY,
            -0.0,
            0.0,
            1.0 / 3.0,
            -7.1,
            1e-310,
            0.1,
        ];
        for shift in 0..LANES {
            let rows =
                core::array::from_fn(|lane| [odd[lane], odd[(lane + shift) % LANES], lane as f64]);
            let expected = Everything(rows).run::<Lanes<LANES>>();
            assert_eq!(expected, widest(Everything(rows)));
            #[cfg(target_arch = "x86_64")]
            {
                if std::arch::is_x86_feature_detected!("avx512dq") {
                    // SAFETY: the processor was just asked
                    assert_eq!(expected, unsafe { x86::avx512(Everything(rows)) });
                }
                if std::arch::is_x86_feature_detected!("avx2") {
                    // SAFETY: the processor was just asked
                    assert_eq!(expected, unsafe { x86::avx2(Everything(rows)) });
                }
            }
        }
    }
}
