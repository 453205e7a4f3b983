"""Keys of ``summary.json`` of a fit and of a comparison, with their types."""

from __future__ import annotations

from typing import Literal, NotRequired, TypedDict

from bayesbl.measurement.measurement import JointCheck
from bayesbl.results.store import Interval, Origin
from bayesbl.sampling.convergence import Outcome


class ReasonSummary(TypedDict):
    """Why an answer is withheld or limited, or why a route answers; programs should read ``code``.

    Each number and name in ``text`` is a key too. ``recordings``: those concerned, if not all.
    ``also``: further reasons, which ``text`` includes. In the diagnostics, ``withholds`` says
    whether δ is withheld, and ``because`` why another route has no answer. The reason of ``answer``
    names the ``route``.
    """

    code: str
    text: str
    also: NotRequired[list[ReasonSummary]]
    recordings: NotRequired[list[str]]
    because: NotRequired[list[ReasonSummary]]
    withholds: NotRequired[bool]
    route: NotRequired[str]


class NoiseSummary(TypedDict):
    """Noise of a recording; ``sd_a`` is the standard deviation in the current, if it was used."""

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
    """How the sampling ended; the optional keys belong to draws that were simulated in full."""

    r_hat: float
    ess_bulk: float
    effective_after_simulation: NotRequired[float]
    simulated_draws: NotRequired[int]
    surrogate_refits: NotRequired[int]
    outcome: Outcome
    reasons: list[ReasonSummary]


class SamplerCheckSummary(TypedDict):
    """A second sampler beside emcee: ``difference_sd`` and ``width_ratio`` of each symbol."""

    agrees: bool
    symbols: dict[str, dict[str, float]]


class PredictiveCheckEntry(TypedDict):
    """Power that repeats every rotation, over that of noise, in one band of load orders."""

    channel: str
    highest_order: int
    ratio: float
    probability: float


class MotionSummary(TypedDict):
    """The motion of a joint that follows a varying reference.

    ``cycle_s`` and ``cycles`` are ``None`` if the motion does not repeat.
    """

    cycle_s: float | None
    cycles: float | None
    flank_changes: int
    compared_from_s: float


class RampsSummary(TypedDict):
    """The ramps that show the play; ``width_rad``: mean width at each position around the turn."""

    positions: int
    cycles: int
    torque_nm: float
    width_rad: list[float]


class HarmonicSummary(TypedDict):
    """Amplitude of an order of the transmission error, per turn of the load or the motor."""

    of: str
    order: int
    amplitude_rad: Interval


class TransmissionErrorSummary(TypedDict):
    """Error of the load's angle that is the same in both directions.

    ``harmonics`` exist for each shaft that makes a turn or more.
    """

    peak_to_peak_rad: Interval
    harmonics: list[HarmonicSummary]


class StatedLimit(TypedDict):
    """The limit as it was given. ``measured`` is δ, converted to the kind and ``unit`` of the limit
    (``arcmin of play``)."""

    text: str
    unit: str
    measured: Interval | None


class _OfSomeRoutes(TypedDict, total=False):
    """Keys that not every route has."""

    # Of the fit of the ringing's waveform.
    rmse_rpm: float
    relative_rmse: float
    misfit_rms_rpm: float
    impact_sd_rpm: Interval
    start: str
    box_search: dict[str, float]
    sampler_check: SamplerCheckSummary
    # Of the simulated bench.
    cramer_rao_sd: dict[str, float | None]
    posterior_sd: dict[str, float]
    predictive_check: list[PredictiveCheckEntry]
    motion: MotionSummary
    # Of torque ramps, all at the output, and of two encoders.
    lost_motion_rad: Interval | None
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
    play_rad: Interval | None
    windup_rad_per_nm: Interval | None
    gear_ratio: Interval
    channel_skew_s: Interval
    transmission_error: TransmissionErrorSummary
    reversals: int


class RouteSummary(_OfSomeRoutes):
    """One recording by one route; one that could not be run has only ``route``, ``delta_rad`` and
    ``reason``.

    If the load's position was recorded, ``two_encoders`` is a second opinion beside the route that
    answers. ``delta_upper_bound_rad`` (95 %) is given if there may be no gap. ``preloaded``: ramps
    of torque show no play. Keys that are also variables of ``result.nc`` are explained there; draws
    become their interval, or ``None`` if the variable is NaN.
    """

    route: str
    curve: str | None
    delta_rad: Interval | None
    delta_upper_bound_rad: float | None
    amplitude_rpm: Interval | None
    parameters: dict[str, Interval]
    optimum: dict[str, float]
    noise: NoiseSummary
    rotations: float
    excluded_samples: int
    budget: dict[str, float]
    diagnostics: DiagnosticsSummary
    reason: ReasonSummary | None
    model_check: JointCheck
    limit_rad: NotRequired[float]
    limit: NotRequired[StatedLimit]
    probability_above_limit: NotRequired[float | None]


class SnapshotSummary(RouteSummary):
    """The answer for one recording; ``routes`` has that of each route that ran.

    ``name``: the name of the snapshot, in a comparison.
    """

    routes: dict[str, RouteSummary]
    name: NotRequired[str]


class _Measured(Origin):
    """Of a fit and of a comparison: how it ended, and which route answers."""

    outcome: str
    warnings: list[str]
    answer: ReasonSummary


class FitSummary(_Measured, SnapshotSummary):
    """``summary.json`` of a fit."""

    kind: Literal["fit"]


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


class NotBefore(TypedDict):
    """With probability ``level`` the limit is not reached before ``date`` (one-sided).

    ``None`` if that is too far ahead to be computed.
    """

    date: str | None
    level: float


class ProbabilityBefore(TypedDict):
    """Probability that the limit is reached by a date."""

    date: str
    probability: float


class DateInterval(TypedDict):
    """An interval of dates; one that is too far ahead to be computed is ``None``."""

    median: str | None
    low: str | None
    high: str | None
    level: float
    kind: str


class ForecastFromPrior(TypedDict):
    """How much of a forecast comes from the prior.

    ``width_over_prior``: width of ln years_to_limit, over that by the prior alone with the same gap
    and mean rate. ``probability_change_ahead``: share of forecasts in which wear changes between
    the last recording and the limit.
    """

    width_over_prior: float
    probability_change_ahead: float


class ChangeSummary(TypedDict):
    """The change from first to last, by one route."""

    change_rad: Interval | None
    probability_increase: float | None
    outcome: str
    reason: ReasonSummary | None
    same_joint: JointCheck


class WearSummary(TypedDict):
    """Wear in time, from dated snapshots since the last repair.

    ``level`` is the probability of one-sided bounds too. ``probability_wear``, that the gap grows,
    allows for shrinking gaps; the other keys do not. ``law``: posterior probability of each law of
    wear. ``rate`` is the mean since the first snapshot, ``rate_now`` the rate at the last one by
    the laws. ``scatter_rad_per_root_year`` is irregular wear, ``None`` with fewer than four
    snapshots. ``drift_widens``: factor by which ``relative_sd_per_date``, as configured, widens the
    rate. ``years_to_limit`` count from the last snapshot. ``forecast_from_prior`` is ``None``
    without a limit ahead. If no rate can be given, ``reason`` says why, and all values of the rate
    are null.
    """

    snapshots: list[str]
    first_date: str
    last_date: str
    level: float
    limit_rad: float | None
    limit: str | None
    relative_sd_per_date: float
    drift_widens: float | None
    decide_before: str | None
    probability_wear: float
    law: dict[str, float]
    rate: Interval
    rate_now: Interval
    rate_at_most_rad_per_year: float
    scatter_rad_per_root_year: Interval | None
    years_to_limit: Interval | None
    date_of_limit: DateInterval | None
    not_before: NotBefore | None
    probability_before: ProbabilityBefore | None
    forecast_from_prior: ForecastFromPrior | None
    reason: ReasonSummary | None


class ComparisonSummary(_Measured):
    """``summary.json`` of a comparison.

    ``ringing_change`` is that of the amplitude from first to last as a share of the first, where it
    was measured at one speed and rate, else ``None``. ``routes`` has the change by each route.
    """

    kind: Literal["compare"]
    curve: str | None
    reason: ReasonSummary | None
    snapshots: list[SnapshotSummary]
    change_rad: Interval | None
    changes: list[StepSummary]
    probability_increase: float | None
    ringing_change: Interval | None
    probability_ringing_grew: float | None
    same_joint: JointCheck
    routes: dict[str, ChangeSummary]
    wear: WearSummary | None


MeasuredSummary = FitSummary | ComparisonSummary
"""Of gaps measured in recordings; ``kind`` says which."""
