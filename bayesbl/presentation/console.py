"""Prints results: the answer, all that limits it, and where a result comes from."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.presentation import direct_route
from bayesbl.presentation.blocks import Block, Heading, Sentence
from bayesbl.presentation.subjects import blocks, subject_of, summary_of
from bayesbl.presentation.terminal import print_blocks
from bayesbl.presentation.words import Summary

if TYPE_CHECKING:
    import xarray as xr
    from rich.console import Console


def print_result(summary: Summary, folder: Path | None, console: Console) -> None:
    """The answer in words, its table, and everything that limits the answer."""
    withheld = summary["outcome"] == "withheld"
    headline = subject_of(summary).headline(summary)
    print_blocks([Sentence(headline, "withheld" if withheld else "answer")], console)
    print_blocks(blocks(summary), console)
    if folder is not None:
        # Not wrapped: a path is there to be copied.
        console.print(f"Written to {folder}", soft_wrap=True)


def print_summary(tree: xr.DataTree, console: Console) -> None:
    """Everything that a stored result says: the answer, parameters, diagnostics, origin."""
    summary = summary_of(tree)
    print_result(summary, None, console)
    print_blocks(subject_of(summary).details(tree, summary), console)
    print_blocks(_origin(tree, summary), console)


def _origin(tree: xr.DataTree, summary: Summary) -> Iterator[Block]:
    yield Heading("Origin")
    lines = {
        "Version": f"{summary['version']}, commit {summary['commit']}",
        "Made": tree.attrs.get("created_utc"),
        "Seed": summary["seed"],
        "Gap curve": None if direct_route.is_direct(summary) else summary.get("curve"),
    }
    inputs = json.loads(tree.attrs.get("input_sha256", "{}"))
    lines |= {f"SHA-256 of {file}": digest for file, digest in inputs.items()}
    for label, content in lines.items():
        if content is not None:
            yield Sentence(str(content), label=label)
