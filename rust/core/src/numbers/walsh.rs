//! The Walsh–Hadamard transform: sums under every pattern of signs of a group at once.

use super::wide::{Kernel, LANES, Wide, widest};

/// Entry `t` becomes the sum of all entries `h`, each with the sign of the parity of `h & t`. In place; the number of
/// entries is a power of two, else what is beyond the last whole block stays as it is.
///
/// Source: Fino and Algazi, "Unified matrix treatment of the fast Walsh–Hadamard transform", IEEE Trans. Comput. 1976.
pub fn walsh_hadamard(values: &mut [f64]) {
    widest(Transform(values));
}

/// The transform of these values, in place, as a part of another kernel.
pub struct Transform<'a>(pub &'a mut [f64]);

impl Kernel for Transform<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Wide>(self) {
        let values = self.0;
        let (eights, _) = values.as_chunks_mut::<LANES>();
        if eights.is_empty() {
            let mut half = 1;
            while 2 * half <= values.len() {
                for block in values.chunks_exact_mut(2 * half) {
                    let (low, high) = block.split_at_mut(half);
                    for (a, b) in low.iter_mut().zip(high) {
                        (*a, *b) = (*a + *b, *a - *b);
                    }
                }
                half *= 2;
            }
            return;
        }
        // within a vector: a partner is added to each, with the sign of the place that it has itself
        for eight in &mut *eights {
            let one = butterfly::<V, 1>(V::of(*eight));
            let two = butterfly::<V, 2>(one);
            *eight = butterfly::<V, 4>(two).numbers();
        }
        let mut half = 1;
        while 2 * half <= eights.len() {
            for block in eights.chunks_exact_mut(2 * half) {
                let (low, high) = block.split_at_mut(half);
                for (a, b) in low.iter_mut().zip(high) {
                    let (one, other) = (V::of(*a), V::of(*b));
                    (*a, *b) = ((one + other).numbers(), (one - other).numbers());
                }
            }
            half *= 2;
        }
    }
}

/// Sums and differences of lanes that are `HALF` apart.
#[inline(always)]
fn butterfly<V: Wide, const HALF: usize>(values: V) -> V {
    let numbers = values.numbers();
    let (mut partner, mut sign) = ([0.0; LANES], [1.0; LANES]);
    for lane in 0..LANES {
        partner[lane] = numbers[lane ^ HALF];
        if lane & HALF != 0 {
            sign[lane] = -1.0;
        }
    }
    V::of(partner) + values * V::of(sign)
}

#[cfg(test)]
mod tests {
    use super::walsh_hadamard;

    /// Catches a wrong sign or a butterfly of wrong width: every entry against its definition.
    #[test]
    fn it_is_the_sum_under_every_pattern_of_signs() {
        let before: [f64; 64] = core::array::from_fn(|k| (k * k % 7) as f64 - 0.3 * k as f64);
        for length in [1, 2, 4, 8, 16, 64] {
            holds(&before[..length]);
        }
    }

    fn holds(before: &[f64]) {
        extern crate std;
        let mut after = std::vec::Vec::from(before);
        walsh_hadamard(&mut after);
        for (t, value) in after.iter().enumerate() {
            let expected: f64 = before
                .iter()
                .enumerate()
                .map(|(h, x)| {
                    if (h & t).count_ones() % 2 == 0 {
                        *x
                    } else {
                        -x
                    }
                })
                .sum();
            assert!((value - expected).abs() < 1e-11);
        }
    }
}
