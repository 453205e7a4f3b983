"""How often each search method finds the global RMSE optimum of recordings with known truth.

    bayesbl run configs/search_study.toml

Every case is a recording of the disturbance model itself: A = 20 rpm, T_w 2.5 to 4.5 s, 4 to 6
rotations, half the cases with white noise and half with AR(1) noise of a random coefficient. The
optimum refined from the truth is what a search has to reach. Under noise as strong as the ringing
the global optimum is not always at the true pulses, so both are reported: whether the search ended
as low (``found``), and whether it did so with its pulses where they truly are (``success``).

``paper`` is eq. 6 exactly, with four repetitions and the ranges of Table 2 as printed, on
recordings that eq. 6 itself made; it has found the optimum where its RMSE is no higher than that of
the truth.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import xarray as xr
from made_recordings import draw_symbols, speed_as_printed, synthetic_recording
from study_tools import StudyRow

from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_SPEED, FloatArray, Recording
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import find_optimum, local_search
from bayesbl.ringing.search import refine
from bayesbl.ringing.symbols import ROTATION, WINDOW_END, WINDOW_START, DisturbanceModel
from bayesbl.ringing.table_2 import same_pulses, search_as_printed

AMPLITUDE_RPM = 20.0
SAME_RMSE = 1e-6
"""An RMSE within this part of the optimum's is the optimum's."""
Method = Literal["guess", "paper"]

COLUMNS = {
    "found": ("1", "1 where the RMSE is as low as that of the optimum refined from the truth"),
    "right_pulses": (
        "1",
        "1 where all pulses are within a quarter ringing period of the truth",
    ),
    "rmse_excess": ("1", "RMSE relative to that of the optimum refined from the truth, less 1"),
    "search_seconds": ("s", "processor time of the search, one thread, after warm-up"),
    "evaluations": ("1", "evaluations of the RMSE by CMA-ES"),
    "signal_to_noise": ("1", "A over the standard deviation of the noise"),
    "noise_coefficient": ("1", "AR(1) coefficient of the noise, 0 for white"),
}


class Row(StudyRow):
    """A row: a method on a range of signal to noise."""

    method: Method
    signal_to_noise: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Found:
    """Where a search ended."""

    symbols: Mapping[str, float]
    rmse_rpm: float
    evaluations: int


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> dict[str, float]:
    warm_up(row.method)
    truth_seed, search_seed = seed.spawn(2)
    generator = np.random.default_rng(truth_seed)
    truth = draw_symbols(generator, AMPLITUDE_RPM)
    low, high = row.signal_to_noise
    ratio = math.exp(generator.uniform(math.log(low), math.log(high)))
    coefficient = generator.uniform(0.3, 0.95) if index % 2 else 0.0
    noise = NoiseModel(AMPLITUDE_RPM / ratio, (coefficient,) if coefficient else ())
    # The paper's model has no baseline, so its recordings have none either.
    harmonics = 1 if row.method == "guess" else 0
    if row.method == "paper":
        truth, recording = made_by_eq_6(truth, noise, generator)
    else:
        baseline = generator.uniform(0.0, 0.5 * AMPLITUDE_RPM) * _direction(generator)
        recording = synthetic_recording(
            truth,
            noise,
            generator,
            rotations=generator.uniform(4.0, 6.0),
            baseline_rpm=baseline[: 2 * harmonics].tolist(),
        )
    objective = Objective(DisturbanceModel(harmonics), recording.time_s, recording.motor_speed_rpm)
    begin = time.process_time()
    found = search(row.method, objective, np.random.default_rng(search_seed))
    seconds = time.process_time() - begin
    reference = (
        rmse_of_eq_6(objective, truth)
        if row.method == "paper"
        else best_rmse_near(objective, truth)
    )
    return {
        "found": found.rmse_rpm <= reference * (1.0 + SAME_RMSE),
        "right_pulses": same_pulses(found.symbols, truth, recording.duration_s),
        "rmse_excess": found.rmse_rpm / reference - 1.0,
        "search_seconds": seconds,
        "evaluations": found.evaluations,
        "signal_to_noise": ratio,
        "noise_coefficient": coefficient,
    }


def made_by_eq_6(
    symbols: Mapping[str, float], noise: NoiseModel, generator: np.random.Generator
) -> tuple[dict[str, float], Recording]:
    """A recording of exactly eq. 6: its four repetitions, a window inside Table 2's ranges."""
    truth = {**symbols, WINDOW_START: 0.0, WINDOW_END: 0.102}
    time_s = np.arange(round(5.5 * truth[ROTATION] * 1000.0)) / 1000.0
    speed = speed_as_printed(time_s, truth) + noise.draw(time_s.size, generator)
    return truth, Recording("eq. 6", time_s, {MOTOR_SPEED: speed})


def rmse_of_eq_6(objective: Objective, truth: Mapping[str, float]) -> float:
    """RMSE of eq. 6 at the truth, rpm: its optimum is at least as low."""
    residual = objective.speed_rpm - speed_as_printed(objective.time_s, truth)
    return math.sqrt(float(np.mean(residual**2)))


def summarise(row: Row, cases: xr.Dataset) -> dict[str, float]:
    found, right = cases["found"].values, cases["right_pulses"].values
    return {
        "found": float(found.mean()),
        "right_pulses": float(right.mean()),
        "success": float((found * right).mean()),
        "median_rmse_excess": float(cases["rmse_excess"].median()),
        "median_search_seconds": float(cases["search_seconds"].median()),
        "longest_search_seconds": float(cases["search_seconds"].max()),
        "median_evaluations": float(cases["evaluations"].median()),
    }


def search(method: Method, objective: Objective, generator: np.random.Generator) -> Found:
    """Where a method ends on a recording."""
    if method == "guess":
        optimum = find_optimum(objective, method, generator)
        return Found(optimum.symbols, optimum.rmse_rpm, optimum.evaluations)
    found, history = search_as_printed(objective, generator)
    return Found(found.symbols, found.rmse_rpm, int(history.evaluations[-1]))


def best_rmse_near(objective: Objective, truth: Mapping[str, float]) -> float:
    """RMSE of the optimum refined from the truth, in rpm."""
    start = np.array([truth[name] for name in objective.searched])
    refined = refine(objective, start)
    polished, _ = local_search(objective, refined, np.random.default_rng(0))
    least = objective.sum_of_squares(np.array([refined, polished])).min()
    return math.sqrt(least / objective.samples)


def _direction(generator: np.random.Generator) -> FloatArray:
    """cos and sin of a random phase."""
    phase = generator.uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(phase), math.sin(phase)])


@functools.cache
def warm_up(method: str) -> None:
    """Compile and import what a search needs, once in each process."""
    generator = np.random.default_rng(0)
    symbols = draw_symbols(generator, AMPLITUDE_RPM)
    recording = synthetic_recording(symbols, NoiseModel(1.0), generator, rotations=3.0)
    harmonics = 1 if method == "guess" else 0
    objective = Objective(DisturbanceModel(harmonics), recording.time_s, recording.motor_speed_rpm)
    find_optimum(objective, "guess", generator)
