"""Keys that ``summary.json`` has of every kind of result."""

from __future__ import annotations

from typing import TypedDict

import xarray as xr

from bayesbl.results.store import texts


class Origin(TypedDict):
    """Where a result comes from."""

    version: str | None
    commit: str | None
    seed: int | None


class Head(Origin):
    """How a run ended and where it came from; ``reason`` says why answers are withheld."""

    outcome: str
    reason: str | None
    warnings: list[str]


def origin(tree: xr.DataTree) -> Origin:
    """Where a result comes from, by its attributes."""
    return {
        "version": tree.attrs.get("bayesbl_version"),
        "commit": tree.attrs.get("git_commit"),
        "seed": tree.attrs.get("seed"),
    }


def head(tree: xr.DataTree) -> Head:
    """The keys that every summary begins with, from the attributes of a stored result."""
    return {
        "outcome": tree.attrs["outcome"],
        "reason": tree.attrs.get("reason") or None,
        "warnings": texts(tree.attrs.get("warnings")),
        **origin(tree),
    }
