"""What is said of each kind of result, by the module that puts it in words."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from types import MappingProxyType, ModuleType
from typing import TYPE_CHECKING

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
from bayesbl.presentation.blocks import Block, Sentence, labelled

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.runs.kinds import Summary

SUBJECTS: Mapping[str, ModuleType] = MappingProxyType(
    {
        "fit": answer,
        "compare": answer,
        "diagnose": diagnosis,
        "identify": identification,
        "sweep": sweep,
        "plan": plan,
        "study": study,
        "fleet": fleet,
    }
)
"""Kind of result to the module with its ``headline``, ``blocks``, ``advice`` and ``assumptions``.

Each is a function of the summary: the answer in a sentence, all that is said below it, what to do,
and what is taken for granted. A fleet has pages of its own, and needs neither of the last two.
"""


def blocks(summary: Summary) -> Iterator[Block]:
    """Everything that is said of a result below its headline."""
    kind = summary["kind"]
    yield from SUBJECTS[kind].blocks(summary)
    for warning in summary["warnings"]:
        label = "Note" if kind in ("diagnose", "identify") else "Warning"
        yield Sentence(warning, "warning", label)


def details(tree: xr.DataTree, summary: Summary) -> Iterator[Block]:
    """Diagnostics, from the stored result too."""
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
