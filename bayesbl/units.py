"""Units at the edges: recordings may come in rpm, degrees or milliseconds.

Each quantity that a recording may hold has one unit inside the package, named at the end of its
channel name; :func:`conversion_factor` converts from the other accepted units.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Literal, get_args

RPM_PER_RAD_PER_S = 60.0 / (2.0 * math.pi)
"""Revolutions per minute in one radian per second."""

# dimension -> unit -> factor to the first unit of that dimension
_FACTORS: dict[str, dict[str, float]] = {
    # "datenum" is MATLAB's count of days; "datetime" are dates, which readers turn into s.
    "time": {
        "s": 1.0,
        "ms": 1e-3,
        "us": 1e-6,
        "ns": 1e-9,
        "min": 60.0,
        "datenum": 86400.0,
        "datetime": 1.0,
    },
    "speed": {
        "rpm": 1.0,
        "rad/s": RPM_PER_RAD_PER_S,
        "deg/s": 1.0 / 6.0,
        "rev/s": 60.0,
        "Hz": 60.0,
        "krpm": 1e3,
        "mrad/s": 1e-3 * RPM_PER_RAD_PER_S,
        "rad/min": 0.5 / math.pi,
    },
    "angle": {
        "rad": 1.0,
        "deg": math.pi / 180.0,
        "rev": 2.0 * math.pi,
        "mrad": 1e-3,
        "arcmin": math.pi / 10800.0,
        "arcsec": math.pi / 648000.0,
    },
    "current": {"A": 1.0, "mA": 1e-3},
    "torque": {"N m": 1.0, "Nm": 1.0, "mN m": 1e-3, "mNm": 1e-3},
}

_OTHER_SPELLINGS = {
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "milliseconds": "ms",
    "microseconds": "us",
    "µs": "us",
    "μs": "us",
    "nanoseconds": "ns",
    "minutes": "min",
    "rpm": "rpm",
    "r/min": "rpm",
    "1/min": "rpm",
    "u/min": "rpm",
    "min-1": "rpm",
    "min^-1": "rpm",
    "rev/min": "rpm",
    "kr/min": "krpm",
    "rad s-1": "rad/s",
    "rad/sec": "rad/s",
    "radian/s": "rad/s",
    "radians/s": "rad/s",
    "radps": "rad/s",
    "deg s-1": "deg/s",
    "deg/sec": "deg/s",
    "degree/s": "deg/s",
    "degrees/s": "deg/s",
    "degps": "deg/s",
    "dps": "deg/s",
    "rev/sec": "rev/s",
    "rps": "rev/s",
    "turn": "rev",
    "turns": "rev",
    "revs": "rev",
    "revolutions": "rev",
    "rotations": "rev",
    "turn/s": "rev/s",
    "turns/s": "rev/s",
    "revs/s": "rev/s",
    "revolutions/s": "rev/s",
    "arcminutes": "arcmin",
    "'": "arcmin",
    "′": "arcmin",
    "arcseconds": "arcsec",
    "″": "arcsec",
    "hertz": "Hz",
    "radian": "rad",
    "radians": "rad",
    "degree": "deg",
    "degrees": "deg",
    "aeff": "A",
    "arms": "A",
    "a rms": "A",
    "ampere": "A",
    "amperes": "A",
    "newton meter": "N m",
    "n*m": "N m",
    "n.m": "N m",
}

_DIMENSION_OF_SUFFIX = {
    "_s": "time",
    "_rpm": "speed",
    "_rad": "angle",
    "_a": "current",
    "_nm": "torque",
}


_UNIT_OF_ENDING = {
    "_nm_s2_per_rad2": "N m s²/rad²",
    "_nm_s_per_rad": "N m s/rad",
    "_nm_per_rad3": "N m/rad³",
    "_nm_per_rad": "N m/rad",
    "_nm_per_a": "N m/A",
    "_nm_per_s": "N m/s",
    "_kg_m2": "kg m²",
    "_rad_per_nm": "rad/(N m)",
    "_rad_per_s": "rad/s",
    "_s_per_rad": "s/rad",
    "_per_s": "1/s",
    "_per_rad": "1/rad",
    "_rpm": "rpm",
    "_rad": "rad",
    "_nm": "N m",
    "_a": "A",
    "_s": "s",
}
"""Longest endings first: the first match wins."""


def quantity_and_unit(parameter: str) -> tuple[str, str]:
    """A parameter's name in words and its unit: ``friction torque``, ``N m``; or an empty unit."""
    for ending, unit in _UNIT_OF_ENDING.items():
        if parameter.endswith(ending):
            return parameter.removesuffix(ending).replace("_", " "), unit
    return parameter.replace("_", " "), ""


def in_words(name: str) -> str:
    """The name of an effect or parameter without its unit: ``motor Coulomb friction``."""
    words, _ = quantity_and_unit(name)
    return words.replace("coulomb", "Coulomb").replace("stribeck", "Stribeck")


def dimension_of(channel: str) -> str | None:
    """The dimension of a channel by its unit suffix, ``None`` if that is unknown."""
    for suffix, dimension in _DIMENSION_OF_SUFFIX.items():
        if channel.endswith(suffix):
            return dimension
    return None


def unit_of(channel: str) -> str:
    """The package's own unit of a channel, empty if its suffix is unknown."""
    units = accepted_units(channel)
    return units[0] if units else ""


def accepted_units(channel: str) -> tuple[str, ...]:
    """Units accepted for a column of this channel, the package's own first."""
    dimension = dimension_of(channel)
    return () if dimension is None else tuple(_FACTORS[dimension])


_NUMBER = r"(\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)"
_MULTIPLE = re.compile(rf"{_NUMBER} (\S.*)")
_PART = re.compile(rf"(\S.*?)/{_NUMBER}")
_SHARE = re.compile(rf"(%|‰|per ?cent|per ?mille|0\.1 ?%) of {_NUMBER} (\S.*)")
_SIZES = {"time": '"4 ms"', "angle": '"rev/4096"', "speed": '"rpm/7"'}
"""How a unit with a number is written: samples of 4 ms, counts of a turn, pairs of poles."""


def conversion_factor(channel: str, unit: str) -> float:
    """Factor that brings a value in ``unit`` to the channel's own unit.

    Beside :func:`accepted_units` a multiple (``4 ms``), a part (``rev/4096`` for counts of an
    encoder, ``rpm/7`` for electrical speed) or a share (``% of 12.5 A``, ``‰ of 2.4 N m``) of one.

    Raises
    ------
    KeyError
        If the unit is none of these.
    """
    units = _FACTORS.get(dimension_of(channel) or "", {})
    if unit in units:
        return units[unit]
    for form in (_SHARE, _MULTIPLE, _PART):
        held = form.fullmatch(unit)
        if held is None:
            continue
        *share, first, second = held.groups()
        inner, size = (first, second) if form is _PART else (second, first)
        if inner not in units or float(size) == 0.0:
            break
        if form is _PART:
            return units[inner] / float(size)
        hundredth = 0.01 if share and share[0] in ("%", "percent", "per cent") else 0.001
        return units[inner] * float(size) * (hundredth if share else 1.0)
    raise KeyError(unit)


def is_accepted(channel: str, unit: str) -> bool:
    """Whether a column of this channel may come in this unit, with or without a number in it."""
    try:
        return math.isfinite(conversion_factor(channel, unit))
    except KeyError:
        return False


def choice_of_units(channel: str) -> str:
    """The units that a column of this channel may come in, in words."""
    units = accepted_units(channel)
    if not units:
        return "no unit"
    share = f'"% of 12.5 {units[0]}"'
    sized = _SIZES.get(dimension_of(channel) or "", share)
    return f"{' or '.join(units)}, or with a number as {sized}"


def spelled(unit: str) -> str:
    """A unit as files spell it, in this package's spelling if that is known."""
    text = unit.strip().replace("·", " ").replace("⁻¹", "-1").replace("°", "deg")
    if is_unit(text):
        return text
    # Only these ignore case: "MN m" is not "mN m".
    return _OTHER_SPELLINGS.get(text.lower(), text)


def is_unit(text: str) -> bool:
    """Whether this is a unit, of any dimension, in this package's spelling."""
    return any(text in units for units in _FACTORS.values())


LimitUnit = Literal["rad", "mrad", "deg", "arcmin", "arcsec", "mm"]
LimitKind = Literal["delta", "play", "lost_motion"]

_LIMIT_UNITS: dict[str, float] = {
    "rad": 1.0,
    "mrad": 1e-3,
    "deg": math.pi / 180.0,
    "arcmin": math.pi / 10_800.0,
    "arcsec": math.pi / 648_000.0,
}

_LIMIT_SPELLINGS = {"°": "deg", "′": "arcmin", "'": "arcmin", "″": "arcsec", '"': "arcsec"}

LIMIT_EXAMPLES = (
    'VALUE UNIT KIND: "3 arcmin play", "0.2 mrad delta", "0.5 mm play at 0.4 m" or '
    '"1 arcmin lost_motion at 3 %" (of the rated torque)'
)

_LIMIT_TEXT = re.compile(
    r"\s*(?P<value>[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*(?P<unit>[^\s\d]+)"
    r"(?:\s+(?P<of>delta|δ|play|lost[ _]motion))?"
    r"(?:\s+at\s+(?P<at_m>\d+\.?\d*|\.\d+)\s*m)?"
    r"(?:\s+at\s+(?P<percent>\d+\.?\d*|\.\d+)\s*%)?\s*",
    re.IGNORECASE,
)


class LimitError(ValueError):
    """A limit that says too little or too much: what is wrong, what was found, what is expected."""

    def __init__(self, problem: str, found: str, expected: str) -> None:
        self.problem, self.found, self.expected = problem, found, expected
        super().__init__(f"{problem} Found: {found}. Expected: {expected}.")


@dataclass(frozen=True, slots=True)
class Limit:
    """A limit as a maker states it, and the gap δ that it means.

    Play is the whole angle, 2 δ. Lost motion at a share s of the rated torque T is play and what
    the stiffness K at the load gives way between +s T and −s T: 2 δ + 2 s T / K.

    Attributes
    ----------
    at_m
        Radius at which a length in mm is meant, m; only with ``unit = "mm"``.
    at_torque_share
        s, between 0 and 1; only of lost motion.

    Raises
    ------
    LimitError
        Where unit, kind, radius and share do not go together.
    """

    value: float
    unit: LimitUnit
    of: LimitKind
    at_m: float | None = None
    at_torque_share: float | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.value) and self.value > 0.0):
            raise LimitError("A limit is positive.", f"{self.value:g}", "a number above 0")
        if self.unit not in get_args(LimitUnit):
            units = ", ".join(get_args(LimitUnit))
            raise LimitError("This unit is not one of a limit.", self.unit, f"one of {units}")
        if (self.unit == "mm") != (self.at_m is not None):
            found = "no radius" if self.at_m is None else f"a radius with {self.unit}"
            raise LimitError("A limit in mm, and no other, has a radius.", found, LIMIT_EXAMPLES)
        if (self.of == "lost_motion") != (self.at_torque_share is not None):
            found = "no torque" if self.at_torque_share is None else f"a torque with {self.of}"
            raise LimitError("Lost motion, and nothing else, has a torque.", found, LIMIT_EXAMPLES)
        if self.at_m is not None and not self.at_m > 0.0:
            raise LimitError("A radius is positive.", f"{self.at_m:g} m", "a length in m above 0")
        if self.at_torque_share is not None and not 0.0 < self.at_torque_share < 1.0:
            found = f"{100.0 * self.at_torque_share:g} %"
            raise LimitError("A share of the rated torque is below it.", found, "0 to 100 %")

    @classmethod
    def parse(cls, text: str) -> Limit:
        """Of text such as ``3 arcmin play``; :data:`LIMIT_EXAMPLES`.

        Raises
        ------
        LimitError
            If it is not of that form.
        """
        parts = _LIMIT_TEXT.fullmatch(text)
        if parts is None:
            raise LimitError("This is no limit.", f'"{text}"', LIMIT_EXAMPLES)
        if parts["of"] is None:
            problem = "A limit says whether it is of δ, of play (2 δ) or of lost motion."
            raise LimitError(problem, f'"{text}"', LIMIT_EXAMPLES)
        kind = parts["of"].lower().replace(" ", "_").replace("δ", "delta")
        unit = _LIMIT_SPELLINGS.get(parts["unit"], parts["unit"])
        at_m, percent = (None if x is None else float(x) for x in parts.group("at_m", "percent"))
        share = None if percent is None else percent / 100.0
        return cls(float(parts["value"]), unit, kind, at_m, share)  # type: ignore[arg-type]

    def __str__(self) -> str:
        radius = "" if self.at_m is None else f" at {self.at_m!r} m"
        share = self.at_torque_share
        torque = "" if share is None else f" at {float(f'{100.0 * share:.12g}')!r} %"
        return f"{self.value!r} {self.unit} {self.of}{radius}{torque}".replace(".0 ", " ")

    @property
    def name(self) -> str:
        """Unit and kind, as a measured value in them is told: ``arcmin of play``."""
        _, unit, kind = str(self).split(" ", 2)
        return f"{unit} of {kind.replace('_', ' ').replace('delta', 'δ')}"

    def windup_rad(self, torque_nm: float | None, stiffness_nm_per_rad: float | None) -> float:
        """What the joint gives way at the torque of a lost motion, both ways; 0 of other limits.

        Raises
        ------
        LimitError
            Where rated torque or stiffness is missing.
        """
        if self.at_torque_share is None:
            return 0.0
        problem = "Lost motion needs the rated torque and the joint's stiffness."
        if torque_nm is None:
            raise LimitError(problem, "no rated torque", "rated_torque_nm = 50.0 under [joint]")
        if stiffness_nm_per_rad is None:
            expected = "a bench with shaft_stiffness_nm_per_rad, or a limit of play or delta"
            raise LimitError(problem, "no stiffness", expected)
        return 2.0 * self.at_torque_share * torque_nm / stiffness_nm_per_rad

    def delta_rad(self, windup_rad: float = 0.0) -> float:
        """The gap at this limit, rad.

        Raises
        ------
        LimitError
            Where the joint gives way by more than the limit without any play.
        """
        whole = self.value * self._rad
        delta = whole if self.of == "delta" else 0.5 * (whole - windup_rad)
        if delta <= 0.0:
            found = f"{self}, of which {1e3 * windup_rad:.3g} mrad are wind-up"
            problem = "This limit leaves no room for a gap."
            raise LimitError(problem, found, f"more than {windup_rad / self._rad:.3g} {self.unit}")
        return delta

    def stated(self, delta_rad: float, windup_rad: float = 0.0) -> float:
        """A gap in the unit and of the kind of this limit: the inverse of :meth:`delta_rad`."""
        return (delta_rad if self.of == "delta" else 2.0 * delta_rad + windup_rad) / self._rad

    @property
    def _rad(self) -> float:
        return _LIMIT_UNITS[self.unit] if self.at_m is None else 1e-3 / self.at_m


def number(value: float, places: int) -> str:
    """A number with a true minus sign, and no minus in front of zero."""
    text = f"{value:.{places}f}"
    if float(text) == 0.0:
        text = text.removeprefix("-")
    return text.replace("-", "−")
