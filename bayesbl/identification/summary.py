"""``summary.json`` of an identification, in the keys of the contract."""

from __future__ import annotations

import json
from typing import Literal, NotRequired, TypedDict

import xarray as xr

from bayesbl.diagnosis.summary import DisagreementTableSummary, HeldValue, SamplingSummary
from bayesbl.results.intervals import Interval
from bayesbl.results.store import Head, head

Verdict = Literal["agrees", "missing_effect", "unexplained"]


class PriorSummary(TypedDict):
    """The data sheet: its value, and the range within the tolerance."""

    value: float
    low: float
    high: float


class ParameterSummary(TypedDict):
    """``learned``: 1 − posterior sd / prior sd."""

    unit: str
    prior: PriorSummary
    posterior: Interval
    learned: float


class EffectFound(TypedDict):
    """A missing or free effect, and its parameters if the identified bench has it."""

    name: str
    parameters: dict[str, Interval | HeldValue]
    indistinguishable_from: list[str]


class BeyondSummary(TypedDict):
    """A value of the data sheet that the recordings contradict."""

    name: str
    believed: float
    tolerance: float
    found: float
    deviations: float
    could_be: list[str]


class TogetherSummary(TypedDict):
    """Parameters known together far better than alone: all by their ratios to each other, or two by
    their product; relative standard deviations, the largest of one alone and of what is told."""

    parameters: list[str]
    told: Literal["ratios", "product"]
    alone_sd: float
    together_sd: float


class NextRecordingSummary(TypedDict):
    """What to record next: five load rotations at one speed, or ``motion_of`` the recording whose
    motion to repeat; ``information_bits``: half the binary logarithm of how much the volume of what
    is unknown shrinks; what it ``sharpens`` most, and the standard deviation of its logarithm."""

    reference_speed_rpm: float
    motion_of: str | None
    information_bits: float
    sharpens: str
    sd_before: float
    sd_after: float


class IdentificationAnswer(TypedDict):
    """What an identification says; ``gaps`` are null where they are withheld."""

    verdict: Verdict
    parameters: dict[str, ParameterSummary]
    gaps: dict[str, Interval | None]
    gap_shared: bool
    effects: list[EffectFound]
    missing: list[list[str]]
    data_sheet_error: BeyondSummary | None
    not_told_apart: list[TogetherSummary]
    disagreement: DisagreementTableSummary
    suggested_recording: NextRecordingSummary | None
    diagnostics: SamplingSummary
    bench: NotRequired[str]


class IdentificationSummary(Head, IdentificationAnswer):
    """``summary.json``."""

    kind: Literal["identify"]


def summarise_identification(tree: xr.DataTree) -> IdentificationSummary:
    """``summary.json`` of a stored identification."""
    answer: IdentificationAnswer = json.loads(tree.attrs["identification"])
    return {"kind": "identify", **head(tree), **answer}
