"""The bench's own parameters (name, meaning, sign) and their flat vector.

Some parameters drift between two snapshots even if nobody touched the joint: grease warms up,
magnets weaken, bearings settle. It is therefore never assumed that only the gap changed. Joint
knowledge of several parameters is a normal distribution of their logarithms.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from bayesbl.bench.effect_declaration import EffectParameter
from bayesbl.bench.effects import EFFECTS, effect_named
from bayesbl.bench.kernel import Slot
from bayesbl.errors import BenchError, SimulationError
from bayesbl.recording.types import FloatArray
from bayesbl.units import unit_of


@dataclass(frozen=True, slots=True)
class ParameterInfo:
    """Declaration of a bench parameter.

    ``positive``: it must not be zero, and must be above zero unless ``signed``; if not
    ``positive``, zero is allowed too. ``default``: value if a bench file does not give it; ``None``
    if it must. ``idle``: value if the file of a rigid bench does not give it, which is only
    compared with recordings and never driven. ``correctable``: whether a wrong value can explain a
    disagreement of recordings with the bench (a parameter error).
    """

    name: str
    meaning: str
    positive: bool = True
    signed: bool = False
    default: float | None = None
    idle: float | None = None
    correctable: bool = False

    @property
    def unit(self) -> str:
        """Unit, from the ending of the name; empty for a pure number."""
        return unit_of(self.name)


BENCH_PARAMETERS: tuple[ParameterInfo, ...] = (
    ParameterInfo("gear_ratio", "gear ratio N, motor turns per load turn"),
    ParameterInfo("motor_inertia_kg_m2", "inertia J_m of the motor", correctable=True),
    ParameterInfo("load_inertia_kg_m2", "inertia J_l of the load", correctable=True),
    ParameterInfo(
        "shaft_stiffness_nm_per_rad",
        "torsional stiffness K_s, seen at the load",
        idle=1.0,
        correctable=True,
    ),
    ParameterInfo(
        "shaft_damping_nm_s_per_rad",
        "torsional damping D_s, seen at the load",
        positive=False,
        idle=0.0,
        correctable=True,
    ),
    ParameterInfo(
        "gravity_torque_nm",
        "largest torque m g l of gravity on the load",
        positive=False,
        default=0.0,
        correctable=True,
    ),
    ParameterInfo(
        "speed_gain_nm_s_per_rad",
        "proportional gain K_p of the speed controller",
        idle=1.0,
        correctable=True,
    ),
    ParameterInfo(
        "integral_gain_nm_per_rad",
        "integral gain K_i of the speed controller",
        positive=False,
        idle=0.0,
        correctable=True,
    ),
    ParameterInfo(
        "position_gain_per_s",
        "gain of the outer position controller; 0 for none",
        positive=False,
        default=0.0,
    ),
    ParameterInfo(
        "torque_constant_nm_per_a", "torque constant K_t of the motor", idle=1.0, correctable=True
    ),
    ParameterInfo(
        "current_limit_a", "largest current i_max that the controller asks for", idle=1.0
    ),
    ParameterInfo(
        "reference_speed_rpm", "reference speed ω_ref, negative for reverse", signed=True, idle=1.0
    ),
    ParameterInfo(
        "stiffness_sharpness_per_rad",
        "sharpness α of the arctan stiffness at the edges of the gap",
        default=1e6,
    ),
    ParameterInfo(
        "gravity_angle_rad",
        "angle φ_g that gravity's torque m g l sin(θ_l + φ_g) is ahead of the load's",
        positive=False,
        signed=True,
        default=0.0,
    ),
)

PARAMETER_INFO: Mapping[str, ParameterInfo] = {info.name: info for info in BENCH_PARAMETERS}

CORRECTABLE_PARAMETERS = tuple(info.name for info in BENCH_PARAMETERS if info.correctable)
"""Parameters whose wrong values are a separate class of explanations. See docs/design.md, "What
recordings cannot tell apart"."""

SMALLEST_SHARPNESS_GAP = 50.0
"""α·δ below which the arctan form has no dead zone left, only a weak shaft."""

SHARPEST_PER_RAD = 5e5
"""α above which the gap may be arbitrarily small. Edges of 2 µrad, 0.2 µm at 100 mm, are sharper
than those of any tooth, and the torque of 2 K_s/(π α) that the dead zone lacks around zero twist
moves no impact."""


def declaration_of(name: str) -> ParameterInfo | EffectParameter:
    """Declaration of a bench parameter or ``effect.parameter``, also by its slot's name."""
    owner, _, parameter = name.replace("__", ".").partition(".")
    return effect_named(owner).parameter(parameter) if parameter else PARAMETER_INFO[owner]


def label(slot: Slot) -> str:
    """A slot as a user writes it: ``load_coulomb_friction.torque_nm``."""
    return slot.name.replace("__", ".")


def slot_of(name: str) -> Slot:
    """Slot of a bench parameter, run setting or ``effect.parameter``.

    Raises
    ------
    BenchError
        If there is no such parameter.
    """
    try:
        return Slot[name.replace(".", "__")]
    except KeyError:
        raise BenchError(
            "There is no such parameter in the simulator.",
            found=name,
            expected="one of " + ", ".join(label(slot) for slot in Slot),
        ) from None


def check_parameters(matrix: FloatArray) -> None:
    """Refuse parameter vectors without physical sense.

    Parameters
    ----------
    matrix
        Shape (m, SLOTS), one parameter vector per row.

    Raises
    ------
    BenchError
        With the parameter, the row's value and the expected values.
    """
    for column in np.flatnonzero(~np.isfinite(matrix).all(axis=0)):
        _refuse_where(~np.isfinite(matrix[:, column]), matrix, Slot(int(column)), "a finite number")
    for info in BENCH_PARAMETERS:
        slot = Slot[info.name]
        values = matrix[:, slot]
        if info.signed and info.positive:
            _refuse_where(values == 0.0, matrix, slot, "a number other than zero")
        elif info.positive:
            _refuse_where(values <= 0.0, matrix, slot, "a number above zero")
        elif not info.signed:
            _refuse_where(values < 0.0, matrix, slot, "zero or a number above it")
        size = np.abs(values)
        extreme = (size > 1.0 / SMALLEST) | ((size != 0.0) & (size < SMALLEST))
        _refuse_where(extreme, matrix, slot, f"a size from {SMALLEST:g} to {1.0 / SMALLEST:g}")
    _check_gap(matrix)
    for slot, low, high, is_open, expected, switches in _BOUNDS:
        values = matrix[:, slot]
        inside = (low < values) & (values < high) if is_open else (low <= values) & (values <= high)
        if not inside.all():
            wrong = ~inside & np.any(matrix[:, switches] != 0.0, axis=1)
            _refuse_where(wrong, matrix, slot, expected)


def _check_gap(matrix: FloatArray) -> None:
    gap_rad = matrix[:, Slot.gap_rad]
    wrong = (gap_rad < 0.0) | (gap_rad > math.pi)
    _refuse_where(wrong, matrix, Slot.gap_rad, "zero or a number above it, at most π: half a turn")
    gap = matrix[:, Slot.gap_rad] + matrix[:, Slot.backlash__gap_rad]
    sharpness = matrix[:, Slot.stiffness_sharpness_per_rad]
    arctan = (matrix[:, Slot.hard_dead_zone] == 0.0) & (matrix[:, Slot.rigid] == 0.0)
    weak = arctan & (gap > 0.0) & (sharpness < SHARPEST_PER_RAD)
    weak &= sharpness * gap < SMALLEST_SHARPNESS_GAP
    if weak.any():
        row = int(np.argmax(weak))
        raise SimulationError(
            "The arctan stiffness has no dead zone at so small a gap: stiffness_sharpness_per_rad "
            f"must be at least {SHARPEST_PER_RAD:g}, or {SMALLEST_SHARPNESS_GAP:g} over the gap, "
            'or the shaft is only weakened everywhere. Use gap_form = "dead_zone", a larger '
            "sharpness, or no gap.",
            where="stiffness_sharpness_per_rad * gap_rad",
            found=f"{sharpness[row]:g} * {gap[row]:g} = {sharpness[row] * gap[row]:.3g}",
        )


ROUNDING = 1e-12
"""Relative tolerance of the ends of a range, which may have been rounded via their logarithm."""

SMALLEST = 1e-30
"""Smallest size of a parameter: products and ratios of a few such numbers stay finite."""

_POSITIVE = (0.0, math.inf, True, "a number above zero")
_NOT_NEGATIVE = (0.0, math.inf, False, "zero or a number above it")


def _bounds() -> Iterator[tuple[Slot, float, float, bool, str, list[Slot]]]:
    """Yield per slot: least and largest value, whether both are excluded, the expected values as
    text, and the slots of which one must be non-zero for the bounds to hold."""
    yield Slot.learned_torque__period, *_POSITIVE, [Slot.learned_torque__side]
    yield Slot.encoder_error__period_rad, *_POSITIVE, [Slot.encoder_error__orders]
    for effect in EFFECTS:
        amplitudes = [effect.slots[item.name] for item in effect.amplitudes]
        for item in effect.parameters:
            slot, low, high = effect.slots[item.name], item.low, item.high
            if item.not_negative:
                yield slot, *_NOT_NEGATIVE, [slot]
            if bound := item.smaller_than:
                expected = f"between -{bound:g} and {bound:g} {item.unit}".rstrip()
                yield slot, -bound, bound, True, expected, [slot]
            if item.bounded:
                slack, expected = ROUNDING * max(abs(low), abs(high)), f"a number from {low:g}"
                on = [slot, *amplitudes]
                yield slot, low - slack, high + slack, False, f"{expected} to {high:g}", on
            if item.positive_scale:
                yield slot, *_POSITIVE, amplitudes


_BOUNDS = tuple(_bounds())
_DECLARED = {effect.slots[item.name]: item for effect in EFFECTS for item in effect.parameters}


def simulated_range(name: str) -> tuple[float, float]:
    """Smallest and largest value of a slot that its effect declares, by the slot's name.

    Infinite without such an end, as for slots of no effect.
    """
    item = _DECLARED.get(Slot[name])
    if item is not None and item.bounded:
        return item.low, item.high
    return 0.0 if item is not None and item.not_negative else -math.inf, math.inf


def _refuse_where(wrong: NDArray[np.bool_], matrix: FloatArray, slot: Slot, expected: str) -> None:
    if wrong.any():
        row = int(np.argmax(wrong))
        raise SimulationError(
            "This value makes no physical sense.",
            where=label(slot),
            found=f"{matrix[row, slot]:g}",
            expected=expected,
        )


def rotation_period_s(matrix: FloatArray) -> FloatArray:
    """Time of one load rotation T_w = 2πN/|ω_ref| for each row, s."""
    speed = np.abs(matrix[:, Slot.reference_speed_rpm]) * (2.0 * math.pi / 60.0)
    period: FloatArray = 2.0 * math.pi * matrix[:, Slot.gear_ratio] / speed
    return period


# Lubricant temperatures vary by some 20 K: Bittencourt & Gunnarsson 2012, J. Dyn. Syst. Meas.
# Control 134, 051013. So do those of motors: the remanence of Nd-Fe-B falls by 0.08 to 0.12 % per
# kelvin (IEC 60404-8-1). Young's modulus of steel falls by 0.03 % per kelvin; the preload of
# bearings accounts for the rest.
DEFAULT_DRIFT: Mapping[str, float] = MappingProxyType(
    {
        "shaft_damping_nm_s_per_rad": 0.2,
        "shaft_stiffness_nm_per_rad": 0.01,
        "torque_constant_nm_per_a": 0.02,
        "contact_damping": 0.2,
        "stiffness_hardening": 0.02,
        "shaft_hysteresis": 0.2,
        "motor_coulomb_friction": 0.2,
        "motor_viscous_friction": 0.3,
        "motor_quadratic_drag": 0.3,
        "motor_stribeck_friction": 0.3,
        "friction_asymmetry": 0.3,
        "load_coulomb_friction": 0.2,
        "load_viscous_friction": 0.3,
        "gear_mesh_friction": 0.2,
    }
)
"""Relative standard deviation between two snapshots, by name of a bench parameter or effect. Other
parameters do not drift unless configured. Gains and payload are set by people: they stay or are
changed, and a change shows."""


def drift_of(name: str, stated: Mapping[str, float]) -> float:
    """Relative standard deviation of a parameter, an effect or ``effect.parameter``."""
    effect = name.partition(".")[0]
    return next(
        (d[key] for d in (stated, DEFAULT_DRIFT) for key in (name, effect) if key in d), 0.0
    )


FURTHEST = 5.0
"""Largest distance of a parameter from its value, in standard deviations: farther by chance once in
two million, so a parameter there contradicts its identification."""


@dataclass(frozen=True, slots=True, eq=False)
class JointNormal:
    """ln p ~ N(ln of the bench's values, covariance).

    Attributes
    ----------
    names
        k bench parameters, all above zero.
    covariance
        Covariance of their logarithms, shape (k, k), positive definite.
    sources
        SHA-256 of the files that it was learned from.
    """

    names: tuple[str, ...]
    covariance: FloatArray
    sources: tuple[str, ...] = ()

    def sd(self, name: str) -> float:
        """Standard deviation of the logarithm of one parameter: about its relative one."""
        i = self.names.index(name)
        return float(np.sqrt(self.covariance[i, i]))

    def whitening(self, names: Sequence[str]) -> FloatArray:
        """W with Wᵀ W the inverse covariance of these parameters' logarithms, shape (n, n)."""
        index = [self.names.index(name) for name in names]
        root = np.linalg.cholesky(self.covariance[np.ix_(index, index)])
        return np.asarray(np.linalg.inv(root))

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Draw factors of the values, shape (count, k)."""
        root = np.linalg.cholesky(self.covariance)
        return np.exp(rng.standard_normal((count, len(self.names))) @ root.T)
