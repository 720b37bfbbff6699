//! What readings say of blocks of columns: the sum of squares that each would take.
//!
//! A block is the square of products of its columns, of unit length, row by row. What is `least` of a column's square or
//! less is rounding of what the model holds: such a column is not there, and so much is added to the others', so that
//! columns which are nearly one take what one of them would (Golub and Van Loan, *Matrix Computations*, 4.2).

use crate::numbers::math::sqrt;
use crate::{Error, Result};

/// The sum of squares that a block would take, and its rank: `right` are the products of its columns with what is left of
/// the readings, `room` as many numbers as the block and its columns together.
///
/// # Errors
/// [`Error::WrongLength`].
pub fn taken(block: &[f64], right: &[f64], least: f64, room: &mut [f64]) -> Result<(f64, usize)> {
    let k = right.len();
    for (expected, found) in [(k * k, block.len()), (k * k + k, room.len())] {
        if expected != found {
            return Err(Error::WrongLength { expected, found });
        }
    }
    let (triangle, solved) = room.split_at_mut(k * k);
    let (mut gain, mut rank) = (0.0, 0);
    for (a, values) in block.chunks_exact(k.max(1)).enumerate() {
        let (done, rest) = triangle.split_at_mut(a * k);
        let line = &mut rest[..k];
        line.fill(0.0);
        solved[a] = 0.0;
        // a NaN is not above it
        if values[a] > least {
            for (q, other) in done.chunks_exact(k).enumerate() {
                // a column that is not there has no pivot
                if other[q] > 0.0 {
                    line[q] = (values[q] - dot(&line[..q], &other[..q])) / other[q];
                }
            }
            // without rounding no pivot is smaller than what was added
            let pivot = values[a] + least - dot(&line[..a], &line[..a]);
            line[a] = sqrt(pivot.max(least));
            solved[a] = (right[a] - dot(&line[..a], &solved[..a])) / line[a];
            gain += solved[a] * solved[a];
            rank += 1;
        }
    }
    Ok((gain, rank))
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}
