"""Predictions of the bench as a function of the unknowns, compared with recordings.

The direct posterior of δ and the search for missing effects both build on this. Unknowns are the
gap, each recording's start angle, bench parameters within their tolerance and parameters of
effects. A point is an array of their coordinates: ln δ for the gap, and the value itself for the
others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import InitVar, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from bayesbl.bench.bench import Bench
from bayesbl.bench.effects import after, effect_named
from bayesbl.bench.learned import LearnedTerm
from bayesbl.bench.parameters import FURTHEST, JointNormal, simulated_range
from bayesbl.matching.as_observed import (
    RecentSimulations,
    accuracy_rpm,
    continued,
    in_whole_ticks,
    repeats,
    simulated,
)
from bayesbl.matching.observed import Observed
from bayesbl.noise.channel_noise import ChannelNoise
from bayesbl.processes import in_threads
from bayesbl.recording.types import BoolArray, FloatArray
from bayesbl.sampling.importance import truncated_normal

GAP = "gap_rad"
START_ANGLE = "start_angle_rad"
REFERENCE_DELAY = "reference_delay_s"
SMALLEST_GAP_RAD = 1e-5
"""Smallest angle that counts as a gap: makers of precision reducers state 0.1′ of play, 0.0145
mrad, at best."""
MOST_DELAY_S = 0.02
"""A few cycles of the slowest usual bus."""
TURN_SD_RAD = 2.0 * math.pi / math.sqrt(12.0)
"""Standard deviation of a uniformly distributed angle."""

AT_ONCE = 64
"""Number of simulated recordings in memory."""
FEW_POINTS = 16
"""Number of points below which recordings are simulated in parallel."""


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
        Name of its recording; ``None`` if all recordings share it.
    logarithmic
        Whether the coordinate is ln of the value.
    offset
        For a logarithmic coordinate ln(value + offset), so that the value can be zero.
    added
        Whether the value is added to the recording's value without it: unchanged at ``reference``,
        otherwise in proportion.
    reference
        Zero for the bench's value.
    """

    name: str
    low: float = -math.inf
    high: float = math.inf
    centre: float = 0.0
    sd: float = math.inf
    recording: str | None = None
    logarithmic: bool = False
    added: bool = False
    reference: float = 0.0
    offset: float = 0.0

    @property
    def key(self) -> tuple[str, str | None]:
        """Name and recording."""
        return self.name, self.recording

    @property
    def label(self) -> str:
        """Name, followed by the recording if it belongs to one."""
        name = f"drift of {self.name}" if self.added else self.name
        return name if self.recording is None else f"{name} ({self.recording})"

    def value(self, coordinate: FloatArray) -> FloatArray:
        """Convert the coordinate to the value."""
        return np.exp(coordinate) - self.offset if self.logarithmic else coordinate

    def coordinate(self, value: FloatArray) -> FloatArray:
        """Convert the value to the coordinate; −∞ below its range."""
        if not self.logarithmic:
            return value
        with np.errstate(divide="ignore"):
            return np.log(np.maximum(value + self.offset, 0.0))

    def slope(self, value: FloatArray) -> FloatArray:
        """Derivative of the value by the coordinate, at a value."""
        return value + self.offset if self.logarithmic else np.ones_like(value)

    @property
    def middle(self) -> float:
        """Centre of the prior, or the middle of the range; 0 if it has neither."""
        if math.isfinite(self.sd) or not math.isfinite(self.high - self.low):
            return self.centre
        return 0.5 * (self.low + self.high)

    @property
    def prior_sd(self) -> float:
        """Standard deviation of the prior, whether normal or flat.

        An unknown with neither range nor normal prior is an angle, flat over a turn.
        """
        flat = (self.high - self.low) / math.sqrt(12.0)
        sd = min(flat, self.sd)
        return sd if math.isfinite(sd) else TURN_SD_RAD


def gap_unknown(low_rad: float, high_rad: float, recording: str | None = None) -> Unknown:
    """δ with a log-uniform prior; from zero with the density 1/(δ + 0.01 mrad), which is proper.

    It belongs to one recording, or to all if ``recording`` is ``None``. Signals are linear in δ
    below :data:`SMALLEST_GAP_RAD`, and in ln δ far above.
    """
    offset = 0.0 if low_rad > 0.0 else SMALLEST_GAP_RAD
    low, high = math.log(low_rad + offset), math.log(high_rad + offset)
    # Rounding must not make a gap negative.
    low = low if low_rad > 0.0 else math.nextafter(low, high)
    return Unknown(GAP, low, high, recording=recording, logarithmic=True, offset=offset)


def start_angle_unknown(recording: str) -> Unknown:
    """Start angle of one recording; its prior is a turn wide, for joints without gravity."""
    return Unknown(START_ANGLE, centre=math.pi, sd=TURN_SD_RAD, recording=recording)


def reference_delay_unknown(recording: str) -> Unknown:
    """Delay of a motion's reference in the loop relative to the recorded one, with a flat prior.

    A controller holds its reference from sample to sample and receives it over a bus.
    """
    return Unknown(REFERENCE_DELAY, -MOST_DELAY_S, MOST_DELAY_S, recording=recording)


def tolerance_unknowns(bench: Bench) -> list[Unknown]:
    """Bench parameters that are not known exactly, as identified or within their tolerances.

    A tolerance becomes a normal prior with the standard deviation of a uniform one, because values
    slightly outside occur. It is a prior of the logarithm: a combination that no recording shows,
    such as one factor on all torques and the torque constant, is a straight line among logarithms.
    A value that may be zero is uniform within its tolerance.
    """
    unknowns, joint = [], bench.identified
    for name, half in bench.tolerances.items():
        value = bench.value(name)
        is_identified = joint is not None and name in joint.names
        if not is_identified and half >= value:
            unknowns.append(Unknown(name, value - half, value + half))
            continue
        sd = (
            joint.sd(name) if joint is not None and is_identified else half / value / math.sqrt(3.0)
        )
        middle, reach = math.log(value), FURTHEST * sd
        low, high = middle - reach, middle + reach
        unknowns.append(Unknown(name, low, high, middle, sd, logarithmic=True))
    return unknowns


def effect_unknowns(bench: Bench, recordings: Sequence[str]) -> list[Unknown]:
    """Effect parameters of the bench with a standard deviation (Gaussian prior) and phases (flat).

    The motor's angle at the first sample differs between recordings, and the phase with it.
    """
    unknowns = []
    for effect in bench.effects:
        for item in effect_named(effect.name).parameters:
            name = f"{effect.name}__{item.name}"
            parameter = effect.parameters.get(item.name)
            if item.role == "phase":
                unknowns += [Unknown(name, recording=recording) for recording in recordings]
            elif parameter is not None and parameter.sd:
                low = item.low if item.low <= parameter.value else -math.inf
                unknowns.append(
                    Unknown(name, low, simulated_range(name)[1], parameter.value, parameter.sd)
                )
    for learned in bench.learned_terms:
        unknowns += shift_unknowns(learned, recordings)
        terms = zip(learned.names, learned.coefficients, learned.sd, strict=False)
        unknowns += [Unknown(name, centre=value, sd=sd) for name, value, sd in terms if sd > 0.0]
    return unknowns


def shift_unknowns(learned: LearnedTerm, recordings: Sequence[str]) -> list[Unknown]:
    """Shift of a learned term in every recording, if each has its own zero of the variable."""
    if not learned.belongs_to_recordings:
        return []
    # Two periods, so that the best shift is never at the end of the range.
    reach = learned.period
    return [Unknown(learned.shift_slot, -reach, reach, recording=name) for name in recordings]


@dataclass(frozen=True, slots=True, eq=False)
class NormalPrior:
    """The density exp(−½ Σ ((x − c)/s)² − ½|W (x − c)|²).

    Attributes
    ----------
    centre
        c, shape (d,).
    sd
        s of each unknown, shape (d,); infinite for no prior or a joint one.
    together
        W, shape (k, d), of the joint prior.
    """

    centre: FloatArray
    sd: FloatArray
    together: FloatArray

    @classmethod
    def of(
        cls,
        centre: FloatArray,
        sd: FloatArray,
        shared: Sequence[str | None],
        joint: JointNormal | None,
    ) -> NormalPrior:
        """Combine the unknowns' own priors and the bench's joint prior.

        ``shared``: names of the unknowns that all recordings share, ``None`` for others.
        """
        joined = [] if joint is None else [i for i, n in enumerate(shared) if n in joint.names]
        together = np.zeros((len(joined), centre.size))
        if joint is not None and joined:
            together[:, joined] = joint.whitening([str(shared[i]) for i in joined])
        alone = sd.copy()
        alone[joined] = np.inf
        return cls(centre, alone, together)

    @property
    def precision(self) -> FloatArray:
        """Inverse covariance, 0 for unknowns without a normal prior, shape (d, d)."""
        return np.asarray(np.diag(self.sd**-2.0) + self.together.T @ self.together)

    def deviations(self, point: FloatArray) -> FloatArray:
        """Whitened centre − coordinate, shape (k,)."""
        alone = (self.centre - point) / self.sd
        return np.concatenate([alone[np.isfinite(self.sd)], self.together @ (self.centre - point)])

    def log_densities(self, points: FloatArray) -> FloatArray:
        """ln density of each coordinate given those before, up to constants; (m, d) to (m, d)."""
        offsets = points - self.centre
        densities = -0.5 * (offsets / self.sd) ** 2
        # W is the inverse of a lower triangular root: each row conditions on the coordinates
        # before.
        joined = np.flatnonzero(np.any(self.together != 0.0, axis=0))
        densities[:, joined] -= 0.5 * (offsets @ self.together.T) ** 2
        return np.asarray(densities)


@dataclass(eq=False)
class SimulatedSignals:
    """Predictions of the bench for several recordings, at many points at once.

    Attributes
    ----------
    noise
        Noise of each recording; it makes residuals independent and standard normal.
    workers
        Number of threads; no result depends on it.
    settings
        Known values besides the bench, by name, such as ``gap_rad``.
    recent
        Cache of simulations, shared with other models of the same recordings.
    white_recordings
        Whitened channels of each recording, from another model with the same noise.
    normal_prior
        Normal prior of the unknowns that have one.

    Raises
    ------
    ValueError
        If two recordings have the same name: they would get each other's start angle.
    """

    bench: Bench
    recordings: Sequence[Observed]
    unknowns: Sequence[Unknown]
    noise: Sequence[ChannelNoise]
    workers: int = field(default=1, compare=False)
    settings: Mapping[str, float] = field(default_factory=dict)
    recent: RecentSimulations = field(default_factory=RecentSimulations, compare=False)
    white_recordings: InitVar[Sequence[FloatArray] | None] = None

    def __post_init__(self, white_recordings: Sequence[FloatArray] | None) -> None:
        self.recordings, self.unknowns = tuple(self.recordings), tuple(self.unknowns)
        names = [observation.name for observation in self.recordings]
        if len(set(names)) < len(names):
            raise ValueError(f"Unknowns belong to recordings by name, and two are alike: {names}")
        self.normal_prior = NormalPrior.of(
            np.array([u.centre for u in self.unknowns]),
            np.array([u.sd for u in self.unknowns]),
            [u.name if u.recording is None and not u.added else None for u in self.unknowns],
            self.bench.identified,
        )
        self._white_recordings = white_recordings or [
            n.whiten(observation.signals)
            for n, observation in zip(self.noise, self.recordings, strict=True)
        ]

    @property
    def low(self) -> FloatArray:
        """Lower ends of the priors, shape (d,)."""
        return np.array([u.low for u in self.unknowns])

    @property
    def high(self) -> FloatArray:
        """Upper ends of the priors, shape (d,)."""
        return np.array([u.high for u in self.unknowns])

    def index(self, name: str, recording: str | None = None) -> int:
        """Index of an unknown in a point."""
        return [u.key for u in self.unknowns].index((name, recording))

    def place_of(self, name: str, recording: str) -> int | None:
        """Index of a recording's own unknown, or of the shared one; ``None`` if it is known."""
        keys = [u.key for u in self.unknowns]
        return next((keys.index((name, r)) for r in (recording, None) if (name, r) in keys), None)

    def places_in(self, recording: int) -> list[int]:
        """Indices of all unknowns that a recording depends on."""
        name = self.recordings[recording].name
        return [i for i, u in enumerate(self.unknowns) if u.recording in (None, name)]

    def with_unknowns(self, bench: Bench, unknowns: Sequence[Unknown]) -> SimulatedSignals:
        """The same model with another bench and further unknowns."""
        return replace(
            self,
            bench=bench,
            unknowns=(*self.unknowns, *unknowns),
            white_recordings=self._white_recordings,
        )

    @property
    def size(self) -> int:
        """Number of whitened residuals of all recordings, N."""
        return sum(observation.size for observation in self._white_recordings)

    def samples_of(self, recording: int) -> int:
        """Number of whitened residuals of one recording, over its channels."""
        return self._white_recordings[recording].size

    def signals(self, points: FloatArray, recording: int) -> FloatArray:
        """Predicted channels of one recording, (m, d) to (m, c, n); nan if a run fails."""
        return continued(self.stretch(points, recording), self.recordings[recording].samples)

    def stretch(self, points: FloatArray, recording: int) -> FloatArray:
        """Like :meth:`signals`, but a single rotation if all are alike, (m, c, lag)."""
        observation = self.recordings[recording]
        matrix = self._benches(np.atleast_2d(points), observation)
        accuracy = accuracy_rpm(self.noise[recording], observation)
        samples = observation.lag if repeats(matrix, observation) else observation.samples
        return self.recent.signals(
            matrix,
            (
                *observation.rows,
                samples,
                observation.sampling_hz,
                accuracy,
                observation.motor_start_rad,
                observation.motion,
            ),
            partial(simulated, observation, samples, accuracy, self.workers, "nan"),
        )

    def require(self, point: FloatArray) -> None:
        """Check that all recordings can be simulated at a point (d,).

        Raises
        ------
        BenchError
            With the reason, if one cannot.
        """
        for observation, noise in zip(self.recordings, self.noise, strict=True):
            matrix = self._benches(point[None], observation)
            simulated(
                observation,
                observation.samples,
                accuracy_rpm(noise, observation),
                1,
                "raise",
                matrix,
            )

    def vectors(self, points: FloatArray, observation: Observed, **overrides: float) -> FloatArray:
        """Bench parameters for a recording at points, (m, d) to (m, SLOTS), with ``overrides``."""
        matrix = self.bench.vector(**(self.settings_of(points, observation) | overrides))
        return matrix if len(matrix) == len(points) else np.repeat(matrix, len(points), axis=0)

    def _benches(self, points: FloatArray, observation: Observed) -> FloatArray:
        """Parameters that a recording's simulations use, (m, d) to (m, SLOTS)."""
        matrix = self.vectors(points, observation)
        if observation.begin_s:
            matrix = after(matrix, observation.begin_s)
        return in_whole_ticks(
            self.bench.measurement.seen_by(matrix, observation.sampling_hz), observation
        )

    def settings_of(self, points: FloatArray, observation: Observed) -> dict[str, Any]:
        """Values that replace the bench's for a recording, as :meth:`Bench.vector` takes them.

        Known values of the recording take precedence over shared unknowns, and its own unknowns
        over both.
        """
        settings: dict[str, Any] = {}
        if observation.motion is None:
            settings["reference_speed_rpm"] = observation.reference_speed_rpm
        settings |= self.settings
        own_values = []
        for i, unknown in enumerate(self.unknowns):
            if unknown.recording is None:
                settings[unknown.name] = unknown.value(points[:, i])
            elif unknown.recording == observation.name:
                own_values.append((unknown, unknown.value(points[:, i])))
        settings |= observation.known
        for unknown, value in own_values:
            if unknown.added:
                nominal = unknown.reference or self.bench.value(unknown.name)
                base = settings.get(unknown.name, nominal)
                # In proportion, so that drift cannot make a value negative that a tolerance lowers.
                value = base + value * (base / nominal if nominal else 1.0)
                # The shared value may have moved too, and make an earlier drift too large.
                value = np.clip(value, *simulated_range(unknown.name))
            settings[unknown.name] = value
        return settings

    def whitened(self, points: FloatArray) -> FloatArray:
        """Whitened residuals of all recordings, (m, d) to (m, N): their squares sum to χ²."""
        points = np.atleast_2d(points)
        sizes = [observation.size for observation in self._white_recordings]
        white = np.empty((len(points), self.size))
        parts = np.split(white, np.cumsum(sizes)[:-1], axis=1)

        def fill(recording: int) -> None:
            self._whiten_into(parts[recording], points, recording)

        # A batch has enough rows for all threads, and parallel batches would take more memory.
        in_threads(fill, range(len(parts)), self.workers if len(points) < FEW_POINTS else 1)
        return white

    def by_recording(self, white: FloatArray) -> list[FloatArray]:
        """Whitened residuals (N,) of one point as views by recording, each of shape (c, n − p)."""
        ends = np.cumsum([observation.size for observation in self._white_recordings])
        return [
            part.reshape(len(observation.signals), -1)
            for part, observation in zip(np.split(white, ends[:-1]), self.recordings, strict=True)
        ]

    def rotations(self, recording: int) -> NDArray[np.int64]:
        """Rotation or cycle number of each whitened sample, shape (n − p,).

        A remainder shorter than half a rotation belongs to the rotation before it.
        """
        observation = self.recordings[recording]
        number = np.arange(self.noise[recording].order, observation.samples) // observation.lag
        return np.minimum(number, max(round(observation.samples / observation.lag) - 1, 0))

    def rotation_log_density(self, recording: int) -> FloatArray:
        """ln density of each rotation of a recording at χ² = 0, (rotation,)."""
        observation, noise, rotation = (
            self.recordings[recording],
            self.noise[recording],
            self.rotations(recording),
        )
        log_density = np.log(np.diag(noise.root)).sum() + 0.5 * len(observation.signals) * math.log(
            2.0 * math.pi
        )
        counts = np.bincount(rotation[self._counts(recording)], minlength=rotation[-1] + 1)
        return np.asarray(-log_density * counts)

    def _counts(self, recording: int) -> BoolArray:
        """Whitened samples without excluded ones, shape (n − p,)."""
        observation, order = self.recordings[recording], self.noise[recording].order
        if observation.excluded is None:
            return np.ones(observation.samples - order, dtype=bool)
        return np.asarray(~sliding_window_view(observation.excluded, order + 1).any(axis=1))

    def only_in(self, recording: int, white: FloatArray) -> FloatArray:
        """Whitened residuals (N,) of one recording, zero in all others."""
        part = np.zeros_like(white)
        self.by_recording(part)[recording][:] = self.by_recording(white)[recording]
        return part

    def whitened_of(self, points: FloatArray, recording: int) -> FloatArray:
        """Whitened residuals of one recording, (m, d) to (m, c (n − p)); 0 where excluded."""
        points = np.atleast_2d(points)
        white = np.empty((len(points), self._white_recordings[recording].size))
        self._whiten_into(white, points, recording)
        return white

    def _whiten_into(self, out: FloatArray, points: FloatArray, recording: int) -> None:
        observation, noise = self.recordings[recording], self.noise[recording]
        stretch = self.stretch(points, recording)
        # Whitening is linear, so a repeating signal still repeats after it.
        prediction = noise.whiten(
            continued(stretch, min(stretch.shape[2] + noise.order, observation.samples))
        )
        observed = self._white_recordings[recording]
        white = out.reshape(len(points), *observed.shape)
        length = prediction.shape[2]
        for begin in range(0, observed.shape[1], length):
            window = slice(begin, begin + length)
            observed_part = observed[:, window]
            np.subtract(
                observed_part, prediction[:, :, : observed_part.shape[1]], out=white[:, :, window]
            )
        if observation.excluded is not None:
            white[..., ~self._counts(recording)] = 0.0
        if observation.motor_lines is not None:
            observation.motor_lines.project_out(white)

    def log_prior(self, points: FloatArray) -> FloatArray:
        """Log prior density up to a constant, (m, d) to (m,); −inf outside the ranges."""
        points = np.atleast_2d(points)
        inside = np.all((points >= self.low) & (points <= self.high), axis=1)
        density = self.normal_prior.log_densities(points).sum(axis=1)
        return np.where(inside, density, -np.inf)

    def log_priors(self, points: FloatArray) -> FloatArray:
        """Log prior density of each unknown's value, up to constants, (m, d) to (m, d)."""
        is_logarithmic = np.array([float(u.logarithmic) for u in self.unknowns])
        densities = self.normal_prior.log_densities(points)
        return np.asarray(densities - points * is_logarithmic)

    def prior_draws(self, count: int, generator: np.random.Generator) -> FloatArray:
        """Draws of the prior, shape (count, d); an angle without a prior is uniform over a turn."""
        low, high = self.low, self.high
        endless = ~np.isfinite(high - low)
        flat_low, flat_high = np.where(endless, 0.0, low), np.where(endless, 2.0 * np.pi, high)
        points = generator.uniform(flat_low, flat_high, (count, low.size))
        precision = self.normal_prior.precision
        normal = np.flatnonzero(np.diag(precision) > 0.0)
        if normal.size:
            points[:, normal] = truncated_normal(
                self.normal_prior.centre[normal],
                np.asarray(np.linalg.inv(precision[np.ix_(normal, normal)]), dtype=np.float64),
                (low[normal], high[normal]),
                count,
                generator,
            )
        return points

    def prior_precision(self) -> FloatArray:
        """Inverse prior covariance, with flat priors as normal ones, shape (d, d)."""
        precision = np.array([u.prior_sd**-2.0 for u in self.unknowns])
        together = self.normal_prior.together
        precision[np.any(together != 0.0, axis=0)] = 0.0
        return np.asarray(np.diag(precision) + together.T @ together)
