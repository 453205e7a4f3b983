"""Nested sampling beside emcee on the same posterior: where both agree, and where they must not."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from test_convergence import ambiguous, clean

from bayesbl import cli
from bayesbl.recording.types import Recording
from bayesbl.ringing.estimator import Estimator, Fit
from bayesbl.ringing.second_sampler import SamplerCheck
from bayesbl.ringing.symbols import AMPLITUDE
from bayesbl.sampling.chains import SamplerSettings

pytest.importorskip("dynesty")

RECORDING = Path(__file__).parents[2] / "configs" / "recordings" / "wear_before.csv"


def checked(recording: Recording) -> Fit:
    estimator = Estimator(sampler=SamplerSettings(ensembles=2))
    return estimator.fit(recording, np.random.SeedSequence(3), check=True)


def test_both_samplers_agree_on_a_posterior_with_one_mode() -> None:
    check = checked(clean()).check
    assert check is not None
    # Some thousand effective draws on either side: differences of 0.1 sd would be four sigma.
    assert max(abs(d) for d in check.difference_sd.values()) < 0.12
    assert all(0.9 < ratio < 1.1 for ratio in check.width_ratio.values())
    assert check.reason is None


def test_a_mode_that_emcee_does_not_reach_is_reported() -> None:
    fit = checked(ambiguous())
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
    check = SamplerCheck({AMPLITUDE: difference}, {AMPLITUDE: ratio}, 1)
    assert (check.reason is None) == agrees


def test_the_check_is_stored_and_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("bayesbl.library.draw", lambda tree, folder: [])
    monkeypatch.chdir(tmp_path)
    options = ["--check-sampler", "--out", "out"]
    assert cli.status(["fit", str(RECORDING), *options]) == 0
    assert "Nested sampling agrees with emcee" in capsys.readouterr().out
    summary = json.loads(Path("out/summary.json").read_text())
    assert summary["sampler_check"]["agrees"] is True
    assert summary["sampler_check"]["symbols"].keys() == summary["parameters"].keys()


def test_without_the_sampler_the_extra_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "dynesty", None)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    options = ["--check-sampler", "--out", str(tmp_path / "out")]
    assert cli.status(["fit", str(RECORDING), *options]) == 2
    assert "pip install 'bayesbl[check]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    config = tmp_path / "fit.toml"
    config.write_text(
        f'schema = 1\nkind = "fit"\n[run]\noutput = "out"\n[[recordings]]\nfile = "{RECORDING}"\n'
        "[posterior]\ncheck_sampler = true\n"
    )
    assert cli.status(["check", str(config)]) == 2
    assert "pip install 'bayesbl[check]'" in capsys.readouterr().err
