"""Files in which columns are sampled in groups, each by its own clock (bags, MDF, TDMS, Scope)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from bayesbl.recording.array_table import AnyArray, ArrayTable
from bayesbl.recording.channels import TIME


@dataclass(frozen=True, slots=True)
class Group:
    """Columns that were sampled together.

    Attributes
    ----------
    name
        What goes before the name of a column that other groups have too: a joint, a topic.
    columns
        Name to values, shape (n,).
    time
        The group's clock in s, shape (n,), or dates; ``None`` where a column must be named for it.
    units
        Units that the file states, by the column's name.
    withheld
        Why values of a column are not read, by the column's name.
    """

    name: str
    columns: Mapping[str, AnyArray]
    time: AnyArray | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    withheld: Mapping[str, str] = field(default_factory=dict)


def numbered(names: Sequence[str]) -> list[str]:
    """The names, all that come several times numbered: ``n (1)``, ``n (2)``; empty ones stay."""
    times = Counter(names)
    taken = set(times)
    reached: Counter[str] = Counter()
    unique: list[str] = []
    for name in names:
        free = name
        while name and times[name] > 1 and (free == name or free in taken):
            reached[name] += 1
            free = f"{name} ({reached[name]})"
        taken.add(free)
        unique.append(free)
    return unique


def table_of_groups(
    file: Path, groups: Sequence[Group], *, always_prefixed: bool = False
) -> ArrayTable:
    """All columns of all groups, each with its clock.

    Groups of one name are numbered. A name that only one group has stays as it is, others become
    ``GROUP/NAME``: all of them with ``always_prefixed``. The clock of a group is ``time_s`` among
    them.
    """
    prefixes = numbered([group.name for group in groups])
    with_clocks = [
        {TIME: group.time, **group.columns}
        if group.time is not None and TIME not in group.columns
        else dict(group.columns)
        for group in groups
    ]
    times = Counter(name for columns in with_clocks for name in columns)
    arrays: dict[str, AnyArray] = {}
    units: dict[str, str] = {}
    clocks: dict[str, str] = {}
    withheld: dict[str, str] = {}
    for group, prefix, columns in zip(groups, prefixes, with_clocks, strict=True):
        full = {
            name: f"{prefix}/{name}" if always_prefixed or times[name] > 1 else name
            for name in columns
        }
        arrays |= {full[name]: values for name, values in columns.items()}
        stated = {name: unit for name, unit in group.units.items() if name in columns}
        units |= {full[name]: unit for name, unit in stated.items() if unit.strip()}
        withheld |= {full[name]: reason for name, reason in group.withheld.items()}
        if TIME in columns:
            clocks |= dict.fromkeys(full.values(), full[TIME])
    return ArrayTable(str(file), arrays, units, clocks, withheld)
