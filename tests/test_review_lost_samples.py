"""Messages and samples that lack numbers in between."""

from __future__ import annotations

from array import array
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from bayesbl.matching import loop_noise
from bayesbl.recording.array_table import ArrayTable
from bayesbl.recording.formats.ros_bag import _groups
from bayesbl.ringing.pointwise import _innovations


def test_a_joint_whose_first_messages_lack_the_effort_is_one_group() -> None:
    """Its messages are in order of their times, with NaN for what they lack."""
    series = {
        ("/joint_states", "j1", ("position",)): array("d", [0.0, 0.0, 1.0, 0.2, 0.2, 3.0]),
        ("/joint_states", "j1", ("position", "effort")): array("d", [0.1, 0.1, 2.0, 5.0]),
    }
    (group,) = _groups(series)
    assert np.array_equal(group.columns["position"], [1.0, 2.0, 3.0])
    assert np.array_equal(group.columns["effort"], [np.nan, 5.0, np.nan], equal_nan=True)


def test_lost_samples_of_differentiated_noise_do_not_add_up() -> None:
    """The innovations of white noise, differentiated, are as large with lost samples as without."""
    rng = np.random.default_rng(1)
    rows = np.diff(rng.standard_normal(4001))[None]
    used = np.arange(4000) % 50 != 25
    point: Any = SimpleNamespace(
        noise=SimpleNamespace(differentiated=True, coefficients=np.zeros(0)),
        objective=SimpleNamespace(used=used),
    )
    assert abs(_innovations(point, rows)[0][used].std() - 1.0) < 0.05


def test_parts_of_a_second_beside_dates_are_in_order_and_change() -> None:
    """Unsigned numbers out of order are not a clock, nor is a constant delay."""
    unordered = ArrayTable({"x_ms": np.array([500, 100, 900, 200], dtype=np.uint16)})
    seconds = np.array([0.0, 0.0, 0.0, 1.0])
    assert np.array_equal(unordered.with_parts(seconds), seconds)
    parts = {"delay_ms": np.ones(4), "time_ms": np.array([100, 200, 100, 200])}
    dates = ArrayTable(parts).with_parts(np.array([0.0, 0.0, 1.0, 1.0]))
    assert np.allclose(dates, [0.0, 0.1, 1.0, 1.1])


def test_a_controller_without_gain_feeds_no_noise_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its current does not respond, which is no division by zero."""
    size = 5
    spectra = np.linspace(0.0, 0.5, size), np.ones(size), np.ones(size, complex)
    monkeypatch.setattr(loop_noise, "_spectra", lambda *_: spectra)
    idle = np.ones(size, complex), np.zeros(size, complex)
    monkeypatch.setattr(loop_noise, "_loop_responses", lambda *_: idle)
    observation = SimpleNamespace(samples=8, signals=np.ones((2, 8)))
    fit: Any = SimpleNamespace(
        point=np.zeros(1),
        model=SimpleNamespace(
            recordings=[observation],
            noise=[SimpleNamespace(repeats=False)],
            vectors=lambda *_: np.zeros((1, 1)),
        ),
    )
    assert loop_noise.loop_noise(fit, 0) is None
