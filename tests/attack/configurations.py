"""Configurations of every kind, with values, keys and sections that nobody expects."""

from __future__ import annotations

import copy
import os
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from attack.damage import BYTES, Damage
from attack.engine import DONE, OTHER, WITHHELD, WRONG, Ended, Finding, Group, Prepare, Trial
from attack.workshop import CONFIGURATIONS, RESULTS, Originals, put_configuration

KINDS = tuple(CONFIGURATIONS)
RUN_SHARE = 0.4
"""Of the configurations that ``check`` accepts so many are run as well."""
BEGUN_S = 3.0
"""A run that has computed so long has asked its questions: it is stopped, and was accepted."""

VALUES: Mapping[str, object] = {
    "0": 0,
    "1": 1,
    "-1": -1,
    "0.0": 0.0,
    "-0.5": -0.5,
    "1e-300": 1e-300,
    "1e9": 1e9,
    "1e300": 1e300,
    "a billion": 10**9,
    "2^63": 2**63,
    "a number of 60 digits": 10**60,
    "NaN": float("nan"),
    "infinite": float("inf"),
    "minus infinite": float("-inf"),
    "true": True,
    "false": False,
    "empty text": "",
    "blank": "   ",
    "text": "text",
    "number as text": "1",
    "300 characters": "x" * 300,
    "5,000 characters": "x" * 5000,
    "escapes": "\x1b[31mred\x07",
    "brackets": "[bold]{0}%s[/bold]",
    "NUL": "a\0b",
    "other letters": "δ Ω 中 e\u0301 \u202e",
    "root": "/",
    "here": ".",
    "above": "..",
    "/dev/null": "/dev/null",
    "/dev/zero": "/dev/zero",
    "/dev/urandom": "/dev/urandom",
    "/dev/full": "/dev/full",
    "a FIFO": "fifo",
    "its own file": "its own",
    "a recording": "before.csv",
    "a bench": "bench.toml",
    "a folder": "folder",
    "a file as folder": "before.csv/result",
    "home": "~",
    "home of nobody": "~nosuchuser/x",
    "an empty list": [],
    "a list": [1, 2],
    "a list of texts": ["a", "b"],
    "falling range": [2.0, 1.0],
    "range of nothing": [1.0, 1.0],
    "huge range": [1e-300, 1e300],
    "an empty table": {},
    "a table": {"a": 1},
    "a list of tables": [{"a": 1}, {}],
    "deep": [[[[[[[[]]]]]]]],
    "a date": date(2026, 1, 1),
    "first date": date(1, 1, 1),
    "last date": date(9999, 12, 31),
}
"""What any value of a configuration may be replaced by."""

Place = tuple[str | int, ...]


def places(tables: Any, place: Place = ()) -> Iterator[Place]:
    """All keys of a configuration, sections too."""
    items = (
        tables.items()
        if isinstance(tables, dict)
        else enumerate(tables)
        if isinstance(tables, list)
        else ()
    )
    for key, value in items:
        yield (*place, key)
        yield from places(value, (*place, key))


def at(tables: Any, place: Place) -> Any:
    for key in place:
        tables = tables[key]
    return tables


def any_place(tables: Any, rng: np.random.Generator) -> Place:
    found = list(places(tables))
    return found[int(rng.integers(len(found)))]


Edit = Callable[[dict[str, Any], np.random.Generator], object]


def replaced(value: object) -> Edit:
    def edit(tables: dict[str, Any], rng: np.random.Generator) -> None:
        place = any_place(tables, rng)
        at(tables, place[:-1])[place[-1]] = copy.deepcopy(value)

    return edit


def removed(tables: dict[str, Any], rng: np.random.Generator) -> None:
    place = any_place(tables, rng)
    del at(tables, place[:-1])[place[-1]]


def unknown(tables: dict[str, Any], rng: np.random.Generator) -> None:
    place = any_place(tables, rng)
    owner = at(tables, place[:-1])
    if isinstance(owner, dict):
        owner["suprise"] = 1


def renamed(tables: dict[str, Any], rng: np.random.Generator) -> None:
    place = any_place(tables, rng)
    owner, key = at(tables, place[:-1]), place[-1]
    if isinstance(owner, dict):
        owner[f"{str(key)[:-1]}"] = owner.pop(key)


def nested(tables: dict[str, Any], rng: np.random.Generator) -> None:
    place = any_place(tables, rng)
    owner, key = at(tables, place[:-1]), place[-1]
    owner[key] = {str(key): owner[key]}


def as_list(tables: dict[str, Any], rng: np.random.Generator) -> None:
    place = any_place(tables, rng)
    owner, key = at(tables, place[:-1]), place[-1]
    owner[key] = [owner[key], owner[key]]


def scaled(factor: float) -> Edit:
    """A number becomes one that is possible but absurd, or of another unit."""

    def edit(tables: dict[str, Any], rng: np.random.Generator) -> None:
        numbers = [p for p in places(tables) if type(at(tables, p)) in (int, float)]
        if numbers:
            place = numbers[int(rng.integers(len(numbers)))]
            owner = at(tables, place[:-1])
            owner[place[-1]] = type(owner[place[-1]])(owner[place[-1]] * factor)

    return edit


def set_to(value: object, *place: str | int) -> Edit:
    def edit(tables: dict[str, Any], rng: np.random.Generator) -> None:
        for key in place[:-1]:
            tables = tables.setdefault(key, {}) if isinstance(tables, dict) else tables[key]
        tables[place[-1]] = value

    return edit


EDITS: Mapping[str, Edit] = {
    **{f"a value: {name}": replaced(value) for name, value in VALUES.items()},
    "a key removed": removed,
    "another key removed": removed,
    "an unknown key": unknown,
    "a key misspelt": renamed,
    "a value nested": nested,
    "a value in a list": as_list,
    "a thousand times as large": scaled(1e3),
    "a millionth": scaled(1e-6),
    "the other sign": scaled(-1.0),
    "in rad/s": scaled(np.pi / 30.0),
}

RUN_EDITS: Mapping[str, Edit] = {
    "output a file": set_to("before.csv", "run", "output"),
    "output below a file": set_to("before.csv/x", "run", "output"),
    "output root": set_to("/", "run", "output"),
    "output here": set_to(".", "run", "output"),
    "output /dev/null": set_to("/dev/null", "run", "output"),
    "output below /proc": set_to("/proc/x", "run", "output"),
    "output of 300 characters": set_to("x" * 300, "run", "output"),
    "output with escapes": set_to("\x1b[31mred", "run", "output"),
    "a billion workers": set_to(10**9, "run", "workers"),
    "a huge seed": set_to(2**63 - 1, "run", "seed"),
}
SNAPSHOT_EDITS: Mapping[str, Edit] = {
    "a wrong gear ratio": set_to(12.0, "joint", "gear_ratio"),
    "a huge gear ratio": set_to(1e12, "joint", "gear_ratio"),
    "a tiny limit": set_to(1e-300, "joint", "limit_rad"),
    "speed read as rad/s": set_to(
        {"motor_speed_rpm": {"name": "motor_speed_rpm", "unit": "rad/s"}}, "columns"
    ),
    "time read as ms": set_to({"time_s": {"name": "time_s", "unit": "ms"}}, "columns"),
    "another speed asked for": set_to(500.0, "recordings", 0, "reference_speed_rpm"),
    "2e153 rpm asked for": set_to(2e153, "recordings", 0, "reference_speed_rpm"),
    "current as speed": set_to({"motor_speed_rpm": "motor_current_a"}, "columns"),
    "a recording a FIFO": set_to("fifo", "recordings", 0, "file"),
    "a recording /dev/zero": set_to("/dev/zero", "recordings", 0, "file"),
    "a recording /dev/urandom": set_to("/dev/urandom", "recordings", 0, "file"),
    "a recording its configuration": set_to("its own", "recordings", 0, "file"),
    "a million steps more": set_to(10**18, "posterior", "max_steps"),
    "1e-300 of level": set_to(1e-300, "interval", "level"),
    "twenty harmonics": set_to(20, "estimator", "model", "baseline_harmonics"),
    "a window of a year": set_to(3e7, "estimator", "model", "fixed", "window_end_s"),
    "from itself": set_to("result", "estimator", "search", "start_from"),
    "curve a FIFO": set_to("fifo", "curve", "source"),
    "curve /dev/zero": set_to("/dev/zero", "curve", "source"),
    "curve a bench": set_to("bench.toml", "curve", "source"),
}
ROTATION_EDITS: Mapping[str, Edit] = {
    "1e9 rotations": lambda t, rng: _owner_of_rotations(t).update(rotations=1e9),
    "1e300 rotations": lambda t, rng: _owner_of_rotations(t).update(rotations=1e300),
    "1e12 Hz": lambda t, rng: _owner_of_rotations(t).update(sampling_hz=1e12),
    "1e-12 Hz": lambda t, rng: _owner_of_rotations(t).update(sampling_hz=1e-12),
    "no rotations": lambda t, rng: _owner_of_rotations(t).update(rotations=1e-9),
}


def _owner_of_rotations(tables: dict[str, Any]) -> dict[str, Any]:
    owner = tables.get("sweep") or tables["recordings"][0]
    assert isinstance(owner, dict)
    return owner


TEXTS: Mapping[str, Callable[[str], str]] = {
    "a key twice": lambda text: text + text.splitlines()[0] + "\n",
    "a section twice": lambda text: text + "[run]\nseed = 2\n",
    "nothing at all": lambda text: "",
    "only its kind": lambda text: "\n".join(text.splitlines()[:2]) + "\n",
    "nested 5,000 deep": lambda text: text + "deep = " + "[" * 5000 + "]" * 5000 + "\n",
    "a comma as decimal point": lambda text: text.replace("0.", "0,"),
    "without quotes": lambda text: text.replace('"', ""),
    "Windows line ends": lambda text: text.replace("\n", "\r\n"),
    "byte order mark": lambda text: "\ufeff" + text,
    "100,000 recordings": lambda text: text + '[[recordings]]\nfile = "before.csv"\n' * 20_000,
    "a million blanks": lambda text: text + " " * 1_000_000,
    "another kind": lambda text: text.replace("kind", "kind_", 1),
}
"""What may be done to the text of a configuration."""


def dumped(tables: dict[str, Any]) -> str:
    import tomli_w

    return tomli_w.dumps(tables)


def edited(kind: str, edit: Edit, of_all: bool = True) -> Prepare:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        tables = tomllib.loads(CONFIGURATIONS[kind])
        edit(tables, rng)
        text = dumped(_own(tables, f"{kind}.toml"))
        return configured(
            kind, text.encode(), place, rng, run=not of_all or rng.random() < RUN_SHARE
        )

    return prepare


def rewritten(kind: str, change: Callable[[str], str]) -> Prepare:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        return configured(kind, change(CONFIGURATIONS[kind]).encode(), place, rng, run=False)

    return prepare


def damaged(kind: str, damage: Damage) -> Prepare:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        text = damage(CONFIGURATIONS[kind].encode(), rng)
        return configured(kind, text, place, rng, run=False)

    return prepare


def configured(
    kind: str, text: bytes, place: Path, rng: np.random.Generator, *, run: bool
) -> Trial:
    """Check, and if wanted run what was accepted: that must not refuse."""
    path = put_configuration(place, kind)
    path.write_bytes(text)
    os.mkfifo(place / "fifo")
    (place / "folder").mkdir()
    check = ("check", path.name)
    if not run or kind in ("bench", "study"):
        return Trial([check], names=_named(kind), unprivileged=True)

    def run_if_accepted() -> object:
        from bayesbl.cli import status

        return (status(list(check)), status(["run", path.name]))

    def judge(ended: Sequence[Ended]) -> Iterator[Finding]:
        if ended[0].answer == (DONE, WRONG):
            refusal = next((x for x in ended[0].err.splitlines() if x.startswith("Error")), "")
            yield OTHER, f"check accepts what run refuses: {refusal[:300]}"
        answer = ended[0].answer
        if isinstance(answer, tuple) and not set(answer) <= {DONE, WRONG, WITHHELD}:
            yield OTHER, f"statuses {answer}: {ended[0].err.strip()[:300]}"

    return Trial(
        [run_if_accepted],
        judge,
        outputs=["result", "made.csv", "truth.json", ".*", "folder"],
        enough_s=BEGUN_S,
        unprivileged=True,
    )


def _named(kind: str) -> tuple[str, ...]:
    """Its files, and what its output would be or replace."""
    inputs = ("before.csv", "after.csv", "bench.toml", "axis.csv", "study.py", "datasheet.toml")
    inputs = (*inputs, "ramp.csv", "ramp_later.csv", "joints.csv", "data/")
    return (f"{kind}.toml", *inputs, "result/", "/dev/", "fifo", "x" * 100, "[run] output")


def _own(tables: Any, name: str) -> Any:
    """The text "its own" stands for the configuration's own name."""
    if isinstance(tables, dict):
        return {key: _own(value, name) for key, value in tables.items()}
    if isinstance(tables, list):
        return [_own(value, name) for value in tables]
    return name if tables == "its own" else tables


def group() -> Group:
    """All kinds through all edits."""
    snapshots, simulated = ("fit", "compare", "direct"), ("simulate", "sweep")
    runs = [kind for kind in KINDS if kind != "bench"]
    table = [
        *((f"{kind}: {n}", edited(kind, e, False)) for n, e in RUN_EDITS.items() for kind in runs),
        *((f"{k}: {n}", edited(k, e, False)) for n, e in SNAPSHOT_EDITS.items() for k in snapshots),
        *((f"{k}: {n}", edited(k, e, False)) for n, e in ROTATION_EDITS.items() for k in simulated),
        *((f"{kind}: {n}", edited(kind, e)) for n, e in EDITS.items() for kind in KINDS),
        *((f"{kind}: {n}", rewritten(kind, t)) for n, t in TEXTS.items() for kind in KINDS),
        *((f"{kind}: {n}", damaged(kind, d)) for n, d in BYTES.items() for kind in KINDS),
    ]
    order = np.random.default_rng(0).permutation(len(table))
    return Group("configurations", 18, [table[i] for i in order])


def written_configuration(originals: Originals, damage: Damage) -> Prepare:
    """The configuration as it ran, damaged: people edit it, so it need not be what it was."""

    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        kind = str(rng.choice(RESULTS))
        file = originals.copy(kind, place) / "config.toml"
        file.write_bytes(damage(file.read_bytes(), rng))
        return Trial([("check", str(file.relative_to(place)))], names=["config.toml", "study.py"])

    return prepare


def written_files(originals: Originals) -> Group:
    """The files in TOML that the program writes; nobody reads truth.json back."""
    return Group(
        "configurations that it wrote",
        2,
        [(name, written_configuration(originals, damage)) for name, damage in BYTES.items()],
    )
