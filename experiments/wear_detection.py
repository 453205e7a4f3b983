"""How much must a joint wear before a comparison of two recordings reports it?

    bayesbl sweep configs/sweep.toml
    bayesbl run configs/wear_detection.toml

A case is a pair of recordings of the virtual bench, before and after a known change of the gap,
with start angles of their own. By the amplitude route each is fitted as any recording is and both
are put through one draw of a swept curve; the posterior of A is taken normal around the optimum,
with the covariance that emcee samples. By the direct route both are fitted together, with the fast
posterior. An increase is *reported* if its probability is at least ``REPORTED_AT``; reported
without a change it is a false alarm, of which there should be at most one minus that.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import xarray as xr
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    NonNegativeInt,
    PositiveInt,
    Strict,
    model_validator,
)

sys.path.append(str(Path(__file__).parent))

from calibration_statistics import coverage_band

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import load_bench
from bayesbl.config.sections import Items, refuse
from bayesbl.curve.gap_curve import GapCurve, likeliest_branch
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import GAP
from bayesbl.measurement.curves import read_curve
from bayesbl.measurement.direct_route import fit_directly
from bayesbl.measurement.gap_by_curve import MeasuredRinging, gaps
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import FloatArray, Recording
from bayesbl.ringing.estimator import Estimator
from bayesbl.sampling.chains import SamplerSettings

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

REPORTED_AT = 0.95
"""Probability of an increase from which on it is reported."""

POWER = 0.95
"""Share of pairs in which the smallest change that counts as detectable is reported."""

REPEATS = 200
"""Tables drawn again from the fitted curve, for the standard error of the smallest change."""

FAST_DIRECT = SamplerSettings(ensembles=2, max_steps=1000)
SNAPSHOTS = ("before", "after")


class Row(BaseModel):
    """A row: one joint and one way to record it, over several true changes.

    ``pairs`` are simulated for each of ``changes_rad``, and ``more_without_wear`` pairs with no
    change, which count false alarms. ``route`` ``amplitude`` needs a ``curve``; ``prior_rad`` is
    the range of the direct route's prior.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    bench: Path
    route: Literal["amplitude", "direct"] = "amplitude"
    curve: Path | None = None
    prior_rad: Annotated[tuple[float, float], Strict(False)] = (1e-4, 1e-2)
    gap_rad: float = Field(gt=0.0)
    changes_rad: Items[float] = Field(min_length=1)
    pairs: PositiveInt
    more_without_wear: NonNegativeInt = 0
    speed_noise_sd_rpm: float = Field(gt=0.0)
    coefficients: Items[float] = (0.6,)
    rotations: float = 5.0
    sampling_hz: float = 1000.0

    @model_validator(mode="after")
    def _has_a_curve(self) -> Row:
        if self.route == "amplitude" and self.curve is None:
            refuse("The amplitude route needs a curve.", found="none", expected="a sweep's file")
        return self


COLUMNS = {
    "change_rad": ("rad", "change simulated"),
    "probability_increase": ("1", "posterior probability that the gap grew"),
    "change_median_rad": ("rad", "posterior median of the change"),
    "change_sd_rad": ("rad", "posterior standard deviation of the change"),
    "withheld": ("1", "1 where the answer would be withheld"),
}


def count(row: Row) -> int:
    """Number of pairs, over all changes."""
    return row.pairs * len(row.changes_rad) + row.more_without_wear


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One pair; changes take turns, so that a study cut short has pairs of each."""
    truth_seed, fit_seed = seed.spawn(2)
    generator = np.random.default_rng(truth_seed)
    in_turn = index < row.pairs * len(row.changes_rad)
    change = row.changes_rad[index % len(row.changes_rad)] if in_turn else 0.0
    recordings = [_recorded(row, gap, generator) for gap in (row.gap_rad, row.gap_rad + change)]
    by_route = _directly if row.route == "direct" else _by_amplitude
    before, after, withheld = by_route(row, recordings, fit_seed)
    found = after - before
    return {
        "change_rad": change,
        "probability_increase": float(np.mean(found > 0.0)),
        "change_median_rad": float(np.median(found)),
        "change_sd_rad": float(found.std()),
        "withheld": float(withheld),
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """False alarms, the share reported at each change, and the smallest change found."""
    change, reported = cases["change_rad"].values, _reported(cases)
    line: dict[str, float | str] = {
        "route": row.route,
        "gap_mrad": 1e3 * row.gap_rad,
        "noise_sd_rpm": row.speed_noise_sd_rpm,
        "rotations": row.rotations,
        "pairs_per_change": float(row.pairs),
    }
    known = np.unique(change)
    shares = [float(reported[change == c].mean()) for c in known]
    if known[0] == 0.0:
        without = int(np.sum(change == 0.0))
        line["pairs_without_wear"] = float(without)
        line["false_alarms"] = shares[0]
        # What a nominal rate leaves in at most 1 of 200 studies.
        line["false_alarms_at_most"] = coverage_band(without, 1.0 - REPORTED_AT)[1]
    line |= {
        "changes_mrad": " ".join(f"{1e3 * c:g}" for c in known),
        "reported": " ".join(f"{share:.3f}" for share in shares),
        "change_sd_mrad": 1e3 * float(np.median(cases["change_sd_rad"].values)),
        "withheld": float(cases["withheld"].values.mean()),
    }
    if known.size == 1:
        return line
    middle, width = detection_curve(change, reported)
    smallest = smallest_change(middle, width)
    return line | {
        "half_found_mrad": 1e3 * middle,
        "curve_width_mrad": 1e3 * width,
        "smallest_mrad": 1e3 * smallest,
        "smallest_se_mrad": 1e3 * _standard_error(change, middle, width),
        "smallest_%": 100.0 * smallest / row.gap_rad,
    }


def detection_curve(change_rad: FloatArray, reported: FloatArray) -> tuple[float, float]:
    """Change at which half the pairs are reported, and the width of the curve around it, rad.

    Maximum likelihood of P(reported | change) = Φ((change − middle) / width).
    """
    from scipy.optimize import minimize
    from scipy.stats import norm

    scale = float(change_rad.max()) or 1.0
    x = change_rad / scale

    def deviance(symbols: FloatArray) -> float:
        z = (x - symbols[0]) / math.exp(symbols[1])
        return -float(np.sum(norm.logcdf(np.where(reported > 0.0, z, -z))))

    # Curves much steeper than the spacing of the changes cannot be distinguished.
    bounds = [(-2.0, 4.0), (math.log(0.02), math.log(5.0))]
    found = minimize(deviance, np.array([0.4, -1.5]), method="L-BFGS-B", bounds=bounds)
    return scale * float(found.x[0]), scale * math.exp(found.x[1])


def smallest_change(middle_rad: float, width_rad: float, power: float = POWER) -> float:
    """The change that a detection curve reports in a share ``power`` of pairs, rad."""
    from scipy.stats import norm

    return middle_rad + width_rad * float(norm.ppf(power))


def figure(table: Sequence[Mapping[str, Any]], cases: Mapping[str, xr.Dataset]) -> Figure:
    """Detection curves of each route: the share of pairs reported against the true change."""
    from bayesbl.presentation.figures.style import (
        DOUBLE_COLUMN_IN,
        grid,
        head_panels,
        new_figure,
        publication_style,
    )

    table = [line for line in table if line.get("smallest_mrad")]  # others have no curve
    routes = list(dict.fromkeys(str(line["route"]) for line in table))
    with publication_style():
        drawn = new_figure(DOUBLE_COLUMN_IN, 0.5 + 2.7 * len(routes))
        places = grid(drawn, len(routes), 1, right=2.9, between=(0.75, 0.0))
        panels = [drawn.add_subplot(places[n, 0]) for n in range(len(routes))]
        for route, panel in zip(routes, panels, strict=True):
            _draw_curves(panel, [line for line in table if line["route"] == route])
        head_panels(panels, [f"By the {route} route" for route in routes])
        panels[-1].set_xlabel("True change of the gap δ (mrad)")
    return drawn


def _draw_curves(panel: Axes, table: Sequence[Mapping[str, Any]]) -> None:
    from scipy.stats import binom, norm

    from bayesbl.presentation.figures.style import NEUTRAL, look

    for index, line in enumerate(table):
        style = look(index)
        change, share = (
            np.array(str(line[key]).split(), dtype=float) for key in ("changes_mrad", "reported")
        )
        size = np.full(change.shape, float(line["pairs_per_change"]))
        size[change == 0.0] = float(line.get("pairs_without_wear") or size[0])
        band = binom.ppf([[0.05], [0.95]], size, share) / size
        panel.errorbar(
            change, share, np.abs(band - share), color=style.colour, marker=style.marker,
            linestyle="none", capsize=2.0, elinewidth=0.7,
        )  # fmt: skip
        fine = np.linspace(0.0, 1.1 * change.max(), 200)
        middle, width = (float(line[k]) for k in ("half_found_mrad", "curve_width_mrad"))
        found = f"{float(line['smallest_mrad']):.2g} mrad found in {100.0 * POWER:g} %"
        panel.plot(
            fine, norm.cdf((fine - middle) / width), color=style.colour,
            linestyle=style.dashes, label=f"{line['name']}:\n{found}",
        )  # fmt: skip
    levels = ((POWER, f"{100.0 * POWER:g} %"), (1.0 - REPORTED_AT, "nominal\nfalse alarms"))
    for level, told in levels:
        panel.axhline(level, color=NEUTRAL, linewidth=0.6, linestyle=(0.0, (3.0, 2.0)))
        panel.annotate(
            told, (1.0, level), xycoords=("axes fraction", "data"), xytext=(2.0, 0.0),
            textcoords="offset points", va="center", fontsize=6.0,
        )  # fmt: skip
    panel.set_xlim(left=-0.02 * panel.get_xlim()[1])
    panel.set_ylim(0.0, 1.03)
    panel.set_ylabel("Share of pairs reported")
    panel.legend(loc="center left", bbox_to_anchor=(1.18, 0.5))


def _reported(cases: xr.Dataset) -> FloatArray:
    """1 where an increase is reported; an answer that is withheld reports nothing."""
    sure = cases["probability_increase"].values >= REPORTED_AT
    return np.asarray(sure & (cases["withheld"].values == 0.0), dtype=np.float64)


def _standard_error(change_rad: FloatArray, middle_rad: float, width_rad: float) -> float:
    """Parametric bootstrap of the smallest change found."""
    from scipy.stats import norm

    generator = np.random.default_rng(11)
    chance = norm.cdf((change_rad - middle_rad) / width_rad)
    again = [
        smallest_change(
            *detection_curve(change_rad, (generator.uniform(size=chance.size) < chance) * 1.0)
        )
        for _ in range(REPEATS)
    ]
    return float(np.std(again))


def _recorded(row: Row, gap_rad: float, generator: np.random.Generator) -> Recording:
    """A recording of a random start angle."""
    return _bench(row).simulate(
        gap_rad,
        rotations=row.rotations,
        sampling_hz=row.sampling_hz,
        start_angle_rad=generator.uniform(0.0, 2.0 * math.pi),
        seed=generator,
    )


def _by_amplitude(
    row: Row, recordings: Sequence[Recording], seed: np.random.SeedSequence
) -> tuple[FloatArray, FloatArray, bool]:
    """Draws of both gaps by the row's curve, rad, and whether an answer would be withheld."""
    assert row.curve is not None
    return gaps_by_amplitude(_curve(row.curve), recordings, seed)


def gaps_by_amplitude(
    curve: GapCurve, recordings: Sequence[Recording], seed: np.random.SeedSequence
) -> tuple[FloatArray, FloatArray, bool]:
    """Draws of two gaps by one curve, shape (2, 2000), rad, and whether either is withheld.

    The posterior of A is taken normal around the optimum.
    """
    estimator = Estimator()
    *own, draw_seed, gap_seed = seed.spawn(len(recordings) + 2)
    generator = np.random.default_rng(draw_seed)
    ringing = []
    for recording, search_seed in zip(recordings, own, strict=True):
        point = likeliest_branch(curve, estimator, estimator.estimate(recording, search_seed))
        centre, covariance = point.ringing
        draws = generator.normal(centre[0], math.sqrt(covariance[0, 0]), (2, 2000))
        ringing.append(MeasuredRinging(draws, centre, covariance))
    before, after = gaps([curve, curve], ringing, gap_seed)
    withheld = bool(before.reasons or after.reasons)
    return before.delta_rad, after.delta_rad, withheld


def _directly(
    row: Row, recordings: Sequence[Recording], seed: np.random.SeedSequence
) -> tuple[FloatArray, FloatArray, bool]:
    """As :func:`_by_amplitude`, both recordings fitted together as simulations of their bench."""
    bench = _bench(row)
    seen = [
        observed(replace(recording, name=name), bench)
        for recording, name in zip(recordings, SNAPSHOTS, strict=True)
    ]
    found = fit_directly(bench, seen, row.prior_rad, {}, FAST_DIRECT, seed)
    posterior = found.posterior
    withheld = posterior.diagnostics.outcome == "withheld" or any(map(found.repeating, SNAPSHOTS))
    before, after = (posterior.values(GAP, name) for name in SNAPSHOTS)
    return before, after, withheld


@cache
def _curve(path: Path) -> GapCurve:
    return read_curve(path)


@cache
def _bench(row: Row) -> Bench:
    bench = load_bench(row.bench)
    noise = NoiseModel(row.speed_noise_sd_rpm, row.coefficients)
    return replace(bench, measurement=replace(bench.measurement, speed_noise=noise))
