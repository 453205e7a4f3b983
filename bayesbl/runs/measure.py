"""``fit`` and ``compare``: from recordings of one joint to their gaps, by the route asked for."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from bayesbl.measurement.amplitude_route import (
    curve_of,
    estimator_of,
    measure,
    recording_of,
    require_plausible_limit,
    require_same_estimator,
    same_files,
)
from bayesbl.measurement.direct_route import bench_of, measure_direct, observed_of
from bayesbl.measurement.speeds import require_one_speed_of_all
from bayesbl.results.earlier import read_earlier
from bayesbl.ringing.estimator import nominal_speed_rpm
from bayesbl.ringing.second_sampler import require_second_sampler
from bayesbl.runs.workflow import Options, Plan, Summary, run_into_folder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from bayesbl.bench.bench import Bench
    from bayesbl.config.measurement import SnapshotConfig
    from bayesbl.config.sections import SnapshotRecording
    from bayesbl.recording.types import Recording


def run(config: SnapshotConfig, options: Options) -> Summary:
    """Measure by the route that the configuration names, and write its output folder."""
    if config.estimator.route == "direct":
        return run_into_folder(
            config, options, lambda work: measure_direct(config, options.progress, work)
        )
    return run_into_folder(
        config, options, lambda work: measure(config, options.progress, work, options.say)
    )


def describe(config: SnapshotConfig, plan: Plan) -> None:
    """What would be measured, and by what."""
    estimator, curve = estimator_of(config), curve_of(config)
    plan.lines += [
        ("curve", curve.name),
        ("estimator", f"search {estimator.search}, noise {estimator.noise_kind}"),
        ("interval", f"{100.0 * config.interval.level:g} %, {config.interval.kind}"),
    ]

    if config.estimator.search.start_from is not None:
        plan.add("start from", partial(_earlier, config.estimator.search.start_from))
    if config.posterior.check_sampler:
        plan.add("second sampler", _second_sampler)

    def checked(entry: SnapshotRecording) -> str:
        recording = recording_of(entry, config)
        require_same_estimator(curve, estimator, recording)
        if bench is not None:
            observed_of(config, bench, recording)
        rate = 1.0 / recording.sampling_period_s
        sound.append(recording)
        plan.warnings += [f"{entry.name}: {note}" for note in recording.notes]
        return f"{entry.file}, {recording.duration_s:.4g} s at {rate:.4g} Hz"

    bench: Bench | None = None
    sound: list[Recording] = []
    if config.estimator.route == "direct":
        bench = bench_of(config)
        plan.lines.append(("bench", f"{config.estimator.bench}, gap form {bench.gap_form}"))
    for entry in config.recordings:
        plan.add(f"recording {entry.name}", partial(checked, entry))
    plan.warnings += same_files(sound)
    if bench is None and config.joint.gear_ratio is None:
        plan.warnings.append(
            "Without [joint] gear_ratio the load's rotations are counted only by the run, which "
            "refuses a recording of fewer than two."
        )
    if bench is None and len(sound) > 1:
        plan.add("speed", partial(_one_speed, sound))
    if config.joint.limit_rad is not None:
        measurable = config.estimator.gap_rad if bench is not None else curve.gap_range_rad
        plan.add("limit", partial(_limit, config.joint.limit_rad, measurable))


def _earlier(path: Path) -> str:
    return f"{', '.join(read_earlier(path))} in {path}"


def _second_sampler() -> str:
    require_second_sampler()
    return "dynesty"


def _one_speed(recordings: Sequence[Recording]) -> str:
    require_one_speed_of_all(recordings)
    return f"{nominal_speed_rpm(recordings[0]):.5g} rpm in all"


def _limit(limit_rad: float, range_rad: tuple[float, float]) -> str:
    require_plausible_limit(limit_rad, range_rad)
    return f"{1e3 * limit_rad:g} mrad"
