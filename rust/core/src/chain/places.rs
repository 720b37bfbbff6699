//! Where the effects of a robot stand, link by link.

use super::{angles, bar, body, camera, cartesian, joints, plane, tracker};

/// Where all effects of a robot stand, link by link; `Own` are those of its mechanism.
#[derive(Clone, Copy, Debug)]
pub struct Places<Own> {
    pub(crate) joints: joints::At,
    pub(crate) structure: Own,
    pub(crate) body: body::At,
    pub(crate) cartesian: cartesian::At,
    pub(crate) camera: camera::At,
    pub(crate) angles: angles::At,
    pub(crate) tracker: tracker::At,
    pub(crate) bar: bar::At,
    pub(crate) plane: plane::At,
}

impl<Own: Copy> Places<Own> {
    /// None but what the mechanism has.
    #[must_use]
    pub(crate) const fn none(structure: Own) -> Self {
        Self {
            joints: joints::At::NONE,
            structure,
            body: body::At::NONE,
            cartesian: cartesian::At::NONE,
            camera: camera::At::NONE,
            angles: angles::At::NONE,
            tracker: tracker::At::NONE,
            bar: bar::At::NONE,
            plane: plane::At::NONE,
        }
    }
}
