"""Speed of a serial arm: beside figaroh, which calibrates arms on pinocchio, and on runs of growing size."""

from __future__ import annotations

import importlib.util
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from timing import Bench

import sherkit as sk
from sherkit.model.kinds import model_of
from sherkit.robots.serial import KIND, Serial, VirtualSerial, postures
from sherkit.robots.serial.imported import import_urdf

NOISE_MM = 0.05
PLAIN = {"noise_um": 1e3 * NOISE_MM, "yield_mrad": 0.0, "play_mrad": 0.0, "ring_mrad": 0.0}
#: TIAGo's arm on its lift: one joint that slides and seven that turn.
TIP = "arm_tool_link"
POSES = 200
#: Rows of a run, and what its identification and its diagnosis may take.
SIZES = ((1_000, "20 ms", "2 s"), (10_000, "", "10 s"))


def run_of(arm: Serial, poses: int, **hidden: float) -> sk.Measurements:
    """A run of an arm of plausible errors before a tracker."""
    virtual = VirtualSerial.simulated(arm, 1, 1.0, {**PLAIN, **hidden})
    return virtual.measure(postures(arm, poses, 0.9, 1), seed=2)


def sizes(bench: Bench) -> None:
    """1,000 and 10,000 rows of a six-axis arm, 27 parameters."""
    for rows, identified, diagnosed in SIZES:
        data = run_of(KIND.example, rows, yield_mrad=0.5)
        work = f"of {rows:,} rows of a six-axis arm, {len(model_of(KIND.example).parameters)} values"
        fit = sk.identify(KIND.example, data)
        bench.compare(f"identification {work}", {"sherkit": lambda d=data: sk.identify(KIND.example, d)}, 5, identified)
        bench.compare(f"diagnosis {work}", {"sherkit": lambda f=fit: sk.diagnose(f)}, 3, diagnosed)


def beside_figaroh(bench: Bench) -> None:
    """TIAGo's arm: as many parameters as can be told apart, to the same cost.

    Of figaroh what its ``BaseCalibration`` runs once files are read and parameters chosen: ``calc_updated_fkm`` with
    those geometric parameters that its own ``select_identifiable_parameters`` keeps, under SciPy's Levenberg-Marquardt
    with differences. Both begin at the drawing.
    """
    for module in ("pinocchio", "figaroh"):
        if importlib.util.find_spec(module) is None:
            print(f"no arm beside figaroh: {module} is missing (pip install pin example-robot-data figaroh)")
            return
    import pinocchio as pin
    from figaroh.calibration import calibration_tools as tools
    from figaroh.calibration.parameter import BASE_TPL, EE_TPL, FULL_PARAMTPL

    folders = [Path(pin.__file__).parents[4] / "share", *(Path(p) for p in pin.__path__)]
    file = next(f for folder in folders for f in folder.glob("example-robot-data/robots/*/*/tiago.urdf"))
    arm = replace(import_urdf(file, None, TIP), target_mm=(30.0, -20.0, 80.0))
    data = run_of(arm, POSES)
    names = [name for name, _ in arm_joints(arm)]
    model = pin.buildModelFromUrdf(str(file))
    store, places = model.createData(), [model.getJointId(name) for name in names]
    q = np.tile(pin.neutral(model), (len(data), 1))
    q[:, [model.joints[k].idx_q for k in places]] = data.joints * [scale for _, scale in arm_joints(arm)]
    frames = [*BASE_TPL, *(f"{name}_1" for name in EE_TPL[:3])]
    config = {
        "calib_model": "full_params", "start_frame": "universe", "end_frame": TIP, "actJoint_idx": places,
        "NbMarkers": 1, "calibration_index": 3, "measurability": [True] * 3 + [False] * 3, "NbSample": len(data),
        "param_name": [*frames, *(f"{axis}_{name}" for name in names for axis in FULL_PARAMTPL)],
    }  # fmt: skip
    start = np.zeros(len(config["param_name"]))
    start[6:9] = 1e-3 * np.array(arm.target_mm)
    columns = tools.measurement_jacobian(model, store, start, q, config)
    kept, _ = tools.select_identifiable_parameters(columns, config["param_name"], frames)
    start = start[[config["param_name"].index(name) for name in kept]]
    config["param_name"] = kept
    read = 1e-3 * data.readings[:, :3].T.ravel()

    def figaroh() -> float:
        def residuals(values: np.ndarray) -> np.ndarray:
            return tools.calc_updated_fkm(model, store, values, q, config) - read

        return 2e6 * float(least_squares(residuals, start, method="lm", max_nfev=1000).cost)

    ours, theirs = float(np.nansum(sk.identify(arm, data).residuals ** 2)), figaroh()
    told = len(model_of(arm).parameters)
    print(f"sum of squares, mm²: sherkit {ours:.6f} of {told} values, figaroh {theirs:.6f} of {len(kept)}", flush=True)
    assert abs(ours - theirs) < 1e-3 * ours, (ours, theirs)
    work = f"TIAGo's arm, {len(data)} poses: its {told} values"
    runs = {"sherkit": lambda: sk.identify(arm, data), f"figaroh, {len(kept)} values, no cause of the rest": figaroh}
    bench.compare(work, runs, 5)
    bench.compare("and what is missing", {"sherkit": lambda: sk.diagnose(arm, data)}, 3)


def arm_joints(arm: Serial) -> list[tuple[str, float]]:
    """Its joints in the file, and metres or radians by unit of its own."""
    return [(joint.name, 1e-3 if joint.slides else 1.0) for joint in arm.joints]


def arms(bench: Bench) -> None:
    """Both."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        beside_figaroh(bench)
        sizes(bench)
