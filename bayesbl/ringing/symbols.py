"""The nine symbols of the disturbance model, and which of them a fit leaves free."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from bayesbl.errors import ConfigError
from bayesbl.units import unit_of

AMPLITUDE = "amplitude_rpm"
START = "start_time_s"
DECAY = "decay_rate_per_s"
FREQUENCY = "angular_frequency_rad_per_s"
MEAN = "mean_speed_rpm"
WINDOW_START = "window_start_s"
WINDOW_END = "window_end_s"
SEPARATION = "pulse_separation_s"
ROTATION = "rotation_period_s"


@dataclass(frozen=True, slots=True)
class Symbol:
    """One symbol of the paper's eq. 6: its name here and in the paper, and its meaning."""

    name: str
    paper: str
    long_name: str

    @property
    def unit(self) -> str:
        """Unit, from the ending of the name."""
        return unit_of(self.name)


SYMBOLS: Mapping[str, Symbol] = MappingProxyType(
    {
        s.name: s
        for s in (
            Symbol(AMPLITUDE, "A", "amplitude of the impact ringing"),
            Symbol(START, "t_0", "start of the first positive pulse"),
            Symbol(DECAY, "τ", "decay rate of the ringing"),
            Symbol(FREQUENCY, "ω", "angular frequency of the ringing"),
            Symbol(MEAN, "v_t", "mean motor speed"),
            Symbol(WINDOW_START, "t_1", "start of the pulse window"),
            Symbol(WINDOW_END, "t_2", "end of the pulse window"),
            Symbol(SEPARATION, "T", "time from a negative pulse to the positive one after it"),
            Symbol(ROTATION, "T_w", "period of one load rotation"),
        )
    }
)
"""The nine symbols in the paper's order (eq. 6, Table 2)."""

LINEAR = (AMPLITUDE, MEAN)
"""Symbols in which the model is linear: solved exactly unless fixed."""

DEFAULT_FIXED: Mapping[str, float] = MappingProxyType({WINDOW_START: 0.0, WINDOW_END: 0.204})
DEFAULT_RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {DECAY: (2.0, 80.0), FREQUENCY: (2.0 * math.pi, 2.0 * math.pi * 40.0)}
)


@dataclass(frozen=True, slots=True)
class DisturbanceModel:
    """Which symbols of eq. 6 are free, and the load-angle baseline under them.

    Attributes
    ----------
    baseline_harmonics
        Harmonics k of the load angle 2π t / T_w fitted beside the pulses; 0 is the paper's model.
    fixed
        Symbol name to its fixed value. The default fixes the window of Table 2. Start and window
        start are never both free: only their sum enters the model.
    ranges
        Symbol name to (low, high), inside which a free symbol is searched and sampled.
    """

    baseline_harmonics: int = 1
    fixed: Mapping[str, float] = field(default_factory=lambda: dict(DEFAULT_FIXED))
    ranges: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if AMPLITUDE in self.fixed:
            raise ConfigError(
                "With the amplitude fixed there is nothing to measure.",
                where="[estimator.model] fixed",
                found=f"{AMPLITUDE} = {self.fixed[AMPLITUDE]}",
                expected=f"{AMPLITUDE} free",
            )

    @property
    def searched(self) -> tuple[str, ...]:
        """Free symbols that enter nonlinearly, in the paper's order."""
        return tuple(n for n in SYMBOLS if n not in self.fixed and n not in LINEAR)

    @property
    def free(self) -> tuple[str, ...]:
        """All free symbols, in the paper's order."""
        return tuple(n for n in SYMBOLS if n not in self.fixed)

    def named(self, point: Iterable[float]) -> dict[str, float]:
        """Symbols by name: the searched ones from a point, (d,), and the fixed ones."""
        return dict(zip(self.searched, map(float, point), strict=True)) | dict(self.fixed)

    @property
    def lasting_ranges(self) -> dict[str, tuple[float, float]]:
        """Ranges of the searched symbols except t0, which differs in every recording."""
        return {n: self.ranges[n] for n in self.searched if n in self.ranges and n != START}

    def holding(self, values: Mapping[str, float]) -> DisturbanceModel:
        """Fix these symbols too, and drop their ranges."""
        ranges = {name: r for name, r in self.ranges.items() if name not in values}
        return replace(self, fixed={**self.fixed, **values}, ranges=ranges)
