"""sherkit finds the physics that a robot's model is missing."""

from ._core import __version__
from .calibrate import Experiment, Result, calibrate
from .calibration import Calibration
from .correction import Correction, choose_correction, fit_grid, fit_polynomial, paper_protocol
from .diagnosis import Diagnosis, diagnose, play, sentence
from .effects import CATALOGUE, Effect, effect
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
from .measurements import (
    Measurements,
    MeasurementStream,
    from_frame,
    read_measurements,
    stream_measurements,
)
from .model import DeltaModel
from .parameters import Parameter
from .poses import grid, paper_local, paper_whole
from .readings import Model, ModelFit, Readings, fit_model
from .robots import Delta, load_robot, save_robot
from .simulation import VirtualDelta
from .study import Step, Study

__all__ = [
    "CATALOGUE",
    "Calibration",
    "CalibrationError",
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
    "Readings",
    "Result",
    "RobotError",
    "ShapeError",
    "SherkitError",
    "SherkitWarning",
    "Singular",
    "Step",
    "Study",
    "VirtualDelta",
    "__version__",
    "calibrate",
    "choose_correction",
    "diagnose",
    "effect",
    "fit_grid",
    "fit_model",
    "fit_polynomial",
    "from_frame",
    "grid",
    "identify",
    "identify_stream",
    "import_klipper",
    "load_robot",
    "paper_local",
    "paper_protocol",
    "paper_whole",
    "play",
    "read_measurements",
    "save_robot",
    "sentence",
    "stream_measurements",
]
