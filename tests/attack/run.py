"""Attack the package: ``python tests/attack/run.py --help``.

A case damages one thing and gives one command or a few. It fails where that ends in a traceback,
takes over 10 s of processor time, answers otherwise than for the undamaged file, changes an input,
leaves a hidden file, or refuses without naming the file. Case number N is always the same for the
same seed and code; ``--case N --keep FOLDER`` repeats it and keeps what it left.

What is done to files stands in tables, a line each: ``damage.BYTES`` for any file,
``recordings.SAME``, ``STRUCTURE`` and ``VALUES``,
``configurations.EDITS`` and its sisters, ``commands.NAMES``, ``MISSING``, ``OUTPUTS``,
``COLLISIONS`` and ``STUDY_FILES``.
"""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import takewhile
from pathlib import Path

# Before NumPy: threads of linear algebra cost more than they bring, and do not survive a fork.
for library in ("OMP", "OPENBLAS", "MKL", "NUMBA"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")
TESTS = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "support")]  # the writer of bags is there

from attack import commands, configurations, recordings  # noqa: E402
from attack.engine import (  # noqa: E402
    HANG,
    HARM,
    KINDS,
    OTHER,
    SILENT,
    TRACEBACK,
    Attack,
    Group,
    Result,
    run_all,
)
from attack.workshop import Originals  # noqa: E402

HEADINGS = {
    TRACEBACK: "tracebacks",
    HANG: "hangs",
    SILENT: "silent changes",
    HARM: "inputs harmed",
    OTHER: "other",
}


def all_groups(originals: Originals) -> list[Group]:
    """Everything that is attacked."""
    return [
        recordings.HARMLESS,
        recordings.DAMAGED,
        configurations.group(),
        configurations.written_files(originals),
        commands.group(),
        commands.files_group(),
    ]


def chosen(attack: Attack, count: int, only: str | None) -> Iterator[int]:
    """The numbers of the first cases, of a group if one is named."""
    number = 0
    while count > 0:
        if only is None or only in attack.case(number)[0].name:
            yield number
            count -= 1
        number += 1


def failures(result: Result) -> list[tuple[str, str]]:
    return [(kind, told) for kind, told in result.findings if kind != "skipped"]


def table(results: Sequence[Result]) -> str:
    """A line per group: cases, and how many of them failed in each way."""
    width = max(len(result.group) for result in results)
    lines = ["  ".join([" " * width, "cases", *HEADINGS.values(), "skipped", "CPU s"])]
    for group in [*dict.fromkeys(result.group for result in results), None]:
        part = [result for result in results if group in (None, result.group)]
        counts = Counter(kind for result in part for kind in {kind for kind, _ in result.findings})
        cells = [f"{counts[kind]:{len(heading)}}" for kind, heading in HEADINGS.items()]
        cells.append(f"{counts['skipped']:7}")
        cells.append(f"{sum(result.seconds for result in part):5.0f}")
        lines.append("  ".join([f"{group or 'all':{width}}", f"{len(part):5}", *cells]))
    return "\n".join(lines)


def told(results: Iterable[Result]) -> Iterator[str]:
    """A line for each failure, the worst kind first."""
    found = [(kind, text, result) for result in results for kind, text in failures(result)]
    for kind, text, result in sorted(found, key=lambda item: KINDS.index(item[0])):
        yield f"--case {result.number}  [{kind}] {result.group}, {result.name}: {text!s}"


def parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Attack the package with damaged and odd inputs.")
    parser.add_argument("--cases", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=16)
    parser.add_argument("--minutes", type=float, default=5.0, help="start no case after these")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", metavar="GROUP", help="groups whose name holds this text")
    parser.add_argument("--case", type=int, action="append", metavar="N", help="repeat this case")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="keep what failing cases left")
    return parser.parse_args(arguments)


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status: 1 if anything failed."""
    options = parse(arguments)
    with tempfile.TemporaryDirectory(prefix="attack-") as temporary:
        folder = (options.keep or Path(temporary)).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        for path in (folder, Path(temporary)):
            path.chmod(0o755)  # cases that give up root's rights work below it
        begin = time.monotonic()
        originals = Originals(folder / "originals")
        print(f"Originals made in {time.monotonic() - begin:.0f} s.", flush=True)
        attack = Attack(all_groups(originals), options.seed)
        numbers = options.case or chosen(attack, options.cases, options.only)
        end = time.monotonic() + 60.0 * options.minutes
        in_time = takewhile(lambda _: time.monotonic() < end, numbers)
        results = []
        for result in run_all(attack, in_time, folder, options.workers):
            results.append(result)
            for line in told([result]):
                print(line, flush=True)
    print(f"\n{table(results)}\n")
    for line in told(results):
        print(line)
    skipped = {text for result in results for kind, text in result.findings if kind == "skipped"}
    for reason in sorted(skipped):
        print(f"skipped: {reason}")
    return int(any(map(failures, results)))


if __name__ == "__main__":
    sys.exit(main())
