"""The paper's search and model give no δ where their pulses are not the recording's."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from places import ROOT

from bayesbl.cli import status
from bayesbl.ringing import table_2
from bayesbl.ringing.symbols import SYMBOLS

RECORDING = ROOT / "configs" / "recordings" / "wear_before.csv"


def fitted(folder: Path, method: str, harmonics: int) -> tuple[int, dict]:
    config = folder / "fit.toml"
    config.write_text(
        'schema = 1\nkind = "fit"\n[[recordings]]\n'
        f'name = "before"\nfile = "{RECORDING.as_posix()}"\n'
        f"[estimator.model]\nbaseline_harmonics = {harmonics}\n"
        f'[estimator.search]\nmethod = "{method}"\n'
        "[posterior]\nensembles = 2\nmax_steps = 500\n"
        '[curve]\nsource = "published"\n[run]\noutput = "out"\n'
    )
    ended = status(["run", str(config)])
    return ended, json.loads((folder / "out" / "summary.json").read_text(encoding="utf-8"))


@pytest.mark.long
def test_pulses_fitted_to_gravitys_wave_give_no_gap(tmp_path: Path, no_figures) -> None:
    ended, summary = fitted(tmp_path, "guess", 0)
    assert ended == 3
    assert summary["delta_rad"] is None
    for word in ("gravity", "A = 56", "31.6 rpm", "baseline_harmonics = 1"):
        assert word in summary["reason"]["text"]


@pytest.mark.long
def test_a_search_that_ended_elsewhere_is_told_and_gives_no_gap(
    tmp_path: Path, no_figures, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table_2, "POPULATION", 100)
    monkeypatch.setattr(table_2, "ITERATIONS", 10)
    ended, summary = fitted(tmp_path, "paper", 0)
    assert ended == 3
    assert summary["delta_rad"] is None
    assert "missed the best fit" in summary["reason"]["text"]
    assert 'method = "guess"' in summary["reason"]["text"]
    found = summary["box_search"]
    assert found["has_pulses_of_optimum"] == 0.0
    assert found["rmse_rpm"] > summary["optimum"]["rmse_rpm"]
    assert set(SYMBOLS) < set(found)
    assert found["gap_as_printed_rad"] != 0.0
