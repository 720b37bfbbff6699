"""sherkit finds the physics that a robot's model is missing."""

from ._core import __version__
from .calibrate import Experiment, Result, calibrate
from .calibration import Calibration
from .calibrations import load_calibration
from .camera_placement import camera_placement
from .correction import Correction, choose_correction, fit_grid, fit_polynomial, paper_protocol
from .diagnosis import Diagnosis, diagnose, play, sentence
from .effects import CATALOGUE, Effect, effect
from .effects.spherical import SPHERICAL_CATALOGUE
from .errors import (
    CalibrationError,
    EffectError,
    FitError,
    MeasurementError,
    NotConverged,
    NotFinite,
    OutOfReach,
    RobotError,
    ShapeError,
    SherkitError,
    SherkitWarning,
    Singular,
)
from .formats.klipper import import_klipper
from .identification import Fit, identify, identify_stream
from .joint_space import TaskError, identify_joints, task_error
from .measurements import (
    Measurements,
    MeasurementStream,
    from_frame,
    read_measurements,
    stream_measurements,
)
from .model import DeltaModel
from .parameters import Parameter
from .planning import Planning, planning_of
from .pose_design import PoseDesign, choose_poses
from .poses import grid, paper_local, paper_whole, sphere_patch
from .power_study import Sought, study_power
from .readings import Model, ModelFit, Readings, fit_model
from .remote_centre import RemoteCentre, remote_centre
from .robots import CameraView, Delta, Spherical, load_robot, save_robot
from .simulation import VirtualDelta
from .spherical_calibration import SphericalCalibration
from .spherical_model import SphericalModel
from .spherical_simulation import VirtualSpherical
from .straightness import straightness, straightness_by
from .study import Step, Study

__all__ = [
    "CATALOGUE",
    "SPHERICAL_CATALOGUE",
    "Calibration",
    "CalibrationError",
    "CameraView",
    "Correction",
    "Delta",
    "DeltaModel",
    "Diagnosis",
    "Effect",
    "EffectError",
    "Experiment",
    "Fit",
    "FitError",
    "MeasurementError",
    "MeasurementStream",
    "Measurements",
    "Model",
    "ModelFit",
    "NotConverged",
    "NotFinite",
    "OutOfReach",
    "Parameter",
    "Planning",
    "PoseDesign",
    "Readings",
    "RemoteCentre",
    "Result",
    "RobotError",
    "ShapeError",
    "SherkitError",
    "SherkitWarning",
    "Singular",
    "Sought",
    "Spherical",
    "SphericalCalibration",
    "SphericalModel",
    "Step",
    "Study",
    "TaskError",
    "VirtualDelta",
    "VirtualSpherical",
    "__version__",
    "calibrate",
    "camera_placement",
    "choose_correction",
    "choose_poses",
    "diagnose",
    "effect",
    "fit_grid",
    "fit_model",
    "fit_polynomial",
    "from_frame",
    "grid",
    "identify",
    "identify_joints",
    "identify_stream",
    "import_klipper",
    "load_calibration",
    "load_robot",
    "paper_local",
    "paper_protocol",
    "paper_whole",
    "planning_of",
    "play",
    "read_measurements",
    "remote_centre",
    "save_robot",
    "sentence",
    "sphere_patch",
    "straightness",
    "straightness_by",
    "stream_measurements",
    "study_power",
    "task_error",
]
