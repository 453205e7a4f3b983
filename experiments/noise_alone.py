"""How strong a ringing the search finds in recordings that hold noise alone.

    bayesbl run configs/noise_alone.toml

The optimum is the best of many start times, separations, rotation periods, frequencies and decays,
so its A/σ_A is far above zero where there is nothing. An answer is withheld below
``WEAKEST_SIGNAL_TO_NOISE``; this says how rarely noise alone passes it. Recordings of 18 s at 1 kHz
with noise of 1.5 rpm. Those in which the search finds fewer than two rotations are refused, which
is no answer either.
"""

from __future__ import annotations

import math

import numpy as np
import xarray as xr
from pydantic import Field
from study_tools import StudyRow

from bayesbl.errors import RecordingError
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.types import MOTOR_SPEED, Recording
from bayesbl.ringing.estimator import Estimator
from bayesbl.sampling.convergence import WEAKEST_SIGNAL_TO_NOISE

SAMPLES = 18_000
SAMPLING_HZ = 1000.0
NOISE_SD_RPM = 1.5
MEAN_SPEED_RPM = 2000.0

COLUMNS = {
    "signal_to_noise": ("1", "A over its standard deviation, NaN where the recording is refused"),
    "answered": ("1", "1 where it is strong enough for an answer"),
}


class Row(StudyRow):
    """A row: a colour of noise."""

    noise_coefficient: float = Field(ge=0.0, lt=1.0)


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> dict[str, float]:
    noise_seed, search_seed = seed.spawn(2)
    noise = NoiseModel(NOISE_SD_RPM, (row.noise_coefficient,) if row.noise_coefficient else ())
    drawn = noise.draw(SAMPLES, np.random.default_rng(noise_seed))
    time_s = np.arange(SAMPLES) / SAMPLING_HZ
    recording = Recording("noise", time_s, {MOTOR_SPEED: MEAN_SPEED_RPM + drawn})
    try:
        point = Estimator().estimate(recording, search_seed)
    except RecordingError:
        return {"signal_to_noise": math.nan, "answered": 0.0}
    ratio = point.signal_to_noise
    return {"signal_to_noise": ratio, "answered": ratio >= WEAKEST_SIGNAL_TO_NOISE}


def summarise(row: Row, cases: xr.Dataset) -> dict[str, float]:
    ratio = cases["signal_to_noise"].values
    found = ratio[np.isfinite(ratio)]
    mean, sd = float(found.mean()), float(found.std(ddof=1))
    return {
        "answered": float(cases["answered"].sum()),
        "refused": float(np.sum(~np.isfinite(ratio))),
        "mean_signal_to_noise": mean,
        "sd_signal_to_noise": sd,
        "largest_signal_to_noise": float(found.max()),
        "gumbel_chance_of_answer": gumbel_tail(WEAKEST_SIGNAL_TO_NOISE, mean, sd),
    }


def gumbel_tail(level: float, mean: float, sd: float) -> float:
    """Probability that the largest of many, of this mean and spread, is above a level.

    The largest of many normal variables approaches Gumbel's law from below, so this is a bound.
    """
    scale = sd * math.sqrt(6.0) / math.pi
    return -math.expm1(-math.exp(-((level - mean) / scale + float(np.euler_gamma))))
