"""Command line: one verb for each thing a person does.

Exit codes: 0 done, 1 wrong input (a sentence says which), 2 wrong command line, 3 the fit did not converge,
130 interrupted.
"""

from .main import main

__all__ = ["main"]
