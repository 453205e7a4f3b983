"""Check from the recordings alone that only the gap changed between snapshots.

Compared are quantities that the gap changes little or not at all: the controller's gains, the mean
current, the first two load orders of current and speed, the frequency and decay of the ringing. The
difference of each is reduced by the largest effect of a changed gap before it is compared with its
standard error. For the ringing, this effect is that of the user's own bench, by its curve; without
a bench, the largest over benches around the reference. Without a current, only the colour of the
noise shows a changed filter of the speed.

**Features of a recording.** Signals are folded over load rotations. Noise differs from one rotation
to the next, so products of two different rotations contain none of it on average. The amplitude of
a harmonic is computed from such products, so noise does not bias it upward. Standard errors come
from a block bootstrap of the part that does not repeat. The gains come from the control law at
every load order, by maximum likelihood with noise in both speed and current
(:func:`controller_gains`): products of different rotations would give K_p with an error several
times larger.

**Colour of the noise.** A recorder that smooths the speed lowers the ringing, and with it the
apparent gap. It also lowers the noise, more so at higher frequencies. The part that does not repeat
from rotation to rotation therefore shows the filter, best well above the ringing frequency. The
ratio of two such spectra is fitted by the ratio of two first-order filters,

    ln S₂/S₁ = c ± ln(1 + u (f/f_r)²),    Δ ln A = ± ½ ln(1 + u),

with ringing frequency f_r, level c and strength u. Among common filters, the first-order one lowers
the ringing most for a given loss at higher frequencies, so this errs on the safe side. Noise from
another source may look like a filter.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import polygamma

from bayesbl.bench.bench import Bench
from bayesbl.curve.gap_curve import GapCurve
from bayesbl.measurement.compatibility import SNAPSHOTS_APART
from bayesbl.measurement.measurement import (
    CheckItem,
    JointCheck,
    Reason,
    blind_spot,
    check_item,
    joint_check,
)
from bayesbl.probabilities import FALSE_ALARM, normal_isf
from bayesbl.recording.repetition import folded
from bayesbl.recording.types import MOTOR_CURRENT, FloatArray
from bayesbl.ringing.cleaning import MotorLine
from bayesbl.ringing.estimator import PointEstimate, nominal_speed_rpm
from bayesbl.ringing.symbols import FREQUENCY as ANGULAR_FREQUENCY
from bayesbl.ringing.symbols import ROTATION
from bayesbl.units import RPM_PER_RAD_PER_S

RESAMPLES = 100
"""Bootstrap samples: standard errors are then good to 7 %."""

BLOCKS_PER_ROTATION = 8
"""Blocks of an eighth of a rotation are much longer than the noise is correlated."""

SEED = 20260301
HARMONICS = (1, 2)

SMOOTHED = 31
"""Load orders over which the noise spectrum is smoothed: less than the width of the ringing."""

FEWEST_ORDERS = 6
ROUNDS = 8

PROPORTIONAL, INTEGRAL = "proportional gain", "integral gain"
MEAN_CURRENT = "mean current"


@dataclass(frozen=True, slots=True)
class Feature:
    """A quantity of the joint with its standard error, both in ``unit``."""

    name: str
    unit: str
    value: float
    standard_error: float


def harmonic_name(channel: str, order: int) -> str:
    """Name of a harmonic, such as ``current at load order 1``."""
    return f"{channel} at load order {order}"


def folded_rotations(point: PointEstimate) -> tuple[FloatArray, float]:
    """The recording of a fit, folded as :func:`features` takes it, and its sampling period, s."""
    recording, rotation_s = point.recording, point.optimum.symbols[ROTATION]
    direction = math.copysign(1.0, float(recording.motor_speed_rpm.mean()))
    rows = [recording.motor_speed_rpm]
    if MOTOR_CURRENT in recording.channels:
        rows.append(recording.channels[MOTOR_CURRENT])
    turn = rotation_s / recording.sampling_period_s
    rotations = np.stack([folded(direction * row, turn) for row in rows])
    return rotations, rotation_s / rotations.shape[2]


def beside_bench(
    point: PointEstimate, bench: Bench, delta_rad: FloatArray, rng: np.random.Generator
) -> list[CheckItem]:
    """Compare features of a recording with those of drawn benches at draws of δ, shape (k,).

    The part of the recording that does not repeat is added to each simulation, so noise affects
    both alike. Empty for fewer than two rotations, which do not show the noise.
    """
    measured, period_s = folded_rotations(point)
    if measured.shape[1] < 2:
        return []
    scatter = measured - measured.mean(axis=1, keepdims=True)
    speed_rpm = float(point.recording.motor_speed_rpm.mean())
    count, simulated = measured.shape[2], []
    waves = _waves(count)
    for gap in delta_rad:
        drawn = bench.draw(rng).with_parameters(reference_speed_rpm=speed_rpm)
        signals = drawn.simulate_many(
            float(gap),
            rotations=1.0,
            sampling_hz=count / drawn.rotation_period_s(speed_rpm),
            channels="all",
        )[0, 1:, :count]
        rotation = math.copysign(1.0, speed_rpm) * signals[: len(measured), None] + scatter
        gains = {gain.name: gain.value for gain in controller_gains(rotation, period_s)}
        simulated.append(gains | _sizes(rotation, waves))
    items = []
    for feature in features(measured, period_s):
        values = [by_name[feature.name] for by_name in simulated if feature.name in by_name]
        if values:
            mean, sd = float(np.mean(values)), float(np.std(values))
            sd = math.hypot(feature.standard_error, sd)
            z = (feature.value - mean) / sd if sd > 0.0 else 0.0
            items.append(check_item(feature.name, feature.value, mean, feature.unit, z))
    return items


def features(folded: FloatArray, period_s: float) -> list[Feature]:
    """Features of folded signals.

    ``folded``: motor speed in rpm and, if recorded, current in A, both positive in the direction of
    rotation; shape (1 or 2, rotations, samples of a rotation). ``period_s``: sampling period.
    """
    gains = controller_gains(folded, period_s)
    generator = np.random.default_rng(SEED)
    waves = _waves(folded.shape[2])
    drawn = [_sizes(_resampled(folded, generator), waves) for _ in range(RESAMPLES)]
    return gains + [
        Feature(name, _unit(name), value, float(np.std([d[name] for d in drawn], ddof=1)))
        for name, value in _sizes(folded, waves).items()
    ]


def controller_gains(folded: FloatArray, period_s: float) -> list[Feature]:
    """K_p/K_t and K_i/K_t from the control law, I_k = (K_p + K_i/jω_k) E_k / K_t.

    At every load order k, the mean over rotations of speed error E_k and current I_k has noise. Its
    covariance comes from the scatter between rotations, smoothed over ``SMOOTHED`` orders. The true
    E_k is estimated with the gains (errors in variables), by Gauss-Newton. Orders at which noise
    alone could make the speed error are left out: in noise that stands out by chance, the current
    answers the noise.

    Returns both gains; empty without a current, or if too few orders stand out. ``folded`` as
    :func:`features` takes it.
    """
    from scipy.ndimage import uniform_filter1d

    if len(folded) == 1:
        return []
    centred = folded - folded.mean(axis=2, keepdims=True)
    spectrum = np.fft.rfft(centred, axis=2)[:, :, 1:]
    spectrum[0] *= -1.0 / RPM_PER_RAD_PER_S
    rotations = spectrum.shape[1]
    error, current = spectrum.mean(axis=1)
    scatter = spectrum - spectrum.mean(axis=1, keepdims=True)
    noise = np.einsum("irk,jrk->ijk", scatter, scatter.conj()) / (rotations * (rotations - 1))
    noise = uniform_filter1d(noise.real, SMOOTHED) + 1j * uniform_filter1d(noise.imag, SMOOTHED)
    used = np.abs(error) ** 2 > math.log(error.size / FALSE_ALARM) * noise[0, 0].real
    if np.count_nonzero(used) < FEWEST_ORDERS:
        return []
    error, current, noise = error[used], current[used], noise[:, :, used]
    order = 1.0 + np.flatnonzero(used)
    integrated = folded.shape[2] * period_s / (2j * np.pi * order)
    regressors = np.stack([error, error * integrated])
    gains = np.linalg.solve(
        (regressors @ regressors.conj().T).real, (regressors.conj() @ current).real
    )
    for _ in range(ROUNDS):
        response = gains[0] + gains[1] * integrated
        variance = (
            noise[1, 1] + np.abs(response) ** 2 * noise[0, 0] - 2.0 * response.conj() * noise[1, 0]
        ).real
        residual = current - response * error
        cross_term = response.conj() * noise[0, 0] - noise[0, 1]
        true_error = error + cross_term / variance * residual
        columns = np.stack([true_error, true_error * integrated]) / np.sqrt(0.5 * variance)
        whitened = residual / np.sqrt(0.5 * variance)
        information = (columns @ columns.conj().T).real
        gains = gains + np.linalg.solve(information, (columns.conj() @ whitened).real)
    excess = float(np.sum(np.abs(whitened) ** 2)) / (2 * whitened.size - 2)
    sds = np.sqrt(np.diag(np.linalg.inv(information)) * max(excess, 1.0))
    return [
        Feature(name, _unit(name), float(value), float(sd))
        for name, value, sd in zip((PROPORTIONAL, INTEGRAL), gains, sds, strict=True)
    ]


def _waves(count: int) -> FloatArray:
    """Cosines and sines over a rotation, scaled to give amplitudes, (count, 2, harmonic)."""
    angle = 2.0 * np.pi * np.outer(np.arange(count), HARMONICS) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1) * (2.0 / count)


def _sizes(folded: FloatArray, waves: FloatArray) -> dict[str, float]:
    """Mean current and amplitudes at multiples of the load rotation, by name."""
    rotations = folded.shape[1]
    terms = np.tensordot(folded, waves, 1)
    power = np.sum(terms.sum(axis=1) ** 2 - np.sum(terms**2, axis=1), axis=1)
    sizes = np.sqrt(np.maximum(power / (rotations * (rotations - 1)), 0.0))
    values = {} if len(folded) == 1 else {MEAN_CURRENT: float(folded[1].mean())}
    for name, row in zip(("speed", "current"), sizes.tolist(), strict=False):
        values |= {harmonic_name(name, k): size for k, size in zip(HARMONICS, row, strict=True)}
    return values


def _resampled(folded: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Bootstrap sample: the repeating part plus shuffled blocks of the rest, channels alike."""
    channels, rotations, count = folded.shape
    mean = folded.mean(axis=1, keepdims=True)
    residual = (folded - mean) * math.sqrt(rotations / (rotations - 1))
    residual = residual.reshape(channels, rotations * count)
    length = max(1, count // BLOCKS_PER_ROTATION)
    starts = generator.integers(0, residual.shape[1], size=-(-residual.shape[1] // length))
    places = (starts[:, None] + np.arange(length)).ravel()[: residual.shape[1]] % residual.shape[1]
    return np.asarray(mean + residual[:, places].reshape(folded.shape))


def _unit(name: str) -> str:
    if name == PROPORTIONAL:
        return "A s/rad"
    if name == INTEGRAL:
        return "A/rad"
    return "rpm" if name.startswith("speed") else "A"


LOWEST_OVER_RINGING = 2.0
"""Lowest frequency used: below it, differences between impacts dominate."""

HIGHEST_OVER_SAMPLING = 0.4
"""Highest frequency used: above it, interpolation between samples leaves little power."""

LEAST_SCATTER = 1e-6
"""Share of the mean speed: less scatter is no noise, but the error of the fitted rotation."""

BANDS = 24
STRENGTHS = np.geomspace(1e-4, 30.0, 200)
"""Steps of 3 % in a filter's corner; the strongest filters cannot be distinguished."""


@dataclass(frozen=True, slots=True)
class NoiseSpectrum:
    """Spectrum of the part of a recorded speed that does not repeat.

    ``frequency_hz``, ``log_power``: shape (k,); power in an arbitrary unit, mean over ``degrees`` +
    1 rotations. ``degrees``: degrees of freedom (independent rotations) of each value.
    ``highest_hz``: highest usable frequency.
    """

    frequency_hz: FloatArray
    log_power: FloatArray
    degrees: int
    ringing_hz: float
    highest_hz: float


@dataclass(frozen=True, slots=True)
class FilterChange:
    """Change of ln A between two recordings by a changed filter.

    ``low``, ``high``: range in which χ² exceeds its minimum by at most the square of the requested
    deviations. ``deviations``: distance of the best value from no change, in standard deviations,
    with the sign of ``log_amplitude``.
    """

    log_amplitude: float
    low: float
    high: float
    deviations: float


def noise_spectrum(point: PointEstimate) -> NoiseSpectrum | None:
    """Noise spectrum of a fit's recording; ``None`` if the recording shows no usable noise.

    That is so if samples were repaired, if all rotations are rounded alike, or if there are fewer
    than two whole rotations.
    """
    recording, symbols = point.recording, point.optimum.symbols
    rotation_s, period_s = symbols[ROTATION], recording.sampling_period_s
    rotations = folded_rotations(point)[0][0]
    scatter = rotations - rotations.mean(axis=0)
    degrees, count = len(rotations) - 1, rotations.shape[1]
    smallest_scatter = LEAST_SCATTER * abs(float(rotations.mean()))
    if point.mended or point.noise.rounding_repeats or not scatter.std() > smallest_scatter:
        return None
    spectrum = np.fft.rfft(scatter, axis=1)[:, 1:]
    power = np.sum(np.abs(spectrum) ** 2, axis=0) / (degrees * count)
    # Linear interpolation at a fraction a between two samples keeps
    # 1 − 2a(1 − a)(1 − cos ωT) of the power.
    share = np.arange(rotations.size) * (rotation_s / period_s / count) % 1.0
    angle = 2.0 * math.pi * np.arange(1, power.size + 1) / count
    power /= 1.0 - 2.0 * np.mean(share * (1.0 - share)) * (1.0 - np.cos(angle))
    return NoiseSpectrum(
        np.arange(1, power.size + 1) / rotation_s,
        np.log(power),
        degrees,
        symbols[ANGULAR_FREQUENCY] / (2.0 * math.pi),
        HIGHEST_OVER_SAMPLING / period_s,
    )


def filter_change(
    first: NoiseSpectrum, other: NoiseSpectrum, deviations: float
) -> FilterChange | None:
    """Fit the filter that would explain the changed noise; ``None`` with too few bands.

    ``deviations``: half width of the returned range, in standard deviations.
    """
    lowest = LOWEST_OVER_RINGING * max(first.ringing_hz, other.ringing_hz)
    highest = min(first.highest_hz, other.highest_hz)
    if highest <= lowest:
        return None
    edges = np.geomspace(lowest, highest, BANDS + 1)
    (before, before_variance), (after, after_variance) = (
        _in_bands(spectrum, edges) for spectrum in (first, other)
    )
    usable = np.isfinite(before) & np.isfinite(after)
    if np.count_nonzero(usable) < 3:
        return None
    ratio = (after - before)[usable]
    weight = 1.0 / (before_variance + after_variance)[usable]
    relative_frequency = np.sqrt(edges[1:] * edges[:-1])[usable] / first.ringing_hz
    strengths = np.concatenate([-STRENGTHS[::-1], [0.0], STRENGTHS])
    shapes = np.sign(strengths)[:, None] * np.log1p(
        np.abs(strengths)[:, None] * relative_frequency**2
    )
    residual = ratio - shapes
    residual -= (residual @ weight / weight.sum())[:, None]
    chi2 = residual**2 @ weight
    best = int(np.argmin(chi2))
    # If the filter family does not fit, scale the uncertainty by the misfit.
    chi2 /= max(1.0, chi2[best] / (relative_frequency.size - 2))
    shifts = 0.5 * np.sign(strengths) * np.log1p(np.abs(strengths))
    within = shifts[chi2 <= chi2[best] + deviations**2]
    return FilterChange(
        float(shifts[best]),
        float(within.min()),
        float(within.max()),
        float(np.sign(shifts[best]) * math.sqrt(chi2[STRENGTHS.size] - chi2[best])),
    )


def _in_bands(spectrum: NoiseSpectrum, edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean of ln power in each band and its variance; NaN where a band is empty."""
    band = np.digitize(spectrum.frequency_hz, edges) - 1
    inside = (band >= 0) & (band < edges.size - 1)
    count = np.bincount(band[inside], minlength=edges.size - 1)
    total = np.bincount(band[inside], spectrum.log_power[inside], minlength=edges.size - 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return total / count, float(polygamma(1, spectrum.degrees)) / count


FREQUENCY, DECAY = "ringing frequency", "ringing decay"
FILTER = "share of the ringing that is recorded"
"""Its logarithm is compared, from the noise of the first snapshot and of another."""

RINGING = ((FREQUENCY, "Hz", 2.0 * math.pi), (DECAY, "1/s", 1.0))
"""Name and unit of ω and τ, and what that unit is in rad/s or 1/s."""

LINE = "line of the motor in the speed"
"""Ripple, or error of transmission or encoder, that stands out in the speed."""

HARMLESS_SD = 0.5
"""Harmless bias, in standard deviations: a 90 % interval then covers in 86 % of cases."""

BY_AMPLITUDE = {FREQUENCY: 0.1, DECAY: 0.5}
"""Largest ∂ln quantity/∂ln A along the gap, over benches within a factor of 1.6 of the reference
and gaps of 0.3 to 3 mrad (0.09 and 0.47, ``experiments/joint_features.py``). Without a bench."""

BY_GAP = {"current": 0.0025, "speed": 0.005}
"""Change of a load order, or of the mean, by 2.7 mrad more gap, as a share of the first order: the
load jumps by twice the gap at each change of flank, the second order by 8/(3π) of that angle (0.23
and 0.46 %, same command)."""

BY_SPEED = 2.0
"""Highest power of the speed in a quantity; the speeds of snapshots may differ by 2 %."""

BY_SAMPLING = {FREQUENCY: 0.15, DECAY: 0.41}
"""Largest relative error of a fit with sampling period T, per (ω T)², over the same benches at 125
and 250 Hz (0.149 and 0.408, same command)."""

SAME_RATE = 0.01
"""Relative difference up to which two sampling rates show the same noise."""

START_ANGLE_SD = {FREQUENCY: 0.0015, DECAY: 0.002}
"""Scatter of ln quantity with the start angle on the reference bench (same command), without a
bench."""

COULD_BE = {
    PROPORTIONAL: ("speed_gain_nm_s_per_rad", "torque_constant_nm_per_a", "speed_averaging"),
    INTEGRAL: ("integral_gain_nm_per_rad", "torque_constant_nm_per_a"),
    MEAN_CURRENT: ("motor_coulomb_friction", "motor_viscous_friction", "load_coulomb_friction"),
    harmonic_name("current", 1): ("gravity_torque_nm", "torque_constant_nm_per_a"),
    harmonic_name("current", 2): ("gear_mesh_friction", "load_torque_offset"),
    harmonic_name("speed", 1): ("gravity_torque_nm", "integral_gain_nm_per_rad"),
    harmonic_name("speed", 2): ("integral_gain_nm_per_rad", "gear_mesh_friction"),
    FREQUENCY: (
        "load_inertia_kg_m2",
        "shaft_stiffness_nm_per_rad",
        "speed_gain_nm_s_per_rad",
        "integral_gain_nm_per_rad",
        "speed_sensor_lag",
    ),
    DECAY: ("shaft_damping_nm_s_per_rad", "speed_gain_nm_s_per_rad", "speed_sensor_lag"),
    FILTER: ("speed_averaging", "speed_sensor_lag"),
    LINE: ("gear_transmission_error", "motor_torque_ripple", "encoder_eccentricity"),
}
"""Parameters and effects of the joint that would move each quantity."""

SHOWN_BEST = (DECAY, FREQUENCY, PROPORTIONAL, INTEGRAL, harmonic_name("current", 1))
"""Quantities whose smallest detectable change is reported, those of the ringing first."""


@dataclass(frozen=True, slots=True)
class _Snapshot:
    """The compared quantities of one snapshot."""

    name: str
    features: dict[str, Feature]
    log_amplitude: float
    log_amplitude_sd: float
    log_speed: float
    direction: float
    period_s: float
    noise: NoiseSpectrum | None
    lines: Mapping[int, MotorLine]
    by_bench: Mapping[str, FloatArray]
    """ln of each quantity of the ringing at the amplitude, by draws of the bench, (m,)."""

    @classmethod
    def of(cls, point: PointEstimate, curve: GapCurve | None) -> _Snapshot:
        centre, covariance = point.ringing
        by_bench: dict[str, FloatArray] = {}
        by_start_angle = START_ANGLE_SD
        if curve is not None and curve.ringing is not None:
            expected, scatter, _ = curve.ringing_at(centre[0])
            tables = curve.ringing.frequency_draws, curve.ringing.decay_draws
            for name, log, draws in zip(BY_AMPLITUDE, expected, tables, strict=True):
                rows = np.arange(len(draws))
                by_bench[name] = log + curve.at_rows(draws, rows, np.full(len(draws), centre[0]))
            sds = np.sqrt(np.diag(scatter)[1:]).tolist()
            by_start_angle = dict(zip(BY_AMPLITUDE, sds, strict=True))
        rotations, period_s = folded_rotations(point)
        # Fewer than two whole rotations do not show the noise.
        shown = features(rotations, period_s) if rotations.shape[1] > 1 else []
        by_name = {feature.name: feature for feature in shown}
        for index, (name, unit, scale) in enumerate(RINGING, start=1):
            sd = math.sqrt(covariance[index, index])
            if sd > 0.0:  # a fixed symbol was not measured
                value = math.exp(centre[index]) / scale
                sd = math.hypot(sd, by_start_angle[name])
                by_name[name] = Feature(name, unit, value, value * sd)
        recording = point.recording
        return cls(
            recording.name,
            by_name,
            math.log(centre[0]),
            math.sqrt(covariance[0, 0]) / centre[0],
            math.log(nominal_speed_rpm(recording)),
            float(np.sign(recording.motor_speed_rpm.mean())),
            recording.sampling_period_s,
            noise_spectrum(point),
            {line.order: line for line in point.lines},
            by_bench,
        )


def same_joint(
    points: Sequence[PointEstimate],
    repaired: Sequence[bool],
    stated: Sequence[Hashable] | None = None,
    curves: Sequence[GapCurve | None] | None = None,
) -> JointCheck:
    """Compare every snapshot with the first comparable one since the last repair.

    Parameters
    ----------
    repaired
        Whether each snapshot is the first one after a repair.
    stated
        What the user states of each snapshot; only snapshots with equal statements are compared.
    curves
        Curve of each snapshot, for its speed and sampling rate.
    """
    if len(points) < 2:
        return joint_check()
    pairs: list[_Pair] = []
    first: dict[Hashable, _Snapshot] = {}
    nothing = [None] * len(points)
    for point, after_repair, statement, curve in zip(
        points, repaired, stated or nothing, curves or nothing, strict=True
    ):
        snapshot = _Snapshot.of(point, curve)
        if after_repair:
            first.clear()
        if statement in first:
            pairs.append(_Pair(first[statement], snapshot))
        else:
            first[statement] = snapshot
    compared = sum(len(p.items) + (not p.shows_gains) + len(p.lines) for p in pairs)
    if not compared:
        return joint_check()
    bound = normal_isf(0.5 * FALSE_ALARM / compared)
    filters = [pair.filter_change(bound) for pair in pairs]
    items, changed = [], []
    for pair, change in zip(pairs, filters, strict=True):
        where = {"recording": pair.other.name} if len(pairs) > 1 else {}
        for item, finding in pair.findings(change, bound):
            items.append(item)
            if finding is not None:
                changed.append((item["quantity"], {**finding, **where}))
    blind = [*_too_small(pairs, bound), *_filters_unseen(pairs, filters)]
    if not all(MOTOR_CURRENT in point.recording.channels for point in points):
        blind = [blind_spot("gains_unseen"), *blind]
    return joint_check(
        not changed,
        items,
        (cause for quantity, _ in changed for cause in COULD_BE[quantity]),
        [finding for _, finding in changed],
        blind,
    )


def change_reason(check: JointCheck) -> Reason | None:
    """Why the change of a gap by a curve is withheld; ``None`` if it is not."""
    return None if check["agrees"] else Reason("joint_changed", {"also": check["findings"]})


@dataclass(frozen=True, slots=True)
class _Pair:
    """Two snapshots that are compared."""

    first: _Snapshot
    other: _Snapshot

    @property
    def shows_gains(self) -> bool:
        """Whether the control law shows a filter of the speed, better than the noise does."""
        return all(PROPORTIONAL in each.features for each in (self.first, self.other))

    @property
    def change(self) -> float:
        """Change of ln A."""
        return self.other.log_amplitude - self.first.log_amplitude

    @property
    def change_sd(self) -> float:
        return math.hypot(self.first.log_amplitude_sd, self.other.log_amplitude_sd)

    @property
    def harmless(self) -> float:
        """Largest bias of ln A that leaves an interval valid."""
        return HARMLESS_SD * self.change_sd

    @property
    def items(self) -> list[CheckItem]:
        """One item for each feature that both snapshots have."""
        items = []
        for name, before in self.first.features.items():
            after = self.other.features.get(name)
            reversed_direction = self.first.direction != self.other.direction
            # If the direction changed, so did the sign of a constant torque.
            if after is None or (name == MEAN_CURRENT and reversed_direction):
                continue
            difference, (possible, either, _) = after.value - before.value, self.by_gap(name)
            difference -= min(max(difference, min(possible, 0.0)), max(possible, 0.0))
            beyond = max(abs(difference) - either, 0.0)
            z = math.copysign(beyond, difference) / self.sd(name)
            items.append(check_item(name, after.value, before.value, before.unit, z))
        return items

    @property
    def lines(self) -> dict[int, CheckItem]:
        """One item for each line of the motor, by its order; a missing line has amplitude 0."""
        if abs(self.other.log_speed - self.first.log_speed) > SNAPSHOTS_APART:
            return {}
        items = {}
        for order in sorted({*self.first.lines, *self.other.lines}):
            no_line = MotorLine(order, 0.0, 0.0)
            before, after = (each.lines.get(order, no_line) for each in (self.first, self.other))
            sd = math.hypot(before.standard_error_rpm, after.standard_error_rpm)
            z = (after.size_rpm - before.size_rpm) / sd if sd > 0.0 else 0.0
            items[order] = check_item(LINE, after.size_rpm, before.size_rpm, "rpm", z)
        return items

    def filter_change(self, bound: float) -> FilterChange | None:
        """The filter change by the noise; ``None`` if gains show it better or the rates differ.

        At another sampling rate, another part of the noise is aliased.
        """
        first, other = self.first, self.other
        same_rate = abs(math.log(other.period_s / first.period_s)) < SAME_RATE
        if self.shows_gains or first.noise is None or other.noise is None or not same_rate:
            return None
        return filter_change(first.noise, other.noise, bound)

    def findings(
        self, change: FilterChange | None, bound: float
    ) -> Iterator[tuple[CheckItem, dict[str, Any] | None]]:
        """Yield each item with its finding; ``None`` if the difference is chance or harmless."""
        for item in self.items:
            significant = abs(item["z"]) > bound
            yield item, {"code": "quantity_changed", **_values(item)} if significant else None
        if change is not None:
            shift = change.log_amplitude
            item = check_item(FILTER, math.exp(shift), 1.0, "", change.deviations)
            significant = abs(item["z"]) > bound and abs(shift) > self.harmless
            smallest = math.expm1(change.low if shift > 0.0 else change.high)
            yield item, {"code": "filter_changed", "least_share": smallest} if significant else None
        for order, item in self.lines.items():
            # A ripple that repeats with the motor also acts when the teeth meet. It changes their
            # speed of contact by up to its own amplitude, and the ringing in proportion.
            largest = abs(item["measured"] - item["expected"]) / math.exp(self.first.log_amplitude)
            smallest = max(abs(self.change) - bound * self.change_sd, 0.0)
            significant = abs(item["z"]) > bound and abs(self.change) > self.harmless
            values = {"order": order, "furthest_share": largest, **_values(item)}
            is_changed = significant and largest >= smallest
            yield item, {"code": "line_changed", **values} if is_changed else None

    def by_gap(self, name: str) -> tuple[float, float, float]:
        """Change of a feature that gap, speed and sampling may cause, in three parts.

        Returns a change that may be there or not, the largest change of either sign, and the
        standard deviation of the first. If the speed is a mean over the sampling period T, it is
        late by T/2, so K_p + K_i/jω appears larger by K_i T/2.
        """
        first, other = self.first, self.other
        value = first.features[name].value
        if name in first.by_bench and name in other.by_bench:
            logs = [snapshot.by_bench[name] for snapshot in (first, other)]
            count = min(map(len, logs))
            change = logs[1][:count] - logs[0][:count]
            return value * float(np.expm1(change.mean())), 0.0, value * float(change.std())
        if name == PROPORTIONAL:
            later_s = 0.5 * (other.period_s - first.period_s)
            return later_s * first.features[INTEGRAL].value, 0.0, 0.0
        if name == INTEGRAL:
            return 0.0, 0.0, 0.0  # the control law depends on neither speed nor gap
        by_speed = BY_SPEED * abs(value * (other.log_speed - first.log_speed))
        if name in BY_AMPLITUDE:
            angular_frequency = 2.0 * math.pi * first.features[FREQUENCY].value
            squares = angular_frequency**2 * (other.period_s**2 - first.period_s**2)
            by_sampling = BY_SAMPLING[name] * abs(squares)
            by_amplitude = abs(BY_AMPLITUDE[name] * self.change)
            return 0.0, by_speed + abs(value) * (by_amplitude + by_sampling), 0.0
        channel = "speed" if name.startswith("speed") else "current"
        by_harmonic = BY_GAP[channel] * first.features[harmonic_name(channel, 1)].value
        return 0.0, by_speed + by_harmonic, 0.0

    def sd(self, name: str) -> float:
        """Standard deviation of a feature's change beyond the possible one."""
        errors = [s.features[name].standard_error for s in (self.first, self.other)]
        return math.hypot(*errors, self.by_gap(name)[2])


def _values(item: CheckItem) -> dict[str, Any]:
    """Keys of an item that a finding reports: all but ``z``."""
    return {key: value for key, value in item.items() if key != "z"}


def _too_small(pairs: Sequence[_Pair], bound: float) -> Iterator[dict[str, Any]]:
    """Yield the smallest detectable change of each quantity, by the least sensitive pair."""
    for name in SHOWN_BEST:
        detectable = [
            (
                bound * pair.sd(name) + sum(map(abs, pair.by_gap(name)[:2])),
                pair.first.features[name].value,
            )
            for pair in pairs
            if name in pair.first.features and name in pair.other.features
        ]
        if not detectable:
            continue
        # Noise may hide a harmonic.
        visible = all(value > 0.0 for _, value in detectable)
        share = max(size / value for size, value in detectable) if visible else None
        yield blind_spot("change_unseen", quantity=name, share=share)


def _filters_unseen(
    pairs: Sequence[_Pair], filters: Sequence[FilterChange | None]
) -> Iterator[dict[str, Any]]:
    """Yield the filters of the speed that would go undetected, by the least sensitive pair."""
    by_noise = [(p, f) for p, f in zip(pairs, filters, strict=True) if not p.shows_gains]
    if any(change is None for _, change in by_noise):
        yield blind_spot("filter_unseen")
    undetected = [
        max(change.high - change.log_amplitude, change.log_amplitude - change.low, pair.harmless)
        for pair, change in by_noise
        if change is not None
    ]
    if undetected:
        yield blind_spot("filter_before_noise_unseen")
        yield blind_spot("small_filter_unseen", share=math.expm1(max(undetected)))
