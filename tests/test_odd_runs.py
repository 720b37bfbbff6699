"""Whatever a run holds, there is an answer or a sentence: no traceback, no warning of NumPy, no number that is none."""

import pytest

from odd_runs import ODD, asked
from standing_worlds import WORLDS

OF_EACH = len(WORLDS)


#: What takes longest.
LONG = ("jitters", "frozen", "held_reading")


@pytest.mark.parametrize(
    "odd", [pytest.param(k, marks=[pytest.mark.slow] * (one.__name__ in LONG)) for k, one in enumerate(ODD)],
    ids=[odd.__name__ for odd in ODD],
)  # fmt: skip
def test_an_odd_run_gets_an_answer(odd: int) -> None:
    """Catches a column that is nothing, or a joint that does not move, where the way counts on more. One robot each."""
    _, said = asked(OF_EACH * odd + odd % OF_EACH)
    assert not said.startswith("FAULT"), said


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 1000, 50))
def test_a_thousand_odd_runs_get_answers(first: int) -> None:
    """The same of all robots and mutations, 1,000 runs."""
    told = [asked(number)[1] for number in range(first, first + 50)]
    assert not [said for said in told if said.startswith("FAULT")]
