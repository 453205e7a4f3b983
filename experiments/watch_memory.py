"""What ``bayesbl watch`` takes for each recording, in a row: core-seconds and memory.

    python experiments/watch_memory.py FOLDER [RECORDINGS]

The recordings are the example's, a day apart, each with its own added noise; the joint's curve is
the paper's. Prints, for every tenth recording, the core-seconds since the last line by recording,
the memory now, how much of it is its own rather than pages of files, which processes share and the
system can drop, and the size of all that was written.
"""

from __future__ import annotations

import resource
import sys
import time
from collections.abc import Mapping
from datetime import date, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from bayesbl.libraries import bare

EXAMPLE = Path(__file__).parents[1] / "configs/recordings/wear_before.csv"
ADDED_SD_RPM = 0.02
EVERY = 10

CONFIG = """schema = 1
kind = "fleet"
[fleet]
joints = "joints.csv"
recordings = "data/{joint}/{date}.csv"
[run]
output = "plant"
"""


def make(folder: Path, recordings: int) -> None:
    """The inventory, the configuration and the recordings."""
    (folder / "data/J1").mkdir(parents=True)
    (folder / "joints.csv").write_text("joint,curve,gear_ratio\nJ1,published,120\n")
    (folder / "plant.toml").write_text(CONFIG)
    head, *lines = EXAMPLE.read_text().splitlines()
    columns = head.split(",")
    values = np.array([[float(x) for x in line.split(",")] for line in lines])
    speed = columns.index("motor_speed_rpm")
    for number in range(recordings):
        made = values.copy()
        made[:, speed] += ADDED_SD_RPM * np.random.default_rng(number).standard_normal(len(made))
        file = folder / f"data/J1/{date(2025, 1, 1) + timedelta(days=number)}.csv"
        np.savetxt(file, made, fmt="%.7g", delimiter=",", header=head, comments="")


def memory_mb() -> tuple[float, float]:
    """Resident now, and how much of that is of no file."""
    _, resident, of_files, *_ = map(int, Path("/proc/self/statm").read_text().split())
    page_mb = resource.getpagesize() / 1e6
    return resident * page_mb, (resident - of_files) * page_mb


def main(folder: Path, recordings: int = 200) -> None:
    """Make the plant, watch it as the command does, and print."""
    with bare():
        _watch(folder, recordings)


def _watch(folder: Path, recordings: int) -> None:
    from bayesbl.config.kinds import FleetConfig
    from bayesbl.config.loading import load_config
    from bayesbl.runs.watch import Watched, watch

    make(folder, recordings)
    config = load_config(folder / "plant.toml")
    assert isinstance(config, FleetConfig)
    count, clock = 0, time.process_time()

    def tell(row: Mapping[str, Any]) -> None:
        nonlocal count, clock
        count += 1
        if count > 1 and count % EVERY:
            return
        took, clock = time.process_time() - clock, time.process_time()
        written = [folder / ".plant.kept", folder / ".finished", folder / "plant_watched"]
        size = sum(f.stat().st_size for place in written for f in place.iterdir()) / 1e6
        resident, own = memory_mb()
        print(
            f"{count}: {took / (1 if count == 1 else EVERY):.2f} core-s, {resident:.0f} MB, "
            f"{own:.0f} its own, {size:.1f} MB on disk",
            flush=True,
        )

    asked = Watched(folder / "data", folder / "plant_watched", once=True, settled_s=0.1)
    watch(config, asked, print, tell)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    print(f"largest memory: {peak:.0f} MB")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:3]))
