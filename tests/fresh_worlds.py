"""Worlds that nobody has seen, counted: delta, sphere, arm and planar machine with nothing, one effect, two effects,
physics of no catalogue, and one of each hidden, wherever their instrument stands.

PYTHONPATH=python python tests/fresh_worlds.py [--suite delta] [--worlds 40] [--first 100000] [--show] [--out FILE]
PYTHONPATH=python python tests/fresh_worlds.py --ask delta/100003/backlash@2+bumps@5
"""

from __future__ import annotations

import argparse
import json
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import sherkit as sk
from consistency import PRAISED, contradictions, named
from fresh_scenes import BY_NAME, KNOWN, MORE_KINDS, SUITES, Fresh, read, written
from second_machines import apart
from sensor_poses import SEEN, blames_nobody, is_told
from sherkit.base.workers import processes, run_tasks
from standing_worlds import WORLDS

Record = dict[str, Any]

RATIOS = (2.0, 5.0)
#: Noises by which a reading that was praised may be off at other poses.
PRAISE = 1.25
#: An innocent takes less than this part of what is left without it: idle.
IDLE = 0.1
#: An effect of which geometry and instrument leave less than this part is counted apart: it is of no machine's size.
LEAST_SHOWN = 0.01
#: Effects that are a part of a kind's truth: what snaps to another place slips, robot or instrument; what grows late
#: about a point far off shifts late.
PARTS = {kind: {"slip", "sensor_slip"} for kind in ("telegraph", "bump_back")} | {"lagged_growth": {"thermal_shift"}}
WORKERS = 2


def asks_of(suite: str, number: int) -> dict[str, dict[str, float]]:
    """What is hidden in a world in turn, by what is counted."""
    world: Any = WORLDS[SUITES[suite]](number)
    place = list(SUITES).index(suite)
    # each suite begins elsewhere on its list
    rng, names, number = np.random.default_rng([number, 544, place]), world.askable, number + 5 * place
    known, more = KNOWN[suite], MORE_KINDS
    out: dict[str, dict[str, float]] = {"nothing": {}}
    if names:
        one = names[number % len(names)]
        out |= {f"one at {ratio:g}": {one: ratio} for ratio in RATIOS}
    if len(names) > 1:
        out["two at 2"] = dict.fromkeys(rng.choice(names, 2, replace=False).tolist(), RATIOS[0])
    out["unknown"] = {known[number % len(known)].__name__: RATIOS[number // len(WORLDS) % 2]}
    out["new unknown"] = {more[number % len(more)].__name__: RATIOS[(number // len(more)) % 2]}
    if names:
        kind = (*known, *more)[int(rng.integers(len(known) + len(more)))].__name__
        out["one and unknown"] = {str(rng.choice(names)): rng.choice(RATIOS), kind: rng.choice(RATIOS)}
    return out


def _absurd(world: Fresh) -> bool:
    """Whether geometry and instrument take all but a hundredth of an effect, so that what is left of it asks for rods
    that differ by millimetres."""
    exact = world.standing.exact
    names, plain = world.standing.readings, exact({})
    for name, ratio in world.effects.items():
        changed = exact({name: ratio})
        moved = np.sqrt(np.mean([np.square(changed[one] - plain[one]) for one in names]))
        if moved * LEAST_SHOWN > ratio * world.noise:
            return True
    return False


def answered(suite: str, number: int, what: str, hidden: dict[str, float]) -> Record:
    """One answer, and what became of it: ``right``, ``lie``, ``innocents`` with those that are ``idle``, the true names
    that were ``kept``; ``noises`` by which a praised fit is off at other poses."""
    out: Record = {"ask": f"{suite}/{number}/{written(hidden)}", "suite": suite, "what": what}
    try:
        world = Fresh(suite, number, hidden)
        run = world.run()
    except (ValueError, RuntimeError) as why:
        return out | {"unmade": str(why)}
    began = time.process_time()
    try:
        d = sk.diagnose(world.robot, run)
    except Exception as why:  # a crash is an outcome as well
        return out | {"crash": repr(why)}
    out |= {"cpu_s": round(time.process_time() - began, 2), "verdict": d.verdict, "effects": list(d.effects)}
    out["ties"] = [list(tie) for tie in d.indistinguishable]
    out["shape"] = d.signature and [list(d.signature["depends_on"]), d.signature["shape"]]
    out["contradictions"] = contradictions(d)
    praised = d.verdict.split(",")[0] in PRAISED
    out["noises"] = round(world.error(d.fit), 3) if praised else None
    out["lie"] = praised and out["noises"] > PRAISE
    out["absurd"] = _absurd(world)
    truth = world.true_names
    meant = set().union(*truth.values(), *(PARTS.get(name, set()) for name in hidden))
    told = meant.union(*(tie for tie in d.indistinguishable if meant & set(tie)))
    out["innocents"] = [name for name in d.effects if name not in told]
    out["takes"] = [round(_takes(d, run, name), 3) for name in out["innocents"]]
    out["kept"] = [name for name, under in truth.items() if under & named(d)]
    if not hidden:
        out["right"] = blames_nobody(d)
    elif not world.kinds:
        one = len(truth) == 1
        out["right"] = is_told(d, *truth.values()) if one else len(out["kept"]) == len(truth)
        out["as_well"] = bool(world.as_well(d) < SEEN)
    return out


def _takes(d: Any, run: Any, name: str) -> float:
    """Which part of the squares that are left without it an effect takes, all else that was fitted being fitted again,
    in linear approximation about its absence: moments, lags and periods stay as they were found."""
    fit, rows = d.fit, run.taken
    its = np.array([p.name.startswith(f"{name}.") or name == f"free {p.name}" for p in fit.parameters])
    absent = np.where(its, 0.0, fit.values)
    left = (run.readings - fit.model.predict(run, absent))[rows]
    columns = fit.model.derivatives(run, absent)[rows][:, ~its]
    columns = columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    without = left - columns @ np.linalg.lstsq(columns, left, rcond=1e-10)[0]
    with_it = (run.readings - fit.model.predict(run, fit.values))[rows]
    return float(1.0 - np.sum(with_it**2) / np.sum(without**2))


def missed(one: Record) -> str | None:
    """Why an answer is listed; nothing where it is as it should be."""
    why = [name for name in ("unmade", "crash") if name in one]
    if why:
        return f"{why[0]}: {one[why[0]]}"
    if one["lie"]:
        why.append("LIE")
    if one["innocents"]:
        taken = zip(one["innocents"], one["takes"], strict=True)
        why.append("innocent " + ", ".join(f"{name} (takes {part:.2f})" for name, part in taken))
    if not one.get("right", True):
        why.append("not found" + (", as well by what is named" if one.get("as_well") else ""))
    if one["what"] == "one and unknown" and not one["kept"]:
        why.append("true name not kept")
    return "; ".join([*why, *(f"CONTRADICTION {one}" for one in one["contradictions"])]) or None


def in_words(one: Record) -> str:
    """A miss with its answer."""
    if "verdict" not in one:
        return f"{one['ask']}: {missed(one)}"
    off = "" if one["noises"] is None else f" off by {one['noises']:.2f} noises"
    said = f"{one['verdict']} {one['effects']} tied {one['ties']} shape {one['shape']}{off}, {one['cpu_s']} s"
    return f"{one['ask']}: {missed(one)} <- {said}"


def of_world(task: tuple[str, int]) -> list[Record]:
    """Every answer of a world."""
    suite, number = task
    with apart(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return [answered(suite, number, what, hidden) for what, hidden in asks_of(suite, number).items()]


def of_all(suites: Sequence[str], worlds: int, first: int, workers: int = WORKERS) -> Iterator[list[Record]]:
    """Every world, suites in turn, in the order in which they come."""
    todo = [(suite, first + k) for k in range(worlds) for suite in suites]
    if workers == 1:
        yield from map(of_world, todo)
        return
    with processes(workers) as pool:
        for outcome in run_tasks(of_world, todo, pool):
            if outcome.error is not None:
                print(f"{todo[outcome.number]}: {outcome.error!r}", flush=True)
            elif outcome.answer is not None:
                yield outcome.answer


def _is(*whats: str) -> Callable[[Record], bool]:
    return lambda one: one["what"] in whats and not one["absurd"]


_UNKNOWN = ("unknown", "new unknown")
_TRUE = ("one at 2", "one at 5", "two at 2")
#: What is counted: of which answers, and which of them.
COUNTED: dict[str, tuple[Callable[[Record], bool], Callable[[Record], bool]]] = {
    "nothing hidden: nobody blamed": (_is("nothing"), lambda one: one["right"]),
    "one effect at 2 x: named, tied or absorbed": (_is("one at 2"), lambda one: one["right"]),
    "one effect at 5 x: named, tied or absorbed": (_is("one at 5"), lambda one: one["right"]),
    "two effects at 2 x: both named, or nobody can tell": (_is("two at 2"), lambda one: one["right"] or one["as_well"]),
    "... a wrong name beside what is true": (_is(*_TRUE), lambda one: bool(one["innocents"])),
    "... lies": (_is("nothing", *_TRUE), lambda one: one["lie"]),
    "physics of no catalogue, known kinds: lies": (_is("unknown"), lambda one: one["lie"]),
    "... innocents": (_is("unknown"), lambda one: bool(one["innocents"])),
    "physics of no catalogue, new kinds: lies": (_is("new unknown"), lambda one: one["lie"]),
    "... innocents ": (_is("new unknown"), lambda one: bool(one["innocents"])),
    "both sorts of kinds: idle innocents": (_is(*_UNKNOWN), lambda one: any(part < IDLE for part in one["takes"])),
    "one effect and an unknown: lies": (_is("one and unknown"), lambda one: one["lie"]),
    "... true name kept": (_is("one and unknown"), lambda one: bool(one["kept"])),
    "... innocents  ": (_is("one and unknown"), lambda one: bool(one["innocents"])),
    "... idle innocents": (_is("one and unknown"), lambda one: any(part < IDLE for part in one["takes"])),
    "effects of no machine's size (apart): found": (
        lambda one: one["absurd"] and "right" in one, lambda one: one["right"] or one["as_well"],
    ),
    "any: contradicts itself": (lambda one: True, lambda one: bool(one["contradictions"])),
}  # fmt: skip


def table_of(done: Sequence[Record]) -> str:
    """Counts by suite, and the processor's time of a diagnosis."""
    suites = [suite for suite in SUITES if any(one["suite"] == suite for one in done)]
    some = {"all": list(done)} | {suite: [one for one in done if one["suite"] == suite] for suite in suites}
    lines = [f"{'':<52}" + "".join(f"{name:>12}" for name in some)]
    for what, (of, counts) in COUNTED.items():
        cells = []
        for every in some.values():
            asked = [counts(one) for one in every if "verdict" in one and of(one)]
            cells.append(f"{sum(asked)}/{len(asked)}" if asked else "-")
        lines.append(f"{what.rstrip():<52}" + "".join(f"{cell:>12}" for cell in cells))
    for name, told in (("crashes", "crash"), ("worlds that cannot be made", "unmade")):
        lines.append(f"{name:<52}" + "".join(f"{sum(told in one for one in every):>12}" for every in some.values()))
    for name, share in (("median", 0.5), ("95 %", 0.95), ("most", 1.0)):
        took = [[one["cpu_s"] for one in every if "cpu_s" in one] for every in some.values()]
        cells = [f"{np.quantile(each, share):.2f}" if each else "-" for each in took]
        lines.append(f"{'processor s of a diagnosis, ' + name:<52}" + "".join(f"{cell:>12}" for cell in cells))
    blamed = Counter(
        f"{'+'.join(sorted(name for name in read(one['ask'].split('/')[2]) if name in BY_NAME))} -> {innocent}"
        for one in done for innocent in one.get("innocents", ()) if one["what"] in (*_UNKNOWN, "one and unknown")
    )  # fmt: skip
    lines += [f"    {count} x {who}" for who, count in blamed.most_common(20)]
    return "\n".join(lines)


def main() -> None:
    """Prints what went wrong as it comes, then the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--suite", choices=list(SUITES))
    parser.add_argument("--worlds", type=int, default=40, help="of each suite")
    parser.add_argument("--first", type=int, default=100_000, help="number of the first world")
    parser.add_argument("--workers", type=int, default=WORKERS)
    parser.add_argument("--show", action="store_true", help="list each miss with its truth, its answer and its world")
    parser.add_argument("--out", type=Path, help="every answer as a line of JSON")
    parser.add_argument("--ask", help="one world again: suite/number/what is hidden")
    asked = parser.parse_args()
    if asked.ask:
        suite, number, word = asked.ask.split("/")
        with apart(), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            hidden = read(word)
            matching = [what for what, one in asks_of(suite, int(number)).items() if one == hidden]
            print(json.dumps(answered(suite, int(number), (*matching, "asked")[0], hidden), indent=1))
        return
    done: list[Record] = []
    for records in of_all([asked.suite] if asked.suite else list(SUITES), asked.worlds, asked.first, asked.workers):
        done += records
        if asked.out:
            with asked.out.open("a", encoding="utf-8") as file:
                file.writelines(json.dumps(one, ensure_ascii=False) + "\n" for one in records)
        for one in records:
            if asked.show and missed(one):
                print(in_words(one), flush=True)
    print(table_of(done))


if __name__ == "__main__":
    main()
