"""``kind = "plan"``: rank the motions of a bench by how well they would show the gap."""

from __future__ import annotations

from dataclasses import asdict
from typing import Literal, TypedDict

import xarray as xr

from bayesbl.config.kinds import PlanConfig
from bayesbl.matching.planning import Strokes, noise_of_bench, ranked_motions
from bayesbl.progress import of_stage
from bayesbl.results.identified import bench_from, require_gap
from bayesbl.results.provenance import provenance_of
from bayesbl.results.store import Head, json_text
from bayesbl.results.variables import Group, columns, datasets, table
from bayesbl.results.work import WorkStore
from bayesbl.runs.workflow import Options, Plan

MOTIONS = Group(
    "motions",
    table("""
        low_rad (motion) | rad | lower end of the strokes, load angle, 0 hangs straight down
        high_rad (motion) | rad | upper end of the strokes
        speed_rpm (motion) | rpm | largest speed of the motor
        acceleration_rpm_per_s (motion) | rpm/s | acceleration of the motor
        dwell_s (motion) | s | rest between two strokes
        duration_s (motion) | s | length of the recording
        flank_changes (motion) | 1 | how often the load would pass from one flank to the other
        expected_relative_sd (motion) | 1 | standard deviation of ln δ that is expected, NaN where
            no flank changes
    """),
)


class PlannedEntry(TypedDict):
    """A motion, as ``motion = {…}`` of a simulation, with the expected precision."""

    kind: Literal["strokes"]
    range_rad: list[float]
    speed_rpm: float
    acceleration_rpm_per_s: float
    dwell_s: float
    duration_s: float
    flank_changes: int
    expected_relative_sd: float | None


class Planned(TypedDict):
    """``plan``: the motions, the most precise one first."""

    gap_rad: float
    motions: list[PlannedEntry]


class PlanSummary(Head):
    """``summary.json`` of a plan."""

    kind: Literal["plan"]
    plan: Planned


def describe(config: PlanConfig, plan: Plan) -> None:
    """Which bench, and within which limits."""
    bench = bench_from(config.bench)
    require_gap(bench, config.bench)
    plan.add("noise", lambda: "{:.3g} rpm, {:.3g} A".format(*noise_of_bench(bench).sd))
    low, high = config.limits.range_rad
    plan.lines.append(
        ("limits", f"{low:g} to {high:g} rad of the load, {config.limits.speed_rpm:g} rpm")
    )


def make(config: PlanConfig, options: Options, work: WorkStore) -> xr.DataTree:
    """Rank motions. Raises UserError if the bench cannot be used, or can follow none of them."""
    limits, bench = config.limits, bench_from(config.bench)
    require_gap(bench, config.bench)
    allowed = Strokes(**limits.model_dump())
    report = of_stage(options.progress, "Ranking motions")
    motions = ranked_motions(
        bench, allowed, config.gap_rad, config.sampling_hz, config.run.workers, report
    )
    shown = any(motion.flank_changes for motion in motions)
    low, high = ([motion.range_rad[end] for motion in motions] for end in (0, 1))
    values = (columns(MOTIONS, motions), {"low_rad": low, "high_rad": high})
    tree = xr.DataTree.from_dict(datasets({MOTIONS: values}))
    planned = [{**asdict(motion), "kind": "strokes"} for motion in motions]
    summary = {"plan": {"gap_rad": config.gap_rad, "motions": planned}}
    tree.attrs = {
        "kind": "plan",
        "outcome": "converged" if shown else "withheld",
        "reason": "" if shown else NONE_SHOWS,
        "warnings": [],
        "summary": json_text(summary),
        **provenance_of(config),
    }
    return tree


NONE_SHOWS = (
    "Within these limits the load never passes from one tooth flank to the other, so no recording "
    "can show δ. Allow a range in which gravity's torque changes its sign (hanging straight down "
    "or upright), or more acceleration."
)
