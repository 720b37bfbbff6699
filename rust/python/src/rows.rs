//! Rows as they come from Python, and where their readings stand among the columns.

use crate::arrays::rows_like;
use crate::errors::shape;
use nalgebra::Vector3;
use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use sherkit_core::chain::{Aim, Covariates, Distances, Fixed, REFERENCE_TEMPERATURE_C, Robot, Row};

/// A block of rows as it comes from Python: joints `(n, J)`, the other ends of distances `(n, J)`, covariates
/// `(n, 3 + 2 J)` (time s, temperature °C, directions, velocities, the number of the target and its payload where there are
/// several, and the temperature of the stands; a loop leaves out what follows the directions) and displacements of the measured point `(n, 3)`. Where distances are read from fixed centres and
/// planes, the other ends are the number of one or the other `(n, 2)`.
pub type Block<'py> = (
    PyReadonlyArray2<'py, f64>,
    Option<PyReadonlyArray2<'py, f64>>,
    Option<PyReadonlyArray2<'py, f64>>,
    Option<PyReadonlyArray2<'py, f64>>,
);

/// Targets, centres and planes are numbered up to here.
const MOST: usize = 16;

/// The rows of a block, copied, so that nobody else can write them while they are used. A row whose other end is NaN is
/// no distance.
pub fn rows_of<const J: usize>(block: &Block<'_>) -> PyResult<Vec<Row<J>>> {
    rows_of_first(block, J, Distances::BetweenPlaces)
}

/// The same of a robot that has the first `k` joints alone: the others stand at zero.
pub fn rows_of_first<const J: usize>(
    block: &Block<'_>,
    k: usize,
    distances: Distances,
) -> PyResult<Vec<Row<J>>> {
    let fixed = distances == Distances::FromFixed;
    // the number of a centre, and that of a plane
    let wide = if fixed { 2 } else { k };
    let n = block.0.shape().first().copied().unwrap_or(0);
    let joints = table("joints", &block.0, n, k)?;
    let to = optional("to_joints", block.1.as_ref(), n, wide)?;
    let given = block.2.as_ref().and_then(|c| c.shape().last().copied());
    // an arm's rows have target and payload as well
    let known = given
        .filter(|width| [2 + k, 5 + 2 * k].contains(width))
        .unwrap_or(3 + 2 * k);
    // numbers are counted from one
    let counted = |number: f64| (0..MOST).find(|k| (k + 1) as f64 == number).unwrap_or(0);
    let covariates = optional("covariates", block.2.as_ref(), n, known)?;
    let push = optional("push", block.3.as_ref(), n, 3)?;
    let row = |i: usize| Row {
        joints: first(&joints[k * i..], k),
        to: to
            .filter(|_| !fixed)
            .map(|to| first(&to[k * i..], k))
            .filter(|to| !to[0].is_nan()),
        aim: Aim {
            target: covariates
                .filter(|_| known > 3 + 2 * k)
                .map_or(0, |c| counted(c[known * i + 2 + 2 * k])),
            from: to.filter(|_| fixed).and_then(|to| {
                let number = |at: usize| Some(to[2 * i + at]).filter(|x| !x.is_nan());
                let centre = number(0).map(|x| Fixed::Centre(counted(x)));
                centre.or_else(|| number(1).map(|x| Fixed::Plane(counted(x))))
            }),
        },
        covariates: covariates.map_or(Covariates::NONE, |c| {
            let c = &c[known * i..];
            Covariates {
                time_s: c[0],
                temperature_c: c[1],
                stand_c: if known == 2 + k {
                    REFERENCE_TEMPERATURE_C
                } else {
                    c[known - 1]
                },
                payload_kg: if known > 3 + 2 * k {
                    c[3 + 2 * k]
                } else {
                    f64::NAN
                },
                direction: first(&c[2..], k),
                velocity: if known == 2 + k {
                    [f64::NAN; J]
                } else {
                    first(&c[2 + k..], k)
                },
            }
        }),
        push: push.map_or_else(Vector3::zeros, |p| Vector3::from(several(&p[3 * i..]))),
    };
    Ok((0..n).map(row).collect())
}

/// The rows of a block of this robot.
pub fn own_rows<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize>(
    model: &R,
    block: &Block<'_>,
) -> PyResult<Vec<Row<J>>> {
    if let (Distances::None, Some(to)) = (R::DISTANCES, &block.1) {
        return Err(shape(
            "to_joints",
            "None: this robot reads no distances",
            to.shape(),
        ));
    }
    rows_of_first(block, model.joints(), R::DISTANCES)
}

/// What a control loop knows besides the joints: time s, temperature °C, a direction for each joint. It commands places,
/// so velocities are zero.
pub fn now<const J: usize>(numbers: &[f64]) -> PyResult<Covariates<J>> {
    if numbers.len() != 2 + J {
        return Err(shape(
            "covariates",
            &format!("({},)", 2 + J),
            &[numbers.len()],
        ));
    }
    Ok(Covariates {
        time_s: numbers[0],
        temperature_c: numbers[1],
        stand_c: REFERENCE_TEMPERATURE_C,
        payload_kg: f64::NAN,
        direction: several(&numbers[2..]),
        velocity: [0.0; J],
    })
}

/// The first `k` numbers, then zeros.
pub fn first<const N: usize>(numbers: &[f64], k: usize) -> [f64; N] {
    std::array::from_fn(|i| if i < k { numbers[i] } else { 0.0 })
}

fn several<const N: usize>(numbers: &[f64]) -> [f64; N] {
    std::array::from_fn(|k| numbers[k])
}

fn optional<'a>(
    name: &str,
    array: Option<&'a PyReadonlyArray2<'_, f64>>,
    n: usize,
    width: usize,
) -> PyResult<Option<&'a [f64]>> {
    array.map(|array| table(name, array, n, width)).transpose()
}

/// The numbers of an array of as many rows as there are others.
pub fn table<'a>(
    name: &str,
    array: &'a PyReadonlyArray2<'_, f64>,
    n: usize,
    width: usize,
) -> PyResult<&'a [f64]> {
    let wrong = || shape(name, &format!("({n}, {width}), contiguous"), array.shape());
    if array.shape() != [n, width] {
        return Err(wrong());
    }
    array.as_slice().map_err(|_| wrong())
}

/// A copy of rows of as many numbers as there are others.
pub fn copied<const N: usize>(
    name: &str,
    array: &PyReadonlyArray2<'_, f64>,
    n: usize,
) -> PyResult<Vec<[f64; N]>> {
    Ok(rows_like::<N>(name, array, n)?.to_vec())
}

/// Where the readings of a row stand among the columns, and how many there are.
pub fn place<const J: usize, const M: usize>(row: &Row<J>) -> (usize, usize) {
    if row.is_distance() { (M, 1) } else { (0, M) }
}

/// Columns that the readings of a robot have: what its sensor shows, and a distance where it can be read.
pub fn columns<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize>() -> usize {
    M + usize::from(R::DISTANCES != Distances::None)
}

/// Refuses indices that are no parameter's.
pub fn check_free<const P: usize>(free: &[usize]) -> PyResult<()> {
    if free.iter().any(|&k| k >= P) {
        return Err(shape("free", &format!("indices below {P}"), free));
    }
    Ok(())
}
