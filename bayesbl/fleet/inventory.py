"""The joints of a plant and their recordings, from tables or a pattern of file names."""

from __future__ import annotations

import csv
import hashlib
import io
import math
import os
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date as Date
from glob import escape, glob
from pathlib import Path
from typing import Annotated, NoReturn, Self, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationError,
    model_validator,
)

from bayesbl.config.kinds import FleetSection
from bayesbl.config.loading import problems_of
from bayesbl.config.measurement import LimitRad, StatedLimit
from bayesbl.config.sections import BASE_DIRECTORY, BenchSource, CurveSource, Name, Positive, refuse
from bayesbl.errors import ConfigError
from bayesbl.recording.channels import did_you_mean, did_you_mean_file
from bayesbl.recording.input_bytes import read_input


def _day(value: object) -> str:
    try:
        return Date.fromisoformat(str(value)).isoformat()
    except ValueError:
        refuse("This is no date.", expected="a date such as 2026-03-01, or nothing")


_Day = Annotated[str, BeforeValidator(_day)]


class _Row(BaseModel):
    """A row of a table."""

    model_config = ConfigDict(allow_inf_nan=False)


_File = AfterValidator(str)


class Joint(_Row):
    """A row of the inventory."""

    model_config = ConfigDict(extra="allow", frozen=True)

    name: Name = Field(alias="joint")
    gearbox: str = ""
    bench: Annotated[BenchSource, _File] | None = None
    curve: Annotated[CurveSource, _File] | None = None
    limit: StatedLimit | None = None
    stated_limit_rad: LimitRad | None = Field(default=None, alias="limit_rad")
    cost_at_limit: Positive | None = None
    gear_ratio: Positive | None = None
    in_service_since: _Day | None = None
    repaired: _Day | None = None

    @model_validator(mode="after")
    def _goes_together(self) -> Self:
        if self.bench is not None and self.curve is not None:
            both = "bench and curve"
            refuse(
                "A joint has either a bench or a curve.",
                found=both,
                expected="either",
                at=("curve",),
            )
        if self.limit is not None and self.stated_limit_rad is not None:
            both = "limit and limit_rad"
            refuse("There are two limits.", found=both, expected="one limit", at=("limit",))
        if self.limit is not None and self.limit.of == "lost_motion":
            expected = "a limit of play or delta in a fleet"
            refuse("Lost motion needs a bench's stiffness.", expected=expected, at=("limit",))
        return self

    @property
    def limit_rad(self) -> float | None:
        """Limit of δ."""
        return self.stated_limit_rad if self.limit is None else self.limit.delta_rad()

    @property
    def covariates(self) -> dict[str, float | str]:
        """Every other column, as number or text."""
        return {key: _covariate(value) for key, value in (self.model_extra or {}).items()}

    def group(self, column: str) -> str:
        """The joint's entry in the column by which joints are pooled."""
        return self.gearbox if column == "gearbox" else str(self.covariates.get(column, ""))


OF_JOINT = tuple(field.alias or name for name, field in Joint.model_fields.items())
"""Columns of the inventory with a meaning; all others are covariates."""


class _RecordingRow(_Row):
    """A row of the table of recordings."""

    joint: str
    date: str
    file: str
    reference_speed_rpm: float | None = None


@dataclass(frozen=True, slots=True)
class Found:
    """A recording of a joint. ``reason``: why it is of no use; ``sha256``: of bytes once read."""

    joint: str
    date: str
    file: str
    reference_speed_rpm: float | None = None
    reason: str | None = None
    sha256: str | None = None

    @property
    def identity(self) -> dict[str, str | None]:
        """The columns of a table that identify the recording."""
        return {"joint": self.joint, "date": self.date, "file": self.file, "sha256": self.sha256}

    def read(self) -> Found:
        """The recording with the digest of its file, or the reason why it cannot be read."""
        if self.reason is not None:
            return self
        sha256, problem = digest_of_file(self.file)
        return replace(self, sha256=sha256, reason=problem)


def read_joints(section: FleetSection) -> list[Joint]:
    """All rows of the inventory.

    Raises ConfigError with file, row and column if there is no joint, two have the same name, a
    value is invalid, or a bench or a curve does not exist.
    """
    file = section.joints
    joints = [_valid(Joint, row, file, number) for number, row in enumerate(_rows(file), start=1)]
    if not joints:
        raise ConfigError("The inventory has no joint.", file=file, expected="a row for each joint")
    by_name: dict[str, str] = {}
    for joint in joints:
        # Each becomes a file, and some file systems do not tell large from small letters.
        other = by_name.setdefault(joint.name.casefold(), joint.name)
        if other is not joint.name:
            raise ConfigError(
                "Two joints have the same name.",
                file=file,
                where="joint",
                found=joint.name if joint.name == other else f"{other} and {joint.name}",
                expected="a different name for each; upper and lower case count as the same",
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
                actual = str(value) if value not in (None, "") else "nothing"
                _refuse(file, number, name, actual, "a number in every row, for [fleet] covariates")
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
    """All recordings by joint and date; those of no joint in the inventory have a reason.

    Raises ConfigError if the table of recordings cannot be read.
    """
    recordings = list(_by_pattern(section) if section.is_pattern else _by_table(section))
    known = {joint.name for joint in joints}
    listed = [
        one
        if one.joint in known or one.reason
        else replace(
            one,
            reason=f"There is no joint {one.joint!r} in the inventory."
            + did_you_mean(one.joint, sorted(known)),
        )
        for one in recordings
    ]
    return sorted(listed, key=lambda one: (one.joint, one.date, one.file))


FileState = tuple[int, int, int, int]  # inode, size and times; if they differ, the content may


def file_state(file: str) -> FileState | None:
    """State of a file; ``None`` if there is none."""
    try:
        status = os.stat(file)
    except OSError:
        return None
    return status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns


def digest_of_file(file: str) -> tuple[str | None, str | None]:
    """SHA-256 of a file's bytes, or the reason why it cannot be read."""
    try:
        return hashlib.sha256(read_input(Path(file))).hexdigest(), None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        return None, f"The file cannot be read: {reason}."


def _by_pattern(section: FleetSection) -> Iterator[Found]:
    pattern = section.recordings
    parts = re.split(r"\{joint\}|\{date\}", pattern)
    exact = re.escape(pattern)
    for name in ("joint", "date"):
        place = re.escape(f"{{{name}}}")
        exact = exact.replace(place, f"(?P<{name}>[^/]+)", 1).replace(place, f"(?P={name})")
    fixed = parts[0].rpartition("/")[0]
    for path in glob("*".join(map(escape, parts))):
        match = re.fullmatch(exact, path)
        if match and os.path.isfile(path):
            yield _within(fixed, _dated(match["joint"], match["date"], path))


def _within(folder: str | Path, one: Found) -> Found:
    """Refuse links out of the folder, so that whoever adds recordings cannot read other files."""
    if Path(os.path.realpath(one.file)).is_relative_to(os.path.realpath(folder)):
        return one
    return replace(one, reason=f"This is a link, or below one, that leads out of {folder}.")


def _by_table(section: FleetSection) -> Iterator[Found]:
    file = Path(section.recordings)
    for number, given in enumerate(_rows(file), start=1):
        row = _valid(_RecordingRow, given, file, number)
        path = Path(os.path.normpath(file.parent / os.path.expanduser(row.file)))
        one = _dated(row.joint, row.date, str(path), row.reference_speed_rpm)
        if one.reason is None and not path.is_file():
            one = replace(one, reason=f"There is no such file.{did_you_mean_file(path)}")
        yield _within(file.parent if path.is_relative_to(file.parent) else path.parent, one)


def _dated(joint: str, date: str, file: str, speed: float | None = None) -> Found:
    try:
        day = Date.fromisoformat(date).isoformat()
    except ValueError:
        reason = f"{date!r} is no date; expected one such as 2026-03-01."
        return Found(joint, date, file, speed, reason)
    return Found(joint, day, file, speed)


def _covariate(value: object) -> float | str:
    try:
        return float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        return str(value)


_R = TypeVar("_R", bound=_Row)


def _valid(model: type[_R], row: Mapping[str, str], file: Path, number: int) -> _R:
    """A validated row, without its empty cells. Raises ConfigError with file, row and column."""
    given = {key: cell for key, cell in row.items() if cell}
    try:
        return model.model_validate(given, context={BASE_DIRECTORY: file.parent})
    except ValidationError as error:
        first, *_ = problems_of(error, model)
        first.where = (first.where or "").strip("[]")
        raise first.at(ConfigError, f"row {number}, ", file) from None


def _refuse(file: Path, row: int, column: str, actual: str, expected: str) -> NoReturn:
    raise ConfigError(
        "This row cannot be used.",
        file=file,
        where=f"row {row}, {column}",
        found=actual,
        expected=expected,
    )


def _rows(file: Path) -> list[dict[str, str]]:
    """Rows of a table as text by column."""
    try:
        text = read_input(file).decode("utf-8-sig")
        separator = max(",;\t", key=text.partition("\n")[0].count)
        lines = io.StringIO(text, newline="")
        rows = list(csv.DictReader(lines, strict=True, delimiter=separator))
    except UnicodeDecodeError:
        raise ConfigError("This table is not UTF-8 text.", file=file, expected="UTF-8") from None
    except OSError as error:
        raise ConfigError(
            "The table cannot be read.", file=file, found=error.strerror, expected="a file"
        ) from None
    except (ValueError, csv.Error) as error:
        raise ConfigError("This table cannot be read.", file=file, found=str(error)) from None
    for number, row in enumerate(rows, start=1):
        if None in row or None in row.values():
            _refuse(file, number, "", "another number of fields", "as many as the header has")
    return [{key.strip(): cell.strip() for key, cell in row.items()} for row in rows]
