"""``recordings.parquet`` and ``joints.parquet``, with the columns declared here, and all draws.

Draws are in a Zarr store, a group for each joint. It is Zarr's format 2 without compression: a
folder of JSON and little-endian numbers, which needs no library to write.
``xarray.open_zarr(store, group="R1-J2")`` reads one joint.

On a measuring device, and where answers are collected, ``recordings.parquet`` grows row by row and
survives a power cut at any moment. Its key is device, joint and SHA-256 of the recording. The same
answer twice is one row, and a usable answer replaces an unusable one, in whatever order they come.
"""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date as Date
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bayesbl.config.sections import Interval as IntervalConfig
from bayesbl.errors import ConfigError, ResultError
from bayesbl.fleet.inventory import Joint
from bayesbl.fleet.measured_joint import FAILED, REFUSED, JointAnswer, RecordingAnswer
from bayesbl.fleet.pooled_rates import Borrowed, TypeRates, alarms, pooled
from bayesbl.measurement.wear import WearDraws
from bayesbl.results.folder import is_finished, locked_sibling, replacing, require_no_link
from bayesbl.results.store import interval
from bayesbl.results.variables import table

GROUP, ARRAY, ATTRIBUTES = ".zgroup", ".zarray", ".zattrs"


def write_draws(
    folder: Path,
    arrays: Mapping[str, tuple[Sequence[str], NDArray[np.generic]]],
    attributes: Mapping[str, object],
) -> None:
    """Write a group into a new folder; each array comes after the names of its dimensions."""
    folder.mkdir(parents=True)
    (folder / GROUP).write_text('{"zarr_format": 2}')
    (folder / ATTRIBUTES).write_text(json.dumps(dict(attributes), ensure_ascii=False))
    for key, (dims, values) in arrays.items():
        place, dtype = folder / key, values.dtype.newbyteorder("<")
        place.mkdir()
        plain = np.ascontiguousarray(values, dtype=dtype)
        head = {
            "zarr_format": 2,
            "shape": list(plain.shape),
            "chunks": [max(1, size) for size in plain.shape],
            "dtype": dtype.str,
            "compressor": None,
            "fill_value": None,
            "order": "C",
            "filters": None,
        }
        (place / ARRAY).write_text(json.dumps(head))
        (place / ATTRIBUTES).write_text(json.dumps({"_ARRAY_DIMENSIONS": list(dims)}))
        if plain.size:
            (place / ".".join(["0"] * plain.ndim)).write_bytes(plain.tobytes())


RECORDINGS_FILE, JOINTS_FILE = "recordings.parquet", "joints.parquet"

QUANTILES = (0.01, 0.05, 0.25, 0.75, 0.95, 0.99)
QUANTILE_COLUMNS = tuple(f"delta_rad_q{round(100 * q):02d}" for q in QUANTILES)


def _columns(text: str) -> dict[str, tuple[str, str]]:
    """Type and meaning of columns, from a table; ``x_median/low`` is ``x_median``, ``x_low``."""
    columns = {}
    for column in table(text):
        first, *ends = column.name.split("/")
        columns[first] = column.unit, column.meaning
        unit = re.search(r", rad(/year)?\b|, rpm\b|$", column.meaning)
        assert unit is not None
        for end in ends:
            name = f"{first.rpartition('_')[0]}_{end}"
            columns[name] = column.unit, _FURTHER.get(end, "its quantile (q05: 5 %)") + unit[0]
    return columns


_BOUND = "bound of its interval"
_FURTHER = {"low": _BOUND, "high": _BOUND, "sd": "its standard deviation"}


RECORDING_COLUMNS = _columns("""
    joint | string | name in the inventory
    date | string | date of the recording, 2026-03-01
    file | string | path
    sha256 | string | hash of the file's bytes; null if it could not be read
    outcome | string | converged, usable, withheld, no_curve; refused: it cannot be used;
        failed: a bug
    reason | string | why δ is null; null if δ is given
    notes | string | further remarks on the answer
    route | string | direct or amplitude
    used | bool | whether the joint's rate uses it; null from watch, which gives no rates
    delta_rad_median/low/high/sd/q01/q05/q25/q75/q95/q99 | double | gap, rad
    amplitude_rpm_median/low/high | double | amplitude of the ringing, rpm
    probability_above_limit | double | probability that δ was above the joint's limit
    device | string | name of the device that sent it; null if it was measured here
""")
"""Type and meaning of each column."""

JOINT_COLUMNS = _columns("""
    joint | string | name in the inventory
    gearbox | string | its type
    limit_rad | double | gap at which to repair it, rad
    recordings | int64 | number of recordings
    used | int64 | recordings that the rate uses
    withheld | int64 | recordings with a withheld gap, or without a curve
    broken | int64 | recordings that were refused or failed
    route | string | direct or amplitude
    first_date | string | date of the first or last recording in use
    last_date | string | date of the first or last recording in use
    delta_rad_median/low/high | double | gap at the last date, rad
    probability_limit_now | double | probability that the gap was above its limit at the last date
    probability_wear | double | probability that the gap has grown since the first date; without
        pooling
    rate_rad_per_year_median/low/high/sd | double | mean rate over the dates in use, rad/year
    rate_alone_rad_per_year_median/low/high | double | rate from this joint's recordings only,
        rad/year
    pooled | bool | whether rate, law and date use other joints of its type
    probability_unlike_type | double | probability that it does not wear like its type; null
        if its type is unknown
    law | string | likeliest law of wear
    limit_date_median/low/high | string | when the gap reaches the limit; null: not in 1000 years
    limit_date_not_before | string | one-sided bound, at the interval's level
    probability_limit_before | double | probability that the limit is reached before [fleet]
        decide_before
    cost_at_limit | double | what reaching the limit costs, from the inventory
    expected_cost | double | cost_at_limit times probability_limit_before, or, without a rate,
        times probability_limit_now, which is no larger; null without a gap
    alarm | bool | whether it is flagged as over its limit; on average at most 5 % of the flags
        are false
    rank | int64 | 1 reaches its limit first, or costs most if costs are given; null without a date
    reason | string | why there is no rate; null if a rate is given
""")
"""Type and meaning of each column; other columns of the inventory follow."""


def _ends(name: str, bounds: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of an interval."""
    return {f"{name}_{end}": bounds[end] for end in ("median", "low", "high")}


def recording_row(
    answer: RecordingAnswer, joint: Joint | None, used: bool | None, level: IntervalConfig
) -> dict[str, Any]:
    """A row of ``recordings.parquet`` without the recording's identity."""
    row: dict[str, Any] = dict.fromkeys(RECORDING_COLUMNS)
    row |= {"outcome": answer.outcome, "reason": answer.reason, "used": used}
    row["route"] = answer.route or None
    row["notes"] = " ".join(n for n in answer.notes if n not in (answer.reason or "")) or None
    if answer.amplitude_rpm is not None:
        ends = (f"amplitude_rpm_{end}" for end in ("median", "low", "high"))
        row |= dict(zip(ends, answer.amplitude_rpm, strict=True))
    if answer.answers:
        gap = answer.gap_rad
        assert gap is not None
        row |= _ends("delta_rad", interval(gap, level.level, level.kind))
        row["delta_rad_sd"] = float(gap.std())
        found_at = map(float, np.quantile(gap, QUANTILES))
        row |= dict(zip(QUANTILE_COLUMNS, found_at, strict=True))
        if joint is not None and joint.limit_rad is not None and joint.curve != "published":
            row["probability_above_limit"] = float(np.mean(gap > joint.limit_rad))
    return row


@dataclass(frozen=True, slots=True)
class Measured:
    """A joint with its answer, and the outcomes and dates of its recordings."""

    joint: Joint
    answer: JointAnswer
    dates: tuple[str, ...]
    outcomes: tuple[str, ...]


def pool(
    measured: Sequence[Measured], column: str | None, seed: int, covariates: Sequence[str] = ()
) -> tuple[dict[str, TypeRates], dict[str, Borrowed]]:
    """Rates by type, and by joint what its type adds; ``covariates`` are columns."""
    groups: dict[str, list[tuple[Joint, WearDraws]]] = defaultdict(list)
    for one in measured:
        if column and one.answer.wear is not None and one.joint.group(column):
            groups[one.joint.group(column)].append((one.joint, one.answer.wear))
    types: dict[str, TypeRates] = {}
    borrowed: dict[str, Borrowed] = {}
    for place, (name, members) in enumerate(sorted(groups.items())):
        joints, wears = zip(*members, strict=True)
        known = {key: np.array([joint.covariates[key] for joint in joints]) for key in covariates}
        rates = pooled(wears, np.random.default_rng([seed, place]), known)
        if rates is not None:
            types[name] = rates.rates
            borrowed |= {j.name: own for j, own in zip(joints, rates.joints, strict=True)}
    return types, borrowed


def joint_rows(
    measured: Sequence[Measured],
    borrowed: Mapping[str, Borrowed],
    level: IntervalConfig,
    decide_before: Date | None,
) -> list[dict[str, Any]]:
    """Rows of ``joints.parquet``: the largest expected cost first, then the most urgent."""
    rows = [_joint_row(one, borrowed.get(one.joint.name), level, decide_before) for one in measured]
    for row in rows:
        before, cost = row["probability_limit_before"], row["cost_at_limit"]
        probability = row["probability_limit_now"] if before is None else before
        if cost is not None and probability is not None:
            row["expected_cost"] = float(probability * cost)
    called = alarms([row["probability_limit_now"] for row in rows])
    for row, alarm in zip(rows, called, strict=True):
        row["alarm"] = alarm
    rows.sort(key=_urgency)
    dated = [row for row in rows if row["limit_date_median"] is not None]
    for rank, row in enumerate(dated, start=1):
        row["rank"] = rank
    return rows


def _urgency(row: Mapping[str, Any]) -> tuple[Any, ...]:
    """Sort by expected cost, largest first; then joints past their limit by how far, by date, by
    share of the limit; unknown ones last."""
    share = (row["delta_rad_median"] or 0.0) / (row["limit_rad"] or float("inf"))
    date = row["limit_date_median"] or "9999"
    passed = date <= (row["last_date"] or "")
    low = row["limit_date_low"] or "9999"
    cost = row["expected_cost"]
    return (
        cost is None,
        -(cost or 0.0),
        not passed,
        "" if passed else date,
        "" if passed else low,
        -share,
        row["joint"],
    )


def _joint_row(
    one: Measured, borrowed: Borrowed | None, level: IntervalConfig, decide_before: Date | None
) -> dict[str, Any]:
    joint, answer = one.joint, one.answer
    chosen = None if borrowed is None else borrowed.chosen
    row: dict[str, Any] = dict.fromkeys(JOINT_COLUMNS)
    row |= {key: value for key, value in joint.covariates.items() if key not in row}
    row |= {
        "joint": joint.name,
        "gearbox": joint.gearbox or None,
        "limit_rad": joint.limit_rad,
        "cost_at_limit": joint.cost_at_limit,
        "recordings": len(one.outcomes),
        "used": len(answer.used),
        "withheld": sum(o in ("withheld", "no_curve") for o in one.outcomes),
        "broken": sum(o in ("refused", "failed") for o in one.outcomes),
        "route": answer.route or None,
        "pooled": chosen is not None,
        "probability_unlike_type": None if borrowed is None else borrowed.probability_own,
        "reason": answer.reason,
    }
    dates = [one.dates[number] for number in answer.used]
    if dates:
        row |= {"first_date": dates[0], "last_date": dates[-1]}
    if answer.gap_rad is not None:
        now = answer.gap_rad[-1]
        row |= _ends("delta_rad", interval(now, level.level, level.kind))
        if joint.limit_rad is not None and joint.curve != "published":
            row["probability_limit_now"] = float(np.mean(now > joint.limit_rad))
    if answer.wear is None:
        return row
    last = Date.fromisoformat(dates[-1])
    before = decide_before if decide_before and decide_before > last else None
    wear = answer.wear if chosen is None else answer.wear.at(chosen)
    alone, own = (draws.summary(last, level, before) for draws in (answer.wear, wear))
    row |= {
        "probability_wear": alone["probability_wear"],
        "law": max(own["law"], key=own["law"].__getitem__),
        "rate_rad_per_year_sd": float(wear.rate_rad_per_year.std()),
        **_ends("rate_alone_rad_per_year", alone["rate"]),
        **_ends("rate_rad_per_year", own["rate"]),
    }
    if "date_of_limit" in own:
        row |= _ends("limit_date", own["date_of_limit"])
        row["limit_date_not_before"] = own["not_before"]["date"]
    if "probability_before" in own:
        row["probability_limit_before"] = own["probability_before"]["probability"]
    return row


def write_table(
    rows: Sequence[Mapping[str, Any]], columns: Mapping[str, tuple[str, str]], path: Path
) -> None:
    """Write a Parquet file with the meaning of each column as metadata."""
    import pyarrow
    import pyarrow.parquet

    extra = dict.fromkeys(key for row in rows for key in row if key not in columns)
    fields = list(schema_of(columns))
    for name in extra:
        is_number = all(isinstance(row.get(name, 0.0), float | None) for row in rows)
        kind = pyarrow.float64() if is_number else pyarrow.string()
        fields.append(pyarrow.field(name, kind, metadata={"meaning": "of the inventory"}))
        if not is_number:
            rows = [
                {**row, name: None if row.get(name) is None else str(row[name])} for row in rows
            ]
    table = pyarrow.Table.from_pylist([dict(row) for row in rows], schema=pyarrow.schema(fields))
    pyarrow.parquet.write_table(table, path)


def schema_of(columns: Mapping[str, tuple[str, str]]) -> Any:
    """pyarrow's schema with the meaning of each column as metadata."""
    import pyarrow

    return pyarrow.schema(
        pyarrow.field(name, pyarrow.type_for_alias(kind), metadata={"meaning": meaning})
        for name, (kind, meaning) in columns.items()
    )


def require_tables() -> None:
    """Raise ConfigError if Parquet cannot be written."""
    try:
        import pyarrow  # noqa: F401
    except ImportError:
        raise ConfigError(
            "A fleet needs a package that is not installed.",
            expected="pip install 'bayesbl[fleet]'",
        ) from None


Row = dict[str, Any]

UNUSABLE = frozenset({REFUSED, FAILED})

_BESIDE = ".growing"


@dataclass(slots=True)
class RecordingTable:
    """Rows and their file. ``beside``: a locked hidden folder for the writer's own data."""

    path: Path
    beside: Path
    rows: list[Row]
    _changed: bool = False

    @classmethod
    @contextmanager
    def opened(cls, output: Path) -> Iterator[RecordingTable]:
        """The table of an output folder, for one writer at a time; the folder is made if needed.

        Raises UserError if the folder holds a fleet's result, which the next run replaces, if the
        table is damaged or in use, or without pyarrow.
        """
        require_tables()
        require_no_link(output)
        if is_finished(output):
            raise ResultError(
                "This folder holds the result of a run, which would be mixed with other rows.",
                file=output,
                expected="another folder (--out)",
            )
        with locked_sibling(output, _BESIDE) as beside:
            path = output / RECORDINGS_FILE
            yield cls(path, beside, _read(path))

    def holds_measured(self, joint: str, sha256: str) -> bool:
        """Whether a recording was measured here and is usable."""
        usable = {"device": None, "joint": joint, "sha256": sha256, "outcome": "usable"}
        return self._knows(usable)

    def put(self, row: Row) -> bool:
        """Add a row, unless the table has it, or one of the same recording that says more.

        Rows of the same device, joint and file describe its former content and are removed.
        """
        if self._knows(row):
            return False
        same = ("file",) if row["sha256"] is None else ("file", "sha256")
        kept = [one for one in self.rows if not any(_is_same(row, one, key) for key in same)]
        self.rows = sorted([*kept, row], key=lambda one: (one["joint"], one["date"], one["file"]))
        self._changed = True
        return True

    def save(self) -> None:
        """Write all rows to disk. Raises OSError and leaves the file unchanged if that fails."""
        if self._changed:
            with replacing(self.path, durable=True) as temporary:
                write_table(self.rows, RECORDING_COLUMNS, temporary)
            self._changed = False

    def _knows(self, row: Row) -> bool:
        if row["sha256"] is None:
            return any(_is_same(row, one, "file", "reason") for one in self.rows)
        known = {one["outcome"] for one in self.rows if _is_same(row, one, "sha256")}
        return bool(known if row["outcome"] in UNUSABLE else known - UNUSABLE)


def _is_same(row: Row, one: Row, *keys: str) -> bool:
    """Whether both rows are of the same device and joint, and alike in these columns."""
    return all(one[key] == row[key] for key in ("device", "joint", *keys))


def _read(path: Path) -> list[Row]:
    import pyarrow.parquet

    if not path.exists():
        return []
    schema = schema_of(RECORDING_COLUMNS)
    try:
        table = pyarrow.parquet.read_table(path)
        return list(table.select(schema.names).cast(schema).to_pylist())
    except (pyarrow.ArrowException, KeyError, ValueError) as error:
        raise ResultError(
            "This is no table of recordings, or it is damaged.",
            file=path,
            found=str(error),
            expected="a table that bayesbl wrote; to start a new one, move this file away",
        ) from None
