"""From the encoders of motor and load, over any motion with reversals, to the gap.

See :mod:`bayesbl.two_encoders.transmission` and ``docs/design.md``, "Two encoders".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from bayesbl.config.sections import SnapshotRecording
from bayesbl.errors import RecordingError
from bayesbl.measurement import shared_groups as shared
from bayesbl.measurement.measurement import (
    UPPER_BOUND_LEVEL,
    Answer,
    Measurement,
    Measurer,
    Reason,
    Task,
    outcome_of,
)
from bayesbl.progress import of_stage
from bayesbl.recording.checks import require_alive, require_channels
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import (
    LOAD_POSITION,
    MOTOR_CURRENT,
    MOTOR_POSITION,
    MOTOR_TORQUE,
    Recording,
)
from bayesbl.results.store import interval
from bayesbl.results.variables import Group, table
from bayesbl.sampling.convergence import Diagnostics, rank_r_hat_and_ess
from bayesbl.two_encoders.paths import ALIKE, LONGEST_SKEW_S, Channels, scaled_paths
from bayesbl.two_encoders.transmission import PLAY_RAD, Transmission, fit_transmission, hidden_rad

NAME = "two_encoders"

CHANNELS = (MOTOR_POSITION, LOAD_POSITION)

FEWEST_SAMPLES, FEWEST_REVERSALS, FEW_REVERSALS = 100, 1, 4

LIKELY = 0.5
"""Probability of play from which a recording shows it: more likely than not."""

LASTING = 0.1
"""Misfit that lasts for a stroke over half the lost motion, from which it is told."""

FOLLOWS = 0.1
"""Share of the load's variance that the motor's position explains, from which they are of one
joint."""

ALIASED = 0.9
"""Half turns of the motor in a sample: a position that wraps may then be of any turn."""

RESTS = 0.2
"""Probability that weight keeps a load on one flank, if neither a torque nor the user says. A
judgement."""

SAME_RATIO = 0.1
"""ln of what a gear ratio differs from another by, that it may be."""

TOO_WIDE = 0.05
"""Upper bound of δ over the travel: above it nothing was told of the play."""

POSTERIOR = Group(
    "posterior",
    (
        shared.DELTA,
        *table("""
            play_rad! (chain, draw) | rad | whole play, 2δ
            lost_motion_rad! (chain, draw) | rad
                | angle between the two directions: play plus wind-up by the load's friction
            held_windup_rad (chain, draw) | rad | part of the lost motion that is not play
            windup_rad_per_nm! (chain, draw) | rad/(N m)
                | compliance at the output; NaN where no torque shows it
            gear_ratio! (chain, draw) | 1 | motor over load, with its sign
            channel_skew_s! (chain, draw) | s | how late the load's stamps are
            transmission_error_rad (chain, draw) | rad | peak to peak, over the travel
        """),
    ),
    (shared.CHAIN, shared.DRAW),
)

TRANSMISSION = Group(
    "transmission",
    table("""
        position_rad (point) | rad | the load's position
        forward (point) | 1 | whether the motor turns forwards (1)
        lag_rad (point) | rad | motor minus load, corrected for all but the play
        model_rad (point) | rad | this lag by the model
        curve_rad (point) | rad | transmission error
        probability_of_play! | 1 | probability that δ is not zero
        counted | 1 | factor on the variances by a misfit that repeats every cycle
        reversals | 1 | reversals of the motor
        noise_sd_rad | rad | white noise
        drift_sd_rad | rad | standard deviation of the correlated noise
        drift_s | s | correlation time of that noise
    """),
)

OF_PLAY = ("play_rad", "lost_motion_rad", "held_windup_rad")
"""Of the posterior, what is withheld with δ: a load on one flank shows none of them."""


class TwoEncoderMeasurer(Measurer):
    """The route of two encoders."""

    gap_range_rad = PLAY_RAD

    def describe(self) -> Iterator[tuple[str, Callable[[], str]]]:
        """The ratio, where it is stated."""
        ratio = self.config.joint.gear_ratio
        yield "gear ratio", lambda: "from the recording" if ratio is None else f"{ratio:g}"

    def read(self, entry: SnapshotRecording) -> Recording:
        """Samples as they are: they need not be even in time."""
        recording = read_recording(
            entry.file, name=entry.name, columns=self.config.column_specs, even=False
        )
        require_channels(recording, CHANNELS)
        require_alive(recording, CHANNELS)
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
        motor = channels.motor_rad
        if np.ptp(motor) <= 2.0 * np.pi:
            motor = np.unwrap(motor)
        turned = float(np.quantile(np.abs(np.diff(motor)), 0.99))
        if follows < 1.0 - ALIKE and ALIASED * np.pi < turned <= np.pi:
            raise RecordingError(
                "The motor turns too far between two samples to count its turns.",
                file=recording.place,
                where=MOTOR_POSITION,
                found=f"up to {turned / np.pi:.2f} half turns in a sample",
                expected="a position that counts turns, a higher sampling rate, or slower motion",
            )
        if not follows >= FOLLOWS:
            raise RecordingError(
                "The load does not follow the motor.",
                file=recording.place,
                where=", ".join(CHANNELS),
                found=f"{100.0 * follows:.0f} % of the load's motion",
                expected="both encoders of one joint, and a motion larger than the play",
            )
        reversals = scaled_paths(channels, channels.slope()).reversals
        if reversals < FEWEST_REVERSALS:
            raise RecordingError(
                "The motor does not reverse.",
                file=recording.place,
                where=MOTOR_POSITION,
                found="a motion in one direction",
                expected="reversals: play shows only there",
            )

    def measure(self, task: Task) -> Measurement:
        """One recording after the other."""
        answers, likely = [], []
        for recording, seed in zip(task.recordings, task.seeds.recordings, strict=True):
            report = of_stage(task.progress, f"Fitting {recording.name}")
            transmission = fit_transmission(
                channels_of(recording), seed, task.seeds.gap, self.config.joint.gear_ratio, report
            )
            answers.append(self._answer(recording, transmission))
            likely.append(transmission.probability_of_play > LIKELY)
        reason = None
        if len(answers) > 1 and not (any(likely) or any(one.is_withheld for one in answers)):
            # What the prior takes for none is no evidence that nothing changed.
            reason = Reason("change_of_bounds", {"upper_rad": answers[-1].upper_bound_rad})
        return Measurement(NAME, answers, change_reason=reason)

    def _answer(self, recording: Recording, transmission: Transmission) -> Answer:
        # The gravest first.
        reasons = sorted(self._findings(transmission), key=lambda reason: not reason.withholds)
        withheld = outcome_of(reasons) == "withheld"
        sure = transmission.probability_of_play >= UPPER_BOUND_LEVEL
        reasons += [Reason.of_text("recording", text) for text in recording.notes]
        of = self.config.interval
        groups, numbers = shared.stored(
            groups_of(transmission, recording, at_output=self._is_at_output(transmission)), of
        )
        for name in OF_PLAY if withheld else ():
            numbers["parameters"].pop(name, None)
            numbers |= {name: None} if name in numbers else {}
        numbers |= {
            "transmission_error": {
                "peak_to_peak_rad": numbers["parameters"]["transmission_error_rad"],
                "harmonics": [
                    {"of": side, "order": order, "amplitude_rad": interval(each, of.level, of.kind)}
                    for (side, order), each in transmission.harmonics.items()
                ],
            },
            "reversals": transmission.reversals,
            "noise": shared.no_speed_noise("drift"),
        }
        return Answer(
            recording.name,
            transmission.draws["delta_rad"],
            reasons,
            groups,
            numbers,
            upper_bound_rad=None if sure or withheld else upper_bound_rad(transmission),
        )

    def _is_at_output(self, transmission: Transmission) -> bool:
        """Whether the motor's position was divided by the ratio already; its torque may not be."""
        stated = self.config.joint.gear_ratio
        measured = float(np.median(transmission.draws["gear_ratio"]))
        return stated is not None and abs(np.log(abs(measured))) < SAME_RATIO < abs(np.log(stated))

    def _probability_of_hidden_play(self, transmission: Transmission) -> float:
        """That the load rests on one flank, where no play shows however large it is."""
        share = transmission.gravity_holds
        if np.isnan(share):
            rests = 0.0 if self.config.joint.upright else RESTS
        else:
            # A share of strokes is neither none nor all for sure: half a stroke more of each.
            rests = (transmission.reversals * share + 0.5) / (transmission.reversals + 1.0)
        none, seen, hidden = transmission.of_play
        odds = (none + (1.0 - rests) * seen) / max(rests * hidden, 1e-300)
        return 1.0 / (1.0 + odds)

    def _findings(self, transmission: Transmission) -> Iterator[Reason]:
        """All that limits the answer."""
        upper = upper_bound_rad(transmission)
        lost = float(np.median(transmission.draws["lost_motion_rad"]))
        lost_track = float(np.std(transmission.draws["channel_skew_s"])) > LONGEST_SKEW_S
        probability = transmission.probability_of_play
        unsure = probability < UPPER_BOUND_LEVEL
        too_wide = upper > TOO_WIDE * float(np.ptp(transmission.position_rad))
        hidden = self._probability_of_hidden_play(transmission)
        if lost_track or (unsure and too_wide):
            yield Reason("nothing_told", {"upper_mrad": 1e3 * upper})
        elif hidden > 1.0 - UPPER_BOUND_LEVEL:
            if np.isnan(transmission.gravity_holds):
                yield Reason("weight_unknown", {"probability": hidden})
            else:
                share = {"share": transmission.gravity_holds}
                yield Reason("held_by_weight", {**share, "probability": hidden})
        elif unsure:
            bounds = {"upper_mrad": 1e3 * upper, "lost_mrad": 1e3 * lost}
            yield Reason("play_not_told", {"probability": probability, **bounds})
        skews_ms = 1e3 * transmission.draws["channel_skew_s"]
        skew = {"skew_ms": float(np.median(skews_ms))}
        if transmission.skew_or_play:
            yield Reason("skew_or_play", skew)
        if transmission.reversals < FEW_REVERSALS:
            yield Reason("few_reversals", {"count": transmission.reversals})
        if transmission.friction_nm is None:
            yield Reason("no_torque")
        elif "compliance_rad_per_nm" not in transmission.draws:
            yield Reason("torque_unused")
        stated, measured = self.config.joint.gear_ratio, np.abs(transmission.draws["gear_ratio"])
        middle = float(np.median(measured))
        if stated is None:
            if np.log(middle) < -SAME_RATIO:
                yield Reason("positions_exchanged", {"seen": middle})
        else:
            if abs(np.log(middle * stated)) < SAME_RATIO < abs(np.log(stated)):
                yield Reason("positions_exchanged", {"seen": middle})
            elif self._is_at_output(transmission):
                yield Reason("motor_at_output")
            elif abs(middle / stated - 1.0) > max(3.0 * float(measured.std()) / stated, 1e-3):
                yield Reason("ratio_differs", {"stated": stated, "seen": middle})
        if abs(skew["skew_ms"]) > max(1.0, 3.0 * float(skews_ms.std())):
            yield Reason("channels_skewed", skew)
        if _misfit_lasts(transmission):
            values = {"misfit_mrad": 1e3 * transmission.misfit_rad, "lost_mrad": 1e3 * lost}
            yield Reason("load_coasts", values)
        before, after = transmission.half_lag_rad
        if probability > LIKELY and abs(after - before) > LASTING * 0.5 * lost:
            yield Reason("lag_changes", {"before_mrad": 2e3 * before, "after_mrad": 2e3 * after})
        if transmission.counted > 2.0:
            yield Reason("misfit_repeats", {"times": transmission.counted})


def _misfit_lasts(transmission: Transmission) -> bool:
    """Whether a load with play leaves the flanks in ways that the model does not have."""
    half = 0.5 * float(np.median(transmission.draws["lost_motion_rad"]))
    return transmission.probability_of_play > LIKELY and transmission.misfit_rad > LASTING * half


def upper_bound_rad(transmission: Transmission) -> float:
    """Of δ, with 95 %, where all sizes up to it are alike beforehand.

    By the draws' prior it would be what that takes small gaps for: a bound is of the data. A load
    within a play goes no further than the play: one that the model does not follow shows
    its play in the range of the misfit, beyond that of white noise. What the prior takes for
    wind-up is within it.
    """
    delta = np.sort(transmission.draws["delta_rad"], axis=None)
    alike = np.cumsum(delta)
    bound = float(delta[np.searchsorted(alike, UPPER_BOUND_LEVEL * alike[-1])])
    return max(bound, hidden_rad(transmission.lag_rad, transmission.noise))


def channels_of(recording: Recording) -> Channels:
    """What the route takes of a recording: the torque, or the current in its place."""
    torque = recording.channels.get(MOTOR_TORQUE)
    if torque is None:
        torque = recording.channels.get(MOTOR_CURRENT)
    if torque is not None and float(np.ptp(torque)) == 0.0:
        torque = None
    return Channels(
        recording.time_s,
        recording.channels[MOTOR_POSITION],
        recording.channels[LOAD_POSITION],
        torque,
    )


def groups_of(
    transmission: Transmission, recording: Recording, *, at_output: bool = False
) -> dict[Group, object]:
    """Data of all groups of one snapshot."""
    draws = dict(transmission.draws)
    shape = draws["delta_rad"].shape
    # What one ampere makes is not known, so a current's compliance is no compliance.
    of_torque = MOTOR_TORQUE in recording.channels and not at_output
    compliance = draws.pop("compliance_rad_per_nm", np.full(shape, np.nan))
    draws["windup_rad_per_nm"] = compliance if of_torque else np.full(shape, np.nan)
    noise, paths = transmission.noise, transmission.paths
    own = {
        "forward": (paths.binned(paths.speed) > 0.0).astype(float),
        "model_rad": transmission.modelled_rad,
        "noise_sd_rad": noise.white_rad,
        "drift_sd_rad": noise.drift_rad,
    }
    sampled, budget = _sampled(transmission), _budget(transmission)
    return {
        POSTERIOR: draws,
        **shared.common_groups(recording, CHANNELS, sampled, budget),
        TRANSMISSION: (noise, transmission, own),
    }


def _sampled(transmission: Transmission) -> Diagnostics:
    """Of draws that are independent of one another."""
    chains, draws = transmission.draws["lost_motion_rad"].shape
    r_hat, ess = rank_r_hat_and_ess({"lost_motion_rad": transmission.draws["lost_motion_rad"]})
    return Diagnostics(r_hat, ess, 1.0, draws, np.ones(chains))


def _budget(transmission: Transmission) -> dict[str, float]:
    """Share of each source in the variance of δ."""
    held = 0.25 * float(np.var(transmission.draws["held_windup_rad"]))
    share = min(held / max(float(np.var(transmission.draws["delta_rad"])), held, 1e-300), 1.0)
    return {"noise": 1.0 - share, "held_windup": share}
