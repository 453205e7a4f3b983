"""``kind = "sweep"``: simulate a bench over a range of gaps and make its gap curve."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import xarray as xr

from bayesbl.bench.bench import Bench, require_flank_change
from bayesbl.config.bench import dump_bench
from bayesbl.config.kinds import SweepConfig
from bayesbl.curve.gap_curve import published_curve
from bayesbl.curve.sweep import DegreeSummary, SweepSettings, degree_reports
from bayesbl.errors import ConfigError
from bayesbl.measurement.curves import CURVE, SweepProblem, curve_group
from bayesbl.progress import of_stage
from bayesbl.results.identified import bench_from
from bayesbl.results.provenance import provenance_of
from bayesbl.results.store import Head, json_text
from bayesbl.results.variables import Group, datasets, labels, table
from bayesbl.results.work import WorkStore
from bayesbl.ringing.estimator import Estimator, nominal_speed_rpm
from bayesbl.ringing.symbols import DECAY, FREQUENCY, DisturbanceModel
from bayesbl.runs.workflow import Options, Plan, require_affordable

EXAMPLE_GAPS = 6

SWEEP = Group(
    "sweep",
    table("""
        gap_rad (gap) | rad | backlash gap simulated
        start_angle_rad (gap, start) | rad | load angle at the start
        amplitude_rpm (gap, start) | rpm | amplitude of the impact ringing
        angular_frequency_rad_per_s (gap, start) | rad/s | angular frequency of the ringing
        decay_rate_per_s (gap, start) | 1/s | decay rate of the ringing
        rmse_rpm (gap, start) | rpm | misfit of the waveform
    """),
)

EXAMPLES = Group(
    "examples",
    table("""
        gap_rad (example) | rad | backlash gap simulated
        time_s (sample) | s | time
        motor_speed_rpm (example, sample) | rpm | motor speed, noise-free
    """),
)

BENCH_DRAWS = Group(
    "bench_draws",
    table("""
        shift (draw, parameter) | 1 | departure of the parameter in units of its tolerance
        departure (draw, gap, quantity) | 1 | departure of ln A, ln ω and ln τ from the nominal
            sweep
    """),
    (labels("parameter", "parameter of the bench"), labels("quantity", "quantity of the ringing")),
)


class SweepSummary(Head):
    """``summary.json`` of a sweep."""

    kind: Literal["sweep"]
    curve: str
    coefficients: list[float]
    degree: int
    gap_rad: list[float]
    amplitude_rpm: list[float]
    largest_correction: float
    relative_sd: dict[str, float]
    largest_departure_from_published: float
    degrees: dict[str, DegreeSummary]


BYTES_PER_SAMPLE, SECONDS_PER_SAMPLE = 24.0, 2e-6
"""Approximate cost of simulating and fitting; all recordings of a row are held at once."""


def describe(config: SweepConfig, plan: Plan) -> None:
    """Which bench would be swept, and over which gaps."""
    bench = bench_from(config.bench)
    plan.lines.append(("bench", f"drive {bench.drive}, gap form {bench.gap_form}"))

    def gaps() -> str:
        require_drawable(config, bench)
        _require_possible(config, bench)
        gap = config.sweep.gap_rad
        return f"{gap.count} from {gap.low:g} to {gap.high:g} rad, {config.sweep.bench_draws} draws"

    plan.add("gaps", gaps)


def make(config: SweepConfig, options: Options, work: WorkStore) -> xr.DataTree:
    """Sweep a bench and regress its gap curve.

    Raises UserError if the bench cannot be used, a simulation fails, or the
    curve is not monotone.
    """
    bench = bench_from(config.bench)
    require_flank_change(bench)
    require_drawable(config, bench)
    section, gap, of_model = config.sweep, config.sweep.gap_rad, config.estimator.model
    model = DisturbanceModel(of_model.baseline_harmonics, of_model.fixed, of_model.ranges)
    model = replace(model, ranges=model.lasting_ranges)
    settings = SweepSettings(
        gap.low,
        gap.high,
        gap.count,
        gap.spacing,
        section.start_angles,
        section.rotations,
        section.sampling_hz,
    )
    problem = SweepProblem(bench, model, settings, config.run.seed, work)
    # Of the sweep's sampling and the bench's speed.
    recording = bench.simulate(gap.low, rotations=2.0, sampling_hz=section.sampling_hz)
    curve, nominal, swept = problem.curve(
        str(config.run.output),
        config.sweep.degree,
        Estimator(model=problem.model).fingerprint(recording),
        nominal_speed_rpm(recording),
        config.sweep.bench_draws,
        config.run.workers,
        of_stage(options.progress, "Simulating bench draws"),
    )
    if (first := nominal.gap_rad[0]) > problem.settings.gap_rad[0]:
        leaps = f"Below {1e3 * first:.3g} mrad the best fit leaps to another ringing"
        curve = replace(curve, warnings=(f"{leaps}, and the curve begins there.",))
    symbols = {name: nominal.symbol(name, problem.model.fixed) for name in (FREQUENCY, DECAY)}
    published = published_curve(draws=1)  # eq. 4, inverted by interpolation on a fine grid
    low, high = published.amplitude_range_rpm
    grid = np.geomspace(0.5 * low, 2.0 * high, 20_000)
    published_rpm = np.interp(nominal.gap_rad, published.gap(grid), grid)
    ratio = nominal.amplitude_rpm.mean(axis=1) / published_rpm
    # Noise-free speed over a rotation at a few gaps, for figures; it begins with a level arm.
    example_gaps = np.geomspace(gap.low, gap.high, EXAMPLE_GAPS)
    level_rad = 0.5 * math.pi - bench.value("gravity_angle_rad")
    speeds = bench.simulate_many(
        example_gaps, rotations=1.0, sampling_hz=section.sampling_hz, start_angle_rad=level_rad
    )
    groups: dict[Group, object] = {
        SWEEP: (nominal, symbols),
        EXAMPLES: {
            "gap_rad": example_gaps,
            "time_s": np.arange(speeds.shape[1]) / section.sampling_hz,
            "motor_speed_rpm": speeds,
        },
    }
    if swept is not None:
        groups[BENCH_DRAWS] = {
            "shift": swept.shifts,
            "departure": swept.departures,
            "parameter": list(swept.names),
            "quantity": ["ln_amplitude", "ln_frequency", "ln_decay"],
        }
    *_, band_seed = np.random.SeedSequence(config.run.seed).spawn(4)
    of_curve = {CURVE.name: curve_group(curve, config.interval.level, band_seed)}
    tree = xr.DataTree.from_dict({**datasets(groups), **of_curve})
    tree.attrs = {
        "kind": "sweep",
        "outcome": "converged",
        "reason": "",
        "warnings": list(curve.warnings),
        "degree": config.sweep.degree,
        "bench": dump_bench(bench),
        "summary": json_text(
            {
                "curve": curve.name,
                "coefficients": curve.coefficients,
                "degree": config.sweep.degree,
                "gap_rad": nominal.gap_rad[[0, -1]],
                "amplitude_rpm": curve.knots_rpm[[0, -1]],
                "largest_correction": np.abs(curve.correction).max(),
                "relative_sd": {n: draws.std(axis=0).max() for n, draws in curve.sources.items()},
                "largest_departure_from_published": np.abs(ratio - 1.0).max(),
                "degrees": degree_reports(nominal),
            }
        ),
        **provenance_of(config),
    }
    return tree


def require_drawable(config: SweepConfig, bench: Bench) -> None:
    """Require a tolerance if benches are to be drawn."""
    if config.sweep.bench_draws and not bench.tolerances:
        raise ConfigError(
            "There is nothing to draw: no parameter of the bench has a tolerance.",
            where="[sweep] bench_draws",
            found=config.sweep.bench_draws,
            expected=f"a tolerance or relative_tolerance in {config.bench}, or bench_draws = 0",
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
