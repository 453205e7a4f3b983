"""Laws of outputs and inputs: by whatever name, no output is an input."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from bayesbl.errors import ResultError
from bayesbl.results.folder import require_apart, require_inside


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "data" / "a.csv"
    path.parent.mkdir()
    path.write_text("1\n")
    return path


def test_outputs_elsewhere_are_free(recording, tmp_path):
    require_apart([tmp_path / "out", tmp_path / "b.csv"], [recording])


@pytest.mark.parametrize("name", ["data/a.csv", "data", "data/../data/a.csv", "link", "hard", "."])
def test_an_input_by_any_name_is_refused(recording, tmp_path, name):
    (tmp_path / "link").symlink_to("data")
    os.link(recording, tmp_path / "hard")
    with pytest.raises(ResultError, match="input"):
        require_apart([tmp_path / name], [recording])


def test_a_link_to_an_input_is_not_deleted_with_a_folder(recording, tmp_path):
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "a.csv").symlink_to(recording)
    with pytest.raises(ResultError, match="input"):
        require_apart([tmp_path / "old"], [tmp_path / "old" / "a.csv"])


def test_a_name_that_differs_by_case_is_another_where_the_system_says_so(recording):
    other = recording.with_name("A.csv")
    if other.exists():
        pytest.skip("this file system ignores case")
    require_apart([other], [recording])


@pytest.mark.parametrize("other", ["b.csv", "./b.csv", "B.CSV", "data/../b.csv"])
def test_two_outputs_are_two_files_on_every_system(recording, tmp_path, other):
    with pytest.raises(ResultError, match="same file"):
        require_apart([tmp_path / "b.csv", tmp_path / other], [])


def test_only_an_absolute_name_leaves_the_folder(recording, tmp_path):
    folder = tmp_path / "out"
    assert require_inside(folder, "deep/a.csv") == folder / "deep" / "a.csv"
    assert require_inside(folder, str(recording)) == recording
    folder.mkdir()
    (folder / "link").symlink_to(recording.parent)
    for name in ("../a.csv", "deep/../../a.csv", "link/a.csv"):
        with pytest.raises(ResultError, match="outside"):
            require_inside(folder, name)
