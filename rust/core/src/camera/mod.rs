//! A pinhole camera with Brown–Conrady distortion, in `OpenCV`'s conventions.
//!
//! `X_cam = R X + t` (mm), with the z axis of the camera along its line of sight, x to the right and y down in the
//! picture; `x = X/Z`, `y = Y/Z`, `r² = x² + y²`;
//! `x″ = x (1 + k₁r² + k₂r⁴ + k₃r⁶) + 2p₁xy + p₂(r² + 2x²)`, `y″` likewise with `p₁(r² + 2y²) + 2p₂xy`;
//! `u = f_x x″ + c_x`, `v = f_y y″ + c_y` (px).
//!
//! Sources: Eqs. 8, 9 of Agand et al. (their Eq. 9 drops a symbol); D. C. Brown, Photogrammetric Engineering 37 (1971);
//! `OpenCV`, `projectPoints`. A point that is no number gives [`Error::NotFinite`].

mod lens;
mod rotation;
mod sphere;

pub use rotation::{left_jacobian, right_jacobian, rotation_matrix, rotation_vector};
pub use sphere::Face;

use crate::numbers::math::Real;
use crate::numbers::rigid::Rigid;
use crate::{Error, Result};
use lens::Lens;
use nalgebra::{Matrix2, Matrix2x3, Matrix3, SMatrix, Vector2, Vector3};

/// Numbers of a camera: `f_x, f_y, c_x, c_y`, `k₁, k₂, p₁, p₂, k₃`, rotation vector (3), translation (3).
pub const PARAMETERS: usize = 15;

/// A camera as its calibration writes it down.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Description {
    /// Focal lengths and principal point, `f_x, f_y, c_x, c_y`, px.
    pub intrinsics: [f64; 4],
    /// `k₁, k₂, p₁, p₂, k₃`, `OpenCV`'s order.
    pub distortion: [f64; 5],
    /// Rotation vector of the pose, rad.
    pub rotation: Vector3<f64>,
    /// Translation of the pose, mm.
    pub translation: Vector3<f64>,
}

impl Description {
    /// From the numbers in the order of [`PARAMETERS`].
    #[must_use]
    pub fn from_parameters(p: &[f64; PARAMETERS]) -> Self {
        Self {
            intrinsics: [p[0], p[1], p[2], p[3]],
            distortion: [p[4], p[5], p[6], p[7], p[8]],
            rotation: Vector3::new(p[9], p[10], p[11]),
            translation: Vector3::new(p[12], p[13], p[14]),
        }
    }

    /// The numbers in the order of [`PARAMETERS`].
    #[must_use]
    pub fn parameters(&self) -> [f64; PARAMETERS] {
        let mut p = [0.0; PARAMETERS];
        p[..4].copy_from_slice(&self.intrinsics);
        p[4..9].copy_from_slice(&self.distortion);
        p[9..12].copy_from_slice(self.rotation.as_slice());
        p[12..].copy_from_slice(self.translation.as_slice());
        p
    }

    /// A camera without distortion that looks at the origin from the direction φ, γ and a distance: the paper's
    /// set-up (φ = π/2, γ = π/4). Its x axis points to growing φ, its y axis to growing γ.
    #[must_use]
    pub fn facing(phi_rad: f64, gamma_rad: f64, distance_mm: f64, intrinsics: [f64; 4]) -> Self {
        let (sp, cp) = crate::numbers::math::sin_cos(phi_rad);
        let (sg, cg) = crate::numbers::math::sin_cos(gamma_rad);
        let rotation = Matrix3::new(-sp, cp, 0.0, cg * cp, cg * sp, -sg, -sg * cp, -sg * sp, -cg);
        Self {
            intrinsics,
            distortion: [0.0; 5],
            rotation: rotation_vector(&rotation),
            translation: Vector3::new(0.0, 0.0, distance_mm),
        }
    }
}

/// A camera ready to project.
#[derive(Clone, Copy, Debug)]
pub struct Camera {
    focal: [f64; 2],
    centre: [f64; 2],
    lens: Lens,
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
    /// Right Jacobian of the rotation vector.
    turning: Matrix3<f64>,
}

/// A projected point with what its derivatives need.
#[derive(Clone, Copy, Debug)]
pub struct Projection {
    /// Pixel.
    pub pixel: Vector2<f64>,
    /// By the point in the camera frame.
    pub by_seen: Matrix2x3<f64>,
    /// By `f_x, f_y, c_x, c_y`.
    pub by_intrinsics: SMatrix<f64, 2, 4>,
    /// By `k₁, k₂, p₁, p₂, k₃`.
    pub by_distortion: SMatrix<f64, 2, 5>,
}

impl Camera {
    /// Prepares a camera.
    ///
    /// # Errors
    /// [`Error::NotFinite`] names the number by its place in [`PARAMETERS`]; [`Error::InvalidCamera`] for a focal
    /// length that is not positive.
    pub fn new(description: &Description) -> Result<Self> {
        if let Some(index) = description.parameters().iter().position(|v| !v.is_finite()) {
            return Err(Error::NotFinite { index });
        }
        let [fx, fy, cx, cy] = description.intrinsics;
        if fx <= 0.0 || fy <= 0.0 {
            let what = "the focal lengths must be positive";
            return Err(Error::InvalidCamera { what });
        }
        Ok(Self {
            focal: [fx, fy],
            centre: [cx, cy],
            lens: Lens(description.distortion),
            rotation: rotation_matrix(&description.rotation),
            translation: description.translation,
            turning: right_jacobian(&description.rotation),
        })
    }

    /// From the base frame to that of the camera.
    pub(crate) fn frame(&self) -> Rigid {
        Rigid {
            rotation: self.rotation,
            translation: self.translation,
        }
    }

    /// The same camera where it stands elsewhere.
    pub(crate) fn standing(mut self, frame: &Rigid) -> Self {
        self.rotation = frame.rotation;
        self.translation = frame.translation;
        self
    }

    /// Rotation from the base frame to the camera's.
    #[must_use]
    pub fn rotation(&self) -> &Matrix3<f64> {
        &self.rotation
    }

    /// Optical centre, base frame, mm.
    #[must_use]
    pub fn position(&self) -> Vector3<f64> {
        -(self.rotation.transpose() * self.translation)
    }

    /// Direction of a point from the optical centre, in the camera frame, mm.
    #[must_use]
    pub fn seen(&self, point: &Vector3<f64>) -> Vector3<f64> {
        self.rotation * point + self.translation
    }

    /// Pixel of a point, mm.
    ///
    /// # Errors
    /// [`Error::BehindCamera`], [`Error::NotFinite`].
    pub fn project(&self, point: &Vector3<f64>) -> Result<Vector2<f64>> {
        let (pixel, depth) = self.formula([point.x, point.y, point.z]);
        check(point, depth)?;
        finite(Vector2::from(pixel))
    }

    /// The formula of the module, one point or many side by side: pixel and depth.
    #[inline(always)]
    fn formula<T: Real>(&self, point: [T; 3]) -> ([T; 2], T) {
        let mut seen = [T::splat(0.0); 3];
        for (row, out) in seen.iter_mut().enumerate() {
            *out = point[0] * T::splat(self.rotation[(row, 0)])
                + point[1] * T::splat(self.rotation[(row, 1)])
                + point[2] * T::splat(self.rotation[(row, 2)])
                + T::splat(self.translation[row]);
        }
        let nearness = T::splat(1.0) / seen[2];
        let [x, y] = self.lens.bend([seen[0] * nearness, seen[1] * nearness]);
        let pixel = [
            x * T::splat(self.focal[0]) + T::splat(self.centre[0]),
            y * T::splat(self.focal[1]) + T::splat(self.centre[1]),
        ];
        (pixel, seen[2])
    }

    /// [`Self::project`] for points side by side: pixels, and one for those in front of the camera, zero for the others.
    #[inline(always)]
    #[must_use]
    pub fn project_lanes<T: Real>(&self, points: [T; 3]) -> ([T; 2], T) {
        let (zero, far) = (T::splat(0.0), T::splat(f64::INFINITY));
        let (pixel, depth) = self.formula(points);
        let mut seen = depth.above(zero, T::splat(1.0), zero);
        for coordinate in pixel {
            seen = far.above(coordinate.size(), seen, zero);
        }
        (pixel, seen)
    }

    /// Projects with derivatives.
    ///
    /// # Errors
    /// As [`Self::project`].
    pub fn projection(&self, point: &Vector3<f64>) -> Result<Projection> {
        let pixel = self.project(point)?;
        let seen = self.seen(point);
        let nearness = 1.0 / seen.z;
        let flat = [seen.x * nearness, seen.y * nearness];
        let focal = Matrix2::new(self.focal[0], 0.0, 0.0, self.focal[1]);
        let flatten = Matrix2x3::new(
            nearness,
            0.0,
            -flat[0] * nearness,
            0.0,
            nearness,
            -flat[1] * nearness,
        );
        let [x, y] = self.lens.bend(flat);
        Ok(Projection {
            pixel,
            by_seen: focal * self.lens.by_direction(flat) * flatten,
            by_intrinsics: SMatrix::<f64, 2, 4>::new(x, 0.0, 1.0, 0.0, 0.0, y, 0.0, 1.0),
            by_distortion: focal * Lens::by_coefficients(flat),
        })
    }

    /// Derivative of a projection by the point, base frame.
    #[must_use]
    pub fn by_point(&self, projection: &Projection) -> Matrix2x3<f64> {
        projection.by_seen * self.rotation
    }

    /// Derivative of a projection by rotation vector and translation; exact at any rotation.
    #[must_use]
    pub fn by_pose(&self, projection: &Projection, point: &Vector3<f64>) -> SMatrix<f64, 2, 6> {
        // R(w + dw) = R(w) exp(J_r dw)
        let by_rotation =
            -(projection.by_seen * self.rotation * point.cross_matrix() * self.turning);
        let mut d = SMatrix::<f64, 2, 6>::zeros();
        d.fixed_columns_mut::<3>(0).copy_from(&by_rotation);
        d.fixed_columns_mut::<3>(3).copy_from(&projection.by_seen);
        d
    }

    /// Direction in the camera frame, `(x, y, 1)`, that a pixel shows: the lens distortion undone.
    ///
    /// # Errors
    /// [`Error::LensFolds`], [`Error::NotFinite`].
    pub fn undistort(&self, pixel: &Vector2<f64>) -> Result<Vector3<f64>> {
        finite(*pixel)?;
        let bent = [
            (pixel.x - self.centre[0]) / self.focal[0],
            (pixel.y - self.centre[1]) / self.focal[1],
        ];
        let [x, y] = self.lens.straighten(bent)?;
        Ok(Vector3::new(x, y, 1.0))
    }
}

fn check(point: &Vector3<f64>, depth_mm: f64) -> Result<()> {
    if let Some(index) = point.iter().position(|v| !v.is_finite()) {
        return Err(Error::NotFinite { index });
    }
    if depth_mm <= 0.0 {
        return Err(Error::BehindCamera { depth_mm });
    }
    Ok(())
}

fn finite(v: Vector2<f64>) -> Result<Vector2<f64>> {
    v.iter()
        .position(|c| !c.is_finite())
        .map_or(Ok(v), |index| Err(Error::NotFinite { index }))
}
