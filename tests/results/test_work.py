"""Finished work is recalled bit for bit, or not at all."""

from __future__ import annotations

import errno
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from datetime import date
from pathlib import Path
from types import UnionType
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import numpy as np
import pytest

from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.errors import ResultError
from bayesbl.identification.identify import Identification
from bayesbl.measurement.amplitude_route import Fit
from bayesbl.measurement.curves import SweepRow
from bayesbl.measurement.direct_route import DirectMatch
from bayesbl.results.folder import locked_sibling
from bayesbl.results.work import WorkStore, address, decoder, encoded
from bayesbl.runs.study import Case


@dataclass(frozen=True, slots=True)
class Part:
    values: np.ndarray
    names: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Work:
    number: float
    part: Part | None
    parts: tuple[Part, ...]
    by_name: dict[str, float]
    scratch: list[int] = field(default_factory=list, compare=False)


WORK = Work(
    0.1 + 0.2,
    Part(np.array([math.nan, -0.0, math.inf, 1e-308])),
    (Part(np.arange(6, dtype=np.int32).reshape(2, 3)[:, ::2], ("a", "β")), Part(np.array(True))),
    {"z": math.nan, "a": -math.inf},
)


def store(folder: Path, **options) -> WorkStore:
    folder.mkdir(exist_ok=True)
    return WorkStore(folder, **options)


def never() -> Work:
    raise AssertionError("made again")


def test_work_is_recalled_bit_for_bit(tmp_path):
    store(tmp_path / "kept").get("work", 1, lambda: WORK, Work)
    found = store(tmp_path / "kept").get("work", 1, never, Work)
    assert encoded(found) == encoded(WORK)
    assert found.parts[0].names == ("a", "β")
    assert list(found.by_name) == ["z", "a"]
    assert found.parts[0].values.dtype == np.int32
    assert np.signbit(found.part.values[1])


def test_other_inputs_work_or_code_are_another_address(tmp_path):
    kept = store(tmp_path / "kept")
    kept.keep("work", {"seed": 1, "x": np.arange(3)}, WORK)
    assert kept.recall("work", {"x": np.arange(3), "seed": 1}, Work) is not None
    for what, inputs in (
        ("other", {"seed": 1, "x": np.arange(3)}),
        ("work", {"seed": 2, "x": np.arange(3)}),
        ("work", {"seed": 1, "x": np.arange(3.0)}),
        ("work", {"seed": 1, "x": np.arange(3)[::-1]}),
    ):
        assert kept.recall(what, inputs, Work) is None
    other_code = store(tmp_path / "kept", code="other")
    assert other_code.recall("work", {"seed": 1, "x": np.arange(3)}, Work) is None


def test_seeds_are_told_apart_by_their_place():
    first, second = np.random.SeedSequence(1).spawn(2)
    assert address(first) != address(second)
    assert address(first) == address(np.random.SeedSequence(1).spawn(1)[0])


def test_a_problem_with_dates_has_an_address_and_dates_come_back():
    """A configuration of dated recordings is part of what an identification is kept by."""
    first, later = date(2025, 3, 1), date(2026, 3, 1)
    assert address({"date": first}) == address({"date": date(2025, 3, 1)})
    assert address({"date": first}) != address({"date": later})
    assert decoder(date)(encoded(later)) == later


def test_damaged_and_foreign_entries_are_not_believed(tmp_path):
    kept = store(tmp_path / "kept")
    kept.keep("work", 1, WORK)
    [file] = kept.folder.iterdir()
    whole = file.read_bytes()
    generator = np.random.default_rng(3)
    for place in generator.integers(len(whole), size=100):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << int(generator.integers(8))
        file.write_bytes(bytes(flipped))
        assert kept.recall("work", 1, Work) is None
    for content in (b"", whole[:-1], whole[: len(whole) // 2], whole + b"x", b"\x80\x04N."):
        file.write_bytes(content)
        assert kept.recall("work", 1, Work) is None
    kept.keep("work", 2, WORK)
    [other] = set(kept.folder.iterdir()) - {file}
    file.write_bytes(other.read_bytes())  # whole, but of another address
    assert kept.recall("work", 1, Work) is None
    assert kept.recall("work", 2, Part) is None  # of another type
    assert kept.recall("work", 2, Work) is not None


def test_what_could_be_executed_is_not_stored():
    class Evil:
        def __reduce__(self):
            return (print, ("executed",))

    for value in (Evil(), np.array([Evil()], dtype=object), {"a": Evil()}):
        with pytest.raises(TypeError, match="cannot be stored"):
            encoded(value)


def test_pickled_arrays_are_not_read(tmp_path, capsys):
    class Evil:
        def __reduce__(self):
            return (print, ("executed",))

    np.savez(tmp_path / "evil.npz", text=np.array([Evil()], dtype=object))
    with pytest.raises(ValueError, match="allow_pickle"):
        decoder(Work)((tmp_path / "evil.npz").read_bytes())
    assert not capsys.readouterr().out


def test_the_oldest_work_goes_first_where_there_is_too_much(tmp_path):
    store = WorkStore(tmp_path)
    for number in range(4):
        store.keep("work", number, np.full(100, number))
        for file in tmp_path.iterdir():
            os.utime(file, ns=(t := file.stat().st_mtime_ns - 10**9, t))
    size = next(tmp_path.iterdir()).stat().st_size
    store.keep_latest(size_bytes=2 * size + 1)
    kept = [store.recall("work", number, np.ndarray) is not None for number in range(4)]
    assert kept == [False, False, True, True]


def test_two_runs_into_one_folder_do_not_mix(tmp_path):
    with (
        locked_sibling(tmp_path / "out", ".running"),
        pytest.raises(ResultError, match="is writing"),
        locked_sibling(tmp_path / "out", ".running"),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_file_system_without_locks_can_be_written_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", refuse)
    with locked_sibling(tmp_path / "out", ".running") as folder:
        assert folder.is_dir()


SIMPLE = (int, float, str, bool, type(None), date, Path, np.ndarray, np.random.SeedSequence)
CONTAINERS = (Union, UnionType, tuple, list, set, frozenset, dict, Mapping, Sequence)


def unstorable(kind: Any, seen: set[Any]) -> Iterator[str]:
    """Fields of a dataclass, and of those in it, of a type that a store does not take."""
    hints = get_type_hints(kind)
    for item in fields(kind):
        found = [hints[item.name]] if item.init and item.compare else []
        while found:
            own = found.pop()
            if get_origin(own) in CONTAINERS:
                found += [each for each in get_args(own) if each is not Ellipsis]
            elif is_dataclass(own):
                if own not in seen:
                    seen.add(own)
                    yield from unstorable(own, seen)
            elif (get_origin(own) or own) not in (*SIMPLE, Literal, Any):
                yield f"{kind.__name__}.{item.name}: {own}"


@pytest.mark.parametrize("kind", [Fit, DirectMatch, Diagnosis, Identification, SweepRow, Case])
def test_all_that_runs_finish_can_be_stored(kind):
    assert not list(unstorable(kind, set()))


def test_files_that_are_no_entries_are_never_deleted(tmp_path: Path) -> None:
    kept = store(tmp_path / "work")
    kept.keep("a", 1, WORK)
    own = tmp_path / "work" / "notes.txt"
    own.write_text("mine")
    kept.keep_latest(size_bytes=0)
    kept.keep_only([])
    assert os.listdir(tmp_path / "work") == ["notes.txt"]
