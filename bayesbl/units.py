"""Units at the edges: recordings may come in rpm, degrees or milliseconds.

Each quantity that a recording may hold has one unit inside the package, named at the end of its
channel name; :func:`conversion_factor` converts from the other accepted units.
"""

from __future__ import annotations

import math
import re

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


def number(value: float, places: int) -> str:
    """A number with a true minus sign, and no minus in front of zero."""
    text = f"{value:.{places}f}"
    if float(text) == 0.0:
        text = text.removeprefix("-")
    return text.replace("-", "−")
