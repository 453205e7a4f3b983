"""A bench in, its gap curve out."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import xarray as xr

from bayesbl.bench.bench import Bench
from bayesbl.bench.flank_change import require_flank_change
from bayesbl.config.bench import dump_bench
from bayesbl.config.sweep import SweepConfig
from bayesbl.curve.sweep import SweepRow, SweepSettings
from bayesbl.curve.swept_curve import swept_curve
from bayesbl.errors import ConfigError
from bayesbl.measurement.bench_sweep import SweepProblem
from bayesbl.measurement.stored_curve import GAP_CURVE, curve_to_dataset, one_curve_group
from bayesbl.recording.types import Recording
from bayesbl.results.identified import bench_from
from bayesbl.results.provenance import provenance_of
from bayesbl.results.work import WorkStore
from bayesbl.ringing.estimator import Estimator, nominal_speed_rpm
from bayesbl.ringing.symbols import DisturbanceModel
from bayesbl.runs.sweep_groups import (
    BENCH_DRAWS,
    degree_group,
    draw_group,
    example_group,
    sweep_group,
)
from bayesbl.runs.workflow import (
    Options,
    Plan,
    require_affordable,
    require_output,
    run_into_folder,
)

if TYPE_CHECKING:
    from bayesbl.progress import StageProgress
    from bayesbl.runs.summary import Summary

CACHE = ".sweep-cache"

CACHE_BYTES = 200_000_000
"""What finished rows may take, some ten thousand of them; the oldest go first."""

BYTES_PER_SAMPLE, SECONDS_PER_SAMPLE = 24.0, 2e-6
"""What simulating and fitting takes, roughly: all recordings of a row are held at once."""


def run(config: SweepConfig, options: Options) -> Summary:
    """Sweep, and write the output folder; the rows are kept for other sweeps."""
    return run_into_folder(
        config, options, lambda _: run_sweep(config, options.progress, fresh=options.force)
    )


def describe(config: SweepConfig, plan: Plan) -> None:
    """Which bench would be swept, and over which gaps."""
    plan.add("output", partial(require_output, config.run.output))
    bench = bench_from(config.bench)
    plan.lines.append(("bench", f"drive {bench.drive}, gap form {bench.gap_form}"))
    plan.add("gaps", partial(_gaps, config, bench))


def _cut_off(nominal: SweepRow, settings: SweepSettings) -> Iterator[str]:
    first = nominal.gap_rad[0]
    if first > settings.gap_rad[0]:
        yield (
            f"Below {1e3 * first:.3g} mrad the best fit leaps to another ringing, and the curve "
            "begins there."
        )


def _gaps(config: SweepConfig, bench: Bench) -> str:
    require_drawable(config, bench)
    _require_possible(config, bench)
    gap = config.sweep.gap_rad
    return f"{gap.count} from {gap.low:g} to {gap.high:g} rad, {config.sweep.bench_draws} draws"


def run_sweep(
    config: SweepConfig, progress: StageProgress | None = None, *, fresh: bool = False
) -> xr.DataTree:
    """Sweep a bench and regress its gap curve.

    Rows that the same code made of the same problem are taken from the cache.

    Parameters
    ----------
    fresh
        Make all rows anew.

    Raises
    ------
    UserError
        If the bench file cannot be used, a simulation fails, or the curve is not monotone.
    """
    bench = bench_from(config.bench)
    require_flank_change(bench)
    require_drawable(config, bench)
    work = WorkStore.shared(config.run.output.parent / CACHE, fresh=fresh)
    problem = SweepProblem(bench, _model(config), _settings(config), config.run.seed, work)
    nominal_seed, draw_seed, curve_seed, band_seed = np.random.SeedSequence(config.run.seed).spawn(
        4
    )
    work.keep_latest(size_bytes=CACHE_BYTES)
    workers = config.run.workers
    nominal = problem.nominal(nominal_seed, workers)
    swept = problem.draws(nominal, config.sweep.bench_draws, draw_seed, workers, progress)
    recording = _sampled(config, bench)
    fingerprint = Estimator(model=problem.model).fingerprint(recording)
    curve, regression = swept_curve(
        str(config.run.output),
        nominal,
        problem.model,
        config.sweep.degree,
        fingerprint,
        curve_seed,
        swept,
    )
    curve = replace(
        curve,
        reference_speed_rpm=nominal_speed_rpm(recording),
        warnings=tuple(_cut_off(nominal, problem.settings)),
    )
    tree = xr.DataTree.from_dict(
        {
            "sweep": sweep_group(nominal, problem.model),
            "degrees": degree_group(nominal),
            "examples": example_group(bench, problem.settings),
            "curve": one_curve_group(curve, config.interval.level, band_seed),
            GAP_CURVE.name: curve_to_dataset(curve),
        }
    )
    if swept is not None:
        tree[BENCH_DRAWS.name] = xr.DataTree(draw_group(swept))
    tree.attrs = {
        "kind": "sweep",
        "outcome": "converged",
        "reason": "",
        "warnings": list(curve.warnings),
        "fingerprint": fingerprint,
        "lack_of_fit_size": regression.lack_of_fit_size,
        "lack_of_fit_length": regression.lack_of_fit_length,
        "degree": config.sweep.degree,
        "bench": dump_bench(bench),
        **provenance_of(config),
    }
    return tree


def require_drawable(config: SweepConfig, bench: Bench) -> None:
    """The bench has a tolerance where benches are to be drawn within it."""
    if config.sweep.bench_draws and not bench.tolerances:
        raise ConfigError(
            "There is nothing to draw: no parameter of the bench has a tolerance.",
            file=config.bench,
            where="[sweep] bench_draws",
            found=config.sweep.bench_draws,
            expected="a tolerance or relative_tolerance in the bench file, or bench_draws = 0",
        )


def _require_possible(config: SweepConfig, bench: Bench) -> None:
    section = config.sweep
    recordings = float(section.gap_rad.count * section.start_angles)
    samples = recordings * section.rotations * bench.rotation_period_s() * section.sampling_hz
    require_affordable(
        "The sweep",
        "fewer rotations, gaps or draws, or a lower sampling_hz under [sweep]",
        BYTES_PER_SAMPLE * samples,
        SECONDS_PER_SAMPLE * samples * (1 + section.bench_draws) / config.run.workers,
    )
    require_flank_change(bench)
    bench.simulate(section.gap_rad.high, rotations=0.1, sampling_hz=section.sampling_hz)


def _model(config: SweepConfig) -> DisturbanceModel:
    section = config.estimator.model
    model = DisturbanceModel(section.baseline_harmonics, section.fixed, section.ranges)
    return replace(model, ranges=model.lasting_ranges)


def _settings(config: SweepConfig) -> SweepSettings:
    section, gap = config.sweep, config.sweep.gap_rad
    return SweepSettings(
        gap.low,
        gap.high,
        gap.count,
        gap.spacing,
        section.start_angles,
        section.rotations,
        section.sampling_hz,
    )


def _sampled(config: SweepConfig, bench: Bench) -> Recording:
    """A recording with the sweep's sampling and the bench's speed."""
    return bench.simulate(
        config.sweep.gap_rad.low, rotations=2.0, sampling_hz=config.sweep.sampling_hz
    )
