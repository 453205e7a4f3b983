"""Keys of ``summary.json`` of a fit and of a comparison, with their types."""

from __future__ import annotations

from typing import Literal, NotRequired, TypedDict

from bayesbl.results.intervals import Interval
from bayesbl.results.summary_types import Head
from bayesbl.sampling.convergence import Outcome


class NoiseSummary(TypedDict):
    """Noise of a recording; ``sd_a`` is that of the current, where it was used."""

    kind: str
    order: int
    sd_rpm: float
    coefficients: list[float]
    degrees_of_freedom: float | None
    student_t_evidence: NotRequired[float | None]
    differentiated: NotRequired[bool]
    repeating_rounding_sd_rpm: NotRequired[float]
    sd_a: NotRequired[float | None]


class DiagnosticsSummary(TypedDict):
    """How the sampling ended; the optional keys are of draws that were simulated in full."""

    r_hat: float
    ess_bulk: float
    effective_after_simulation: NotRequired[float]
    simulated_draws: NotRequired[int]
    surrogate_refits: NotRequired[int]
    outcome: Outcome
    reasons: list[str]


class SymbolCheck(TypedDict):
    """A second sampler beside emcee for one symbol."""

    difference_sd: float
    width_ratio: float


class SamplerCheckSummary(TypedDict):
    """A second sampler beside emcee."""

    agrees: bool
    symbols: dict[str, SymbolCheck]


class PredictiveCheckEntry(TypedDict):
    """What repeats every rotation over what noise explains, in one band of load orders."""

    channel: str
    highest_order: int
    ratio: float
    probability: float


class CheckItemSummary(TypedDict):
    """A quantity as measured and as expected; ``z`` is their difference in standard deviations."""

    quantity: str
    measured: float
    expected: float
    unit: str
    z: float


class BlindSpotSummary(TypedDict):
    """A change of the joint that the check cannot see, and what it would do to δ, where known."""

    change: str
    reason: str
    delta_error_rad: float | None


class JointCheckSummary(TypedDict):
    """A snapshot against its bench, or snapshots against one another.

    ``could_be`` names effects or parameters of the bench that would do what was found;
    ``sentences`` say so, one for each finding. Where nothing was compared, ``items`` is empty and
    ``agrees`` true.
    """

    agrees: bool
    items: list[CheckItemSummary]
    could_be: list[str]
    sentences: list[str]
    blind_spots: list[BlindSpotSummary]


class RouteSummary(TypedDict):
    """What one route answers of a snapshot; ``reason``: why it has no δ."""

    delta_rad: Interval | None
    reason: str | None
    amplitude_rpm: NotRequired[Interval | None]
    curve: NotRequired[str]


class _FromRinging(TypedDict, total=False):
    """Of the fit of the ringing's waveform."""

    misfit_rms_rpm: float
    start: str
    box_search: dict[str, float]
    sampler_check: SamplerCheckSummary


class MotionSummary(TypedDict):
    """Of a joint that follows a reference over time.

    ``cycle_s`` and ``cycles`` are ``None`` where the motion does not repeat.
    """

    cycle_s: float | None
    cycles: float | None
    flank_changes: int
    compared_from_s: float


class _FromSimulation(TypedDict, total=False):
    """Of the simulated bench."""

    cramer_rao_sd: dict[str, float]
    posterior_sd: dict[str, float]
    predictive_check: list[PredictiveCheckEntry]
    motion: MotionSummary


class RampsSummary(TypedDict):
    """The ramps that tell the play; ``width_rad`` is the mean of each position round the turn."""

    positions: int
    cycles: int
    torque_nm: float
    width_rad: list[float]


class _FromRamps(TypedDict, total=False):
    """Of torque ramps with the output held, all at the output.

    ``lost_motion_rad`` is between ±``lost_motion_torque_nm``. ``preloaded``: no play is
    seen, and ``preload_torque_nm`` is the torque at which one of both flanks lifts; 0 with play,
    ``None`` where that is not seen.
    ``held_windup_rad``: what of δ is compliance that friction holds at zero torque.
    ``stiffness_nm_per_rad``: of a line through the largest ramps, as test reports state it.
    """

    lost_motion_rad: Interval
    lost_motion_torque_nm: float
    compliance_rad_per_nm: Interval
    stiffness_nm_per_rad: Interval
    friction_torque_nm: Interval
    held_windup_rad: Interval
    preload_torque_nm: Interval | None
    preloaded: bool
    probability_of_play: float
    relative_compliance: float
    ramps: RampsSummary


class HarmonicSummary(TypedDict):
    """Amplitude of an order of the transmission error, per turn of the load or the motor."""

    of: str
    order: int
    amplitude_rad: Interval


class TransmissionErrorSummary(TypedDict):
    """Of the load behind the motor, over the angle, the same in both directions.

    ``harmonics`` are of angles that make a turn or more.
    """

    peak_to_peak_rad: Interval
    harmonics: list[HarmonicSummary]


class _FromTwoEncoders(TypedDict, total=False):
    """Of the encoders of motor and load.

    ``play_rad`` is 2δ. ``lost_motion_rad`` is between both directions: the play, and what the
    load's friction winds up. ``delta_upper_bound_rad`` (95 %) where play is not told from none.
    ``windup_rad_per_nm`` is the compliance at the output, where a torque tells it.
    ``channel_skew_s`` is how late the load's stamps are.
    """

    delta_upper_bound_rad: float | None
    play_rad: Interval | None
    windup_rad_per_nm: Interval | None
    gear_ratio: Interval
    channel_skew_s: Interval
    transmission_error: TransmissionErrorSummary
    reversals: int


class SnapshotSummary(_FromRinging, _FromSimulation, _FromRamps, _FromTwoEncoders):
    """One snapshot; every route gives the keys here, and some of its own.

    ``route`` is the one that answers, ``routes`` has the answer of each that was run.
    """

    route: str
    routes: dict[str, RouteSummary]
    delta_rad: Interval | None
    amplitude_rpm: Interval | None
    parameters: dict[str, Interval]
    optimum: dict[str, float]
    noise: NoiseSummary
    rotations: float
    excluded_samples: int
    budget: dict[str, float]
    diagnostics: DiagnosticsSummary
    reason: str | None
    model_check: JointCheckSummary
    limit_rad: NotRequired[float]
    probability_above_limit: NotRequired[float | None]


class NamedSnapshotSummary(SnapshotSummary):
    """A snapshot of a comparison."""

    name: str


class FitSummary(Head, SnapshotSummary):
    """``summary.json`` of a fit."""

    kind: Literal["fit"]
    curve: str | None


StepSummary = TypedDict(
    "StepSummary",
    {
        "from": str,
        "to": str,
        "change_rad": Interval | None,
        "probability_increase": float | None,
    },
)
"""Change between neighbouring snapshots."""


class RateInterval(Interval):
    """An interval of a rate of wear, with its unit."""

    unit: str


class NotBefore(TypedDict):
    """With probability ``level`` the limit is not reached before ``date`` (one-sided).

    ``None`` where that is too far ahead to be computed.
    """

    date: str | None
    level: float


class ProbabilityBefore(TypedDict):
    """Probability that the limit is reached by a date."""

    date: str
    probability: float


class DateInterval(TypedDict):
    """An interval of dates; ``None`` where one is too far ahead to be computed."""

    median: str | None
    low: str | None
    high: str | None
    level: float
    kind: str


class _DatedSummary(TypedDict):
    """Of dated snapshots since the last repair."""

    snapshots: list[str]
    first_date: str
    last_date: str
    level: float
    limit_rad: float | None
    relative_sd_per_date: float
    drift_widens: float | None
    decide_before: str | None


class WearSummary(_DatedSummary):
    """Wear in time; one-sided statements hold with the probability of the intervals, ``level``.

    ``probability_wear`` that the gap grows has not ruled out healing, all that follows has. ``law``
    is the posterior probability of each law of wear, ``rate`` the mean since the first snapshot,
    ``rate_now`` that at the last one by the laws. ``scatter_rad_per_root_year`` is irregular wear,
    ``None`` under four snapshots. ``relative_sd_per_date`` is what the gap may drift, as
    configured, and ``drift_widens`` by what factor that widens the rate. ``years_to_limit`` count
    from the last snapshot.
    """

    probability_wear: float
    law: dict[str, float]
    rate: RateInterval
    rate_now: RateInterval
    rate_at_most_rad_per_year: float
    scatter_rad_per_root_year: Interval | None
    years_to_limit: Interval | None
    date_of_limit: DateInterval | None
    not_before: NotBefore | None
    probability_before: ProbabilityBefore | None
    reason: None


class WithheldWearSummary(_DatedSummary):
    """As :class:`WearSummary` where no rate can be given; ``reason`` says why."""

    probability_wear: None
    law: None
    rate: None
    rate_now: None
    rate_at_most_rad_per_year: None
    scatter_rad_per_root_year: None
    years_to_limit: None
    date_of_limit: None
    not_before: None
    probability_before: None
    reason: str


class ComparisonSummary(Head):
    """``summary.json`` of a comparison.

    ``ringing_change`` is that of the amplitude from first to last as a share of the first, where it
    was measured at one speed and rate, else ``None``.
    """

    kind: Literal["compare"]
    curve: str | None
    snapshots: list[NamedSnapshotSummary]
    change_rad: Interval | None
    changes: list[StepSummary]
    probability_increase: float | None
    ringing_change: Interval | None
    probability_ringing_grew: float | None
    same_joint: JointCheckSummary
    wear: WearSummary | WithheldWearSummary | None


MeasuredSummary = FitSummary | ComparisonSummary
"""Of gaps measured in recordings; ``kind`` says which."""
