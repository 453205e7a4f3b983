"""Result of a diagnosis by any method: verdict, named effects, disagreement.

Every method of :data:`bayesbl.runs.diagnose.METHODS` returns a :class:`Diagnosis`. Storage, summary
and figures depend on its contents, never on the method.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.stats import truncnorm

from bayesbl.bench.bench import Bench
from bayesbl.bench.learned import LearnedTerm
from bayesbl.diagnosis.disagreement import (
    ComparedPiece,
    DisagreementTableSummary,
    disagreement_table,
)
from bayesbl.matching.posterior import DirectPosterior
from bayesbl.model_search.residuals import Unexplained
from bayesbl.recording.types import FloatArray

CURVE_POINTS = 181
"""Points of a :class:`LearnedAnswer`: one for every two degrees of a turn."""

Verdict = Literal["nothing_missing", "named", "parameter_error", "unexplained"]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A fitted value.

    ``value``, ``sd``: mean and standard deviation of the value, or of its logarithm if
    ``logarithmic``. The sd of a fixed value is NaN. ``draws``: posterior draws in the value's own
    unit, of any shape; ``None`` without sampling.
    """

    value: float
    sd: float
    draws: FloatArray | None = None
    logarithmic: bool = False

    def rms_about(self, value: float) -> float:
        """Root mean square of its difference from another value.

        The standard deviation of a value that is stated although it is not the mean.
        """
        return math.hypot(self.sd, self.value - value)

    def given_positive(self) -> Estimate:
        """Mean and standard deviation of a normal variable, given that it is positive."""
        if self.sd <= 0.0:
            return self
        low = -self.value / self.sd
        mean, variance = truncnorm.stats(low, math.inf, self.value, self.sd)
        return replace(self, value=float(mean), sd=math.sqrt(variance))


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """An effect that the bench lacks.

    ``probability``: posterior probability of this effect, or of one of those that are
    indistinguishable; ``z``: size in standard deviations; ``indistinguishable_from``: other effects
    that explain the recordings as well.
    """

    name: str
    parameters: Mapping[str, Estimate]
    probability: float
    z: float
    indistinguishable_from: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ParameterError:
    """A bench parameter whose fitted value is beyond its tolerance."""

    name: str
    believed: float
    tolerance: float
    fitted: Estimate
    indistinguishable_from: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Suggestion:
    """A recording worth making.

    Attributes
    ----------
    reference_speed_rpm
        Motor speed, negative for reverse.
    payload_share
        Gravity torque and load inertia over the present ones.
    distance
        |z| between the predictions of the two most similar explanations.
    separates
        Sets of names that these recordings cannot distinguish.
    """

    reference_speed_rpm: float
    payload_share: float
    distance: float
    separates: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class LearnedAnswer:
    """A learned torque or encoder error that no effect of the catalogue explains.

    ``variable``, ``sd``: values of the variable, and the standard deviation of the term there, (n,)
    each; ``alike``: other dependences that the recordings do not distinguish from it.
    """

    term: LearnedTerm
    variable: FloatArray
    sd: FloatArray
    alike: tuple[LearnedTerm, ...] = ()

    @property
    def value(self) -> FloatArray:
        """Torque at its side in forward rotation, N m, or error, rad, (n,)."""
        return self.term.over(self.variable)

    @property
    def amplitude(self) -> float:
        """Largest absolute value in the term's unit, without the mean unless it reverses."""
        size = self.value
        return float(np.abs(size if self.term.reverses else size - size.mean()).max())


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The whole result.

    Attributes
    ----------
    remaining
        What still stands out after naming.
    pieces
        Everything that was compared.
    bench_parameters
        Fitted values of the parameters declared unknown.
    delta_before
        δ (rad) of the first fitted recording with the bench as believed; ``None`` for a rigid
        bench.
    gaps
        δ (rad) of each fitted recording with the named effects; empty for a rigid bench, or if it
        is withheld.
    gap_withheld
        Reason why no gap is given; empty otherwise.
    augmented_bench
        The bench with everything that was named and learned.
    learned
        A torque without a known law, or an error of the encoder.
    """

    verdict: Verdict
    effects: tuple[NamedEffect, ...]
    parameter_errors: tuple[ParameterError, ...]
    remaining: tuple[Unexplained, ...]
    pieces: tuple[ComparedPiece, ...]
    notes: tuple[str, ...] = ()
    bench_parameters: Mapping[str, Estimate] = field(default_factory=dict)
    delta_before: Estimate | None = None
    gaps: Mapping[str, Estimate] = field(default_factory=dict)
    gap_withheld: str = ""
    suggestion: Suggestion | None = None
    posterior: DirectPosterior | None = None
    augmented_bench: Bench | None = None
    learned: LearnedAnswer | None = None

    @property
    def delta_after(self) -> Estimate | None:
        """δ (rad) of the first recording with the named effects."""
        return next(iter(self.gaps.values()), None)

    @property
    def disagreement(self) -> DisagreementTableSummary:
        """Disagreement of all pieces."""
        return disagreement_table(self.pieces)

    @property
    def signals(self) -> tuple[ComparedPiece, ...]:
        """Pieces to store: the held-out ones of a closed loop, or all if there are none."""
        of_loop = (p for p in self.pieces if p.noise_floor_from == "rotation")
        return tuple(p for p in of_loop if p.use == "held_out") or self.pieces


def verdict_of(*, effects: bool, parameters: bool, remains: bool) -> Verdict:
    """Verdict, by whether effects are named, parameters are wrong, and something remains."""
    if effects:
        return "named"
    if parameters:
        return "parameter_error"
    return "unexplained" if remains else "nothing_missing"
