"""One noise floor and one closed fraction, whatever the method."""

from __future__ import annotations

import dataclasses
import typing

import numpy as np
import pytest
from scipy.signal import lfilter

from bayesbl.config.kinds import Method as Configured
from bayesbl.diagnosis.closed_loop.prediction import compared_channels
from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.diagnosis.disagreement import ComparedPiece, ResidualNoise, disagreement_table
from bayesbl.diagnosis.groups import diagnosis_tree
from bayesbl.diagnosis.rigid.motion import LowPass
from bayesbl.matching.observed import Observed
from bayesbl.noise.rotation_noise import HIGHEST_ORDER
from bayesbl.results.store import summary_of
from bayesbl.runs.diagnose import METHODS

LAG = 500
ROTATIONS = 8
SD = 1.5


def noise(seed: int, phi: float = 0.6) -> np.ndarray:
    """AR(1) noise of standard deviation 1.5 over eight rotations."""
    white = np.random.default_rng(seed).standard_normal(ROTATIONS * LAG)
    return SD * np.sqrt(1.0 - phi**2) * lfilter([1.0], [1.0, -phi], white)


def misfit(size: float) -> np.ndarray:
    """What repeats every rotation, RMS ``size``."""
    angle = 2.0 * np.pi * np.arange(ROTATIONS * LAG) / LAG
    return size * np.sqrt(2.0) * np.sin(3.0 * angle)


def piece(before, after, rotation=LAG, channel="motor_speed_rpm", white=None):
    """What two simulations leave of a signal that is zero."""
    signals = np.arange(before.size), np.zeros(before.size), -before, -after
    return ComparedPiece.of("made", channel, "used", *signals, rotation=rotation, white=white)


def test_what_repeats_is_no_noise_where_whole_rotations_show_it() -> None:
    left = noise(1) + misfit(4.0)
    found = piece(left, left)
    assert found.noise_floor_from == "rotation"
    # 3500 differences of φ 0.6 scatter by 2.5 %.
    assert found.noise_floor == pytest.approx(SD, rel=0.08)


def test_what_follows_from_the_samples_before_is_no_noise_elsewhere() -> None:
    found = piece(noise(2), noise(2), rotation=None)
    assert found.noise_floor_from == "samples"
    assert found.noise_floor == pytest.approx(0.8 * SD, rel=0.05)  # √(1 − φ²) of it


@pytest.mark.parametrize("samples_per_period", [2.5, 3.0, 3.97, 4.9])
def test_behind_a_low_pass_white_noise_is_its_own_floor(samples_per_period: float) -> None:
    low_pass = LowPass(1.0 / samples_per_period, 1.0)
    left = low_pass(np.random.default_rng(4).standard_normal(10_000))
    white = low_pass.of_white_noise(1, HIGHEST_ORDER + 1)
    assert white[0] == pytest.approx(np.mean(left**2), rel=0.05)
    found = piece(left, left, None, "motor_torque_nm", white)
    # An order of BIC's choice, its share of white noise to a few per cent.
    assert found.noise_floor == pytest.approx(np.sqrt(np.mean(left**2)), rel=0.05)


def test_behind_a_low_pass_what_is_smoother_than_noise_stays_a_misfit() -> None:
    low_pass = LowPass(0.25, 1.0)
    made = np.random.default_rng(5).standard_normal(10_000)
    swing = np.sqrt(2.0) * 4.0 * np.sin(2.0 * np.pi * 0.01 * np.arange(made.size))
    white = low_pass.of_white_noise(1, HIGHEST_ORDER + 1)
    left = low_pass(made) + swing
    found = piece(left, left, None, "motor_torque_nm", white)
    assert found.noise_floor < 0.3 * np.sqrt(np.mean(left**2))


@pytest.mark.parametrize("left", [0.0, 0.5, 1.0])
def test_the_closed_fraction_is_the_share_of_the_misfit_that_is_gone(left: float) -> None:
    made = noise(3)
    table = disagreement_table([piece(made + misfit(4.0), made + misfit(left))])
    found = table["recordings"]["made"]["motor_speed_rpm"]["used"]
    assert found["closed_fraction"] == pytest.approx(1.0 - (left / 4.0) ** 2, abs=0.02)
    assert found["unit"] == table["unit"] == "rpm"


def test_no_share_is_given_of_a_misfit_that_noise_may_have_made() -> None:
    table = disagreement_table([piece(noise(4) + misfit(0.2), noise(4))])
    assert table["over_all"]["used"]["closed_fraction"] is None


def test_over_all_channels_no_unit_counts() -> None:
    speed = piece(noise(5) + misfit(4.0), noise(5))
    tables = []
    for factor in (1.0, 1e-3):
        before, after = noise(6) + misfit(2.0), noise(6)
        current = piece(factor * before, factor * after, channel="motor_current_a")
        tables.append(disagreement_table([speed, current]))
    one, other = (list(table["over_all"]["used"].values()) for table in tables)
    assert one[:4] == pytest.approx(other[:4])
    assert one[-1] == "noise"


def test_what_is_left_out_makes_neither_misfit_nor_noise_smaller() -> None:
    """RMS over 4000 samples and 1600 of them: alike within 10 %, five standard errors."""
    rng = np.random.default_rng(4)
    signals = rng.standard_normal((2, 4000))
    whole = Observed("one", signals, 1000.0, 2000.0, 1.0)
    some = dataclasses.replace(whole, excluded=np.arange(4000) % 500 < 300)
    sizes = [
        (piece.noise_floor, float(np.sqrt(np.mean(piece.residual[0] ** 2))))
        for seen in (whole, some)
        for piece in compared_channels(seen, "used", 0.0 * signals + 1.0, 0.0 * signals)
    ]
    assert np.array(sizes[2:]) == pytest.approx(np.array(sizes[:2]), rel=0.1)


def test_where_a_floor_is_from_is_stored_beside_it() -> None:
    pieces = piece(noise(7), noise(7)), piece(noise(8), noise(8), None, "motor_current_a")
    tree = diagnosis_tree(Diagnosis("nothing_missing", (), (), (), pieces), 0.9, "hdi")
    summary = summary_of(tree)["disagreement"]["recordings"]["made"]
    assert summary["motor_speed_rpm"]["used"]["noise_floor_from"] == "rotation"
    assert summary["motor_current_a"]["used"]["noise_floor_from"] == "samples"


def test_every_method_that_may_be_configured_is_there_under_its_name() -> None:
    assert set(METHODS) == set(typing.get_args(Configured))


def test_a_residual_that_comes_in_bursts_has_a_size_everywhere() -> None:
    """An axis that rests to the last digit between its moves."""
    bursts = np.random.default_rng(3).standard_normal(4000) * np.where(np.arange(4000) < 200, 1, 0)
    bursts[200:] = 1e-12 * np.sin(np.arange(3800.0))
    noise = ResidualNoise.of(bursts)
    assert np.all(np.isfinite(noise.local))
    assert noise.local[:100].min() > 1e3 * noise.local[-1]
