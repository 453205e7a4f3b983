"""What a view hands over to be inferred: pieces of recordings, and an affine model of them.

Around its fit a view is affine: base + nuisances u + candidates a + discrepancy h. It knows nothing
of probabilities; what :mod:`bayesbl.diagnosis.inference` makes of it knows nothing of motion.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from scipy.optimize import lsq_linear

from bayesbl.bench.effect_declaration import RigidLaw
from bayesbl.bench.learned import LearnedTerm, Variable
from bayesbl.diagnosis.disagreement import Use
from bayesbl.recording.types import BoolArray, FloatArray

DEPENDENT = 1e-8
"""Share of its own length that a column must have apart from the others, to be fitted."""


@dataclass(frozen=True, slots=True)
class Piece:
    """A recording, or a part of one, as it is compared.

    Attributes
    ----------
    name, channel
        Of the recording, and of what is compared.
    use
        ``used``: effects are fitted on it. ``held_out``: only start, phases and offsets are.
    time_s, measured
        Shape (n,), evenly spaced; the channel's unit.
    excluded
        Shape (n,): samples that were lost or cannot be trusted, ``None`` where there are none.
    shown
        Whether the answer tells its disagreement: not of what the comparison could not explain.
    white
        Autocovariance of white noise behind the filter that both sides passed, lags of 0, 1, …
        samples; ``None`` where they passed none.
    """

    name: str
    channel: str
    use: Use
    time_s: FloatArray
    measured: FloatArray
    excluded: BoolArray | None = None
    shown: bool = True
    white: FloatArray | None = None

    def kept(self, values: FloatArray) -> FloatArray:
        """Values of the samples that count, (n, …) to (k, …)."""
        return values if self.excluded is None else values[~self.excluded]

    def part(self, rows: slice, use: Use) -> Piece:
        """Some samples of it, with a use of their own."""
        excluded = None if self.excluded is None else self.excluded[rows]
        time_s, measured = self.time_s[rows], self.measured[rows]
        return replace(self, time_s=time_s, measured=measured, excluded=excluded, use=use)

    @property
    def period_s(self) -> float:
        """Sampling period, s."""
        return float(self.time_s[-1] - self.time_s[0]) / (self.time_s.size - 1)


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """One shape of a candidate.

    ``shapes``: parameters that are not linear, by name. ``columns``: for every piece, change of the
    prediction by one unit of each linear parameter, (n, k). ``weight``: share of its prior.
    ``size``: that its parameter usually has, in its unit, where that is known whatever is compared.
    """

    shapes: Mapping[str, float]
    columns: tuple[FloatArray, ...]
    weight: float = 1.0
    size: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """A hypothesis as a view sees it.

    Attributes
    ----------
    label
        Unique; an effect's name, a bench parameter's, or a line's.
    kind
        ``effect`` of the catalogue, ``parameter`` of the bench that is wrong, ``line`` in time, or
        ``gravity`` of which the bench states none.
    name
        Of the effect or the parameter.
    parameters
        Names of the linear ones; of a wave its amplitude alone, as its columns are sine and cosine.
    usual
        Share that it usually has in the root mean square of what is compared.
    not_negative
        The amplitude has a sign.
    own_phase
        A wave with a sine and a cosine for every recording; with one for all where ``False``.
    """

    label: str
    kind: Literal["effect", "parameter", "line", "gravity"]
    name: str
    parameters: tuple[str, ...]
    looks: tuple[Look, ...]
    usual: float
    not_negative: bool = False
    is_wave: bool = False
    own_phase: bool = False
    excludes: frozenset[str] = frozenset()
    requires: frozenset[str] = frozenset()
    same_as: tuple[str, ...] = ()

    @property
    def holds_another(self) -> bool:
        """Whether it is one law and a departure from it: two hypotheses in one."""
        return self.kind == "effect" and bool(self.excludes)


def candidate_of(
    law: RigidLaw, name: str, parameters: tuple[str, ...], looks: tuple[Look, ...], **other: Any
) -> Candidate:
    """The effect of this name, by its law; ``other``: fields that are not as that says."""
    by_law = Candidate(
        name,
        "effect",
        name,
        parameters,
        looks,
        law.usual,
        law.not_negative,
        excludes=frozenset({law.contains} if law.contains else ()),
        requires=frozenset({law.requires} if law.requires else ()),
        same_as=law.same_as,
    )
    return replace(by_law, **other)


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A torque over a variable, its amplitudes falling as 1/k.

    Attributes
    ----------
    means
        Of the cosines and sines over what was recorded, which are taken off, (2 orders,): the mean
        is an effect's.
    reach
        Of the variable, as recorded.
    """

    variable: Variable
    period: float
    reverses: bool
    orders: int
    means: FloatArray
    reach: tuple[float, float]

    @classmethod
    def over(
        cls,
        variable: Variable,
        period: float,
        *,
        reverses: bool,
        orders: int,
        reach: tuple[float, float],
    ) -> Series:
        """With the means over this reach of its variable."""
        made = cls(variable, period, reverses, orders, np.zeros(2 * orders), reach)
        x = np.linspace(reach[0], min(reach[1], reach[0] + period), 1000)
        return replace(made, means=made.waves(x).mean(axis=0))

    @property
    def kind(self) -> str:
        """What it is a torque over."""
        return f"motor_torque_over_{self.variable}{'_reversing' if self.reverses else ''}"

    def waves(self, x: FloatArray) -> FloatArray:
        """Cosines, then sines, less their means, (n, 2 orders)."""
        k = np.arange(1, self.orders + 1)
        phase = 2.0 * math.pi * x[:, None] * k / self.period
        return np.hstack([np.cos(phase) / k, np.sin(phase) / k]) - self.means

    def torque(self, coefficients: FloatArray, sds: FloatArray | None = None) -> LearnedTerm:
        """With coefficients of the waves, (2 orders,), and their standard deviations."""
        decay = np.tile(1.0 / np.arange(1, self.orders + 1), 2)
        waves = coefficients * decay
        sd: tuple[float, ...] = ()
        if sds is not None:
            constant = math.sqrt(float((sds * self.means) @ (sds * self.means)))
            sd = (constant, *(sds * decay).tolist())
        return LearnedTerm(
            "motor",
            self.variable,
            self.period,
            -float(coefficients @ self.means),
            tuple(waves[: self.orders].tolist()),
            tuple(waves[self.orders :].tolist()),
            self.reverses,
            sd,
        )


@dataclass(frozen=True, slots=True, eq=False)
class Discrepancy:
    """Columns of what nothing explains, for every piece (n, m), each times its prior's amplitude;
    of no recording but its own where ``own``; ``series``: the torque that they are, if any."""

    kind: str
    columns: tuple[FloatArray, ...]
    own: bool = False
    series: Series | None = None


@dataclass(frozen=True, eq=False)
class AffineModel:
    """A view around a fit; tuples have an entry for every piece, in the channel's unit.

    ``nuisances``: columns that are fitted anyway, by name; what belongs to a recording has its name
    behind ``@``. ``nuisance_sds``: of those of which something is known beforehand, around what
    the base has. ``without``: predictions of a fit without any effect, (n,), where the base and the
    nuisances alone are none.
    """

    pieces: tuple[Piece, ...]
    base: tuple[FloatArray, ...]
    nuisances: tuple[Mapping[str, FloatArray], ...]
    candidates: tuple[Candidate, ...]
    discrepancies: tuple[Discrepancy, ...] = ()
    nuisance_sds: Mapping[str, float] = field(default_factory=dict)
    without: tuple[FloatArray, ...] = ()

    @property
    def used(self) -> list[int]:
        """Pieces that are fitted."""
        return [i for i, piece in enumerate(self.pieces) if piece.use == "used"]

    @property
    def recordings(self) -> tuple[str, ...]:
        """Names of those that are fitted."""
        return tuple(dict.fromkeys(self.pieces[i].name for i in self.used))

    @property
    def shown(self) -> list[int]:
        """Of these, those whose disagreement is told."""
        return [i for i in self.used if self.pieces[i].shown]

    @cached_property
    def nuisance_names(self) -> tuple[str, ...]:
        """Of the used pieces."""
        return tuple(dict.fromkeys(name for i in self.used for name in self.nuisances[i]))

    def nuisance_columns(self, i: int) -> FloatArray:
        """Those of a piece, zero where it has none, (n, d)."""
        columns = np.zeros((self.pieces[i].measured.size, len(self.nuisance_names)))
        for k, name in enumerate(self.nuisance_names):
            if name in self.nuisances[i]:
                columns[:, k] = self.nuisances[i][name]
        return columns

    @cached_property
    def by_nuisances(self) -> FloatArray:
        """Nuisances that fit the shown pieces best beside nothing else, (d,)."""
        columns = self.rows(self.nuisance_columns, self.shown)
        return least_squares(columns, self.rows(self.beside_base, self.shown))

    def rows(self, of: Callable[[int], FloatArray], places: Sequence[int]) -> FloatArray:
        """What there is of these pieces, (n, …) each, at the samples that count, in one array."""
        return np.concatenate([self.pieces[i].kept(of(i)) for i in places])

    def beside_base(self, i: int) -> FloatArray:
        """What was measured of a piece less the base, (n,)."""
        return np.asarray(self.pieces[i].measured - self.base[i])

    def at(self, i: int, nuisances: FloatArray) -> FloatArray:
        """Prediction of a piece with these nuisances, (d,), and nothing else, (n,)."""
        return np.asarray(self.base[i] + self.nuisance_columns(i) @ nuisances)

    def candidate_columns(self, candidate: Candidate, look: Look, i: int) -> FloatArray:
        """Those of a piece, with a pair for every used recording where phases are their own."""
        columns = look.columns[i]
        if not candidate.own_phase:
            return columns
        spread = np.zeros((columns.shape[0], 2 * len(self.recordings)))
        if self.pieces[i].name in self.recordings:
            at = 2 * self.recordings.index(self.pieces[i].name)
            spread[:, at : at + 2] = columns
        return spread


def least_squares(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """x of the least ‖target − matrix x‖, shape (p,), with columns of any unit, (n, p)."""
    scale = np.sqrt((matrix**2).sum(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    return np.asarray(np.linalg.lstsq(matrix / scale, target, rcond=DEPENDENT)[0] / scale)


def bounded_least_squares(matrix: FloatArray, target: FloatArray, low: FloatArray) -> FloatArray:
    """The same with every x at least as large as ``low``, (p,): zero, or minus infinity."""
    scale = np.sqrt((matrix**2).sum(axis=0))
    scale = np.where(scale > 0.0, scale, 1.0)
    free = least_squares(matrix, target)
    if np.all(free >= low):
        return free
    whole = np.column_stack([matrix / scale, target])
    root = np.asarray(np.linalg.qr(whole, mode="r"), dtype=float)
    return np.asarray(lsq_linear(root[:, :-1], root[:, -1], (low, np.inf)).x / scale)
