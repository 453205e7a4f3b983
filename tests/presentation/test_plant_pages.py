"""Pages of a plant: what a joint's recordings say against its type is said."""

from __future__ import annotations

from dataclasses import replace
from datetime import date as Date
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from plant_scale import LEVEL, config_of, simulated

from bayesbl.fleet.plant_tables import (
    JOINT_COLUMNS,
    JOINTS_FILE,
    RECORDING_COLUMNS,
    RECORDINGS_FILE,
    Measured,
    joint_rows,
    pool,
    write_table,
)
from bayesbl.presentation.fleet import types_in_words
from bayesbl.presentation.page.plant import write_pages
from bayesbl.results.folder import SUMMARY_FILE
from bayesbl.results.store import write_json
from bayesbl.runs.fleet import summary_of

pytest.importorskip("pyarrow")


def eight() -> tuple[list[Measured], list[dict[str, Any]]]:
    """Joints of one type, and the rows of their recordings."""
    made = list(simulated(24, 12, np.random.default_rng(2)))[::3]
    return [one for one, _ in made], [row for _, of_joint in made for row in of_joint]


def pages(folder: Path, faster: float) -> dict[str, str]:
    """Of eight joints of one type, of which the last wears ``faster`` than it was simulated."""
    measured, rows = eight()
    last = measured[-1].answer
    assert last.wear is not None
    wear = replace(last.wear, rate_rad_per_year=faster * last.wear.rate_rad_per_year)
    measured[-1] = replace(measured[-1], answer=replace(last, wear=wear))
    types, borrowed = pool(measured, "gearbox", 1)
    of_joints = joint_rows(measured, borrowed, LEVEL, None)
    write_table(rows, RECORDING_COLUMNS, folder / RECORDINGS_FILE)
    write_table(of_joints, JOINT_COLUMNS, folder / JOINTS_FILE)
    summary = summary_of(config_of("gearbox", None), rows, of_joints, types)
    write_json(summary, folder / SUMMARY_FILE)
    (told,) = types_in_words(summary)
    assert "Share of joints unlike the rest" in told
    return {page.stem: page.read_text(encoding="utf-8") for page in write_pages(folder)}


def test_a_joint_that_wears_unlike_its_type_is_said_to_be_answered_by_its_own_recordings(tmp_path):
    found = pages(tmp_path, faster=12.0)
    assert found["index"].count(">measured, wears faster than its type") == 1
    own = [name for name, text in found.items() if "by its own recordings alone" in text]
    assert own == ["R004-J4"]


def test_of_a_joint_like_its_type_nothing_of_the_kind_is_said(tmp_path):
    found = pages(tmp_path, faster=1.0)
    assert not [name for name, text in found.items() if "by its own recordings alone" in text]
    assert "than its type" not in "".join(found.values())


def test_joints_are_ranked_by_what_each_is_expected_to_cost(tmp_path):
    measured, rows = eight()
    before = Date(2027, 6, 1)
    by_date = joint_rows(measured, {}, LEVEL, before)
    # Dearest where it is least urgent.
    costs = {row["joint"]: 10.0 ** (2 * n) for n, row in enumerate(by_date)}
    priced = [
        replace(one, joint=one.joint.model_copy(update={"cost_at_limit": costs[one.joint.name]}))
        for one in measured
    ]
    by_cost = joint_rows(priced, {}, LEVEL, before)
    expected = [row["expected_cost"] for row in by_cost]
    assert expected == sorted(expected, reverse=True)
    for row in by_cost:
        chance = row["probability_limit_before"]
        assert row["expected_cost"] == chance * costs[row["joint"]]
    write_table(rows, RECORDING_COLUMNS, tmp_path / RECORDINGS_FILE)
    write_table(by_cost, JOINT_COLUMNS, tmp_path / JOINTS_FILE)
    summary = summary_of(config_of(None, before), rows, by_cost, {})
    write_json(summary, tmp_path / SUMMARY_FILE)
    index, *_ = write_pages(tmp_path)
    text = index.read_text(encoding="utf-8")
    assert "Expected cost before 2027-06-01" in text
    assert f">{expected[0]:,.0f}<" in text
