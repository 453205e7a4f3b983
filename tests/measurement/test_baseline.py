"""The paper's own model has no baseline: it is measured and stored as any other."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from made_recordings import synthetic_recording
from quick import two_ensembles, without_figures
from recording_files import write_csv
from synthetic_ringing import NOISE, STRONG

from bayesbl import cli
from bayesbl.results.store import read_tree
from bayesbl.ringing.symbols import AMPLITUDE


@pytest.mark.long
def test_a_model_without_baseline_is_measured_and_stored(tmp_path: Path) -> None:
    recording = synthetic_recording(STRONG, NOISE, np.random.default_rng(1))
    columns = {"time_s": recording.time_s, "motor_speed_rpm": recording.motor_speed_rpm}
    file = write_csv(tmp_path / "recording.csv", columns)
    config = two_ensembles(tmp_path, "fit")
    config.write_text(config.read_text() + "[estimator.model]\nbaseline_harmonics = 0\n")
    out = tmp_path / "out"
    with without_figures():
        assert cli.status(["fit", str(file), "--config", str(config), "--out", str(out)]) == 0
    posterior = read_tree(out)["amplitude/posterior"].to_dataset()
    assert posterior.sizes["baseline_term"] == 0
    found = posterior[AMPLITUDE]
    assert float(found.mean()) == pytest.approx(STRONG[AMPLITUDE], abs=4.0 * float(found.std()))
