"""What commands print: results, the catalogue of effects, the guesses of ``init``."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping
from importlib.resources import files
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

from bayesbl import __version__
from bayesbl.presentation import (
    answer,
    diagnosis,
    estimates,
    fleet,
    identification,
    plan,
    study,
    sweep,
)
from bayesbl.presentation.blocks import Block, Sentence, aside, labelled, table
from bayesbl.presentation.terminal import print_blocks
from bayesbl.presentation.words import significant
from bayesbl.recording.guessing import NO_UNIT, UNKNOWN
from bayesbl.runs.kinds import summarise

if TYPE_CHECKING:
    import xarray as xr
    from rich.console import Console

    from bayesbl.bench.effect_declaration import Effect
    from bayesbl.presentation.blocks import Tone
    from bayesbl.recording.guessing import Guess
    from bayesbl.runs.kinds import Summary


SUBJECTS: Mapping[str, ModuleType] = {
    "fit": answer,
    "compare": answer,
    "diagnose": diagnosis,
    "identify": identification,
    "sweep": sweep,
    "plan": plan,
    "study": study,
    "fleet": fleet,
}
"""Module for each kind of result, with functions of the summary: ``headline`` (one sentence),
``blocks`` (everything below it) and ``advice``; and with ``ASSUMPTIONS``, or for measured gaps the
function ``assumptions``. A fleet has pages of its own and lacks the last two."""


def blocks(summary: Summary) -> Iterator[Block]:
    """Everything below the headline of a result."""
    kind = summary["kind"]
    yield from SUBJECTS[kind].blocks(summary)
    for warning in summary["warnings"]:
        label = "Note" if kind in ("diagnose", "identify") else "Warning"
        yield Sentence(warning, "warning", label)


def details(tree: xr.DataTree, summary: Summary) -> Iterator[Block]:
    """Diagnostics of a stored result."""
    return estimates.blocks(tree, summary) if answer.is_measured(summary) else iter(())


def origin(tree: xr.DataTree) -> Iterator[Block]:
    """Where a stored result comes from: versions, seed, inputs."""
    stored = tree.attrs
    inputs = json.loads(stored.get("input_sha256", "{}"))
    versions = json.loads(stored.get("dependency_versions", "{}"))
    packages = {"python": stored.get("python_version"), **versions}
    lines = {
        "Version": f"{stored.get('bayesbl_version')}, commit {stored.get('git_commit')}",
        "Made": stored.get("created_utc"),
        "Seed": stored.get("seed"),
        "Packages": ", ".join(f"{name} {version}" for name, version in packages.items() if version),
        **{f"SHA-256 of {file}": digest for file, digest in inputs.items()},
    }
    yield from labelled(lines)


def all_bibtex() -> str:
    """The works behind every result as BibTeX; ``annote`` says what each contributes."""
    stored = files("bayesbl.presentation") / "citations.bib"
    return stored.read_text(encoding="utf-8").strip().replace("VERSION", __version__)


def print_result(summary: Summary, folder: Path | None, console: Console) -> None:
    """Print the answer, the advice, the tables, and everything that limits the answer."""
    tone: Tone = "withheld" if summary["outcome"] == "withheld" else "answer"
    print_blocks([Sentence(SUBJECTS[summary["kind"]].headline(summary), tone)], console)
    if answer.is_measured(summary):
        print_blocks([Sentence(answer.advice(summary).title, tone)], console)
    print_blocks(blocks(summary), console)
    if folder is not None:
        # Not wrapped: a path is there to be copied.
        console.print(f"Written to {folder}", soft_wrap=True)


def print_summary(tree: xr.DataTree, console: Console) -> None:
    """Print everything that a stored result says: answer, parameters, diagnostics, origin."""
    summary = summarise(tree)
    print_result(summary, None, console)
    print_blocks(details(tree, summary), console)
    print_blocks([Sentence("Origin", "heading"), *origin(tree)], console)


def catalogue(effects: Iterable[Effect]) -> Iterator[Block]:
    """Each effect with its place of action and a sentence."""
    yield from labelled({f"{one.name} ({one.enters})": one.sentence for one in effects})
    yield aside("bayesbl effects NAME shows one in full.")


_REPEATS = {
    "always": "yes",
    "whole_orders": "with a whole number of cycles per load rotation",
    "never": "no",
}


def entry(effect: Effect) -> Iterator[Block]:
    """The full catalogue entry of an effect."""
    repeats = {item.name: _REPEATS[item.repeats] for item in effect.amplitudes}
    answers = set(repeats.values())
    if len(answers) != 1:
        answers = {", ".join(f"{name}: {answer}" for name, answer in repeats.items())}
    yield Sentence(effect.name, "answer")
    lines = {
        "What": effect.sentence,
        "Equation": effect.equation,
        "Enters": effect.enters,
        "Depends on": ", ".join(effect.depends_on).replace("_", " "),
        "Repeats each load rotation": answers.pop(),
        "In the data": effect.data,
        "Reference": effect.reference,
    }
    yield from labelled(lines)
    rows = [
        (item.name, item.unit or "1", *(f"{value:g}".replace("-", "−") for value in values))
        for item in effect.parameters
        for values in [(item.low, item.high, item.neutral)]
    ]
    yield table(("Parameter", "Unit", "#Low", "#High", "#Off or default"), rows)
    for item in effect.parameters:
        yield Sentence(item.meaning, "aside", item.name)


_SHARE = re.compile(r"[\[(]\s*(%|‰|prozent|promille|per ?cent|per ?mille)", re.IGNORECASE)


def guess_blocks(guess: Guess) -> Iterator[Block]:
    """The guessed columns with channel, unit and reason, and what to check."""
    yield Sentence("Guessed from the recording; please confirm:", "answer")
    rows = [(column.name, column.channel, column.unit, column.reason) for column in guess.columns]
    yield table(("Column", "Channel", "Unit", "Reason"), rows)
    if guess.unused:
        yield Sentence(", ".join(guess.unused), label="Not used")
    for name in filter(_SHARE.search, guess.unused):
        yield Sentence(
            f"{name} is a share of a rated value. If it is the motor's current or torque, add it "
            'under [columns] with its rated value, for example unit = "% of 12.5 A". A current '
            "makes the interval of δ several times narrower and shows other changes in the joint.",
            "warning",
            "Check",
        )
    for column in guess.columns:
        why = "its unit is not stated"
        if column.doubted or column.unit == UNKNOWN:
            why = column.reason
        elif column.reason != NO_UNIT:
            why += f" ({column.reason})"
        if column.unit == UNKNOWN and not column.needed:
            why = f"left out until its unit is filled in; {why}"
        elif column.is_open or (column.sure and not column.doubted):
            continue
        yield Sentence(f"{column.name}: {why}.", "warning", "Check")


def what_next(path: Path, *, sound: bool, route: str = "") -> str:
    """Where the configuration was written, and what to do with it."""
    if not sound:
        return f"Written to {path}. It cannot run yet:"
    bench = "bench (a file that describes the joint; bayesbl init --bench writes one)"
    correct = {
        "motion": ", for a motion, whose gap is measured with a bench. Correct columns there, and "
        f"fill in {bench}",
        "torque_ramp": ", for ramps of torque with the output held. Correct units and gear_ratio "
        "there",
        "two_encoders": ", for encoders of motor and load. Correct units there, fill in "
        "gear_ratio if it is known",
    }.get(
        route,
        ". Correct columns there, and fill in gear_ratio, limit (when to repair) and " + bench,
    )
    return f"Written to {path}{correct}, then: bayesbl run {shlex.quote(str(path))}"


def recording_line(row: Mapping[str, Any]) -> str:
    """Joint, date and gap with its interval, or the reason for none."""
    what = f"{row['joint']}, {row['date']}: "
    if row["reason"] is not None:
        return what + str(row["reason"])
    middle, low, high = (
        significant(1e3 * row[f"delta_rad_{end}"], 3) for end in ("median", "low", "high")
    )
    return f"{what}gap {middle} mrad ({low} to {high})"
