"""JSON as a table: records, named lists, rows of a matrix, or one record on each line.

::

    [{"t": 0.0, "motor": {"position": 1.0}}, …]     t, motor/position
    {"log": {"t": [0.0, …], "q": [[1.0, 2.0], …]}}  log/t, log/q[0], log/q[1]
    {"data": [[0.0, 1.0], …]}                       data[0], data[1]

The longest table of a file is read.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.recording.array_table import ArrayTable

_LONGEST_LIST = 64
_DEEPEST = 6
_DATA = ("values", "data")  # names of a signal's list beside its times


def read(data: bytes) -> ArrayTable:
    """The longest table in the file. RecordingError if it is no JSON, or has no numbers."""

    text = data.decode("utf-8-sig")
    try:
        content = json.loads(text)
    except json.JSONDecodeError as error:
        if error.msg != "Extra data":
            raise
        content = [json.loads(line) for line in text.splitlines() if line.strip()]
    columns: dict[str, list[Any]] = {}
    units: dict[str, str] = {}
    for name, values in _columns("", content, 0, units):
        columns.setdefault(name, values)
    longest = max((len(values) for values in columns.values()), default=0)
    if longest < 2:
        raise RecordingError(
            "The file holds no series of numbers.",
            found=f"{len(columns)} lists" if columns else "no list",
            expected="a list for each channel, or a list of records",
        )
    arrays = {
        name: np.array([np.nan if v is None else v for v in values])
        for name, values in columns.items()
        if len(values) == longest
    }
    return ArrayTable(arrays, {name: unit for name, unit in units.items() if name in arrays})


def _named(content: dict[str, Any]) -> dict[str, Any]:
    """Rows of values as named columns, if a list of as many texts is beside them."""
    lists = [v for v in content.values() if isinstance(v, list) and v]
    rows = next((v for v in lists if all(isinstance(row, list) for row in v)), [])
    widths = {len(row) for row in rows}
    for names in lists:
        if {len(names)} == widths and all(isinstance(name, str) for name in names):
            return dict(zip(names, map(list, zip(*rows, strict=True)), strict=True))
    return content


def _columns(
    name: str, content: Any, depth: int, units: dict[str, str]
) -> Iterator[tuple[str, list[Any]]]:
    """Every list of plain values, with the path of names to it; ``units`` gains those beside it."""
    if depth > _DEEPEST or not content:
        return
    if isinstance(content, list) and len(content) == 1 and isinstance(content[0], (dict, list)):
        yield from _columns(name, content[0], depth + 1, units)
    elif isinstance(content, dict) and len(content) > _LONGEST_LIST and "0" in content:
        # by pandas' index
        yield from _columns(name, [*content.values()], depth, units)
    elif isinstance(content, dict):
        content = _named(content)
        unit = content.get("unit", content.get("units"))
        lists = [key for key, value in content.items() if isinstance(value, list)]
        lists = [key for key in lists if str(key).lower() in _DATA] or lists
        for key, value in content.items():
            # Beside several lists, a unit may be that of any: it is not the unit of time.
            if lists == [key] and isinstance(unit, str):
                units[f"{name}/{key}" if name else str(key)] = unit
            yield from _columns(f"{name}/{key}" if name else str(key), value, depth + 1, units)
    elif isinstance(content, list):
        kinds = {type(value) for value in content}
        if dict in kinds:
            keys = dict.fromkeys(k for v in content if isinstance(v, dict) for k in v)
            for key in keys:
                of_key = [v.get(key) if isinstance(v, dict) else None for v in content]
                yield from _columns(f"{name}/{key}" if name else str(key), of_key, depth + 1, units)
        elif list in kinds:
            width = max(len(v) for v in content if isinstance(v, list))
            for i in range(width if width <= _LONGEST_LIST else 0):
                of_place = [v[i] if isinstance(v, list) and len(v) > i else None for v in content]
                yield from _columns(f"{name or 'column'}[{i}]", of_place, depth + 1, units)
        else:
            yield name or "column", content
