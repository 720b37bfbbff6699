"""What a verdict rests on: checks, each made on numbers that the same report shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

#: Checks of which the first line speaks though nothing is decided by them.
AS_DRAWN, APART, DIGITS, DECLARED = "as_drawn", "apart", "digits", "noise_as_declared"
#: The check that repeats differ by noise alone.
REPEATS = "repeats_are_noise"
#: The check that tests lack of fit.
POSES_AS_REPEATS = "poses_as_repeats"
#: The checks that compare rows held out with the noise, and with what few poses make of it.
SMALL, LOOSE = "as_small_as_noise", "poses_suffice"
#: The checks that the poses are no line, and that the fit came to rest; where these alone fail, or that the poses
#: suffice, nothing is decided.
PLACES, SETTLED = "poses_tell", "converged"
_UNDECIDED = {LOOSE, PLACES, SETTLED}
#: Checks without which the drawing is not judged.
_MOVES = {"set_up", "plausible", PLACES}
#: Reasons that the first line gives; the checks have all.
_MOST = 2


@dataclass(frozen=True)
class Check:
    """One statement and how its test came out.

    ``tested`` is the statement, ``rows`` on which rows, ``result`` what was found, both in words. ``holds`` is None
    where these rows cannot test it; ``p`` the p value where the test has one. A verdict of praise needs all that are
    ``decisive``; ``fails`` is then how the first line says that one does not hold.
    """

    name: str
    tested: str
    rows: str
    result: str
    holds: bool | None
    p: float | None = None
    decisive: bool = True
    fails: str = ""

    @property
    def forbids_praise(self) -> bool:
        """Whether it decides, and does not hold."""
        return self.decisive and self.holds is False

    def __str__(self) -> str:
        word = {True: "yes", False: "no", None: "cannot be told"}[self.holds]
        p = "" if self.p is None else f" (p = {self.p:.2g})"
        return f"{self.tested}: {word}, {self.result}{p}; tested on {self.rows}"

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "name": self.name, "tested": self.tested, "rows": self.rows, "result": self.result,
            "holds": self.holds, "p_value": self.p, "decisive": self.decisive,
        }  # fmt: skip


def verdict_of(checks: Sequence[Check], effects: Sequence[str]) -> str:
    """The verdict, from checks alone: of praise only where no decisive one fails, of blame only where another fails
    than that the poses are enough."""
    failing = {check.name for check in checks if check.forbids_praise}
    if not failing:
        return "explained" if effects else "adequate"
    if effects:
        return "partly explained"
    return "undecided" if failing <= _UNDECIDED else "unexplained"


def headline(checks: Sequence[Check], effects: Sequence[str], not_needed: Sequence[str], *, noise_known: bool) -> str:
    """The verdict in one line: never more praise than the noise allows, and why not where there is none."""
    verdict = verdict_of(checks, effects)
    failing = [check.fails for check in checks if check.forbids_praise and check.fails]
    named = ", ".join(effects)
    if verdict == "adequate":
        line = "adequate: no effect is missing" if noise_known else (
            "nothing with structure is missing; how much of the rest is noise is not known"
        )  # fmt: skip
    elif verdict == "explained":
        line = f"explained: {named}"
        if not noise_known:
            line += "; nothing with structure is left, how much of the rest is noise is not known"
    else:
        line = f"{verdict}: {named or ('no effect shows' if verdict == 'undecided' else 'no effect added')}"
        if failing:
            line += "; " + "; ".join(failing[:_MOST])
    # a wrong column, or an absurd number, moves the drawing as well
    wrong = {check.name for check in checks if check.holds is False}
    spoken = {APART, DIGITS, DECLARED} | ({AS_DRAWN} if not wrong & _MOVES else set())
    line += "".join(
        f"; but {check.fails}" for check in checks if check.name in wrong & spoken and check.fails not in line
    )
    if not_needed:
        verb = "is" if len(not_needed) == 1 else "are"
        line += f"; but {' and '.join(not_needed)}, in the model already, {verb} not needed"
    return line
