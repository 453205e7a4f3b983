"""Folders that others may have put there: never followed, never emptied, never believed."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from bayesbl.errors import ResultError
from bayesbl.results.folder import locked_sibling, new_result, require_free
from bayesbl.results.work import WorkStore

AS_NOBODY = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root makes another's folder"
)
NOBODY = 65534


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A folder with a file that nobody here may touch."""
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign/thesis.tex").write_text("mine")
    return tmp_path / "foreign"


def make(path: Path) -> None:
    with new_result(path, force=True) as folder:
        (folder / "summary.json").write_text("{}")


@pytest.mark.parametrize("suffix", [".running", ".kept", ".growing"])
def test_a_link_planted_where_a_run_keeps_its_work_is_refused(tmp_path, foreign, suffix):
    (tmp_path / f".out{suffix}").symlink_to(foreign, target_is_directory=True)
    with (
        pytest.raises(ResultError, match="somebody else"),
        locked_sibling(tmp_path / "out", suffix),
    ):
        pass
    assert (foreign / "thesis.tex").read_text() == "mine"


@pytest.mark.parametrize("mode", [0o770, 0o707])
def test_a_folder_that_others_can_write_is_not_taken_for_our_own(tmp_path, mode):
    planted = tmp_path / ".out.kept"
    planted.mkdir()
    planted.chmod(mode)
    with pytest.raises(ResultError, match="chmod 700"), locked_sibling(tmp_path / "out", ".kept"):
        pass


@AS_NOBODY
def test_a_folder_of_another_user_is_not_taken_for_our_own(tmp_path):
    planted = tmp_path / ".out.kept"
    planted.mkdir(0o700)
    os.chown(planted, NOBODY, NOBODY)
    with (
        pytest.raises(ResultError, match="somebody else"),
        locked_sibling(tmp_path / "out", ".kept"),
    ):
        pass
    assert WorkStore.shared(planted).folder is None


def test_a_planted_staging_folder_is_not_followed(tmp_path, foreign):
    (tmp_path / ".out.staging").symlink_to(foreign, target_is_directory=True)
    with pytest.raises(ResultError, match="somebody else"):
        make(tmp_path / "out")
    assert (foreign / "thesis.tex").read_text() == "mine"


def test_a_store_that_becomes_a_link_is_neither_read_nor_written_nor_emptied(tmp_path, foreign):
    store = WorkStore(tmp_path / "kept")
    store.keep("work", 1, np.arange(3))
    (tmp_path / "kept").rename(tmp_path / "moved")
    (tmp_path / "kept").symlink_to(tmp_path / "moved", target_is_directory=True)
    assert store.recall("work", 1, np.ndarray) is None
    before = sorted((tmp_path / "moved").iterdir())
    for act in (
        lambda: store.keep("work", 2, np.arange(3)),
        lambda: store.keep_only(()),
        lambda: store.keep_latest(size_bytes=0),
    ):
        with pytest.raises(ResultError, match="somebody else"):
            act()
    assert sorted((tmp_path / "moved").iterdir()) == before
    assert WorkStore.shared(tmp_path / "kept").folder is None


def test_what_is_kept_is_readable_by_its_owner_alone(tmp_path):
    store = WorkStore(tmp_path / "deep/kept")
    store.keep("work", 1, np.arange(3))
    assert (tmp_path / "deep/kept").stat().st_mode & 0o777 == 0o700
    (entry,) = (tmp_path / "deep/kept").iterdir()
    assert entry.stat().st_mode & 0o777 == 0o600


def test_a_link_in_the_place_of_the_output_folder_is_refused(tmp_path, foreign):
    (tmp_path / "out").symlink_to(foreign, target_is_directory=True)
    for force in (False, True):
        with pytest.raises(ResultError, match="There is a link where"):
            require_free(tmp_path / "out", force=force)
    assert (tmp_path / "out").is_symlink()


def test_a_mount_point_is_refused_before_the_run():
    with pytest.raises(ResultError, match=r"mounted here.*--out"):
        require_free("/proc")


def test_only_what_the_manifest_lists_is_replaced(tmp_path):
    out = tmp_path / "out"
    with new_result(out) as folder:
        (folder / "summary.json").write_text("{}")
        (folder / "joints").mkdir()
        (folder / "joints/J1.html").write_text("page")
    for name in ("joints/my_notes.html", "joints/more/deep.txt", "link"):
        note = out / name
        note.parent.mkdir(exist_ok=True)
        note.symlink_to(tmp_path) if name == "link" else note.write_text("mine")
        with pytest.raises(ResultError, match="not part of a result"):
            require_free(out, force=True)
        note.unlink()
        if note.parent.name == "more":
            note.parent.rmdir()
    make(out)
    assert sorted(entry.name for entry in out.iterdir()) == ["manifest.json", "summary.json"]


def test_work_is_whole_or_absent_and_a_full_disk_leaves_none(tmp_path, monkeypatch):
    store = WorkStore(tmp_path / "kept")
    store.keep("work", 1, np.arange(3))
    before = os.listdir(tmp_path / "kept")
    monkeypatch.setattr(os, "replace", lambda *_, **__: (_ for _ in ()).throw(OSError(28, "full")))
    with pytest.raises(OSError, match="full") as caught:
        store.keep("work", 2, np.arange(3))
    assert str(caught.value.filename).startswith(str(tmp_path / "kept"))
    assert store.recall("work", 1, np.ndarray) is not None
    assert os.listdir(tmp_path / "kept") == before


def test_what_is_being_written_is_not_forgotten_with_what_is_not_needed(tmp_path):
    store = WorkStore(tmp_path / "kept")
    store.keep("work", 1, np.arange(3))
    (tmp_path / "kept/other.part").touch()
    store.keep_only(())
    assert os.listdir(tmp_path / "kept") == ["other.part"]
