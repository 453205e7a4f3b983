"""A table that grows: each answer once, in a fleet's order, whatever comes in between."""

from __future__ import annotations

import pytest

from bayesbl.errors import ResultError
from bayesbl.fleet.plant_tables import RECORDING_COLUMNS, RecordingTable

pytest.importorskip("pyarrow")


def row(joint="J1", date="2025-01-01", content="a", **more):
    made = dict.fromkeys(RECORDING_COLUMNS)
    made |= {"joint": joint, "date": date, "file": f"{joint}/{date}.csv", "outcome": "usable"}
    return made | {"sha256": content and content * 64, "delta_rad_median": 1e-3} | more


def rows(output):
    with RecordingTable.opened(output) as table:
        return table.rows


def put(output, *some):
    """Put and save; what changed."""
    with RecordingTable.opened(output) as table:
        changed = [new for new in some if table.put(new)]
        table.save()
    return changed


def test_rows_are_there_again_and_in_a_fleets_order(tmp_path):
    later, first, other = row(date="2025-02-01", content="b"), row(), row("A1", content="c")
    assert put(tmp_path / "out", later, first, other) == [later, first, other]
    assert rows(tmp_path / "out") == [other, first, later]
    assert put(tmp_path / "out", first, later) == []
    assert len(rows(tmp_path / "out")) == 3


def test_the_same_bytes_of_a_joint_are_one_row(tmp_path):
    put(tmp_path / "out", row(), row(date="2025-06-01"))
    assert [one["date"] for one in rows(tmp_path / "out")] == ["2025-01-01"]


def test_a_file_that_holds_something_else_now_has_one_row(tmp_path):
    put(tmp_path / "out", row(content=None, outcome="refused", reason="cut short"), row())
    put(tmp_path / "out", row(content="b"))
    (found,) = rows(tmp_path / "out")
    assert (found["sha256"], found["outcome"]) == ("b" * 64, "usable")


def test_a_device_takes_nothing_from_the_rows_of_another(tmp_path):
    """Whoever may send answers could else void those of every joint, by their digests."""
    mine, forged = row(device="a"), row("J2", device="b")
    put(tmp_path / "out", mine, forged)
    assert rows(tmp_path / "out") == [mine, forged]


def test_one_writer_at_a_time(tmp_path):
    with (
        RecordingTable.opened(tmp_path / "out"),
        pytest.raises(ResultError, match="Another run"),
        RecordingTable.opened(tmp_path / "out"),
    ):
        pass


def test_a_table_that_is_none_is_told_and_left(tmp_path):
    (tmp_path / "recordings.parquet").write_text("mine")
    with pytest.raises(ResultError, match="no table of recordings"):
        rows(tmp_path)
    assert (tmp_path / "recordings.parquet").read_text() == "mine"
