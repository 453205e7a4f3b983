"""Groups of ``result.nc`` by which a sweep is stored, beside its gap curve."""

from __future__ import annotations

import math

import numpy as np
import xarray as xr

from bayesbl.bench.bench import Bench
from bayesbl.curve.bench_draws import SweptDraws
from bayesbl.curve.gap_curve import published_curve
from bayesbl.curve.sweep import SweepRow, SweepSettings
from bayesbl.curve.swept_curve import degree_reports
from bayesbl.measurement.stored_curve import CURVE, GAP_CURVE
from bayesbl.recording.types import FloatArray
from bayesbl.results.variables import Group, attributes, dataset, labels, table
from bayesbl.ringing.symbols import DECAY, FREQUENCY, DisturbanceModel

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
        amplitude_over_published (gap) | 1 | amplitude over that of the paper's eq. 4
    """),
)

DEGREES = Group(
    "degrees",
    table("""
        rms_departure (degree) | 1 | RMS relative departure of δ from the polynomial
        largest_departure (degree) | 1 | largest relative departure of δ from the polynomial
        log_evidence (degree) | 1 | restricted log likelihood with a smooth lack of fit beside it
    """),
    table("degree (degree) | 1 | degree of the polynomial"),
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
    (
        labels("parameter", "parameter of the bench"),
        labels("quantity", "quantity of the ringing"),
    ),
    optional=True,
)


def declared_groups(_: xr.DataTree) -> tuple[Group, ...]:
    """All groups of a sweep."""
    return SWEEP, DEGREES, EXAMPLES, CURVE, GAP_CURVE, BENCH_DRAWS


def sweep_group(nominal: SweepRow, model: DisturbanceModel) -> xr.Dataset:
    """What was simulated at every gap and start angle, and what the fits gave."""
    published = _published_amplitude(nominal.gap_rad)
    return dataset(
        SWEEP,
        {
            **attributes(SWEEP, nominal),
            FREQUENCY: nominal.symbol(FREQUENCY, model.fixed),
            DECAY: nominal.symbol(DECAY, model.fixed),
            "amplitude_over_published": nominal.amplitude_rpm.mean(axis=1) / published,
        },
    )


def degree_group(nominal: SweepRow) -> xr.Dataset:
    """How well polynomials of several degrees describe the sweep."""
    reports = degree_reports(nominal)
    names = [variable.name for variable in (*DEGREES.variables, *DEGREES.coordinates)]
    return dataset(DEGREES, {name: [getattr(r, name) for r in reports] for name in names})


def example_group(bench: Bench, settings: SweepSettings) -> xr.Dataset:
    """Noise-free speed over one rotation at a few gaps, for the figures."""
    gaps = np.geomspace(settings.low_rad, settings.high_rad, EXAMPLE_GAPS)
    speeds = bench.simulate_many(
        gaps, rotations=1.0, sampling_hz=settings.sampling_hz, start_angle_rad=0.5 * math.pi
    )
    time_s = np.arange(speeds.shape[1]) / settings.sampling_hz
    return dataset(EXAMPLES, {"gap_rad": gaps, "time_s": time_s, "motor_speed_rpm": speeds})


def draw_group(swept: SweptDraws) -> xr.Dataset:
    """Drawn benches, and how their ringing departs from the nominal bench's."""
    return dataset(
        BENCH_DRAWS,
        {"shift": swept.shifts, "departure": swept.departures},
        {
            "parameter": list(swept.names),
            "quantity": ["ln_amplitude", "ln_frequency", "ln_decay"],
        },
    )


def _published_amplitude(gap_rad: FloatArray) -> FloatArray:
    """Inverse of eq. 4, by interpolation on a fine grid, rpm."""
    curve = published_curve(draws=1)
    low, high = curve.amplitude_range_rpm
    grid = np.geomspace(0.5 * low, 2.0 * high, 20_000)
    return np.asarray(np.interp(gap_rad, curve.gap(grid), grid))
