"""``sherkit lab``: a laboratory of emulated instruments on ports of this machine."""

from __future__ import annotations

import signal
import tempfile
import threading
from dataclasses import replace
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

import click

from . import output

if TYPE_CHECKING:
    from ..lab.laboratory import RunningLaboratory

_LOOPBACK = ("127.", "localhost")


@click.command()
@click.argument("laboratory", type=click.Path(path_type=Path), required=False)
@click.option("--ports", type=click.Path(path_type=Path), help="Write the addresses into this file (JSON).")
@click.option("--host", help="Listen on this address of the machine; left out, for programs of this machine alone.")
@click.option("--time-scale", type=click.FloatRange(min=0, min_open=True), help="Run so much faster than real time.")
@click.option("--json", "as_json", is_flag=True, help="Print the addresses as JSON.")
@click.option("--demo", is_flag=True, help="Start a laboratory, find what is hidden in its robot, and compensate it.")
@click.option("-o", "--output", "folder", type=click.Path(path_type=Path), default=Path("demo-lab"), show_default=True,
              help="Where --demo puts its files.")  # fmt: skip
def lab(
    laboratory: Path | None, ports: Path | None, host: str | None, time_scale: float | None, as_json: bool, demo: bool,
    folder: Path,
) -> None:  # fmt: skip
    """Start the emulated instruments of LABORATORY (TOML), until Ctrl-C; without one, those of an example."""
    # emulators are loaded by who wants them: not where a robot is measured
    from ..lab.laboratory import RunningLaboratory, load_laboratory
    from .lab_demo import lab_demo, write_laboratory

    if demo:
        lab_demo(folder)
        return
    if laboratory is None:
        with tempfile.TemporaryDirectory() as example:
            chosen = replace(load_laboratory(write_laboratory(Path(example))), source="example")
    else:
        chosen = load_laboratory(laboratory)
    if host is not None:
        chosen = replace(chosen, host=host)
    if time_scale is not None:
        chosen = replace(chosen, time_scale=time_scale)
    if not chosen.host.startswith(_LOOPBACK):
        output.warn(f"the emulators listen on {chosen.host}: every machine that reaches it can drive them")
    over = threading.Event()

    def end(number: int, frame: FrameType | None) -> None:
        del number, frame
        over.set()

    before = {number: signal.signal(number, end) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        with RunningLaboratory(chosen) as running:
            if ports is not None:
                running.write_ports(ports)
            if as_json:
                output.print_json(running.ports())
            else:
                _show(running)
            output.out.file.flush()
            while not over.wait(0.2):
                pass
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _show(running: RunningLaboratory) -> None:
    lab = running.laboratory
    scale = f"; its clock runs {lab.time_scale:g} times as fast" if lab.time_scale != 1 else ""
    made = output.table(f"{lab.source}: instruments around a virtual {lab.robot.kind} robot{scale}", "instrument",
                        "kind", "address", note="Ctrl-C ends the laboratory.")  # fmt: skip
    for name, one in running.ports().items():
        made.add_row(name, one["kind"], one["address"])
        if "page" in one:
            made.add_row("", "its page", one["page"])
    output.out.print(made)
