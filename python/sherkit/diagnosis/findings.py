"""What a diagnosis says, said once: a short list in the order in which a person asks. Terminal, ``print``, report, page
and JSON render it and word nothing themselves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..base.answer import FILES
from ..base.figures import in_names, listed, number, stated
from ..fit.constant_columns import unread
from ..fit.regions import TO_DO
from ..model.base import asked_for
from ..model.effect import Effect
from ..model.kinds import required_um
from ..model.sensor_pose import SLIP
from .held_out import LOWERS
from .next_poses import times_as_often
from .outliers import sentences
from .result import (  # fmt: skip
    ADD_IT,
    APART,
    AS_DRAWN,
    FEW,
    MISSING,
    NEXT,
    NOTHING,
    SINGLY,
    STANDS,
    WHERE,
    WHICH,
    WRONG,
    CandidateReport,
    Diagnosis,
    Finding,
)
from .sensor_pose import motion_of, pose_in_words
from .template import course, indistinguishable, sentence, settles

_AGAIN = f"sherkit diagnose {FILES} MORE"
_TEMPLATE = f"sherkit diagnose {FILES} --template my_effects.py"
_ORIGIN = {
    "declared": "as declared in the file",
    "repeats": "from repeats of poses",
    "unknown": "unknown; this is what the model leaves",
}


def findings_of(d: Diagnosis) -> tuple[Finding, ...]:
    """All that a diagnosis says, those that decide first."""
    return (*_wrong(d), *_missing(d), *_where(d), *_which(d), *_apart(d), *_next(d))


def largest(found: Diagnosis, one: CandidateReport) -> str:
    """What a line says of a candidate's size: what is really known of it, else the parameter that is farthest beyond
    its plausible size."""
    if one.effect in found.known:
        return found.known[one.effect].short
    worst = one.largest
    return f"{worst['name']} = {stated(worst['value'], worst['std'], worst['unit'], worst['size'])}"


def figure(d: Diagnosis, value: float) -> str:
    """A size in the unit of a diagnosis: a tenth of a micrometre is enough, of a pixel it is not."""
    return f"{value:.1f}" if d.unit == "µm" and not 0 < abs(value) < 0.1 else f"{value:.3g}"


def p_value(value: float) -> str:
    """A p as people read it."""
    return "< 1e-16" if value < 1e-16 else f"{value:.2g}"


def plausibility(one: CandidateReport) -> str:
    """How large a candidate is beside what is plausible."""
    times = f"{one.times:.2g} ×" if one.times < 1e4 else "> 10⁴ ×"
    return times if one.plausible else f"{times}, implausible"


def _with_p(value: float) -> str:
    told = p_value(value)
    return f"p {told}" if told.startswith("<") else f"p = {told}"


# -- what is wrong -------------------------------------------------------------------------------------------------


def _wrong(d: Diagnosis) -> Iterator[Finding]:
    """In sentences for a person who reads nothing else, and the verdict in one line."""
    first, last = number(d.steps[0].error.rms), number(d.steps[-1].error.rms)
    end = in_names(d.unit)
    came = {f"before_{end}": float(d.steps[0].error.rms)}
    if d.effects:
        causes = [effect for effect in d.fit.model.effects if effect.name in d.effects and effect.name != SLIP]
        physics = " ".join(f"{_most(d, e)} {_first_sentence(e.physics)}".strip() for e in causes)
        tied = "".join(
            f" These poses cannot tell {'it' if len(d.effects) == 1 else tie[0]} from {listed(tie[1:])}."
            for tie in d.indistinguishable[: None if len(d.effects) > 1 else 1]
        )
        whole = "" if d.verdict == "explained" else f" That is not all: {_rest(d)}."
        if d.too_few_poses:
            whole = " These poses are too few to say whether that is all."
        doubt = f" With a caveat: {d.caveat}." if d.caveat else ""
        lacks = f"The model lacks {listed(e.name for e in causes)}. {physics}".strip() if causes else ""
        yield Finding(WRONG, "cause", _with_motion(d, lacks) + tied, _motion_in_numbers(d))
        yield Finding(
            WRONG, "brings",
            f"With that in the model the error falls from {first} to {last} {d.unit} RMS {d.error.in_words}, 95 % "
            f"within {number(d.error.p95)}, on poses that the fit had not seen{_beside(d)}.{whole}{doubt}",
            came | {f"after_{end}": float(d.steps[-1].error.rms)},
            sure="" if d.confirmed is None else _with_p(d.confirmed),
            to_do=" ".join(_repairs(d, causes)),
        )  # fmt: skip
    else:
        off = f"off by {first} {d.unit} RMS {d.error.in_words}, 95 % within {number(d.error.p95)}{_beside(d)}"
        cause, to_do = _without_effect(d, off)
        yield Finding(WRONG, "cause", cause, came, to_do=to_do)
    if d.elsewhere is not None and (said := d.elsewhere.sentence(d.error)):
        sizes = {"error": d.elsewhere.error.rms, "drawing": d.elsewhere.drawing.rms}
        numbers = {f"{name}_{end}": float(value) for name, value in sizes.items()}
        yield Finding(WRONG, "elsewhere", said, numbers, to_do=TO_DO[d.fit.priors > 0.0])
    for said in unread(d.fit.data):
        yield Finding(WRONG, "unread", said)
    yield Finding(WRONG, "verdict", d.headline)


def _with_motion(d: Diagnosis, lacks: str) -> str:
    """What the model ``lacks``; what the instrument did stands before it, and is nothing that the robot's lacks."""
    motion = motion_of(d.fit) if SLIP in d.effects else None
    if motion is None:
        return lacks
    if lacks:
        return f"T{str(motion)[1:]}. Beside that, {lacks[:1].lower()}{lacks[1:]}"
    said = f"{motion}: it or its stand was knocked, or the robot moved on its floor."
    return f"The robot's model lacks nothing; {said}" if d.verdict == "explained" else f"T{said[1:]}"


def _motion_in_numbers(d: Diagnosis) -> dict[str, float]:
    motion = motion_of(d.fit) if SLIP in d.effects else None
    return {} if motion is None else motion.numbers


def _repairs(d: Diagnosis, causes: Sequence[Effect]) -> Iterator[str]:
    """What to do about the causes in the machine, and about the instrument."""
    if repair := " ".join(d.known[e.name].remedy if e.name in d.known else e.remedy for e in causes):
        yield f"Fix: {repair[:1].lower()}{repair[1:]}"
    yield from (f"Of the instrument: {e.remedy[:1].lower()}{e.remedy[1:]}" for e in d.fit.model.effects
                if e.name == SLIP and SLIP in d.effects)  # fmt: skip


def _beside(d: Diagnosis) -> str:
    """The noise, and what is needed, which is compared with what 95 of 100 poses stay within."""
    told = [f"the noise is {number(d.noise_size)}"] if d.noise_origin != "unknown" else []
    needed = required_um(getattr(d.fit.model, "robot", None))
    if needed and d.unit == "µm":
        told.append(f"the target {needed:g}")
    return f"; {', '.join(told)}" if told else ""


def _without_effect(d: Diagnosis, off: str) -> tuple[str, str]:
    """What is said where no effect is named, and what to do."""
    if mistake := _fails(d, "set_up"):
        return (
            f"Columns or the robot's file are not as they should be: {mistake}. Before that is put right nothing can "
            "be said of the machine.",
            "Put that right, and ask again.",
        )
    if d.verdict == "adequate" and (drawn := _fails(d, AS_DRAWN)):
        return (
            f"The model describes this machine: on poses that it was not fitted to it is {off}; but {drawn}",
            "Measure that at the machine: where it is so, write it into the robot's file; where it is not, something "
            "else is pressed into it, and the model holds among these poses alone.",
        )
    if d.verdict == "adequate":
        return (
            f"The model describes this machine: on poses that it was not fitted to it is {off}, and nothing that was "
            "tried would make that less.",
            "Use the calibration as it is; only better or more readings could tell more.",
        )
    if d.verdict == "undecided":
        return (
            f"The model is {off} on poses that it was not fitted to, and that may be because these are too few, or too "
            "close together: nothing shows beside what they leave open.",
            "Measure more poses, out to the rim of the workspace, and ask again.",
        )
    failing = [check for check in d.checks if check.forbids_praise]
    if [check.name for check in failing] == [STANDS]:
        stands, _, to_do = failing[0].fails.partition(": ")
        return (
            f"The sensor is not where the robot's file has it: {stands}. With it there the model is {off}.",
            f"{to_do[0].upper()}{to_do[1:]}. What turns or shifts the whole robot, as zeros that its joints share, "
            "looks the same.",
        )
    if [check.name for check in failing] == [SINGLY]:
        return (
            f"Rows that are wrong lie together: {failing[0].fails}. Without them the model is {off}.",
            "Look at the machine and the instrument there; what is said of all other rows holds without them.",
        )
    return (
        f"The model is {off}, and no effect that is known explains it: {_rest(d)}.",
        "What settles so is warmth, most often, or what creeps: measure when that is over, or record a temperature "
        "that goes with it."
        if d.signature is not None and settles(d.signature)
        else "Look at the pattern below, ask what could leave it, and add that as an effect of your own."
        if d.signature is not None
        else "Ask what differs from pose to pose and stands in no column: record it, or declare it as noise.",
    )


def _fails(d: Diagnosis, name: str) -> str:
    """What a check that does not hold says; empty where it holds, or was not made."""
    return next((check.fails for check in d.checks if check.name == name and check.holds is False), "")


def _rest(d: Diagnosis) -> str:
    """What is left, as far as shapes follow it."""
    if d.signature is not None:
        return f"what is left has a pattern: {course(d.signature)}"
    if _fails(d, "nothing_left"):
        # not all together: one of the catalogue may be in it that says too little by itself
        return "what is left is more than noise, but no effect and no shape that was tried is clear in it by itself"
    return "what is left follows no effect and no shape that was tried"


def _most(d: Diagnosis, effect: Effect) -> str:
    """What is known of an effect, or the largest of its numbers, in a sentence."""
    report = next((one for one in d.candidates if one.effect == effect.name), None)
    if report is None:
        return ""
    if effect.name in d.known:
        return f"As fitted: {d.known[effect.name].short}."
    worst = report.largest
    words = effect.in_words(worst["name"], worst["value"], worst["std"], worst["unit"])
    most = f", the most of {len(effect.parameters)} numbers" if len(effect.parameters) > 1 else ""
    if not words:
        return f"As fitted: {largest(d, report)}{most}."
    return f"{words[:1].upper()}{words[1:]} ({worst['name']}{most})."


def _first_sentence(text: str) -> str:
    return text.partition(". ")[0].rstrip(".") + "." if text else ""


# -- the five questions --------------------------------------------------------------------------------------------


def _missing(d: Diagnosis) -> Iterator[Finding]:
    noise = ", ".join(f"{axis} {figure(d, value)}" for axis, value in d.noise.items())
    end = in_names(d.unit)
    yield Finding(
        MISSING, "noise", f"noise {noise} {d.unit} ({_ORIGIN[d.noise_origin]})",
        {f"{axis}_{end}": value for axis, value in d.noise.items()},
    )  # fmt: skip
    if d.correlation_in_time:
        yield Finding(
            MISSING, "noise",
            f"the noise is correlated in time, {d.correlation_in_time:.2f} from row to row; taken into account",
            {"correlation": d.correlation_in_time},
        )  # fmt: skip
    yield Finding(
        MISSING, "missing", "something is" if d.p_missing <= d.level else "nothing significant",
        {"p_missing": d.p_missing}, sure=f"{_with_p(d.p_missing)} over all effects and shapes",
    )  # fmt: skip
    if len(d.outliers):
        accidents = all(check.holds is not False for check in d.checks if check.name in (FEW, SINGLY))
        yield Finding(
            MISSING, "left_out", f"{len(d.outliers)} of {len(d.fit.data)} rows, as gross errors",
            {"rows": len(d.fit.data)}, rows=tuple(d.fit.data.line[d.outliers].tolist()),
            to_do=" ".join(sentences(d.fit, d.outliers, accidents=accidents)),
        )  # fmt: skip
    if SLIP not in d.effects and (motion := motion_of(d.fit)) is not None:
        yield Finding(MISSING, "note", str(motion), motion.numbers)
    # what was not read stands beside the verdict
    said = unread(d.fit.data)
    for note in d.notes:
        if note not in said:
            yield Finding(MISSING, "note", note)


def _where(d: Diagnosis) -> Iterator[Finding]:
    clearest = min(d.where, key=lambda line: line.p_value, default=None)
    if clearest is not None and clearest.p_value <= d.level:
        ends = f"{figure(d, clearest.rms[0])} to {figure(d, clearest.rms[-1])} {d.unit}"
        yield Finding(
            WHERE, "where", f"most clearly against {clearest.variable}, {ends} from its lowest to its highest sextile",
            sure=_with_p(clearest.p_value),
        )  # fmt: skip


def _which(d: Diagnosis) -> Iterator[Finding]:
    end = in_names(d.unit)
    earned = {check.name.removeprefix("earns:"): check for check in d.checks if check.name.startswith("earns:")}
    for step in d.steps:
        check = earned.get(step.effect or "")
        yield Finding(
            WHICH, "step", step.state,
            {f"held_out_rms_{end}": float(step.error.rms)},
            sure="" if check is None or check.p is None else _with_p(check.p),
        )  # fmt: skip
    if d.signature is not None:
        told = f"{sentence(d.signature)} {indistinguishable(d.signature)}".rstrip()
        yield Finding(
            WHICH, "shape", told,
            to_do="" if _is_of_instrument(d) else f"write a template of an effect with this shape: {_TEMPLATE}",
        )  # fmt: skip


def _is_of_instrument(d: Diagnosis) -> bool:
    """Whether what is left differs in every other row: no robot does."""
    return d.signature is not None and d.signature["shape"] == "alternating"


def _apart(d: Diagnosis) -> Iterator[Finding]:
    for tie in d.indistinguishable:
        yield Finding(APART, "tie", f"{' or '.join(tie)}: these poses cannot tell")
    for name, parameters in d.confounded_with.items():
        yield Finding(APART, "confounded", f"{name}, if there is any, is confounded with {listed(parameters)}")
    if said := pose_in_words(d.base.unobserved, d.taken_by_pose):
        yield Finding(APART, "sensor_pose", said)
    untestable = asked_for(d.untestable, d.fit.data)
    for name, reason in untestable.items():
        yield Finding(APART, "untestable", f"{name} could not be tried: {reason}")
    if not (d.indistinguishable or d.confounded_with or untestable or said):
        yield Finding(APART, "nothing", "nothing of what was tried")


def _next(d: Diagnosis) -> Iterator[Finding]:
    for answer, command in _steps_next(d):
        yield Finding(NEXT, "next", answer, command=command)


def _steps_next(d: Diagnosis) -> Iterator[tuple[str, str]]:
    """What to do, and the command that does it where there is one."""
    if d.indistinguishable:
        if d.advice:
            yield d.advice, ""
        if d.next_poses:
            times = times_as_often(d.next_poses)
            often = f", each {times} times as often as those of the run" if times > 1 else ""
            yield f"measure the poses below{often}, some time after this run, and diagnose both", _AGAIN
        elif not d.advice:
            yield "which poses could be reached is not known of this machine, so none are proposed", ""
    elif d.too_few_poses:
        more = "measure more poses, out to the rim of the workspace: these are too few for the parameters of the model"
        yield more, ""
        yield from _failing(d)
    elif d.verdict == "explained":
        named = " ".join(f"--effect {e}" for e in d.effects)
        # a model of another sort may say itself where what is named is written to
        into = getattr(getattr(d.fit.model, "plain", None), "writes", None)
        yield ADD_IT, f"sherkit {into or f'calibrate {FILES} {named} -o calibrated.toml'}"
    elif _is_of_instrument(d):
        yield "take the mean of both (two faces, two heads), or record in a column which of them read each row", ""
    elif (own := _own_that_helps(d)) is not None:
        yield f"add {own}, then look again", f"sherkit diagnose {FILES} --effect {own}"
    elif d.signature is not None:
        yield "write a template of an effect with the shape of what is left", _TEMPLATE
        yield "or repeat the run in another order and at another temperature: what moves with them is named by them", ""
    elif d.verdict != "adequate":
        yield from _failing(d)
    elif d.not_needed:
        out = " and ".join(d.not_needed)
        yield f"take {out} out of the model: the error on rows held out is no larger without", ""
    elif d.noise_origin == "unknown":
        yield "repeat some poses, or add sigma columns: only then can it be said whether the model is good enough", ""
    elif _fails(d, AS_DRAWN):
        yield "measure at the machine what is so far from the robot's file, and correct the file or look again", ""
    else:
        yield NOTHING, ""


def _own_that_helps(d: Diagnosis) -> str | None:
    """The user's own effect that by itself lowers the error most, where one lowers it clearly."""
    known = {*d.base.model.known_effects, *d.base.model.held, *(e.name for e in d.fit.model.effects)}
    own = [one for one in d.candidates if one.effect not in known]
    best = min(own, key=lambda one: one.held_out_rms, default=None)
    return best.effect if best is not None and best.held_out_rms < (1.0 - LOWERS) * d.error.rms else None


def _failing(d: Diagnosis) -> Iterator[tuple[str, str]]:
    return ((check.fails, "") for check in d.checks if check.forbids_praise)
