//! Rows in, rows out: many poses side by side, with the widest vectors that the processor has, on all cores.

/// Poses computed side by side.
pub const LANES: usize = 8;

/// `N` coordinates of [`LANES`] poses, side by side.
pub type Block<const N: usize> = [[f64; LANES]; N];

/// A map from `I` to `O` coordinates, [`LANES`] poses at once, and which of them it could compute. Implementations
/// must be inlined whole, or they are not compiled for the wide vectors.
pub trait LaneMap<const I: usize, const O: usize>: Copy + Sync + Send {
    /// Maps one block.
    fn run(self, from: &Block<I>) -> (Block<O>, [bool; LANES]);
}

/// Poses below which a second thread costs more than it brings.
const WORTH_A_THREAD: usize = 50_000;

/// Runs the lanes, on all cores where there are many poses; what cannot be computed is NaN and `false`.
pub fn in_lanes<const I: usize, const O: usize, M: LaneMap<I, O>>(
    input: &[[f64; I]],
    map: M,
) -> (Vec<f64>, Vec<bool>) {
    let mut out = vec![0.0; input.len() * O];
    let mut reached = vec![false; input.len()];
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = cores.min(input.len() / WORTH_A_THREAD).max(1);
    let share = input
        .len()
        .div_ceil(threads)
        .next_multiple_of(LANES)
        .max(LANES);
    let parts = input
        .chunks(share)
        .zip(out.as_chunks_mut::<O>().0.chunks_mut(share))
        .zip(reached.chunks_mut(share));
    if threads == 1 {
        for ((input, out), reached) in parts {
            widest(input, out, reached, map);
        }
    } else {
        std::thread::scope(|scope| {
            for ((input, out), reached) in parts {
                scope.spawn(move || widest(input, out, reached, map));
            }
        });
    }
    (out, reached)
}

/// Blocks that are turned from rows to lanes and back at a time; they stay in the first cache.
const BLOCKS: usize = 32;

/// Turns rows into lanes, runs the kernel, and turns the result back. The three steps are kept apart: only a loop
/// that reads and writes lanes becomes vector instructions.
fn widest<const I: usize, const O: usize, M: LaneMap<I, O>>(
    input: &[[f64; I]],
    out: &mut [[f64; O]],
    reached: &mut [bool],
    map: M,
) {
    let kernel = kernel::<I, O, M>();
    let mut from = [[[0.0; LANES]; I]; BLOCKS];
    let mut to = [[[0.0; LANES]; O]; BLOCKS];
    let mut ok = [[false; LANES]; BLOCKS];
    let chunks = input
        .chunks(BLOCKS * LANES)
        .zip(out.chunks_mut(BLOCKS * LANES))
        .zip(reached.chunks_mut(BLOCKS * LANES));
    for ((rows, out), reached) in chunks {
        let used = rows.len().div_ceil(LANES);
        for (rows, block) in rows.chunks(LANES).zip(&mut from) {
            for (lane, row) in rows.iter().enumerate() {
                for axis in 0..I {
                    block[axis][lane] = row[axis];
                }
            }
        }
        kernel(&from[..used], &mut to[..used], &mut ok[..used], map);
        let results = to.iter().zip(&ok);
        let places = out.chunks_mut(LANES).zip(reached.chunks_mut(LANES));
        for ((block, ok), (out, reached)) in results.zip(places) {
            for (lane, (out, reached)) in out.iter_mut().zip(reached).enumerate() {
                for axis in 0..O {
                    out[axis] = if ok[lane] {
                        block[axis][lane]
                    } else {
                        f64::NAN
                    };
                }
                *reached = ok[lane];
            }
        }
    }
}

type Kernel<const I: usize, const O: usize, M> =
    fn(&[Block<I>], &mut [Block<O>], &mut [[bool; LANES]], M);

/// The kernel with the widest vectors that this processor has; every choice gives the same bits.
fn kernel<const I: usize, const O: usize, M: LaneMap<I, O>>() -> Kernel<I, O, M> {
    #[cfg(target_arch = "x86_64")]
    {
        #[target_feature(enable = "avx512f,avx512dq")]
        fn avx512<const I: usize, const O: usize, M: LaneMap<I, O>>(
            from: &[Block<I>],
            to: &mut [Block<O>],
            ok: &mut [[bool; LANES]],
            map: M,
        ) {
            run(from, to, ok, map);
        }
        #[target_feature(enable = "avx2")]
        fn avx2<const I: usize, const O: usize, M: LaneMap<I, O>>(
            from: &[Block<I>],
            to: &mut [Block<O>],
            ok: &mut [[bool; LANES]],
            map: M,
        ) {
            run(from, to, ok, map);
        }
        if std::arch::is_x86_feature_detected!("avx512f")
            && std::arch::is_x86_feature_detected!("avx512dq")
        {
            // SAFETY: the processor was just asked for the features.
            return |from, to, ok, map| unsafe { avx512(from, to, ok, map) };
        }
        if std::arch::is_x86_feature_detected!("avx2") {
            // SAFETY: the processor was just asked for the feature.
            return |from, to, ok, map| unsafe { avx2(from, to, ok, map) };
        }
    }
    run
}

#[inline(always)]
fn run<const I: usize, const O: usize, M: LaneMap<I, O>>(
    from: &[Block<I>],
    to: &mut [Block<O>],
    reached: &mut [[bool; LANES]],
    map: M,
) {
    for ((from, to), reached) in from.iter().zip(to).zip(reached) {
        (*to, *reached) = map.run(from);
    }
}
