"""The answer of a diagnosis, whatever the method: verdict, named effects, model error.

Every method of :data:`bayesbl.runs.diagnose.METHODS` returns a :class:`Diagnosis`; what is stored,
summarised and drawn depends on what one holds, never on the method that made it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

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
"""Of a :class:`LearnedAnswer`: one for every two degrees of a turn."""

Verdict = Literal["nothing_missing", "named", "parameter_error", "unexplained"]


@dataclass(frozen=True, slots=True)
class Estimate:
    """A fitted value.

    Attributes
    ----------
    value, sd
        Of a normal distribution; of the value's logarithm where ``logarithmic``. The sd is NaN
        where the value was held.
    draws
        Of the posterior, any shape, in the value's own unit; ``None`` where it was not sampled.
    """

    value: float
    sd: float
    draws: FloatArray | None = None
    logarithmic: bool = False


@dataclass(frozen=True, slots=True)
class NamedEffect:
    """An effect that the bench lacks.

    Attributes
    ----------
    probability
        That it is this one: against its absence at even odds, or among those that cannot be told
        apart.
    z
        How clearly it stands out, in standard deviations.
    indistinguishable_from
        Other effects that would explain these recordings as well.
    """

    name: str
    parameters: Mapping[str, Estimate]
    probability: float
    z: float
    indistinguishable_from: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class ParameterError:
    """A bench parameter whose fitted value the bench file does not allow."""

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
        Of the motor, negative for reverse.
    payload_share
        Gravity torque and load inertia over the present ones.
    distance
        |z| between the best fits of the two explanations that come closest in it.
    separates
        Sets of names that these recordings cannot tell apart.
    """

    reference_speed_rpm: float
    payload_share: float
    distance: float
    separates: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class LearnedAnswer:
    """What was learned where no effect of the catalogue explains what repeats.

    Attributes
    ----------
    variable, sd
        Values of what it depends on, and its standard deviation there, (n,) each.
    alike
        Other dependences that the recordings do not tell from it.
    """

    term: LearnedTerm
    variable: FloatArray
    sd: FloatArray
    alike: tuple[LearnedTerm, ...] = ()

    @property
    def value(self) -> FloatArray:
        """N m at the side it acts, forwards, or rad, (n,)."""
        return self.term.over(self.variable)

    @property
    def amplitude(self) -> float:
        """Largest size in the term's unit, less its mean where it does not reverse."""
        size = self.value
        return float(np.abs(size if self.term.reverses else size - size.mean()).max())


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """The whole answer.

    Attributes
    ----------
    remaining
        What still stands out after naming.
    pieces
        All that was compared.
    bench_parameters
        Declared unknown ones, fitted.
    delta_before
        δ (rad) of the first recording that was fitted, with the bench as believed; ``None`` of a
        rigid bench.
    gaps
        δ (rad) with what was named, of every recording that was fitted; empty of a rigid bench, or
        where it is withheld.
    gap_withheld
        Why no gap is given; empty where one is, or nothing is asked of it.
    augmented_bench
        The bench with what was named and learned in it.
    learned
        A torque of no known law, or an error of the encoder.
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
        """δ (rad) of the first recording, as ``delta_before``, with what was named."""
        return next(iter(self.gaps.values()), None)

    @property
    def disagreement(self) -> DisagreementTableSummary:
        """Of all pieces."""
        return disagreement_table(self.pieces)

    @property
    def signals(self) -> tuple[ComparedPiece, ...]:
        """Pieces that are stored: of a closed loop those held out, or all if none is."""
        of_loop = (p for p in self.pieces if p.noise_floor_from == "rotation")
        return tuple(p for p in of_loop if p.use == "held_out") or self.pieces


def verdict_of(*, effects: bool, parameters: bool, remains: bool) -> Verdict:
    """One word: effects are named, parameters wrong, something remains that nothing explains."""
    if effects:
        return "named"
    if parameters:
        return "parameter_error"
    return "unexplained" if remains else "nothing_missing"
