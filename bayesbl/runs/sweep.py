"""A bench in, its gap curve out."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import dump_bench, load_bench
from bayesbl.config.loading import dump_config
from bayesbl.config.sweep import SweepConfig
from bayesbl.curve.bench_draws import SweptDraws
from bayesbl.curve.gap_curve import published_curve
from bayesbl.curve.sweep import SweepRow, SweepSettings, sweep_like, sweep_nominal
from bayesbl.curve.swept_curve import degree_reports, departures, swept_curve
from bayesbl.errors import BenchError, ConfigError
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.results.curve_file import GROUP, curve_to_dataset
from bayesbl.results.provenance import file_sha256, provenance
from bayesbl.results.tree import curve_group, dataset
from bayesbl.results.work import WorkStore
from bayesbl.ringing.estimator import Estimator, nominal_speed_rpm
from bayesbl.ringing.symbols import DECAY, FREQUENCY, DisturbanceModel
from bayesbl.runs.processes import processes
from bayesbl.runs.workflow import Options, Plan, Progress, Summary, run_into_folder

CACHE = ".sweep-cache"
EXAMPLE_GAPS = 6


@dataclass(frozen=True, slots=True)
class _Problem:
    """What decides the numbers of every row, and where finished rows of all sweeps are kept."""

    bench: Bench
    model: DisturbanceModel
    settings: SweepSettings
    seed: int
    work: WorkStore

    def row(self, drawn: Bench | None, make: Callable[[], SweepRow]) -> SweepRow:
        """The row of the bench, or of one drawn around it, if no earlier sweep has made it."""
        benches = (self.bench.fingerprint(), None if drawn is None else drawn.fingerprint())
        inputs = (*benches, self.model, self.settings, self.seed)
        return self.work.get("sweep row", inputs, partial(_finite, make), SweepRow)


def _finite(make: Callable[[], SweepRow]) -> SweepRow:
    row = make()
    if not np.all(np.isfinite(row.amplitude_rpm)):
        raise BenchError(
            "A simulated recording could not be fitted.",
            found="an amplitude that is not a number",
            expected="a bench whose gap shows in the motor speed",
        )
    return row


def run(config: SweepConfig, options: Options) -> Summary:
    """Sweep, and write the output folder; the rows are kept for other sweeps."""
    return run_into_folder(
        config, options, lambda _: run_sweep(config, options.progress, fresh=options.force)
    )


def describe(config: SweepConfig, plan: Plan) -> None:
    """Which bench would be swept, and over which gaps."""
    bench = load_bench(config.bench)
    plan.lines.append(("bench", f"drive {bench.drive}, gap form {bench.gap_form}"))
    plan.add("gaps", partial(_gaps, config, bench))


def _gaps(config: SweepConfig, bench: Bench) -> str:
    require_drawable(config, bench)
    gap = config.sweep.gap_rad
    return f"{gap.count} from {gap.low:g} to {gap.high:g} rad, {config.sweep.bench_draws} draws"


def run_sweep(
    config: SweepConfig, progress: Progress | None = None, *, fresh: bool = False
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
    bench = load_bench(config.bench)
    require_drawable(config, bench)
    work = WorkStore(config.run.output.parent / CACHE, fresh)
    problem = _Problem(bench, _model(config), _settings(config), config.run.seed, work)
    nominal_seed, draw_seed, curve_seed, band_seed = np.random.SeedSequence(config.run.seed).spawn(
        4
    )
    nominal = problem.row(
        None,
        lambda: sweep_nominal(
            bench,
            problem.model,
            problem.settings,
            np.random.default_rng(nominal_seed),
            config.run.workers,
        ),
    )
    swept = _sweep_draws(config, problem, nominal, draw_seed, progress)
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
    curve = replace(curve, reference_speed_rpm=nominal_speed_rpm(recording))
    tree = xr.DataTree.from_dict(
        {
            "sweep": _sweep_group(nominal, problem.model),
            "degrees": _degree_group(nominal),
            "examples": _example_group(bench, problem.settings),
            "curve": curve_group(curve, config.interval.level, band_seed),
            GROUP: curve_to_dataset(curve),
        }
    )
    if swept is not None:
        tree["bench_draws"] = xr.DataTree(_draw_group(swept))
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
        **provenance(
            dump_config(config), config.run.seed, {str(config.bench): file_sha256(config.bench)}
        ),
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


def _sweep_draws(
    config: SweepConfig,
    problem: _Problem,
    nominal: SweepRow,
    seed: np.random.SeedSequence,
    progress: Progress | None,
) -> SweptDraws | None:
    """Sweeps of benches drawn within the tolerances, over processes."""
    count, tolerances = config.sweep.bench_draws, problem.bench.tolerances
    if count == 0:
        return None
    benches = [problem.bench.draw(np.random.default_rng(s)) for s in seed.spawn(count)]
    names = tuple(tolerances)
    shifts = np.array(
        [[(b.value(n) - problem.bench.value(n)) / tolerances[n] for n in names] for b in benches]
    )
    jobs = [(problem, nominal, b) for b in benches]
    rows = []
    for row in _mapped(_drawn_row, jobs, config.run.workers):
        rows.append(departures(row, nominal, problem.model))
        if progress is not None:
            progress("bench draws", len(rows), count)
    return SweptDraws(names, shifts, np.array(rows))


def _drawn_row(job: tuple[_Problem, SweepRow, Bench]) -> SweepRow:
    problem, nominal, drawn = job
    return problem.row(drawn, lambda: sweep_like(drawn, nominal, problem.model, problem.settings))


def _mapped(
    function: Callable[[Any], SweepRow], jobs: list[Any], workers: int
) -> Iterator[SweepRow]:
    """In order, over processes where that pays."""
    if workers == 1 or len(jobs) < 2 * workers:
        yield from map(function, jobs)
        return
    with processes(workers) as pool:
        yield from pool.map(function, jobs)


def _sweep_group(nominal: SweepRow, model: DisturbanceModel) -> xr.Dataset:
    dims = ("gap", "start")
    return dataset(
        {
            "gap_rad": (("gap",), nominal.gap_rad, "rad", "backlash gap simulated"),
            "start_angle_rad": (dims, nominal.start_angle_rad, "rad", "load angle at the begin"),
            "amplitude_rpm": (
                dims,
                nominal.amplitude_rpm,
                "rpm",
                "amplitude of the impact ringing",
            ),
            FREQUENCY: (
                dims,
                nominal.symbol(FREQUENCY, model.fixed),
                "rad/s",
                "angular frequency of the ringing",
            ),
            DECAY: (dims, nominal.symbol(DECAY, model.fixed), "1/s", "decay rate of the ringing"),
            "rmse_rpm": (dims, nominal.rmse_rpm, "rpm", "misfit of the waveform"),
            "amplitude_over_published": (
                ("gap",),
                nominal.amplitude_rpm.mean(axis=1) / _published_amplitude(nominal.gap_rad),
                "1",
                "amplitude over that of the paper's eq. 4",
            ),
        }
    )


def _published_amplitude(gap_rad: FloatArray) -> FloatArray:
    """Inverse of eq. 4, by interpolation on a fine grid, rpm."""
    curve = published_curve(draws=1)
    low, high = curve.amplitude_range_rpm
    grid = np.geomspace(0.5 * low, 2.0 * high, 20_000)
    return np.asarray(np.interp(gap_rad, curve.gap(grid), grid))


def _degree_group(nominal: SweepRow) -> xr.Dataset:
    reports = degree_reports(nominal)
    columns = {
        "rms_departure": "RMS relative departure of δ from the polynomial",
        "largest_departure": "largest relative departure of δ from the polynomial",
        "log_evidence": "restricted log likelihood with a smooth lack of fit beside it",
    }
    return dataset(
        {
            name: (("degree",), np.array([getattr(r, name) for r in reports]), "1", long_name)
            for name, long_name in columns.items()
        },
        {"degree": [r.degree for r in reports]},
    )


def _example_group(bench: Bench, settings: SweepSettings) -> xr.Dataset:
    """Noise-free speed over one rotation at a few gaps, for the figures."""
    gaps = np.geomspace(settings.low_rad, settings.high_rad, EXAMPLE_GAPS)
    speeds = bench.simulate_many(
        gaps, rotations=1.0, sampling_hz=settings.sampling_hz, start_angle_rad=0.5 * math.pi
    )
    time_s = np.arange(speeds.shape[1]) / settings.sampling_hz
    return dataset(
        {
            "gap_rad": (("example",), gaps, "rad", "backlash gap simulated"),
            "time_s": (("sample",), time_s, "s", "time"),
            "motor_speed_rpm": (("example", "sample"), speeds, "rpm", "motor speed, noise-free"),
        }
    )


def _draw_group(swept: SweptDraws) -> xr.Dataset:
    return dataset(
        {
            "shift": (
                ("draw", "parameter"),
                swept.shifts,
                "1",
                "departure of the parameter in units of its tolerance",
            ),
            "departure": (
                ("draw", "gap", "quantity"),
                swept.departures,
                "1",
                "departure of ln A, ln ω and ln τ from the nominal sweep",
            ),
        },
        {"parameter": list(swept.names), "quantity": ["ln_amplitude", "ln_frequency", "ln_decay"]},
    )
