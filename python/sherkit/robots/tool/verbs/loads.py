"""What known loads say of a tool, on the screen and for programs."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from ....cli import output
from ..calibration import ToolCalibration


def calibration_json(result: ToolCalibration) -> dict[str, Any]:
    """What the loads say, without the tool."""
    return {
        "loads": result.loaded,
        "unloaded": result.unloaded,
        "rms_mn_mm": result.rms_mn_mm.tolist(),
        "read_as": asdict(result.convention),
        "chi2_more": [{**asdict(c), "chi2": value} for c, value in result.chi2.items()],
        "scatter": asdict(result.scatter),
        "gains_std": result.gains_std.tolist(),
        "distances_mm": result.distances_mm.tolist(),
        "zero_mm": result.zero_mm,
        "slope_mn_mm2": result.slope_mn_mm2,
        "stiffness_mn_mm2": result.stiffness_mn_mm2,
        "length_mm": result.length_mm,
        "noticed": list(result.lack_of_fit),
    }


def print_calibration(result: ToolCalibration) -> None:
    """What the loads say."""
    table = output.table(
        "Gratings", "", "fibre 1", "fibre 2", "fibre 3", "left, mN mm",
        note=f"{result.loaded} loads, {result.unloaded} rows without; noise of a wavelength "
        f"{result.tool.noise_nm:.2g} nm",
    )  # fmt: skip
    for s, section in enumerate(("I", "II")):
        for a, axis in enumerate("xy"):
            cells = (
                f"{k:.1f} ± {std:.1g}" for k, std in zip(result.tool.gains[s][a], result.gains_std[s, a], strict=True)
            )
            table.add_row(f"K_{section} {axis}, mN mm/nm", *cells, f"{result.rms_mn_mm[s]:.2f}" if a == 0 else "")
    output.out.print(table)
    output.say(f"   {result.read_as}")
    scatter = result.scatter
    output.say(
        f"   rows scatter by {scatter.load_mn:.2g} mN of the cell, friction of {scatter.friction:.2g}, "
        f"{1000 * scatter.gauge_mm:.2g} µm of the gauge and {1000 * scatter.place_mm:.2g} µm of the places; the bench "
        f"counts {result.zero_mm[0]:+.2f} ± {result.zero_mm[1]:.2f} mm too deep"
    )
    if result.slope_mn_mm2 and result.stiffness_mn_mm2 and result.length_mm:
        shaft = output.table("Shaft", "", "value", "± std")
        shaft.add_row("EI by the paper's slope, mN mm²", *(f"{v:.4g}" for v in result.slope_mn_mm2))
        shaft.add_row("EI with the length, mN mm²", *(f"{v:.4g}" for v in result.stiffness_mn_mm2))
        for k, section in enumerate(("I", "II")):
            shaft.add_row(f"tip to section {section}, mm", *(f"{v:.4g}" for v in result.distances_mm[:, k]))
        shaft.add_row("free length h, mm", *(f"{v:.4g}" for v in result.length_mm))
        output.out.print(shaft)
    else:
        output.say("no deflections (deflection_mm): stiffness and length stay as they are")
