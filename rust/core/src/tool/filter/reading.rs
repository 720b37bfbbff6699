//! One reading: force and depth from two moments, and what the filter makes of them.
//!
//! At the depth `d` expected the moments are `M_i = F c_i`, `c_i = (l_i - d)/ρ_i` with the elastica's relief `ρ`
//! ([`Shaft::relief`](crate::tool::rod::Shaft)); were it deeper by `δ`, `M_i = F c_i - F δ/ρ_i`. Both are linear, so
//! `F` and `δ` are least squares over what the gratings say. To first order this is the paper's Eqs. 1 and 2, but no ratio
//! of two noisy numbers is taken, `δ`'s noise does not know that of `F`, and a section of which a grating is lost still
//! counts.

use super::known::UNKNOWNS;
use super::moments::Moments;
use super::pace::Felt;
use super::start::ToolFilter;
use super::state::{CLEARANCE, DEEPER, GIVES, L, N, OFFSETS, Row, Seen, State};
use super::status::Status;
use crate::numbers::math::sqrt;
use nalgebra::{Matrix2, Vector2};

/// Deviations of the force below which it does not tell a depth.
const DETECTED: f64 = 5.0;
/// The hole must stand so far below section I for its moment to count, mm.
const NEAREST_MM: f64 = 2.0;
/// Readings in a row without a force from which on moments are those of no force; the noise they count with then; and the
/// χ² of four moments above which they are not.
const FREE: u16 = 40;
const FREE_NOISE: f64 = 10.0;
const FREE_CHI2: f64 = 60.0;
/// Part of the moment that no error of a calibration puts across the force: so many of its deviations, but neither less
/// nor more than these.
const PLAIN: f64 = 5.0;
const PLAINEST: [f64; 2] = [0.01, 0.04];

/// A moment is off by this times the share that the mean of a section is; readings over which such an error is alike; and
/// how far warmth of two sections differs, nm.
const LOST: f64 = 2.0;
const LASTS: f64 = 50.0;
const UNLIKE_NM: f64 = 1.5e-3;

/// What a reading says beside the expected state.
#[derive(Clone, Copy, Debug)]
pub(super) struct Said {
    pub(super) size: f64,
    pub(super) way: Vector2<f64>,
    /// Length of shaft beyond the hole that the reading was looked at with, what the bend takes from `l` there, mm.
    pub(super) depth: f64,
    pub(super) short: f64,
    pub(super) relief: [f64; 2],
    /// Variance of the force's components by noise, mN²; the force by the moments of I and II and by the depth.
    pub(super) noise: f64,
    pub(super) by_moments: [f64; 2],
    pub(super) by_depth: f64,
    /// Whether the hole is felt.
    pub(super) touched: bool,
    /// How far the depth is from the expected one, mm, with what that hangs on.
    pub(super) off: Option<(f64, Row, Seen)>,
    /// What of its variance stands for errors that last, mm².
    pub(super) lasting: f64,
    /// Square of what the moments say across the force over its variance; whether no error of a calibration does.
    pub(super) misfit: f64,
    pub(super) plainly: bool,
}

impl Said {
    /// Square of how far the depth is from the expected one over its variance; zero where it is not told.
    pub(super) fn far(&self) -> f64 {
        match &self.off {
            Some((mm, _, seen)) if seen.total > 0.0 => mm * mm / seen.total,
            Some(_) => f64::INFINITY,
            None => 0.0,
        }
    }
}

/// Force, the inverse of its precision.
#[inline]
fn force(m: &Moments, c: &[f64; 2]) -> (Vector2<f64>, Matrix2<f64>) {
    let n = m.j[0] * (c[0] * c[0]) + m.j[1] * (c[1] * c[1]);
    let v = n.try_inverse().unwrap_or_else(Matrix2::zeros);
    (v * (m.z[0] * c[0] + m.z[1] * c[1]), v)
}

impl ToolFilter {
    /// What moments say beside a state.
    #[inline]
    pub(super) fn say(&self, s: &State, m: &Moments) -> Said {
        let [near, far] = self.distances_mm;
        let most = near - NEAREST_MM;
        let arms = |depth: f64| [near - depth, far - depth];
        let held = |depth: f64| if depth < most { depth } else { most };
        // first with the shape of the last reading, for the shape of this one
        let mut depth = held(s.arc());
        let mut arm = arms(depth);
        let mut c = [arm[0] / s.relief[0], arm[1] / s.relief[1]];
        let (first, _) = force(m, &c);
        let squared = first.norm_squared();
        let relief = [
            self.shaft.relief(squared, arm[0]),
            self.shaft.relief(squared, arm[1]),
        ];
        let short = self.shaft.short(squared, self.shaft.arc(depth));
        depth = held(s.l() + s.known.x[DEEPER] - short);
        arm = arms(depth);
        c = [arm[0] / relief[0], arm[1] / relief[1]];
        let (f, v) = force(m, &c);
        let size = sqrt(f.norm_squared());
        let way = if size > 0.0 {
            f / size
        } else {
            Vector2::new(1.0, 0.0)
        };
        let noise = 0.5 * v.trace();
        let weight = |i: usize| 0.5 * c[i] * (m.j[i] * v).trace();
        let by_moments = [weight(0), weight(1)];
        let mut unknown = 0.0;
        for i in 0..2 {
            let o = OFFSETS + 2 * i;
            let own = 0.5 * (s.known.p[o][o] + s.known.p[o + 1][o + 1]);
            unknown += by_moments[i] * by_moments[i] * own;
        }
        let mut said = Said {
            size,
            way,
            depth,
            short,
            relief,
            noise,
            by_moments,
            by_depth: 0.0,
            touched: size * size > DETECTED * DETECTED * (noise + unknown) && noise > 0.0,
            off: None,
            lasting: 0.0,
            misfit: 0.0,
            plainly: false,
        };
        if said.touched {
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
        if m.whole[0] && m.whole[1] {
            let contrast = m.m[0] * c[1] - m.m[1] * c[0];
            let across = contrast.y * said.way.x - contrast.x * said.way.y;
            let variance = self.variances[0] * c[1] * c[1] + self.variances[1] * c[0] * c[0];
            said.misfit = if variance > 0.0 {
                across * across / variance
            } else {
                0.0
            };
            let share = (PLAIN * self.unknown_force).clamp(PLAINEST[0], PLAINEST[1]);
            let [a, b] = [
                s.known.p[OFFSETS][OFFSETS],
                s.known.p[OFFSETS + 2][OFFSETS + 2],
            ];
            let own = a * c[1] * c[1] + b * c[0] * c[0];
            said.plainly = across.abs() > share * said.size * c[0] * c[1]
                && across * across > PLAIN * PLAIN * own;
        }
        let a = [f / said.relief[0], f / said.relief[1]];
        let ja = [m.j[0] * a[0], m.j[1] * a[1]];
        let cross = ja[0] * c[0] + ja[1] * c[1];
        let turned = v * cross;
        let told = a[0].dot(&ja[0]) + a[1].dot(&ja[1]) - cross.dot(&turned);
        if !(told > 0.0) {
            return;
        }
        let per_told = 1.0 / told;
        let left = |i: usize| m.z[i] - m.j[i] * f * c[i];
        let delta = -(a[0].dot(&left(0)) + a[1].dot(&left(1))) * per_told;
        // false for NaN: what acts further from here than a shaft is long is no force
        if !(delta.abs() < self.rod.beam.length_mm()) {
            said.touched = false;
            return;
        }
        let mut h = [0.0; N];
        h[L] = 1.0;
        h[DEEPER] = 1.0;
        for i in 0..2 {
            let on = (m.j[i] * turned * c[i] - ja[i]) * per_told;
            h[OFFSETS + 2 * i] = on.x;
            h[OFFSETS + 2 * i + 1] = on.y;
        }
        // T = μ F makes T y at its own bend, F x³/6EI, beside F x
        let [near, far] = [c[0], c[1]];
        let drag = said.size * near * far * (near + far) * self.per_stiffness / 6.0 * s.slides();
        let lasting = self.of_lost(m, said, c);
        said.lasting = lasting * (1.0 - 1.0 / LASTS);
        let row = Row {
            h,
            tied: self.of_depth.at(said.depth, drag),
            noise: per_told + self.floor_mm2 + lasting,
        };
        let beyond = s.l() + s.known.x[DEEPER] - said.short - said.depth;
        said.by_depth = turned.dot(&said.way);
        said.off = Some((delta - beyond, row, s.known.see(&row)));
    }

    /// What a section that lost a grating adds to the variance of the depth, mm²: its moment hangs on warmth from elsewhere,
    /// freed of bends as well as that is known. Such an error lasts, and counts for as many readings.
    fn of_lost(&self, m: &Moments, said: &Said, c: &[f64; 2]) -> f64 {
        let lever = c[0] * c[1] / (self.distances_mm[1] - self.distances_mm[0]);
        let mut sum = 0.0;
        for i in 0..2 {
            if !m.whole[i] {
                let bend = said.size * c[i] / sqrt(self.variances[i]) * sqrt(self.gratings.noise);
                let share = LOST * (self.unknown_mean + UNLIKE_NM / bend.max(UNLIKE_NM));
                sum += share * share;
            }
        }
        LASTS * sum * lever * lever
    }

    /// Takes a reading into the state.
    #[inline]
    pub(super) fn take(&mut self, m: &Moments, said: &Said) -> Status {
        let mut status = Status::UPDATED;
        self.before = self.state.known;
        let mut moved = said.depth;
        if let Some((mm, _, seen)) = &said.off {
            let s = &mut self.state;
            if !s.known.take(seen, *mm) {
                return Status::NOT_FINITE;
            }
            if s.known.x[CLEARANCE] < 0.0 {
                s.known.x[CLEARANCE] = 0.0;
            }
            if s.known.x[GIVES] < 0.0 {
                s.known.x[GIVES] = 0.0;
            }
            if let Some(square) = self.drift.take(*mm, seen.total) {
                s.known.p[L][L] += square;
            }
            self.watch.consistency.add(mm * mm / seen.total);
            moved = s.l() + s.known.x[DEEPER] - said.short;
        } else {
            status = status | Status::NO_FORCE;
        }
        moved -= said.depth;
        if !(said.noise > 0.0 && said.size.is_finite()) {
            self.state.lean(&self.shaft);
            return status;
        }
        let size = said.size + said.by_depth * moved;
        let s = &mut self.state;
        s.size = if size > 0.0 { size } else { 0.0 };
        s.way = said.way;
        s.short = said.short;
        s.relief = said.relief;
        self.felt = Some(Felt::of(said, s.time_s, s.size));
        if said.touched {
            s.touched = true;
            s.free = false;
            self.free_for /= 2;
            let gives = s.gives(&self.shaft);
            self.pace.felt(s, said.noise, gives);
            s.aside = s.way * (s.known.x[CLEARANCE] + gives * s.size);
        } else {
            s.free = true;
            self.free_for = self.free_for.saturating_add(1);
            let far = sqrt(s.aside.norm_squared());
            if far > s.known.x[CLEARANCE] {
                s.aside *= s.known.x[CLEARANCE] / far;
            }
            self.pace.lost();
            if self.free_for > FREE {
                self.rest(m);
            }
        }
        status
    }

    /// Moments that are felt where nothing touches: those of no force.
    fn rest(&mut self, m: &Moments) {
        let Some(v) = m.j[0].try_inverse().zip(m.j[1].try_inverse()) else {
            return;
        };
        let known = &mut self.state.known;
        let before = *known;
        let mut felt = [
            (m.m[0].x, v.0.m11),
            (m.m[0].y, v.0.m22),
            (m.m[1].x, v.1.m11),
            (m.m[1].y, v.1.m22),
        ];
        let mut chi2 = 0.0;
        for (k, (moment, variance)) in felt.iter().enumerate() {
            chi2 += moment * moment / (variance + before.p[OFFSETS + k][OFFSETS + k]);
        }
        if !(chi2 < FREE_CHI2) {
            return;
        }
        for (k, (moment, variance)) in felt.iter_mut().enumerate() {
            let mut h = [0.0; N];
            h[OFFSETS + k] = 1.0;
            let row = Row {
                h,
                tied: [0.0; UNKNOWNS],
                noise: FREE_NOISE * *variance,
            };
            let seen = known.see(&row);
            *moment += before.x[OFFSETS + k];
            if !(*variance > 0.0 && known.take(&seen, *moment - known.x[OFFSETS + k])) {
                *known = before;
                return;
            }
        }
        self.creep.rest(self.state.time_s, felt);
        self.warmth.rest(&before, &self.state.known);
    }
}

impl Felt {
    fn of(said: &Said, time_s: f64, size: f64) -> Self {
        Self {
            time_s,
            way: said.way,
            size,
            noise: said.noise,
            by_moments: said.by_moments,
            by_depth: said.by_depth,
        }
    }
}
