"""The joints of a plant and their recordings, as tables or a pattern of file names give them.

Those in an object store (S3, Azure, HTTP …) are listed and copied by fsspec.
"""

from __future__ import annotations

import csv
import hashlib
import io
import math
import os
import re
import tempfile
import tomllib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date as Date
from datetime import datetime
from glob import glob
from pathlib import Path
from typing import Any, NoReturn

from bayesbl.config.fleet import FleetSection, is_address
from bayesbl.config.measurement import LARGEST_LIMIT_RAD
from bayesbl.config.sections import LONGEST_NAME, PUBLISHED, RESULT_FILE
from bayesbl.errors import ConfigError
from bayesbl.recording.channels import did_you_mean, did_you_mean_file
from bayesbl.recording.input_bytes import read_input, require_size
from bayesbl.results.atomic import PrivateFolder
from bayesbl.units import Limit, LimitError


def listed(pattern: str) -> Iterator[str]:
    """Addresses of the files that a pattern with ``*`` finds, spelled as the pattern is.

    Raises
    ------
    ConfigError
        If the store cannot be reached, or no package for it is installed.
    """
    begin = re.match(r"[a-z0-9+.-]+://[^*]*/", pattern)
    root = pattern if begin is None else begin[0]
    try:
        store, path = _opened(pattern)
        prefix = str(store._strip_protocol(root)).rstrip("/") + "/"
        for name in sorted(map(str, store.glob(path))):
            yield root + name.removeprefix(prefix)
    except Exception as error:  # each store's package has its own
        raise ConfigError(
            "The recordings in this store cannot be listed.",
            file=pattern,
            found=_told(error),
            expected="a store that fsspec can list, its package installed (s3fs, adlfs, gcsfs), "
            "and credentials where that package looks for them",
        ) from None


def copied(address: str, folder: Path) -> Path:
    """A copy of a file in ``folder``; taken again only where the store says that it has changed.

    Raises
    ------
    OSError
        If the file cannot be had, with a ``strerror`` that says why: also one that is too large.
    """
    try:
        store, path = _opened(address)
        state = hashlib.sha256(f"{address} {store.ukey(path)}".encode()).hexdigest()
        copy = folder / (state[:32] + "".join(Path(path).suffixes[-2:]))
        if not copy.exists():
            require_size(store.size(path))
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=folder) as apart:
                store.get_file(path, f"{apart}/copy")
                os.replace(f"{apart}/copy", copy)
    except Exception as error:
        raise OSError(0, f"it cannot be had from its store ({_told(error)})") from None
    return copy


def _opened(address: str) -> tuple[Any, str]:
    """The store and the path in it; raises whatever the store's package does."""
    from fsspec.core import url_to_fs

    store, path = url_to_fs(address)
    return store, str(path)


def _told(error: Exception) -> str:
    return f"{type(error).__name__}: {error}".rstrip(" .:")


_NAME = re.compile(rf"\w[\w .,+-]{{0,{LONGEST_NAME - 1}}}")

OF_JOINT = (
    "joint",
    "gearbox",
    "bench",
    "curve",
    "limit",
    "limit_rad",
    "cost_at_limit",
    "gear_ratio",
    "in_service_since",
    "repaired",
)
"""Columns of the inventory that mean something here; every other is a covariate."""


@dataclass(frozen=True, slots=True)
class Joint:
    """A row of the inventory.

    Attributes
    ----------
    gearbox
        Type of the gearbox; empty where it is not given.
    bench, curve
        Where δ comes from; neither gives the ringing alone.
    cost_at_limit
        What it costs if the joint reaches its limit; in one currency for all.
    repaired
        Date of the last repair: what was recorded on it or later is of the repaired joint.
    covariates
        Every other column, number or text.
    """

    name: str
    gearbox: str = ""
    bench: str | None = None
    curve: str | None = None
    limit_rad: float | None = None
    cost_at_limit: float | None = None
    gear_ratio: float | None = None
    in_service_since: str | None = None
    repaired: str | None = None
    covariates: Mapping[str, float | str] = field(default_factory=dict)

    def group(self, column: str) -> str:
        """What the joint has in a column that joints are pooled by."""
        return self.gearbox if column == "gearbox" else str(self.covariates.get(column, ""))


@dataclass(frozen=True, slots=True)
class Found:
    """A recording that belongs to a joint.

    Attributes
    ----------
    file
        Path, or its address in an object store until it is copied from there.
    reason
        Why it cannot be one.
    address
        In an object store, of what ``file`` is a copy of.
    """

    joint: str
    date: str
    file: str
    reference_speed_rpm: float | None = None
    reason: str | None = None
    address: str | None = None


def read_joints(section: FleetSection) -> list[Joint]:
    """All rows of the inventory.

    Raises
    ------
    ConfigError
        Naming file, row and column: no joint, two of one name, a value that cannot be one, a bench
        or a curve that is not there.
    """
    file = section.joints
    rows = _rows(file, "joints")
    joints = [_joint(row, file, number) for number, row in enumerate(rows, start=1)]
    if not joints:
        raise ConfigError("The inventory has no joint.", file=file, expected="a row a joint")
    seen: dict[str, str] = {}
    for joint in joints:
        # Each becomes a file, and some file systems do not tell large from small letters.
        other = seen.setdefault(joint.name.casefold(), joint.name)
        if other is not joint.name:
            raise ConfigError(
                "Two joints have the same name.",
                file=file,
                where="joint",
                found=joint.name if joint.name == other else f"{other} and {joint.name}",
                expected="a different one for each, in more than large and small letters",
            )
    costs = [joint.cost_at_limit for joint in joints]
    if any(costs) and not all(costs):
        expected = "a cost for every joint, or for none: the others would have no rank"
        _refuse(file, costs.index(None) + 1, "cost_at_limit", "nothing", expected)
    if any(costs) and section.decide_before is None:
        raise ConfigError(
            "An expected cost needs a date.",
            file=file,
            where="cost_at_limit",
            expected="[fleet] decide_before: a date, such as that of the next shutdown",
        )
    own = {name for joint in joints for name in joint.covariates}
    if section.pool_by is not None:
        _require_column("pool_by", section.pool_by, {*OF_JOINT, *own}, file)
    for name in section.covariates:
        _require_column("covariates", name, own, file)
        for number, joint in enumerate(joints, start=1):
            value = joint.covariates.get(name)
            if not isinstance(value, float) or not math.isfinite(value):
                found = str(value) if value not in (None, "") else "nothing"
                _refuse(file, number, name, found, "a number in every row, for [fleet] covariates")
    return joints


def _require_column(key: str, name: str, columns: Collection[str], file: Path) -> None:
    if name not in columns:
        raise ConfigError(
            "There is no such column in the inventory." + did_you_mean(name, columns),
            file=file,
            where=f"[fleet] {key}",
            found=name,
            expected="one of " + ", ".join(sorted(columns)),
        )


def find_recordings(section: FleetSection, joints: Sequence[Joint]) -> list[Found]:
    """All recordings, by joint and date; those of no joint of the inventory have a reason.

    Raises
    ------
    ConfigError
        If the table of recordings cannot be read.
    """
    found = list(_by_pattern(section) if section.is_pattern else _by_table(section))
    known = {joint.name for joint in joints}
    listed = [
        one
        if one.joint in known or one.reason
        else replace(
            one,
            reason=f"There is no joint {one.joint!r} in the inventory."
            + did_you_mean(one.joint, sorted(known)),
        )
        for one in found
    ]
    return sorted(listed, key=lambda one: (one.joint, one.date, one.file))


def fetched(found: Sequence[Found], folder: Path) -> list[Found]:
    """The same recordings, those in an object store copied into ``folder``.

    One that cannot be had gets its reason; copies that nothing leads to any more are deleted.
    """
    taken = [_fetched(one, folder) for one in found]
    needed = {Path(one.file).name for one in taken if one.address is not None}
    copies = PrivateFolder(folder)
    for name in copies.entries().keys() - needed:
        copies.delete(name)
    return taken


def _fetched(one: Found, folder: Path) -> Found:
    if one.reason is not None or not is_address(one.file):
        return one
    try:
        return replace(one, file=str(copied(one.file, folder)), address=one.file)
    except OSError as error:
        return replace(one, reason=f"The file cannot be read: {error.strerror}.")


FileState = tuple[int, int, int, int]
"""A file's number, size and times: another state may be another content."""


def file_state(file: str) -> FileState | None:
    """``None`` where there is no file any more."""
    try:
        return state_of(os.stat(file))
    except OSError:
        return None


def state_of(status: os.stat_result) -> FileState:
    """State of a file that is open, or was asked for."""
    return status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def is_joint_name(text: str) -> bool:
    """Whether a joint may be called so: the name of its page, so no path and no markup."""
    return _NAME.fullmatch(text) is not None


def digest_of_file(file: str) -> tuple[str | None, str | None]:
    """SHA-256 of a file's bytes, or why it cannot be read."""
    try:
        return hashlib.sha256(read_input(Path(file))).hexdigest(), None
    except (OSError, ValueError) as error:
        told = getattr(error, "strerror", None) or str(error)
        return None, f"The file cannot be read: {told}."


def file_of_another(joint: str, date: str) -> str:
    """Why a recording is not used whose file is there for another joint too."""
    return (
        f"Its file is to the last byte that of joint {joint}, {date}, so it counts for neither. "
        "Was a file copied by mistake?"
    )


def _by_pattern(section: FleetSection) -> Iterator[Found]:
    pattern = section.recordings
    remote = is_address(pattern)
    parts = re.split(r"(\{joint\}|\{date\})", pattern)
    anything = "".join("*" if part.startswith("{") else _glob_escaped(part) for part in parts)
    seen: set[str] = set()
    exact = ""
    for part in parts:
        name = part[1:-1] if part in ("{joint}", "{date}") else ""
        again = f"(?P={name})" if name in seen else f"(?P<{name}>[^/]+)"
        exact += again if name else re.escape(part)
        seen.add(name)
    fixed = parts[0].rpartition("/")[0]
    for path in listed(anything) if remote else glob(anything):
        match = re.fullmatch(exact, path)
        if match and (remote or os.path.isfile(path)):
            yield _within(fixed, _dated(match["joint"], match["date"], path), remote)


def _within(folder: str | Path, one: Found, remote: bool = False) -> Found:
    """Whoever puts recordings into a folder gives no access to what is outside of it."""
    if remote or Path(os.path.realpath(one.file)).is_relative_to(os.path.realpath(folder)):
        return one
    return replace(one, reason=f"This is a link, or below one, that leads out of {folder}.")


def _glob_escaped(text: str) -> str:
    return re.sub(r"([*?\[])", r"[\1]", text)


def _by_table(section: FleetSection) -> Iterator[Found]:
    file = Path(section.recordings)
    for number, row in enumerate(_rows(file, "recordings"), start=1):
        for column in ("joint", "date", "file"):
            if row.get(column) in (None, ""):
                _refuse(file, number, column, "nothing", "joint, date and file in every row")
        speed = _number(row.get("reference_speed_rpm"), file, number, "reference_speed_rpm")
        if is_address(str(row["file"])):
            yield _dated(str(row["joint"]), row["date"], str(row["file"]), speed)
            continue
        path = Path(os.path.normpath(file.parent / os.path.expanduser(str(row["file"]))))
        one = _dated(str(row["joint"]), row["date"], str(path), speed)
        if one.reason is None and not path.is_file():
            one = replace(one, reason=f"There is no such file.{did_you_mean_file(path)}")
        yield _within(file.parent if path.is_relative_to(file.parent) else path.parent, one)


def _dated(joint: str, date: object, file: str, speed: float | None = None) -> Found:
    try:
        day = _date_of(date)
    except ValueError:
        reason = f"{date!r} is no date; expected one such as 2026-03-01."
        return Found(joint, str(date), file, speed, reason)
    return Found(joint, day, file, speed)


def _date_of(value: object) -> str:
    day = value.date() if isinstance(value, datetime) else value
    return (day if isinstance(day, Date) else Date.fromisoformat(str(day))).isoformat()


def _joint(row: Mapping[str, Any], file: Path, number: int) -> Joint:
    name = str(row.get("joint") or "")
    if not is_joint_name(name):
        expected = (
            f"at most {LONGEST_NAME} letters, digits, spaces and . , + - _, a letter or digit first"
        )
        _refuse(file, number, "joint", name or "nothing", expected)
    limit = _limit_rad(row, file, number)
    bench, curve = (_file(row.get(column), file, number, column) for column in ("bench", "curve"))
    if bench and curve:
        _refuse(file, number, "curve", f"{curve} beside a bench", "a bench or a curve")
    return Joint(
        name,
        str(row.get("gearbox") or ""),
        bench,
        curve,
        limit,
        _number(row.get("cost_at_limit"), file, number, "cost_at_limit"),
        _number(row.get("gear_ratio"), file, number, "gear_ratio"),
        _day(row.get("in_service_since"), file, number, "in_service_since"),
        _day(row.get("repaired"), file, number, "repaired"),
        {key: _covariate(v) for key, v in row.items() if key not in OF_JOINT and v is not None},
    )


def _limit_rad(row: Mapping[str, Any], file: Path, number: int) -> float | None:
    """Of δ, from ``limit_rad`` or from ``limit`` as data sheets state it."""
    limit = _number(row.get("limit_rad"), file, number, "limit_rad")
    column, found = "limit_rad", f"{limit:g}" if limit is not None else ""
    if stated := str(row.get("limit") or "").strip():
        column, found = "limit", stated
        if limit is not None:
            _refuse(file, number, column, f"{stated} beside limit_rad", "one limit")
        try:
            parsed = Limit.parse(stated)
        except LimitError as error:
            _refuse(file, number, column, error.found, error.expected)
        if parsed.of == "lost_motion":
            _refuse(file, number, column, stated, "a limit of play or delta in a fleet")
        limit = parsed.delta_rad()
    if limit is not None and limit > LARGEST_LIMIT_RAD:
        expected = f"a gap δ of at most {LARGEST_LIMIT_RAD:g} rad (1.2e-3 = 1.2 mrad)"
        _refuse(file, number, column, found, expected)
    return limit


def _covariate(value: object) -> float | str:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return str(value)


def _number(value: object, file: Path, row: int, column: str) -> float | None:
    if value in (None, "") or value != value:  # a table's missing number is nan
        return None
    try:
        found = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        _refuse(file, row, column, str(value), "a number with a decimal point, or nothing")
    if not 0.0 < found < float("inf") and column != "reference_speed_rpm":
        _refuse(file, row, column, str(value), "a number greater than 0, or nothing")
    return found


def _day(value: object, file: Path, row: int, column: str) -> str | None:
    if value in (None, ""):
        return None
    try:
        return _date_of(value)
    except ValueError:
        _refuse(file, row, column, str(value), "a date such as 2026-03-01, or nothing")


def _file(value: object, file: Path, row: int, column: str) -> str | None:
    if value in (None, ""):
        return None
    if column == "curve" and value == PUBLISHED:
        return PUBLISHED
    path = Path(os.path.normpath(file.parent / os.path.expanduser(str(value))))
    path = path / RESULT_FILE if path.is_dir() else path
    if not path.is_file():
        expected = f"an existing file, relative to {file.parent}" + did_you_mean_file(path)
        _refuse(file, row, column, str(path), expected)
    return str(path)


def _refuse(file: Path, row: int, column: str, found: str, expected: str) -> NoReturn:
    raise ConfigError(
        "This row cannot be used.",
        file=file,
        where=f"row {row}, {column}",
        found=found,
        expected=expected,
    )


def _rows(file: Path, key: str) -> list[dict[str, Any]]:
    """Rows of a table as column to value; ``key`` names their list in TOML."""
    try:
        data = read_input(file)
        if file.suffix.lower() == ".parquet":
            return _parquet_rows(file, data)
        text = data.decode("utf-8-sig")
        if file.suffix.lower() == ".toml":
            rows = tomllib.loads(text).get(key)
        else:
            rows = list(csv.DictReader(io.StringIO(text, newline=""), strict=True))
    except UnicodeDecodeError:
        raise ConfigError("This table is not UTF-8 text.", file=file, expected="UTF-8") from None
    except OSError as error:
        raise ConfigError(
            "The table cannot be read.", file=file, found=error.strerror, expected="a file"
        ) from None
    except (ValueError, RecursionError, csv.Error) as error:
        raise ConfigError(
            "This is no table that can be read.", file=file, found=str(error)
        ) from None
    if not isinstance(rows, list) or not all(isinstance(row, dict) for row in rows):
        raise ConfigError("The table has no rows.", file=file, expected=f"[[{key}]] entries")
    if file.suffix.lower() == ".csv":
        for number, row in enumerate(rows, start=1):
            if None in row or None in row.values():
                _refuse(file, number, "", "another number of fields", "as many as the header has")
        rows = [{k.strip(): v.strip() for k, v in row.items()} for row in rows]
    return rows


def _parquet_rows(file: Path, data: bytes) -> list[dict[str, Any]]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ConfigError(
            "Parquet needs a package that is not installed.",
            file=file,
            expected="pip install 'bayesbl[fleet]', or the table as CSV or TOML",
        ) from None
    try:
        rows: list[dict[str, Any]] = pyarrow.parquet.read_table(
            pyarrow.BufferReader(data)
        ).to_pylist()
    except pyarrow.ArrowException as error:
        raise ValueError(str(error)) from None
    return rows
