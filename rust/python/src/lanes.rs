//! Rows in, rows out: many poses side by side, with the widest vectors that the processor has, on all cores.

use sherkit_core::numbers::wide::{Kernel, LANES, Wide, widest};

/// A map from `I` to `O` coordinates, [`LANES`] poses at once. Implementations of `run` must be inlined whole, or they are
/// not compiled for the wide vectors.
pub trait LaneMap<const I: usize, const O: usize>: Copy + Sync + Send {
    /// Maps the poses; one for those it could compute, zero for the others.
    fn run<V: Wide>(self, from: [V; I]) -> ([V; O], V);

    /// What lanes leave to a computation of its own, where there is such a thing.
    fn alone(self, _: &[f64; I]) -> Option<[f64; O]> {
        None
    }
}

/// Poses below which a second thread costs more than it brings.
const WORTH_A_THREAD: usize = 50_000;

/// Runs the lanes, on all cores where there are many poses; what cannot be computed is NaN and `false`.
pub fn in_lanes<const I: usize, const O: usize, M: LaneMap<I, O>>(
    input: &[[f64; I]],
    out: &mut [[f64; O]],
    reached: &mut [bool],
    map: M,
) {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = cores.min(input.len() / WORTH_A_THREAD).max(1);
    let share = input
        .len()
        .div_ceil(threads)
        .next_multiple_of(LANES)
        .max(LANES);
    let parts = input
        .chunks(share)
        .zip(out.chunks_mut(share))
        .zip(reached.chunks_mut(share))
        .map(|((input, out), reached)| Part {
            input,
            out,
            reached,
            map,
        });
    if threads == 1 {
        parts.for_each(widest);
    } else {
        std::thread::scope(|scope| {
            for part in parts {
                scope.spawn(move || widest(part));
            }
        });
    }
}

/// The share of one thread.
struct Part<'a, const I: usize, const O: usize, M> {
    input: &'a [[f64; I]],
    out: &'a mut [[f64; O]],
    reached: &'a mut [bool],
    map: M,
}

impl<const I: usize, const O: usize, M: LaneMap<I, O>> Kernel for Part<'_, I, O, M> {
    type Output = ();

    #[inline(always)]
    fn run<V: Wide>(self) {
        let (input, rest) = self.input.as_chunks::<LANES>();
        let (out, rest_out) = self.out.as_chunks_mut::<LANES>();
        let (reached, rest_reached) = self.reached.as_chunks_mut::<LANES>();
        for ((input, out), reached) in input.iter().zip(out).zip(reached) {
            block::<V, I, O, M>(input, out, reached, self.map);
        }
        if !rest.is_empty() {
            let (mut last, mut out, mut reached) =
                ([[0.0; I]; LANES], [[0.0; O]; LANES], [false; LANES]);
            last[..rest.len()].copy_from_slice(rest);
            block::<V, I, O, M>(&last, &mut out, &mut reached, self.map);
            rest_out.copy_from_slice(&out[..rest.len()]);
            rest_reached.copy_from_slice(&reached[..rest.len()]);
        }
    }
}

#[inline(always)]
fn block<V: Wide, const I: usize, const O: usize, M: LaneMap<I, O>>(
    input: &[[f64; I]; LANES],
    out: &mut [[f64; O]; LANES],
    reached: &mut [bool; LANES],
    map: M,
) {
    let (found, ok) = map.run(V::columns(input));
    let none = V::splat(f64::NAN);
    let mut told = found;
    for v in &mut told {
        *v = ok.above(V::splat(0.0), *v, none);
    }
    *out = V::rows(told);
    *reached = ok.positive();
    if reached.contains(&false) {
        for (k, ok) in reached.iter_mut().enumerate().filter(|(_, ok)| !**ok) {
            if let Some(found) = map.alone(&input[k]) {
                (out[k], *ok) = (found, true);
            }
        }
    }
}
