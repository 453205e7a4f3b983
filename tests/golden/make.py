"""Run everything of ``golden_runs.py`` and write the numbers to ``golden.json``.

    python tests/golden/make.py                  # all runs, a minute and a half
    python tests/golden/make.py --out FILE       # the same, elsewhere

The kept file was made on the commit that its ``origin`` names. It is written again only where a
number is meant to change, and then the change is told in the commit.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

# On several threads linear algebra rounds otherwise; NumPy reads this when it is imported.
for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"
sys.path[:0] = [str(Path(__file__).resolve().parents[2]), str(Path(__file__).resolve().parent)]

from golden_runs import GOLDEN_FILE, REPOSITORY, RUNS, Workshop, origin_of_machine, today  # noqa: E402

COMMAND = "python tests/golden/make.py"


def commit() -> str:
    """The commit of the package that runs; refused where it differs from what was committed."""
    changed = _git("status", "--porcelain", "--", "bayesbl", "experiments", "configs")
    if changed:
        raise SystemExit(f"The package differs from its commit:\n{changed}")
    return _git("log", "-1", "--format=%H", "--", "bayesbl", "experiments", "configs")


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(REPOSITORY), *arguments]
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout.strip()


def main() -> None:
    """Run, time and write."""
    parser = argparse.ArgumentParser(description="Make the golden values.")
    parser.add_argument("--out", type=Path, default=GOLDEN_FILE)
    wanted = parser.parse_args()
    import bayesbl

    if Path(bayesbl.__file__).resolve().parents[1] != REPOSITORY:
        raise SystemExit(f"Another package would run: {bayesbl.__file__}")
    origin = {"commit": commit(), **origin_of_machine(), "date": today(), "command": COMMAND}
    runs, told = {}, []
    with tempfile.TemporaryDirectory() as folder:
        workshop = Workshop(Path(folder))
        for name in RUNS:
            begin = time.perf_counter()
            runs[name] = workshop.numbers(name)
            told.append(f"{name:22s}{time.perf_counter() - begin:6.1f} s")
    content = {"origin": origin, "runs": runs}
    wanted.out.write_text(json.dumps(content, indent=1, ensure_ascii=False) + "\n", "utf-8")
    print("\n".join(told))


if __name__ == "__main__":
    main()
