"""How hypothesis works here: the same examples in every run, as many as keep the tests quick, no time limit
(the first example of a test may compile a kernel)."""

from __future__ import annotations

import os

from hypothesis import settings

from layerfix.kernels_ahead import MARK

os.environ.setdefault(MARK, "1")  # every process compiles for itself: tests count what it compiles
settings.register_profile("layerfix", deadline=None, derandomize=True, database=None, max_examples=60)
settings.load_profile("layerfix")
