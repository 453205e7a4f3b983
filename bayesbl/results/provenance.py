"""Provenance of a result, as attributes that NetCDF can hold."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import bayesbl
from bayesbl.config.loading import dump_config, files_of
from bayesbl.config.sections import RunConfig

DEPENDENCIES = (
    "numpy",
    "scipy",
    "cma",
    "emcee",
    "arviz-stats",
    "xarray",
    "netCDF4",
    "numba",
    "pydantic",
    "matplotlib",
)
"""Packages whose version may change a number or a figure."""

UNKNOWN = "unknown"


def provenance_of(config: RunConfig) -> dict[str, str | int]:
    """Attributes for the root of the result of a configuration."""
    named = {str(f): file_sha256(f) for f in files_of(config.model_dump()) if f.is_file()}
    return {
        "bayesbl_version": bayesbl.__version__,
        "git_commit": git_commit(),
        "created_utc": datetime.now(UTC).isoformat(timespec="seconds"),
        "seed": config.run.seed,
        "config": dump_config(config),
        "input_sha256": json.dumps(named, sort_keys=True),
        "python_version": platform.python_version(),
        "dependency_versions": json.dumps(dict(dependency_versions())),
    }


def file_sha256(path: str | Path) -> str:
    """SHA-256 of a file's bytes."""
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


def code_versions() -> dict[str, str]:
    """All versions that may change the numbers: this code, Python, dependencies."""
    package = f"{bayesbl.__version__}, commit {git_commit()}"
    return {"bayesbl": package, "python": platform.python_version(), **dependency_versions()}


@cache
def code_sha256() -> str:
    """SHA-256 of this package's code when this process first called the function."""
    package = Path(bayesbl.__file__).resolve().parent
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(file.relative_to(package).as_posix().encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


@cache
def dependency_versions() -> Mapping[str, str]:
    """Version of each of :data:`DEPENDENCIES`."""
    found = dict.fromkeys(DEPENDENCIES, UNKNOWN)
    for name in DEPENDENCIES:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


@cache
def git_commit() -> str:
    """Commit of the checkout that the package runs from, with ``-dirty`` if files were changed.

    ``"unknown"`` if the package is installed elsewhere. A repository that merely contains its
    environment does not count.
    """
    package = Path(bayesbl.__file__).resolve().parent
    top = _git(package, "rev-parse", "--show-toplevel")
    tracked = _git(package, "ls-files", "--", "__init__.py")
    if not tracked or top is None or Path(top).resolve() != package.parent:
        return UNKNOWN
    commit = _git(package, "rev-parse", "HEAD")
    changes = _git(package, "-c", "core.fileMode=false", "status", "--porcelain", "--", ".")
    if commit is None or changes is None:
        return UNKNOWN
    return f"{commit}-dirty" if changes else commit


def _git(folder: Path, *arguments: str) -> str | None:
    # Inside a git hook, these variables name the hook's repository instead of the folder's.
    environment = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
    try:
        completed = subprocess.run(
            ["git", "-C", str(folder), *arguments],
            env=environment,
            capture_output=True,
            text=True,
            timeout=10,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return completed.stdout.strip()
