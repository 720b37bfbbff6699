"""A diagnosis in words and numbers alone: one line of a table over many runs."""

from __future__ import annotations

from dataclasses import dataclass

from ..base.figures import in_names


@dataclass(frozen=True, kw_only=True)
class Summary:
    """What a diagnosis says of a run, without its rows.

    ``before`` and ``after`` are errors (RMS of rows held out, in 3-D for what is read in space) in ``unit`` without
    and with the ``effects`` that were found missing; ``noise`` is counted as they are, by ``noise_origin``.
    ``p_missing`` is that of the one test over all effects and shapes before anything is added, ``p_lack_of_fit`` that
    of poses against their repeats with what was found in the model, None where too few were repeated; ``p_confirmed``
    the largest with which an effect earns its place on rows held out, None where none is named.
    """

    rows: int = 0
    verdict: str = ""
    effects: tuple[str, ...] = ()
    not_needed: tuple[str, ...] = ()
    unit: str = ""
    before: float | None = None
    after: float | None = None
    noise: float | None = None
    noise_origin: str = ""
    p_missing: float | None = None
    p_lack_of_fit: float | None = None
    p_confirmed: float | None = None
    outliers: int = 0

    def row(self) -> dict[str, str | int | float | None]:
        """One flat dict with the unit in each name (``after_um`` for µm), names of effects in one text, and ``ratio``:
        the error after over that before."""
        end = f"_{in_names(self.unit)}"
        return {
            "rows": self.rows,
            "verdict": self.verdict,
            "effects": ", ".join(self.effects),
            "not_needed": ", ".join(self.not_needed),
            f"before{end}": self.before,
            f"after{end}": self.after,
            "ratio": self.after / self.before if self.after is not None and self.before else None,
            f"noise{end}": self.noise,
            "noise_origin": self.noise_origin,
            "p_missing": self.p_missing,
            "p_lack_of_fit": self.p_lack_of_fit,
            "p_confirmed": self.p_confirmed,
            "outliers": self.outliers,
        }
