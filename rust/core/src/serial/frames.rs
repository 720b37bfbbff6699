//! Where the joints of an arm stand, base frame: axes and origins, from which every derivative follows.

use super::arm::JOINTS;
use crate::numbers::math::sin_cos;
use crate::numbers::rigid::Rigid;
use nalgebra::{Matrix3, Vector3};

/// A joint in its place: the fixed part before it with its errors, and how it moves along or about its own z.
#[derive(Clone, Copy, Debug)]
pub(super) struct Link {
    /// From the frame behind the joint before it: the turn as drawn, and the shift with its error.
    turn: Matrix3<f64>,
    shift: Vector3<f64>,
    /// Lean of the axis: about x, then about the y that this leaves.
    lean: Matrix3<f64>,
    lean_y: Vector3<f64>,
    pub(super) prismatic: bool,
}

/// A joint where it stands.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    /// Before its lean: columns are x, y and z.
    pub(super) before: Matrix3<f64>,
    /// The axis about which the second lean turns.
    pub(super) lean_y: Vector3<f64>,
    /// The axis of the joint.
    pub(super) axis: Vector3<f64>,
    /// A point of the axis, mm.
    pub(super) origin: Vector3<f64>,
    /// Behind the joint.
    pub(super) behind: Rigid,
    /// From the joint before it, mm, without growth.
    pub(super) reach: Vector3<f64>,
    pub(super) prismatic: bool,
}

impl Link {
    /// A joint whose fixed part is as drawn but for shifts along x and y, mm, and leans about them, rad.
    pub(super) fn new(fixed: &Rigid, prismatic: bool, shift: [f64; 2], lean: [f64; 2]) -> Self {
        let ((sx, cx), (sy, cy)) = (sin_cos(lean[0]), sin_cos(lean[1]));
        let about_x = Matrix3::new(1.0, 0.0, 0.0, 0.0, cx, -sx, 0.0, sx, cx);
        let about_y = Matrix3::new(cy, 0.0, sy, 0.0, 1.0, 0.0, -sy, 0.0, cy);
        Self {
            turn: fixed.rotation,
            shift: fixed.translation + fixed.rotation * Vector3::new(shift[0], shift[1], 0.0),
            lean: about_x * about_y,
            lean_y: about_x.column(1).into(),
            prismatic,
        }
    }

    /// Where it stands behind a frame, at a value of its joint, rad or mm, where the link between them has grown by a
    /// factor.
    pub(super) fn place(&self, behind: &Rigid, value: f64, growth: f64) -> Place {
        let before = behind.rotation * self.turn;
        let reach = behind.rotation * self.shift;
        let origin = behind.translation + reach * growth;
        let leaning = before * self.lean;
        let axis: Vector3<f64> = leaning.column(2).into();
        let (rotation, translation) = if self.prismatic {
            (leaning, origin + axis * value)
        } else {
            let (sin, cos) = sin_cos(value);
            let (x, y) = (leaning.column(0), leaning.column(1));
            let turned = [x * cos + y * sin, y * cos - x * sin, axis];
            (Matrix3::from_columns(&turned), origin)
        };
        Place {
            before,
            lean_y: before * self.lean_y,
            axis,
            origin,
            behind: Rigid {
                rotation,
                translation,
            },
            reach,
            prismatic: self.prismatic,
        }
    }
}

impl Place {
    /// How a point behind the joint moves with it, mm by rad or mm.
    pub(super) fn moves(&self, point: &Vector3<f64>) -> Vector3<f64> {
        if self.prismatic {
            self.axis
        } else {
            self.axis.cross(&(point - self.origin))
        }
    }
}

/// Where the first `count` of `links` stand, one behind another, and the frame behind the last; places beyond are those of
/// none. The link before each has grown by a factor.
pub(super) fn stand(
    links: &[Link; JOINTS],
    count: usize,
    values: &[f64; JOINTS],
    growth: &[f64; JOINTS],
) -> ([Place; JOINTS], Rigid) {
    let nothing = Place {
        before: Matrix3::identity(),
        lean_y: Vector3::y(),
        axis: Vector3::z(),
        origin: Vector3::zeros(),
        behind: Rigid::identity(),
        reach: Vector3::zeros(),
        prismatic: true,
    };
    let mut out = [nothing; JOINTS];
    let mut behind = Rigid::identity();
    let given = links.iter().zip(values).zip(growth);
    for (((link, value), growth), out) in given.zip(&mut out).take(count) {
        *out = link.place(&behind, *value, *growth);
        behind = out.behind;
    }
    (out, behind)
}
