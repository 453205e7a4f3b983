"""Samples at a limit of the sensor: left out where they are strays, refused where peaks are cut.

A rail that the signal only jumps to (a dropout to 0, an overflow to 65535) says nothing about the
speed, and leaving it out costs nothing. A limit that cuts the peaks of the ringing off is another
matter: fitted without the clipped samples the amplitude changes, as the waveform is not exact (by 1
to 3 standard deviations on the example recordings).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bayesbl.errors import RecordingError
from bayesbl.recording.channels import CHANNELS
from bayesbl.recording.lost_samples import LONGEST_LOSS_S, MOST_LOST, runs
from bayesbl.recording.types import BoolArray, FloatArray, Recording

DETACHED_RANGES = 1.0
"""A rail lies farther from the other values than these lie from one another, by this factor."""


def without_rails(recording: Recording, channel: str) -> Recording:
    """The recording with samples at a detached rail bridged, excluded and noted.

    Raises
    ------
    RecordingError
        If the signal stays at a rail for too long, or for too many samples.
    """
    values = recording.channels[channel]
    at_rail = np.zeros(values.size, dtype=bool)
    rails: list[float] = []
    # Both ends may have one; a third value would be noise of another kind.
    for _ in range(2):
        rail = _detached_value(values[~at_rail])
        if rail is None:
            break
        rails.append(rail)
        at_rail |= values == rail
    if not rails:
        return recording
    begins, ends = runs(at_rail)
    longest = int(np.argmax(ends - begins))
    name = CHANNELS.get(channel, channel)
    rail_text = " and ".join(f"{rail:.6g}" for rail in rails)
    length = float(ends[longest] - begins[longest]) * recording.sampling_period_s
    if length > LONGEST_LOSS_S or at_rail.mean() > MOST_LOST:
        raise RecordingError(
            f"The {name} sits at a limit, far from all its other values.",
            file=recording.place,
            where=f"{channel} from {recording.time_s[begins[longest]]:.6g} s",
            found=f"{at_rail.sum()} samples at {rail_text}, up to {length:.3g} s in a row",
            expected=f"at most {LONGEST_LOSS_S:g} s in a row and {100.0 * MOST_LOST:g} % in all",
        )
    repaired = values.copy()
    repaired[at_rail] = np.interp(
        recording.time_s[at_rail], recording.time_s[~at_rail], values[~at_rail]
    )
    excluded = at_rail if recording.excluded is None else recording.excluded | at_rail
    note = (
        f"{at_rail.sum()} samples of the {name} are at {rail_text}, far from all others, "
        f"the first at {recording.time_s[begins[0]]:.6g} s: left out of the fit."
    )
    return replace(
        recording,
        channels={**recording.channels, channel: repaired},
        excluded=excluded,
        notes=(*recording.notes, note),
    )


def require_unclipped(recording: Recording, channel: str) -> None:
    """The signal does not run into a limit of its sensor or of its number format.

    A limited signal piles up on its very largest or smallest value. Three things must come
    together, at either end, to be called that:

    - at least 5 samples in a row sit exactly on the extreme value;
    - that value occurs more than 5 times as often as any of the 10 distinct values next to it;
    - there are at least 10 such values, so that the signal is not merely coarse.

    The second cannot hold for an encoder's quantised speed: its levels thin out towards the
    extremes, and even the flat top of a sine holds its highest level only 2.4 times as long as
    the next. A signal held for some samples repeats all its values alike.
    """
    values = recording.channels[channel]
    for side, signal in (("largest", values), ("smallest", -values)):
        count = _samples_at_limit(signal)
        if count:
            extreme = values.max() if side == "largest" else values.min()
            first, *_, last = recording.time_s[values == extreme]
            raise RecordingError(
                f"The {CHANNELS.get(channel, channel)} is cut off, or does not change.",
                file=recording.place,
                where=f"{channel} from {first:.6g} to {last:.6g} s",
                found=f"{count} samples exactly at the {side} value, {extreme:.6g}",
                expected="a signal that does not reach the limit of its sensor; record again with "
                "a wider range, or cut the file to a part that stays inside it",
            )


def _detached_value(values: FloatArray) -> float | None:
    """The extreme value that lies apart from all others; ``None`` if there is none."""
    levels = np.unique(values)
    if levels.size < 12:
        return None
    for extreme, near, far in ((-1, -2, 0), (0, 1, -1)):
        apart = abs(levels[extreme] - levels[near])
        if apart > DETACHED_RANGES * abs(levels[near] - levels[far]):
            return float(levels[extreme])
    return None


def _samples_at_limit(values: FloatArray) -> int:
    """Samples piled up on the maximum if it is a limit, else 0."""
    levels, counts = np.unique(values, return_counts=True)
    if levels.size < 11 or counts[-1] <= 5 * counts[-11:-1].max():
        return 0
    return int(counts[-1]) if _longest_run(values == levels[-1]) >= 5 else 0


def _longest_run(flags: BoolArray) -> int:
    begins, ends = runs(flags)
    return int((ends - begins).max(initial=0))
