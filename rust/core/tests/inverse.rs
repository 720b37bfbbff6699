//! The inverse of a small matrix.

mod common;

use common::Random;
use nalgebra::SMatrix;
use sherkit_core::numbers::inverse::inverse;

/// Rows or columns swapped back wrongly, an elimination that is not exact.
#[test]
fn inverses_undo() {
    let mut random = Random(1);
    for _ in 0..2000 {
        let rows: [[f64; 6]; 6] = std::array::from_fn(|_| std::array::from_fn(|_| random.normal()));
        let a = SMatrix::<f64, 6, 6>::from(rows).transpose();
        let found = inverse(rows).expect("a random matrix has an inverse");
        let b = SMatrix::<f64, 6, 6>::from(found.rows).transpose();
        let size = a.amax() * b.amax();
        assert!((a * b - SMatrix::identity()).amax() < 1e-13 * size);
        assert!((b * a - SMatrix::identity()).amax() < 1e-13 * size);
        assert!(found.weakest > 0.0 && found.weakest <= 1.0);
    }
}

/// A zero in the first place, taken for a singular matrix; a singular one that is not.
#[test]
fn pivots_tell_the_rank() {
    let turned = [[0.0, 2.0], [1.0, 0.0]];
    let found = inverse(turned).expect("a swap and a scale");
    assert_eq!(found.rows, [[0.0, 1.0], [0.5, 0.0]]);
    assert_eq!(found.weakest, 0.5);
    assert_eq!(inverse([[0.0; 3]; 3]), None);
    assert_eq!(inverse([[1.0, 2.0], [f64::NAN, 1.0]]), None);
    let dependent = [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]];
    assert!(inverse(dependent).is_none_or(|found| found.weakest < 1e-15));
}
