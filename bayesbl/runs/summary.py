"""``summary.json``: what a stored result of any kind says, from the result alone."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, TypeAlias

from bayesbl.arguments import Tree, checked
from bayesbl.sentences import told

if TYPE_CHECKING:
    from bayesbl.diagnosis.summary import DiagnosisSummary
    from bayesbl.identification.summary import IdentificationSummary
    from bayesbl.measurement.summary_types import ComparisonSummary, FitSummary
    from bayesbl.runs.fleet import FleetSummary
    from bayesbl.runs.plan import PlanSummary
    from bayesbl.runs.study import StudySummary
    from bayesbl.runs.sweep_summary import SweepSummary

    Summary: TypeAlias = (
        FitSummary
        | ComparisonSummary
        | SweepSummary
        | PlanSummary
        | DiagnosisSummary
        | IdentificationSummary
        | StudySummary
        | FleetSummary
    )

_SUMMARISE = {
    "fit": ("bayesbl.measurement.stored", "summary_of"),
    "compare": ("bayesbl.measurement.stored", "summary_of"),
    "sweep": ("bayesbl.runs.sweep_summary", "summarise_sweep"),
    "plan": ("bayesbl.runs.plan", "summarise_plan"),
    "identify": ("bayesbl.identification.summary", "summarise_identification"),
    "diagnose": ("bayesbl.diagnosis.summary", "summarise_diagnosis"),
    "study": ("bayesbl.runs.study", "summarise_study"),
}
"""Kind to module and function, imported only where it is used."""


@checked
def summarise(tree: Tree) -> Summary:
    """The summary of a stored result.

    δ and the change are ``None`` where the answer is withheld; ``reason`` says why.
    """
    module, function = _SUMMARISE[tree.attrs["kind"]]
    summary: Summary = told(getattr(import_module(module), function)(tree))
    return summary
