//! Where the effects of a robot stand, link by link, and so which of them each link can compute.

use super::effects::places;

places! { OfJoints: joint_offset joint_scale joint_slip encoder_cyclic encoder_second encoder_eccentricity backlash camera_delay reading_delay }
places! { OfBody: thermal_growth thermal_shift drift slip }
places! { OfPose: sensor_pose sensor_slip sensor_drift }
places! { OfCartesian: beam_alignment sensor_linearity }
places! { OfCamera: focal_length principal_point lens_distortion }
places! { OfAngles: datum }
places! { OfTracker: sensor_scale sensor_linearity }
places! { OfBar: centres bar_zero }
places! { OfPlane: planes }

/// Where all effects of a robot stand, by the file that computes them; `Own` are those of its mechanism.
#[derive(Clone, Copy, Debug)]
pub struct Places<Own> {
    pub(crate) structure: Own,
    pub(crate) joints: OfJoints,
    pub(crate) body: OfBody,
    pub(crate) pose: OfPose,
    pub(crate) cartesian: OfCartesian,
    pub(crate) camera: OfCamera,
    pub(crate) angles: OfAngles,
    pub(crate) tracker: OfTracker,
    pub(crate) bar: OfBar,
    pub(crate) plane: OfPlane,
}

impl<Own: Copy> Places<Own> {
    /// None but what the mechanism has.
    #[must_use]
    pub(crate) const fn none(structure: Own) -> Self {
        Self {
            structure,
            joints: OfJoints::NONE,
            body: OfBody::NONE,
            pose: OfPose::NONE,
            cartesian: OfCartesian::NONE,
            camera: OfCamera::NONE,
            angles: OfAngles::NONE,
            tracker: OfTracker::NONE,
            bar: OfBar::NONE,
            plane: OfPlane::NONE,
        }
    }
}
