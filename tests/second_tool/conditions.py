"""The conditions of the table of honesty, by name."""

from __future__ import annotations

from dataclasses import replace

from . import faults
from .rod import Rod
from .world import World

_SMALL = World(rod=Rod(exact=False))
_EXACT = World(pivot_rad=0.06)
_FAULTY_SINCE_S = 20.0


def _late(ms: int, *, stamped: bool) -> World:
    return replace(_EXACT, fibre_delay_s=1e-3 * ms, stamped=stamped)


#: The depth is there, and stands in the table of coverage. ``late_*`` say when their wavelengths were taken,
#: ``unsaid_*`` do not: a registration has to find it.
CONDITIONS: dict[str, World] = {
    "matched": _SMALL,
    "pivot": replace(_SMALL, pivot_rad=0.12),
    "gains": replace(_SMALL, gain_error=0.003, reference_error_nm=2e-4),
    "exact_rod": World(),
    "exact_rod_pivot": _EXACT,
    **{f"late_{ms}": _late(ms, stamped=True) for ms in (20, 50, 100, 200, 300)},
    **{f"unsaid_{ms}": _late(ms, stamped=False) for ms in (20, 50, 100, 200)},
    "slow": replace(_EXACT, fibre_hz=20.0, fibre_delay_s=0.05),
    "warm": replace(_EXACT, temperature_c=5.0, warmth_unlike=0.02),
    "eye": replace(_EXACT, eye_mm_s=1.0),
    "all": replace(
        _EXACT, pivot_rad=0.12, gain_error=0.003, reference_error_nm=2e-4, fibre_delay_s=0.05, temperature_c=5.0,
        warmth_unlike=0.02, eye_mm_s=0.2,
    ),
}  # fmt: skip

#: What an interrogator does from the 20th second on, or all the time.
FAULTS: dict[str, World] = {
    name: replace(_EXACT, faults=(fault,))
    for name, fault in {
        "stuck_I": faults.stuck(0, _FAULTY_SINCE_S),
        "stuck_II": faults.stuck(4, _FAULTY_SINCE_S),
        "stuck_III": faults.stuck(7, _FAULTY_SINCE_S),
        "dead_I": faults.dead(1, _FAULTY_SINCE_S),
        "dead_II": faults.dead(3, _FAULTY_SINCE_S),
        "dead_III": faults.dead(8, _FAULTY_SINCE_S),
        "dead_zero": faults.dead(2, _FAULTY_SINCE_S, reads=0.0),
        "swapped_I": faults.swapped(0, 1, _FAULTY_SINCE_S),
        "swapped_II": faults.swapped(3, 5, _FAULTY_SINCE_S),
        "swapped_sections": faults.swapped(2, 3, _FAULTY_SINCE_S),
        "saturated": faults.saturated(0, 1531.0, 0.15),
        "drifting": faults.drifting(4, _FAULTY_SINCE_S, 1e-3),
        "jump": faults.jumps(5, _FAULTY_SINCE_S, 0.4, _FAULTY_SINCE_S + 10.0),
        "spikes": faults.spikes(1e-3, 0.5),
        "pm": faults.in_unit(1e3),
        "m": faults.in_unit(1e-9),
    }.items()
}
