"""What a command's process loads, and that the extras it was spared can be used in it later."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from fresh_process import loaded_by
from places import RECORDINGS

from bayesbl.libraries import absent
from bayesbl.processes import processes

SPARED = {"dask", "distributed", "h5py", "matplotlib", "pyarrow"}


def test_a_fit_loads_only_what_it_uses(tmp_path):
    pytest.importorskip("dask")
    pytest.importorskip("pyarrow")
    file = RECORDINGS / "wear_before.csv"
    command = ["--no-figures", "fit", str(file), "--out", str(tmp_path / "fit")]
    loaded = loaded_by(f"from bayesbl.cli import status; assert status({command}) == 0")
    assert {"pandas", "xarray", "cma", "emcee"} <= loaded
    assert not loaded & SPARED


def loaded_here() -> set[str]:
    return {name.partition(".")[0] for name, module in sys.modules.items() if module is not None}


def test_a_worker_loads_only_what_a_command_does():
    pytest.importorskip("dask")
    pytest.importorskip("pyarrow")
    with processes(1) as pool:
        loaded = pool.submit(loaded_here).result()
    assert {"pandas", "xarray", "cma", "emcee"} <= loaded
    assert not loaded & SPARED


def run(code: str) -> None:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr


def test_extras_work_after_libraries_were_imported_without_them(tmp_path: Path):
    for name in ("dask", "distributed", "h5py", "pyarrow"):
        pytest.importorskip(name)
    run(f"""
from bayesbl.libraries import bare
with bare():
    import cma, emcee, numpy, pandas, xarray
    xarray.Dataset({{"a": ("x", [1.0, 2.0])}}).to_netcdf("{tmp_path}/a.nc", engine="netcdf4")
    assert float(xarray.open_dataset("{tmp_path}/a.nc").a.sum()) == 3.0

import dask.array, distributed, h5py, matplotlib.figure, pyarrow.parquet, scipy.stats
pandas.DataFrame({{"a": [1.0, 2.0], "b": ["x", "y"]}}).to_parquet("{tmp_path}/a.parquet")
table = pyarrow.parquet.read_table("{tmp_path}/a.parquet")
assert table.column("b").to_numpy().tolist() == ["x", "y"]
assert pandas.read_parquet("{tmp_path}/a.parquet").b.tolist() == ["x", "y"]
with h5py.File("{tmp_path}/a.h5", "w") as file:
    file["a"] = numpy.arange(3)
assert dask.array.arange(4).sum().compute() == 6
xarray.Dataset({{"a": ("x", [1.0, 2.0])}}).to_netcdf("{tmp_path}/b.nc", engine="netcdf4")
""")


def test_xarray_that_knows_of_dask_keeps_it():
    pytest.importorskip("dask")
    run("""
import xarray
from bayesbl.libraries import bare
with bare():
    import dask.array
    assert xarray.DataArray(dask.array.arange(4)).sum().compute() == 6
""")


def test_what_is_loaded_is_never_hidden():
    with absent("json", "no_such_module"):
        import json

        assert json.loads("1") == 1
        with pytest.raises(ImportError):
            import no_such_module  # type: ignore[import-not-found]  # noqa: F401
    assert "no_such_module" not in sys.modules
