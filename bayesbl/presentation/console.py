"""Prints results, summaries and errors with rich; what is said stands in ``words``.

rich is imported where it prints, so that ``bayesbl --help`` does not wait for it. Everything is
printed as plain :class:`rich.text.Text`: names and messages may hold brackets, which rich would
take for markup.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from bayesbl.errors import UserError
from bayesbl.presentation import words
from bayesbl.presentation.diagnosis import located, print_diagnosis
from bayesbl.presentation.direct_route import print_direct_details, print_other_route
from bayesbl.presentation.sweep import print_sweep
from bayesbl.presentation.terminal import add_row, new_table, print_table, say
from bayesbl.presentation.wear import answer, print_wear
from bayesbl.presentation.words import Summary
from bayesbl.units import number

if TYPE_CHECKING:
    import xarray as xr
    from rich.console import Console
    from rich.table import Table


def make_console(*, stderr: bool = False) -> Console:
    """A console that prints what it is given, in colour on a terminal only."""
    from rich.console import Console

    return Console(stderr=stderr, highlight=False, markup=False, emoji=False)


def error(console: Console, problem: UserError) -> None:
    """One message, never wrapped: paths in it can be copied, and scripts can search it."""
    from rich.text import Text

    text = Text("Error: ", style="bold red")
    console.print(text.append(str(problem), style="not bold default"), soft_wrap=True)


def print_result(summary: Summary, folder: Path | None, console: Console) -> None:
    """The answer in words, a table of the snapshots, and everything that limits the answer.

    Of a sweep: the curve in words, its polynomial, and other degrees beside it.
    """
    if summary["kind"] == "sweep":
        print_sweep(summary, console)
    elif summary["kind"] == "diagnose":
        print_diagnosis(summary, console)
    else:
        _print_snapshots(summary, console)
    _print_limits(summary, console)
    if folder is not None:
        # Not wrapped: a path is there to be copied.
        console.print(words.written(folder), soft_wrap=True)


def _print_snapshots(summary: Summary, console: Console) -> None:
    withheld = summary["outcome"] == "withheld"
    first, *others = answer(summary)
    say(console, first, "bold yellow" if withheld else "bold")
    for sentence in (*others, *words.steps(summary), words.above_limit(summary)):
        if sentence:
            say(console, sentence)
    if words.has_shrunk(summary):
        say(console, words.SHRANK, "yellow")
    print_table(_snapshot_table(summary), console)
    for name, part in words.snapshots(summary):
        checked = words.sampler_check(part)
        if checked:
            say(console, checked, "dim", label=name)
    if summary.get("wear"):
        print_wear(summary, console)
    say(console, words.GAP_EXPLAINED, "dim")
    for sentence in words.outliers(summary):
        say(console, sentence, "dim")
    told = words.budget(summary)
    if told:
        say(console, told, "dim")
    if words.is_direct(summary):
        print_other_route(summary, console)


def print_summary(tree: xr.DataTree, console: Console) -> None:
    """Everything that a stored result says: the answer, parameters, diagnostics, origin."""
    from bayesbl.runs.summary import summarise

    summary = summarise(tree)
    print_result(summary, None, console)
    print_details(tree, summary, console)
    _print_origin(tree.attrs, summary, console)


def print_details(tree: xr.DataTree, summary: Summary, console: Console) -> None:
    """Parameters and diagnostics of every snapshot; what a forward diagnosis found, and where."""
    for stage, sentences in located(tree):
        say(console, stage, "bold")
        for sentence in sentences:
            say(console, sentence)
    for name, part in words.snapshots(summary) if _has_snapshots(summary) else []:
        if words.is_direct(summary):
            print_direct_details(name, part, console)
        else:
            _print_details(name, part, _rivals(tree, name), console)


def _print_limits(summary: Summary, console: Console) -> None:
    """Reasons against the answer and notes on it, then what the interval leaves out."""
    for label, sentence in words.reasons(summary) if _has_snapshots(summary) else ():
        say(console, sentence, "yellow", label=label)
    label = "Note" if summary["kind"] == "diagnose" else "Warning"
    for warning in summary["warnings"]:
        say(console, warning, "yellow", label=label)


def _has_snapshots(summary: Summary) -> bool:
    return summary["kind"] in ("fit", "compare")


def _snapshot_table(summary: Summary) -> Table:
    parts = words.snapshots(summary)
    compare = summary["kind"] == "compare"
    # The direct route answers even where the ringing gives no amplitude.
    kind = words.short_kind(
        parts[0][1]["amplitude_rpm"] or next(iter(parts[0][1]["parameters"].values()))
    )
    places = words.common_decimals(part["delta_rad"] for _, part in parts)
    table = new_table(
        *([("Snapshot", "left")] if compare else []),
        ("Gap δ\n(mrad)", "right"),
        (f"{kind}\n(mrad)", "right"),
        ("Ringing A\n(rpm)", "right"),
        ("Load\nrotations", "right"),
        ("Noise sd\n(rpm)", "right"),
        ("Outcome", "left"),
    )
    for name, part in parts:
        add_row(
            table,
            *([name] if compare else []),
            *_gap_cells(part["delta_rad"], places),
            words.median_of(part["amplitude_rpm"], 1),
            f"{part['rotations']:.1f}",
            f"{part['noise']['sd_rpm']:.2f}",
            part["diagnostics"]["outcome"],
        )
    return table


def _gap_cells(delta: Mapping[str, Any] | None, places: int) -> tuple[str, str]:
    if delta is None:
        return "withheld", "withheld"
    return number(1e3 * delta["median"], places), words.bounds(delta, 1e3, places)


def _print_details(name: str, part: Summary, rivals: list[str], console: Console) -> None:
    console.print()
    say(console, f"Snapshot {name}" if name else "Fit", "bold")
    print_table(_parameter_table(part), console)
    lines = {
        **({"Search": part["start"]} if "start" in part else {}),
        "Fit": f"RMSE {part['optimum']['rmse_rpm']:.3f} rpm",
        "Repeating misfit": f"{part['misfit_rms_rpm']:.3f} rpm RMS, the same in every rotation",
        "Noise": words.noise(part),
        "Sampling": words.sampling(part),
        "Rival optima": "; ".join(rivals) or "none",
    }
    for label, sentence in lines.items():
        say(console, sentence, label=label)


def _parameter_table(part: Summary) -> Table:
    """All nine symbols: the free ones with their interval, the others as fixed."""
    from bayesbl.ringing.symbols import SYMBOLS

    table = new_table(
        ("Parameter", "left"),
        ("Optimum", "right"),
        ("Median", "right"),
        (words.short_kind(part["amplitude_rpm"]), "right"),
        ("Unit", "left"),
    )
    for symbol in SYMBOLS.values():
        best = part["optimum"][symbol.name]
        found = part["parameters"].get(symbol.name)
        if found is None:
            add_row(table, symbol.name, f"{best:g}", "", "fixed", symbol.unit)
            continue
        places = words.decimals(found, units=20.0)
        add_row(
            table,
            symbol.name,
            number(best, places),
            number(found["median"], places),
            words.bounds(found, places=places),
            symbol.unit,
        )
    return table


def _rivals(tree: xr.DataTree, name: str) -> list[str]:
    """Other local optima of one snapshot, as amplitude and RMSE."""
    optimum = tree["optimum"].to_dataset()
    if name:
        optimum = optimum.sel(snapshot=name)
    amplitudes, errors = optimum["rival_amplitude_rpm"].values, optimum["rival_rmse_rpm"].values
    return [
        f"A = {a:.1f} rpm at RMSE {e:.3f} rpm"
        for a, e in zip(amplitudes, errors, strict=True)
        if a == a  # padding of snapshots with fewer rivals is NaN
    ]


def _print_origin(attributes: Mapping[Any, Any], summary: Summary, console: Console) -> None:
    import json

    console.print()
    say(console, "Origin", "bold")
    inputs = json.loads(attributes.get("input_sha256", "{}"))
    is_direct = _has_snapshots(summary) and words.is_direct(summary)
    lines = {
        "Version": f"{summary['version']}, commit {summary['commit']}",
        "Made": attributes.get("created_utc"),
        "Seed": summary["seed"],
        "Gap curve": None if is_direct else summary.get("curve"),
        **{f"SHA-256 of {file}": digest for file, digest in inputs.items()},
    }
    for label, content in lines.items():
        if content is not None:
            say(console, str(content), label=label)
