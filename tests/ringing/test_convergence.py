"""Posteriors that must not be trusted, each built for real: recognised, said, and withheld."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from made_recordings import synthetic_recording
from synthetic_ringing import NOISE, STRONG, ambiguous, clean

from bayesbl import cli
from bayesbl.presentation.figures.ringing import signal
from bayesbl.recording.types import Recording
from bayesbl.results.store import read_tree
from bayesbl.ringing.covariance import Covariance
from bayesbl.ringing.estimator import Estimator, PointEstimate
from bayesbl.ringing.posterior import sample_posterior
from bayesbl.ringing.symbols import AMPLITUDE, DECAY, FREQUENCY, DisturbanceModel
from bayesbl.sampling.chains import SamplerSettings

pytestmark = pytest.mark.long

SHORT = SamplerSettings(ensembles=2, max_steps=500)


@pytest.fixture(scope="module")
def point() -> PointEstimate:
    return Estimator().estimate(clean(), np.random.SeedSequence(1))


def withheld(
    recording: Recording, folder: Path, capsys: pytest.CaptureFixture[str], extra: str
) -> str:
    """Fit by the command line; checks that nothing is answered, and returns the reason."""
    table = np.column_stack([recording.time_s, recording.motor_speed_rpm])
    np.savetxt(
        folder / "speed.csv", table, "%.12g", ",", header="time_s,motor_speed_rpm", comments=""
    )
    (folder / "fit.toml").write_text(
        f'schema = 1\nkind = "fit"\n[run]\noutput = "out"\n[[recordings]]\nfile = "speed.csv"\n'
        f'[curve]\nsource = "published"\n'
        f"allow_extrapolation = true\n{extra}"
    )
    assert cli.status(["run", str(folder / "fit.toml"), "--json"]) == 3
    summary = json.loads(capsys.readouterr().out)
    assert summary["outcome"] == summary["diagnostics"]["outcome"] == "withheld"
    assert summary["delta_rad"] is None
    assert (folder / "out" / "result.nc").is_file()
    return str(summary["reason"]["text"])


pytestmark = pytest.mark.usefixtures("no_figures")


def test_a_bimodal_posterior_is_withheld_though_every_ensemble_mixes(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reason = withheld(ambiguous(), tmp_path, capsys, "")
    assert "several modes: another optimum" in reason


def test_a_chain_too_short_is_said(point: PointEstimate) -> None:
    settings, seed = SamplerSettings(ensembles=2, max_steps=100), np.random.SeedSequence(2)
    found = sample_posterior(point, settings, seed)
    assert found.diagnostics.outcome == "usable"
    assert found.diagnostics.reasons[0].code == "chain_short"


def test_a_posterior_at_a_bound_is_withheld(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    reason = withheld(
        clean(), tmp_path, capsys, f"[estimator.model.ranges]\n{DECAY} = [5.0, 11.5]\n"
    )
    assert f"draws of {DECAY} are at a bound" in reason


def test_ringing_lost_in_noise_is_the_first_reason_and_its_band_can_be_drawn(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    silent = synthetic_recording(
        STRONG | {AMPLITUDE: 0.0}, NOISE, np.random.default_rng(1), baseline_rpm=(5.0, -3.0)
    )
    reason = withheld(silent, tmp_path, capsys, "[posterior]\nensembles = 2\nmax_steps = 500\n")
    assert reason.startswith("The impact ringing is too weak")
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["reason"]["code"] == "no_flank_change"
    tree = read_tree(tmp_path / "out")
    assert all(
        np.isfinite(tree["amplitude/predictive"][name]).all() for name in ("low_rpm", "high_rpm")
    )
    signal(tree)


def test_a_stuck_ensemble_is_withheld(point: PointEstimate) -> None:
    # Walkers scattered ten thousand times too far find a peak each, and no way between them.
    spread = point.spread
    far = Covariance(spread.names, 1e8 * spread.sandwich, 1e8 * spread.inverse_curvature)
    assert far.scale == pytest.approx(spread.scale)
    point = replace(point, spread=far)
    found = sample_posterior(point, SHORT, np.random.SeedSequence(1)).diagnostics
    assert found.outcome == "withheld"
    assert "ensemble_stuck" in [flaw.code for flaw in found.reasons]


def test_a_posterior_that_fills_its_range_is_at_its_bounds(point: PointEstimate) -> None:
    sd = point.spread.standard_deviations[FREQUENCY]
    centre = point.optimum.symbols[FREQUENCY]
    model = DisturbanceModel(ranges={FREQUENCY: (centre - 0.1 * sd, centre + 0.1 * sd)})
    found = Estimator(model, sampler=SHORT).fit(clean(), np.random.SeedSequence(1))
    assert found.posterior.diagnostics.outcome == "withheld"


def test_a_clear_optimum_is_answered_whatever_its_rivals() -> None:
    estimator = Estimator(sampler=SamplerSettings(ensembles=2))
    found = estimator.fit(clean(), np.random.SeedSequence(1))
    assert found.point.optimum.rivals
    assert found.posterior.diagnostics.outcome == "converged"
