//! `SphericalKinematics` and the functions of the paper's vision: mapping, sensitivity, place of the camera.

use crate::arrays::{fixed, rows, shaped};
use crate::errors::{shape, to_python};
use crate::lanes::{Block, LANES, LaneMap, in_lanes};
use nalgebra::Vector2;
use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use sherkit_core::spherical::vision::{self, ClosedMapping, Region};
use sherkit_core::spherical::{Assembly, Elbows, GEOMETRIC, Geometry, Kinematics};

pub type Marked<'py, A> = (Bound<'py, A>, Bound<'py, PyArray1<bool>>);

/// The assembly of this name.
pub fn assembly(name: &str) -> PyResult<Assembly> {
    match name {
        "outer" => Ok(Assembly::Outer),
        "inner" => Ok(Assembly::Inner),
        _ => Err(shape("assembly", "'outer' or 'inner'", &[])),
    }
}

/// The working mode of this name.
pub fn elbows_of(name: &str) -> PyResult<Elbows> {
    match name {
        "open" => Ok(Elbows::Open),
        "crossed" => Ok(Elbows::Crossed),
        "ahead" => Ok(Elbows::Ahead),
        "behind" => Ok(Elbows::Behind),
        _ => Err(shape(
            "elbows",
            "'open', 'crossed', 'ahead' or 'behind'",
            &[],
        )),
    }
}

fn region_of(name: &str) -> PyResult<Region> {
    match name {
        "half" => Ok(Region::Half),
        "quarter" => Ok(Region::Quarter),
        _ => Err(shape("region", "'half' or 'quarter'", &[])),
    }
}

#[derive(Clone, Copy)]
struct Forward<'a>(&'a Kinematics);

impl LaneMap<2, 2> for Forward<'_> {
    #[inline(always)]
    fn run(self, from: &Block<2>) -> (Block<2>, [bool; LANES]) {
        self.0.forward_lanes::<LANES>(from)
    }
}

#[derive(Clone, Copy)]
struct Inverse<'a>(&'a Kinematics, Elbows);

impl LaneMap<2, 2> for Inverse<'_> {
    #[inline(always)]
    fn run(self, from: &Block<2>) -> (Block<2>, [bool; LANES]) {
        self.0.inverse_lanes::<LANES>(from, self.1)
    }
}

/// Kinematics of the tool axis of a spherical robot with two limbs on one actuated axis.
#[pyclass(frozen, module = "sherkit._core")]
pub struct SphericalKinematics(Kinematics);

#[pymethods]
impl SphericalKinematics {
    #[new]
    #[pyo3(signature = (parameters, assembly_mode="outer"))]
    fn new(parameters: PyReadonlyArray1<'_, f64>, assembly_mode: &str) -> PyResult<Self> {
        let p = fixed::<GEOMETRIC, _>("parameters", &parameters)?;
        let geometry = Geometry::from_parameters(&p, assembly(assembly_mode)?);
        Kinematics::new(&geometry).map(Self).map_err(to_python)
    }

    fn forward<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let q = Vector2::from(fixed("joints", &joints)?);
        let found = self.0.forward(&q).map_err(to_python)?;
        Ok(PyArray1::from_slice(py, found.as_slice()))
    }

    #[pyo3(signature = (angles, elbows="open"))]
    fn inverse<'py>(
        &self,
        py: Python<'py>,
        angles: PyReadonlyArray1<'_, f64>,
        elbows: &str,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let x = Vector2::from(fixed("angles", &angles)?);
        let found = self.0.inverse(&x, elbows_of(elbows)?).map_err(to_python)?;
        Ok(PyArray1::from_slice(py, found.as_slice()))
    }

    fn forward_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let q = rows::<2, _>("joints", &joints)?;
        let (found, reached) = in_lanes(q, Forward(&self.0));
        marked(py, found, reached, 2)
    }

    #[pyo3(signature = (angles, elbows="open"))]
    fn inverse_batch<'py>(
        &self,
        py: Python<'py>,
        angles: PyReadonlyArray2<'_, f64>,
        elbows: &str,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let x = rows::<2, _>("angles", &angles)?;
        let (found, reached) = in_lanes(x, Inverse(&self.0, elbows_of(elbows)?));
        marked(py, found, reached, 2)
    }

    /// Derivative of φ, γ by the joint angles `(n, 2, 2)` and by the six parameters `(n, 2, 6)`.
    fn derivatives_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Both<'py>> {
        let q = rows::<2, _>("joints", &joints)?;
        both(py, q, |q| {
            let pose = self.0.pose(&Vector2::from(*q)).ok()?;
            pose.phi_rad
                .is_finite()
                .then(|| (pose.by_joints(), pose.by_parameters()))
        })
    }

    /// Derivative of the inverse at joint angles: of the joints by φ, γ `(n, 2, 2)` and by the six parameters
    /// `(n, 2, 6)`.
    fn inverse_derivatives_batch<'py>(
        &self,
        py: Python<'py>,
        joints: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Both<'py>> {
        let q = rows::<2, _>("joints", &joints)?;
        both(py, q, |q| {
            let pose = self.0.pose(&Vector2::from(*q)).ok()?;
            let by_angles = pose.joints_by_angles().ok()?;
            let by_parameters = pose.joints_by_parameters().ok()?;
            pose.phi_rad
                .is_finite()
                .then_some((by_angles, by_parameters))
        })
    }
}

type Both<'py> = (
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<bool>>,
);

fn both<'py>(
    py: Python<'py>,
    joints: &[[f64; 2]],
    of: impl Fn(&[f64; 2]) -> Option<(nalgebra::Matrix2<f64>, nalgebra::SMatrix<f64, 2, GEOMETRIC>)>,
) -> PyResult<Both<'py>> {
    let n = joints.len();
    let mut square = vec![f64::NAN; n * 4];
    let mut wide = vec![f64::NAN; n * 2 * GEOMETRIC];
    let mut reached = vec![false; n];
    for (i, q) in joints.iter().enumerate() {
        if let Some((a, b)) = of(q) {
            square[i * 4..][..4].copy_from_slice(a.transpose().as_slice());
            wide[i * 2 * GEOMETRIC..][..2 * GEOMETRIC].copy_from_slice(b.transpose().as_slice());
            reached[i] = true;
        }
    }
    Ok((
        shaped(py, square, [n, 2, 2])?,
        shaped(py, wide, [n, 2, GEOMETRIC])?,
        PyArray1::from_vec(py, reached),
    ))
}

pub fn marked(
    py: Python<'_>,
    values: Vec<f64>,
    reached: Vec<bool>,
    width: usize,
) -> PyResult<Marked<'_, PyArray2<f64>>> {
    let n = reached.len();
    Ok((
        shaped(py, values, [n, width])?,
        PyArray1::from_vec(py, reached),
    ))
}

/// φ, γ of pixels by the paper's closed mapping; `settings`: radius, distance from the surface (mm), half width and
/// height (px), half angles of view (rad).
#[pyfunction]
pub fn spherical_closed_mapping<'py>(
    py: Python<'py>,
    settings: PyReadonlyArray1<'_, f64>,
    pixels: PyReadonlyArray2<'_, f64>,
) -> PyResult<Marked<'py, PyArray2<f64>>> {
    let [radius_mm, clearance_mm, nx, ny, ax, ay] = fixed("settings", &settings)?;
    let mapping = ClosedMapping {
        radius_mm,
        clearance_mm,
        half_size: [nx, ny],
        half_angle: [ax, ay],
    };
    let pixels = rows::<2, _>("pixels", &pixels)?;
    let mut out = vec![f64::NAN; pixels.len() * 2];
    let mut reached = vec![false; pixels.len()];
    for ((pixel, out), ok) in pixels
        .iter()
        .zip(out.as_chunks_mut::<2>().0)
        .zip(&mut reached)
    {
        if let Ok(found) = mapping.angles(*pixel) {
            *out = found;
            *ok = true;
        }
    }
    marked(py, out, reached, 2)
}

/// Exact sensitivity dθ/dδ and the paper's approximation S (Eq. 27) at angles δ at the centre.
#[pyfunction]
#[pyo3(signature = (radius_mm, clearance_mm, arcs, step_rad=0.0))]
pub fn spherical_sensitivity<'py>(
    py: Python<'py>,
    radius_mm: f64,
    clearance_mm: f64,
    arcs: PyReadonlyArray1<'_, f64>,
    step_rad: f64,
) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>)> {
    let arcs = arcs.as_slice()?;
    let exact = arcs
        .iter()
        .map(|&d| vision::sensitivity(radius_mm, clearance_mm, d));
    let paper = arcs
        .iter()
        .map(|&d| vision::approximate_sensitivity(radius_mm, clearance_mm, d, step_rad));
    Ok((
        PyArray1::from_vec(py, exact.collect()),
        PyArray1::from_vec(py, paper.collect()),
    ))
}

/// What a camera sees from a distance from the centre, by default from the best one (Eqs. 29 to 33).
#[pyfunction]
#[pyo3(signature = (radius_mm, lens_rad, weight, region="half", distance_mm=None))]
pub fn spherical_camera_placement<'py>(
    py: Python<'py>,
    radius_mm: f64,
    lens_rad: f64,
    weight: f64,
    region: &str,
    distance_mm: Option<f64>,
) -> PyResult<Bound<'py, PyDict>> {
    let region = region_of(region)?;
    let found = match distance_mm {
        None => vision::best_placement(radius_mm, lens_rad, weight, region),
        Some(distance) => vision::placement(radius_mm, distance, lens_rad, weight, region),
    }
    .map_err(to_python)?;
    let out = PyDict::new(py);
    out.set_item("distance_mm", found.distance_mm)?;
    out.set_item("half_angle_rad", found.half_angle_rad)?;
    out.set_item("coverage", found.coverage)?;
    out.set_item("seen_mm2", found.seen_mm2)?;
    out.set_item("waste_mm2", found.waste_mm2)?;
    out.set_item("benefit_mm2", found.benefit_mm2)?;
    Ok(out)
}
