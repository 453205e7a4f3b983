"""Stored results of any kind lack nothing that they declare, or are refused in one message."""

from __future__ import annotations

import pytest
import xarray as xr

from bayesbl.errors import ResultError
from bayesbl.results.store import write_tree
from bayesbl.runs.kinds import read_result

ROW = xr.Dataset({name: ("case", [0.0]) for name in ("failed", "seconds", "own")})
TEXTS = xr.Dataset({name: ("case", ["text"]) for name in ("message", "commit")})


@pytest.mark.parametrize(
    ("attributes", "groups", "told"),
    [
        ({"kind": "identify"}, {}, "identified: no such group"),
        ({"kind": "diagnose"}, {}, "no diagnosis"),
        ({"kind": "study"}, {"row_1": ROW}, "row_1: no message; row_1: no commit"),
        ({"kind": "study"}, {"row_2": ROW.merge(TEXTS).isel(case=0)}, "failed over ()"),
        ({"kind": "study"}, {}, "no study"),
        ({"kind": "fit", "routes": ["scenic"]}, {}, "routes scenic"),
        ({"kind": "compare"}, {}, "routes none"),
        ({"kind": "scenic"}, {}, "kind 'scenic'"),
    ],
)
def test_what_is_missing_is_one_message_that_names_the_file(tmp_path, attributes, groups, told):
    tree = xr.DataTree.from_dict(groups)
    tree.attrs = {"outcome": "done", **attributes}
    write_tree(tree, tmp_path / "result.nc")
    with pytest.raises(ResultError) as refusal:
        read_result(tmp_path)
    assert told in str(refusal.value)
    assert str(refusal.value).startswith(str(tmp_path))


def test_a_study_may_hold_groups_that_are_no_rows(tmp_path):
    row = ROW.merge(TEXTS).assign_coords(case=[0])
    tree = xr.DataTree.from_dict({"row_1": row, "notes": ROW})
    tree.attrs = {"outcome": "done", "kind": "study", "study": "{}"}
    write_tree(tree, tmp_path / "result.nc")
    assert "row_1" in read_result(tmp_path).children
