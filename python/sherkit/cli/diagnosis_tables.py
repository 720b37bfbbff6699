"""A diagnosis for people: the five questions, in their order."""

from __future__ import annotations

from rich.markup import escape
from rich.table import Table

from ..diagnosis import Diagnosis, indistinguishable, largest, sentence
from ..diagnosis.next_poses import SEPARATION
from ..names import listed
from .output import out, table

_ORIGIN = {
    "declared": "as declared in the file",
    "repeats": "from repeats of poses",
    "unknown": "unknown; this is what the model leaves",
}
_COLOUR = {
    "adequate": "green",
    "explained": "green",
    "partly explained": "yellow",
    "unexplained": "red",
    "undecided": "yellow",
}
_MOST = 8


def _short(d: Diagnosis, value: float) -> str:
    """A number in the unit of a diagnosis: a tenth of a micrometre is enough, of a pixel it is not."""
    return f"{value:.1f}" if d.unit == "µm" else f"{value:.3g}"


def _long(d: Diagnosis, value: float) -> str:
    return f"{value:.2f}" if d.unit == "µm" else f"{value:.4g}"


def _with_unit(column: str) -> str:
    name, _, unit = column.rpartition("_")
    return f"{name}, {unit}"


def _p(value: float) -> str:
    return "< 1e-16" if value < 1e-16 else f"{value:.2g}"


def diagnosis(d: Diagnosis) -> None:
    """Everything a diagnosis found."""
    noise = ", ".join(f"{axis} {_short(d, value)}" for axis, value in d.noise.items())
    out.print(f"[bold]1. Is anything missing?[/]  noise {noise} {d.unit} ({_ORIGIN[d.noise_origin]})")
    if d.correlation_in_time:
        out.print(
            f"   the noise is correlated in time, {d.correlation_in_time:.2f} from row to row; taken into account"
        )
    missing = "something is" if d.p_missing <= d.level else "nothing significant"
    out.print(f"   {missing}: familywise p = {d.p_missing:.4g} over all effects and shapes")
    for note in d.notes:
        out.print(f"   {escape(note)}")
    if d.smallest_found:
        out.print(_power(d))
    out.print("\n[bold]2. Where?[/]")
    out.print(_where(d))
    out.print("[bold]3. Which effect?[/]")
    out.print(_candidates(d))
    out.print("\n[bold]4. What can these data not tell apart?[/]")
    if not d.indistinguishable and not d.confounded_with and not d.untestable:
        out.print("   nothing of what was tried")
    for tie in d.indistinguishable:
        out.print(f"   [bold]{' or '.join(tie)}[/]: these poses cannot tell")
    for name, parameters in d.confounded_with.items():
        out.print(f"   {name}, if there is any, hides almost entirely in {listed(parameters)}")
    for name, reason in d.untestable.items():
        out.print(f"   {escape(f'{name} could not be tried: {reason}')}")
    out.print("\n[bold]5. What next?[/]")
    for line in _next(d):
        out.print(f"   {line}")
    if d.next_poses:
        out.print(_poses(d))
    # praise has no colour where nobody knows how much of the rest is noise
    colour = _COLOUR[d.verdict] if d.noise_origin != "unknown" or d.verdict not in ("adequate", "explained") else "cyan"
    out.print(f"\n[bold]Verdict:[/] [bold {colour}]{escape(d.headline)}[/]")
    out.print(_claims(d))
    out.print(falling(d))


def _claims(d: Diagnosis) -> Table:
    """What the verdict rests on."""
    made = table("What the verdict rests on", "check", "", "result", "p", "rows")
    for check in d.checks:
        word = {True: "yes", False: "[bold red]no[/]", None: "?"}[check.holds]
        p = "" if check.p is None else _p(check.p)
        made.add_row(escape(check.tested), word, escape(check.result), p, escape(check.rows))
    return made


def falling(d: Diagnosis) -> Table:
    """The error on poses held out, step by step."""
    made = table("Error on poses held out", "model", f"{d.unit} RMS")
    for s in d.steps:
        made.add_row("as it came" if s.effect is None else f"+ {s.effect}", _long(d, s.held_out_rms))
    noise = (sum(v**2 for v in d.noise.values()) / len(d.noise)) ** 0.5
    made.add_row("noise", _long(d, noise), style="dim")
    return made


def _where(d: Diagnosis) -> Table:
    made = table("", "against", "p", f"{d.unit} RMS from its lowest to its highest sixth")
    for line in d.where[:_MOST]:
        made.add_row(line.variable, _p(line.p_value), "  ".join(_short(d, v) for v in line.rms))
    made.caption = f"correlation with the nearest neighbour in space: {d.neighbour_correlation:.2f}"
    return made


def _candidates(d: Diagnosis) -> Table:
    made = table("", "effect", "link", f"held out {d.unit}", "p", "size", "largest parameter, or what is known")
    for c in d.candidates:
        value = largest(d, c)
        named = c.effect in d.effects
        mark = "plausible" if c.plausible else "implausible"
        made.add_row(
            f"[bold]{escape(c.effect)}[/]" if named else escape(c.effect),
            c.link, _long(d, c.held_out_rms), _p(c.p_value), mark, value,
        )  # fmt: skip
    return made


def _power(d: Diagnosis) -> Table:
    made = table(
        "Smallest effects that would have been found (80 % power)",
        "effect",
        "× plausible size",
        f"leaves {d.unit} RMS",
    )
    for name, (size, rms) in d.smallest_found.items():
        made.add_row(escape(name), f"{size:.2g}" if size < 1e6 else "never", _long(d, rms) if rms < 1e6 else "")
    return made


def _poses(d: Diagnosis) -> Table:
    axes = [name for name in d.next_poses[0] if name != SEPARATION]
    made = table("Poses to measure next, in this order", "", *map(_with_unit, axes), "separation with it, σ")
    for k, pose in enumerate(d.next_poses, start=1):
        made.add_row(str(k), *(f"{pose[a]:.6g}" for a in axes), f"{pose[SEPARATION]:.1f}")
    return made


def _next(d: Diagnosis) -> list[str]:
    advice = [escape(d.advice)] if d.advice else []
    if d.indistinguishable and d.next_poses:
        poses = "measure the poses below, some time after this run, and diagnose both: sherkit diagnose ROBOT RUN MORE"
        return [*advice, poses]
    if d.indistinguishable:
        return advice or ["which poses could be reached is not known of this machine, so none are proposed"]
    if d.verdict == "explained":
        named = " ".join(f"--effect {e}" for e in d.effects)
        without = " --without-outliers" if len(d.outliers) else ""
        return [f"add it: sherkit calibrate ROBOT RUN {named}{without} -o calibrated.toml"]
    if d.signature is not None:
        return [
            escape(sentence(d.signature)),
            *([escape(told)] if (told := indistinguishable(d.signature)) else []),
            "write a template of an effect with this shape: sherkit diagnose … --template my_effects.py",
        ]
    if d.verdict != "adequate":
        return [escape(check.fails) for check in d.checks if check.decisive and check.holds is False]
    if d.not_needed:
        return [f"take {' and '.join(d.not_needed)} out of the model: the error on rows held out is no larger without"]
    if d.noise_origin == "unknown":
        return ["repeat some poses, or add sigma columns: only then can it be said whether the model is good enough"]
    return ["nothing; go on with the model as it is"]
