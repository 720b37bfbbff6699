"""Settings of all tests."""

from __future__ import annotations

import os

from hypothesis import settings

# how long an example takes depends on what else the machine does; and a run that says something else than the last one
# shall mean that the code changed
settings.register_profile("same", deadline=None, derandomize=True, print_blob=True)
# `make test-slow` looks elsewhere each time
settings.register_profile("random", deadline=None, print_blob=True, max_examples=500)
settings.load_profile("random" if os.environ.get("SHERKIT_RANDOM") else "same")
