//! The frame in which a robot's places are counted.

use crate::result::{SHERKIT_INVALID, answer, sherkit_result};
use crate::storage::{Opaque, get_mut};
use sherkit_core::chain::Frame;

/// One of the SHERKIT_FRAME codes: where the coordinates of a place are counted from.
pub type sherkit_frame = u32;

/// The base of the robot, as its drawing and its controller have it: where the robot is. Nothing of the instrument counts.
pub const SHERKIT_FRAME_BASE: u32 = 0;
/// The instrument that measured the robot: what it reads, errors and all, from where it stood at last.
pub const SHERKIT_FRAME_SENSOR: u32 = 1;

/// A calibrated robot whose places can be counted from either.
pub trait Framed: Opaque {
    /// The same robot with places in a frame.
    fn in_frame(robot: &Self::Value, frame: Frame) -> Self::Value;
}

/// Chooses the frame of a robot's places.
///
/// # Safety
/// The pointer is null or valid.
pub unsafe fn use_frame<T: Framed>(robot: *mut T, frame: sherkit_frame) -> sherkit_result {
    let run = || {
        // SAFETY: the caller's word.
        let robot = unsafe { get_mut(robot)? };
        let frame = match frame {
            SHERKIT_FRAME_BASE => Frame::Base,
            SHERKIT_FRAME_SENSOR => Frame::Sensor,
            _ => return Err(SHERKIT_INVALID),
        };
        *robot = T::in_frame(robot, frame);
        Ok(())
    };
    answer(run())
}
