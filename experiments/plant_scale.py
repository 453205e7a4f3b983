"""How long tables, pooling and pages of a plant take, with simulated answers of its joints.

    python experiments/plant_scale.py FOLDER [JOINTS] [RECORDINGS]

Writes ``recordings.parquet``, ``joints.parquet``, ``summary.json`` and the pages into FOLDER, which
must not exist, and prints the time that each step took.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from datetime import date, timedelta
from pathlib import Path

import numpy as np

from bayesbl.config.kinds import FleetConfig, FleetSection
from bayesbl.config.sections import ClusterRun, Interval
from bayesbl.fleet.inventory import Joint
from bayesbl.fleet.measured_joint import REFUSED, JointAnswer, RecordingAnswer
from bayesbl.fleet.plant_tables import (
    JOINT_COLUMNS,
    RECORDING_COLUMNS,
    Measured,
    joint_rows,
    pool,
    recording_row,
    write_table,
)
from bayesbl.measurement.wear import WearDraws
from bayesbl.presentation.page.plant import write_pages
from bayesbl.results.store import write_json
from bayesbl.runs.fleet import summary_of

TYPES = {"RV-80": 3e-4, "RV-20": 1e-4, "HD-25": 2e-4}
"""Type of gearbox to its median rate, rad/year; joints differ by 40 %."""

LEVEL = Interval(level=0.9, kind="equal_tailed")
DRAWS = 1000


def simulated(
    joints: int, recordings: int, generator: np.random.Generator
) -> Iterator[tuple[Measured, list[dict[str, object]]]]:
    """Joints with their answers, and the rows of their recordings, one of each 50 broken."""
    for number in range(joints):
        gearbox, median = list(TYPES.items())[number % 3]
        rate = median * np.exp(0.4 * generator.standard_normal())
        joint = Joint(
            joint=f"R{number // 6 + 1:03d}-J{number % 6 + 1}", gearbox=gearbox, limit_rad=1.2e-3
        )
        start = generator.uniform(2e-4, 8e-4)
        days = [date(2024, 1, 1) + timedelta(days=30 * n) for n in range(recordings)]
        years = np.array([(day - days[0]).days / 365.25 for day in days])
        drawn = generator.normal(rate, 0.3 * median / max(years[-1], 0.1), DRAWS)
        rates = np.abs(drawn) + 1e-7
        gaps = start + rates * years[:, None] + 5e-6 * generator.standard_normal((recordings, 1))
        rows = []
        outcomes = []
        for n, day in enumerate(days):
            broken = generator.uniform() < 0.02
            answer = RecordingAnswer(
                REFUSED if broken else "converged",
                "The recording holds too few rotations." if broken else None,
                route="" if broken else "direct",
                gap_rad=None if broken else gaps[n] + 5e-6 * generator.standard_normal(DRAWS),
            )
            outcomes.append(answer.outcome)
            row = recording_row(answer, joint, not broken, LEVEL)
            file = f"data/{joint.name}/{day}.csv"
            rows.append({**row, "joint": joint.name, "date": day.isoformat(), "file": file})
        used = tuple(n for n, outcome in enumerate(outcomes) if outcome != REFUSED)
        wear = WearDraws(
            rates,
            np.zeros(DRAWS, dtype=int),
            rates * 10.0 ** generator.uniform(-6.0, 0.0, DRAWS),
            rates,
            np.maximum(1.2e-3 - gaps[used[-1]], 0.0) / rates,
        )
        found = JointAnswer(None, "direct", used, gaps[[used[-1]]], wear)
        dates = tuple(day.isoformat() for day in days)
        yield Measured(joint, found, dates, tuple(outcomes)), rows


def config_of(pool_by: str | None, before: date | None) -> FleetConfig:
    """What the summary takes of a fleet's configuration."""
    section = FleetSection.model_construct(pool_by=pool_by, decide_before=before)
    run = ClusterRun.model_construct(seed=1)
    return FleetConfig.model_construct(fleet=section, interval=LEVEL, run=run)


def main(folder: Path, joints: int = 1000, recordings: int = 24) -> None:
    """Write the plant, and print how long each step took."""
    folder.mkdir(parents=True)
    plant = list(simulated(joints, recordings, np.random.default_rng(1)))
    measured = [one for one, _ in plant]
    rows = [row for _, of_joint in plant for row in of_joint]
    clock = time.process_time()

    def took(what: str) -> None:
        nonlocal clock
        print(f"{what}: {time.process_time() - clock:.2f} s")
        clock = time.process_time()

    types, borrowed = pool(measured, "gearbox", 1)
    took("pooling")
    of_joints = joint_rows(measured, borrowed, LEVEL, date(2027, 1, 1))
    took("rows of joints")
    write_table(rows, RECORDING_COLUMNS, folder / "recordings.parquet")
    write_table(of_joints, JOINT_COLUMNS, folder / "joints.parquet")
    took("tables")
    summary = summary_of(config_of("gearbox", date(2027, 1, 1)), rows, of_joints, types)
    write_json(summary, folder / "summary.json")
    write_pages(folder)
    took("pages")


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:4]))
