"""Results on disk: whole or absent, never written over unasked, read back or refused in words."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import netCDF4
import numpy as np
import pytest
import xarray as xr

from bayesbl.config.loading import config_from_options, dump_config
from bayesbl.errors import ResultError
from bayesbl.results import folder
from bayesbl.results.folder import is_finished, new_result, require_free
from bayesbl.results.provenance import git_commit, provenance_of
from bayesbl.results.store import read_tree, seal, write_json, write_text, write_tree


def tree(outcome: str | None = "converged") -> xr.DataTree:
    rng = np.random.default_rng(1)
    posterior = xr.Dataset(
        {"amplitude_rpm": (("chain", "draw"), rng.normal(size=(4, 500)), {"units": "rpm"})}
    )
    observed = xr.Dataset({"name": ("snapshot", ["before", "after"])})
    made = xr.DataTree.from_dict({"/posterior": posterior, "/observed_data": observed})
    made.attrs = {"seed": 1} | ({} if outcome is None else {"outcome": outcome})
    return made


def finish(path: Path, mark: str, *, force: bool = False) -> None:
    with new_result(path, force=force) as staging:
        write_json({"mark": mark}, staging / "summary.json")


def fail(path: Path, *, force: bool = False) -> None:
    with new_result(path, force=force) as staging:
        write_json({"mark": "half"}, staging / "summary.json")
        raise RuntimeError("diverged")


def mark_of(path: Path) -> object:
    return json.loads((path / "summary.json").read_text())["mark"]


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_a_result_appears_only_when_it_is_complete(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "wear"
    with new_result(path) as staging:
        write_json({}, staging / "summary.json")
        assert not path.exists()
    assert names(path) == ["manifest.json", "summary.json"]
    assert names(path.parent) == ["wear"]


def test_a_run_that_fails_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="diverged"):
        fail(tmp_path / "wear")
    assert names(tmp_path) == []


def test_a_finished_result_is_not_written_over(tmp_path: Path) -> None:
    finish(tmp_path / "wear", "first")
    with pytest.raises(ResultError, match=r"finished result.*summary\.json.*--force") as caught:
        finish(tmp_path / "wear", "second")
    assert caught.value.file == str(tmp_path / "wear")
    assert mark_of(tmp_path / "wear") == "first"
    assert names(tmp_path) == ["wear"]


def test_force_replaces_a_result_only_by_a_complete_one(tmp_path: Path) -> None:
    path = tmp_path / "wear"
    finish(path, "first")
    with pytest.raises(RuntimeError):
        fail(path, force=True)
    assert mark_of(path) == "first"
    finish(path, "second", force=True)
    assert mark_of(path) == "second"
    assert names(tmp_path) == ["wear"]


def test_of_two_runs_into_one_folder_the_slower_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "wear"
    finish(tmp_path / "other", "quicker")
    with pytest.raises(ResultError, match="finished result"), new_result(path):
        (tmp_path / "other").rename(path)
    assert mark_of(path) == "quicker"
    assert names(tmp_path) == ["wear"]


def test_an_empty_folder_is_taken_and_one_with_other_files_never(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    finish(tmp_path / "empty", "here")
    assert is_finished(tmp_path / "empty")
    assert names(tmp_path) == ["empty"]
    (tmp_path / "thesis").mkdir()
    (tmp_path / "thesis" / "chapter.tex").touch()
    for force in (False, True):
        with pytest.raises(ResultError, match=r"not part of a result.*chapter\.tex"):
            finish(tmp_path / "thesis", "here", force=force)
    assert names(tmp_path / "thesis") == ["chapter.tex"]


def test_force_deletes_nothing_that_a_user_put_beside_a_result(tmp_path: Path) -> None:
    path = tmp_path / "wear"
    finish(path, "first")
    (path / "notes.txt").write_text("grease changed")
    with pytest.raises(ResultError, match=r"notes\.txt"):
        require_free(path, force=True)
    assert names(path) == ["manifest.json", "notes.txt", "summary.json"]


def test_force_deletes_nothing_that_a_user_put_among_the_figures(tmp_path: Path) -> None:
    path = tmp_path / "wear"
    finish(path, "first")
    (path / "figures").mkdir()
    for name in ("gap.pdf", "gap.png"):
        (path / "figures" / name).write_bytes(b"%PDF /Title (gap)")
    finish(path, "second", force=True)
    (path / "figures").mkdir()
    for name in ("photograph.png", "notes.txt", "more"):
        place = path / "figures" / name
        place.mkdir() if name == "more" else place.touch()
        with pytest.raises(ResultError, match=f"figures/{name}"):
            finish(path, "third", force=True)
        place.rename(tmp_path / name)
    assert mark_of(path) == "second"


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "wear").touch()
    for path in (tmp_path / "wear", tmp_path / "wear" / "inside"):
        with pytest.raises(ResultError, match="There is a file where"):
            finish(path, "here", force=True)


def test_what_is_no_file_is_not_replaced_by_one(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    (tmp_path / "device").symlink_to("/dev/null")
    for name in ("fifo", "folder", "loop", "device"):
        with pytest.raises(ResultError, match="not a file"):
            write_text("text", tmp_path / name)
    assert names(tmp_path) == ["device", "fifo", "folder", "loop"]


def test_leftovers_of_dead_runs_are_cleared_and_those_of_living_runs_kept(tmp_path: Path) -> None:
    dead = tmp_path / ".wear.staging/wear"
    dead.mkdir(parents=True)
    dead.parent.chmod(0o700)
    (dead / "result.nc").touch()
    with new_result(tmp_path / "wear") as living:
        assert not (dead / "result.nc").exists()
        require_free(tmp_path / "wear")
        finish(tmp_path / "other", "beside")
        with pytest.raises(ResultError, match="is writing"):
            finish(tmp_path / "wear", "second")
        write_json({"mark": "living"}, living / "summary.json")
    assert mark_of(tmp_path / "wear") == "living"
    assert names(tmp_path) == ["other", "wear"]


def aside_of(path: Path) -> Path:
    """Where a result is put that another one replaces."""
    folder = path.with_name(f".{path.name}.staging")
    folder.mkdir(0o700)
    return folder / ".replaced"


def test_a_run_killed_between_the_two_renames_gives_the_old_result_back(tmp_path: Path) -> None:
    path = tmp_path / "wear"
    finish(path, "old")
    path.rename(aside_of(path))
    with pytest.raises(ResultError, match="finished result"):
        require_free(path)
    assert mark_of(path) == "old"


def test_a_run_killed_while_it_deletes_the_old_result_is_tidied_up(tmp_path: Path) -> None:
    path = tmp_path / "wear"
    finish(path, "new")
    aside = aside_of(path)
    aside.mkdir()
    (aside / "manifest.json").touch()  # the rest is deleted already
    finish(path, "newer", force=True)
    assert mark_of(path) == "newer"
    assert names(tmp_path) == ["wear"]


WRITER = """
import sys
from bayesbl.results.folder import new_result
from pathlib import Path
for number in range(1000000):
    with new_result(sys.argv[1], force=True) as staging:
        for name in ("config.toml", "result.nc"):
            (staging / name).write_text(str(number))
        (staging / "summary.json").write_text(str(number))
    print(number, flush=True)
"""


@pytest.mark.long
def test_a_kill_at_any_moment_leaves_one_whole_result(tmp_path: Path) -> None:
    path = tmp_path / "wear"
    rng = np.random.default_rng(1)
    for _ in range(8):
        writer = subprocess.Popen(
            [sys.executable, "-c", WRITER, str(path)], stdout=subprocess.PIPE, text=True
        )
        assert writer.stdout is not None
        writer.stdout.readline()
        time.sleep(float(rng.uniform(0.0, 0.03)))
        writer.send_signal(signal.SIGKILL)
        writer.communicate()
        require_free(path, force=True)
        written = ["config.toml", "result.nc", "summary.json"]
        assert names(path) == sorted([*written, "manifest.json"])
        assert len({(path / name).read_text() for name in written}) == 1


def test_folders_are_as_readable_as_any_other(tmp_path: Path) -> None:
    finish(tmp_path / "wear", "here")
    (tmp_path / "plain").mkdir()
    assert (tmp_path / "wear").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_failed_rename_puts_the_old_result_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "wear"
    finish(path, "old")
    real = Path.rename

    def fails_for_staging(source: Path, target: Path) -> Path:
        if source.parent.name.endswith(".staging") and source.name == "wear":
            raise OSError("disk full")
        return real(source, target)

    monkeypatch.setattr(folder.Path, "rename", fails_for_staging)
    with pytest.raises(OSError, match="disk full"):
        finish(path, "new", force=True)
    assert mark_of(path) == "old"
    assert names(tmp_path) == ["wear"]


def test_a_tree_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    written = tree()
    write_tree(written, tmp_path / "result.nc")
    read = read_tree(tmp_path)
    xr.testing.assert_equal(read["posterior"].to_dataset(), written["posterior"].to_dataset())
    assert read["posterior"]["amplitude_rpm"].attrs["units"] == "rpm"
    assert read.attrs["outcome"] == "converged"
    assert "bayesbl_format" not in written.attrs
    assert names(tmp_path) == ["result.nc"]


def test_a_read_result_keeps_no_file_open(tmp_path: Path) -> None:
    write_tree(tree(), tmp_path / "result.nc")
    read = read_tree(tmp_path)
    os.remove(tmp_path / "result.nc")
    assert np.isfinite(read["posterior"]["amplitude_rpm"].values).all()


def test_unusable_result_files_are_refused_with_the_reason(tmp_path: Path) -> None:
    whole = tmp_path / "result.nc"
    write_tree(tree(), whole)
    (tmp_path / "cut.nc").write_bytes(whole.read_bytes()[:5000])
    (tmp_path / "text.nc").write_text("not NetCDF")
    xr.Dataset({"x": 1}).to_netcdf(tmp_path / "foreign.nc")
    write_tree(tree(outcome=None), tmp_path / "unfinished.nc")
    write_tree(tree(outcome="running"), tmp_path / "running.nc")
    later = tree()
    write_tree(later, tmp_path / "later.nc")
    with netCDF4.Dataset(tmp_path / "later.nc", "a") as file:
        file.setncattr("bayesbl_format", 99)
    seal(tmp_path / "later.nc")
    for name, words in (
        ("none.nc", "no such result"),
        ("cut.nc", "not a result as"),
        ("text.nc", "not a result as"),
        ("foreign.nc", "not a result as"),
        ("unfinished.nc", "not finished"),
        ("running.nc", "not finished"),
        ("later.nc", "later version"),
    ):
        with pytest.raises(ResultError, match=words) as caught:
            read_tree(tmp_path / name)
        assert caught.value.file == str(tmp_path / name)
        assert caught.value.expected


def change_a_number(file: netCDF4.Dataset) -> None:
    values = file["posterior/amplitude_rpm"]
    values[2, 7] = np.nextafter(values[2, 7], 9.0)


def change_an_attribute(file: netCDF4.Dataset) -> None:
    file["posterior/amplitude_rpm"].units = "rad"


def change_a_text(file: netCDF4.Dataset) -> None:
    file["observed_data/name"][0] = "later"


def rename_a_dimension(file: netCDF4.Dataset) -> None:
    file["posterior"].renameDimension("draw", "drawn")


def rename_a_group(file: netCDF4.Dataset) -> None:
    file.renameGroup("posterior", "prior")


def add_a_variable(file: netCDF4.Dataset) -> None:
    file["posterior"].createVariable("delta_rad", "f8")


def change_the_seed(file: netCDF4.Dataset) -> None:
    file.setncattr("seed", 2)


@pytest.mark.parametrize(
    "change",
    [
        change_a_number,
        change_an_attribute,
        change_a_text,
        rename_a_dimension,
        rename_a_group,
        add_a_variable,
        change_the_seed,
    ],
)
def test_whatever_is_changed_in_a_result_is_refused(
    tmp_path: Path, change: Callable[[netCDF4.Dataset], None]
) -> None:
    path = tmp_path / "result.nc"
    write_tree(tree(), path)
    read_tree(path)
    with netCDF4.Dataset(path, "a") as file:
        change(file)
    with pytest.raises(ResultError, match="changed"):
        read_tree(path)


@pytest.mark.parametrize("place", [0.01, 0.5, 0.99, -1])
def test_a_damaged_byte_is_found_before_a_library_opens_the_file(
    tmp_path: Path, place: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """HDF5 may hang or crash on what is damaged."""
    path = tmp_path / "result.nc"
    write_tree(tree(), path)
    content = bytearray(path.read_bytes())
    content[place if place < 0 else int(place * len(content))] ^= 1
    path.write_bytes(content)

    def opened(*_: object, **__: object) -> None:
        pytest.fail("a library opened a damaged file")

    monkeypatch.setattr(xr, "open_datatree", opened)
    with pytest.raises(ResultError, match="damaged"):
        read_tree(path)


def test_a_result_opens_in_the_libraries_of_its_format(tmp_path: Path) -> None:
    """What follows the end that the file states disturbs no reader."""
    write_tree(tree(), tmp_path / "result.nc")
    with netCDF4.Dataset(tmp_path / "result.nc") as file:
        assert file["posterior/amplitude_rpm"].shape == (4, 500)
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "result.nc") as file:
        assert file["posterior/amplitude_rpm"].shape == (4, 500)


def test_a_result_that_was_read_can_be_written_again(tmp_path: Path) -> None:
    write_tree(tree(), tmp_path / "first.nc")
    read = read_tree(tmp_path / "first.nc")
    read.attrs["seed"] = 2
    write_tree(read, tmp_path / "second.nc")
    assert read_tree(tmp_path / "second.nc").attrs["seed"] == 2


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path: Path) -> None:
    path = tmp_path / "summary.json"
    write_json({"a": 1}, path)
    with pytest.raises(ValueError, match="object is not for JSON"):
        write_json({"a": object()}, path)
    with pytest.raises(UnicodeEncodeError):
        write_text("\ud800", path)
    assert json.loads(path.read_text()) == {"a": 1}
    assert names(tmp_path) == ["summary.json"]


def test_json_is_plain_and_what_is_not_finite_is_null(tmp_path: Path) -> None:
    content = {
        "nan": float("nan"),
        "inf": np.float64(np.inf),
        "array": np.array([1.0, np.nan]),
        "count": np.int64(3),
        "flag": np.bool_(True),
        "pair": (1, 2),
        "path": Path("a"),
    }
    write_json(content, tmp_path / "summary.json")
    assert json.loads((tmp_path / "summary.json").read_text()) == {
        "nan": None,
        "inf": None,
        "array": [1.0, None],
        "count": 3,
        "flag": True,
        "pair": [1, 2],
        "path": "a",
    }


def test_provenance_can_be_stored_and_tells_version_commit_and_inputs(tmp_path: Path) -> None:
    recording = tmp_path / "before.csv"
    recording.write_bytes(b"time_s,motor_speed_rpm")
    config = config_from_options("fit", [recording], seed=7)
    attributes = provenance_of(config)
    assert attributes["seed"] == 7
    sha256 = hashlib.sha256(recording.read_bytes()).hexdigest()
    assert json.loads(str(attributes["input_sha256"])) == {str(recording): sha256}
    assert "numpy" in json.loads(str(attributes["dependency_versions"]))
    marked = tree()
    marked.attrs |= attributes
    write_tree(marked, tmp_path / "result.nc")
    assert read_tree(tmp_path).attrs["config"] == dump_config(config)


def test_the_commit_is_that_of_the_packages_own_checkout_even_inside_a_hook(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    before = git_commit()
    git_commit.cache_clear()
    monkeypatch.setenv("GIT_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert git_commit().removesuffix("-dirty") == before.removesuffix("-dirty")
    assert before == "unknown" or len(before.removesuffix("-dirty")) in (40, 64)
