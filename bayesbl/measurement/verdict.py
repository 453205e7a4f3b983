"""Whether an answer can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

from bayesbl.sampling.convergence import Outcome


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether an answer can be trusted.

    Attributes
    ----------
    reasons
        All that is to be known of the answer, the gravest first.
    reason
        Why it is withheld; ``None`` where it is not.
    """

    outcome: Outcome
    reasons: tuple[str, ...]
    reason: str | None
