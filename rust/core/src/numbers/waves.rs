//! Sums over rows of weights times sines and cosines of a variable, at many frequencies.

use super::wide::{Kernel, LANES, Wide, widest};

/// Cells that one row is spread over.
pub const WIDTH: usize = 14;

/// Adds to the cells about each row its weights times a kernel.
///
/// Row `i` stands at `at[i]`, in cells: its kernel lies over the `WIDTH` cells from `⌊at⌋` on. The kernel is
/// a polynomial of where in its cell the row is, highest power first, one for each of these cells. `weights` has `k`
/// numbers for each row, `cells` for each cell; rows beyond the cells are left out. The Fourier transform of the cells is
/// that of the rows, but for the kernel's own (Barnett et al., "A parallel nonuniform fast Fourier transform library
/// based on an exponential of semicircle kernel", SIAM J. Sci. Comput. 2019).
pub fn spread(at: &[f64], weights: &[f64], k: usize, kernel: &[[f64; WIDTH]], cells: &mut [f64]) {
    if k > 0 {
        widest(Spread {
            at,
            weights,
            k,
            kernel,
            cells,
        });
    }
}

struct Spread<'a> {
    at: &'a [f64],
    weights: &'a [f64],
    k: usize,
    kernel: &'a [[f64; WIDTH]],
    cells: &'a mut [f64],
}

impl Kernel for Spread<'_> {
    type Output = ();

    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "what is no cell is beyond them, or the first"
    )]
    #[inline(always)]
    fn run<V: Wide>(self) {
        let Self {
            k, kernel, cells, ..
        } = self;
        for (&at, weights) in self.at.iter().zip(self.weights.chunks_exact(k)) {
            let first = at as usize;
            let within = V::splat(2.0 * (at - first as f64) - 1.0);
            let (mut near, mut far) = (V::splat(0.0), V::splat(0.0));
            for power in kernel {
                // two vectors that lie over one another in the middle
                let (a, b) = (power.first_chunk(), power.last_chunk());
                if let (Some(a), Some(b)) = (a, b) {
                    near = near * within + V::of(*a);
                    far = far * within + V::of(*b);
                }
            }
            let mut value = [0.0; WIDTH];
            value[..LANES].copy_from_slice(&near.numbers());
            value[WIDTH - LANES..].copy_from_slice(&far.numbers());
            let Some(cells) = cells.get_mut(first * k..(first + WIDTH) * k) else {
                continue;
            };
            let (wide, rest) = weights.as_chunks::<LANES>();
            for (cell, v) in cells.chunks_exact_mut(k).zip(value) {
                let (eights, last) = cell.as_chunks_mut::<LANES>();
                for (c, w) in eights.iter_mut().zip(wide) {
                    *c = (V::of(*c) + V::splat(v) * V::of(*w)).numbers();
                }
                for (c, w) in last.iter_mut().zip(rest) {
                    *c += v * w;
                }
            }
        }
    }
}

/// Adds `weight · sin(t·angle)` to `sine[t - 1]`, and the cosine likewise, for `t` = 1, 2, 3, …, as a part of a kernel.
///
/// `turn` is the cosine and the sine of the angle.
#[inline(always)]
pub fn add_waves<V: Wide>(
    turn: (f64, f64),
    weight: f64,
    sine: &mut [[f64; LANES]],
    cosine: &mut [[f64; LANES]],
) {
    let times = |a: (f64, f64), b: (f64, f64)| (a.0 * b.0 - a.1 * b.1, a.0 * b.1 + a.1 * b.0);
    let (mut re, mut im) = ([0.0; LANES], [0.0; LANES]);
    let mut power = turn;
    for (re, im) in re.iter_mut().zip(&mut im) {
        (*re, *im) = (weight * power.0, weight * power.1);
        power = times(power, turn);
    }
    let twice = times(turn, turn);
    let four = times(twice, twice);
    let step = times(four, four);
    let (step_re, step_im) = (V::splat(step.0), V::splat(step.1));
    let (mut re, mut im) = (V::of(re), V::of(im));
    for (sine, cosine) in sine.iter_mut().zip(cosine) {
        *sine = (V::of(*sine) + im).numbers();
        *cosine = (V::of(*cosine) + re).numbers();
        (re, im) = (re * step_re - im * step_im, re * step_im + im * step_re);
    }
}

#[cfg(test)]
mod tests {
    use super::{LANES, WIDTH, add_waves, spread};
    use crate::numbers::wide::{Kernel, Wide, widest};

    struct Add<'a>(f64, f64, &'a mut [[f64; LANES]], &'a mut [[f64; LANES]]);

    impl Kernel for Add<'_> {
        type Output = ();
        fn run<V: Wide>(self) {
            add_waves::<V>((self.0.cos(), self.0.sin()), self.1, self.2, self.3);
        }
    }

    /// Catches a lane that starts at the wrong wave, a step of the wrong size, and sine taken for cosine.
    #[test]
    fn waves_are_sines_and_cosines() {
        let (mut sine, mut cosine) = ([[0.5; LANES]; 5], [[0.25; LANES]; 5]);
        let angle: f64 = 0.37;
        widest(Add(angle, 2.0, &mut sine, &mut cosine));
        let (sine, cosine) = (sine.as_flattened(), cosine.as_flattened());
        for t in 0..40 {
            let a = (t + 1) as f64 * angle;
            assert!((sine[t] - 0.5 - 2.0 * a.sin()).abs() < 1e-12);
            assert!((cosine[t] - 0.25 - 2.0 * a.cos()).abs() < 1e-12);
        }
    }

    /// Catches a kernel laid over the wrong cells, powers in the wrong order, and a row beyond the cells.
    #[test]
    fn a_row_is_spread_over_the_cells_about_it() {
        let mut kernel = [[0.0; WIDTH]; 2];
        for j in 0..WIDTH {
            kernel[0][j] = 1.0 + j as f64;
            kernel[1][j] = 0.5;
        }
        let mut cells = [0.0; 2 * (WIDTH + 2)];
        spread(&[1.25, 9.0], &[1.0, -2.0, 7.0, 7.0], 2, &kernel, &mut cells);
        for (c, cell) in cells.chunks(2).enumerate() {
            let v = if (1..=WIDTH).contains(&c) {
                -0.5 * c as f64 + 0.5
            } else {
                0.0
            };
            assert_eq!(cell, [v, -2.0 * v]);
        }
    }
}
