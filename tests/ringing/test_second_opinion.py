"""Nested sampling beside emcee on the same posterior: where both agree, and where they must not."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from places import BEFORE
from quick import two_ensembles
from recording_files import write_csv
from synthetic_ringing import ambiguous, clean

from bayesbl import cli
from bayesbl.recording.types import MOTOR_SPEED
from bayesbl.ringing.estimator import Estimator
from bayesbl.ringing.posterior import SamplerCheck
from bayesbl.ringing.symbols import AMPLITUDE
from bayesbl.sampling.chains import SamplerSettings

pytestmark = pytest.mark.long

pytest.importorskip("dynesty")


def test_both_samplers_agree_on_a_posterior_with_one_mode_and_it_is_stored_and_printed(
    tmp_path: Path, no_figures: None, capsys: pytest.CaptureFixture[str]
) -> None:
    measured = clean()
    columns = {"time_s": measured.time_s, MOTOR_SPEED: measured.motor_speed_rpm}
    file, config = write_csv(tmp_path / "clean.csv", columns), two_ensembles(tmp_path, "fit")
    options = ["--check-sampler", "--config", str(config), "--out", str(tmp_path / "out")]
    assert cli.status(["fit", str(file), *options]) == 0
    assert "Nested sampling agrees with emcee" in capsys.readouterr().out
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    check = summary["sampler_check"]
    assert check["agrees"] is True
    assert check["symbols"].keys() == summary["parameters"].keys()
    # Some thousand effective draws on either side: differences of 0.1 sd would be four sigma.
    for symbol in check["symbols"].values():
        assert abs(symbol["difference_sd"]) < 0.12
        assert 0.9 < symbol["width_ratio"] < 1.1


def test_a_mode_that_emcee_does_not_reach_is_reported() -> None:
    estimator = Estimator(sampler=SamplerSettings(ensembles=2))
    fit = estimator.fit(ambiguous(), np.random.SeedSequence(3), check=True)
    assert fit.check is not None
    assert AMPLITUDE in fit.check.differing
    assert fit.check.reason is not None
    assert "disagrees with emcee" in fit.check.reason


@pytest.mark.parametrize(
    ("difference", "ratio", "agrees"),
    [(0.1, 1.1, True), (-0.3, 1.0, False), (0.0, 1.3, False), (0.0, 0.7, False)],
)
def test_a_disagreement_in_place_or_width_is_one(
    difference: float, ratio: float, agrees: bool
) -> None:
    check = SamplerCheck({AMPLITUDE: difference}, {AMPLITUDE: ratio})
    assert (check.reason is None) == agrees


def test_without_the_sampler_the_extra_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "dynesty", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    options = ["--check-sampler", "--out", str(tmp_path / "out")]
    assert cli.status(["fit", str(BEFORE), *options]) == 2
    assert "pip install 'bayesbl[check]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    config = tmp_path / "fit.toml"
    config.write_text(
        f'schema = 1\nkind = "fit"\n[run]\noutput = "out"\n[[recordings]]\nfile = "{BEFORE}"\n'
        "[posterior]\ncheck_sampler = true\n"
    )
    assert cli.status(["check", str(config)]) == 2
    assert "pip install 'bayesbl[check]'" in capsys.readouterr().err
