"""What a run that was killed left beside its output folder, damaged: the same command goes on.

It ends with the numbers that the run would have had, or says that it cannot go on.
"""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from attack.damage import BYTES, Damage
from attack.engine import (
    DONE,
    KEPT,
    OTHER,
    SILENT,
    WITHHELD,
    Ended,
    Finding,
    Group,
    Prepare,
    Skipped,
    Trial,
    captured,
)
from attack.results import one
from attack.workshop import Originals, put_configuration

FOREIGN = ("notes.txt", "foreign-optimum.npz")
"""Files that :func:`foreign_file` puts there, which nobody has to clear away."""
KINDS = ("fit", "sweep", "study")
"""Kinds that are cheap to run again."""


def leave_unfinished(place: Path, kind: str) -> None:
    """Run in a child that dies when it draws its first figure: all is computed, nothing stored."""
    put_configuration(place, kind)
    study = (place / "study.py").read_text()
    (place / "study.py").write_text(study.replace("figure = Figure()", "figure = Figure.dying()"))
    child = os.fork()
    if child == 0:
        with captured():
            from matplotlib.figure import Figure

            Figure.savefig = Figure.dying = lambda *_, **__: os._exit(9)  # type: ignore[attr-defined]
            from bayesbl.cli import status

            status(["run", f"{kind}.toml"])
        os._exit(0)
    os.waitpid(child, 0)
    (place / "study.py").write_text(study)


def left(place: Path) -> list[Path]:
    """Files in hidden folders."""
    return sorted(
        path
        for path in place.rglob("*")
        if path.is_file() and any(p.startswith(".") for p in path.relative_to(place).parts)
    )


def finished_work(place: Path) -> list[Path]:
    """What a run goes on from; a result that was not yet whole is not looked at again."""
    return [path for path in left(place) if ".staging" not in str(path)]


def forgotten(place: Path) -> list[str]:
    """Hidden files that a finished run should have cleared away."""
    names = (str(path.relative_to(place)) for path in left(place))
    return [n for n in names if not n.startswith(KEPT) and not n.endswith(FOREIGN)]


def numbers(folder: Path) -> Any:
    """What a finished run says, without what changes from run to run."""
    if (folder / "table.csv").exists():
        with (folder / "table.csv").open() as stream:
            return [
                {k: v for k, v in row.items() if k != "commit"} for row in csv.DictReader(stream)
            ]
    # Where it ran, and at which commit, is no part of the answer.
    text = (folder / "summary.json").read_text().replace(str(folder.parent), "")
    return {key: value for key, value in json.loads(text).items() if key != "commit"}


def garbage_line(data: bytes, rng: np.random.Generator) -> bytes:
    return data + b"garbage\n"


def foreign_line(data: bytes, rng: np.random.Generator) -> bytes:
    return data + b'{"valid": "but foreign"}\n'


def other_numbers(data: bytes, rng: np.random.Generator) -> bytes:
    """One digit becomes another, everywhere."""
    return data.replace(b"1", b"2")


MORE: Mapping[str, Damage] = {
    "a line of garbage": garbage_line,
    "a line that is foreign": foreign_line,
    "other digits": other_numbers,
    "valid JSON of another kind": lambda data, rng: b"[1, 2, 3]\n",
    "an empty table": lambda data, rng: b"{}\n",
}

Act = Callable[[Path, np.random.Generator], object]


def with_bytes(damage: Damage) -> Act:
    def act(place: Path, rng: np.random.Generator) -> None:
        files = finished_work(place)
        if files:
            file = files[int(rng.integers(len(files)))]
            file.write_bytes(damage(file.read_bytes(), rng))

    return act


def exchange(place: Path, rng: np.random.Generator) -> None:
    files = finished_work(place)
    first, second = (one([str(f) for f in files], rng) for _ in range(2))
    content = Path(first).read_bytes()
    Path(first).write_bytes(Path(second).read_bytes())
    Path(second).write_bytes(content)


def delete_one(place: Path, rng: np.random.Generator) -> None:
    Path(one([str(f) for f in finished_work(place)], rng)).unlink()


def foreign_file(place: Path, rng: np.random.Generator) -> None:
    for folder in {file.parent for file in finished_work(place)}:
        (folder / "notes.txt").write_text("mine\n")
        np.savez(folder / "foreign-optimum.npz", x=np.arange(3.0))


def other_arrays(place: Path, rng: np.random.Generator) -> None:
    """Valid archives with arrays of other names and shapes."""
    for file in finished_work(place):
        if file.suffix == ".npz":
            np.savez(file, x=np.arange(3.0))


def scaled_arrays(place: Path, rng: np.random.Generator) -> None:
    """Valid archives in which the numbers are others: a tool that rewrote them, or a worn disk."""
    for file in finished_work(place):
        if file.suffix == ".npz":
            with np.load(file, allow_pickle=False) as stored:
                arrays = {
                    k: stored[k] * 0.9 if stored[k].dtype.kind == "f" else stored[k] for k in stored
                }
            np.savez(file, **arrays)


ACTS: Mapping[str, Act] = {
    "nothing": lambda place, rng: None,
    "files exchanged": exchange,
    "a file deleted": delete_one,
    "foreign files": foreign_file,
    "archives of other arrays": other_arrays,
    "numbers in archives changed": scaled_arrays,
    **{name: with_bytes(damage) for name, damage in (MORE | BYTES).items()},
}


def resumed(originals: Originals, kind: str, act: Act) -> Prepare:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        leave_unfinished(place, kind)
        if not finished_work(place):
            raise Skipped(f"a {kind} that was killed left nothing behind")
        act(place, rng)
        wanted = numbers(originals.folder / kind / "result")

        def judge(ended: Sequence[Ended]) -> Iterator[Finding]:
            if ended[0].status in (DONE, WITHHELD):
                if numbers(place / "result") != wanted:
                    yield SILENT, "the run went on to other numbers"
                yield from ((OTHER, f"{name} is left behind") for name in forgotten(place))

        outputs = ["result", "study_file_was_run", ".*"]
        return Trial([("run", f"{kind}.toml")], judge, outputs=outputs)

    return prepare


def group(originals: Originals) -> Group:
    table = [
        (f"{kind}: {name}", resumed(originals, kind, act))
        for name, act in ACTS.items()
        for kind in KINDS
        if kind in originals.kinds
    ]
    order = np.random.default_rng(0).permutation(len(table))
    return Group("unfinished work, damaged", 2, [table[i] for i in order])
