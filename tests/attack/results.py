"""Every file that the program itself writes, damaged, and every command that reads it.

A damaged result is refused with one message, or its answer is exactly that of the undamaged one.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from attack.damage import BYTES, Damage
from attack.engine import (
    DONE,
    HARM,
    SILENT,
    WITHHELD,
    WRONG,
    Ended,
    Finding,
    Group,
    Prepare,
    Step,
    Trial,
    run_step,
)
from attack.workshop import HEAD, JOINT, SHORT, Originals

INSPECT: Step = ("inspect", "result")
JSON: Step = ("inspect", "result", "--json")
REPORT: Step = ("report", "result")
FIGURES: Step = ("figures", "result")

_LATER_FIT = (
    HEAD.format(kind="fit").replace('"result"', '"later"')
    + JOINT
    + SHORT.replace("1000", "200")
    + '[[recordings]]\nfile = "after.csv"\n'
)
BY_CURVE = _LATER_FIT + '[curve]\nsource = "result"\n'
FROM_RESULT = _LATER_FIT + '[estimator.search]\nstart_from = "result"\n'
FIT_LATER: Step = ("run", "later.toml", "--json")
CHECK_LATER: Step = ("check", "later.toml")

Open = Any
"""An open HDF5 file of h5py."""
Change = Callable[[Open, np.random.Generator], object]


def groups(file: Open) -> list[str]:
    return sorted(name for name in file if hasattr(file[name], "keys"))


def variables(file: Open, kinds: str = "fiuSOb") -> list[str]:
    """Paths of the datasets with values of these kinds."""
    found: list[str] = []

    def visit(name: str, item: Any) -> None:
        if hasattr(item, "dtype") and item.dtype.kind in kinds:
            found.append(name)

    file.visititems(visit)
    return found


def one(names: Sequence[str], rng: np.random.Generator) -> str:
    return names[int(rng.integers(len(names)))]


def attribute(value: object, name: str | None = None) -> Change:
    """A root attribute, any or of that name, gets a value."""

    def change(file: Open, rng: np.random.Generator) -> None:
        chosen = name or one(sorted(file.attrs), rng)
        if chosen in file.attrs:
            del file.attrs[chosen]
        if value is not None:
            file.attrs[chosen] = value

    return change


def group_attribute(value: object) -> Change:
    """The attribute of a group or a variable that holds what the program keeps there."""

    def change(file: Open, rng: np.random.Generator) -> None:
        found = [
            (item, key)
            for item in (file[name] for name in (*groups(file), *variables(file)))
            for key in item.attrs
            if not key.startswith(("_", "CLASS", "NAME", "DIMENSION", "REFERENCE"))
        ]
        item, key = found[int(rng.integers(len(found)))]
        del item.attrs[key]
        if value is not None:
            item.attrs[key] = value

    return change


def without_group(file: Open, rng: np.random.Generator) -> None:
    del file[one(groups(file), rng)]


def without_variable(file: Open, rng: np.random.Generator) -> None:
    del file[one(variables(file), rng)]


def answer_variables(file: Open) -> list[str]:
    """The numbers that an answer is made of."""
    wanted = ("/posterior/", "/optimum/", "/change/", "/gap/", "/curve/", "/wear/", "/row_")
    wanted += ("/diagnostics/",)
    found = [n for n in variables(file, "f") if any(part in f"/{n}" for part in wanted)]
    return found or variables(file, "f")


def values(form: Callable[[Any, np.random.Generator], Any]) -> Change:
    """The numbers of a variable of the answer become others of the same shape."""

    def change(file: Open, rng: np.random.Generator) -> None:
        data = file[one(answer_variables(file), rng)]
        data[...] = form(data[...], rng)

    return change


def some(value: float) -> Callable[[Any, np.random.Generator], Any]:
    def form(numbers: Any, rng: np.random.Generator) -> Any:
        return np.where(rng.random(np.shape(numbers)) < 0.01, value, numbers)

    return form


def one_bit(numbers: Any, rng: np.random.Generator) -> Any:
    """What a worn disk does: a bit of one number."""
    flat = np.array(numbers, dtype=float).ravel()
    bits = flat.view(np.uint64)
    bits[int(rng.integers(bits.size))] ^= np.uint64(1) << np.uint64(rng.integers(40, 63))
    return flat.reshape(np.shape(numbers))


def one_bit_of_delta(file: Open, rng: np.random.Generator) -> None:
    names = [
        n for n in variables(file, "f") if n.rpartition("/")[2] in ("delta_rad", "amplitude_rpm")
    ]
    data = file[one(names or answer_variables(file), rng)]
    data[...] = one_bit(data[...], rng)


def another_shape(file: Open, rng: np.random.Generator) -> None:
    name = one(answer_variables(file), rng)
    content = file[name][...]
    del file[name]
    file[name] = np.ravel(content)[: max(1, np.size(content) // 2)]


def as_text(file: Open, rng: np.random.Generator) -> None:
    name = one(variables(file, "f"), rng)
    del file[name]
    file[name] = "text"


def extra_group(file: Open, rng: np.random.Generator) -> None:
    file.create_group("posterior_2")["x"] = np.arange(3.0)


def renamed_group(file: Open, rng: np.random.Generator) -> None:
    file.move(one(groups(file), rng), "something")


def link_to_elsewhere(file: Open, rng: np.random.Generator) -> None:
    import h5py

    name = one(groups(file), rng)
    del file[name]
    file[name] = h5py.ExternalLink("/etc/passwd", "/")


KINDS = ("fit", "compare", "sweep", "diagnose", "study", "simulate", "bench", "", "nonsense")

CHANGES: Mapping[str, Change] = {
    **{f'kind "{kind}"': attribute(kind, "kind") for kind in KINDS},
    "kind missing": attribute(None, "kind"),
    "kind a number": attribute(7, "kind"),
    "an attribute missing": attribute(None),
    "another attribute missing": attribute(None),
    "an attribute not JSON": attribute("{not json"),
    "another attribute not JSON": attribute('{"a": '),
    "an attribute JSON of another kind": attribute("[1, 2, 3]"),
    "an attribute a number": attribute(-1.5),
    "an attribute empty": attribute(""),
    "an attribute an array": attribute(np.arange(4.0)),
    "an attribute bytes": attribute(np.bytes_(b"\xff\xfe\x00")),
    "an attribute with escapes": attribute("\x1b[31mred\x1b[0m\x07"),
    "configuration runs a file": attribute('kind = "study"\nstudy = "evil.py"\n', "config"),
    "a group's attribute missing": group_attribute(None),
    "a group's attribute not JSON": group_attribute("{not json"),
    "a group's attribute a number": group_attribute(3),
    "a group missing": without_group,
    "another group missing": without_group,
    "a group renamed": renamed_group,
    "a group from elsewhere": link_to_elsewhere,
    "a group more": extra_group,
    "a variable missing": without_variable,
    "another variable missing": without_variable,
    "a variable of another shape": another_shape,
    "a variable of text": as_text,
    "an answer NaN": values(lambda x, rng: x * np.nan),
    "some NaN": values(some(np.nan)),
    "an answer negative": values(lambda x, rng: -np.abs(x)),
    "some infinite": values(some(np.inf)),
    "an answer zero": values(lambda x, rng: 0.0 * x),
    "an answer a quarter off": values(lambda x, rng: 0.75 * x),
    "one bit of an answer": values(one_bit),
    "one bit of the gap": one_bit_of_delta,
    "a later version": attribute(99, "bayesbl_format"),
    "an earlier version": attribute(0, "bayesbl_format"),
    "a negative version": attribute(-1, "bayesbl_format"),
    "a version of text": attribute("one", "bayesbl_format"),
    "outcome missing": attribute(None, "outcome"),
    "outcome running": attribute("running", "outcome"),
    "outcome nonsense": attribute("nonsense", "outcome"),
    "outcome a number": attribute(1, "outcome"),
}
"""What may be wrong inside a result.nc that is sound as a file."""


class Cases:
    """The groups over the originals."""

    def __init__(self, originals: Originals) -> None:
        self.originals = originals

    def expected(self, kind: str, step: Step) -> tuple[int, str]:
        """Status and answer of the undamaged result, which lies in the working directory.

        The first case that asks keeps them for those after it.
        """
        name = re.sub(r"\W+", "-", f"{kind} {' '.join(step)}")
        kept = self.originals.folder / f"{name}.json"
        if kept.exists():
            status, said = json.loads(kept.read_text())
            return status, said
        found = answer(run_step(step)[0], step)
        clean()
        beside = kept.with_name(f"{name}.{os.getpid()}")
        beside.write_text(json.dumps(found))
        os.replace(beside, kept)
        return found

    def steps(self, kind: str, rng: np.random.Generator) -> list[Step]:
        """The reading command of this case."""
        cheap = [INSPECT, REPORT] if rng.random() < 0.75 else [JSON]
        if rng.random() < 0.1:
            return [FIGURES]
        later = {"sweep": BY_CURVE, "fit": FROM_RESULT, "compare": FROM_RESULT}.get(kind)
        if later is None or rng.random() < 0.7:
            return cheap
        Path("later.toml").write_text(later)
        return [FIT_LATER] if rng.random() < 0.5 else [CHECK_LATER]

    def trial(self, kind: str, steps: list[Step], damage: Callable[[], object]) -> Trial:
        """The same commands on the undamaged and the damaged result must answer alike."""
        wanted = [self.expected(kind, step) for step in steps]
        damage()
        Path("evil.py").write_text("open('study_file_was_run', 'w')\n")

        def judge(ended: Sequence[Ended]) -> Iterator[Finding]:
            if Path("study_file_was_run").exists():
                yield HARM, "a file that the result names was run"
            for step, told, (status, said) in zip(steps, ended, wanted, strict=True):
                if told.status in (DONE, WITHHELD):
                    found = answer(told, step)
                    if found != (status, said):
                        yield SILENT, f"{' '.join(step)}: {first_difference(said, found[1])}"

        return Trial(
            steps,
            judge,
            names=["result/result.nc", "result/summary.json", "result:", "result,"],
            outputs=["result/figures", "result/report.html", "later"],
            statuses=(DONE, WRONG, WITHHELD),
        )

    def changed(self, kind: str, change: Change, *steps: Step) -> Prepare:
        """A change inside the result.nc, read by these commands or by any."""

        def prepare(place: Path, rng: np.random.Generator) -> Trial:
            import h5py

            folder = self.originals.copy(kind, place)

            def damage() -> None:
                with h5py.File(folder / "result.nc", "r+") as file:
                    change(file, rng)

            return self.trial(kind, list(steps) or self.steps(kind, rng), damage)

        return prepare

    def damaged(self, kind: str, damage: Damage) -> Prepare:
        """Bytes of the result.nc."""

        def prepare(place: Path, rng: np.random.Generator) -> Trial:
            file = self.originals.copy(kind, place) / "result.nc"

            def spoil() -> None:
                file.write_bytes(damage(file.read_bytes(), rng))

            return self.trial(kind, self.steps(kind, rng), spoil)

        return prepare

    def beside(self, kind: str, damage: Damage) -> Prepare:
        """Bytes of the files beside the result.nc."""

        def prepare(place: Path, rng: np.random.Generator) -> Trial:
            folder = self.originals.copy(kind, place)
            names = [p.name for p in folder.iterdir() if p.suffix in (".json", ".csv")]
            file = folder / one(sorted(names), rng)

            def spoil() -> None:
                file.write_bytes(damage(file.read_bytes(), rng))

            return self.trial(kind, [JSON, INSPECT], spoil)

        return prepare

    def group(self) -> Group:
        table = [
            (f"{kind}: {name}", self.changed(kind, change))
            for name, change in CHANGES.items()
            for kind in self.originals.kinds
        ]
        table += [
            (f"{kind}: {name}", self.damaged(kind, damage))
            for name, damage in BYTES.items()
            for kind in self.originals.kinds
        ]
        table += [
            (f"{kind}, beside: {name}", self.beside(kind, damage))
            for name, damage in BYTES.items()
            for kind in self.originals.kinds
        ]
        return Group("results, damaged", 16, mixed(table))


def mixed(table: list[tuple[str, Prepare]]) -> list[tuple[str, Prepare]]:
    """In an order of no meaning, always the same: a short attack meets something of everything."""
    order = np.random.default_rng(0).permutation(len(table))
    return [table[i] for i in order]


def clean() -> None:
    """Take away what the commands on the undamaged result wrote."""
    import shutil

    shutil.rmtree("later", ignore_errors=True)
    Path("result/report.html").unlink(missing_ok=True)
    Path("study_file_was_run").unlink(missing_ok=True)


def answer(ended: Ended, step: Step) -> tuple[int, str]:
    """What a command says, with the files that it writes."""
    here = Path.cwd()
    out = ended.out.replace(str(here), "").replace(here.name, "")
    parts = [out]
    if step == REPORT and Path("result/report.html").exists():
        parts.append(Path("result/report.html").read_text(encoding="utf-8"))
    if step == FIGURES:
        parts += [f"{p.name} {p.read_text()}" for p in sorted(Path("result/figures").glob("*"))]
    if step == FIT_LATER and ended.status in (DONE, WITHHELD):
        told = json.loads(out)
        for key in ("created_utc", "commit"):
            told.pop(key, None)
        parts = [json.dumps(told, sort_keys=True, indent=1)]
    return ended.status, "\n".join(parts)


def first_difference(old: str, new: str) -> str:
    for before, after in zip(old.splitlines(), new.splitlines(), strict=False):
        if before != after:
            return f"{before.strip()[:90]!r} became {after.strip()[:90]!r}"
    return f"{len(old)} characters became {len(new)}"


def written_configuration(originals: Originals, damage: Damage) -> Prepare:
    """The configuration as it ran, damaged: people edit it, so it need not be what it was."""

    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        kind = one(originals.kinds, rng)
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
