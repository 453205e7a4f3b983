"""What the form of a law may do to names and to δ.

No real shaft follows the catalogue's laws to the last digit. Beside one that explains nearly all,
what its form leaves looks like a small error of something else that shapes the ringing; and what a
law does to δ is known no better than its form is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from bayesbl.bench.effects import effect_named
from bayesbl.matching.signals import GAP
from bayesbl.naming.candidates import Candidate
from bayesbl.naming.criteria import left, repeating_misfit
from bayesbl.naming.explanation import (
    Explanation,
    reduced,
)
from bayesbl.naming.naming import NamedCandidate, Naming

FORM_SHARE = 0.01
"""Of what a law of the shaft explains, in χ²: what its form may leave, and another name mend.

A law is taken to be right to a tenth of what it does. Of eleven joints whose shaft follows
Bouc-Wen's law, Dahl's left up to that share, and false names gained up to 0.0014 of it.
"""

FORM_OF_GAP = 0.2
"""Standard deviation of ln δ that a law's form leaves, over what the law does to ln δ.

Of twelve joints whose contact damps with the root of its compression, δ's error over that was 0.21
in the root mean square beside Hunt and Crossley's law, noise included.
"""

FORM_OF_GAP_BY_LAW = {"shaft_hysteresis": 0.05}
"""The same where another form of that law was tried: 0.012 in fourteen of Bouc-Wen's beside Dahl's.

Four times as much, as a real shaft's hysteresis may be less like Dahl's than Bouc-Wen's is. Both
are in the summary of ``bayesbl run configs/open_world.toml``.
"""


def without_mends(naming: Naming, explained: float = 0.0) -> Naming:
    """Only those names that explain more than the form of a law of the shaft may leave.

    ``explained``: χ² by what was learned beside them, which has a form too.
    """
    least = max(_form_leaves(naming), FORM_SHARE * explained)
    mends = [e for e in naming.effects if e.gain < least]
    kept = _less(naming, mends) if mends else None
    if kept is None:
        return naming
    effects = tuple(e for e in naming.effects if e not in mends)
    return replace(naming, final=kept, effects=effects)


def is_within_form(naming: Naming) -> bool:
    """Whether what repeats beyond noise is no more than the form of a named law may leave."""
    return repeating_misfit(naming.final.fit) < _form_leaves(naming)


def _form_leaves(naming: Naming) -> float:
    return FORM_SHARE * max((law.gain for law in laws_of_shaft(naming)), default=0.0)


def least_beside(nominal: Explanation, one: Explanation) -> float:
    """χ² that a name must gain beside an explanation.

    More than the form of a law of the shaft may leave, where that alone explains all but its form.
    """
    if len(one.candidates) != 1 or not _is_law_of_shaft(one.candidates[0]):
        return 0.0
    may_leave = FORM_SHARE * (left(nominal) - left(one))
    return may_leave if repeating_misfit(one.fit) < may_leave else 0.0


def laws_of_shaft(naming: Naming) -> list[NamedCandidate]:
    """What is named of torques over the twist, whose form a real joint has its own of."""
    return [e for e in naming.effects if _is_law_of_shaft(e.candidate)]


def _is_law_of_shaft(candidate: Candidate) -> bool:
    if candidate.kind != "effect":
        return False
    effect = effect_named(candidate.name)
    return "twist" in effect.depends_on and effect.replaces != GAP


def form_sd(naming: Naming) -> float:
    """Standard deviation of ln δ for the forms of the shaft's laws that are named.

    Parameters named beside a law may stand in for its form: what they do counts as its own.
    """
    laws = laws_of_shaft(naming)
    if not laws or GAP not in [u.name for u in naming.nominal.fit.model.unknowns]:
        return 0.0
    rest = _less(
        naming, [e for e in naming.effects if e in laws or e.candidate.kind == "parameter"]
    )
    if rest is None:
        return 0.0
    return form_of_gap(naming) * abs(_log_gap(naming.final) - _log_gap(rest))


def form_of_gap(naming: Naming) -> float:
    """Share to which what the named laws of the shaft do to ln δ is not known; 0 without any."""
    names = [law.candidate.name for law in laws_of_shaft(naming)]
    return max((FORM_OF_GAP_BY_LAW.get(name, FORM_OF_GAP) for name in names), default=0.0)


def _less(naming: Naming, names: Sequence[NamedCandidate]) -> Explanation | None:
    """The final explanation without these, fitted again; ``None`` if it cannot be simulated."""
    final = naming.final
    return reduced(naming.nominal, final, [final.candidates.index(n.candidate) for n in names])


def _log_gap(explanation: Explanation) -> float:
    fit = explanation.fit
    place = [u.name for u in fit.model.unknowns].index(GAP)
    return math.log(float(fit.model.unknowns[place].value(fit.point[place])))
