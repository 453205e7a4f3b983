"""Every key of ``summary.json``, variable of ``result.nc`` and column of a fleet's tables.

    python docs/make_results.py

writes ``docs/results.md`` from the types and declarations that the program itself goes by.
``tests/test_docs.py`` holds that it is as they are.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from importlib import import_module
from itertools import groupby
from pathlib import Path
from typing import Any, Literal, NotRequired, get_args, get_origin, get_type_hints, is_typeddict

from bayesbl.fleet.plant_tables import JOINT_COLUMNS, RECORDING_COLUMNS
from bayesbl.results.store import Head
from bayesbl.results.variables import Group, Variable

PAGE = Path(__file__).parent / "results.md"

SUMMARIES = {
    "fit": "bayesbl.measurement.summary_types:FitSummary",
    "compare": "bayesbl.measurement.summary_types:ComparisonSummary",
    "identify": "bayesbl.identification.groups:IdentificationSummary",
    "diagnose": "bayesbl.diagnosis.groups:DiagnosisSummary",
    "sweep": "bayesbl.runs.sweep:SweepSummary",
    "plan": "bayesbl.runs.plan:PlanSummary",
}

GROUPS = {
    "Of every measurement": "bayesbl.measurement.shared_groups",
    "Of the curve": "bayesbl.measurement.curves",
    "By the amplitude of the ringing": "bayesbl.measurement.amplitude_route",
    "By simulation of the bench": "bayesbl.measurement.direct_route",
    "By ramps of torque": "bayesbl.measurement.ramp_route",
    "By two encoders": "bayesbl.measurement.two_encoder_route",
    "Of wear": "bayesbl.measurement.wear",
    "Of an identification": "bayesbl.results.identified",
    "Of a diagnosis": "bayesbl.diagnosis.groups",
    "Of a sweep": "bayesbl.runs.sweep",
    "Of a plan": "bayesbl.runs.plan",
}

UNNAMED = {"step": "The change between neighbouring snapshots."}
"""Types that cannot have a docstring."""

HEAD = """# Keys, variables and columns of results

`python docs/make_results.py` makes this page from the program's declarations.

A result folder has `summary.json` (the answer), `result.nc` (everything, an xarray tree),
`config.toml` (the configuration that was run) and `figures`. A fleet's folder has tables instead. A
new run replaces only files that `manifest.json` lists. A withheld quantity is null, and `reason`
says why. Keys in brackets exist only if they apply. `[x]` is a list of x, `{x}` a table of x by
name.
"""


def pages() -> dict[Path, str]:
    """What the files should hold."""
    return {PAGE: "\n".join([HEAD, *_keys(), *_variables(), *_columns()])}


def _keys() -> Iterator[str]:
    parts: list[Any] = []
    summaries = {
        f'`kind = "{kind}"`': getattr(import_module(module), name)
        for kind, (module, _, name) in ((k, v.partition(":")) for k, v in SUMMARIES.items())
    }
    yield "## Keys of `summary.json`\n"
    yield "| of | keys |\n|---|---|"
    for title, table in ({"every kind": Head} | summaries).items():
        yield f"| {title} | {_keys_of(table, parts)} |"
    yield "\nThe parts, whose names are in italics above:\n"
    yield "| part | keys |\n|---|---|"
    rows = [  # parts grow on the way
        (_title(part), _plain(part.__doc__ or UNNAMED[_title(part)]), _keys_of(part, parts))
        for part in parts
    ]
    for name, text, keys in sorted(rows):
        yield f"| **{name}**: {text} | {keys} |"
    yield ""


def _keys_of(table: Any, parts: list[Any]) -> str:
    """Its own keys, those of one value together; tables among them join the parts."""
    hints = _hints(table)
    values = {key: _value(hint, parts) for key, hint in hints.items()}
    wider = (part for part in parts if _hints(part).items() < hints.items())
    shared = [part for part in wider if len(_hints(part)) > 2]
    texts = []
    if shared:
        base = max(shared, key=lambda part: len(_hints(part)))
        texts = [f"those of {_value(base, parts)}"]
        values = {key: value for key, value in values.items() if key not in _hints(base)}
    rows: dict[str, list[str]] = {}
    for key, value in values.items():
        always = get_origin(hints[key]) is not NotRequired and key in table.__required_keys__
        rows.setdefault(value, []).append(f"`{key}`" if always else f"(`{key}`)")
    return "; ".join([*texts, *(f"{', '.join(keys)}: {value}" for value, keys in rows.items())])


def _hints(table: Any) -> dict[str, Any]:
    """Types of its keys without those that every summary has."""
    hints = get_type_hints(table, include_extras=True)
    shared = get_type_hints(Head, include_extras=True) if table is not Head else {}
    return {key: hint for key, hint in hints.items() if shared.get(key) != hint}


def _value(hint: Any, parts: list[Any]) -> str:
    """A type in words."""
    inner = [_value(part, parts) for part in get_args(hint) if get_origin(hint) is not Literal]
    if is_typeddict(hint):
        if hint not in parts:
            parts.append(hint)
        return f"*{_title(hint)}*"
    if get_origin(hint) is Literal:
        return ", ".join(f'`"{choice}"`' for choice in get_args(hint))
    if get_origin(hint) is list:
        return f"[{inner[0]}]"
    if get_origin(hint) is dict:
        return f"{{{inner[1]}}}"
    if inner:
        return " or ".join(inner)
    words = {str: "text", float: "number", int: "integer", bool: "boolean"}
    return words.get(hint, "null" if hint is type(None) else "any")


def _title(part: Any) -> str:
    """``RouteSummary`` as ``route``."""
    name = part.__name__.removesuffix("Summary").strip("_")
    return re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()


def _variables() -> Iterator[str]:
    yield "## Variables of `result.nc`\n"
    yield (
        "In a comparison, variables of a recording have a first dimension `snapshot`. Not listed\n"
        "are variables named after a symbol, a parameter or a channel, and coordinates that label\n"
        "the dimension of their name (`chain`: the independent ensembles). The attributes `units`\n"
        "and `long_name` explain every variable.\n"
    )
    listed: list[Group] = []
    sections: dict[str, list[str]] = {}
    for title, module in GROUPS.items():
        own = list(_groups(vars(import_module(module)).values(), listed))
        listed += own
        sections[title] = [
            _row(group, variable)
            for group in own
            for variable in (*group.variables, *group.coordinates)
            if variable.dims != (variable.name,)
        ]
    times = Counter(row for rows in sections.values() for row in rows)
    yield "| variable (dimensions) | unit | meaning |\n|---|---|---|"
    yield "| **Of several routes** | | |"
    yield from _merged(row for row, count in times.items() if count > 1)
    for title, rows in sections.items():
        yield f"| **{title}** | | |"
        yield from _merged(row for row in rows if times[row] == 1)
    yield ""


def _merged(rows: Iterable[tuple[str, str, str]]) -> Iterator[str]:
    """A line for all variables of a section that have the same dimensions and cells."""
    names: dict[tuple[str, str], list[str]] = {}
    for name, dims, cells in rows:
        names.setdefault((dims, cells), []).append(f"`{name}`")
    for (dims, cells), alike in names.items():
        yield f"| {', '.join(alike)} {dims}".rstrip() + f" | {cells} |"


def _groups(values: Iterable[object], listed: Sequence[Group]) -> Iterator[Group]:
    """Those that declare variables by name, but for those that a module only imports."""
    for value in values:
        for one in value.values() if isinstance(value, dict) else (value,):
            if isinstance(one, Group) and one.variables and one not in listed:
                yield one


def _row(group: Group, variable: Variable) -> tuple[str, str, str]:
    """Path and dimensions of a variable, and the cells behind them."""
    cells = (variable.unit, variable.meaning)
    text = " | ".join(cell.replace("|", chr(92) + "|") for cell in cells)
    dims = f"({', '.join(variable.dims)})" if variable.dims else ""
    return f"{group.name}/{variable.name}", dims, text


def _columns() -> Iterator[str]:
    yield "## Columns of a fleet's tables\n"
    for file, columns in (("recordings", RECORDING_COLUMNS), ("joints", JOINT_COLUMNS)):
        yield f"### `{file}.parquet`\n\n| column (type) | meaning |\n|---|---|"
        for about, names in groupby(columns, columns.__getitem__):  # neighbours alike: one row
            kind, meaning = about
            yield f"| {', '.join(f'`{name}`' for name in names)} ({kind}) | {meaning} |"
        yield ""


def _plain(text: str) -> str:
    """A docstring in one line of Markdown."""
    text = re.sub(r":class:`(\w+)`", r"\1", re.sub("``(.+?)``", r"`\1`", text))
    return " ".join(text.split()).replace("|", chr(92) + "|").replace("`None`", "null")


if __name__ == "__main__":
    for file, content in pages().items():
        file.write_text(content, encoding="utf-8")
