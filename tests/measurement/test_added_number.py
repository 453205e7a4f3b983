"""A number that is added to an answer is a line of its route's table, and its type."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from test_ramp_route import write

from bayesbl.config.loading import config_from_options
from bayesbl.measurement import ramp_route
from bayesbl.measurement.routes import measure
from bayesbl.results.store import summary_of
from bayesbl.results.variables import table


def test_a_line_of_a_table_is_all_that_a_number_takes(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """``docs/extending.md``, "a number of an answer"; the flanks have had this number before."""
    (added,) = table("left_by_larger! | 1 | width after larger ramps, as a share of that of these")
    cycles = ramp_route.CYCLES
    longer = replace(cycles, variables=(*cycles.variables, added))
    monkeypatch.setattr(ramp_route, "CYCLES", longer)
    file = write(tmp_path / "ramps.csv")
    tree = measure(config_from_options("fit", [file], route="torque_ramp", seed=1))
    stored = tree["torque_ramp/cycles"]["left_by_larger"]
    assert stored.attrs["long_name"] == added.meaning
    assert summary_of(tree)["left_by_larger"] == float(stored)
