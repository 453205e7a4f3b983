"""Recordings written in every format, for tests."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

Columns = Mapping[str, Any]
"""Column name to values, shape (n,)."""


def write_csv(path: Path, columns: Columns) -> Path:
    """Numbers with all their digits, NaN as an empty cell, text as it is."""
    cells = [[_cell(value) for value in values] for values in columns.values()]
    lines = [",".join(columns), *(",".join(row) for row in zip(*cells, strict=True))]
    path.write_text("\n".join(lines) + "\n")
    return path


def write_netcdf(path: Path, columns: Columns, kind: str = "NETCDF4", **units: str) -> Path:
    import xarray as xr

    data = xr.Dataset({name: ("sample", np.asarray(v)) for name, v in columns.items()})
    for name, unit in units.items():
        data[name].attrs["units"] = unit
    data.to_netcdf(path, format=kind)
    return path


def write_mat5(path: Path, variables: Mapping[str, Any], orientation: str = "column") -> Path:
    from scipy.io import savemat

    savemat(path, dict(variables), oned_as=orientation)
    return path


def write_mat73(path: Path, variables: Mapping[str, Any]) -> Path:
    """As MATLAB writes it: a header block, its class on every dataset, columns before rows."""
    import h5py

    def store(group: Any, values: Mapping[str, Any]) -> None:
        for name, value in values.items():
            if isinstance(value, Mapping):
                inner = group.create_group(name)
                inner.attrs["MATLAB_class"] = np.bytes_("struct")
                store(inner, value)
            else:
                dataset = group.create_dataset(name, data=np.atleast_2d(value))
                dataset.attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        store(file, variables)
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sun Mar  1 12:00:00 2026"
    with open(path, "r+b") as raw:
        raw.write(head.ljust(124) + b"\x00\x02IM")
    return path


def write_parquet(path: Path, columns: Columns) -> Path:
    import pandas as pd

    pd.DataFrame(dict(columns)).to_parquet(path, engine="pyarrow")
    return path


def write_mdf(path: Path, columns: Columns, version: str = "4.10", **units: str) -> Path:
    """The column ``time_s`` as the master of all others."""
    import asammdf

    names = [name for name in columns if name != "time_s"]
    signals = [
        asammdf.Signal(
            np.asarray(columns[name]), columns["time_s"], name=name, unit=units.get(name, "")
        )
        for name in names
    ]
    with asammdf.MDF(version=version) as file:
        file.append(signals)
        file.save(path, overwrite=True)
    return path


def write_tdms(path: Path, groups: Mapping[str, Columns], **properties: Any) -> Path:
    """Group to its columns; the properties go to every channel."""
    import nptdms

    with nptdms.TdmsWriter(path) as file:
        file.write_segment(
            [
                nptdms.ChannelObject(group, name, np.asarray(values), properties=properties)
                for group, columns in groups.items()
                for name, values in columns.items()
            ]
        )
    return path


def write_excel(path: Path, columns: Columns) -> Path:
    import openpyxl

    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet("Log")
    sheet.append(list(columns))
    for row in zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True):
        sheet.append(list(row))
    book.save(path)
    return path


def write_bag(path: Path, joints: Mapping[str, Columns], time_s: Any, stamped: bool = True) -> Path:
    """JointState of all joints, as ROS 1 (.bag) or ROS 2 (.db3, .mcap) records it."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    old = path.suffix == ".bag"
    types = get_typestore(Stores.ROS1_NOETIC if old else Stores.ROS2_JAZZY)
    state = types.types["sensor_msgs/msg/JointState"]
    header, stamp = types.types["std_msgs/msg/Header"], types.types["builtin_interfaces/msg/Time"]
    if old:
        writer: Any = rosbag1.Writer(path)
    else:
        plugin = rosbag2.StoragePlugin.MCAP if path.suffix == ".mcap" else None
        folder = path.with_suffix("")
        writer = rosbag2.Writer(
            folder, version=9, storage_plugin=plugin or rosbag2.StoragePlugin.SQLITE3
        )
    with writer:
        topic = writer.add_connection("/joint_states", state.__msgtype__, typestore=types)
        for row, seconds in enumerate(time_s):
            ns = round(float(seconds) * 1e9) + 1_772_366_400 * 10**9
            values = {
                quantity: np.array([float(c[quantity][row]) for c in joints.values()])
                for quantity in ("position", "velocity", "effort")
                if all(quantity in columns for columns in joints.values())
            }
            head = {"stamp": stamp(*(divmod(ns, 10**9) if stamped else (0, 0))), "frame_id": ""}
            message = state(
                header(**({"seq": row} if old else {}), **head),
                list(joints),
                *(values.get(q, np.array([])) for q in ("position", "velocity", "effort")),
            )
            raw = (types.serialize_ros1 if old else types.serialize_cdr)(message, state.__msgtype__)
            writer.write(topic, ns, raw)
    if not old:
        (folder / path.name).rename(path)
    return path


def write_scope(path: Path, columns: Columns, separator: str = "\t", decimal: str = ",") -> Path:
    """As TwinCAT Scope exports: a column of times in ms before every channel."""
    names = [name for name in columns if name != "time_s"]

    def line(key: str, cells: list[str]) -> str:
        return separator.join(f"{key}{separator}{cell}" for cell in cells)

    ms = [f"{1e3 * t:.9g}" for t in columns["time_s"]]
    lines = [f"Name{separator}Scope", f"Starttime of export{separator}132959733843760000", "", ""]
    lines += [line("Name", names), line("Data-Type", ["REAL64"] * len(names))]
    lines += [line("SampleTime[ms]", ["1"] * len(names)), line("Unit", ["(None)"] * len(names))]
    lines += [line("Unit ScaleFactor", ["1"] * len(names)), ""]
    for row, time in enumerate(ms):
        cells = [f"{time}{separator}{float(columns[name][row])!r}" for name in names]
        lines.append(separator.join(cells).replace(".", decimal))
    path.write_text("\n".join([*lines, "EOF", ""]), encoding="utf-8")
    return path


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return value
    return "" if value != value else repr(float(value))
