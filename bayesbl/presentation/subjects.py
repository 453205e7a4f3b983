"""What is said of each kind of result, chosen by what its summary holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from bayesbl.presentation import (
    advice,
    answer,
    assumptions,
    cards,
    diagnosis,
    estimates,
    study,
    sweep,
)
from bayesbl.presentation.advice import Advice
from bayesbl.presentation.blocks import Block, Sentence
from bayesbl.presentation.cards import Card
from bayesbl.presentation.words import Summary

if TYPE_CHECKING:
    import xarray as xr


def _no_details(tree: xr.DataTree, summary: Summary) -> Iterator[Block]:
    yield from ()


def _no_cards(summary: Summary) -> Iterator[Card]:
    yield from ()


@dataclass(frozen=True, slots=True)
class Subject:
    """How one kind of result is presented.

    Attributes
    ----------
    key
        Of ``summary.json``, which only summaries of this kind have.
    title
        Of the page.
    headline, blocks
        The answer in a sentence, and all that is said below it.
    details
        Diagnostics, from the stored result too.
    """

    key: str
    title: str
    headline: Callable[[Any], str]
    blocks: Callable[[Any], Iterator[Block]]
    advice: Callable[[Summary], Advice]
    assumptions: Callable[[Summary], Iterator[str]]
    cards: Callable[[Summary], Iterator[Card]] = _no_cards
    details: Callable[[xr.DataTree, Summary], Iterator[Block]] = _no_details
    warning_label: str = "Warning"


def _measured(key: str, title: str) -> Subject:
    return Subject(
        key,
        title,
        lambda summary: next(answer.lead(summary)),
        answer.blocks,
        advice.of_snapshots,
        assumptions.of_snapshots,
        cards.of_snapshots,
        estimates.blocks,
    )


SUBJECTS = (
    Subject(
        "verdict",
        "What a bench lacks",
        diagnosis.headline,
        diagnosis.blocks,
        advice.of_diagnosis,
        assumptions.of_diagnosis,
        cards.of_diagnosis,
        diagnosis.residual_blocks,
        warning_label="Note",
    ),
    Subject(
        "coefficients",
        "Gap curve of a virtual bench",
        sweep.headline,
        sweep.blocks,
        advice.of_sweep,
        assumptions.of_sweep,
    ),
    Subject("rows", "Study", study.headline, study.blocks, advice.of_study, assumptions.of_study),
    _measured("snapshots", "Backlash gap of a joint and its change"),
    _measured("delta_rad", "Backlash gap of a joint"),
)


def subject_of(summary: Summary) -> Subject:
    """The subject of a summary."""
    return next(subject for subject in SUBJECTS if subject.key in summary)


def blocks(summary: Summary) -> Iterator[Block]:
    """Everything that is said of a result below its headline."""
    subject = subject_of(summary)
    yield from subject.blocks(summary)
    for warning in summary.get("warnings", ()):
        yield Sentence(warning, "warning", subject.warning_label)


def summary_of(tree: xr.DataTree) -> Summary:
    """The summary of a stored result of any kind."""
    if "study" in tree.attrs:
        from bayesbl.runs.study import summarise_study

        return summarise_study(tree)
    from bayesbl.runs.summary import summarise

    return summarise(tree)
