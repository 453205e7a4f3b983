"""Recordings that are made to hurt: nothing outside them is read, nothing in them is run, and they
cost neither memory nor time. Each is a kind, by what must not happen."""

from __future__ import annotations

import os
import resource
import struct
import time
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from attack.recordings import as_mat5, as_mat73, as_mdf, as_parquet
from attack.workshop import CURRENT, SPEED, TIME, example, plain_csv
from bayesbl.errors import RecordingError, ResultError
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.input_bytes import LIMIT_VARIABLE
from bayesbl.recording.readers import read_recording, read_table

SECRET = "root:x:0:0:secret of the machine:/root:/bin/bash"
LONGEST_S, MOST_BYTES = 10.0, 3e9
SAMPLES = 400


@pytest.fixture
def secret(tmp_path: Path) -> Path:
    path = tmp_path / "elsewhere" / "passwd"
    path.parent.mkdir()
    path.write_text("\n".join([SECRET] * 100))
    return path


# HDF5 that leaves the file


def columns(group: Any) -> None:
    group.create_dataset(TIME, data=np.arange(SAMPLES) * 1e-3)
    group.create_dataset(SPEED, data=np.full(SAMPLES, 2000.0))


def external_link(file: h5py.File, outside: Path) -> None:
    with h5py.File(outside.with_suffix(".h5"), "w") as other:
        other.create_dataset("x", data=np.arange(SAMPLES))
    file[CURRENT] = h5py.ExternalLink(str(outside.with_suffix(".h5")), "/x")


def external_storage(file: h5py.File, outside: Path) -> None:
    file.create_dataset(CURRENT, (SAMPLES,), "u1", external=[(str(outside), 0, SAMPLES)])


def virtual(file: h5py.File, outside: Path) -> None:
    layout = h5py.VirtualLayout((SAMPLES,), "f8")
    layout[:] = h5py.VirtualSource(str(outside), "x", (SAMPLES,))
    file.create_virtual_dataset(CURRENT, layout)


def virtual_of_itself(file: h5py.File, outside: Path) -> None:
    layout = h5py.VirtualLayout((SAMPLES,), "f8")
    layout[:] = h5py.VirtualSource(".", CURRENT, (SAMPLES,))
    file.create_virtual_dataset(CURRENT, layout)


def soft_link_cycle(file: h5py.File, outside: Path) -> None:
    file["a"] = h5py.SoftLink("/b")
    file["b"] = h5py.SoftLink("/a")


def hard_link_cycle(file: h5py.File, outside: Path) -> None:
    file.create_group("a")["b"] = file["/"]


def many_ways(file: h5py.File, outside: Path) -> None:
    """2^40 paths to one group."""
    group = file.create_group("g0")
    for _ in range(40):
        inner = group.create_group("a")
        group["b"] = inner
        group = inner


def pipe(file: h5py.File, outside: Path) -> None:
    os.mkfifo(outside.parent / "pipe")
    file[CURRENT] = h5py.ExternalLink(str(outside.parent / "pipe"), "/x")


def pipe_as_storage(file: h5py.File, outside: Path) -> None:
    os.mkfifo(outside.parent / "pipe")
    stored = [(str(outside.parent / "pipe"), 0, SAMPLES)]
    file.create_dataset(CURRENT, (SAMPLES,), "u1", external=stored)


def foreign_filter(file: h5py.File, outside: Path) -> None:
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_chunk((SAMPLES,))
    made.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))
    space = h5py.h5s.create_simple((SAMPLES,))
    h5py.h5d.create(file.id, CURRENT.encode(), h5py.h5t.NATIVE_DOUBLE, space, made)


LEAVING = [
    external_link,
    external_storage,
    virtual,
    virtual_of_itself,
    soft_link_cycle,
    hard_link_cycle,
    many_ways,
    pipe,
    pipe_as_storage,
    foreign_filter,
]


@pytest.mark.parametrize("suffix", [".mat", ".nc"])
@pytest.mark.parametrize("leave", LEAVING, ids=lambda leave: leave.__name__)
def test_no_hdf5_file_shows_what_it_does_not_hold(
    leave: Callable[[h5py.File, Path], None], suffix: str, tmp_path: Path, secret: Path
) -> None:
    path = tmp_path / f"a{suffix}"
    with h5py.File(path, "w") as file:
        columns(file)
        leave(file, secret)
    begin = time.monotonic()
    with pytest.raises(RecordingError, match="refers to data outside itself") as caught:
        read_recording(path)
    assert time.monotonic() - begin < 3.0 * LONGEST_S
    assert "secret" not in str(caught.value)


@pytest.mark.parametrize("leave", [external_storage, virtual_of_itself, hard_link_cycle])
def test_no_result_shows_what_it_does_not_hold(
    leave: Callable[[h5py.File, Path], None], tmp_path: Path, secret: Path
) -> None:
    from bayesbl.results.store import read_tree, seal

    path = tmp_path / "result.nc"
    with h5py.File(path, "w") as file:
        leave(file, secret)
    seal(path)
    with pytest.raises(ResultError, match="refers to data outside itself"):
        read_tree(path)


@pytest.mark.parametrize("suffix", [".csv", ".mat", ".nc", ".mcap", ".xlsx"])
def test_a_pipe_in_place_of_a_file_is_not_waited_for(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"a{suffix}"
    os.mkfifo(path)
    with pytest.raises(RecordingError, match="a pipe, not a file"):
        read_recording(path)


# MDF


@pytest.mark.parametrize(("suffix", "version"), [("mf4", "4.10"), ("mdf", "3.30")])
@pytest.mark.parametrize("formula", ["X1*2", "__import__('os').system('touch was_run')"])
def test_no_formula_of_a_file_is_evaluated_on_any_channel_or_master(
    formula: str, suffix: str, version: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import asammdf
    from asammdf.blocks.conversion_utils import from_dict

    monkeypatch.chdir(tmp_path)
    path = tmp_path / f"a.{suffix}"
    speed = np.full(SAMPLES, 2000.0)
    with asammdf.MDF(version=version) as file:
        linear = asammdf.Signal(speed, np.arange(SAMPLES) * 1e-3, name=SPEED)
        file.append([linear])
        file.save(path)
    with asammdf.MDF(path) as file:
        for channel in file.groups[0].channels:
            conversion = from_dict({"formula": formula})
            if version.startswith("3"):
                from asammdf.blocks.conversion_utils import conversion_transfer

                conversion = conversion_transfer(conversion, version=3)
            channel.conversion = conversion
        file.save(path, overwrite=True)
    with pytest.raises(RecordingError, match=r'a formula|"time_s" is missing'):
        read_recording(path)
    assert not (tmp_path / "was_run").exists()
    table = read_table(path)
    with pytest.raises(RecordingError, match="a formula"):
        table.numbers([SPEED])


def test_two_groups_of_one_name_are_not_mixed(tmp_path: Path) -> None:
    import asammdf

    path = tmp_path / "a.mf4"
    fast, slow = np.arange(SAMPLES) * 1e-3, np.arange(SAMPLES // 4) * 4e-3
    with asammdf.MDF() as file:
        file.append([asammdf.Signal(fast * 0 + 2000.0, fast, name=SPEED)], acq_name="log")
        file.append([asammdf.Signal(slow, slow, name=CURRENT)], acq_name="log")
        file.append([asammdf.Signal(slow * 0 + 5.0, slow, name=SPEED)], acq_name="log")
        file.save(path)
    table = read_table(path)
    assert len(set(table.columns)) == len(table.columns)
    with pytest.raises(RecordingError, match="not sampled together"):
        read_recording(
            path, columns={SPEED: ColumnSpec(f"log (1)/{SPEED}"), CURRENT: ColumnSpec(CURRENT)}
        )
    first = read_recording(path, columns={SPEED: ColumnSpec(f"log (1)/{SPEED}")})
    assert first.samples == SAMPLES
    third = read_recording(path, columns={SPEED: ColumnSpec(f"log (3)/{SPEED}")})
    assert (third.motor_speed_rpm == 5.0).all()


# Small files, large memory

HUGE = 400_000_000
"""Values of 8 bytes in one variable: 3.2 GB."""


def large_mat5(path: Path) -> None:
    from scipy.io import savemat

    savemat(path, {"x": np.zeros((4, 4), np.uint8)}, do_compression=False)
    data = path.read_bytes()
    # The same matrix as one of zeros that declares HUGE doubles, stored as bytes and packed.
    flags = struct.pack("<IIII", 6, 8, 6, 0)
    size = struct.pack("<IIii", 5, 8, HUGE, 1)
    name = struct.pack("<HH4s", 1, 1, b"x")
    head = flags + size + name + struct.pack("<II", 2, HUGE)
    packer = zlib.compressobj(9)
    body = [packer.compress(struct.pack("<II", 14, len(head) + HUGE) + head)]
    zeros = bytes(1 << 20)
    body += [packer.compress(zeros) for _ in range(HUGE >> 20)]
    body += [packer.compress(zeros[: HUGE & 0xFFFFF]), packer.flush()]
    packed = b"".join(body)
    path.write_bytes(data[:128] + struct.pack("<II", 15, len(packed)) + packed)


def large_fill_value(path: Path) -> None:
    import netCDF4

    with netCDF4.Dataset(path, "w") as file:
        file.createDimension("sample", HUGE)
        for name in (TIME, SPEED):
            file.createVariable(name, "f8", ("sample",), chunksizes=(1 << 20,))


def large_mat73(path: Path) -> None:
    with h5py.File(path, "w") as file:
        file.create_dataset(SPEED, (HUGE, 1), "f8", chunks=(1 << 20, 1), fillvalue=1.0)


def large_parquet(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    rows = 1 << 24
    part = pa.table({name: pa.array(np.zeros(rows)) for name in (TIME, SPEED)})
    with pq.ParquetWriter(path, part.schema) as writer:
        for _ in range(16):
            writer.write_table(part)


def large_excel(path: Path) -> None:
    sheet = b'<c t="inlineStr"><is><t></t></is></c>' * 900
    rows = b"<row>" + sheet + b"</row>"
    begin = (
        b'<?xml version="1.0"?><worksheet xmlns="http://schemas.openxmlformats.org/'
        b'spreadsheetml/2006/main"><sheetData>'
    )
    import openpyxl

    small = path.with_name("small.xlsx")
    book = openpyxl.Workbook()
    book.save(small)
    with zipfile.ZipFile(small) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            if not name.endswith("sheet1.xml"):
                new.writestr(name, old.read(name))
                continue
            with new.open(name, "w", force_zip64=True) as part:
                part.write(begin)
                for _ in range(40_000):
                    part.write(rows)
                part.write(b"</sheetData></worksheet>")


def large_mcap(path: Path) -> None:
    import lz4.frame

    zeros = lz4.frame.compress(bytes(1 << 20))
    frame = lz4.frame.compress(bytes(HUGE * 6))
    del zeros

    def record(kind: int, content: bytes) -> bytes:
        return struct.pack("<BQ", kind, len(content)) + content

    def text(content: bytes) -> bytes:
        return struct.pack("<I", len(content)) + content

    chunk = struct.pack("<QQQI", 0, 1, HUGE * 6, 0) + text(b"lz4")
    chunk += struct.pack("<Q", len(frame)) + frame
    path.write_bytes(
        b"\x89MCAP0\r\n"
        + record(1, text(b"ros2") + text(b""))
        + record(6, chunk)
        + record(15, struct.pack("<I", 0))
        + record(2, struct.pack("<QQI", 0, 0, 0))
        + b"\x89MCAP0\r\n"
    )


def large_csv_gz(path: Path) -> None:
    import gzip

    with gzip.open(path, "wb", compresslevel=1) as file:
        file.write(f"{TIME},{SPEED}\n".encode())
        for _ in range(2_200):
            file.write(b"0.0,0.0\n" * 130_000)


LARGE: dict[str, tuple[str, Callable[[Path], None]]] = {
    "MATLAB v5, packed": ("a.mat", large_mat5),
    "MATLAB v7.3, never written": ("a.mat", large_mat73),
    "NetCDF, never written": ("a.nc", large_fill_value),
    "Parquet, run lengths": ("a.parquet", large_parquet),
    "Excel, packed": ("a.xlsx", large_excel),
    "MCAP, packed": ("a.mcap", large_mcap),
    "CSV, packed": ("a.csv.gz", large_csv_gz),
}


def peak_of_children() -> float:
    return 1024.0 * resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    folder = tmp_path_factory.mktemp("large")

    def make(kind: str) -> Path:
        name, write = LARGE[kind]
        path = folder / kind.replace(" ", "_") / name
        path.parent.mkdir()
        write(path)
        return path

    return make


@pytest.mark.long
@pytest.mark.parametrize("kind", LARGE)
def test_no_small_file_takes_large_memory(kind: str, made: Callable[[str], Path]) -> None:
    path = made(kind)
    assert path.stat().st_size < 3e7
    begin = resource.getrusage(resource.RUSAGE_CHILDREN)
    with pytest.raises(RecordingError, match=f"too much memory.*{LIMIT_VARIABLE}"):
        read_recording(path)
    end = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert end.ru_utime + end.ru_stime - begin.ru_utime - begin.ru_stime < LONGEST_S
    assert peak_of_children() < MOST_BYTES


@pytest.mark.parametrize("write", [as_mat5, as_mat73, as_parquet], ids=lambda w: w.__name__)
def test_the_limit_is_one_setting_for_every_format(
    write: Callable[..., None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / {"as_mat5": "a.mat", "as_mat73": "a.mat"}.get(write.__name__, "a.parquet")
    write(path, example())
    assert read_recording(path).samples == len(example()[TIME])
    monkeypatch.setenv(LIMIT_VARIABLE, "0.05")
    with pytest.raises(RecordingError, match=LIMIT_VARIABLE):
        read_recording(path)


LONG = {
    "a line without end": (bytes(30_000_000), "not a CSV"),
    "lines without samples": (b"time_s,x\n0,1\n0,1\n" + b"\n" * 30_000_000, "not a CSV"),
    "samples without end": (b"time_s,x\n" + b"0,1\n" * 6_000_000, "too much memory"),
    "other line ends": (b"time_s,x\r\n" + b"0,1\r\n" * 6_000_000, "too much memory"),
    "another encoding": (("time_s,x\n" + "0,1\n" * 6_000_000).encode("utf-16"), "too much memory"),
}


@pytest.mark.long
@pytest.mark.parametrize("kind", LONG)
def test_no_text_takes_long_or_large_memory(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import gzip

    content, told = LONG[kind]
    monkeypatch.setenv(LIMIT_VARIABLE, "50")
    path = tmp_path / "a.csv.gz"
    path.write_bytes(gzip.compress(content, 1))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin = time.process_time()
    with pytest.raises(RecordingError, match=told):
        read_recording(path)
    assert time.process_time() - begin < LONGEST_S
    assert 1024.0 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) < 3e8


# A reader that breaks down

BREAKING = """
import ctypes, os, sys, time

def read(data):
    {act}
"""
ACTS = {
    "a crash": ("ctypes.string_at(0)", "breaks down.*SIGSEGV"),
    "an end": ("os._exit(3)", "breaks down.*exit status 3"),
    "a hang": ("time.sleep(60)", "takes too long"),
    "all memory": ("x = bytearray(10 ** 10)", "too much memory"),
    "words": ("print('x' * 10 ** 6); os.write(1, b'x' * 10 ** 6); raise ValueError", "ValueError"),
}


@pytest.mark.parametrize("act", ACTS)
def test_a_reader_that_breaks_down_costs_that_file_alone(
    act: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from bayesbl.recording import formats, own_process

    code, sentence = ACTS[act]
    if act == "a hang":
        monkeypatch.setattr(own_process, "LONGEST_S", 1.0)
    module = tmp_path / "modules" / "broken.py"
    module.parent.mkdir()
    module.write_text(BREAKING.format(act=code))
    path = tmp_path / "a.broken"
    path.write_bytes(b"B" * 100)
    good = tmp_path / "a.csv"
    good.write_text(plain_csv(example()))
    monkeypatch.syspath_prepend(module.parent)
    broken = formats.Format("Broken", (".broken",), "broken", signatures=((0, b"B"),))
    monkeypatch.setitem(formats.FORMATS, ".broken", broken)
    with pytest.raises(RecordingError, match=sentence) as caught:
        read_recording(path)
    assert caught.value.file == str(path)
    assert read_recording(good).samples == len(example()[TIME])


# Text that is no recording

SECRETS = {
    "passwords": "root:x:0:0:root,secret,,:/root:/bin/bash\nbin:x:1:1:secret,,,:/bin:/bin/sh\n"
    * 20,
    "a key": "-----BEGIN PRIVATE KEY-----\n" + "c2VjcmV0c2VjcmV0,c2VjcmV0\n" * 20,
    "settings": "password = secret, 1\nuser = root\n" * 10,
    "a table of secrets": "user,password\n" + "root,secret\n" * 30,
    "a line": "secret, of the machine",
}


@pytest.mark.parametrize("suffix", [".csv", ".mf4", ".mat", ".nc", ".parquet", ".xlsx", ".mcap"])
@pytest.mark.parametrize("kind", SECRETS)
def test_a_refusal_quotes_nothing_of_what_is_no_recording(
    kind: str, suffix: str, tmp_path: Path
) -> None:
    hidden = tmp_path / "hidden"
    hidden.write_text(SECRETS[kind])
    path = tmp_path / f"a{suffix}"
    path.symlink_to(hidden)
    with pytest.raises(RecordingError) as caught:
        read_recording(path)
    told = str(caught.value)
    assert "secret" not in told
    assert "c2Vj" not in told
    assert "root" not in told.replace(str(path), "")


def test_mdf_and_mat_files_are_read_as_before(tmp_path: Path) -> None:
    """The gates let through what is sound: no test of theirs passes by refusing all."""
    for name, write in (("a.mf4", as_mdf), ("b.mat", as_mat73), ("c.mat", as_mat5)):
        write(tmp_path / name, example())
        read = read_recording(tmp_path / name)
        np.testing.assert_array_equal(read.motor_speed_rpm, example()[SPEED])
