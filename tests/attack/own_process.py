"""What only a process of its own can show: memory, and a package that is read-only."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from attack.engine import HANG, HARM, OTHER, TRACEBACK, Finding, Trial, give_to_nobody, give_up_root
from attack.workshop import REPOSITORY, example, plain_csv, put_configuration

FEW_TIMES = 6.0
"""Memory of a command, at most so many times the file, beyond what a small file takes."""
LARGE_BYTES = 60_000_000
LONGEST_S = 900.0
"""A process of its own imports and compiles, on a machine that may be busy; what it may take is not
judged here."""

Findings = Iterator[Finding]


def command(
    place: Path, *arguments: str, package: Path = REPOSITORY, **more: object
) -> subprocess.CompletedProcess[bytes]:
    """The command line as a process of its own in a folder."""
    environment = {**os.environ, "PYTHONPATH": str(package), "PYTHONDONTWRITEBYTECODE": "1"}
    environment |= more.pop("env", {})  # type: ignore[arg-type]
    ended = subprocess.run(
        [sys.executable, "-m", "bayesbl", *arguments],
        cwd=place,
        env=environment,
        stdin=subprocess.DEVNULL,
        timeout=LONGEST_S,
        **{"capture_output": True, **more},  # type: ignore[call-overload]
    )
    assert isinstance(ended, subprocess.CompletedProcess)
    return ended


def judged(ended: subprocess.CompletedProcess[bytes], *statuses: int) -> Findings:
    told = (ended.stderr or b"").decode("utf-8", "replace")
    if "Traceback" in told or "This is a bug" in told:
        yield TRACEBACK, told.strip().splitlines()[-1][:300]
    elif ended.returncode not in statuses:
        yield OTHER, f"status {ended.returncode}: {told.strip()[:300]}"


def read_only_package(place: Path, *commands: Sequence[str]) -> Findings:
    """A container: nobody may write to the package, nor is there a home to write to.

    By default it simulates and measures, which compiles everything anew.
    """
    package = place / "package"
    without = shutil.ignore_patterns("__pycache__")
    shutil.copytree(REPOSITORY / "bayesbl", package / "bayesbl", ignore=without)
    home = place / "home"
    home.mkdir()
    for path in (home, package, *package.rglob("*")):
        path.chmod(0o555 if path.is_dir() else 0o444)
    private = {"HOME": str(home), "XDG_CACHE_HOME": str(home / "cache")}
    more: dict[str, object] = {}
    if os.geteuid() == 0:
        give_to_nobody(place, *place.glob("*.*"))
        more = {"preexec_fn": give_up_root}
    os.environ.pop("NUMBA_CACHE_DIR", None)  # this process runs one case alone
    simple = (place / "fit.toml").read_text().replace("max_steps = 1000", "max_steps = 100")
    (place / "fit.toml").write_text(simple)
    try:
        for asked in commands or (
            ("simulate", "simulate.toml"),
            ("run", "fit.toml", "--out", "fit"),
        ):
            yield from judged(command(place, *asked, package=package, env=private, **more), 0, 3)
    finally:
        for path in (home, package, *package.rglob("*")):
            path.chmod(0o755)


def memory_of_a_large_csv(place: Path, size_bytes: int = LARGE_BYTES) -> Findings:
    """At most so many times the file, above what a small one takes."""
    head, *lines = plain_csv(example()).splitlines()
    size = len("\n".join(lines)) + 30 * len(lines)
    with (place / "large.csv").open("w") as stream:
        stream.write(head + "\n")
        for turn in range(2 * size_bytes // size + 2):
            stream.writelines(
                f"{turn * 8.3 + i * 0.01:.6f},{row.partition(',')[2]}\n"
                for i, row in enumerate(lines)
            )
            if stream.tell() > size_bytes:
                break
    for name in ("before", "large"):
        text = (place / "fit.toml").read_text().replace("before.csv", f"{name}.csv")
        (place / f"{name}.toml").write_text(text)
    small, large = (peak_bytes(place, f"{name}.toml") for name in ("before", "large"))
    times = (large - small) / (place / "large.csv").stat().st_size
    if times > FEW_TIMES:
        yield OTHER, f"check of a CSV file takes {times:.1f} times its size in memory"


def peak_bytes(place: Path, config: str) -> int:
    """The largest memory that a check takes."""
    program = (
        "import resource, sys; from bayesbl.cli import status; status(['check', sys.argv[1]]);"
        "print('PEAK', resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)"
    )
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    ended = subprocess.run(
        [sys.executable, "-c", program, config],
        cwd=place,
        env=environment,
        capture_output=True,
        text=True,
        timeout=LONGEST_S,
    )
    return 1024 * int(ended.stdout.rpartition("PEAK ")[2])


def in_own_process(
    work: Callable[[Path], Findings],
) -> Callable[[Path, np.random.Generator], Trial]:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        put_configuration(place, "simulate")
        put_configuration(place, "direct")
        put_configuration(place, "fit")
        inputs = {path.name: path.read_bytes() for path in place.glob("*.csv")}
        try:
            findings = list(work(place))
        except subprocess.TimeoutExpired as late:
            findings = [(HANG, f"over {LONGEST_S:g} s: {late.cmd[-2:]}")]
        changed = [
            name for name, content in inputs.items() if (place / name).read_bytes() != content
        ]
        findings += [(HARM, f"{name} was changed") for name in changed]
        return Trial([], lambda ended: iter(findings))

    return prepare
