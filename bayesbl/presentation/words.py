"""Numbers, probabilities and intervals in words.

Angles are in mrad. Probabilities are never certain, because finitely many draws cannot show that.
"""

from __future__ import annotations

import math
import re
from pathlib import PureWindowsPath
from typing import TYPE_CHECKING

from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.measurement.summary_types import RouteSummary
    from bayesbl.results.store import Interval

RAREST = 1e-3  # thousands of draws cannot show probabilities closer to 0 or 1
SURE = 0.95  # probability from which something is shown; below 1 minus this, its opposite

_WORDS = {
    "amplitude": "the ringing",
    "direct": "simulation",
    "torque_ramp": "torque ramps",
    "two_encoders": "two encoders",
    "noise": "noise of the recording",
    "start_angle": "start angle",
    "rounding": "rounding of the curve's coefficients",
    "regression": "coefficients of the curve",
    "lack_of_fit": "lack of fit of the curve",
    "laws_and_drift": "laws that the bench may lack, and drift between snapshots",
    "bench": "tolerances of the bench",
    "known_gap": "the known gap that scales the curve",
    "repeated_ramps": "scatter of repeated ramps",
    "held_windup": "wind-up that friction holds",
    "positions_round_the_turn": "positions around the turn",
}


def probability(value: float) -> str:
    """``78 %``, ``2.3 %``, ``> 99.9 %``; never 0 % or 100 %."""
    if value < RAREST:
        return f"< {100.0 * RAREST:g} %"
    if value > 1.0 - RAREST:
        return f"> {100.0 * (1.0 - RAREST):g} %"
    return f"{100.0 * value:.0f} %" if 0.1 <= value <= 0.9 else f"{100.0 * value:.1f} %"


def decimals(interval: Interval, scale: float = 1.0, units: float = 5.0) -> int:
    """Fewest decimals at which the interval is at least ``units`` of the last one wide."""
    width = abs(scale * (interval["high"] - interval["low"]))
    return max(0, math.ceil(math.log10(units / width))) if width > 0.0 else 3


def bounds(interval: Interval, scale: float = 1.0, places: int | None = None) -> str:
    """``0.685 to 0.731``."""
    shown = decimals(interval, scale) if places is None else places
    low, high = sorted((scale * interval["low"], scale * interval["high"]))
    return f"{number(low, shown)} to {number(high, shown)}"


def interval_kind(interval: Interval) -> str:
    """``90 % interval``, or ``90 % HDI`` for the highest density."""
    kind = "HDI" if interval["kind"] == "hdi" else "interval"
    return f"{100.0 * interval['level']:g} % {kind}"


def middle(interval: Interval, scale: float = 1.0) -> str:
    """The median, with as many digits as the interval justifies."""
    return number(scale * interval["median"], decimals(interval, scale))


def with_bounds(interval: Interval, unit: str, scale: float = 1.0) -> str:
    """``12.1 rpm (90 % interval 11.9 to 12.3 rpm)``."""
    ends = f"{interval_kind(interval)} {bounds(interval, scale)}"
    return f"{middle(interval, scale)} {unit} ({ends} {unit})"


def with_ends(interval: Interval, digits: int = 2) -> str:
    """``0.0052 (0.00054 to 0.020)``: so many digits each, for values near zero."""
    low, middle, high = (significant(interval[key], digits) for key in ("low", "median", "high"))
    return f"{middle} ({low} to {high})"


def in_mrad(interval: Interval) -> str:
    """``0.25 mrad (90 % interval 0.21 to 0.28 mrad)`` for an interval in rad."""
    return with_bounds(interval, "mrad", 1e3)


def change_of(what: str, change: Interval, unit: str, scale: float) -> str:
    """Whether a quantity grew, shrank, or may have done neither, and by how much."""
    if change["low"] > 0.0:
        return f"{what} grew by {with_bounds(change, unit, scale)}"
    if change["high"] < 0.0:
        return f"{what} shrank by {with_bounds(change, unit, -scale)}"
    return f"{what} may not have changed: the change is {with_bounds(change, unit, scale)}"


def gap_cells(gap: Interval | None, upper_rad: float | None = None) -> tuple[str, str]:
    """A gap and its bounds in mrad, or its upper bound, as table cells."""
    if upper_rad is not None:
        return f"below {significant(1e3 * upper_rad)}", "95 %"
    if gap is None:
        return "withheld", "withheld"
    return middle(gap, 1e3), bounds(gap, 1e3)


def of(*names: str) -> str:
    """`` of "NAME"``; empty for the only snapshot of a fit."""
    quoted = ", ".join(f'"{name}"' for name in names)
    return f" of {quoted}" if any(names) else ""


def capitalised(sentence: str) -> str:
    """The sentence with a capital first letter."""
    return sentence[0].upper() + sentence[1:]


def significant(value: float, digits: int = 2) -> str:
    """``0.15``, ``32``, ``0.0007``: significant digits, never powers of ten."""
    rounded = float(f"{value:.{digits - 1}e}")
    if rounded == 0.0:
        return "0"
    return number(value, max(0, digits - 1 - math.floor(math.log10(abs(rounded)))))


def percent(value: float) -> str:
    """A share with two significant digits, ``0.15 %``."""
    return f"{significant(100.0 * value)} %"


def in_words(name: str) -> str:
    """A route, or a source of an interval's width, in words."""
    return _WORDS.get(name, name.replace("_", " "))


def curve_name(curve: str) -> str:
    """Name of a gap curve: ``published``, or the folder of its sweep."""
    path = PureWindowsPath(curve)  # which takes both slashes
    return path.parent.name if path.name == "result.nc" and path.parent.name else path.name


def sampling(part: RouteSummary) -> str:
    """Convergence of the sampling in one line."""
    diagnostics = part["diagnostics"]
    return (
        f"{diagnostics['outcome']}, largest R̂ {diagnostics['r_hat']:.3f}, "
        f"smallest effective sample size {diagnostics['ess_bulk']:.0f}"
    )


def glued(sentence: str) -> str:
    """The sentence with no-break spaces between a number and its sign or unit."""
    before_unit = r"(?<=\d) (?=%|mrad|rpm|rad|(?:A|Hz|m|mm|ms|s)\b|N m|kg m)"
    within = r"(?<=[<>]) (?=\d)|(?<=\d N) (?=m)|(?<=\d kg) (?=m)"
    return re.sub(f"{before_unit}|{within}", "\N{NO-BREAK SPACE}", sentence)


def limit(delta_rad: float, text: str | None) -> str:
    """A limit of δ, and as it was stated: ``1.16 mrad (8 arcmin of play)``."""
    in_mrad = f"{1e3 * delta_rad:.4g} mrad"
    if text is None or text.endswith("mrad delta"):
        return in_mrad
    value, unit, rest = text.split(" ", 2)
    return f"{in_mrad} ({value} {unit} of {rest.replace('_', ' ').replace('delta', 'δ')})"
