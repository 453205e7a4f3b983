"""What ``check`` expects of recordings beside what a fit of them answers."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from places import BEFORE, CONFIGS

from bayesbl import cli
from bayesbl.bench.motion import cycle
from bayesbl.config.bench import reference_bench
from bayesbl.matching.alignment import fit_aligned
from bayesbl.matching.observed import Observed, observed
from bayesbl.matching.signals import GAP
from bayesbl.measurement.direct_route import expected_sds
from bayesbl.measurement.measurement import ExpectedSd
from bayesbl.model_search.always_in import directions, with_far_terms_freed, with_friction
from bayesbl.model_search.pipeline import direct_unknowns
from bayesbl.runs.kinds import check
from bayesbl.runs.simulate import recording_csv

BENCH, GAP_RAD = reference_bench(), 5e-4
RNG = np.random.default_rng(1)


def recordings(rotations: float) -> list[Observed]:
    rng = np.random.default_rng(11)
    return [
        observed(BENCH.simulate(GAP_RAD, rotations=rotations, seed=rng, name=name), BENCH)
        for name in ("before", "after")
    ]


def expected(seen: list[Observed]) -> ExpectedSd:
    bench = with_friction(BENCH, seen)
    unknowns = direct_unknowns(bench, [one.name for one in seen], (0.0, 5e-3))
    (own,) = expected_sds(bench, seen, unknowns, directions(bench, {}), [GAP_RAD])
    return own


def test_the_expected_width_is_that_of_an_answer() -> None:
    """To within the 20 % by which residuals of one recording move the marginalised laws."""
    seen = recordings(3.0)
    before = expected(seen)
    bench = with_friction(BENCH, seen)
    nominal = fit_aligned(bench, seen, direct_unknowns(bench, ["before", "after"], (0.0, 5e-3)))
    rest = with_far_terms_freed(nominal, directions(bench, {}))
    fit = rest.fit
    shift = rest.posterior.draw(np.random.default_rng(0), 2000).shift
    places = [fit.model.index(GAP, name) for name in ("before", "after")]
    covariance = (fit.covariance + np.cov(shift.T))[np.ix_(places, places)]
    change = np.array([-1.0, 1.0])
    slope_rad = float(fit.model.unknowns[places[0]].slope(np.array(GAP_RAD)))
    assert before.delta_rad == pytest.approx(
        slope_rad * math.sqrt(covariance.diagonal().max()), rel=0.2
    )
    assert before.change_rad == pytest.approx(
        slope_rad * math.sqrt(change @ covariance @ change), rel=0.2
    )


def test_more_rotations_narrow_the_noise_and_not_what_the_bench_leaves_open() -> None:
    few, many = (expected(recordings(n)).delta_rad for n in (2.0, 8.0))
    assert 0.5 * few < many < few


def test_without_the_current_a_gap_is_known_less_precisely() -> None:
    seen = recordings(3.0)
    alone = [replace(one, signals=one.signals[:1], rounding=one.rounding[:1]) for one in seen]
    assert expected(alone).delta_rad > expected(seen).delta_rad


@pytest.mark.parametrize(("low_rad", "is_expected"), [(0.0, True), (2e-3, False)])
def test_check_says_nothing_of_gaps_outside_the_prior(
    low_rad: float, is_expected: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It ended in a traceback where the prior holds none of the gaps that it asks for."""
    assert ("expected:" in checked(BEFORE, tmp_path, capsys, low_rad)) is is_expected


def test_check_says_what_strokes_would_show(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    motion = cycle(120.0, (-0.5, 0.5), 1500.0, 6000.0, 0.15, 8.0)
    file = tmp_path / "strokes.csv"
    file.write_text(recording_csv(BENCH.simulate(GAP_RAD, motion, sampling_hz=500.0, seed=RNG)))
    assert re.search(r"expected: .*±0\.00\d+ mrad at 1 mrad", checked(file, tmp_path, capsys))


def test_check_tells_at_which_gap_it_is(tmp_path: Path) -> None:
    told: list[tuple[str, int, int]] = []
    check(fit_of(BEFORE, tmp_path), lambda *stage: told.append(stage))
    stage = "Estimating the precision at some gaps"
    assert told == [(stage, done, 3) for done in range(3)]


def checked(
    recording: Path, folder: Path, capsys: pytest.CaptureFixture[str], low_rad: float = 0.0
) -> str:
    """What ``check`` prints of a fit of one recording by the direct route."""
    assert cli.status(["check", str(fit_of(recording, folder, low_rad))]) == 0
    return capsys.readouterr().out


def fit_of(recording: Path, folder: Path, low_rad: float = 0.0) -> Path:
    """A configuration that fits one recording by the direct route."""
    config = folder / "config.toml"
    config.write_text(
        f"""
schema = 1
kind = "fit"
[run]
output = "out"
[joint]
gear_ratio = 120.0
[estimator]
route = "direct"
bench = "{CONFIGS / "bench.toml"}"
gap_rad = [{low_rad}, 1e-2]
[[recordings]]
name = "before"
file = "{recording}"
"""
    )
    return config
