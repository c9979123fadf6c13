"""The laws of the method on 2,000 random images each; `python -m tests.laws 100000` is the slow run."""

from __future__ import annotations

import pytest

from tests.laws import LAWS, broken, case, moved_in_moved_out

PIECES = 4


@pytest.mark.parametrize("piece", range(PIECES))
@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_laws(law, piece):
    """Seeds that the slow run has, too."""
    each = 2000 // PIECES
    assert broken(law, range(piece * each, (piece + 1) * each)) == []


@pytest.mark.parametrize("seed", [1020080, 1042196])
def test_layers_that_once_came_out_otherwise_when_moved(seed):
    """The second thinning looked at some blocks of pixels in one of its phases only."""
    assert moved_in_moved_out(*case(seed))
