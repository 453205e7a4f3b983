"""What is said of each kind of result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from bayesbl.presentation import (
    advice,
    answer,
    assumptions,
    cards,
    diagnosis,
    estimates,
    fleet,
    identification,
    plan,
    study,
    sweep,
)
from bayesbl.presentation.advice import Advice
from bayesbl.presentation.blocks import Block, Sentence
from bayesbl.presentation.cards import Card

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.measurement.summary_types import MeasuredSummary
    from bayesbl.runs.summary import Summary

S = TypeVar("S", contravariant=True)
"""The summary of one kind of result."""


@dataclass(frozen=True, slots=True)
class Subject(Generic[S]):
    """How one kind of result is presented.

    Attributes
    ----------
    title
        Of the page.
    headline, blocks
        The answer in a sentence, and all that is said below it.
    details
        Diagnostics, from the stored result too.
    """

    title: str
    headline: Callable[[S], str]
    blocks: Callable[[S], Iterator[Block]]
    advice: Callable[[S], Advice]
    assumptions: Callable[[S], Iterator[str]]
    cards: Callable[[S], Iterator[Card]] = lambda summary: iter(())
    details: Callable[[xr.DataTree, S], Iterator[Block]] = lambda tree, summary: iter(())
    warning_label: str = "Warning"


def _measured(title: str) -> Subject[MeasuredSummary]:
    return Subject(
        title,
        lambda summary: next(answer.lead(summary)),
        answer.blocks,
        advice.of_snapshots,
        assumptions.of_snapshots,
        cards.of_snapshots,
        estimates.blocks,
    )


SUBJECTS: Mapping[str, Subject[Any]] = MappingProxyType(
    {
        "diagnose": Subject(
            "What a bench lacks",
            diagnosis.headline,
            diagnosis.blocks,
            advice.of_diagnosis,
            assumptions.of_diagnosis,
            cards.of_diagnosis,
            diagnosis.residual_blocks,
            warning_label="Note",
        ),
        "identify": Subject(
            "Bench of a joint, from its data sheet and recordings",
            identification.headline,
            identification.blocks,
            identification.advice,
            identification.assumptions,
            identification.cards,
            warning_label="Note",
        ),
        "sweep": Subject(
            "Gap curve of a virtual bench",
            sweep.headline,
            sweep.blocks,
            advice.of_sweep,
            assumptions.of_sweep,
        ),
        "plan": Subject(
            "Motions that would show the gap",
            plan.headline,
            plan.blocks,
            advice.of_plan,
            assumptions.of_plan,
        ),
        "study": Subject(
            "Study", study.headline, study.blocks, advice.of_study, assumptions.of_study
        ),
        "fleet": Subject(
            "Backlash gaps of a plant",
            fleet.headline,
            fleet.blocks,
            fleet.advice,
            fleet.assumptions,
        ),
        "compare": _measured("Backlash gap of a joint and its change"),
        "fit": _measured("Backlash gap of a joint"),
    }
)


def blocks(summary: Summary) -> Iterator[Block]:
    """Everything that is said of a result below its headline."""
    subject = SUBJECTS[summary["kind"]]
    yield from subject.blocks(summary)
    for warning in summary["warnings"]:
        yield Sentence(warning, "warning", subject.warning_label)
