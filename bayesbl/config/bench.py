"""Bench files: from TOML to a :class:`Bench`, and back.

Units may be those of data sheets and drives. Some of these numbers have another meaning: a reset
time stands for the integral gain, a bandwidth for the proportional gain, a damping ratio for the
damping. They are converted with the other parameters of the bench.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import tomli_w
from pydantic import AfterValidator, Field, field_validator

from bayesbl.arguments import File, checked
from bayesbl.bench.bench import Bench, BenchEffect, BenchParameter, EffectParameterValue
from bayesbl.bench.effects import effect_named
from bayesbl.bench.learned import ENCODER, LearnedTerm, Side, Variable
from bayesbl.bench.parameters import PARAMETER_INFO
from bayesbl.bench.simulation import Measurement
from bayesbl.config.kinds import bench_parameter, effect_name
from bayesbl.config.loading import load_file
from bayesbl.config.sections import Items, Section, Tolerance, refuse, require_different
from bayesbl.errors import BenchError, ConfigError
from bayesbl.noise.process import NoiseModel
from bayesbl.units import RPM_PER_RAD_PER_S, STANDARD_GRAVITY

ARCMIN_PER_RAD = 60.0 * 180.0 / math.pi

Values = Mapping[str, float]
Conversion = Callable[[float, Values], float]  # of the printed number and those before it


def _times(factor: float) -> Conversion:
    return lambda value, bench: factor * value


def _inverse(factor: float) -> Conversion:
    return lambda value, bench: factor / value


_INERTIA = {
    "kg m2": _times(1.0),
    "kg cm2": _times(1e-4),
    "kg mm2": _times(1e-6),
    "g cm2": _times(1e-7),
}
_SPEED_GAIN = {
    "N m s/rad": _times(1.0),
    "N m/rpm": _times(RPM_PER_RAD_PER_S),
    "A s/rad": lambda value, bench: value * bench["torque_constant_nm_per_a"],
    "A/rpm": lambda value, bench: value * RPM_PER_RAD_PER_S * bench["torque_constant_nm_per_a"],
    "1/s": lambda value, bench: value * _total_inertia(bench),
}
CONVERSIONS: Mapping[str, Mapping[str, Conversion]] = {
    "motor_inertia_kg_m2": _INERTIA,
    "load_inertia_kg_m2": _INERTIA,
    "shaft_stiffness_nm_per_rad": {
        "N m/rad": _times(1.0),
        "kN m/rad": _times(1e3),
        "N m/deg": _times(180.0 / math.pi),
        "N m/arcmin": _times(ARCMIN_PER_RAD),
        "arcmin/N m": _inverse(ARCMIN_PER_RAD),
        "rad/N m": _inverse(1.0),
    },
    "gravity_torque_nm": {"N m": _times(1.0), "kg m": _times(STANDARD_GRAVITY)},
    "torque_constant_nm_per_a": {"N m/A": _times(1.0), "mN m/A": _times(1e-3)},
    "shaft_damping_nm_s_per_rad": {
        "N m s/rad": _times(1.0),
        "damping ratio": lambda value, bench: (
            2.0
            * value
            * math.sqrt(bench["shaft_stiffness_nm_per_rad"] * reduced_inertia_kg_m2(bench))
        ),
    },
    "speed_gain_nm_s_per_rad": _SPEED_GAIN,
    "integral_gain_nm_per_rad": {
        "N m/rad": _times(1.0),
        "s": lambda value, bench: bench["speed_gain_nm_s_per_rad"] / value,
        "ms": lambda value, bench: 1e3 * bench["speed_gain_nm_s_per_rad"] / value,
    },
    "position_gain_per_s": {"1/s": _times(1.0), "m/min/mm": _times(1000.0 / 60.0)},
    "reference_speed_rpm": {"rpm": _times(1.0), "rad/s": _times(RPM_PER_RAD_PER_S)},
    "current_limit_a": {"A": _times(1.0), "mA": _times(1e-3)},
}
"""Units in which a parameter may be printed, its own first; later parameters may need earlier
ones."""


def accepted(name: str) -> tuple[str, ...]:
    """Units in which a parameter may be given."""
    return tuple(CONVERSIONS.get(name, {PARAMETER_INFO[name].unit: None}))


def spelled(unit: str) -> str:
    """``kg cm²`` as ``kg cm2``, ``arcmin/(Nm)`` as ``arcmin/N m``."""
    text = unit.strip().replace("²", "2").replace("^2", "2").replace("·", " ").replace("*", " ")
    text = text.replace("(", "").replace(")", "").replace("s⁻¹", "1/s").replace("′", "arcmin")
    return text.replace("Nm", "N m")


def reduced_inertia_kg_m2(bench: Values) -> float:
    """Reduced inertia of motor and load, seen at the load: 1/(1/J_l + 1/(N² J_m))."""
    motor = bench["gear_ratio"] ** 2 * bench["motor_inertia_kg_m2"]
    return 1.0 / (1.0 / bench["load_inertia_kg_m2"] + 1.0 / motor)


def _total_inertia(bench: Values) -> float:
    """Inertia of motor and load, seen at the motor."""
    return bench["motor_inertia_kg_m2"] + bench["load_inertia_kg_m2"] / bench["gear_ratio"] ** 2


REFERENCE_BENCH = "reference_bench.toml"
AVERAGING = effect_named("speed_averaging")
LONGEST_AVERAGE_S = AVERAGING.parameter("time_s").high


class _Uncertain(Section):
    """A value with at most one statement of its uncertainty."""

    value: float
    tolerance: Tolerance = Field(default=None, ge=0.0)
    relative_tolerance: Tolerance = Field(default=None, ge=0.0, lt=1.0)

    def require_sound(self) -> None:
        stated = {
            name: value
            for name in ("sd", "tolerance", "relative_tolerance")
            if (value := getattr(self, name, None)) is not None
        }
        if len(stated) > 1:
            also = "standard deviation or " if "sd" in type(self).model_fields else ""
            refuse(
                f"A parameter has one {also}tolerance.",
                found=" and ".join(f"{name} = {value:g}" for name, value in stated.items()),
                expected="one of them",
            )


class ParameterEntry(_Uncertain):
    """A parameter of the bench; a tolerance is the half-width of its range.

    ``unit``: that of the data sheet, if it is not the one in the parameter's name.
    """

    unit: str | None = None

    def parameter(self, value: float) -> BenchParameter:
        """The bench's parameter; ``value`` is in the bench's own unit."""
        if self.relative_tolerance is not None:
            return BenchParameter(value, self.relative_tolerance * abs(value))
        unit = abs(value / self.value) if value != self.value and self.value else 1.0
        return BenchParameter(value, (self.tolerance or 0.0) * unit)


@contextmanager
def _refusing() -> Iterator[None]:
    """Refuse what a part of a bench refuses, in the same words."""
    try:
        yield
    except BenchError as error:
        refuse(error.problem, found=error.found, expected=error.expected)


def kind_of(noise: NoiseModel) -> str:
    """Name of the kind of noise in a bench file."""
    if noise.degrees_of_freedom is not None:
        return "student_t"
    return "ar" if noise.coefficients else "white"


class _NoiseEntry(Section):
    """Noise of a channel; ``sd`` is that of the noise, not of its innovations."""

    sd: float
    kind: Literal["white", "ar", "student_t"] = "white"
    coefficients: Items[float] = ()
    degrees_of_freedom: float | None = Field(default=None, gt=2.0)

    def require_sound(self) -> None:
        with _refusing():
            if self.kind != (kind := kind_of(self.model())):
                refuse(
                    "Degrees of freedom belong to Student-t noise, coefficients alone to an "
                    "autoregressive one, neither to a white one.",
                    found=f'kind = "{self.kind}" with {len(self.coefficients)} coefficients and '
                    f"degrees_of_freedom {self.degrees_of_freedom}",
                    expected=f'kind = "{kind}", or other keys',
                )

    def model(self) -> NoiseModel:
        """The noise model."""
        return NoiseModel(self.sd, self.coefficients, self.degrees_of_freedom)


class SpeedNoise(_NoiseEntry):
    """Noise of the speed channel."""

    sd: float = Field(alias="sd_rpm", ge=0.0)


class CurrentNoise(_NoiseEntry):
    """Noise of the current channel."""

    sd: float = Field(alias="sd_a", ge=0.0)


class MeasurementSection(Section):
    """``[measurement]``: how the bench is measured.

    ``speed_filter_s``: the time over which the recorded speed is averaged, as in the effect
    ``speed_averaging``. ``speed_source = "encoder"``: the mean speed over a sampling period.
    """

    encoder_counts: int | None = Field(default=None, ge=1)
    speed_source: Literal["sensor", "encoder"] = "sensor"
    speed_filter_s: float = Field(default=0.0, ge=0.0, le=LONGEST_AVERAGE_S)
    speed_noise: SpeedNoise = SpeedNoise(sd_rpm=0.0)
    current_noise: CurrentNoise = CurrentNoise(sd_a=0.0)
    noise_through_controller: bool = False

    def require_sound(self) -> None:
        if self.speed_source == "encoder" and self.encoder_counts is None:
            refuse(
                "A speed from the encoder needs its counts.",
                found="no encoder_counts",
                expected="encoder_counts, in counts per motor revolution",
            )
        if self.speed_source == "encoder" and self.speed_filter_s > 0.0:
            refuse(
                "A speed from the encoder is averaged over a sampling period already.",
                found=f"speed_filter_s = {self.speed_filter_s:g}",
                expected='speed_filter_s alone, with the whole time, or speed_source = "encoder"',
            )

    def measurement(self) -> Measurement:
        """The bench's measurement."""
        return Measurement(
            encoder_counts=self.encoder_counts,
            speed_source=self.speed_source,
            speed_noise=self.speed_noise.model(),
            current_noise=self.current_noise.model(),
            noise_through_controller=self.noise_through_controller,
        )


class EffectValue(_Uncertain):
    """A parameter of an effect, with ``sd`` if it was estimated, or a tolerance if it was stated.

    A tolerance is the half-width of a uniform distribution, whose standard deviation is used.
    """

    sd: float | None = Field(default=None, ge=0.0)

    def parameter(self) -> EffectParameterValue:
        """The bench's parameter."""
        half_width = self.tolerance
        if self.relative_tolerance is not None:
            half_width = self.relative_tolerance * abs(self.value)
        sd = self.sd if half_width is None else half_width / math.sqrt(3.0)
        return EffectParameterValue(self.value, sd)


def _above_zero(entry: EffectValue) -> EffectValue:
    if entry.value <= 0.0:
        problem = "The stiffness of a spring and the inertia behind it are above zero."
        refuse(problem, found=f"{entry.value:g}", expected="a number above zero")
    return entry


AboveZero = Annotated[EffectValue, AfterValidator(_above_zero)]


class _Spring(Section):
    """A part of the joint behind a spring, as a data sheet states it."""

    # The effect, the key of the inertia, the effect's parameter for it, and the bench parameter
    # that counts it too, of which it is then a share.
    as_effect: ClassVar[tuple[str, str, str, str | None]]
    further: ClassVar[tuple[str, ...]] = ()  # keys that are parameters of the effect as they are

    stiffness_nm_per_rad: AboveZero
    damping_nm_s_per_rad: EffectValue = EffectValue(value=0.0)

    def effect(self, values: Values) -> BenchEffect:
        """The bench's effect; ``values`` are the bench's parameters."""
        name, key, parameter, whole = self.as_effect
        inertia: EffectValue = getattr(self, key)
        own = inertia.parameter()
        if whole is not None:
            own = _divided(inertia, EffectValue(value=values[whole]))
        stiffness, damping = self.stiffness_nm_per_rad, self.damping_nm_s_per_rad
        oscillating = inertia.value
        if whole is not None:
            # A share of one or more is refused with the other values out of range.
            oscillating *= max(1.0 - own.value, 1e-3)
        critical, sd = 2.0 * math.sqrt(stiffness.value * oscillating), damping.parameter().sd
        ratio = EffectParameterValue(damping.value / critical, sd and sd / critical)
        compliance = _divided(EffectValue(value=1.0), stiffness)
        spring = {"compliance_rad_per_nm": compliance, "damping_ratio": ratio}
        more = {key: getattr(self, key).parameter() for key in self.further}
        return BenchEffect(name, {**spring, parameter: own, **more})


def _divided(above: EffectValue, below: EffectValue) -> EffectParameterValue:
    """Ratio of two values; its relative variance is the sum of theirs."""
    ratio = above.value / below.value
    relative = [(item.parameter().sd or 0.0) / item.value for item in (above, below)]
    sd = abs(ratio) * math.hypot(*relative)
    return EffectParameterValue(ratio, sd or None)


def _no_play(entry: EffectValue) -> EffectValue:
    if entry.value != 0.0:
        refuse(
            "Play of the belt itself is not simulated.",
            found=f"{entry.value:g}",
            expected="0: a joint with a second play is withheld, not measured",
        )
    return entry


class BeltSection(_Spring):
    """``[belt]``: a belt or elastic coupling between motor and gear; values at the motor.

    ``reducer_inertia_kg_m2`` is the part behind the belt of ``motor_inertia_kg_m2`` under
    ``[parameters]``, the whole inertia on the motor's side of the gear.
    """

    as_effect = ("belt", "reducer_inertia_kg_m2", "reducer_share", "motor_inertia_kg_m2")

    reducer_inertia_kg_m2: AboveZero
    play_rad: Annotated[EffectValue, AfterValidator(_no_play)] = EffectValue(value=0.0)


class ArmSection(_Spring):
    """``[arm]``: an elastic arm or payload behind the load; values at the load.

    ``inertia_kg_m2`` and ``gravity_share`` are the parts behind the spring of the whole load's
    ``load_inertia_kg_m2`` and ``gravity_torque_nm`` under ``[parameters]``.
    """

    as_effect = ("arm", "inertia_kg_m2", "inertia_share", "load_inertia_kg_m2")
    further = ("gravity_share",)

    inertia_kg_m2: AboveZero
    gravity_share: EffectValue = EffectValue(value=0.5)


class BaseSection(_Spring):
    """``[base]``: a base that yields under the joint; values about the joint's axis."""

    as_effect = ("base", "inertia_kg_m2", "inertia_kg_m2", None)

    inertia_kg_m2: AboveZero


class GapSection(Section):
    """``[gap]``: how the gap varies with the load's angle, as shares of its mean.

    The gap is δ (1 + Σ_k cosine[k] cos kθ_l + sine[k] sin kθ_l), with at most two harmonics.
    """

    cosine: Items[EffectValue] = ()
    sine: Items[EffectValue] = ()

    def require_sound(self) -> None:
        for name, entries in self:
            if len(entries) > 2:
                refuse(
                    "A gap varies by two harmonics of the load's angle at most.",
                    found=f"{len(entries)} of {name}",
                    expected="one or two",
                )

    def effect(self) -> BenchEffect:
        """The bench's effect."""
        parts = {
            f"{name}_{k}": entry.parameter()
            for name, entries in self
            for k, entry in enumerate(entries, start=1)
        }
        return BenchEffect("gap_variation", parts)


class EffectEntry(Section):
    """An effect that the joint has (``bayesbl effects`` lists all).

    A digital drive has ``sampled_control``, with the period of its speed controller:
    ``parameters = {period_s = {value = 250e-6}}``. Its torque acts ``delay_periods`` after it reads
    the encoder: 1, or 17 with a further dead time of 4 ms. Its speed is the difference of the
    encoder over a period, or with ``instant_share = 1`` the speed at the sampling instant. If you
    state no delay, the direct route and ``identify`` fit both, starting from 1 and a difference.
    """

    name: Annotated[str, AfterValidator(effect_name)]
    parameters: dict[str, EffectValue]

    def require_sound(self) -> None:
        with _refusing():
            effect_named(self.name).complete(dict.fromkeys(self.parameters, 0.0))


class _LearnedSection(Section):
    """A learned term; what the term itself refuses is refused here."""

    def require_sound(self) -> None:
        with _refusing():
            self.learned()

    def learned(self) -> LearnedTerm:
        """The bench's learned term."""
        return LearnedTerm(**dict(self))


class LearnedTorqueSection(_LearnedSection):
    """``[learned_torque]``: a repeating torque that no effect explains.

    It acts against the motor or the load, in N m there: constant_nm + Σ_k cosine_nm[k]
    cos(2π k x/period) + sine_nm[k] sin(2π k x/period), with the variable x; if it ``reverses``,
    times the sign of the motor's speed. ``period`` is in rad, rad/s or s. ``sd_nm``: standard
    deviations of constant, cosines and sines.
    """

    side: Side
    variable: Variable
    period: float = Field(gt=0.0)
    constant: float = Field(default=0.0, alias="constant_nm")
    cosine: Items[float] = Field(alias="cosine_nm")
    sine: Items[float] = Field(alias="sine_nm")
    reverses: bool = False
    sd: Items[float] = Field(default=(), alias="sd_nm")


class EncoderErrorSection(_LearnedSection):
    """``[encoder_error]``: the angle that the motor's encoder shows, minus the true one.

    With the motor's angle θ, in rad and inside the speed loop: Σ_k cosine_rad[k] cos(2π k
    θ/period_rad) + sine_rad[k] sin(2π k θ/period_rad). ``sd_rad``: standard deviations of cosines
    and sines.
    """

    period: float = Field(gt=0.0, alias="period_rad")
    cosine: Items[float] = Field(alias="cosine_rad")
    sine: Items[float] = Field(alias="sine_rad")
    sd: Items[float] = Field(default=(), alias="sd_rad")

    def learned(self) -> LearnedTerm:
        """The bench's learned term."""
        return LearnedTerm(side=ENCODER, variable="motor_angle", constant=0.0, **dict(self))


class BenchFile(Section):
    """``kind = "bench"``."""

    schema_version: Literal[1] = Field(alias="schema")
    kind: Literal["bench"]
    drive: Literal["two_mass", "rigid"] = "two_mass"
    gap_form: Literal["arctan", "dead_zone"] = "arctan"
    parameters: dict[Annotated[str, AfterValidator(bench_parameter)], ParameterEntry]
    measurement: MeasurementSection = MeasurementSection()
    effects: Items[EffectEntry] = ()
    belt: BeltSection | None = None
    arm: ArmSection | None = None
    base: BaseSection | None = None
    gap: GapSection | None = None
    learned_torque: LearnedTorqueSection | None = None
    encoder_error: EncoderErrorSection | None = None

    @field_validator("parameters")
    @classmethod
    def _units(cls, parameters: dict[str, ParameterEntry]) -> dict[str, ParameterEntry]:
        for name, entry in parameters.items():
            if entry.unit is not None and spelled(entry.unit) not in (known := accepted(name)):
                refuse(
                    f"The unit of {name} is not known.",
                    found=f'"{entry.unit}"',
                    expected=" or ".join(f'"{unit}"' for unit in known),
                    at=(name, "unit"),
                )
        return parameters

    def require_sound(self) -> None:
        tables = ("belt", self.belt), ("arm", self.arm), ("base", self.base)
        others = ("gap_variation", self.gap), (AVERAGING.name, self.measurement.speed_filter_s)
        stated = [effect.name for effect in self.effects]
        stated += [name for name, table in (*tables, *others) if table]
        require_different(
            stated,
            "An effect is stated twice, under [[effects]], in a table of its own or as "
            "speed_filter_s.",
        )

    def _effects(self, values: Mapping[str, float]) -> Iterator[BenchEffect]:
        """The bench's effects; ``values`` are the bench's parameters."""
        for effect in self.effects:
            yield BenchEffect(effect.name, {k: v.parameter() for k, v in effect.parameters.items()})
        for spring in (self.belt, self.arm, self.base):
            if spring is not None:
                yield spring.effect(values)
        if self.gap is not None:
            yield self.gap.effect()
        if self.measurement.speed_filter_s > 0.0:
            time = EffectParameterValue(self.measurement.speed_filter_s)
            yield BenchEffect(AVERAGING.name, {"time_s": time})

    def _values(self) -> dict[str, float]:
        """Every value given, in the bench's own unit."""
        units = {
            name: spelled(entry.unit)
            for name, entry in self.parameters.items()
            if entry.unit is not None and name in CONVERSIONS
        }
        printed = {name: entry.value for name, entry in self.parameters.items()}
        values = {name: value for name, value in printed.items() if name not in units}
        try:
            for name in filter(units.__contains__, CONVERSIONS):  # in the order of their needs
                values[name] = CONVERSIONS[name][units[name]](printed[name], values)
            return values
        except KeyError as missing:
            raise BenchError(
                "A unit is converted with another parameter, which is missing.",
                where=str(missing.args[0]),
                found=", ".join(f'{name} in "{unit}"' for name, unit in units.items()),
                expected=f"a value of {missing.args[0]}",
            ) from None
        except ZeroDivisionError:
            name = next(name for name in units if printed[name] == 0.0)
            raise BenchError(
                "Zero cannot be converted from this unit.",
                where=name,
                found=f'0 in "{units[name]}"',
                expected="a number above zero",
            ) from None

    def bench(self) -> Bench:
        """The bench. Raises BenchError if its parameters make no physical sense together."""
        values = self._values()
        given = {name: entry.parameter(values[name]) for name, entry in self.parameters.items()}
        idle = {
            name: BenchParameter(info.idle)
            for name, info in PARAMETER_INFO.items()
            if self.drive == "rigid" and info.idle is not None and name not in given
        }
        bench = Bench(
            given | idle,
            gap_form=self.gap_form,
            drive=self.drive,
            measurement=self.measurement.measurement(),
            effects=tuple(self._effects(values)),
            assumed=frozenset(idle),
            learned_torque=None if self.learned_torque is None else self.learned_torque.learned(),
            encoder_error=None if self.encoder_error is None else self.encoder_error.learned(),
        )
        if self.drive == "two_mass" and "gravity_torque_nm" not in given:
            raise BenchError(
                "A bench with a gap needs gravity, which moves the load from flank to flank.",
                where="gravity_torque_nm",
                expected="its largest torque; 0 for a vertical axis",
            )
        return bench


@checked
def load_bench(path: File) -> Bench:
    """The bench of a bench file.

    Raises
    ------
    ConfigError
        Naming file and field: no such file, not TOML, unknown keys or effects, values out of
        range, parameters that make no physical sense.
    """
    return _bench_of(load_file(Path(path), BenchFile), path)


def parse_bench(text: str, path: str | Path) -> Bench:
    """The bench of a bench file's text in a result; ``path`` is named by a ConfigError."""
    try:
        return _bench_of(BenchFile.model_validate(tomllib.loads(text)), path)
    except ValueError as error:
        raise ConfigError("The bench in this result is damaged.", file=path) from error


def _bench_of(loaded: BenchFile, path: str | Path) -> Bench:
    try:
        return loaded.bench()
    except BenchError as error:
        raise error.at(ConfigError, "[parameters] ", path) from None


def reference_bench() -> Bench:
    """The bench of the package, whose A(δ) follows the paper's eq. 4."""
    with resources.as_file(resources.files("bayesbl.bench") / REFERENCE_BENCH) as path:
        return load_bench(path)


def dump_bench(bench: Bench) -> str:
    """The bench as a bench file, which loads back to an equal one."""
    measurement = bench.measurement
    tables: dict[str, Any] = {
        "schema": 1,
        "kind": "bench",
        "drive": bench.drive,
        "gap_form": bench.gap_form,
        "parameters": {
            name: {"value": item.value} | ({"tolerance": item.tolerance} if item.tolerance else {})
            for name, item in bench.parameters.items()
            if name not in bench.assumed
        },
        "measurement": {
            "speed_source": measurement.speed_source,
            "speed_noise": _noise_table(measurement.speed_noise, "sd_rpm"),
            "current_noise": _noise_table(measurement.current_noise, "sd_a"),
            "noise_through_controller": measurement.noise_through_controller,
        },
        "effects": [
            {
                "name": effect.name,
                "parameters": {
                    name: {"value": item.value} | ({} if item.sd is None else {"sd": item.sd})
                    for name, item in effect.parameters.items()
                },
            }
            for effect in bench.effects
        ],
    }
    if measurement.encoder_counts is not None:
        tables["measurement"]["encoder_counts"] = measurement.encoder_counts
    for learned in bench.learned_terms:
        section = EncoderErrorSection if learned.is_of_encoder else LearnedTorqueSection
        stated = {key: getattr(learned, key) for key in section.model_fields}
        tables[learned.block] = section.model_construct(**stated).model_dump(by_alias=True)
    return tomli_w.dumps(tables)


def _noise_table(noise: NoiseModel, sd_name: str) -> dict[str, Any]:
    table = {"kind": kind_of(noise), sd_name: noise.standard_deviation}
    if noise.coefficients:
        table["coefficients"] = list(noise.coefficients)
    if noise.degrees_of_freedom is not None:
        table["degrees_of_freedom"] = noise.degrees_of_freedom
    return table
