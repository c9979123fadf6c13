"""How hypothesis works here: the same examples in every run, as many as keep the tests quick, no time limit
(the first example of a test may compile a kernel)."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("layerfix", deadline=None, derandomize=True, database=None, max_examples=60)
settings.load_profile("layerfix")
