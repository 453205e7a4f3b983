"""The store of draws is Zarr's format, whoever reads it."""

from __future__ import annotations

import json

import numpy as np
import pytest

from bayesbl.fleet.plant_tables import write_draws


@pytest.fixture
def store(tmp_path):
    write_draws(tmp_path / "draws.zarr", {}, {})
    arrays = {
        "date": (("recording",), np.array(["2026-01-01", "2026-03-01"])),
        "delta_rad": (("recording", "draw"), np.arange(6.0).reshape(2, 3)),
    }
    write_draws(tmp_path / "draws.zarr/R1-J2", arrays, {"route": "direct"})
    return tmp_path / "draws.zarr"


def test_an_array_is_its_head_and_its_numbers(store):
    head = json.loads((store / "R1-J2/delta_rad/.zarray").read_text())
    assert (head["shape"], head["chunks"], head["dtype"], head["zarr_format"]) == (
        [2, 3],
        [2, 3],
        "<f8",
        2,
    )
    values = np.frombuffer((store / "R1-J2/delta_rad/0.0").read_bytes(), head["dtype"])
    np.testing.assert_array_equal(values, np.arange(6.0))


def test_zarr_and_xarray_read_it(store):
    pytest.importorskip("zarr")
    import xarray as xr

    joint = xr.open_zarr(store, group="R1-J2", consolidated=False)
    assert joint["delta_rad"].dims == ("recording", "draw")
    np.testing.assert_array_equal(joint["delta_rad"].values, np.arange(6.0).reshape(2, 3))
    assert list(joint["date"].values) == ["2026-01-01", "2026-03-01"]
