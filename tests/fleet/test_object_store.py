"""Recordings of an object store are those of a folder: found, copied once, again if changed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import fsspec
import pytest

from bayesbl.config.loading import load_config
from bayesbl.errors import ConfigError
from bayesbl.fleet.inventory import fetched, find_recordings, read_joints
from bayesbl.recording.input_bytes import LIMIT_VARIABLE

CONFIG = """schema = 1
kind = "fleet"
[fleet]
joints = "joints.csv"
recordings = "{recordings}"
"""


@pytest.fixture
def store(tmp_path: Path):
    """A store in memory, empty; the plant's inventory in ``tmp_path``."""
    (tmp_path / "joints.csv").write_text("joint\nR1-J2\nR1-J3\n")
    memory = fsspec.filesystem("memory")
    memory.store.clear()
    yield memory
    memory.store.clear()


def found(folder: Path, recordings: str):
    (folder / "fleet.toml").write_text(CONFIG.format(recordings=recordings))
    section = load_config(folder / "fleet.toml").fleet
    return find_recordings(section, read_joints(section))


PATTERN = "memory://plant/{joint}/speed {date}.csv"


def test_a_store_and_a_folder_give_the_same_recordings(store, tmp_path):
    for name in ("R1-J2/speed 2026-03-01", "R1-J3/speed spring", "R9-J9/speed 2026-01-01"):
        store.pipe(f"/plant/{name}.csv", name.encode())
        (tmp_path / "plant" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "plant" / f"{name}.csv").write_text(name)
    remote, local = (
        fetched(found(tmp_path, way), tmp_path / place)
        for place, way in (("copies", PATTERN), ("none", PATTERN.removeprefix("memory://")))
    )
    assert [replace(one, file="", address=None) for one in remote] == [
        replace(one, file="") for one in local
    ]
    first = next(one for one in remote if one.reason is None)
    assert first.address == "memory://plant/R1-J2/speed 2026-03-01.csv"
    assert Path(first.file).suffix == ".csv"
    assert Path(first.file).read_text() == "R1-J2/speed 2026-03-01"


def test_a_file_is_copied_once_and_again_when_it_has_changed(store, tmp_path):
    copies = tmp_path / "copies"

    def taken() -> Path:
        (one,) = fetched(found(tmp_path, PATTERN), copies)
        return Path(one.file)

    store.pipe("/plant/R1-J2/speed 2026-03-01.csv", b"first")
    first = taken()
    first.write_bytes(b"kept as it is")
    assert taken() == first
    assert first.read_bytes() == b"kept as it is"
    store.pipe("/plant/R1-J2/speed 2026-03-01.csv", b"second")
    assert taken().read_bytes() == b"second"
    assert [path.name for path in copies.iterdir()] == [taken().name]


def test_what_cannot_be_had_is_a_row_with_its_reason(store, tmp_path, monkeypatch):
    monkeypatch.setenv(LIMIT_VARIABLE, "0.001")
    store.pipe("/plant/a.csv", b"x" * 2000)
    table = "joint,date,file\nR1-J2,2026-01-01,memory://plant/a.csv\n"
    table += "R1-J3,2026-01-01,memory://plant/none.csv\n"
    (tmp_path / "table.csv").write_text(table)
    large, none = fetched(found(tmp_path, "table.csv"), tmp_path / "copies")
    assert "MB" in str(large.reason)
    assert "none.csv" in str(none.reason)
    assert not list((tmp_path / "copies").glob("*"))


def test_a_store_that_is_none_is_refused_in_words(store, tmp_path):
    with pytest.raises(ConfigError, match="cannot be listed"):
        found(tmp_path, "nowhere://plant/{joint}/{date}.csv")
