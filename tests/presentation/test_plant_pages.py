"""Pages of a plant: what a joint's recordings say against its type is said."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plant_scale import LEVEL, simulated

from bayesbl.fleet.plant_tables import (
    JOINT_COLUMNS,
    JOINTS_FILE,
    RECORDING_COLUMNS,
    RECORDINGS_FILE,
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


def pages(folder: Path, faster: float) -> dict[str, str]:
    """Of eight joints of one type, of which the last wears ``faster`` than it was simulated."""
    made = list(simulated(24, 12, np.random.default_rng(2)))[::3]
    measured = [one for one, _ in made]
    last = measured[-1].answer
    assert last.rate_rad_per_year is not None
    answer = replace(last, rate_rad_per_year=faster * last.rate_rad_per_year)
    measured[-1] = replace(measured[-1], answer=answer)
    rows = [row for _, of_joint in made for row in of_joint]
    types, borrowed = pool(measured, "gearbox", 1)
    of_joints = joint_rows(measured, borrowed, LEVEL, None)
    write_table(rows, RECORDING_COLUMNS, folder / RECORDINGS_FILE)
    write_table(of_joints, JOINT_COLUMNS, folder / JOINTS_FILE)
    summary = summary_of(rows, of_joints, types, LEVEL, 1, "gearbox", None)
    write_json(summary, folder / SUMMARY_FILE)
    (told,) = types_in_words(summary)
    assert "wears in its own way" in told
    return {page.stem: page.read_text(encoding="utf-8") for page in write_pages(folder)}


def test_a_joint_that_wears_unlike_its_type_is_said_to_be_answered_by_its_own_recordings(tmp_path):
    found = pages(tmp_path, faster=12.0)
    assert found["index"].count(">measured, wears faster than its type") == 1
    own = [name for name, text in found.items() if "this rests on its own" in text]
    assert own == ["R004-J4"]


def test_of_a_joint_like_its_type_nothing_of_the_kind_is_said(tmp_path):
    found = pages(tmp_path, faster=1.0)
    assert not [name for name, text in found.items() if "this rests on its own" in text]
    assert "than its type" not in "".join(found.values())
