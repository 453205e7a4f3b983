"""Read a bench from an identification's result, with the joint prior that a bench file lacks."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from pathlib import Path

from bayesbl.bench.bench import Bench
from bayesbl.bench.parameters import JointNormal
from bayesbl.config.bench import load_bench, parse_bench
from bayesbl.errors import ConfigError, ResultError
from bayesbl.recording.types import FloatArray
from bayesbl.results.store import read_tree
from bayesbl.results.variables import Group, labels, table

IDENTIFIED = Group(
    "identified",
    table("""
        prior_low (parameter) | each parameter's own | lower end of the data sheet's tolerance
        prior_high (parameter) | each parameter's own | upper end of the data sheet's tolerance
        value (parameter) | each parameter's own | as identified
        log_covariance (parameter, parameter_) | 1
            | covariance of the parameters' logarithms; NaN where one may be zero
    """),
    (labels("parameter", "bench parameter"), labels("parameter_", "bench parameter")),
)


def require_gap(bench: Bench, file: str | Path) -> None:
    """Refuse a rigid bench with a ConfigError."""
    if bench.drive == "rigid":
        raise ConfigError(
            "A rigid bench has no gap.",
            file=file,
            found='drive = "rigid"',
            expected='drive = "two_mass"',
        )


def bench_from(path: str | Path) -> Bench:
    """Read a bench from a bench file, or from an identification's ``result.nc`` with its joint
    prior.

    Raises UserError if the file is neither, or the identification withheld its answer.
    """
    if Path(path).suffix.lower() != ".nc" or not os.path.isfile(path):
        return load_bench(path)
    tree = read_tree(path)
    if tree.attrs.get("kind") != "identify":
        raise ResultError(
            "This result holds no bench.",
            file=path,
            found=f"kind {tree.attrs.get('kind')!r}",
            expected="a bench file, or the result of bayesbl identify",
        )
    text = str(tree.attrs.get("identified_bench") or "")
    if not text:
        raise ResultError(
            "This identification has no bench: its answer is withheld.",
            file=path,
            found=str(tree.attrs.get("reason")),
            expected="an identification that ended with a bench",
        )
    stored = tree[IDENTIFIED.name].to_dataset()
    covariance: FloatArray = stored["log_covariance"].values
    known = [i for i, row in enumerate(covariance) if row[i] == row[i]]
    names = tuple(str(stored["parameter"].values[i]) for i in known)
    sources = tuple(json.loads(tree.attrs["input_sha256"]).values())
    joint = JointNormal(names, covariance[known][:, known], sources) if names else None
    return replace(parse_bench(text, path), identified=joint)
