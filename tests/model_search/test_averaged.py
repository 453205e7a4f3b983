"""The draws that answer are those of all sets of hypotheses, each in its share."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bayesbl.matching.posterior import DirectPosterior
from bayesbl.model_search.closed_loop import averaged
from bayesbl.recording.types import FloatArray


def unknowns(*names: str) -> Any:
    return SimpleNamespace(unknowns=[SimpleNamespace(key=name) for name in names])


def other_set(mean: float) -> Any:
    """A set that has two unknowns in common, which are drawn about a mean."""

    def draws(generator: np.random.Generator, n: int) -> FloatArray:
        return mean + generator.standard_normal((n, 3))

    return SimpleNamespace(draws=draws, fit=SimpleNamespace(model=unknowns("gap", "angle", "b")))


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_every_other_set_has_its_share_and_what_it_lacks_stays(share: float) -> None:
    """The third unknown is of the chosen set alone."""
    rng = np.random.default_rng(1)
    model = unknowns("gap", "angle", "a")
    model.low, model.high = np.full(3, -np.inf), np.full(3, np.inf)
    fit: Any = SimpleNamespace(model=model)
    as_it_is, nothing = np.ones(3), None
    draws = rng.standard_normal((4, 250, 3))
    unaveraged: Any = DirectPosterior(
        fit, draws, np.zeros((4, 250)), np.nan, 0, 0, nothing, as_it_is, as_it_is
    )
    whole = averaged(unaveraged, [(other_set(100.0), share)], np.random.SeedSequence(1))
    is_of_other = whole.draws[..., :2] > 50.0
    assert np.mean(is_of_other) == share
    assert np.array_equal(is_of_other[..., 0], is_of_other[..., 1])
    assert np.array_equal(whole.draws[..., 2], draws[..., 2])
    assert np.array_equal(whole.draws[~is_of_other[..., 0]], draws[~is_of_other[..., 0]])
    assert np.all((whole.model_widening[:2] > 10.0) == (share > 0.0))
