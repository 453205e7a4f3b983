"""Declared variables: what is written is as declared."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
import xarray as xr

from bayesbl.results.variables import Group, Variable, dataset, datasets, labels, table

DRAWN = Group(
    "drawn",
    (
        Variable("gap_rad", ("chain", "draw"), "rad", "backlash gap"),
        Variable("note", (), "text", "a remark"),
        Variable("spread", ("draw",), "1", "scatter", optional=True),
    ),
    (labels("chain", "ensemble"),),
    named=lambda name: Variable(name, (), "A", "a channel") if name.startswith("i_") else None,
)
VALUES = {"gap_rad": np.ones((2, 3)), "note": "fine", "i_motor": 4, "spread": None}
LABELS = {"chain": ["first", "second"]}


def test_every_variable_has_the_dimensions_unit_and_meaning_of_its_declaration():
    made = dataset(DRAWN, VALUES, LABELS)
    for name in ("gap_rad", "note", "i_motor", "chain"):
        declared = DRAWN.variable(name)
        assert made[name].dims == declared.dims
        unit = "" if declared.unit == "text" else declared.unit
        assert made[name].attrs == {"units": unit, "long_name": declared.meaning}
    assert "spread" not in made
    assert made["i_motor"].dtype == np.float64


def test_a_written_group_reads_back_as_it_was_given(tmp_path):
    xr.DataTree.from_dict({"drawn": dataset(DRAWN, VALUES, LABELS)}).to_netcdf(tmp_path / "r.nc")
    with xr.open_datatree(tmp_path / "r.nc") as opened:
        tree = opened.load()
    found = tree["drawn"].to_dataset()
    np.testing.assert_array_equal(found["gap_rad"].values, VALUES["gap_rad"])
    assert found["note"].item() == "fine"
    assert found["chain"].values.tolist() == LABELS["chain"]


@pytest.mark.parametrize(
    ("values", "error"),
    [
        ({**VALUES, "speed": 1.0}, KeyError),
        ({"note": "fine"}, KeyError),
        ({**VALUES, "gap_rad": np.ones(3)}, ValueError),
    ],
)
def test_only_what_is_declared_can_be_written_and_all_of_it_must(values, error):
    with pytest.raises(error):
        dataset(DRAWN, values, LABELS)


def test_sources_are_mappings_and_objects_and_numbers_along_a_dimension_count_by_themselves():
    numbered = Group("drawn", DRAWN.variables, table("draw (draw) | 1 | number of the draw"))
    source = SimpleNamespace(gap_rad=np.ones((2, 3)), note="first", undeclared=1.0)
    made = datasets({numbered: (source, None, {"note": "later"})})["drawn"]
    assert made["note"].item() == "later"
    assert made["draw"].values.tolist() == [0, 1, 2]
    assert set(made.variables) == {"gap_rad", "note", "draw"}
