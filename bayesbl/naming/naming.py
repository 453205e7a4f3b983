"""What a search among candidates found."""

from __future__ import annotations

from dataclasses import dataclass

from bayesbl.naming.candidates import Candidate
from bayesbl.naming.explanation import Explanation


@dataclass(frozen=True, slots=True)
class RankedCandidate:
    """What one candidate alone gains over the bench as believed."""

    candidate: str
    chi_square_gain: float
    log_evidence_gain: float


@dataclass(frozen=True, slots=True)
class NamedCandidate:
    """One explanation found, with those that these recordings cannot tell from it."""

    candidate: Candidate
    gain: float
    indistinguishable: tuple[Explanation, ...]

    @property
    def name(self) -> str:
        """Of the effect or parameter."""
        return self.candidate.name

    @property
    def members(self) -> tuple[str, ...]:
        """The set of names, the most probable first."""
        return (self.name, *(e.candidates[-1].name for e in self.indistinguishable))


@dataclass(frozen=True, slots=True)
class Naming:
    """What was found.

    Attributes
    ----------
    nominal, final
        Before and after adding what is named; the same where nothing is.
    repeats
        Whether something repeats that nothing explains.
    alone
        The nominal bench with one candidate each, most probable first.
    nearest
        The most probable explanation, where none explains enough to be named: it may stand nearer
        to the truth than the nominal bench, whose gap what is missing has drawn away.
    """

    nominal: Explanation
    final: Explanation
    effects: tuple[NamedCandidate, ...]
    alone: tuple[Explanation, ...]
    repeats: bool
    nearest: Explanation | None = None

    @property
    def ranking(self) -> tuple[RankedCandidate, ...]:
        """What each of ``alone`` gains over the nominal bench."""
        return tuple(_ranked(self.nominal, other) for other in self.alone)


def _ranked(nominal: Explanation, other: Explanation) -> RankedCandidate:
    return RankedCandidate(
        other.candidates[-1].name,
        nominal.fit.chi_square - other.fit.chi_square,
        other.log_evidence - nominal.log_evidence,
    )
