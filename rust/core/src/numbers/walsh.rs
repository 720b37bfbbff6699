//! The Walsh–Hadamard transform: sums under every pattern of signs of a group at once.

/// Entry `t` becomes the sum of all entries `h`, each with the sign of the parity of `h & t`. In place; the number of
/// entries is a power of two, else what is beyond the last whole block stays as it is.
///
/// Source: Fino and Algazi, "Unified matrix treatment of the fast Walsh–Hadamard transform", IEEE Trans. Comput. 1976.
pub fn walsh_hadamard(values: &mut [f64]) {
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
}

#[cfg(test)]
mod tests {
    use super::walsh_hadamard;

    /// Catches a wrong sign or a butterfly of wrong width: every entry against its definition.
    #[test]
    fn it_is_the_sum_under_every_pattern_of_signs() {
        let before: [f64; 16] = core::array::from_fn(|k| (k * k % 7) as f64 - 0.3 * k as f64);
        let mut after = before;
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
            assert!((value - expected).abs() < 1e-12);
        }
    }
}
