//! `Camera`: projection and its inverse onto a sphere, single and batched.

use crate::arrays::{Marked, fixed, marked, rows, shaped};
use crate::errors::{shape, to_python};
use crate::lanes::LaneMap;
use crate::maps::many;
use nalgebra::{Vector2, Vector3};
use numpy::{PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2};
use pyo3::prelude::*;
use sherkit_core::Result;
use sherkit_core::camera::{Camera as Core, Description, Face, PARAMETERS};
use sherkit_core::numbers::wide::Wide;

/// The face of this name.
pub fn face(name: &str) -> PyResult<Face> {
    match name {
        "near" => Ok(Face::Near),
        "far" => Ok(Face::Far),
        _ => Err(shape("face", "'near' or 'far'", &[])),
    }
}

#[derive(Clone, Copy)]
struct Project<'a>(&'a Core);

impl LaneMap<3, 2> for Project<'_> {
    #[inline(always)]
    fn run<V: Wide>(self, from: [V; 3]) -> ([V; 2], V) {
        self.0.project_lanes(from)
    }
}

/// By point, pose, intrinsics, distortion, and which points are seen.
type Derivatives<'py> = (
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray1<bool>>,
);

/// A pinhole camera with Brown–Conrady distortion, in `OpenCV`'s conventions.
#[pyclass(frozen, module = "sherkit._core")]
pub struct Camera(pub Core);

#[pymethods]
impl Camera {
    /// `parameters`: fx, fy, cx, cy, k1, k2, p1, p2, k3, rotation vector (3), translation (3).
    #[new]
    fn new(parameters: PyReadonlyArray1<'_, f64>) -> PyResult<Self> {
        let p = fixed::<PARAMETERS, _>("parameters", &parameters)?;
        Core::new(&Description::from_parameters(&p))
            .map(Self)
            .map_err(to_python)
    }

    /// Parameters of a camera without distortion that looks at the origin from the direction φ, γ and a distance.
    #[staticmethod]
    fn facing<'py>(
        py: Python<'py>,
        phi_rad: f64,
        gamma_rad: f64,
        distance_mm: f64,
        intrinsics: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let intrinsics = fixed("intrinsics", &intrinsics)?;
        let found = Description::facing(phi_rad, gamma_rad, distance_mm, intrinsics);
        Ok(PyArray1::from_slice(py, &found.parameters()))
    }

    /// Optical centre, base frame, mm.
    #[getter]
    fn position<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.0.position().as_slice())
    }

    /// From the base frame to its own, x right, y down, z forward `(3, 3)`.
    #[getter]
    fn rotation<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        shaped(
            py,
            self.0.rotation().transpose().as_slice().to_vec(),
            [3, 3],
        )
    }

    fn project<'py>(
        &self,
        py: Python<'py>,
        point: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let point = Vector3::from(fixed("point", &point)?);
        let pixel = self.0.project(&point).map_err(to_python)?;
        Ok(PyArray1::from_slice(py, pixel.as_slice()))
    }

    fn project_batch<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        many(py, "points", &points, Project(&self.0))
    }

    /// Derivatives of the pixels by point `(n, 2, 3)`, rotation vector and translation `(n, 2, 6)`, intrinsics
    /// `(n, 2, 4)` and distortion `(n, 2, 5)`.
    fn derivatives_batch<'py>(
        &self,
        py: Python<'py>,
        points: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Derivatives<'py>> {
        let points = rows::<3, _>("points", &points)?.to_vec();
        let n = points.len();
        let mut out = [3, 6, 4, 5].map(|width| vec![f64::NAN; n * 2 * width]);
        let mut seen = vec![false; n];
        py.detach(|| {
            for (i, point) in points.iter().enumerate() {
                let point = Vector3::from(*point);
                let Ok(found) = self.0.projection(&point) else {
                    continue;
                };
                seen[i] = true;
                let (by_point, by_pose) = (self.0.by_point(&found), self.0.by_pose(&found, &point));
                let [a, b, c, d] = &mut out;
                a[i * 6..][..6].copy_from_slice(by_point.transpose().as_slice());
                b[i * 12..][..12].copy_from_slice(by_pose.transpose().as_slice());
                c[i * 8..][..8].copy_from_slice(found.by_intrinsics.transpose().as_slice());
                d[i * 10..][..10].copy_from_slice(found.by_distortion.transpose().as_slice());
            }
        });
        let [a, b, c, d] = out;
        Ok((
            shaped(py, a, [n, 2, 3])?,
            shaped(py, b, [n, 2, 6])?,
            shaped(py, c, [n, 2, 4])?,
            shaped(py, d, [n, 2, 5])?,
            PyArray1::from_vec(py, seen),
        ))
    }

    /// Direction `(x, y)`, `z = 1`, in the camera frame that a pixel shows.
    fn undistort<'py>(
        &self,
        py: Python<'py>,
        pixel: PyReadonlyArray1<'_, f64>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let pixel = Vector2::from(fixed("pixel", &pixel)?);
        let found = self.0.undistort(&pixel).map_err(to_python)?;
        Ok(PyArray1::from_slice(py, &[found.x, found.y]))
    }

    fn undistort_batch<'py>(
        &self,
        py: Python<'py>,
        pixels: PyReadonlyArray2<'_, f64>,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        each::<2>(py, &pixels, |pixel| {
            self.0.undistort(pixel).map(|d| [d.x, d.y])
        })
    }

    /// φ, γ of the point of a sphere about the origin that a pixel shows.
    #[pyo3(signature = (pixel, radius_mm, face="near"))]
    fn angles<'py>(
        &self,
        py: Python<'py>,
        pixel: PyReadonlyArray1<'_, f64>,
        radius_mm: f64,
        face: &str,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let pixel = Vector2::from(fixed("pixel", &pixel)?);
        let face = self::face(face)?;
        let found = self
            .0
            .angles_on_sphere(&pixel, radius_mm, face)
            .map_err(to_python)?;
        Ok(PyArray1::from_slice(py, found.as_slice()))
    }

    #[pyo3(signature = (pixels, radius_mm, face="near"))]
    fn angles_batch<'py>(
        &self,
        py: Python<'py>,
        pixels: PyReadonlyArray2<'_, f64>,
        radius_mm: f64,
        face: &str,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let face = self::face(face)?;
        each::<2>(py, &pixels, |pixel| {
            self.0
                .angles_on_sphere(pixel, radius_mm, face)
                .map(Into::into)
        })
    }

    /// Points of a sphere about the origin that pixels show, mm.
    #[pyo3(signature = (pixels, radius_mm, face="near"))]
    fn on_sphere_batch<'py>(
        &self,
        py: Python<'py>,
        pixels: PyReadonlyArray2<'_, f64>,
        radius_mm: f64,
        face: &str,
    ) -> PyResult<Marked<'py, PyArray2<f64>>> {
        let face = self::face(face)?;
        each::<3>(py, &pixels, |pixel| {
            self.0.on_sphere(pixel, radius_mm, face).map(Into::into)
        })
    }
}

/// A map of pixels, one by one; what has no answer is NaN and marked.
fn each<'py, const N: usize>(
    py: Python<'py>,
    pixels: &PyReadonlyArray2<'_, f64>,
    of: impl Fn(&Vector2<f64>) -> Result<[f64; N]> + Sync,
) -> PyResult<Marked<'py, PyArray2<f64>>> {
    let pixels = rows::<2, _>("pixels", pixels)?.to_vec();
    let mut out = vec![f64::NAN; pixels.len() * N];
    let mut seen = vec![false; pixels.len()];
    py.detach(|| {
        for ((pixel, out), ok) in pixels.iter().zip(out.as_chunks_mut::<N>().0).zip(&mut seen) {
            if let Ok(found) = of(&Vector2::from(*pixel)) {
                *out = found;
                *ok = true;
            }
        }
    });
    marked(py, out, seen, N)
}
