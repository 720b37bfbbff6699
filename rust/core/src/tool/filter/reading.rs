//! One reading: force and depth from two moments, and what the filter makes of them.
//!
//! At the depth `d` expected the moments are `M_i = F c_i`, `c_i = (l_i - d)/ρ_i` with the elastica's relief `ρ`
//! ([`Shaft::relief`](crate::tool::rod::Shaft)); were it deeper by `δ`, `M_i = F c_i - F δ/ρ_i`. Both are linear, so `F` and `δ`
//! are least squares over what the gratings say: to first order the paper's Eqs. 1 and 2, but no ratio of two noisy numbers,
//! and a section of which a grating is lost still counts.

use super::moments::Moments;
use super::offsets::APART_NM;
use super::start::{Drift, Felt, ToolFilter};
use super::state::{BENCH, CLEARANCE, DEEPER, FRICTION, GIVES, L, N, OFFSETS, Row, Seen, State};
use crate::numbers::math::sqrt;
use crate::tool::status::Status;
use nalgebra::{Matrix2, Vector2};

/// Deviations of the force below which it does not tell a depth.
const DETECTED: f64 = 5.0;
/// The hole must stand so far below section I for its moment to count, mm.
const NEAREST_MM: f64 = 2.0;
/// A depth that is known no better is hardly known, mm; how often its moments are then looked at again.
const VAGUE_MM: f64 = 5.0;
const AGAIN: usize = 6;
/// Deviation of the part of a force that drags along the shaft while it slides; how fast that is, mm/s.
const DRAGS: f64 = 0.08;
const SLIDES_MM_S: f64 = 0.2;
/// Readings over which an error that lasts is alike. Of a section that lost a grating: a moment is off by this times the
/// share that the mean of a section is; unlike warmth, nm.
const LASTS: f64 = 50.0;
/// Innovations that pull one way: over this time, s; how far the logarithm of the hole's drift follows; the largest
/// product that counts, and the square of another hole; the fastest over the slowest.
const OVER_S: f64 = 0.2;
const FOLLOWS: f64 = 0.1;
const MOST: f64 = 16.0;
const FASTEST: f64 = 256.0;

/// What a reading says beside the expected state.
#[derive(Clone, Copy, Debug)]
pub(super) struct Said {
    pub(super) size: f64,
    pub(super) way: Vector2<f64>,
    /// Length of shaft beyond the hole that the reading was looked at with, what the bend takes from `l` there, mm.
    pub(super) depth: f64,
    /// How much deeper that is than expected, where the reading was looked at again, mm.
    ahead: f64,
    short: f64,
    relief: [f64; 2],
    /// Variance of the force's components by noise, mN²; the force by the moments of I and II and by the depth.
    pub(super) noise: f64,
    pub(super) by_moments: [f64; 2],
    pub(super) by_depth: f64,
    /// Variance of the depth by what lasts, mm².
    lasting: f64,
    /// Whether there is a force at all.
    leans: bool,
    /// How far the depth is from the expected one, mm, where the force tells it.
    pub(super) off: Option<(f64, Seen)>,
    /// Square of what the moments say across the force over its variance.
    pub(super) misfit: f64,
}

impl Said {
    /// Square of how far the depth is off over its variance; zero where it is not told.
    pub(super) fn far(&self) -> f64 {
        self.off.map_or(0.0, |(mm, seen)| mm * mm / seen.total)
    }
}

/// By how much the hole stands deeper than where moments were looked at with a force, mm, least squares; how well that is told
/// where the force is not known either, 1/mm²; what of it goes with the force.
struct Deeper {
    mm: f64,
    told: f64,
    turned: Vector2<f64>,
    ja: [Vector2<f64>; 2],
}

impl Deeper {
    #[inline]
    fn of(
        m: &Moments,
        relief: &[f64; 2],
        c: &[f64; 2],
        f: &Vector2<f64>,
        v: &Matrix2<f64>,
    ) -> Self {
        let a = [f / relief[0], f / relief[1]];
        let ja = [m.j[0] * a[0], m.j[1] * a[1]];
        let cross = ja[0] * c[0] + ja[1] * c[1];
        let turned = v * cross;
        let told = a[0].dot(&ja[0]) + a[1].dot(&ja[1]) - cross.dot(&turned);
        let left = |i: usize| m.z[i] - m.j[i] * f * c[i];
        let mm = -(a[0].dot(&left(0)) + a[1].dot(&left(1))) / told;
        Self {
            mm,
            told,
            turned,
            ja,
        }
    }
}

impl Drift {
    pub(super) fn new(since_s: f64, per_second: f64) -> Self {
        Self {
            since_s,
            per_second,
            ..Self::default()
        }
    }
}

impl ToolFilter {
    /// What moments say beside a state.
    #[inline]
    pub(super) fn say(&self, s: &State, m: &Moments) -> Said {
        let [near, far] = self.trusted.calibration.distances_mm;
        let (m, shaft) = (&self.tip.off(m, [near, far]), &self.shaft);
        let held = |depth: f64| {
            if depth < near - NEAREST_MM {
                depth
            } else {
                near - NEAREST_MM
            }
        };
        // first with the shape of the last reading, for the shape of this one; where the depth is hardly known, on to where the
        // reading itself has the hole: from far away its moments are no straight line
        let rounds = if s.p[L][L] > VAGUE_MM * VAGUE_MM {
            AGAIN
        } else {
            1
        };
        let (mut depth, mut relief, mut short) = (held(s.arc()), s.relief, s.short);
        let (mut c, mut f, mut v) = ([0.0; 2], Vector2::zeros(), Matrix2::zeros());
        let mut ahead = 0.0;
        for round in 0..=rounds {
            c = [(near - depth) / relief[0], (far - depth) / relief[1]];
            let precision = m.j[0] * (c[0] * c[0]) + m.j[1] * (c[1] * c[1]);
            v = precision.try_inverse().unwrap_or_else(Matrix2::zeros);
            f = v * (m.z[0] * c[0] + m.z[1] * c[1]);
            let squared = f.norm_squared();
            // where nothing is felt there is nothing to look at again
            let leans = squared > DETECTED * DETECTED * 0.5 * v.trace();
            if round == rounds || (round > 0 && !leans) {
                break;
            }
            let there = if round == 0 {
                None
            } else {
                Some(depth + Deeper::of(m, &relief, &c, &f, &v).mm)
            };
            relief = [
                shaft.relief(squared, near - depth),
                shaft.relief(squared, far - depth),
            ];
            short = shaft.short(squared, shaft.arc(depth));
            let expected = s.x[L] + s.x[DEEPER] - short;
            depth = held(there.map_or(expected, |mm| mm.max(0.0)));
            if there.is_some() {
                ahead = depth - expected;
            }
        }
        let size = sqrt(f.norm_squared());
        let weight = |i: usize| 0.5 * c[i] * (m.j[i] * v).trace();
        let mut said = Said {
            size,
            way: if size > 0.0 {
                f / size
            } else {
                Vector2::new(1.0, 0.0)
            },
            depth,
            ahead,
            short,
            relief,
            noise: 0.5 * v.trace(),
            by_moments: [weight(0), weight(1)],
            by_depth: 0.0,
            lasting: 0.0,
            leans: false,
            off: None,
            misfit: 0.0,
        };
        let (by, g) = (said.by_moments, &self.gratings);
        let of = |i: usize| s.p[OFFSETS + 2 * i][OFFSETS + 2 * i] * by[i] * by[i];
        let unsure = said.noise + if self.tip.on { self.tip.unsure() } else { 0.0 };
        let squared = size * size / (DETECTED * DETECTED);
        said.leans = squared > unsure + of(0) + of(1) && said.noise > 0.0;
        // gratings that differ in warmth push nobody
        let apart =
            APART_NM * APART_NM * (g.per_nm[0] * by[0] * by[0] + g.per_nm[1] * by[1] * by[1]);
        if said.leans && squared > unsure + of(0) + of(1) + apart {
            self.compare(s, &mut said, m, &c, &f, &v);
        }
        said
    }

    /// Both sections beside each other: across the force they must say nothing, along it how deep.
    #[inline]
    fn compare(
        &self,
        s: &State,
        said: &mut Said,
        m: &Moments,
        c: &[f64; 2],
        f: &Vector2<f64>,
        v: &Matrix2<f64>,
    ) {
        let g = &self.gratings;
        if m.whole[0] && m.whole[1] {
            let contrast = m.m[0] * c[1] - m.m[1] * c[0];
            let across = contrast.y * said.way.x - contrast.x * said.way.y;
            let variance = (g.per_nm[0] * c[1] * c[1] + g.per_nm[1] * c[0] * c[0]) * g.noise;
            said.misfit = across * across / variance;
        }
        let Deeper {
            mm: delta,
            told,
            turned,
            ja,
        } = Deeper::of(m, &said.relief, c, f, v);
        // false for NaN: what acts further from here than a shaft is long is no force
        if !(told > 0.0 && delta.abs() < self.trusted.rod.beam.length_mm()) {
            return;
        }
        let mut h: Row = [0.0; N];
        (h[L], h[DEEPER]) = (1.0, 1.0);
        for i in 0..2 {
            let on = (m.j[i] * turned * c[i] - ja[i]) / told;
            (h[OFFSETS + 2 * i], h[OFFSETS + 2 * i + 1]) = (on.x, on.y);
        }
        let d = 0.1 * said.depth;
        for k in 0..3 {
            let of = |i: usize| self.bench[(i, k)];
            h[BENCH + k] = of(0) + d * (of(1) + d * of(2));
        }
        // the bench's zero is learnt from a hole that stays, but no hole stays so well that it is known better than before
        let zero = self.trusted.doubt.deeper_mm;
        h[BENCH] = sqrt(h[BENCH] * h[BENCH] + zero * zero);
        // T = μ F makes T y at its own bend, F x³/6EI, beside F x
        let drag =
            said.size * c[0] * c[1] * (c[0] + c[1]) / (6.0 * self.trusted.rod.beam.stiffness());
        h[FRICTION] = DRAGS * drag * s.slide / sqrt(s.slide * s.slide + SLIDES_MM_S * SLIDES_MM_S);
        // what lasts: a section that lost a grating hangs on warmth from elsewhere, freed of bends as well as that is known;
        // fibres lag; and a force at the tip is known as well as section III tells it
        let mut lasting = self.tip.lasting() * (said.depth / said.size) * (said.depth / said.size);
        for i in 0..2 {
            let (x, y) = (h[OFFSETS + 2 * i], h[OFFSETS + 2 * i + 1]);
            lasting += (x * x + y * y) * self.lagging(i);
        }
        said.lasting = lasting;
        let noise = 1.0 / told + LASTS * lasting;
        said.by_depth = turned.dot(&said.way);
        let beyond = s.x[L] + s.x[DEEPER] - said.short - said.depth;
        said.off = Some((delta - beyond, s.see(&h, noise)));
    }

    /// Takes a reading into the state.
    #[inline]
    pub(super) fn take(&mut self, said: &Said) -> Status {
        let (s, mut status) = (&mut self.state, Status::UPDATED);
        let mut moved = 0.0;
        if let Some((mm, seen)) = &said.off {
            let before = s.x[L] + s.x[DEEPER];
            if !s.take(seen, *mm) {
                return Status::NOT_FINITE;
            }
            s.lasting += seen.gain().clamp(0.0, 1.0) * (sqrt(said.lasting) - s.lasting);
            s.x[CLEARANCE] = s.x[CLEARANCE].max(0.0);
            s.x[GIVES] = s.x[GIVES].max(0.0);
            moved = s.x[L] + s.x[DEEPER] - before;
            self.along.add(s.time_s, s.slid, moved);
            s.slid = 0.0;
            let white = seen.total - (LASTS - 1.0) * said.lasting;
            self.consistency.add(mm * mm / white);
            self.drift(*mm, seen.total);
        } else {
            status = status | Status::NO_FORCE;
        }
        let s = &mut self.state;
        if !(said.noise > 0.0 && said.size.is_finite()) {
            s.lean(&self.shaft);
            return status;
        }
        s.size = (said.size + said.by_depth * (moved - said.ahead)).max(0.0);
        (s.way, s.short, s.relief) = (said.way, said.short, said.relief);
        self.felt = Some(Felt {
            time_s: s.time_s,
            force: s.way * s.size,
            noise: said.noise,
            by_moments: said.by_moments,
            by_depth: said.by_depth,
        });
        s.touched |= said.off.is_some();
        s.free = !said.leans;
        if said.leans && s.touched {
            let gives = s.gives(&self.shaft);
            self.edge(said.noise, gives, said.off.is_some());
            let s = &mut self.state;
            s.aside = s.way * (s.x[CLEARANCE] + gives * s.size);
        } else {
            let far = sqrt(s.aside.norm_squared());
            if far > s.x[CLEARANCE] {
                s.aside *= s.x[CLEARANCE] / far;
            }
            (self.edge.since, self.edge.strays) = (None, None);
        }
        status
    }

    /// How fast the hole strays along the shaft: where the process noise is right, innovations are independent, and the sum
    /// of those of one moment has nothing to do with that of the next (Mehra, *IEEE Trans. Automatic Control* 15, 1970).
    #[inline]
    fn drift(&mut self, innovation: f64, variance: f64) {
        let (d, slowest) = (&mut self.drift, self.trusted.per_second_mm2);
        d.sum += innovation / variance;
        d.weight += 1.0 / variance;
        let now = d.sum / sqrt(d.weight);
        if self.state.time_s - d.since_s < OVER_S {
            return;
        }
        if now.is_finite() {
            let alike = (now * d.before).clamp(-MOST, MOST);
            let next = d.per_second * libm::exp(FOLLOWS * alike);
            d.per_second = next.min(slowest * FASTEST).max(slowest);
        }
        *d = Drift {
            before: if now.is_finite() { now } else { 0.0 },
            ..Drift::new(self.state.time_s, d.per_second)
        };
    }
}
