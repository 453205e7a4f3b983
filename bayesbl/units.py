"""Units of input: recordings may come in rpm, degrees or milliseconds.

Each quantity of a recording has one unit inside the package, at the end of its channel name.
:func:`conversion_factor` converts from the other accepted units.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

RPM_PER_RAD_PER_S = 60.0 / (2.0 * math.pi)  # revolutions per minute in one radian per second
STANDARD_GRAVITY = 9.80665  # m/s², by definition (third CGPM, 1901)

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
        "Hz": 60.0,  # only as the user states it: a file's may be electrical
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

_WORDS = {
    word: (dimension, factor)
    for dimension, factor, words in (
        ("time", 1.0, "s sec secs second seconds sek sekunden"),
        ("time", 60.0, "min mins minute minutes"),
        ("time", 3600.0, "h hr hrs hour hours"),
        ("angle", 1.0, "rad rads radian radians"),
        ("angle", math.pi / 180.0, "deg degs degree degrees grad"),
        ("angle", 2.0 * math.pi, "rev revs turn turns revolution revolutions umdr"),
        ("angle", 2.0 * math.pi, "rotation rotations"),
        ("angle", math.pi / 10800.0, "arcmin arcminute arcminutes '"),
        ("angle", math.pi / 648000.0, 'arcsec arcsecond arcseconds "'),
        ("speed", 1.0, "rpm upm"),
        ("speed", 60.0, "rps"),
        ("speed", RPM_PER_RAD_PER_S, "radps"),
        ("speed", 1.0 / 6.0, "dps degps"),
        ("current", 1.0, "a amp amps ampere amperes arms aeff"),
        ("torque", 1.0, "nm"),
        ("torque", 0.01, "ncm"),
        ("torque", 0.001, "nmm"),
    )
    for word in words.split()
}
"""Units as files write them, in small letters without spaces and points."""

QUESTIONS = frozenset(
    "count counts cnt cnts inc incs increment increments tick ticks pulse pulses lsb lsbs digit "  # noqa: SIM905
    "digits step steps pu erpm percent pct permille cycles kmh kph mph mps mmps ips cdeg ddeg "
    "cps ozin inoz lbin inlb lbft ftlb kgcm kgfcm gcm hz khz hertz".split()
)
"""Words for units that are none here, or whose size only the user knows."""

OTHER_UNITS = QUESTIONS | frozenset(
    "v mv kv ka apk u r gon mm cm m ft in oz lb n kn kg kgf lbf units".split()  # noqa: SIM905
)
"""In brackets, also units of other quantities, or of unknown size."""

_PREFIXES = {
    "time": {"milli": 1e-3, "micro": 1e-6, "nano": 1e-9, "m": 1e-3, "u": 1e-6, "n": 1e-9},
    "angle": {"milli": 1e-3, "micro": 1e-6, "m": 1e-3, "u": 1e-6},
    "speed": {"k": 1e3},
    "current": {"milli": 1e-3, "micro": 1e-6, "m": 1e-3, "u": 1e-6},
    "torque": {"m": 1e-3, "c": 1e-2, "k": 1e3},
}
_TURNS_BY_MINUTE = frozenset(("1", "r", "u", "umdr", "tr", "giri", "obr"))
"""Turns, if per minute; per second, some are radians or counts."""

_TURNS_BY_SECOND = frozenset(("u", "umdr", "tr"))
_SIGNS = str.maketrans(
    {"µ": "u", "μ": "u", "°": "deg", "º": "deg", "˚": "deg", "⁻": "-", "−": "-", "¹": "1", "³": "3",
     "′": "'", "″": '"', "×": "x", "{": "", "}": "", "(": "", ")": ""}
)  # fmt: skip
_BY = re.compile(r"[\s_]+(?:per|p)[\s_]+|/")
_PAIR = re.compile(r"([a-z]+)[ _](s|sec)")
_INVERSE = re.compile(r"(?:^|[\W_])(s|sec|min)\s*[*^]*-1$")
_NUMBER_BEFORE = re.compile(
    r"x?\s*(?:10\^?(?P<power>3|-[1-9])|1/(?P<part>\d+)|(?P<plain>\d+(?:[.,]\d+)?(?:e-?\d+)?))"
    r"\s*[x*]?\s*(?P<unit>[^\d\s/].*|1/min)"
)

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
    "_rad2": "rad²",
    "_rad": "rad",
    "_nm": "N m",
    "_a": "A",
    "_s": "s",
}
"""Units by ending; the first match wins, so longer endings come first."""


def quantity_and_unit(parameter: str) -> tuple[str, str]:
    """A parameter's name in words and its unit, maybe empty: ``friction torque``, ``N m``."""
    for ending, unit in _UNIT_OF_ENDING.items():
        if parameter.endswith(ending):
            return parameter.removesuffix(ending).replace("_", " "), unit
    return parameter.replace("_", " "), ""


def in_words(name: str) -> str:
    """The name of an effect or parameter without its unit: ``motor Coulomb friction``."""
    words, _ = quantity_and_unit(name)
    return words.replace("coulomb", "Coulomb").replace("stribeck", "Stribeck")


def dimension_of(channel: str) -> str | None:
    """Dimension of a channel by the unit at the end of its name, or ``None``."""
    unit = unit_of(channel)
    return next((d for d, units in _FACTORS.items() if next(iter(units)) == unit), None)


def unit_of(channel: str) -> str:
    """The package's unit of a channel; empty for an unknown ending."""
    return quantity_and_unit(channel)[1]


def accepted_units(channel: str) -> tuple[str, ...]:
    """Units accepted for a column of this channel, the package's own first."""
    dimension = dimension_of(channel)
    return () if dimension is None else tuple(_FACTORS[dimension])


_NUMBER = r"(\d+(?:\.\d+)?(?:[eE][+-]?\d+)?)"
_MULTIPLE = re.compile(rf"{_NUMBER} (\S.*)")
_PART = re.compile(rf"(\S.*?)/{_NUMBER}")
_SHARE = re.compile(rf"(%|‰|per ?cent|per ?mille|0\.1 ?%) of {_NUMBER} (\S.*)")
_SIZES = {
    "time": '"4 ms"',
    "angle": '"rev/4096" (counts of a turn; the mm of a screw\'s turn) or "rad/400" (mm at 400 mm)',
    "torque": '"% of 12.5 N m" or "0.4 N m" (N at 0.4 m)',
    "speed": '"rpm/7" (of 7 pole pairs), "rev/s/7" (Hz) or "rev/s/4096" (4096 counts a turn)',
}
"""Units with a number: samples of 4 ms, counts per turn, pole pairs, a lever."""


def conversion_factor(channel: str, unit: str) -> float:
    """Factor from ``unit`` to the channel's own unit.

    Besides :func:`accepted_units`, the unit may be a multiple (``4 ms``), a part (``rev/4096`` for
    counts, ``rpm/7`` for electrical speed) or a share (``% of 12.5 A``, ``‰ of 2.4 N m``). Raises
    KeyError for any other unit.
    """
    return _factor(_FACTORS.get(dimension_of(channel) or "", {}), unit)


def _factor(units: Mapping[str, float], unit: str) -> float:
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
    """Whether a column of this channel may have this unit, with or without a number."""
    try:
        return math.isfinite(conversion_factor(channel, unit))
    except KeyError:
        return False


def choice_of_units(channel: str) -> str:
    """Units that a column of this channel may have, in words."""
    units = accepted_units(channel)
    if not units:
        return "no unit"
    share = f'"% of 12.5 {units[0]}"'
    sized = _SIZES.get(dimension_of(channel) or "", share)
    return f"{' or '.join(unit for unit in units if unit != 'Hz')}, or with a number as {sized}"


def spelled(unit: str) -> str:
    """A unit in this package's spelling; unchanged if it is unknown.

    ``r/min``, ``min⁻¹`` and ``revolutions per minute`` become ``rpm``; ``0.1 r/min``, ``10^3 rpm``
    and ``mdeg`` become ``0.1 rpm``, ``krpm`` and ``0.001 deg``.
    """
    text = unit.strip()
    if is_unit(text):
        return text
    plain = text.translate(_SIGNS).strip()
    if plain[:1] == "M" and not plain.isupper() and not plain.lower().startswith(("mi", "msec")):
        return text  # "MN m" is not "mN m"
    plain = plain.lower()
    held = _NUMBER_BEFORE.fullmatch(plain)
    size, rest = 1.0, plain
    if held and held["part"]:
        size, rest = 1.0 / float(held["part"]), held["unit"]
    elif held:
        power, number = held["power"], (held["plain"] or "").replace(",", ".")
        size, rest = 10.0 ** int(power) if power else float(number), held["unit"]
    quantity = _quantity(rest)
    if quantity is None or size == 0.0:
        return text
    units = _FACTORS[quantity[0]]
    multiples = [(f"{size * quantity[1] / factor:.12g}", name) for name, factor in units.items()]
    number, name = min(multiples, key=lambda pair: (pair[0] != "1", len(pair[0])))
    return name if number == "1" else f"{number} {name}"


def _quantity(text: str) -> tuple[str, float] | None:
    """Dimension and factor of a unit without a number, in small letters."""
    text = _INVERSE.sub(r"/\1", text)
    if two := _PAIR.fullmatch(text):
        text = f"{two[1]}/{two[2]}"
    over, *under = (re.sub(r"[\s_.*·⋅-]", "", part) for part in _BY.split(text))
    if not under:
        return _word(re.sub(r"(?<=a)(rms|eff)$", "", over))
    by = _word(under[0])
    if len(under) > 1 or by not in (("time", 1.0), ("time", 60.0)):
        return None
    kilo, turn = (1e3, over[1:]) if over[:1] == "k" else (1.0, over or "1")
    if turn in (_TURNS_BY_MINUTE if by[1] == 60.0 else _TURNS_BY_SECOND):
        return "speed", kilo * 60.0 / by[1]
    angle = _word(over)
    if angle is None or angle[0] != "angle":
        return None
    return "speed", angle[1] * RPM_PER_RAD_PER_S / by[1]


def _word(word: str) -> tuple[str, float] | None:
    if word in _WORDS:
        return _WORDS[word]
    for rest, (dimension, factor) in _WORDS.items():
        size = _PREFIXES[dimension].get(word.removesuffix(rest)) if word.endswith(rest) else None
        if size and not (dimension == "time" and factor != 1.0):
            return dimension, size * factor
    return None


def is_unit(text: str) -> bool:
    """Whether this is a unit of any dimension in this package's spelling."""
    for units in _FACTORS.values():
        try:
            return math.isfinite(_factor(units, text))
        except KeyError:
            continue
    return False


def plain_letters(text: str) -> str:
    """Small letters alone: ``p.u.`` and ``oz-in`` as ``pu`` and ``ozin``."""
    return re.sub(r"[\W_]", "", text.lower())


def number(value: float, places: int) -> str:
    """A number with a true minus sign, and no minus in front of zero."""
    text = f"{value:.{places}f}"
    if float(text) == 0.0:
        text = text.removeprefix("-")
    return text.replace("-", "−")
