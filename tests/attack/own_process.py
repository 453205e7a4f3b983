"""What only a process of its own can show: encodings, closed pipes, places that are read-only."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from attack.engine import (
    HANG,
    HARM,
    OTHER,
    TRACEBACK,
    Finding,
    Group,
    Skipped,
    Trial,
    give_to_nobody,
    give_up_root,
)
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


def ascii_output(place: Path) -> Findings:
    """A terminal that knows no Greek: characters are degraded, and the answer is given."""
    yield from judged(command(place, "run", "fit.toml", env={"PYTHONIOENCODING": "ascii"}), 0, 3)
    for asked in (
        ("inspect", "result"),
        ("effects",),
        ("cite",),
        ("--help",),
        ("check", "fit.toml"),
    ):
        yield from judged(command(place, *asked, env={"PYTHONIOENCODING": "ascii"}), 0)


def other_encodings(place: Path) -> Findings:
    for encoding in ("latin-1", "cp1252", "cp437", "utf-16"):
        yield from judged(command(place, "effects", env={"PYTHONIOENCODING": encoding}), 0)


def plain_locale(place: Path) -> Findings:
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    (place / "e\u0301.csv").write_text(plain_csv(example()))
    yield from judged(command(place, "effects", env=plain), 0)
    # Whether such a locale can say this name depends on Python's: then it is refused in words.
    told = command(place, "init", "e\u0301.csv", env=plain)
    yield from judged(told, 0, 2)
    if told.returncode == 2 and b"not UTF-8" not in told.stderr:
        yield OTHER, f"refused in other words: {told.stderr.decode(errors='replace')[:200]}"


def closed_pipe(place: Path) -> Findings:
    """``bayesbl effects | head -1``: the reader has gone, which is no mistake of anybody."""
    for asked in (("effects",), ("cite",), ("check", "fit.toml")):
        reader, writer = os.pipe()
        os.close(reader)
        ended = command(place, *asked, stdout=writer, stderr=subprocess.PIPE, capture_output=False)
        os.close(writer)
        yield from judged(ended, 0, 1, 2, 141, -13)
        if b"Exception ignored" in ended.stderr:
            yield TRACEBACK, f"{asked[0]}: {ended.stderr.decode().strip()[:200]}"


def no_output_at_all(place: Path) -> Findings:
    """Started without a standard output, as services are: the answer is in the result."""
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    for asked in ("check", "run"):
        closed = ["sh", "-c", f'exec "$0" -m bayesbl {asked} fit.toml >&- 2>&-', sys.executable]
        ended = subprocess.run(closed, cwd=place, env=environment, timeout=LONGEST_S)
        if ended.returncode not in (0, 3):
            yield OTHER, f"{asked} without a standard output: status {ended.returncode}"
    if not (place / "result" / "result.nc").exists():
        yield OTHER, "without a standard output no result is stored"


def output_to_full_device(place: Path) -> Findings:
    with open("/dev/full", "wb") as full:
        ended = command(place, "effects", stdout=full, stderr=subprocess.PIPE, capture_output=False)
    yield from judged(ended, 1)


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


def full_disk(place: Path) -> Findings:
    """A file system of a megabyte, where one may be made."""
    small = place / "small"
    small.mkdir()
    made = ["mount", "-t", "tmpfs", "-o", "size=80k", "tmpfs", str(small)]
    if os.geteuid() != 0 or subprocess.run(made, capture_output=True).returncode:
        raise Skipped("no file system can be mounted here to be filled")
    try:
        ended = command(place, "run", "fit.toml", "--out", "small/result")
        yield from judged(ended, 1, 2)
        if b"small" not in ended.stderr:
            yield OTHER, f"a full disk is not named: {ended.stderr.decode()[:200]}"
        left = [path.name for path in small.rglob("*") if path.name.startswith(".")]
        if left:
            yield OTHER, f"on a full disk {left} is left behind"
    finally:
        subprocess.run(["umount", str(small)], capture_output=True)


CASES: Mapping[str, Callable[[Path], Findings]] = {
    "an output in ASCII": ascii_output,
    "outputs in other encodings": other_encodings,
    "a plain locale": plain_locale,
    "a closed pipe": closed_pipe,
    "no output at all": no_output_at_all,
    "an output that is full": output_to_full_device,
    "a read-only package without a home": read_only_package,
    "memory of a large CSV": memory_of_a_large_csv,
    "a full disk": full_disk,
}


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


GROUP = Group("own process", 1, [(name, in_own_process(work)) for name, work in CASES.items()])
