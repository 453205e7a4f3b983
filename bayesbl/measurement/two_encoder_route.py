"""From the encoders of motor and load, over any motion with reversals, to the gap.

See :mod:`bayesbl.two_encoders.transmission` and ``docs/design.md``, "Two encoders".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import xarray as xr

from bayesbl.config.measurement import SnapshotConfig
from bayesbl.config.sections import SnapshotRecording
from bayesbl.errors import RecordingError
from bayesbl.measurement import shared_groups as shared
from bayesbl.measurement.measurement import Measurement, Measurer, Route, Snapshot
from bayesbl.measurement.stored_snapshot import StoredSnapshot
from bayesbl.measurement.summary_types import HarmonicSummary, SnapshotSummary
from bayesbl.measurement.task import Task
from bayesbl.measurement.verdict import Verdict
from bayesbl.progress import of_stage
from bayesbl.recording.checks import require_alive, require_channels
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import (
    LOAD_POSITION,
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_TORQUE,
    FloatArray,
    Recording,
)
from bayesbl.results.intervals import interval
from bayesbl.results.variables import Group, dataset, table
from bayesbl.sampling.convergence import Diagnostics, Outcome, rank_r_hat_and_ess
from bayesbl.two_encoders.paths import Channels, scaled_paths
from bayesbl.two_encoders.transmission import PLAY_RAD, Transmission, fit_transmission

NAME = "two_encoders"

TOLD, UPPER = 0.95, 0.95
"""Probability from which there is play, and that of the upper bound of δ."""

FEWEST_SAMPLES, FEWEST_REVERSALS, FEW_REVERSALS = 100, 1, 4

LIKELY = 0.5
"""Probability from which something is told as a note."""

FOLLOWS = 0.1
"""Share of the load's variance that the motor's position explains, from which they are of one
joint."""

HELD_BY_WEIGHT = 0.2
"""Share of the moving time with the load's weight above its friction, from which the flanks do not
turn with the direction."""

TOO_WIDE = 0.05
"""Upper bound of δ over the travel: above it nothing was told of the play."""

POSTERIOR = Group(
    "posterior",
    (
        shared.DELTA,
        *table("""
            play_rad (chain, draw) | rad | whole play, 2δ
            lost_motion_rad (chain, draw) | rad
                | between both directions: play, and what the load's friction winds up
            held_windup_rad (chain, draw) | rad | what of the lost motion is no play
            windup_rad_per_nm (chain, draw) | rad/(N m)
                | compliance at the output; NaN where no torque tells it
            gear_ratio (chain, draw) | 1 | motor over load, with its sign
            channel_skew_s (chain, draw) | s | by which the load's stamps are late
            transmission_error_rad (chain, draw) | rad | peak to peak, over the travel
            harmonic_rad (harmonic, chain, draw) | rad | amplitude of a transmission error's order
        """),
    ),
    (shared.CHAIN, shared.DRAW),
)

TRANSMISSION = Group(
    "transmission",
    table("""
        position_rad (point) | rad | the load's position
        forward (point) | 1 | whether the motor turns forwards (1)
        lag_rad (point) | rad | motor less load, without all but the play
        model_rad (point) | rad | the same by the model
        curve_rad (point) | rad | transmission error
        harmonic_order (harmonic) | 1 | order of a transmission error
        harmonic_of_load (harmonic) | 1 | whether it is per turn of the load (1) or the motor (0)
        probability_of_play | 1 | that δ is not zero
        log_odds | 1 | log evidence of a lag over none
        coasts | 1 | probability that the load goes through the gap by itself
        counted | 1 | times that a misfit which repeats every cycle is counted
        reversals | 1 | of the motor
        noise_sd_rad | rad | white noise
        drift_sd_rad | rad | of the process with a correlation time
        drift_s | s | that correlation time
    """),
)

DIAGNOSTICS = Group("diagnostics", (*shared.SAMPLING,), (shared.SAMPLED_SYMBOLS,))

GROUPS = (POSTERIOR, shared.OBSERVED, TRANSMISSION, DIAGNOSTICS, shared.GAP)

SCALARS = ("probability_of_play", "log_odds", "coasts", "counted", "reversals")

QUANTITIES = (
    "play_rad",
    "lost_motion_rad",
    "held_windup_rad",
    "windup_rad_per_nm",
    "gear_ratio",
    "channel_skew_s",
    "transmission_error_rad",
)


def play_not_told(probability: float, upper_mrad: float, lost_mrad: float) -> str:
    """The lag, or what there is of one, may be wind-up."""
    return (
        f"Play is not told from none (probability {100.0 * probability:.0f} %): both directions "
        f"are {lost_mrad:.2g} mrad apart, which skew, wind-up or noise can make. δ is below "
        f"{upper_mrad:.2g} mrad with 95 % probability."
    )


def held_by_weight(share: float) -> str:
    """Gravity sets the flank."""
    return (
        f"The load's weight is above its friction {100.0 * share:.0f} % of the time, so it rests "
        "on one flank in both directions and hides the play. Record with the load balanced or "
        "the axis upright, or take it through the top and back."
    )


def nothing_told(upper_mrad: float) -> str:
    """The bound is no answer."""
    return (
        f"These data do not limit the play: δ could be as large as {upper_mrad:.2g} mrad. Record "
        "more reversals, slow and fast ones, with friction or a brake at the output."
    )


def few_reversals(count: int) -> str:
    """The play is shown at reversals alone."""
    return (
        f"The motor turns back {count} time{'' if count == 1 else 's'} only: play shows at "
        "reversals. Ten or more, slow and fast, tell it from a skew of the channels."
    )


def no_torque() -> str:
    """What is taken for granted without one."""
    return (
        "No torque tells what the joint winds up or what the load weighs: what makers' sheets let "
        "expect is taken off as wind-up (0.05 mrad), and the load is taken to be dragged by "
        "friction. A load that its weight holds on one flank hides its play."
    )


def torque_unused() -> str:
    """The compliance is aliased."""
    return (
        "The torque does not tell the compliance: it changes with the motion and the angle alone. "
        "What makers' sheets let expect is taken off as wind-up (0.05 mrad)."
    )


def ratio_differs(stated: float, seen: float) -> str:
    """The stated ratio is outside the interval."""
    return f"The gear ratio looks like {seen:.6g}, not {stated:g} as stated."


def motor_at_output() -> str:
    """The motor's position was divided already."""
    return "The motor's position is at the output already: the gear ratio was not applied again."


def channels_skewed(skew_ms: float) -> str:
    """A skew worth mending."""
    late = "late" if skew_ms > 0.0 else "early"
    return f"The load's stamps are {abs(skew_ms):.2g} ms {late}; this was taken out."


def load_coasts(share: float) -> str:
    """A free load."""
    return (
        f"The load goes through the play by itself (probability {100.0 * share:.0f} %), as a free "
        "one does; wind-up by impacts may be in the play."
    )


def misfit_repeats(times: float) -> str:
    """Model error."""
    return (
        "What the model leaves repeats with every cycle, so it is no noise: the intervals are "
        f"{np.sqrt(times):.2g} times as wide as noise would make them."
    )


SENTENCES: dict[str, Callable[..., str]] = {
    made.__name__: made
    for made in (
        play_not_told,
        held_by_weight,
        nothing_told,
        few_reversals,
        no_torque,
        torque_unused,
        ratio_differs,
        motor_at_output,
        channels_skewed,
        load_coasts,
        misfit_repeats,
    )
}

WITHHOLDING = ("held_by_weight", "nothing_told")


class TwoEncoderMeasurer(Measurer):
    """The route of two encoders."""

    def __init__(self, config: SnapshotConfig) -> None:
        self.config = config

    @property
    def gap_range_rad(self) -> tuple[float, float]:
        """Of the prior."""
        return PLAY_RAD

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """The ratio, where it is stated."""
        ratio = self.config.joint.gear_ratio
        yield "gear ratio", lambda: "from the recording" if ratio is None else f"{ratio:g}"

    def read(self, entry: SnapshotRecording) -> Recording:
        """Samples as they are: they need not be even in time."""
        recording = read_recording(
            entry.file, name=entry.name, columns=self.config.column_specs, even=False
        )
        require_channels(recording, [MOTOR_POSITION, LOAD_POSITION])
        require_alive(recording, [MOTOR_POSITION, LOAD_POSITION])
        return recording

    def require_usable(self, recording: Recording) -> None:
        """The load follows the motor, which turns back at least once."""
        channels = channels_of(recording)
        if recording.samples < FEWEST_SAMPLES:
            raise RecordingError(
                "The recording is too short.",
                file=recording.place,
                found=f"{recording.samples} samples",
                expected=f"{FEWEST_SAMPLES} or more",
            )
        follows = float(np.corrcoef(channels.motor_rad, channels.load_rad)[0, 1]) ** 2
        if not follows >= FOLLOWS:
            raise RecordingError(
                "The load does not follow the motor.",
                file=recording.place,
                where=f"{MOTOR_POSITION}, {LOAD_POSITION}",
                found=f"{100.0 * follows:.0f} % of the load's motion",
                expected="both encoders of one joint, and a motion larger than the play",
            )
        reversals = scaled_paths(channels, channels.slope()).reversals
        if reversals < FEWEST_REVERSALS:
            raise RecordingError(
                "The motor does not turn back.",
                file=recording.place,
                where=MOTOR_POSITION,
                found="a motion in one direction",
                expected="reversals: play shows where the motor turns back",
            )

    def measure(self, task: Task) -> Measurement:
        """One recording after the other."""
        snapshots = []
        for recording, seed in zip(task.recordings, task.seeds.recordings, strict=True):
            report = of_stage(task.progress, f"Fitting {recording.name}")
            found = fit_transmission(
                channels_of(recording), seed, self.config.joint.gear_ratio, report
            )
            snapshots.append(self._snapshot(recording, found))
        return Measurement(NAME, snapshots)

    def _snapshot(self, recording: Recording, found: Transmission) -> Snapshot:
        codes = list(self._findings(found))
        # The gravest first.
        codes.sort(key=lambda item: item[0] not in WITHHOLDING)
        sentences = {code: SENTENCES[code](**values) for code, values in codes}
        against = [text for code, text in sentences.items() if code in WITHHOLDING]
        sure = found.probability_of_play >= TOLD
        outcome: Outcome = "withheld" if against else "converged" if sure else "usable"
        return Snapshot(
            recording.name,
            found.draws["delta_rad"],
            Verdict(outcome, (*sentences.values(), *recording.notes), " ".join(against) or None),
            groups_of(found, recording),
        )

    def _findings(self, found: Transmission) -> Iterator[tuple[str, dict[str, float]]]:
        """Codes with their numbers: all that limits the answer."""
        upper = upper_bound_rad(found.draws["delta_rad"], found.noise.drift_rad)
        visible = found.followed > LIKELY
        if found.probability_of_play < TOLD:
            lost = float(np.median(found.draws["lost_motion_rad"]))
            if upper > TOO_WIDE * float(np.ptp(found.position_rad)):
                yield "nothing_told", {"upper_mrad": 1e3 * upper}
            else:
                yield (
                    "play_not_told",
                    {
                        "probability": found.probability_of_play,
                        "upper_mrad": 1e3 * upper,
                        "lost_mrad": 1e3 * lost,
                    },
                )
        if found.gravity_holds > HELD_BY_WEIGHT and not visible:
            yield "held_by_weight", {"share": found.gravity_holds}
        if found.reversals < FEW_REVERSALS:
            yield "few_reversals", {"count": found.reversals}
        if found.friction_nm is None:
            yield "no_torque", {}
        elif "compliance_rad_per_nm" not in found.draws:
            yield "torque_unused", {}
        stated = self.config.joint.gear_ratio
        if stated is not None:
            seen = np.abs(found.draws["gear_ratio"])
            middle = float(np.median(seen))
            if abs(np.log(middle)) < 0.1 < abs(np.log(stated)):
                yield "motor_at_output", {}
            elif abs(middle / stated - 1.0) > max(3.0 * float(seen.std()) / stated, 1e-3):
                yield "ratio_differs", {"stated": stated, "seen": middle}
        skew = 1e3 * float(np.median(found.draws["channel_skew_s"]))
        if abs(skew) > 1.0:
            yield "channels_skewed", {"skew_ms": skew}
        if found.coasts > LIKELY and found.probability_of_play > LIKELY:
            yield "load_coasts", {"share": found.coasts}
        if found.counted > 2.0:
            yield "misfit_repeats", {"times": found.counted}


def upper_bound_rad(delta_rad: FloatArray, drift_rad: float) -> float:
    """Of δ, with 95 %: a misfit that lasts for a stroke can hide a play of its size."""
    return max(float(np.quantile(delta_rad, UPPER)), drift_rad)


def channels_of(recording: Recording) -> Channels:
    """What the route takes of a recording: the torque, or the current in its place."""
    torque = recording.channels.get(MOTOR_TORQUE)
    if torque is None:
        torque = recording.channels.get(MOTOR_CURRENT)
    if torque is not None and float(np.ptp(torque)) == 0.0:
        torque = None
    return Channels.unwrapped(
        recording.time_s,
        recording.channels[MOTOR_POSITION],
        recording.channels[LOAD_POSITION],
        torque,
    )


def groups_of(found: Transmission, recording: Recording) -> dict[str, xr.Dataset]:
    """All groups of one snapshot, without a ``snapshot`` dimension."""
    draws = dict(found.draws)
    shape = draws["delta_rad"].shape
    # What one ampere makes is not known, so a current's compliance is no compliance.
    of_torque = MOTOR_TORQUE in recording.channels
    compliance = draws.pop("compliance_rad_per_nm", np.full(shape, np.nan))
    draws["windup_rad_per_nm"] = compliance if of_torque else np.full(shape, np.nan)
    amplitudes = list(found.harmonics.values())
    draws["harmonic_rad"] = np.stack(amplitudes) if amplitudes else np.empty((0, *shape))
    held = 0.25 * float(np.var(draws["held_windup_rad"]))
    budget = min(held / max(float(np.var(draws["delta_rad"])), held, 1e-300), 1.0)
    r_hat, ess = rank_r_hat_and_ess({"lost_motion_rad": draws["lost_motion_rad"]})
    sampled = Diagnostics(r_hat, ess, 1.0, shape[1], np.ones(shape[0]), "converged", ())
    noise = found.noise
    return {
        "posterior": dataset(POSTERIOR, draws, shared.numbered(shape)),
        "observed_data": shared.observed_group(recording),
        "transmission": dataset(
            TRANSMISSION,
            {
                "position_rad": found.position_rad,
                "forward": (found.paths.binned(found.paths.speed) > 0.0).astype(float),
                "lag_rad": found.lag_rad,
                "model_rad": found.modelled_rad,
                "curve_rad": found.curve_rad,
                "harmonic_order": np.array([float(n) for _, n in found.harmonics]),
                "harmonic_of_load": np.array([float(s == "load") for s, _ in found.harmonics]),
                **{name: float(getattr(found, name)) for name in SCALARS},
                "noise_sd_rad": noise.white_rad,
                "drift_sd_rad": noise.drift_rad,
                "drift_s": noise.drift_s,
            },
        ),
        "diagnostics": dataset(
            DIAGNOSTICS, shared.sampling_values(sampled, 0.0), {"symbol": list(r_hat)}
        ),
        "gap": shared.gap_group({"noise": 1.0 - budget, "held_windup": budget}),
    }


def summarise(stored: StoredSnapshot) -> SnapshotSummary:
    """The contract's keys, and beside them all that both encoders tell."""
    posterior = stored.groups["posterior"]
    given = [name for name in QUANTITIES if np.isfinite(posterior[name].values).all()]
    found = {name: stored.interval("posterior", name) for name in given}
    scalars = {name: stored.number("transmission", name) for name in SCALARS}
    told = scalars["probability_of_play"] >= TOLD
    drift = stored.number("transmission", "drift_sd_rad")
    upper = upper_bound_rad(posterior["delta_rad"].values, drift)
    return {
        "route": NAME,
        "routes": {NAME: {"delta_rad": stored.delta_rad, "reason": stored.reason}},
        "delta_rad": stored.delta_rad,
        "delta_upper_bound_rad": None if told or stored.withheld else upper,
        "amplitude_rpm": None,
        "play_rad": None if stored.withheld else found["play_rad"],
        "lost_motion_rad": found["lost_motion_rad"],
        "windup_rad_per_nm": found.get("windup_rad_per_nm"),
        "gear_ratio": found["gear_ratio"],
        "channel_skew_s": found["channel_skew_s"],
        "transmission_error": {
            "peak_to_peak_rad": found["transmission_error_rad"],
            "harmonics": list(_harmonics(stored)),
        },
        "probability_of_play": scalars["probability_of_play"],
        "reversals": int(scalars["reversals"]),
        "parameters": found,
        "optimum": {},
        "noise": {
            "kind": "drift",
            "order": 0,
            "sd_rpm": 0.0,
            "coefficients": [],
            "degrees_of_freedom": None,
        },
        "rotations": 0.0,
        "excluded_samples": stored.excluded_samples,
        "budget": stored.budget,
        "diagnostics": stored.diagnostics,
        "reason": stored.reason,
        "model_check": stored.model_check,
    }


def _harmonics(stored: StoredSnapshot) -> Iterator[HarmonicSummary]:
    draws: FloatArray = stored.groups["posterior"]["harmonic_rad"].values
    orders = stored.values("transmission", "harmonic_order")
    of_load = stored.values("transmission", "harmonic_of_load")
    for each, order, load in zip(draws, orders, of_load, strict=False):
        yield {
            "of": "load" if load else "motor",
            "order": int(order),
            "amplitude_rad": interval(each, stored.level, stored.interval_kind),
        }


def prepare(config: SnapshotConfig) -> TwoEncoderMeasurer:
    """With nothing but the configuration."""
    return TwoEncoderMeasurer(config)


ROUTE = Route(NAME, GROUPS, summarise)
