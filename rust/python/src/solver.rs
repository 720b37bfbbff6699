//! `Solver`: the streaming least-squares iteration, fed by native models or by `NumPy` blocks.

use crate::arrays::shaped;
use crate::errors::{shape, to_python};
use numpy::{
    PyArray1, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sherkit_core::fit::{
    Descended, Descent, Fold, Levenberg, Loss, Progress, Settings, Stack, descent_len,
    levenberg_len, stack_len,
};
use sherkit_core::numbers::wide::{LANES, Wide};

/// Evaluations after which a fit is asked whether it still gains, and over so many.
const LONG: usize = 15;
/// Part of the variance of the noise that is not worth a step: it would move what is estimated by a tenth of a deviation.
const NOTHING: f64 = 1e-2;
/// Part of the variance that so many evaluations must gain to be worth as many more.
const LITTLE: f64 = 1e-1;

/// Iterates to the minimum with rows that `evaluate` adds at the solver's trial. Returns how it ended and the rows
/// that cannot be computed at the start, with which nothing is solved.
pub fn iterate(
    solver: &mut Solver,
    mut evaluate: impl FnMut(&mut Solver) -> PyResult<Vec<usize>>,
) -> PyResult<(&'static str, Vec<usize>)> {
    let mut first = true;
    loop {
        solver.begin();
        let missing = evaluate(solver)?;
        if missing.is_empty() {
            solver.add_priors();
        } else {
            if first {
                return Ok(("unreachable", missing));
            }
            solver.fail_trial();
        }
        first = false;
        match solver.step()? {
            Progress::Evaluate => {}
            Progress::Converged => return Ok(("converged", Vec::new())),
            Progress::Exhausted => return Ok(("exhausted", Vec::new())),
        }
    }
}

/// Numbers of which one begins a line of the processor's cache: vectors that lie across two lines take twice the time.
struct Lined {
    numbers: Vec<f64>,
    first: usize,
}

impl Lined {
    /// `len` zeros, of which the one `at` that place begins a line.
    fn zeros(len: usize, at: usize) -> Self {
        let numbers = vec![0.0; len + LANES];
        let to_line = numbers[at..]
            .as_ptr()
            .align_offset(LANES * size_of::<f64>());
        Self {
            numbers,
            first: to_line.min(LANES),
        }
    }
}

impl AsRef<[f64]> for Lined {
    fn as_ref(&self) -> &[f64] {
        &self.numbers[self.first..][..self.numbers.len() - LANES]
    }
}

impl AsMut<[f64]> for Lined {
    fn as_mut(&mut self) -> &mut [f64] {
        let len = self.numbers.len() - LANES;
        &mut self.numbers[self.first..][..len]
    }
}

/// One iteration to the minimum of all rows that are pushed at its trial parameters.
#[pyclass(module = "sherkit._core")]
pub struct Solver {
    levenberg: Levenberg<Vec<f64>>,
    /// The way to where the careful iteration begins, while it is gone.
    descent: Option<Descent<Vec<f64>>>,
    stack: Stack<Lined>,
    loss: Loss,
    cost: f64,
    /// Evaluations and cost when the fit was last asked whether it still gains.
    asked: (usize, f64),
    /// How well parameters are known besides: zero, the drawing, give or take so many plausible sizes; 0 for those of
    /// which nothing is.
    known: Vec<f64>,
    /// One weighted row with its residual, on its way into the stack.
    row: Vec<f64>,
}

impl Solver {
    /// Starts a new evaluation.
    pub fn begin(&mut self) {
        self.stack.clear_for(match self.descent {
            Some(_) => Fold::Products,
            None => Fold::Triangle,
        });
        self.cost = 0.0;
    }

    /// The parameters at which rows are wanted.
    pub fn trial_values(&self) -> &[f64] {
        match &self.descent {
            Some(descent) => descent.trial(),
            None => self.levenberg.trial(),
        }
    }

    /// Adds one reading: its derivatives, residual and 1/σ. Weight zero means not taken.
    #[inline]
    pub fn add(&mut self, derivatives: impl Iterator<Item = f64>, residual: f64, weight: f64) {
        if weight == 0.0 {
            return;
        }
        let u = residual * weight;
        let (root, cost) = self.loss.root_weight_and_cost(u);
        self.cost += cost;
        let w = weight * root;
        let n = self.stack.columns();
        let (row, target) = self.row.split_at_mut(n);
        for (place, d) in row.iter_mut().zip(derivatives) {
            *place = d * w;
        }
        target.fill(u * root);
        self.stack.push(self.row.iter().copied());
    }

    /// [`Self::add`] for as many readings as there are lanes, with the derivatives of one `axis` among several; a residual
    /// whose weight is zero may be no number.
    #[inline(always)]
    pub fn add_wide<V: Wide, const M: usize>(
        &mut self,
        derivatives: &[[V; M]],
        axis: usize,
        residual: V,
        weight: V,
    ) {
        let counting = weight.numbers().iter().filter(|w| **w != 0.0).count();
        let all = counting == LANES;
        let kept = |value: V| {
            if all { value } else { value.where_any(weight) }
        };
        let (mut u, mut w) = (kept(residual * weight), weight);
        if self.loss == Loss::Linear {
            self.cost += (u * u).sum();
        } else {
            let mut roots = [0.0; LANES];
            for (root, u) in roots.iter_mut().zip(u.numbers()) {
                let cost;
                (*root, cost) = self.loss.root_weight_and_cost(u);
                self.cost += cost;
            }
            (u, w) = (u * V::of(roots), w * V::of(roots));
        }
        let mut places = self.stack.next_wide(counting);
        if all {
            for (d, place) in derivatives.iter().zip(places.by_ref()) {
                *place = (d[axis] * w).numbers();
            }
        } else {
            for (d, place) in derivatives.iter().zip(places.by_ref()) {
                *place = (d[axis] * w).where_any(weight).numbers();
            }
        }
        places.for_each(|place| *place = u.numbers());
        self.stack.commit_wide();
    }

    /// Marks the trial as impossible.
    pub fn fail_trial(&mut self) {
        self.cost = f64::INFINITY;
    }

    /// Ends the evaluation.
    pub fn step(&mut self) -> PyResult<Progress> {
        let folded = self.stack.triangle();
        let Some(descent) = &mut self.descent else {
            let next = self
                .levenberg
                .advance(folded, self.cost)
                .map_err(to_python)?;
            return if next == Progress::Evaluate {
                self.worth_it()
            } else {
                Ok(next)
            };
        };
        let evaluations = descent.evaluations() + 1;
        match descent.advance(folded, self.cost) {
            Descended::Evaluate => return Ok(Progress::Evaluate),
            Descended::Near => self.levenberg.begin_at(descent.trial(), evaluations),
            Descended::Lost => {
                let start = self.levenberg.start().to_vec();
                self.levenberg.begin_at(&start, evaluations);
            }
        }
        self.descent = None;
        Ok(Progress::Evaluate)
    }

    /// Ends a long fit where next to nothing is left to gain, and one that gains next to nothing although more is promised:
    /// along a combination that the rows hardly tell steps stay long however small their use, and in a curved valley short
    /// however much there is at its end.
    fn worth_it(&mut self) -> PyResult<Progress> {
        let evaluations = self.levenberg.evaluations();
        let cost = self.levenberg.cost();
        if evaluations < self.asked.0 + LONG {
            return Ok(Progress::Evaluate);
        }
        let (rank, to_gain) = self
            .levenberg
            .with_decomposition(|d| (d.rank(), d.gain(0.0)))
            .map_err(to_python)?;
        let variance = cost / self.stack.rows().saturating_sub(rank).max(1) as f64;
        let ended = if to_gain <= NOTHING * variance {
            Progress::Converged
        } else if self.asked.1 - cost <= LITTLE * variance {
            Progress::Exhausted
        } else {
            self.asked = (evaluations, cost);
            return Ok(Progress::Evaluate);
        };
        self.levenberg.stop();
        Ok(ended)
    }

    /// Adds a row for each parameter that is known besides.
    pub fn add_priors(&mut self) {
        let n = self.stack.columns();
        for k in 0..self.known.len() {
            if self.known[k] <= 0.0 {
                continue;
            }
            let size = self.known[k] * self.levenberg.sizes()[k];
            let deviation = -self.trial_values()[k];
            self.cost += (deviation / size).powi(2);
            let unit = (0..n).map(move |j| if j == k { 1.0 / size } else { 0.0 });
            self.stack
                .push(unit.chain(core::iter::once(deviation / size)));
        }
    }
}

#[pymethods]
impl Solver {
    #[new]
    #[pyo3(signature = (start, sizes, *, loss="linear", max_evaluations=100, step_tolerance=1e-5,
                        rank_tolerance=1e-9, single_step=false, known=None))]
    #[allow(
        clippy::too_many_arguments,
        reason = "one argument for each setting of the solve"
    )]
    fn new(
        start: PyReadonlyArray1<'_, f64>,
        sizes: PyReadonlyArray1<'_, f64>,
        loss: &str,
        max_evaluations: usize,
        step_tolerance: f64,
        rank_tolerance: f64,
        single_step: bool,
        known: Option<Vec<f64>>,
    ) -> PyResult<Self> {
        let n = start.len();
        let known = known.unwrap_or_default();
        if !known.is_empty() && known.len() != n {
            return Err(shape("known", &format!("({n},)"), &[known.len()]));
        }
        let settings = Settings {
            max_evaluations,
            step_tolerance,
            rank_tolerance,
            single_step,
        };
        let (start, sizes) = (start.as_slice()?, sizes.as_slice()?);
        let storage = vec![0.0; levenberg_len(n)];
        let levenberg = Levenberg::new(start, sizes, settings, storage).map_err(to_python)?;
        let room = vec![0.0; descent_len(n)];
        let descent =
            Descent::new(start, sizes, 0.5 * step_tolerance.sqrt(), room).map_err(to_python)?;
        // a single step, and a look at the start, are those of the careful iteration
        let far = !single_step && max_evaluations > 1 && n > 0;
        Ok(Self {
            levenberg,
            descent: far.then_some(descent),
            // behind the square of its triangle begin the columns of its block
            stack: Stack::new(n, 1, Lined::zeros(stack_len(n, 1), (n + 1) * (n + 1)))
                .map_err(to_python)?,
            loss: Loss::from_name(loss)
                .ok_or_else(|| shape("loss", "'linear', 'huber', 'cauchy' or 'tukey'", &[]))?,
            cost: 0.0,
            asked: (0, f64::INFINITY),
            known,
            row: vec![0.0; n + 1],
        })
    }

    /// Parameters at which to evaluate the rows; after the end, the estimate.
    #[getter]
    fn trial<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.trial_values())
    }

    /// Forgets the rows of the previous trial.
    fn clear(&mut self) {
        self.begin();
    }

    /// Adds rows: derivatives `(n, m, parameters)`, residuals and weights `(n, m)`.
    fn push(
        &mut self,
        derivatives: PyReadonlyArray3<'_, f64>,
        residuals: PyReadonlyArray2<'_, f64>,
        weights: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<()> {
        let n = self.stack.columns();
        let dims = residuals.shape();
        if weights.shape() != dims {
            return Err(shape("weights", &format!("{dims:?}"), weights.shape()));
        }
        let expected = [dims[0], dims[1], n];
        if derivatives.shape() != expected {
            return Err(shape(
                "derivatives",
                &format!("{expected:?}"),
                derivatives.shape(),
            ));
        }
        let d = derivatives.as_slice()?;
        let (r, w) = (residuals.as_slice()?, weights.as_slice()?);
        for (k, (r, w)) in r.iter().zip(w).enumerate() {
            self.add(d[k * n..(k + 1) * n].iter().copied(), *r, *w);
        }
        Ok(())
    }

    /// Adds the rows of what is known besides.
    fn push_priors(&mut self) {
        self.add_priors();
    }

    /// Marks the trial as impossible: some row could not be evaluated there.
    fn fail(&mut self) {
        self.fail_trial();
    }

    /// Ends an evaluation: `"evaluate"`, `"converged"` or `"exhausted"`.
    fn advance(&mut self) -> PyResult<&'static str> {
        Ok(match self.step()? {
            Progress::Evaluate => "evaluate",
            Progress::Converged => "converged",
            Progress::Exhausted => "exhausted",
        })
    }

    /// What the triangle at the estimate says, for rows of unit noise.
    fn result<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let n = self.stack.columns();
        let mut data = vec![0.0; n * n];
        let mut unobserved = vec![0.0; n * n];
        let mut scratch = vec![0.0; n];
        let (rank, singular, directions, to_gain) = self
            .levenberg
            .with_decomposition(|d| {
                d.covariance(&mut data, &mut unobserved, &mut scratch);
                let directions: Vec<f64> = d.unobserved().flatten().copied().collect();
                (
                    d.rank(),
                    d.singular_values().to_vec(),
                    directions,
                    d.gain(0.0),
                )
            })
            .map_err(to_python)?;
        let out = PyDict::new(py);
        out.set_item("values", PyArray1::from_slice(py, self.levenberg.trial()))?;
        out.set_item("covariance", shaped(py, data, [n, n])?)?;
        out.set_item("unobserved_covariance", shaped(py, unobserved, [n, n])?)?;
        out.set_item("unobserved", shaped(py, directions, [n - rank, n])?)?;
        out.set_item("singular_values", PyArray1::from_vec(py, singular))?;
        out.set_item("rank", rank)?;
        out.set_item("cost", self.levenberg.cost())?;
        out.set_item("to_gain", to_gain)?;
        out.set_item("evaluations", self.levenberg.evaluations())?;
        out.set_item("rows", self.stack.rows())?;
        Ok(out)
    }
}
