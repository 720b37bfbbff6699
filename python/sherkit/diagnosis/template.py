"""A user effect filled in from a signature, ready to run: the description of what is in no catalogue, as code."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ..measurements.columns import JOINTS, POSITION

_HEAD = '''"""Written by `sherkit diagnose`: {sentence}

Rename it after the cause once you know it; then `sherkit diagnose robot.toml run.csv --effects {file}`.
"""

import numpy as np
import sherkit as sk
'''


def sentence(signature: Mapping[str, Any]) -> str:
    """A signature in words."""
    what = " and ".join(signature["depends_on"])
    axes = ", ".join(signature["axis"])
    shape = signature["shape"]
    where = f"the error of joint {signature['joint']}" if signature.get("joint") else f"the error in {axes}"
    share = f"{100 * signature['share_explained']:.0f} % of what is left"
    how = {
        "smooth": f"varies smoothly (order {signature['order']}) with {what}",
        "periodic": f"repeats with {what}, period {signature['period'] or 0.0:.3g}",
        "step": f"steps at {what} = {signature.get('at') or 0.0:.0f}",
        "hysteretic": f"depends on the way {what} came there (width {signature.get('at') or 0.0:g} mm)",
        "interaction": f"depends on {what} together",
    }[shape]
    return f"{where} {how} ({share})."


def template(signature: Mapping[str, Any], name: str = "unknown_effect", file: str = "my_effects.py") -> str:
    """Python source of an effect that takes this shape. It runs as it is with ``--effects``."""
    joint = signature.get("joint")
    names, terms = _terms(signature)
    if joint:
        at, targets = "joints", [JOINTS.index(joint)]
    else:
        at, targets = "body", [POSITION.index(f"{a}_mm") for a in signature["axis"]]
    labels = [f"{n}_{'q' + str(t + 1) if joint else 'xyz'[t]}" for t in targets for n in names]
    parameters = ", ".join(f'"{label}": ("mm", 0.05)' for label in labels)
    lines = [_HEAD.format(sentence=sentence(signature), file=file), ""]
    needs = [n for n in signature["depends_on"] if n not in (*JOINTS, *POSITION)]
    needed = f", needs=({', '.join(repr(n) for n in needs)},)" if needs else ""
    lines += [f'@sk.effect(at="{at}", parameters={{{parameters}}}{needed})', f"def {name}(rows, p):"]
    lines += [f'    """{sentence(signature)}"""', *[f"    {line}" for line in _variables(signature)]]
    lines.append("    out = np.zeros((len(rows), 3))")
    for target in targets:
        suffix = f"q{target + 1}" if joint else "xyz"[target]
        total = " + ".join(f"p.{n}_{suffix} * ({t})" for n, t in zip(names, terms, strict=True))
        lines.append(f"    out[:, {target}] = {total}")
    return "\n".join([*lines, "    return out", ""])


def _column(name: str) -> str:
    if name in JOINTS:
        return f"rows.joints[:, {JOINTS.index(name)}]"
    if name in POSITION:
        return f"rows.position[:, {POSITION.index(name)}]"
    return "rows.time" if name == "time_s" else f"rows.{name}"


def _variables(signature: Mapping[str, Any]) -> list[str]:
    """Lines that bring each variable to about -1 … 1, with the numbers of this run written in."""
    out = []
    for letter, name in zip("uv", signature["depends_on"], strict=False):
        if signature["shape"] in ("periodic", "step", "hysteretic"):
            out.append(f"{letter} = {_column(name)}")
        else:
            middle, half = signature["ranges"][name]
            out.append(f"{letter} = ({_column(name)} - {middle!r}) / {half!r}")
    return out


def _terms(signature: Mapping[str, Any]) -> tuple[list[str], list[str]]:
    shape = signature["shape"]
    if shape == "smooth":
        orders = range(1, (signature["order"] or 1) + 1)
        return [f"order_{k}" for k in orders], [f"u**{k}" if k > 1 else "u" for k in orders]
    if shape == "periodic":
        wave = f"2 * np.pi * u / {signature['period']!r}"
        return ["sine", "cosine"], [f"np.sin({wave})", f"np.cos({wave})"]
    if shape == "step":
        return ["step"], [f"(u >= {signature['at']!r}).astype(float)"]
    if shape == "hysteretic":
        if not signature.get("at"):
            joint = JOINTS.index(signature["depends_on"][0])
            return ["width"], [f"0.5 * rows.direction[:, {joint}]"]
        return ["play"], [f"sk.play(u, {signature['at']!r}) - u"]
    if signature.get("joint"):
        return ["other", "other_squared", "product"], ["v", "v**2", "u * v"]
    return ["product"], ["u * v"]
