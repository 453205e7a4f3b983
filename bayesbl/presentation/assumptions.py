"""What has to hold for the numbers of a result to mean what they say, as sentences."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from bayesbl.presentation import answer, torque_ramps, two_encoders
from bayesbl.presentation.words import interval_kind

if TYPE_CHECKING:
    from bayesbl.diagnosis.summary import DiagnosisSummary
    from bayesbl.measurement.summary_types import MeasuredSummary, SnapshotSummary
    from bayesbl.runs.plan import PlanSummary
    from bayesbl.runs.study import StudySummary
    from bayesbl.runs.sweep_summary import SweepSummary


def of_sweep(_: SweepSummary) -> Iterator[str]:
    """Assumptions of a gap curve."""
    yield "The simulated bench is a two-mass drive whose only play is one gap."
    yield "The joint has the bench's parameters, within their tolerances where they have any."
    yield "Measured recordings are fitted as these simulated ones were."


def of_diagnosis(_: DiagnosisSummary) -> Iterator[str]:
    """Assumptions of a diagnosis."""
    yield "What is missing, if anything, is in the catalogue (bayesbl effects)."
    yield "Noise does not repeat; a named effect predicts what it was not fitted on."
    yield "The bench's other parameters have the values in its file, within their tolerances."


def of_plan(_: PlanSummary) -> Iterator[str]:
    """Assumptions of a plan."""
    yield "The joint behaves as its bench file says, within the tolerances given there."
    yield "Its noise is that of the bench file, and it starts from rest."


def of_study(_: StudySummary) -> Iterator[str]:
    """Assumptions of a study."""
    yield "Each case has random numbers of its own, from the seed, the row and its number."


def of_snapshots(summary: MeasuredSummary) -> Iterator[str]:
    """Assumptions of a measured gap."""
    last = answer.snapshots(summary)[-1][1]
    if torque_ramps.is_by_ramps(summary):
        yield from _of_ramps(summary)
        yield from _of_interval(last)
        return
    if two_encoders.is_by_two_encoders(summary):
        yield from two_encoders.assumptions(summary)
        yield from _of_interval(last)
        return
    if "motion" in last:
        yield "The joint was asked for the motion that its reference channel shows."
    else:
        yield (
            "The joint turned at one constant speed, and gravity changed flanks twice per rotation."
        )
    if answer.is_simulated(summary):
        yield "The joint behaves as its bench file says, within the tolerances given there."
    elif answer.is_ringing_alone(summary):
        yield "More ringing may be more gap, or another load, stiffness, damping or controller."
    elif answer.is_by_other_machine(summary):
        yield "The joint rings like the paper's test bench (curve published, eq. 4)."
        yield "The paper's test bench turned at 2000 rpm, which the paper does not state."
    else:
        yield f"The joint rings like the bench of its gap curve ({summary['curve']})."
    again = "cycle" if "motion" in last else "rotation"
    yield f"Noise is what does not repeat from one {again} to the next, and is steady."
    if not answer.is_ringing_alone(summary):
        yield "Before the recording every gap is equally likely in ln δ."
    if summary["kind"] == "compare":
        if answer.is_simulated(summary):
            yield (
                "Between the snapshots damping, friction, stiffness and the motor's torque drift "
                "by no more than usual ([joint.drift]); controller and load are the same, unless "
                "a change of them is reported."
            )
        else:
            yield (
                "Nothing but the gap changed between the snapshots: same joint, controller and "
                "load."
            )
    yield from _of_interval(last)


def _of_ramps(summary: MeasuredSummary) -> Iterator[str]:
    yield "The output was held, and does not give way; position and torque are scaled to it."
    yield "The ramps are slow: friction and inertia do not depend on how fast the joint moves."
    yield "The positions measured are as good as any round the turn."
    yield (
        "Play is what the joint does not go back through at zero torque. Where it is soft, part of "
        "that is compliance held by friction."
    )
    if summary["kind"] == "compare":
        yield "Nothing but the gap changed between the snapshots: same joint, torque and stand."


def _of_interval(last: SnapshotSummary) -> Iterator[str]:
    found = last["delta_rad"] or last["amplitude_rpm"]
    if found is not None:
        yield (
            f"The {interval_kind(found)} is a credible interval: given all this, the value "
            f"lies in it with probability {100.0 * found['level']:g} %."
        )
