"""How often is the right kind of noise chosen, and what does a wrong kind cost?

    bayesbl run configs/noise_choice.toml

Recordings of the disturbance model, whose A is known, with noise of a kind that is known too. Each
is fitted as any recording is. The optimum is least squares whatever the noise, so only the noise
model is then replaced: by the kind that is chosen, by each that can be asked for, and by the
truth. The posterior of A is normal around the optimum, with the covariance that emcee samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import xarray as xr
from calibration_statistics import coverage_band
from made_recordings import draw_symbols, synthetic_recording
from pydantic import Field
from study_tools import StudyRow

from bayesbl.config.sections import Items
from bayesbl.noise.process import NoiseModel
from bayesbl.ringing.covariance import covariance
from bayesbl.ringing.estimator import Estimator, PointEstimate
from bayesbl.ringing.symbols import AMPLITUDE

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

LEVEL = 0.9
"""Of the interval of A."""

HALF_WIDTH = 1.6448536269514722
"""Of that interval, in standard deviations."""

KINDS = ("white", "ar", "student_t")
"""What can be chosen, in the order in which cases store it."""

ESTIMATORS = {
    "auto": Estimator(),
    "white": Estimator(noise_kind="white"),
    "ar": Estimator(noise_kind="ar"),
    "ar1": Estimator(noise_kind="ar", noise_order=1),
    "student_t": Estimator(noise_kind="student_t"),
}
"""The choice, and what can be asked for in its place; ``ar`` takes the best order above 0."""

WORDS = {
    "auto": "chosen",
    "white": "white",
    "ar": "AR, best order",
    "ar1": "AR(1)",
    "student_t": "Student-t",
    "true": "the truth",
}

AMPLITUDES_RPM = (10.0, 40.0)
LARGEST_BASELINE_RPM = 10.0


class Row(StudyRow):
    """A row: the noise's true kind, and how long it is recorded."""

    noise_sd_rpm: float = Field(default=1.5, gt=0.0)
    coefficients: Items[float] = ()
    degrees_of_freedom: float | None = None
    rotations: float = 5.0
    sampling_hz: float = 1000.0

    @property
    def noise(self) -> NoiseModel:
        """What is drawn from."""
        return NoiseModel(self.noise_sd_rpm, self.coefficients, self.degrees_of_freedom)

    @property
    def kind(self) -> str:
        """What it should be called."""
        if self.degrees_of_freedom is not None:
            return "student_t"
        return "ar" if self.coefficients else "white"


COLUMNS = {
    "kind": ("1", f"kind that was chosen: {', '.join(f'{n} {k}' for n, k in enumerate(KINDS))}"),
    "order": ("1", "order that was chosen"),
    "error_rpm": ("rpm", "A at the optimum less the truth"),
    **{f"{name}_sd_rpm": ("rpm", f"standard deviation of A: {w}") for name, w in WORDS.items()},
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One recording: what was chosen, and the width of A by every kind."""
    truth_seed, search_seed = seed.spawn(2)
    generator = np.random.default_rng(truth_seed)
    truth = draw_symbols(generator, generator.uniform(*AMPLITUDES_RPM))
    size, phase = generator.uniform(0.0, LARGEST_BASELINE_RPM), generator.uniform(0.0, 2 * math.pi)
    recording = synthetic_recording(
        truth,
        row.noise,
        generator,
        rotations=row.rotations,
        baseline_rpm=(size * math.cos(phase), size * math.sin(phase)),
        sampling_hz=row.sampling_hz,
    )
    point = ESTIMATORS["auto"].estimate(recording, search_seed)
    return {
        "kind": float(KINDS.index(point.noise.kind)),
        "order": float(point.noise.order),
        "error_rpm": point.optimum.symbols[AMPLITUDE] - truth[AMPLITUDE],
        **{
            f"{name}_sd_rpm": _sd(estimator.around(point.recording, point.objective, point.optimum))
            for name, estimator in ESTIMATORS.items()
        },
        "true_sd_rpm": _sd(_with_true_noise(point, row.noise)),
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Shares of right choices, and by each kind coverage and width over that of the truth."""
    kind, order = cases["kind"].values, cases["order"].values
    error, true = cases["error_rpm"].values, cases["true_sd_rpm"].values
    low, high = coverage_band(error.size, LEVEL)
    line: dict[str, float | str] = {
        "true_kind": row.kind,
        "true_order": float(len(row.coefficients)),
        "kind_right": float(np.mean(kind == KINDS.index(row.kind))),
        "order_right": float(np.mean(order == len(row.coefficients))),
        **{f"chosen_{name}": float(np.mean(kind == n)) for n, name in enumerate(KINDS)},
        "cover_band": f"{low:.3g} to {high:.3g}",
    }
    for name in WORDS:
        sd = cases[f"{name}_sd_rpm"].values
        line[f"{name}_cover_90%"] = float(np.mean(np.abs(error) <= HALF_WIDTH * sd))
        line[f"{name}_width"] = float(np.median(sd / true))
    return line | {"width_90%_rpm": float(np.median(2.0 * HALF_WIDTH * true))}


def figure(table: Sequence[Mapping[str, Any]], cases: Mapping[str, xr.Dataset]) -> Figure:
    """What was chosen, and coverage and width by each kind, row by row of the table."""
    from bayesbl.presentation.figures.style import (
        BAND,
        DOUBLE_COLUMN_IN,
        NEUTRAL,
        grid,
        head_panels,
        new_figure,
        publication_style,
    )

    with publication_style():
        drawn = new_figure(DOUBLE_COLUMN_IN, 0.95 + 0.3 * len(table))
        places = grid(drawn, 1, 3, left=1.55, bottom=0.6, between=(0.0, 0.25))
        chosen, covered, width = (drawn.add_subplot(places[0, n]) for n in range(3))
        _draw_choice(chosen, table)
        for y, line in enumerate(table):
            low, high = (100.0 * float(end) for end in str(line["cover_band"]).split(" to "))
            covered.fill_between([low, high], y - 0.4, y + 0.4, color=BAND, linewidth=0.0)
        _draw_by_kind(covered, table, "cover_90%", 100.0)
        _draw_by_kind(width, table, "width", 1.0)
        covered.axvline(100.0 * LEVEL, color=NEUTRAL, linewidth=0.6)
        width.axvline(1.0, color=NEUTRAL, linewidth=0.6)
        width.set_xscale("log", base=2)
        width.set_xticks([0.25, 0.5, 1.0], ["1/4", "1/2", "1"])
        for panel in (chosen, covered, width):
            panel.set_ylim(len(table) - 0.5, -0.5)
            panel.set_yticks([])
        chosen.set_yticks(range(len(table)), [str(line["name"]) for line in table])
        chosen.set_xlabel("recordings (%)")
        covered.set_xlabel("A covered (%)")
        width.set_xlabel("width over the truth's")
        for panel, columns in ((chosen, 3), (width, 5)):
            panel.legend(
                loc="upper right", bbox_to_anchor=(1.0, -0.3 / (0.3 * len(table))), ncols=columns,
                columnspacing=0.8, handletextpad=0.3, borderaxespad=0.0,
            )  # fmt: skip
        head_panels([chosen, covered, width], ["Kind chosen", "90 % intervals", "Their width"])
    return drawn


def _draw_choice(panel: Axes, table: Sequence[Mapping[str, Any]]) -> None:
    from bayesbl.presentation.figures.style import look

    rows, start = np.arange(len(table)), np.zeros(len(table))
    for n, kind in enumerate(KINDS):
        share = np.array([100.0 * float(line[f"chosen_{kind}"]) for line in table])
        panel.barh(
            rows, share, 0.7, start, color=look(n).colour, hatch=("", "//", "..")[n],
            edgecolor="white", label={"ar": "AR"}.get(kind, WORDS[kind]),
        )  # fmt: skip
        start = start + share
    panel.set_xlim(0.0, 100.0)


def _draw_by_kind(panel: Axes, table: Sequence[Mapping[str, Any]], what: str, scale: float) -> None:
    from bayesbl.presentation.figures.style import look

    for n, name in enumerate(ESTIMATORS):
        style, apart = look(n), 0.7 / len(ESTIMATORS)
        panel.plot(
            [scale * float(line[f"{name}_{what}"]) for line in table],
            np.arange(len(table)) + apart * (n - 0.5 * (len(ESTIMATORS) - 1)),
            color=style.colour, marker=style.marker, markersize=3.0, linestyle="none",
            label=WORDS[name],
        )  # fmt: skip


def _with_true_noise(point: PointEstimate, noise: NoiseModel) -> PointEstimate:
    """The covariance that the noise's true variance and autocorrelation give."""
    known = replace(
        point.noise,
        sd_rpm=noise.standard_deviation,
        coefficients=np.array(noise.coefficients),
        degrees_of_freedom=noise.degrees_of_freedom,
    )
    spread = covariance(point.optimum, point.objective.time_s, point.residual_rpm, known)
    return replace(point, noise=known, spread=spread)


def _sd(point: PointEstimate) -> float:
    """Of A, rpm."""
    return point.spread.standard_deviations[AMPLITUDE]
