"""Figures as people read them."""

from __future__ import annotations

import pytest

from sherkit.base.figures import in_people_units, stated, with_error


@pytest.mark.parametrize(
    ("value", "std", "unit", "said"),
    [
        (1.499, 0.310, "mm", "1.50 ± 0.31 mm"),
        (-0.0198, 0.0238, "mm", "-0.020 ± 0.024 mm"),
        (0.0105, 1e-5, "rad", "0.60161 ± 0.00057°"),
        (1234.5, 123.0, "mm", "1230 ± 120 mm"),
        (0.2, 0.03, "1", "0.200 ± 0.030"),
        (0.5, 0.0999, "rad/h", "28.6 ± 5.7°/h"),
        (0.0, 0.0996, "µm", "0.00 ± 0.10 µm"),
        (-1e-9, 0.3, "mm", "0.00 ± 0.30 mm"),
        (2.5, 0.0, "mm", "2.5 ± 0 mm"),
        (2.5, float("nan"), "mm", "2.5 ± nan mm"),
    ],
)
def test_a_figure_has_the_digits_that_are_known(value: float, std: float, unit: str, said: str) -> None:
    """Catches digits that nobody knows, a value cut at another place than its error, radians beside degrees, a unit of
    one, a zero with a sign."""
    assert stated(value, std, unit) == said


def test_every_unit_of_angle_becomes_degrees() -> None:
    """Catches a unit that holds rad and is not read in degrees, and a ratio of angles that is."""
    assert in_people_units("rad/mm")[0] == "°/mm"
    assert in_people_units("rad/rad") == ("rad/rad", 1.0)
    assert in_people_units("mm/mm") == ("mm/mm", 1.0)


def test_others_end_where_the_value_ends() -> None:
    """Catches a third figure with digits of its own."""
    assert with_error(1.499, 0.310, 1.1623) == ("1.50", "0.31", "1.16")
    assert with_error(1e-9, 3e-12)[0] == "1.0000e-09"
