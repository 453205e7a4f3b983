"""Axis scales that can be read: mrad for gaps, ms about a reference for times that hardly vary."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axis import Axis, XAxis
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from bayesbl.presentation.figures.snapshots import GAP
from bayesbl.recording.types import FloatArray
from bayesbl.ringing.symbols import SYMBOLS

_RELATIVE_SPREAD = 2e-3
"""Values that vary less than this are drawn as differences from a round number near them."""


def plain_log_axis(axis: Axis, steps: Sequence[float] = (1.0, 2.0, 5.0)) -> None:
    """A logarithmic axis with ``steps`` of each decade written out, never as powers of ten."""
    name = "x" if isinstance(axis, XAxis) else "y"
    axis.axes.set(**{f"{name}scale": "log"})
    axis.set_major_locator(FixedLocator([m * 10.0**k for k in range(-6, 7) for m in steps]))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


@dataclass(frozen=True, slots=True)
class Scale:
    """shown = factor · (stored − reference).

    Attributes
    ----------
    symbol
        As mathtext.
    unit
        Of the values shown.
    """

    symbol: str
    unit: str
    factor: float
    reference: float = 0.0
    reference_text: str = ""

    def shown(self, stored: FloatArray) -> FloatArray:
        """Values to draw, same shape as the stored ones."""
        return self.factor * (stored - self.reference)

    def label(self, between: str = " ") -> str:
        """``T$_w$ − 3.6 s (ms)``, the unit set apart by ``between``."""
        return f"{self.symbol}{self.reference_text}{between}({self.unit})"


def scale_of(name: str, draws: FloatArray) -> Scale:
    """The scale on which draws of a symbol, or of δ, are readable."""
    if name == GAP:
        return Scale("δ", "mrad", 1e3)
    symbol = SYMBOLS[name]
    text = _mathtext(symbol.paper)
    middle, spread = float(np.median(draws)), float(np.std(draws))
    if spread > _RELATIVE_SPREAD * abs(middle):
        return Scale(text, symbol.unit, 1.0)
    factor, unit = (1e3, "ms") if symbol.unit == "s" and spread < 0.05 else (1.0, symbol.unit)
    places = max(0, math.ceil(-math.log10(8.0 * spread))) if spread > 0.0 else 6
    reference = round(middle, places)
    sign = "−" if reference >= 0.0 else "+"
    text_of_reference = f" {sign} {abs(reference):.10g}" + (
        f" {symbol.unit}" if factor != 1.0 else ""
    )
    return Scale(text, unit, factor, reference, text_of_reference)


def time_constant(decay_rate_per_s: FloatArray) -> str:
    """``53 ms``: what a reader takes τ for, which is a rate."""
    return f"{1e3 / float(np.median(decay_rate_per_s)):.3g} ms"


def _mathtext(paper: str) -> str:
    """``T_w`` as T with a subscript."""
    letter, _, index = paper.partition("_")
    return f"{letter}$_{{{index}}}$" if index else letter
