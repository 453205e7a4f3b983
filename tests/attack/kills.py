"""Runs killed at any moment: the same command then ends with the same numbers, nothing lost.

``python tests/attack/kills.py --count 50 --seed 16``; each turn starts a run of some kind, kills it
with SIGKILL at a random moment, gives the same command again and compares what it ends with. Too
slow for every push: a turn takes as long as two runs. ``--plant`` kills devices, collectors, fleets
and a broker that has another subscriber instead: each answer is then there once.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

for library in ("OMP", "OPENBLAS", "MKL"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np  # noqa: E402

from attack import plant  # noqa: E402
from attack.engine import DONE, WITHHELD, WRONG, snapshot  # noqa: E402
from attack.unfinished import forgotten, numbers  # noqa: E402
from attack.workshop import REPOSITORY, put_configuration  # noqa: E402

KINDS = ("fit", "compare", "direct", "sweep", "diagnose", "simulate", "study")


@dataclass(frozen=True)
class Undisturbed:
    """How a run ends that nobody kills."""

    seconds: float
    numbers: Any


def start(place: Path, kind: str) -> subprocess.Popen[bytes]:
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    return subprocess.Popen(
        [sys.executable, "-m", "bayesbl", "run", f"{kind}.toml"],
        cwd=place,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=(place / "said.txt").open("wb"),
        start_new_session=True,
    )


def outcome(place: Path, kind: str) -> Any:
    """What a run leaves that must be the same each time."""
    if kind == "simulate":
        return [(place / "result" / name).read_bytes() for name in ("made.csv", "truth.json")]
    return numbers(place / "result")


def undisturbed(folder: Path, kind: str) -> Undisturbed:
    place = folder / f"{kind}-undisturbed"
    place.mkdir()
    put_configuration(place, kind)
    begin = time.monotonic()
    status = start(place, kind).wait()
    if status not in (DONE, WITHHELD):
        raise RuntimeError(f"{kind} ended with {status}: {(place / 'said.txt').read_text()}")
    return Undisturbed(time.monotonic() - begin, outcome(place, kind))


def killed(place: Path, kind: str, after_s: float, expected: Undisturbed) -> Iterator[str]:
    """What is wrong after a run was killed and started again."""
    place.mkdir()
    put_configuration(place, kind)
    inputs = snapshot(place)
    run = start(place, kind)
    time.sleep(after_s)
    # The run alone: its workers have to notice by themselves.
    os.kill(run.pid, signal.SIGKILL)
    run.wait()
    again = start(place, kind)
    status = again.wait()
    said = (place / "said.txt").read_text(errors="replace")
    finished = "finished result" in said or "exists already" in said
    if status not in (DONE, WITHHELD) and not (status == WRONG and finished):
        yield f"the second run ended with status {status}: {said.strip()[:300]}"
        return
    if outcome(place, kind) != expected.numbers:
        yield "the second run ended with other numbers"
    after = snapshot(place)
    yield from (f"{name} was changed" for name, old in inputs.items() if after.get(name) != old)
    if left := forgotten(place):
        yield f"left behind: {', '.join(left[:3])}"
    if living(run.pid):
        yield "processes of the killed run live on"


def living(session: int) -> bool:
    """Whether a process of this session is still there a few seconds later."""
    for _ in range(50):
        try:
            os.killpg(session, 0)
        except ProcessLookupError:
            return False
        time.sleep(0.1)
    os.killpg(session, signal.SIGKILL)
    return True


def kill_plants(folder: Path, count: int, only: str | None, rng: np.random.Generator) -> int:
    """How many of so many turns went wrong."""
    failed, plants = Counter[str](), plant.Plants(folder)
    kinds = [only] if only else plant.KINDS
    try:
        for turn in range(count):
            kind = kinds[turn % len(kinds)]
            after_s, problems = plants.killed(f"turn{turn}", kind, rng)
            failed[kind] += bool(problems)
            told = "; ".join(problems) or "well"
            print(f"{turn}: {kind}, killed after {after_s:.2f} s: {told}", flush=True)
            if not problems:
                shutil.rmtree(folder / f"turn{turn}", ignore_errors=True)
    finally:
        plants.close()
    print(
        ", ".join(
            f"{kind}: {failed[kind]} of {len(range(n, count, len(kinds)))} badly"
            for n, kind in enumerate(kinds)
        )
    )
    return failed.total()


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status: 1 if any turn failed."""
    parser = argparse.ArgumentParser(description="Kill runs at random moments, and run them again.")
    parser.add_argument("--count", type=int, default=50)
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--only", choices=(*KINDS, *plant.KINDS))
    parser.add_argument("--plant", action="store_true", help="kill the parts of a plant")
    options = parser.parse_args(arguments)
    rng = np.random.default_rng(options.seed)
    failed = 0
    with tempfile.TemporaryDirectory(prefix="kills-") as temporary:
        folder, known = Path(temporary), dict[str, Undisturbed]()
        if options.plant:
            failed = kill_plants(folder, options.count, options.only, rng)
        for turn in range(0 if options.plant else options.count):
            kind = options.only or KINDS[turn % len(KINDS)]
            if kind not in known:
                known[kind] = undisturbed(folder, kind)
            after_s = float(rng.uniform(0.0, known[kind].seconds))
            place = folder / f"turn{turn}"
            problems = list(killed(place, kind, after_s, known[kind]))
            failed += bool(problems)
            told = "; ".join(problems) or "well"
            print(f"{turn}: {kind}, killed after {after_s:.2f} s: {told}", flush=True)
            shutil.rmtree(place, ignore_errors=True)
    print(f"{options.count} runs killed, {failed} of them badly.")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
