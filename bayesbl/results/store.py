"""Result files: NetCDF trees and JSON, each written under another name and renamed.

The last bytes of a result file are its seal, the SHA-256 of all bytes before them. The seal is
checked before a library opens the file, since HDF5 may crash or hang on damaged bytes. HDF5 and
NetCDF readers ignore bytes behind the end that a file states, and drop them when they change a
file. Every ``summary.json`` has a :class:`Head`, and its intervals are an :class:`Interval` each.
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import shlex
from collections.abc import Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO, Literal, NotRequired, TypedDict

import numpy as np
import xarray as xr
from pydantic_core import to_json
from xarray.backends import NetCDF4DataStore
from xarray.conventions import encode_dataset_coordinates

from bayesbl.config.sections import RESULT_FILE
from bayesbl.errors import ResultError
from bayesbl.probabilities import ends
from bayesbl.recording.channels import did_you_mean_file
from bayesbl.recording.formats import FORMATS, RESULT_MARK
from bayesbl.recording.hdf5 import require_whole
from bayesbl.recording.input_bytes import LIMIT_VARIABLE, memory_bytes
from bayesbl.recording.types import FloatArray
from bayesbl.results.folder import replacing

_MARK = b"\nbayesbl SHA-256 "
_HEX_DIGITS = 64
_BYTES = len(_MARK) + _HEX_DIGITS + 1
_CHUNK_BYTES = 1 << 20


def seal(path: Path) -> None:
    """Append the seal to a file that has none."""
    with open(path, "r+b") as file:
        file.write(_seal_of(file, path.stat().st_size))


def _seal_of(file: BinaryIO, size: int) -> bytes:
    """Seal of the next ``size`` bytes."""
    digest = hashlib.sha256()
    while size > 0 and (chunk := file.read(min(size, _CHUNK_BYTES))):
        digest.update(chunk)
        size -= len(chunk)
    return _MARK + digest.hexdigest().encode() + b"\n"


FORMAT_VERSION = 4
OUTCOME = "outcome"  # root attribute: the run's outcome; absent or :data:`RUNNING` until it ends
RUNNING = "running"


def write_tree(tree: xr.DataTree, path: str | Path) -> None:
    """Write a tree as NetCDF; the file appears whole or not at all.

    The root attributes gain the mark of our format, and the file ends in its seal. With the
    attribute :data:`OUTCOME` it counts as a finished result.

    Raises OSError if the disk is full, or the file cannot be written for another reason.
    """
    marked = tree.copy()
    marked.attrs = {**tree.attrs, RESULT_MARK: FORMAT_VERSION}
    with replacing(path) as temporary:
        try:
            _write_netcdf(marked, temporary)
        except RuntimeError as error:
            # netCDF4 does not pass on the system's error.
            message = f"result.nc cannot be written; is the disk full? ({error})"
            raise OSError(errno.EIO, message) from error
        seal(temporary)


class _Later(list[tuple[Any, Any]]):
    """Values with their targets in a file, written once all targets are defined."""

    def add(self, values: object, target: object) -> None:
        """Add an entry; the interface of a writer in xarray."""
        self.append((values, target))


def _write_netcdf(tree: xr.DataTree, path: Path) -> None:
    """Write as ``tree.to_netcdf`` does, in a third of the time. A definition after values makes
    NetCDF rewrite everything defined so far."""
    import netCDF4

    later = _Later()
    with netCDF4.Dataset(path, "w") as file:
        for node in tree.subtree:
            is_root = node is tree
            group = file if is_root else file.createGroup(node.path)
            variables, attributes = encode_dataset_coordinates(node.to_dataset(inherit=is_root))
            store: Any = NetCDF4DataStore
            store(group).store(variables, attributes, writer=later)
        for values, target in later:
            target[...] = values


def read_tree(path: str | Path) -> xr.DataTree:
    """Read a tree into memory and close its file.

    ``path``: a NetCDF file that :func:`write_tree` wrote, or the output folder that contains it.
    Raises ResultError if there is no such file, or it is damaged, changed, not ours, of another
    version, or unfinished.
    """
    path = Path(path)
    file = path / RESULT_FILE if os.path.isdir(path) else path
    if not os.path.isfile(file):
        raise ResultError(
            "There is no such result." + did_you_mean_file(file), file=file, expected="a result.nc"
        )
    sources = dict.fromkeys(FORMATS.keys() - {".nc"}, ("recording", "fit", "one"))
    sources[".toml"] = ("configuration", "run", "it")
    if file.suffix.lower() in sources:
        what, command, one = sources[file.suffix.lower()]
        makes = f"`bayesbl {command} {shlex.quote(str(file))}` makes {one}"
        raise ResultError(
            f"This is a {what}, not a result.",
            file=file,
            expected=f"the output folder of a run; {makes}",
        )
    _require_intact(file)
    with xr.open_datatree(file, engine="netcdf4") as opened:
        tree: xr.DataTree = opened.load()
    if tree.attrs[RESULT_MARK] != FORMAT_VERSION:
        raise ResultError(
            "This result was written by an earlier or a later version of bayesbl, in another "
            "layout.",
            file=file,
            found=f"version {tree.attrs.get('bayesbl_version', 'unknown')}",
            expected=f"one of this version; `bayesbl run "
            f"{shlex.quote(str(file.with_name('config.toml')))} --force` makes it again",
        )
    if tree.attrs.get(OUTCOME, RUNNING) == RUNNING:
        raise ResultError(
            "The run that wrote this result has not finished.",
            file=file,
            expected="a finished result; the same command resumes the run",
        )
    return tree


def write_json(content: Mapping[str, Any], path: str | Path) -> None:
    """Write plain JSON, as made by :func:`json_text`."""
    write_text(json_text(content), path)


def json_text(content: Mapping[str, Any]) -> str:
    """Plain JSON; numpy values become plain ones, and values that are not finite become null."""
    return to_json(content, indent=2, inf_nan_mode="null", fallback=_plain).decode() + "\n"


def texts(attribute: str | Iterable[object] | None) -> list[str]:
    """List of texts from an attribute; NetCDF returns a list of one as a text, of none as none."""
    if isinstance(attribute, str):
        return [attribute] if attribute else []
    return [] if attribute is None else [str(text) for text in attribute]


def write_text(text: str, path: str | Path) -> None:
    """Write a text file that appears whole or not at all."""
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _require_intact(file: Path) -> None:
    """Check seal and structure, because whoever changes a file can seal it again."""
    with open(file, "rb") as stream:
        size = max(0, stream.seek(0, os.SEEK_END) - _BYTES)
        stream.seek(size)
        end = stream.read()
        stream.seek(0)
        is_intact = end == _seal_of(stream, size)
    if len(end) < _BYTES or not end.startswith(_MARK):
        raise ResultError(
            "This file is not a result as this version of bayesbl writes it.",
            file=file,
            found="no seal at its end: a foreign file, a damaged or changed one, or an earlier "
            "version's",
            expected="a result.nc as it was written; to make it again, `bayesbl run config.toml "
            "--force` in its folder",
        )
    damage = "" if is_intact else "content that does not match its checksum"
    content_bytes = 0.0
    if is_intact:
        try:
            content_bytes = require_whole(file, partial(ResultError, file=file))
        except (OSError, RuntimeError, ValueError):
            damage = "no sound structure of groups and variables"
    if damage:
        raise ResultError(
            "The result is damaged, or was changed after it was written.",
            file=file,
            found=damage,
            expected="a result.nc as bayesbl wrote it",
        )
    if content_bytes > memory_bytes():
        raise ResultError(
            "Reading this result takes too much memory.",
            file=file,
            found=f"{content_bytes / 1e6:.5g} MB",
            expected=f"at most {memory_bytes() / 1e6:g} MB; the environment variable "
            f"{LIMIT_VARIABLE} raises the limit",
        )


def _plain(value: object) -> Any:
    """Convert a value that pydantic does not know."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if isinstance(value, Mapping):
        return dict(value)
    raise TypeError(f"{type(value).__name__} is not for JSON")


IntervalKind = Literal["equal_tailed", "hdi"]


class Interval(TypedDict):
    """Median, bounds and the probability between them; a rate also has its unit."""

    median: float
    low: float
    high: float
    level: float
    kind: IntervalKind
    unit: NotRequired[str]


def interval(draws: FloatArray, level: float, kind: IntervalKind) -> Interval:
    """Median and credible interval of draws, any shape.

    ``equal_tailed`` leaves (1 − level)/2 on either side; ``hdi`` is the narrowest interval that
    holds ``level``.
    """
    flat = np.sort(np.asarray(draws, dtype=float).ravel())
    if kind == "hdi":
        count = max(1, round(level * flat.size))
        widths = flat[count - 1 :] - flat[: flat.size - count + 1]
        first = int(np.argmin(widths))
        low, high = flat[first], flat[first + count - 1]
    else:
        low, high = ends(flat, level)
    return {
        "median": float(np.median(flat)),
        "low": float(low),
        "high": float(high),
        "level": level,
        "kind": kind,
    }


class Origin(TypedDict):
    """Where a result comes from."""

    version: str | None
    commit: str | None
    seed: int | None


class Head(Origin):
    """How a run ended and where it came from; ``reason`` says why answers are withheld."""

    outcome: str
    reason: str | None
    warnings: list[str]


def summary_of(tree: xr.DataTree) -> Any:
    """``summary.json`` without sentences: its head from the attributes of a result, and the rest.

    The rest is the attribute ``summary``, JSON with the keys of this kind of result.
    """
    return {
        "kind": tree.attrs["kind"],
        "outcome": tree.attrs["outcome"],
        "reason": tree.attrs.get("reason") or None,
        "warnings": texts(tree.attrs.get("warnings")),
        "version": tree.attrs.get("bayesbl_version"),
        "commit": tree.attrs.get("git_commit"),
        "seed": tree.attrs.get("seed"),
        **json.loads(tree.attrs["summary"]),
    }
