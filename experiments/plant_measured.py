"""A plant measured in full: what a recording costs from file to row, and a run with nothing new.

    python experiments/plant_measured.py FOLDER [JOINTS] [RECORDINGS]

Joints of three types, each with its own bench, wear at rates that differ by 40 %; their recordings,
a month apart, are made on these benches. ``bayesbl fleet`` runs over all of them, then with nothing
new, then with one new file. Prints the core-seconds and the time of each, and how many 90 %
intervals hold the gap and the rate.
"""

from __future__ import annotations

import math
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from datetime import date, timedelta
from pathlib import Path

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import dump_bench, load_bench

BENCH = Path(__file__).parents[1] / "configs/bench.toml"
TYPES = {"RV-80": (2.0e-4, 1.0), "RV-20": (1.0e-4, 0.8), "HD-25": (1.5e-4, 1.25)}
"""Median rate, rad/year, and shaft stiffness and load inertia over the reference bench's."""

SPREAD = 0.4
FIRST_GAPS_RAD = (3e-4, 8e-4)
ROTATIONS, SAMPLING_HZ = 3.0, 500.0
FIRST = date(2024, 1, 1)
MONTH = timedelta(days=30)

CONFIG = """schema = 1
kind = "fleet"
[run]
seed = 1
workers = 2
output = "plant"
[fleet]
joints = "joints.csv"
recordings = "data/{joint}/{date}.csv"
pool_by = "gearbox"
[estimator]
route = "amplitude"
"""


@dataclass(frozen=True, slots=True)
class Wearing:
    """A joint that wears steadily."""

    name: str
    gearbox: str
    first_rad: float
    rate_rad_per_year: float

    def gap_rad(self, number: int) -> float:
        """At its recording of this number."""
        return self.first_rad + self.rate_rad_per_year * number * MONTH.days / 365.25


def wearing(joints: int) -> list[Wearing]:
    """The joints of a plant, always the same."""
    rng = np.random.default_rng(2203)
    found = []
    for number in range(joints):
        gearbox = list(TYPES)[number % len(TYPES)]
        rate = TYPES[gearbox][0] * math.exp(SPREAD * rng.standard_normal())
        name = f"R{number // 6 + 1:02d}-J{number % 6 + 1}"
        found.append(Wearing(name, gearbox, rng.uniform(*FIRST_GAPS_RAD), rate))
    return found


def record(folder: Path, joint: Wearing, number: int) -> None:
    """Write one recording, unless it is there."""
    file = folder / f"data/{joint.name}/{FIRST + number * MONTH}.csv"
    if file.exists():
        return
    bench = bench_of(joint.gearbox)
    seed = np.random.SeedSequence([2204, *joint.name.encode(), number])
    start, noise = (np.random.default_rng(own) for own in seed.spawn(2))
    made = bench.simulate(
        joint.gap_rad(number),
        rotations=ROTATIONS,
        sampling_hz=SAMPLING_HZ,
        start_angle_rad=start.uniform(0.0, 2.0 * math.pi),
        seed=noise,
    )
    rows = np.column_stack([made.time_s, made.motor_speed_rpm])
    np.savetxt(file, rows, fmt="%.7g", delimiter=",", header="time_s,motor_speed_rpm", comments="")


def bench_of(gearbox: str) -> Bench:
    """The bench of a type."""
    bench = load_bench(BENCH)
    factor = TYPES[gearbox][1]
    changed = {
        name: factor * bench.value(name)
        for name in ("shaft_stiffness_nm_per_rad", "load_inertia_kg_m2")
    }
    return bench.with_parameters(**changed)


def make(folder: Path, joints: list[Wearing], recordings: int) -> None:
    """Inventory, benches, configuration and recordings."""
    folder.mkdir(parents=True, exist_ok=True)
    for gearbox in TYPES:
        (folder / f"{gearbox}.toml").write_text(dump_bench(bench_of(gearbox)))
    rows = [f"{one.name},{one.gearbox},{one.gearbox}.toml,1.2e-3" for one in joints]
    (folder / "joints.csv").write_text("\n".join(["joint,gearbox,bench,limit_rad", *rows, ""]))
    (folder / "plant.toml").write_text(CONFIG)
    for one in joints:
        (folder / f"data/{one.name}").mkdir(parents=True, exist_ok=True)
        for number in range(recordings):
            record(folder, one, number)


def fleet(folder: Path, what: str, files: int) -> None:
    """Run it, and print what it took."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    before, began = used.ru_utime + used.ru_stime, time.monotonic()
    command = [sys.executable, "-m", "bayesbl", "fleet", str(folder / "plant.toml")]
    subprocess.run(command, check=True)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    cores = used.ru_utime + used.ru_stime - before
    each = f", {cores / files:.2f} for each of {files} recordings" if files else ""
    print(f"{what}: {time.monotonic() - began:.1f} s, {cores:.1f} core-seconds{each}", flush=True)


def held(folder: Path, joints: list[Wearing]) -> None:
    """Print how many intervals hold the truth."""
    import pyarrow.parquet

    truth = {one.name: one for one in joints}
    rows = pyarrow.parquet.read_table(folder / "plant/recordings.parquet").to_pylist()
    gaps, withheld = [], 0
    for row in rows:
        if row["reason"] is not None:
            withheld += 1
            continue
        number = (date.fromisoformat(row["date"]) - FIRST) // MONTH
        gap = truth[row["joint"]].gap_rad(number)
        gaps.append(row["delta_rad_low"] <= gap <= row["delta_rad_high"])
    rates = [
        row["rate_rad_per_year_low"]
        <= truth[row["joint"]].rate_rad_per_year
        <= row["rate_rad_per_year_high"]
        for row in pyarrow.parquet.read_table(folder / "plant/joints.parquet").to_pylist()
        if row["rate_rad_per_year_low"] is not None
    ]
    print(f"90 % intervals hold {sum(gaps)} of {len(gaps)} gaps, {withheld} withheld")
    print(f"and {sum(rates)} of {len(rates)} rates of {len(joints)} joints")


def main(folder: Path, joints: int = 100, recordings: int = 24) -> None:
    """Make the plant but for one recording, and run the fleet three times."""
    plant = wearing(joints)
    make(folder, plant, recordings)
    last = folder / f"data/{plant[-1].name}/{FIRST + (recordings - 1) * MONTH}.csv"
    last.unlink()
    fleet(folder, "the whole plant", joints * recordings - 1)
    fleet(folder, "nothing new", 0)
    record(folder, plant[-1], recordings - 1)
    fleet(folder, "one new file", 1)
    held(folder, plant)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:4]))
