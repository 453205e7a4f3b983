"""Text with one value a line, its name and its stamp, as EPICS's camonitor writes it.

::

    axis:Enc-PosAct 2020-12-08 16:17:33.317076 1.12222
    1607444253.317 axis:Enc-PosAct 1.12222

A value holds until the next one of its name: such logs are written on change.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from bayesbl.recording.array_table import AnyArray, ArrayTable
from bayesbl.recording.cells import is_date, number_in, seconds_of_dates

_DATE = r"\d{4}-\d\d-\d\d[ T]\d\d:\d\d:\d\d(?:[.,]\d+)?"
_STAMP = rf"(?P<stamp>{_DATE}|\(?\d{{9,10}}\.\d+\)?)"
_NAME = r"(?P<name>[^\s\d(#%]\S*)"
_FORMS = tuple(
    re.compile(form + r"\s+(?P<value>\S+)(?:\s.*)?")
    for form in (rf"{_NAME}\s+{_STAMP}", rf"{_STAMP}\s+{_NAME}", rf"(?P<stamp>{_DATE})(?P<name>)")
)
_ALIKE = 0.8
"""Share of the first lines that are events, from which the text is a log of them."""


def form_of_events(lines: Sequence[str]) -> re.Pattern[str] | None:
    """How most lines write an event, if they do; a name is wanted where a line may be a table's."""
    written = [line for line in lines if line.strip()]
    may_be_table = any(len(line.split()) > 3 for line in written)
    for form in _FORMS[:-1] if may_be_table else _FORMS:
        if sum(_event(form, line) is not None for line in written) >= max(2, _ALIKE * len(written)):
            return form
    return None


def _event(form: re.Pattern[str], line: str) -> tuple[str, str, float] | None:
    """Stamp, name and value of a line; ``None`` if it is no event."""
    found = form.fullmatch(line.strip())
    value = number_in(found["value"], ".") if found else None
    if found is None or value is None:
        return None
    return found["stamp"].strip("()"), found["name"] or "value", value


def read_events(file: Path, lines: Iterable[str], form: re.Pattern[str]) -> ArrayTable:
    """A column for each name, over all stamps from the first at which every name has a value.

    Names of fewer than two values are left out; so are lines that are no events, and are counted.
    """
    found = {n: _event(form, line) for n, line in enumerate(lines, 1) if line.strip()}
    events = {n: event for n, event in found.items() if event is not None}
    repairs = Counter({"line that is no event left out": len(found) - len(events)})
    stamps, *rest = zip(*events.values(), strict=True)
    names, values = map(np.array, rest)
    if is_date(stamps[0]):
        places = list(events)
        time = seconds_of_dates(stamps, str(file), lambda row: f"line {places[row]}")
    else:
        time = np.array(stamps, dtype=float)
        time -= time.min()
    order = np.argsort(time, kind="stable")
    order = order[np.isfinite(values[order])]
    of_name = {name: order[names[order] == name] for name in dict.fromkeys(names.tolist())}
    of_name = {name: own for name, own in of_name.items() if own.size > 1}
    rows = np.unique(time)
    rows = rows[rows >= max((time[own[0]] for own in of_name.values()), default=0.0)]
    columns: dict[str, AnyArray] = {"time_s": rows}
    for name, own in of_name.items():
        last = own[np.searchsorted(time[own], rows, "right") - 1]
        columns[name] = values[last]
        repairs["value of an event log, held until the next"] += int((time[last] < rows).sum())
    return ArrayTable(str(file), columns, repairs=repairs)
