"""Prints results: the answer, all that limits it, and where a result comes from."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.presentation import answer
from bayesbl.presentation.blocks import Block, Heading, Sentence
from bayesbl.presentation.subjects import SUBJECTS, blocks
from bayesbl.presentation.terminal import print_blocks
from bayesbl.runs.kinds import summarise

if TYPE_CHECKING:
    import xarray as xr
    from rich.console import Console

    from bayesbl.runs.kinds import Summary


def print_result(summary: Summary, folder: Path | None, console: Console) -> None:
    """The answer in words, its table, and everything that limits the answer."""
    print_headline(summary, console)
    print_blocks(blocks(summary), console)
    if folder is not None:
        # Not wrapped: a path is there to be copied.
        console.print(f"Written to {folder}", soft_wrap=True)


def print_headline(summary: Summary, console: Console) -> None:
    """The answer in a sentence."""
    withheld = summary["outcome"] == "withheld"
    headline = SUBJECTS[summary["kind"]].headline(summary)
    print_blocks([Sentence(headline, "withheld" if withheld else "answer")], console)


def print_details(tree: xr.DataTree, summary: Summary, console: Console) -> None:
    """Parameters, diagnostics, and where a result comes from."""
    print_blocks(SUBJECTS[summary["kind"]].details(tree, summary), console)
    print_blocks(_origin(tree, summary), console)


def print_summary(tree: xr.DataTree, console: Console) -> None:
    """Everything that a stored result says: the answer, parameters, diagnostics, origin."""
    summary = summarise(tree)
    print_result(summary, None, console)
    print_details(tree, summary, console)


def _origin(tree: xr.DataTree, summary: Summary) -> Iterator[Block]:
    yield Heading("Origin")
    lines = {
        "Version": f"{summary['version']}, commit {summary['commit']}",
        "Made": tree.attrs.get("created_utc"),
        "Seed": summary["seed"],
        "Gap curve": _curve(summary),
    }
    inputs = json.loads(tree.attrs.get("input_sha256", "{}"))
    lines |= {f"SHA-256 of {file}": digest for file, digest in inputs.items()}
    for label, content in lines.items():
        if content is not None:
            yield Sentence(str(content), label=label)


def _curve(summary: Summary) -> str | None:
    """The curve that a sweep made, or that gaps were read from."""
    if summary["kind"] == "sweep":
        return summary["curve"]
    if answer.is_measured(summary):
        return summary["curve"]
    return None
