//! The play operator: what follows a motion with a dead zone.

/// `out` follows `motion` with a dead zone of `width` (Visintin, *Differential Models of Hysteresis*, 1994).
pub fn play(motion: &[f64], width: f64, out: &mut [f64]) {
    let half = 0.5 * width;
    let mut at = motion.first().copied().unwrap_or(0.0);
    for (out, q) in out.iter_mut().zip(motion) {
        at = at.max(q - half).min(q + half);
        *out = at;
    }
}

#[cfg(test)]
mod tests {
    use super::play;

    /// Catches an operator that forgets where it was, moves inside its zone, or lags by another width.
    #[test]
    fn it_follows_with_its_dead_zone() {
        let mut out = [0.0; 7];
        play(&[0.0, 0.4, 1.0, 0.9, 0.3, -1.0, -0.8], 1.0, &mut out);
        assert_eq!(out, [0.0, 0.0, 0.5, 0.5, 0.5, -0.5, -0.5]);
    }
}
