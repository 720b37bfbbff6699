//! Eigenvectors of small symmetric matrices and singular vectors of 3 × 3, by Jacobi rotations.
//!
//! Source: Golub and Van Loan, *Matrix Computations*, 8.5.3 (cyclic Jacobi) and 8.6.3 (one-sided). Chosen over
//! the QR iteration because small eigenvalues come out to full accuracy and the time is bounded whatever the
//! input: after [`SWEEPS`] the work ends. NaN gives NaN.

use crate::numbers::math::sqrt;

/// Sweeps after which the rotations end; six are usual for matrices of this size.
pub const SWEEPS: usize = 30;

/// Cosine and sine of the turn that makes two directions with squares `a`, `b` and product `c` orthogonal.
fn turn(a: f64, b: f64, c: f64) -> (f64, f64) {
    let half = (b - a) / (2.0 * c);
    // the smaller root: a turn of at most 45°, which is what makes the sweeps converge
    let tangent = half.signum() / (half.abs() + sqrt(1.0 + half * half));
    let cosine = 1.0 / sqrt(1.0 + tangent * tangent);
    (cosine, cosine * tangent)
}

/// Turns the pair of rows `p`, `q`.
fn rotate<const N: usize, const M: usize>(
    rows: &mut [[f64; M]; N],
    p: usize,
    q: usize,
    (cosine, sine): (f64, f64),
) {
    for k in 0..M {
        let (x, y) = (rows[p][k], rows[q][k]);
        rows[p][k] = cosine * x - sine * y;
        rows[q][k] = sine * x + cosine * y;
    }
}

/// Puts rows in the order of falling `keys`.
fn sort<const N: usize, const M: usize, const K: usize>(
    keys: &mut [f64; N],
    one: &mut [[f64; M]; N],
    other: &mut [[f64; K]; N],
) {
    for i in 1..N {
        let mut j = i;
        while j > 0 && keys[j] > keys[j - 1] {
            keys.swap(j, j - 1);
            one.swap(j, j - 1);
            other.swap(j, j - 1);
            j -= 1;
        }
    }
}

/// Eigenvalues of a symmetric matrix, largest first, and the eigenvectors (of unit length) as rows.
#[must_use]
pub fn symmetric_eigen<const N: usize>(mut a: [[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    let mut vectors = [[0.0; N]; N];
    for k in 0..N {
        vectors[k][k] = 1.0;
    }
    for _ in 0..SWEEPS {
        let mut turned = false;
        for p in 0..N {
            for q in p + 1..N {
                let off = a[p][q];
                // beneath the rounding of both diagonal elements: a turn would change neither
                if off.abs() <= 1e-18 * (a[p][p].abs() + a[q][q].abs()) || off == 0.0 {
                    continue;
                }
                turned = true;
                let by = turn(a[p][p], a[q][q], off);
                rotate(&mut a, p, q, by);
                for row in &mut a {
                    let (x, y) = (row[p], row[q]);
                    row[p] = by.0 * x - by.1 * y;
                    row[q] = by.1 * x + by.0 * y;
                }
                // exactly symmetric and exactly zero, as in the books
                (a[p][q], a[q][p]) = (0.0, 0.0);
                rotate(&mut vectors, p, q, by);
            }
        }
        if !turned {
            break;
        }
    }
    let mut values = [0.0; N];
    for k in 0..N {
        values[k] = a[k][k];
    }
    sort(&mut values, &mut vectors, &mut a);
    (values, vectors)
}

/// Singular values of a 3 × 3 matrix given by its columns, largest first, with `left` and `right` singular
/// vectors as rows. A left vector of singular value zero is zero.
#[must_use]
pub fn singular_values(columns: [[f64; 3]; 3]) -> ([f64; 3], [[f64; 3]; 3], [[f64; 3]; 3]) {
    let mut left = columns;
    let mut right = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let dot = |a: &[f64; 3], b: &[f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    for _ in 0..SWEEPS {
        let mut turned = false;
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            let (a, b) = (dot(&left[p], &left[p]), dot(&left[q], &left[q]));
            let c = dot(&left[p], &left[q]);
            if c.abs() <= 1e-15 * sqrt(a) * sqrt(b) || c == 0.0 {
                continue;
            }
            turned = true;
            let by = turn(a, b, c);
            rotate(&mut left, p, q, by);
            rotate(&mut right, p, q, by);
        }
        if !turned {
            break;
        }
    }
    let mut values = [0.0; 3];
    for k in 0..3 {
        values[k] = sqrt(dot(&left[k], &left[k]));
        if values[k] > 0.0 {
            left[k] = left[k].map(|x| x / values[k]);
        }
    }
    sort(&mut values, &mut left, &mut right);
    (values, left, right)
}
