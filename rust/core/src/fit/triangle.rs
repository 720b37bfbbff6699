//! A triangle solved for several right-hand sides.

use crate::numbers::math::sqrt;

/// Solves the triangle of a stack with `targets` right-hand sides by back substitution.
///
/// Returns the smallest over the largest diagonal element of the column-scaled triangle, a measure of how
/// well the points determine the coefficients; below 1e-12 the solution has no meaning.
/// `solution` holds `columns × targets` numbers, row by row.
pub fn back_substitute(
    triangle: &[f64],
    columns: usize,
    targets: usize,
    solution: &mut [f64],
) -> f64 {
    let width = columns + targets;
    let mut weakest = f64::INFINITY;
    for k in (0..columns).rev() {
        let row = &triangle[k * width..][..width];
        let norm: f64 = triangle[k..]
            .iter()
            .step_by(width)
            .take(k + 1)
            .map(|x| x * x)
            .sum();
        let norm = sqrt(norm);
        weakest = weakest.min(if norm > 0.0 { row[k].abs() / norm } else { 0.0 });
        for target in 0..targets {
            let mut rest = row[columns + target];
            for j in k + 1..columns {
                rest -= row[j] * solution[j * targets + target];
            }
            solution[k * targets + target] = rest / row[k];
        }
    }
    weakest
}
