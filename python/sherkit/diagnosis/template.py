"""A user effect filled in from a signature, ready to run: the description of what is in no catalogue, as code."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from keyword import iskeyword
from typing import Any

from ..base.figures import listed, on_one_line
from ..data.columns import Layout, bare, unit_in
from ..errors import EffectError

_HEAD = '''"""Written by `sherkit diagnose`: {sentence}

Rename it after the cause once you know it; then `sherkit diagnose robot.toml run.csv --effects {file}`.
"""

import numpy as np
import sherkit as sk
'''
#: Plausible sizes that a template starts from.
_SIZES = {"mm": 0.05, "rad": 1e-3, "px": 1.0}


def sentence(signature: Mapping[str, Any]) -> str:
    """A signature in words."""
    return f"{course(signature)} ({100 * signature['share_explained']:.0f} % of what is left)."


def course(shape: Mapping[str, Any]) -> str:
    """What follows what, in words."""
    return f"{_where(shape)} {_how(shape)}"


def indistinguishable(signature: Mapping[str, Any]) -> str:
    """The shapes that do as well, and what would tell them apart, in words; empty where there is none."""
    others = [f"that {course(one)}" for one in signature["indistinguishable"]]
    if not others:
        return ""
    return f"These rows say as well {'; or '.join(others)}. {signature['apart']}"


def what_parts(signature: Mapping[str, Any], joints: Collection[str], place: Collection[str]) -> str:
    """What to measure so that the leading shape of a signature is told from its ``indistinguishable``. ``joints`` and
    ``place`` are the variables that poses decide. Empty where there is no tie."""
    lead = set(signature["depends_on"])
    others = [set(one["depends_on"]) for one in signature["indistinguishable"]]
    poses = {*joints, *place}
    out = []

    def names(some: Collection[str]) -> str:
        return listed(sorted(some))

    differ = set().union(*(lead ^ other for other in others)) if others else set()
    courses = differ - poses
    if courses and differ & poses:
        out.append(f"the same poses in another, shuffled order, so that {names(courses)} no longer goes with the place")
    if len(courses) > 1:
        out.append(f"a longer run, or one at another time of day, in which {names(courses)} go different ways")
    if len(differ & poses) > 1 and not courses:
        out.append(f"poses off the lines of these, and farther out, where {names(differ & poses)} do not go together")
    if any(other == lead for other in others):
        more = "a longer run" if lead == {"time_s"} else f"more values of {names(lead)}, between these and beyond them"
        out.append(f"{more}, to tell one course from another")
    return f"What would tell them apart: {'; '.join(out)}." if out else ""


def _where(shape: Mapping[str, Any]) -> str:
    return f"the error of joint {shape['joint']}" if shape.get("joint") else f"the error in {', '.join(shape['axis'])}"


def _how(shape: Mapping[str, Any]) -> str:
    what, unit = " and ".join(shape["depends_on"]), unit_in(shape["depends_on"][0])
    # what is only told from the rest, as a course that no polynomial names, has no order
    order = f" (order {shape['order']})" if shape["order"] else ""
    return {
        "smooth": f"varies smoothly{order} with {what}",
        "periodic": f"repeats with {what}, period {shape['period'] or 0.0:.3g} {unit}".rstrip(),
        "step": f"steps at {what} = {shape.get('at') or 0.0:.0f}",
        "kink": f"has another slope from {what} = {shape.get('at') or 0.0:.4g} on",
        "bump": f"has a bump about {what} = {shape.get('at') or 0.0:.4g}, {shape.get('width') or 0.0:.2g} wide (sd)",
        "hysteretic": f"depends on the way {what} came there "
        + ("and on where it is" if order else f"(width {shape.get('at') or 0.0:g} {unit_in(shape['depends_on'][0])})"),
        "interaction": f"depends on {what} together",
        "alternating": "differs in every other row, as they were read (two faces, two heads, two sides?)",
    }[shape["shape"]]


def template(
    signature: Mapping[str, Any], layout: Layout, name: str = "unknown_effect", file: str = "my_effects.py"
) -> str:
    """Python source of an effect that takes this shape on rows of this ``layout``. It runs as it is with ``--effects``.

    An error of a joint is added to the joint, one of the point to the point, any other to the readings. Names of
    columns come from a file: in what is written they are literals and words in docstrings, never code. Raises
    :class:`~sherkit.errors.EffectError` for a ``name`` that no function can have.
    """
    if not name.isidentifier() or iskeyword(name):
        raise EffectError(f"'{name}' cannot be the name of an effect; expected a name as of a Python function")
    if signature["shape"] == "alternating":
        raise EffectError(
            "what differs in every other row is the instrument's: take the mean of both (two faces, two heads), or "
            "record in a column which of them read each row, and write an effect of that column"
        )
    joint = signature.get("joint")
    if not joint and not set(signature["axis"]) <= set(layout.names[: len(layout.coordinates)]):
        raise EffectError("what is left is one of distances, to which an effect of yours can add nothing of its own")
    names, terms = _terms(signature, layout)
    # the point is pushed where its coordinates are what is read
    columns, at = (
        (layout.joints, "joints") if joint else (layout.coordinates, "body" if _is_point(layout) else "sensor")
    )
    targets = [layout.joints.index(joint)] if joint else [layout.names.index(axis) for axis in signature["axis"]]
    if at == "body":
        # the axes along which it was seen are those of the instrument, which may stand turned against the base
        targets = list(range(len(columns)))
    parameters, called = [], {t: _suffix(k, columns, targets) for k, t in enumerate(targets)}
    for t in targets:
        unit = unit_in(columns[t]) or layout.unit
        parameters += [f"{_text(f'{n}_{called[t]}')}: ({_text(unit)}, {_SIZES.get(unit, 1.0)})" for n in names]
    said = _words(sentence(signature))
    lines = [_HEAD.format(sentence=said, file=_words(file)), ""]
    needs = [n for n in signature["depends_on"] if n not in (*layout.joints, *layout.coordinates)]
    needed = f", needs=({', '.join(_text(n) for n in needs)},)" if needs else ""
    lines += [f'@sk.effect(at="{at}", parameters={{{", ".join(parameters)}}}{needed})', f"def {name}(rows, p):"]
    lines += [f'    """{said}"""', *[f"    {line}" for line in _variables(signature, layout)]]
    lines.append(f"    out = np.zeros((len(rows), {len(columns)}))")
    for t in targets:
        total = " + ".join(f"p.{n}_{called[t]} * ({term})" for n, term in zip(names, terms, strict=True))
        lines.append(f"    out[:, {t}] = {total}")
    return "\n".join([*lines, "    return out", ""])


def _is_point(layout: Layout) -> bool:
    """Whether what is read are the three coordinates of a point."""
    return [unit_in(name) for name in layout.coordinates] == ["mm"] * 3


def _column(name: str, layout: Layout) -> str:
    if name in layout.joints:
        return f"rows.joints[:, {layout.joints.index(name)}]"
    if name in layout.coordinates:
        return f"rows.position[:, {layout.coordinates.index(name)}]"
    return f"rows[{_text(name)}]"


def _text(name: str) -> str:
    """A text as a literal, in ASCII: nothing in it ends the literal or the line."""
    return ascii(name)


def _words(text: str) -> str:
    """A text for a docstring: nothing in it ends the docstring or hides what follows."""
    return on_one_line(text).replace("\\", "\\\\").replace('"', '\\"')


def _suffix(k: int, columns: Sequence[str], targets: Sequence[int]) -> str:
    """What tells the parameters of the ``k``-th target from those of the others, as part of an identifier."""
    made = [re.sub(r"\W", "_", bare(columns[t]), flags=re.ASCII) for t in targets]
    return made[k] if made.count(made[k]) == 1 else f"{made[k]}_{k + 1}"


def _variables(signature: Mapping[str, Any], layout: Layout) -> list[str]:
    """Lines that bring each variable to about -1 … 1, with the numbers of this run written in."""
    out = []
    for letter, name in zip("uv", signature["depends_on"], strict=False):
        if signature["shape"] in ("periodic", "step", "kink", "bump", "hysteretic"):
            out.append(f"{letter} = {_column(name, layout)}")
        else:
            middle, half = signature["ranges"][name]
            out.append(f"{letter} = ({_column(name, layout)} - {float(middle)!r}) / {float(half)!r}")
    return out


def _terms(signature: Mapping[str, Any], layout: Layout) -> tuple[list[str], list[str]]:
    shape = signature["shape"]
    if shape == "smooth":
        orders = range(1, (signature["order"] or 1) + 1)
        return [f"order_{k}" for k in orders], [f"u**{k}" if k > 1 else "u" for k in orders]
    if shape == "periodic":
        wave = f"2 * np.pi * u / {float(signature['period'])!r}"
        return ["sine", "cosine"], [f"np.sin({wave})", f"np.cos({wave})"]
    if shape == "step":
        return ["step"], [f"(u >= {float(signature['at'])!r}).astype(float)"]
    if shape == "kink":
        half = float(signature["ranges"][signature["depends_on"][0]][1])
        return ["slope"], [f"np.maximum(u - {float(signature['at'])!r}, 0.0) / {half!r}"]
    if shape == "bump":
        at, width = float(signature["at"]), float(signature["width"])
        return ["height"], [f"np.exp(-0.5 * ((u - {at!r}) / {width!r}) ** 2)"]
    if shape == "hysteretic":
        if not signature.get("at"):
            came = f"0.5 * rows.direction[:, {layout.joints.index(signature['depends_on'][0])}]"
            middle, half = signature["ranges"][signature["depends_on"][0]]
            grows = signature["order"] is not None
            more = [f"{came} * (u - {float(middle)!r}) / {float(half)!r}"] if grows else []
            return ["width", "more"][: 1 + grows], [came, *more]
        return ["play"], [f"sk.diagnosis.play_operator(u, {float(signature['at'])!r}) - u"]
    if signature.get("joint"):
        return ["other", "other_squared", "product"], ["v", "v**2", "u * v"]
    return ["product"], ["u * v"]
