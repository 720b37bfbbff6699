"""How often a promised accuracy holds: the table of docs/accuracy.md. Takes some minutes.

python benchmarks/accuracy_coverage.py [robots per set-up] [words that the set-up's name holds]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from accuracy_coverage import SET_UPS, kept


def main(seeds: int = 8, words: str = "") -> None:
    """Prints a row for each set-up."""
    print(
        "| set-up | radius | addition | miss (95 %) | held by the radius | by both | one visit | read (95 %) | held |"
    )
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: | ---: | ---: |")
    for one in SET_UPS:
        if words in one.name:
            found = kept(one, range(seeds))
            radius, addition = (1e3 * np.median(v) for v in (found.radius, found.addition))
            off, read = (1e3 * np.quantile(v, 0.95) for v in (found.off, found.read))
            print(
                f"| {one.name} | {radius:.1f} | {addition:.1f} | {off:.1f} | {found.by_radius:.2f} | "
                f"{found.whole:.2f} | {1e3 * np.median(found.visit):.1f} | {read:.1f} | {found.by_visit:.2f} |",
                flush=True,
            )


if __name__ == "__main__":
    main(*(int(v) for v in sys.argv[1:2]), *sys.argv[2:3])
