//! Rows to be fitted, and how they reach the solver: side by side where the chain can, else one by one.

use crate::arrays::fixed;
use crate::errors::shape;
use crate::rows::{Block, check_free, columns, own_rows, place, table};
use crate::solver::{Solver, iterate};
use numpy::{PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use sherkit_core::chain::effects::Wanted;
use sherkit_core::chain::{Chain, Columns, Prediction, Robot, Row};
use sherkit_core::numbers::wide::{Kernel, LANES, Wide, widest};

/// Rows to be fitted: the parameters that are free, the values of those that are not, readings and weights.
pub struct Problem<'a, R, const J: usize, const P: usize> {
    pub model: &'a R,
    pub values: [f64; P],
    pub free: Vec<usize>,
    pub rows: Vec<Row<J>>,
    pub readings: Vec<f64>,
    pub weights: Vec<f64>,
}

impl<'a, R, const J: usize, const P: usize> Problem<'a, R, J, P> {
    /// As it comes from Python; the solver must have as many parameters as are free.
    pub fn new<const M: usize>(
        model: &'a R,
        solver: &Solver,
        values: &PyReadonlyArray1<'_, f64>,
        free: Vec<usize>,
        block: &Block<'_>,
        (readings, weights): (&PyReadonlyArray2<'_, f64>, &PyReadonlyArray2<'_, f64>),
    ) -> PyResult<Self>
    where
        R: Robot<J, M, P>,
    {
        check_free::<P>(&free)?;
        let expected = solver.trial_values().len();
        if expected != free.len() {
            return Err(shape("free", &format!("({expected},)"), &[free.len()]));
        }
        let rows = own_rows::<R, J, M, P>(model, block)?;
        let (n, width) = (rows.len(), columns::<R, J, M, P>());
        Ok(Self {
            model,
            values: fixed("values", values)?,
            free,
            rows,
            readings: table("readings", readings, n, width)?.to_vec(),
            weights: table("weights", weights, n, width)?.to_vec(),
        })
    }

    /// Adds rows to the solver at its trial. `add` puts one row in, with its reading and weight, and says whether it could
    /// be computed. Returns those that could not; errors that leave no robot make every row unreachable.
    #[inline(always)]
    pub fn fill<const M: usize>(
        &self,
        solver: &mut Solver,
        add: impl FnMut(&Chain<R, J, M, P>, &Row<J>, &[f64], &[f64], &mut Solver) -> bool,
    ) -> Vec<usize>
    where
        R: Robot<J, M, P>,
    {
        self.fill_but(solver, |_, _| (0..self.rows.len()).collect(), add)
    }

    /// [`Self::fill`] with the rows that `many` leaves.
    #[inline(always)]
    fn fill_but<const M: usize>(
        &self,
        solver: &mut Solver,
        many: impl FnOnce(&Chain<R, J, M, P>, &mut Solver) -> Vec<usize>,
        mut add: impl FnMut(&Chain<R, J, M, P>, &Row<J>, &[f64], &[f64], &mut Solver) -> bool,
    ) -> Vec<usize>
    where
        R: Robot<J, M, P>,
    {
        let mut values = self.values;
        for (&k, &value) in self.free.iter().zip(solver.trial_values()) {
            values[k] = value;
        }
        let Ok(chain) = self.model.with(&values) else {
            return (0..self.rows.len()).collect();
        };
        let mut left = many(&chain, solver);
        let width = columns::<R, J, M, P>();
        left.retain(|&i| {
            let [reading, weight] =
                [&self.readings, &self.weights].map(|all| &all[i * width..][..width]);
            weight.iter().any(|w| *w != 0.0) && !add(&chain, &self.rows[i], reading, weight, solver)
        });
        left
    }

    /// Adds the readings to the solver at its trial, side by side where the chain can; returns the rows that cannot be
    /// computed there.
    pub fn readings<const M: usize>(&self, solver: &mut Solver) -> Vec<usize>
    where
        R: Robot<J, M, P>,
    {
        let wanted = Wanted::of(R::CATALOGUE, &self.free);
        let mut p = Prediction::new();
        self.fill_but(
            solver,
            |chain, solver| {
                widest(Sweep {
                    problem: self,
                    chain,
                    wanted,
                    solver,
                })
            },
            |chain, row, reading, weight, solver| {
                if chain.row_predict_into(row, wanted, &mut p).is_err() {
                    return false;
                }
                let (at, count) = place::<J, M>(row);
                let taken = reading[at..at + count].iter().zip(&weight[at..at + count]);
                for (axis, (reading, weight)) in taken.enumerate() {
                    let residual = reading - p.value[axis];
                    let line = self.free.iter().map(|&k| p.by_parameters[(axis, k)]);
                    solver.add(line, residual, *weight);
                }
                true
            },
        )
    }

    /// Iterates to the minimum, `fill` adding the rows at each trial.
    pub fn solve(
        &self,
        py: Python<'_>,
        solver: &mut Solver,
        fill: impl Fn(&Self, &mut Solver) -> Vec<usize> + Send + Sync,
    ) -> PyResult<(&'static str, Vec<usize>)>
    where
        R: Sync,
    {
        py.detach(|| iterate(solver, |solver| Ok(fill(self, solver))))
    }
}

/// One pass over the rows of a problem, side by side. Gives back the rows that are left to be added one by one: all of them
/// where the chain has effects that ask for that, else distances and what cannot be computed.
struct Sweep<'a, R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize> {
    problem: &'a Problem<'a, R, J, P>,
    chain: &'a Chain<R, J, M, P>,
    wanted: Wanted,
    solver: &'a mut Solver,
}

impl<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize> Kernel
    for Sweep<'_, R, J, M, P>
{
    type Output = Vec<usize>;

    #[inline(always)]
    fn run<V: Wide>(self) -> Vec<usize> {
        let Problem {
            rows,
            free,
            readings,
            weights,
            ..
        } = self.problem;
        let width = columns::<R, J, M, P>();
        let zero = V::splat(0.0);
        // the column of each parameter; what is not free is written behind the last one
        let mut places = [free.len(); P];
        for (column, &k) in free.iter().enumerate() {
            places[k] = column;
        }
        let derivatives = vec![[zero; M]; free.len() + 1];
        let mut columns = Placed {
            places,
            derivatives,
        };
        let mut left = Vec::new();
        for first in (0..rows.len()).step_by(LANES) {
            let count = LANES.min(rows.len() - first);
            let (mut joints, mut push) = ([rows[first].joints; LANES], [[0.0; 3]; LANES]);
            let (mut reading, mut weight) = ([[0.0; M]; LANES], [[0.0; M]; LANES]);
            for lane in 0..count {
                let (row, at) = (&rows[first + lane], (first + lane) * width);
                joints[lane] = row.joints;
                push[lane] = row.push.into();
                if !row.is_distance() {
                    reading[lane].copy_from_slice(&readings[at..at + M]);
                    weight[lane].copy_from_slice(&weights[at..at + M]);
                }
            }
            let predicted = self.chain.predict_many(
                V::columns(&joints),
                V::columns(&push),
                self.wanted,
                &mut columns,
            );
            let Some((value, reached)) = predicted else {
                return (0..rows.len()).collect();
            };
            let reached_at = reached.positive();
            for lane in 0..count {
                if rows[first + lane].is_distance() || !reached_at[lane] {
                    left.push(first + lane);
                }
            }
            let (reading, weight) = (V::columns(&reading), V::columns(&weight));
            for axis in 0..M {
                let weight = reached.above(zero, weight[axis], zero);
                let own = &columns.derivatives[..free.len()];

                self.solver
                    .add_wide(own, axis, reading[axis] - value[axis], weight);
            }
        }
        left
    }
}

/// Predicted readings, row by row, and which rows could be computed; the others are NaN.
pub fn predicted<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize>(
    chain: &Chain<R, J, M, P>,
    rows: &[Row<J>],
) -> (Vec<f64>, Vec<bool>) {
    let width = columns::<R, J, M, P>();
    let mut out = vec![0.0; rows.len() * width];
    let mut reached = vec![false; rows.len()];
    let (lines, marks) = (&mut out, &mut reached);
    widest(Predict {
        chain,
        rows,
        out: lines,
        reached: marks,
        width,
    });
    let left = rows
        .iter()
        .zip(out.chunks_exact_mut(width))
        .zip(&mut reached);
    for ((row, out), ok) in left.filter(|(_, ok)| !**ok) {
        if let Ok(value) = chain.row_value(row) {
            let (at, count) = place::<J, M>(row);
            out[at..at + count].copy_from_slice(&value.as_slice()[..count]);
            *ok = true;
        } else {
            out.fill(f64::NAN);
        }
    }
    (out, reached)
}

/// Readings side by side; rows that are not reached so are left to be computed one by one.
struct Predict<'a, R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize> {
    chain: &'a Chain<R, J, M, P>,
    rows: &'a [Row<J>],
    out: &'a mut [f64],
    reached: &'a mut [bool],
    width: usize,
}

impl<R: Robot<J, M, P>, const J: usize, const M: usize, const P: usize> Kernel
    for Predict<'_, R, J, M, P>
{
    type Output = ();

    #[inline(always)]
    fn run<V: Wide>(self) {
        let parts = self.out.chunks_mut(LANES * self.width);
        let parts = parts.zip(self.reached.chunks_mut(LANES));
        for (rows, (out, reached)) in self.rows.chunks(LANES).zip(parts) {
            let (mut joints, mut push) = ([rows[0].joints; LANES], [[0.0; 3]; LANES]);
            for (lane, row) in rows.iter().enumerate() {
                (joints[lane], push[lane]) = (row.joints, row.push.into());
            }
            let (joints, push) = (V::columns(&joints), V::columns(&push));
            let predicted = self
                .chain
                .predict_many(joints, push, Wanted::NONE, &mut Nowhere);
            let Some((value, ok)) = predicted else {
                return;
            };
            let (value, ok) = (V::rows(value), ok.positive());
            let lines = out.chunks_exact_mut(self.width).zip(reached);
            for (lane, (line, reached)) in lines.enumerate() {
                *reached = ok[lane] && !rows[lane].is_distance();
                if *reached {
                    line[..M].copy_from_slice(&value[lane]);
                }
            }
        }
    }
}

/// No columns are wanted.
struct Nowhere;

impl<V: Wide, const M: usize> Columns<V, M> for Nowhere {
    #[inline(always)]
    fn put(&mut self, _: usize, _: [V; M]) {}
}

/// The columns of the free parameters, one behind the other.
struct Placed<V, const M: usize, const P: usize> {
    places: [usize; P],
    derivatives: Vec<[V; M]>,
}

impl<V: Wide, const M: usize, const P: usize> Columns<V, M> for Placed<V, M, P> {
    #[inline(always)]
    fn put(&mut self, parameter: usize, column: [V; M]) {
        self.derivatives[self.places[parameter]] = column;
    }

    #[inline(always)]
    fn uses(&self, parameter: usize) -> bool {
        self.places[parameter] + 1 < self.derivatives.len()
    }
}
