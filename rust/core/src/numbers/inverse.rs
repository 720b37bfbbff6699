//! Inverse of a small matrix, without a path to a panic.
//!
//! Source: Golub and Van Loan, *Matrix Computations*, 3.4.8: elimination with complete pivoting, whose pivots show the
//! rank, carried on to the identity.

/// An inverse and what was divided by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inverse<const N: usize> {
    /// Rows of the inverse.
    pub rows: [[f64; N]; N],
    /// Smallest pivot over the largest: near zero where the matrix is singular.
    pub weakest: f64,
}

/// The inverse. `None` where a pivot is zero or no number.
#[must_use]
pub fn inverse<const N: usize>(mut a: [[f64; N]; N]) -> Option<Inverse<N>> {
    let mut b = [[0.0; N]; N];
    let mut order = [0; N];
    for k in 0..N {
        b[k][k] = 1.0;
        order[k] = k;
    }
    let (mut smallest, mut largest) = (f64::INFINITY, 0.0_f64);
    for k in 0..N {
        let (mut row, mut column, mut size) = (k, k, -1.0);
        for i in k..N {
            for j in k..N {
                if a[i][j].abs() > size {
                    (row, column, size) = (i, j, a[i][j].abs());
                }
            }
        }
        // they are; the compiler does not see it
        let (row, column) = (row.min(N - 1), column.min(N - 1));
        a.swap(k, row);
        b.swap(k, row);
        for line in &mut a {
            line.swap(k, column);
        }
        order.swap(k, column);
        smallest = smallest.min(size);
        largest = largest.max(size);
        let pivot = a[k][k];
        if pivot.is_nan() || pivot == 0.0 {
            return None;
        }
        let scale = 1.0 / pivot;
        for j in 0..N {
            a[k][j] *= scale;
            b[k][j] *= scale;
        }
        let (ahead, beside) = (a[k], b[k]);
        for i in 0..N {
            if i != k {
                let share = a[i][k];
                for j in 0..N {
                    a[i][j] -= share * ahead[j];
                    b[i][j] -= share * beside[j];
                }
            }
        }
    }
    let mut rows = [[0.0; N]; N];
    for k in 0..N {
        rows[order[k].min(N - 1)] = b[k];
    }
    Some(Inverse {
        rows,
        weakest: smallest / largest,
    })
}
