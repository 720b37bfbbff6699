"""Settings of all tests."""

from __future__ import annotations

import os
from collections.abc import Iterator
from typing import Any

import pytest
from hypothesis import settings

from consistency import consistent
from sherkit.diagnosis import Diagnosis

# how long an example takes depends on what else the machine does; and a run that says something else than the last one
# shall mean that the code changed
settings.register_profile("same", deadline=None, derandomize=True, print_blob=True)
# `make test-slow` looks elsewhere each time
settings.register_profile("random", deadline=None, print_blob=True, max_examples=500)
settings.load_profile("random" if os.environ.get("SHERKIT_RANDOM") else "same")


@pytest.fixture(autouse=True, scope="session")
def every_diagnosis_is_consistent() -> Iterator[None]:
    """Whatever a test asks, no diagnosis that it makes may contradict its own numbers."""
    make = Diagnosis.__init__

    def checked(self: Diagnosis, *args: Any, **fields: Any) -> None:
        make(self, *args, **fields)
        consistent(self)

    Diagnosis.__init__ = checked  # type: ignore[method-assign]
    yield
    Diagnosis.__init__ = make  # type: ignore[method-assign]
