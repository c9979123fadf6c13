"""The laws of the method on 2,000 random images each; `python -m tests.laws 100000` is the slow run."""

from __future__ import annotations

import pytest

from tests.laws import LAWS, broken

PIECES = 4


@pytest.mark.parametrize("piece", range(PIECES))
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_laws(law, piece):
    """Seeds that the slow run has, too."""
    each = 2000 // PIECES
    assert broken(law, range(piece * each, (piece + 1) * each)) == []
