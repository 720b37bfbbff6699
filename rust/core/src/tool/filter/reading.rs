//! One reading: force and depth from two moments, and what the filter makes of them.
//!
//! At the depth `d` expected the moments are `M_i = F c_i`, `c_i = (l_i - d)/ρ_i` with the elastica's relief `ρ`
//! ([`Rod::relief`](crate::tool::rod::Rod)); were it deeper by `δ`, `M_i = F c_i - F δ/ρ_i`. Both are linear, so `F` and `δ`
//! are least squares over what the gratings say: to first order the paper's Eqs. 1 and 2, but no ratio of two noisy numbers,
//! and a section of which a grating is lost still counts.

use super::moments::{Gratings, Moments};
use super::offsets::{APART_NM, Offsets};
use super::state::{BENCH, DEEPER, L, N, OFFSETS, Row, Seen, State};
use super::tip::Tip;
use crate::numbers::math::sqrt;
use crate::tool::rod::Rod;
use crate::tool::trusted::Trusted;
use nalgebra::{Matrix2, Vector2};

/// Deviations of the force below which it does not tell a depth.
const DETECTED: f64 = 5.0;
/// The hole must stand so far below section I for its moment to count, mm.
const NEAREST_MM: f64 = 2.0;
/// A depth that is known no better is hardly known, mm; how often its moments are then looked at again.
const VAGUE_MM: f64 = 5.0;
const AGAIN: usize = 6;
/// Readings over which an error that lasts is alike.
pub(super) const LASTS: f64 = 50.0;

/// What a reading says beside the expected state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Said {
    pub(super) size: f64,
    pub(super) way: Vector2<f64>,
    /// How much deeper than expected the hole stands where the reading was looked at again, what the bend takes from `l`
    /// there, mm, and from the moments.
    pub(super) ahead: f64,
    pub(super) short: f64,
    pub(super) relief: [f64; 2],
    /// Variance of the force's components by noise, mN²; the force by the moments of I and II and by the depth.
    pub(super) noise: f64,
    pub(super) by_moments: [f64; 2],
    pub(super) by_depth: f64,
    /// Variance of the depth by what lasts, mm².
    pub(super) lasting: f64,
    /// Whether there is a force at all.
    pub(super) leans: bool,
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
/// where the force is not known either, 1/mm²; what of it goes with the force, and with the moments.
type Deeper = (f64, f64, Vector2<f64>, [Vector2<f64>; 2]);

#[inline]
fn deeper(
    m: &Moments,
    relief: &[f64; 2],
    c: &[f64; 2],
    f: &Vector2<f64>,
    v: &Matrix2<f64>,
) -> Deeper {
    let a = [f / relief[0], f / relief[1]];
    let ja = [m.j[0] * a[0], m.j[1] * a[1]];
    let cross = ja[0] * c[0] + ja[1] * c[1];
    let turned = v * cross;
    let told = a[0].dot(&ja[0]) + a[1].dot(&ja[1]) - cross.dot(&turned);
    let left = |i: usize| a[i].dot(&(m.z[i] - m.j[i] * f * c[i]));
    let by_moments = [0, 1].map(|i| (m.j[i] * turned * c[i] - ja[i]) / told);
    (-(left(0) + left(1)) / told, told, turned, by_moments)
}

/// What moments say beside a state.
#[inline]
pub(super) fn say(
    trusted: &Trusted,
    shaft: &Rod,
    g: &Gratings,
    tip: &Tip,
    o: &Offsets,
    s: &State,
    m: &Moments,
) -> Said {
    let [near, far] = trusted.calibration.distances_mm;
    let m = &tip.off(m, [near, far]);
    // first with the shape of the last reading, for the shape of this one; where the depth is hardly known, on to where the
    // reading itself has the hole: from far away its moments are no straight line
    let vague = s.p[L][L] > VAGUE_MM * VAGUE_MM;
    let rounds = if vague { AGAIN } else { 1 };
    // what is felt acts on the shaft, also where the tip was thought to stand before the hole
    let held = |depth: f64| depth.min(near - NEAREST_MM).max(0.0);
    let (mut depth, mut relief, mut short) = (held(s.arc()), s.relief, s.short);
    let (mut c, mut f, mut v) = ([0.0; 2], Vector2::zeros(), Matrix2::zeros());
    let mut ahead = 0.0;
    for round in 0..=rounds {
        c = [(near - depth) / relief[0], (far - depth) / relief[1]];
        let precision = m.j[0] * (c[0] * c[0]) + m.j[1] * (c[1] * c[1]);
        v = precision.try_inverse().unwrap_or_default();
        f = v * (m.z[0] * c[0] + m.z[1] * c[1]);
        let squared = f.norm_squared();
        // where nothing is felt there is nothing to look at again
        let leans = squared > DETECTED * DETECTED * 0.5 * v.trace();
        if round == rounds || (round > 0 && !leans) {
            break;
        }
        let found = depth + deeper(m, &relief, &c, &f, &v).0;
        relief = [near, far].map(|at| shaft.relief(squared, at - depth));
        short = shaft.short(squared, shaft.arc(depth));
        let expected = s.x[L] + s.x[DEEPER] - short;
        if round == 0 {
            depth = held(expected);
        } else {
            depth = held(found);
            ahead = depth - expected;
        }
    }
    let (size, noise) = (sqrt(f.norm_squared()), 0.5 * v.trace());
    let by_moments = [0, 1].map(|i| 0.5 * c[i] * (m.j[i] * v).trace());
    let way = if size > 0.0 {
        f / size
    } else {
        Vector2::new(1.0, 0.0)
    };
    let (mut misfit, mut by_depth, mut off, mut lasting) = (0.0, 0.0, None, 0.0);
    // moments of no force, and gratings that differ in warmth, push nobody
    let mut unsure = noise + tip.unsure();
    for i in 0..2 {
        unsure += s.p[OFFSETS + 2 * i][OFFSETS + 2 * i] * by_moments[i] * by_moments[i];
    }
    let per_noise = APART_NM * APART_NM / g.noise;
    let apart = noise * per_noise;
    let over = size * size / (DETECTED * DETECTED);
    let leans = over > unsure && noise > 0.0;
    if leans && over > unsure + apart {
        if m.whole[0] && m.whole[1] {
            let contrast = m.m[0] * c[1] - m.m[1] * c[0];
            let across = contrast.y * way.x - contrast.x * way.y;
            let variance = (g.per_nm[0] * c[1] * c[1] + g.per_nm[1] * c[0] * c[0]) * g.noise;
            misfit = across * across / variance;
        }
        let (delta, told, turned, on) = deeper(m, &relief, &c, &f, &v);
        // false for NaN: what acts further from here than a shaft is long is no force
        if told > 0.0 && delta.abs() < trusted.rod.beam.length_mm() {
            let mut h: Row = [0.0; N];
            (h[L], h[DEEPER]) = (1.0, 1.0);
            for k in 0..4 {
                h[OFFSETS + k] = on[k / 2][k % 2];
            }
            let d = 0.1 * depth;
            h[BENCH..].copy_from_slice(&[1.0, d, d * d]);
            // what lasts: fibres lag, and a force at the tip is known as well as section III tells it
            lasting = tip.lasting() * (depth / size) * (depth / size);
            lasting += on[0].norm_squared() * o.lagging(g, 0);
            lasting += on[1].norm_squared() * o.lagging(g, 1);
            // what is left of a section that lost a grating turns its warmth into a moment
            if !(m.whole[0] && m.whole[1]) {
                lasting += per_noise / told;
            }
            by_depth = turned.dot(&way);
            let beyond = s.x[L] + s.x[DEEPER] - short - depth;
            off = Some((delta - beyond, s.see(&h, 1.0 / told + LASTS * lasting)));
        }
    }
    Said {
        size,
        way,
        ahead,
        short,
        relief,
        noise,
        by_moments,
        by_depth,
        lasting,
        leans,
        off,
        misfit,
    }
}
