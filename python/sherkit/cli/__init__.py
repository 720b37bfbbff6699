"""Command line: one verb for each thing a person does.

Exit codes: 0 done, 1 wrong input (a sentence says which), 2 wrong command line, 3 the fit did not converge,
130 interrupted.
"""

import sys

import sherkit._core as _core

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> None:
    """Runs a command; errors become one sentence and an exit code."""
    typed = sys.argv[1:] if arguments is None else arguments
    if typed == ["--version"]:
        # what reads a command line takes longer to load than this to say
        print(f"sherkit, version {_core.__version__}")
        sys.exit(0)
    from .verbs import run

    run(typed)
