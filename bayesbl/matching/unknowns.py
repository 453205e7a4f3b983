"""What a match looks for: unknowns, each with its prior.

They are the gap, each recording's start angle, bench parameters within their tolerance or as
identified, and parameters of effects; a point is an array of their coordinates.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.bench.effects import effect_named
from bayesbl.bench.joint_normal import JointNormal
from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.recording.types import FloatArray

GAP = "gap_rad"
START_ANGLE = "start_angle_rad"

FURTHEST_IDENTIFIED = 5.0
"""Standard deviations that an identified parameter may be from its value: further by chance once in
two million; a parameter there contradicts what it was identified from."""


@dataclass(frozen=True, slots=True)
class Unknown:
    """One coordinate of a point.

    Attributes
    ----------
    name
        As :meth:`Bench.vector` takes it: a bench parameter, ``gap_rad``, ``start_angle_rad`` or
        ``effect__parameter``.
    low, high
        Range of a flat prior, in the coordinate; infinite for none.
    centre, sd
        Gaussian prior within that range; an infinite sd for none.
    recording
        Name of the recording it belongs to; ``None`` if all share it.
    logarithmic
        The coordinate is the natural logarithm of the value.
    added
        The value is added to what the recording has without it.
    flat_in_value
        The prior is uniform in the value where the coordinate is its logarithm.
    """

    name: str
    low: float = -math.inf
    high: float = math.inf
    centre: float = 0.0
    sd: float = math.inf
    recording: str | None = None
    logarithmic: bool = False
    added: bool = False
    flat_in_value: bool = False

    @property
    def label(self) -> str:
        """Name, with the recording where it belongs to one."""
        name = f"drift of {self.name}" if self.added else self.name
        return name if self.recording is None else f"{name} ({self.recording})"

    def value(self, coordinate: FloatArray) -> FloatArray:
        """From the coordinate to the value."""
        return np.exp(coordinate) if self.logarithmic else coordinate

    @property
    def prior_sd(self) -> float:
        """Standard deviation of the prior, a flat one's included.

        An unknown with neither range nor other prior is an angle, flat over a turn.
        """
        flat = (self.high - self.low) / math.sqrt(12.0)
        known = min(flat, self.sd)
        return known if math.isfinite(known) else 2.0 * math.pi / math.sqrt(12.0)


def gap_unknown(low_rad: float, high_rad: float) -> Unknown:
    """δ with a log-uniform prior."""
    return Unknown(GAP, math.log(low_rad), math.log(high_rad), logarithmic=True)


def start_angle_unknown(recording: str) -> Unknown:
    """Start angle of one recording, flat."""
    return Unknown(START_ANGLE, recording=recording)


def tolerance_unknowns(bench: Bench) -> list[Unknown]:
    """Every bench parameter that is not known exactly: uniform within its tolerance, or identified.

    Those identified have the joint prior of the bench (:attr:`SimulatedSignals.normal_prior`).
    """
    joint = bench.identified
    return [
        Unknown(name, bench.value(name) - half, bench.value(name) + half)
        if joint is None or name not in joint.names
        else _identified_unknown(name, math.log(bench.value(name)), joint.sd(name))
        for name, half in bench.tolerances.items()
    ]


def _identified_unknown(name: str, centre: float, sd: float) -> Unknown:
    reach = FURTHEST_IDENTIFIED * sd
    return Unknown(name, centre - reach, centre + reach, centre, sd, logarithmic=True)


def scale_unknown(bench: Bench, name: str) -> Unknown:
    """A parameter uniform within its tolerance, by its logarithm where all of it is above zero.

    What no recording can show, such as all torques and the torque constant times one factor, is a
    straight line among logarithms, however wide the tolerances.
    """
    value, half = bench.value(name), bench.tolerances[name]
    if value <= half:
        return Unknown(name, value - half, value + half)
    low, high = math.log(value - half), math.log(value + half)
    return Unknown(name, low, high, logarithmic=True, flat_in_value=True)


def drift_unknowns(
    bench: Bench, may_drift: Mapping[str, float], recordings: Sequence[str]
) -> list[Unknown]:
    """How far each parameter may have moved since the first recording, uniform.

    Parameters
    ----------
    may_drift
        Half-width by the name of a bench parameter or ``effect.parameter``, in its unit.
    """
    found = []
    for name, half in may_drift.items():
        value = bench.value(name)
        signed = name in PARAMETER_INFO and PARAMETER_INFO[name].signed
        low = -half if signed or value < 0.0 else max(-half, -value)
        slot = name.replace(".", "__")
        found += [Unknown(slot, low, half, recording=r, added=True) for r in recordings[1:]]
    return found


def effect_unknowns(bench: Bench, recordings: Sequence[str]) -> list[Unknown]:
    """Effect parameters of the bench that carry a standard deviation, Gaussian; phases, flat.

    The motor's angle at the first sample differs between recordings, and the phase with it.
    """
    found = []
    for effect in bench.effects:
        for item in effect_named(effect.name).parameters:
            name = f"{effect.name}__{item.name}"
            given = effect.parameters.get(item.name)
            if item.role == "phase":
                found += [Unknown(name, recording=recording) for recording in recordings]
            elif given is not None and given.sd:
                low = item.low if item.low <= given.value else -math.inf
                found.append(Unknown(name, low, centre=given.value, sd=given.sd))
    return found


def normal_prior(
    unknowns: Sequence[Unknown], joint: JointNormal | None
) -> tuple[FloatArray, FloatArray]:
    """W of shape (k, d) and c (d,): normal priors have the density exp(−½|W (x − c)|²).

    ``joint``: that of parameters which all recordings share, in place of their own.
    """
    normal = [i for i, u in enumerate(unknowns) if math.isfinite(u.sd)]
    together = [i for i in normal if joint is not None and _is_of(joint, unknowns[i])]
    alone = [i for i in normal if i not in together]
    whitening = np.zeros((len(normal), len(unknowns)))
    for row, i in enumerate(alone):
        whitening[row, i] = 1.0 / unknowns[i].sd
    if joint is not None and together:
        whitening[len(alone) :, together] = joint.whitening([unknowns[i].name for i in together])
    return whitening, np.array([u.centre for u in unknowns])


def _is_of(joint: JointNormal, unknown: Unknown) -> bool:
    return unknown.recording is None and not unknown.added and unknown.name in joint.names
