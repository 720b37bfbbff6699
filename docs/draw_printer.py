"""Draws the picture of ``docs/printer.md``: a simulated printer whose frame is twisted, probed twice.

Run from the root: ``python docs/draw_printer.py``. The simulator is that of the tests.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]


def main() -> None:
    """Writes ``docs/pictures/printer.svg``."""
    sys.path.insert(0, str(ROOT / "tests"))
    from second_printer.trials import Trial
    from sherkit.robots.printer.page import drawing
    from sherkit.robots.printer.printer_diagnosis import examine, files_of

    with tempfile.TemporaryDirectory() as folder:
        files = Trial.of("frame twisted", 5, 1).write(Path(folder), "klipper", (0.0, 60.0), 1)
        examined = examine(files_of(files[0], (), {"at60": 60.0}))
    (ROOT / "docs" / "pictures" / "printer.svg").write_text(drawing(examined) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
