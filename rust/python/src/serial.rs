//! The serial arm from Python: `SerialModel`, `SerialCalibrated`.

use crate::arrays::{
    self, Marked, RIGID, Rows, fixed, marked, periods as each_period, rigid, rows, shaped,
};
use crate::calibrated::Single;
use crate::errors::{shape, to_python};
use crate::maps::{WithDerivative, vector};
use crate::model::{Derivatives, model_class};
use crate::rows::{Block, check_free, first, table};
use crate::solver::Solver;
use nalgebra::{SVector, Vector3};
use numpy::{
    PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use sherkit_core::chain::effects::Wanted;
use sherkit_core::chain::{Covariates, Flat, PLANES, REFERENCE_TEMPERATURE_C, Robot};
use sherkit_core::flat::write_serial;
use sherkit_core::serial::{
    self, CATALOGUE, Calibrated as Core, JOINTS, Joint, Limits, Model, PARAMETERS, Values,
};

/// Numbers of a joint: its frame, whether it slides, how it follows the one before, home, mass and its centre.
const NUMBERS: usize = RIGID + 7;

/// As many points as there are, the others zero.
fn points<const N: usize>(
    name: &str,
    array: &PyReadonlyArray2<'_, f64>,
) -> PyResult<[Vector3<f64>; N]> {
    let found = rows::<3, _>(name, array)?;
    if found.len() > N {
        return Err(shape(name, &format!("(up to {N}, 3)"), array.shape()));
    }
    let mut out = [Vector3::zeros(); N];
    for (point, numbers) in out.iter_mut().zip(found) {
        *point = Vector3::from(*numbers);
    }
    Ok(out)
}

/// As many planes as there are, the others the ground.
fn flats(array: &PyReadonlyArray2<'_, f64>) -> PyResult<[Flat; PLANES]> {
    let found = rows::<6, _>("planes", array)?;
    if found.len() > PLANES {
        return Err(shape(
            "planes",
            &format!("(up to {PLANES}, 6)"),
            array.shape(),
        ));
    }
    let mut out = [Flat::GROUND; PLANES];
    for (plane, [x, y, z, normal @ ..]) in out.iter_mut().zip(found) {
        plane.at = Vector3::new(*x, *y, *z);
        plane.normal = Vector3::from(*normal);
    }
    Ok(out)
}

fn joint(numbers: &[f64; NUMBERS]) -> Joint {
    Joint {
        fixed: rigid(numbers),
        prismatic: numbers[RIGID] != 0.0,
        follows: numbers[RIGID + 1],
        home: numbers[RIGID + 2],
        mass_kg: numbers[RIGID + 3],
        centre_mm: Vector3::from_column_slice(&numbers[RIGID + 4..]),
    }
}

/// A nominal serial arm whose errors and effects are to be identified. Readings are x, y, z of its target, mm, in the
/// frame of the sensor.
#[pyclass(frozen, module = "sherkit._core")]
pub struct SerialModel(Model);

model_class!(SerialModel, Model, serial, {
    /// `joints` `(k, 19)`: of each its frame behind the one before it (turn row by row, shift in mm), 1 where it slides,
    /// by how much it follows the one before, home reading, mass and the centre of it (mm); `targets` `(1 to 4, 3)`
    /// behind the last joint; `centres` `(0 to 4, 3)` of distances in the base frame (mm) and `planes` `(0 to 4, 6)`, a
    /// point (mm) and the normal of each; `sensor` `(12,)`: from base to sensor; `settings`:
    /// direction of the weight (3), period of the encoders, time origin, slip times of target, joints
    /// and sensor (s); `periods` `(k,)`: that of each joint, where they differ.
    #[new]
    #[pyo3(signature = (joints, targets, centres, planes, sensor, settings, periods=None))]
    fn new(
        joints: PyReadonlyArray2<'_, f64>,
        targets: PyReadonlyArray2<'_, f64>,
        centres: PyReadonlyArray2<'_, f64>,
        planes: PyReadonlyArray2<'_, f64>,
        sensor: PyReadonlyArray1<'_, f64>,
        settings: PyReadonlyArray1<'_, f64>,
        periods: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Self> {
        let found = rows::<NUMBERS, _>("joints", &joints)?;
        if found.is_empty() || found.len() > JOINTS {
            return Err(shape(
                "joints",
                &format!("(1 to {JOINTS}, {NUMBERS})"),
                joints.shape(),
            ));
        }
        let mut all = [Joint::NONE; JOINTS];
        for (one, numbers) in all.iter_mut().zip(found) {
            *one = joint(numbers);
        }
        let [
            gx,
            gy,
            gz,
            encoder_period,
            time_origin_s,
            slip_time_s,
            joint_slip_time_s,
            sensor_slip_time_s,
        ] = fixed::<8, _>("settings", &settings)?;
        let model = Model {
            joints: all,
            count: found.len(),
            targets_mm: points("targets", &targets)?,
            centres_mm: points("centres", &centres)?,
            planes: flats(&planes)?,
            sensor: rigid(&fixed::<RIGID, _>("sensor", &sensor)?),
            gravity: Vector3::new(gx, gy, gz),
            encoder_period: each_period(found.len(), encoder_period, periods.as_ref())?,
            time_origin_s,
            slip_time_s,
            joint_slip_time_s,
            sensor_slip_time_s,
        };
        model.check().map_err(to_python)?;
        Ok(Self(model))
    }
});

/// A calibrated arm: where its target is in the base frame, and joints that bring it somewhere.
#[pyclass(frozen, module = "sherkit._core")]
pub struct SerialCalibrated {
    core: Core,
    model: Model,
    values: Values,
    limits: Limits,
}

impl SerialCalibrated {
    fn home(&self) -> [f64; JOINTS] {
        self.model.joints.map(|joint| joint.home)
    }

    /// What a control loop knows besides the joints: time s, temperature °C, a direction for each joint, payload
    /// kg.
    fn now(&self, numbers: &[f64]) -> PyResult<Covariates<JOINTS>> {
        let k = self.core.joints();
        if numbers.len() != 3 + k {
            return Err(shape(
                "covariates",
                &format!("({},)", 3 + k),
                &[numbers.len()],
            ));
        }
        Ok(Covariates {
            time_s: numbers[0],
            temperature_c: numbers[1],
            stand_c: REFERENCE_TEMPERATURE_C,
            payload_kg: numbers[2 + k],
            direction: first(&numbers[2..], k),
            velocity: [0.0; JOINTS],
        })
    }

    fn many(&self, name: &str, joints: &PyReadonlyArray2<'_, f64>) -> PyResult<Vec<[f64; JOINTS]>> {
        let k = self.core.joints();
        let n = joints.shape()[0];
        let numbers = table(name, joints, n, k)?;
        Ok(numbers.chunks_exact(k).map(|one| first(one, k)).collect())
    }

    fn one(
        &self,
        name: &str,
        joints: &PyReadonlyArray1<'_, f64>,
    ) -> PyResult<SVector<f64, JOINTS>> {
        let k = self.core.joints();
        match joints.as_slice() {
            Ok(numbers) if numbers.len() == k => Ok(SVector::from(first::<JOINTS>(numbers, k))),
            _ => Err(shape(name, &format!("({k},), contiguous"), joints.shape())),
        }
    }
}

#[pymethods]
impl SerialCalibrated {
    /// `low` and `high` are the limits of the joints `(k,)`; `frame` is that of places, "base" or "sensor".
    #[new]
    #[pyo3(signature = (model, values, low, high, frame="base"))]
    fn new(
        model: PyRef<'_, SerialModel>,
        values: PyReadonlyArray1<'_, f64>,
        low: PyReadonlyArray1<'_, f64>,
        high: PyReadonlyArray1<'_, f64>,
        frame: &str,
    ) -> PyResult<Self> {
        let values = fixed("values", &values)?;
        let k = model.0.count;
        let numbers = |name: &str, array: &PyReadonlyArray1<'_, f64>| match array.as_slice() {
            Ok(numbers) if numbers.len() == k => Ok(first(numbers, k)),
            _ => Err(shape(name, &format!("({k},), contiguous"), array.shape())),
        };
        let limits = Limits {
            low: numbers("low", &low)?,
            high: numbers("high", &high)?,
        };
        Ok(Self {
            core: Core::new(&model.0, &values, &limits)
                .map_err(to_python)?
                .in_frame(arrays::frame(frame)?),
            model: model.0,
            values,
            limits,
        })
    }

    /// From the base frame to that of the sensor `(12,)`: turn row by row, shift in mm.
    fn sensor<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, &arrays::numbers_of(self.core.sensor()))
    }

    /// All that makes it as a row of numbers `(n,)`, for a control loop in another language.
    fn flat<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let mut numbers = Vec::new();
        write_serial(&self.model, &self.values, &self.limits, |x| numbers.push(x));
        PyArray1::from_vec(py, numbers)
    }

    /// Where its target is at joint readings `(3,)`, and the derivative by them `(3, k)`.
    fn forward<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray1<'_, f64>,
        covariates: Vec<f64>,
    ) -> PyResult<Single<'py>> {
        let (q, now) = (self.one("joints", &joints)?, self.now(&covariates)?);
        let (x, by_joints) = self.core.forward(&q, &now).map_err(to_python)?;
        let k = self.core.joints();
        let mut numbers = Rows::new(1, 3, k);
        numbers.put(0, &by_joints);
        Ok((
            PyArray1::from_slice(py, x.as_slice()),
            shaped(py, numbers.numbers(), [3, k])?,
        ))
    }

    /// The same for many joint readings, and which could be computed; the others are NaN.
    fn forward_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
        covariates: Vec<f64>,
    ) -> PyResult<WithDerivative<'py>> {
        let (q, now) = (self.many("joints", &joints)?, self.now(&covariates)?);
        let (mut places, mut by_joints) = (
            Rows::new(q.len(), 3, 1),
            Rows::new(q.len(), 3, self.core.joints()),
        );
        let mut reached = vec![false; q.len()];
        py.detach(|| {
            for (i, q) in q.iter().enumerate() {
                if let Ok((x, j)) = self.core.forward(&SVector::from(*q), &now) {
                    places.put(i, &x);
                    by_joints.put(i, &j);
                    reached[i] = true;
                }
            }
        });
        Ok((
            places.vectors(py)?,
            by_joints.matrices(py)?,
            PyArray1::from_vec(py, reached),
        ))
    }

    /// The turn of the frame behind the last joint at joint readings `(3, 3)`.
    fn flange<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray1<'_, f64>,
        covariates: Vec<f64>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (q, now) = (self.one("joints", &joints)?, self.now(&covariates)?);
        let turn = self.core.flange(&q, &now).map_err(to_python)?;
        shaped(py, turn.transpose().as_slice().to_vec(), [3, 3])
    }

    /// Derivatives of the place by the parameters whose indices are given `(n, 3, free)`, and which could be computed.
    fn by_parameters_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
        covariates: Vec<f64>,
        free: Vec<usize>,
    ) -> PyResult<(Bound<'py, PyArray3<f64>>, Bound<'py, PyArray1<bool>>)> {
        check_free::<PARAMETERS>(&free)?;
        let (q, now) = (self.many("joints", &joints)?, self.now(&covariates)?);
        let wanted = Wanted::of(CATALOGUE, &free);
        let mut out = Rows::new(q.len(), 3, free.len());
        let mut reached = vec![false; q.len()];
        py.detach(|| {
            for (i, q) in q.iter().enumerate() {
                if let Ok(found) = self.core.predict(&SVector::from(*q), &now, wanted) {
                    out.put_columns(i, &found.by_parameters, &free);
                    reached[i] = true;
                }
            }
        });
        Ok((out.matrices(py)?, PyArray1::from_vec(py, reached)))
    }

    /// Joint readings `(k,)` at which its target is at `place` `(3,)`, found from those of `start` `(k,)`, or from home.
    #[pyo3(signature = (place, covariates, start=None))]
    fn inverse<'py>(
        &self,
        py: Python<'py>,
        place: PyReadonlyArray1<'_, f64>,
        covariates: Vec<f64>,
        start: Option<PyReadonlyArray1<'_, f64>>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let (x, now) = (vector("place", &place)?, self.now(&covariates)?);
        let start = match &start {
            Some(start) => self.one("start", start)?,
            None => SVector::from(self.home()),
        };
        let found = self.core.inverse(&x, &start, &now).map_err(to_python)?;
        Ok(PyArray1::from_slice(
            py,
            &found.as_slice()[..self.core.joints()],
        ))
    }

    /// The same for many places `(n, 3)`, each from a start of its own `(n, k)`, and which are in reach; the others are
    /// NaN.
    #[pyo3(signature = (places, covariates, starts=None))]
    fn inverse_batch<'py>(
        &self,
        py: Python<'py>,
        places: PyReadonlyArray2<'_, f64>,
        covariates: Vec<f64>,
        starts: Option<PyReadonlyArray2<'_, f64>>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let places = rows::<3, _>("places", &places)?.to_vec();
        let (n, k) = (places.len(), self.core.joints());
        let starts = match &starts {
            Some(starts) => self.many("starts", starts)?,
            None => vec![self.home(); n],
        };
        if starts.len() != n {
            return Err(shape("starts", &format!("({n}, {k})"), &[starts.len(), k]));
        }
        let now = self.now(&covariates)?;
        let mut out = vec![f64::NAN; n * k];
        let mut reached = vec![false; n];
        py.detach(|| {
            for (i, (place, start)) in places.iter().zip(&starts).enumerate() {
                let (place, start) = (Vector3::from(*place), SVector::from(*start));
                if let Ok(found) = self.core.inverse(&place, &start, &now) {
                    out[k * i..k * (i + 1)].copy_from_slice(&found.as_slice()[..k]);
                    reached[i] = true;
                }
            }
        });
        marked(py, out, reached, k)
    }
}
