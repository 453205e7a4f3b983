"""Noise in the speed loop: how freely it may repeat by chance, and what it gains by chance."""

from __future__ import annotations

from dataclasses import replace
from types import ModuleType

import numpy as np
import pytest
from test_impacts import fitted, turning

from bayesbl.config.bench import reference_bench
from bayesbl.matching.loop_noise import LoopNoise, noise_along
from bayesbl.model_search.closed_loop import weighed
from bayesbl.model_search.refit import Explanation
from bayesbl.probabilities import f_sf
from bayesbl.recording.types import FloatArray

LAG = 400
HIGHEST = 32
ROTATIONS = 3


def at_impacts(count: int, seed: int, share: float = 1.0) -> FloatArray:
    """Rotations (count, LAG): noise, and a ringing after each of two impacts that comes and goes.

    ``share``: of the variance of the impacts.
    """
    rng = np.random.default_rng(seed)
    time = np.arange(LAG // 2)
    ringing = np.exp(-time / 30.0) * np.sin(2.0 * np.pi * 20.0 * time / LAG)
    rows = rng.standard_normal((count, 2, 1)) * ringing * 10.0 * np.sqrt(share)
    return np.asarray(rows.reshape(count, LAG) + rng.standard_normal((count, LAG)))


def in_band(turns: FloatArray) -> FloatArray:
    """Orders up to ``HIGHEST``, (…, LAG) to (…, 2 HIGHEST)."""
    band = np.fft.rfft(turns, axis=-1)[..., 1 : 1 + HIGHEST]
    return np.concatenate([band.real, band.imag], axis=-1)


def ratios(count: int) -> FloatArray:
    """Power that repeats over that which does not, of recordings of nothing but such noise."""
    band = in_band(at_impacts(ROTATIONS * count, 1).reshape(count, ROTATIONS, LAG))
    mean = band.mean(axis=1, keepdims=True)
    scatter = np.sum((band - mean) ** 2, axis=(1, 2)) / (ROTATIONS - 1)
    return np.asarray(ROTATIONS * np.sum(mean[:, 0] ** 2, axis=1) / scatter)


def test_noise_at_impacts_repeats_by_chance_as_often_as_is_said() -> None:
    """1 % of 2000 recordings are taken for more than noise, within four standard deviations.

    With every order of the band free it were ten times as many.
    """
    loop = LoopNoise(np.ones((1, 1)), at_impacts(80, 2)[None], at_impacts(80, 3, share=0.0)[None])
    found = ratios(2000)
    chances = [loop.chance(ratio, in_band, ROTATIONS) for ratio in found]
    free = [f_sf(ratio, 2 * HIGHEST, 2 * HIGHEST * (ROTATIONS - 1)) for ratio in found]
    assert np.mean(np.array(chances) < 0.01) == pytest.approx(0.01, abs=0.009)
    assert np.mean(np.array(free) < 0.01) > 0.05


def test_degrees_of_freedom_are_those_of_the_mixture() -> None:
    """Noise that is white has them all, one value has one; to a tenth and a half."""
    white = np.random.default_rng(1).standard_normal((2, 80, 50))
    one = np.zeros((80, 50))
    one[:, 7] = white[0, :, 7]
    loop = LoopNoise(np.array([[0.0, 1.0]]), one[None], white[1:])

    def as_it_is(rows: FloatArray) -> FloatArray:
        return rows

    assert loop.degrees_of_freedom(as_it_is) == pytest.approx([50.0, 1.0], rel=0.1)


@pytest.mark.parametrize("in_loop", [True, False])
def test_noise_in_the_loop_leaves_less_evidence(independent: ModuleType, in_loop: bool) -> None:
    """What lies along the gap's derivative is worth less there, and all of it where the recorder
    adds the noise; its own estimate scatters as much more."""
    fit = fitted(turning(independent, 7e-4, 3.0, 1, in_loop=in_loop), reference_bench())
    along = fit.derivatives()[:, 0]
    along = along / np.linalg.norm(along)
    moved = replace(fit, residual=fit.residual + 6.0 * along)
    # Nothing else may take it.
    held = [
        replace(u, low=x - 1e-9, high=x + 1e-9)
        for u, x in zip(fit.model.unknowns, fit.point, strict=True)
    ]
    model = replace(fit.model, unknowns=held)
    evidence, squares = zip(
        *(
            (
                weighed(Explanation((), replace(own, model=model))).log_evidence,
                float(own.residual @ own.residual),
            )
            for own in (fit, moved)
        ),
        strict=True,
    )
    by_recorder = 0.5 * (squares[1] - squares[0])
    assert (evidence[0] - evidence[1] < 0.7 * by_recorder) == in_loop
    estimate = fit.derivatives() @ fit.covariance[:, 0]
    assert (noise_along(fit)(estimate) > 1.5) == in_loop
