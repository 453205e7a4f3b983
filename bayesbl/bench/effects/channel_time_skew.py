"""Skew: one measured channel lags the others by a fixed time, as their filters and buses differ.

    channel(t) → channel(t − T)

All channels together are a start angle in disguise, so a search in the loop frees the current's
alone. In a rigid comparison the skew moves the motion, not the signal: its law adds nothing.
"""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import Amplitude, Effect, Law, RigidLaw

_NOTHING: Law = lambda motion, bench, given: np.zeros_like(motion.speed)  # noqa: E731


def _skew(name: str, typical: float) -> Amplitude:
    return Amplitude(
        name,
        "s",
        "time by which this channel lags the true signal",
        low=-0.01,
        high=0.01,
        typical=typical,
    )


EFFECT = Effect(
    place=200,
    name="channel_time_skew",
    sentence="One channel lags the others by a fixed time.",
    equation="channel(t) → channel(t − T)",
    parameters=(
        _skew("position_s", typical=1e-3),
        _skew("speed_s", typical=2e-3),
        _skew("current_s", typical=-1.5e-3),
    ),
    enters="measurement",
    data="channels whose pulses do not start together",
    torque=RigidLaw(signal=_NOTHING, amplitude="current_s", usual=0.2),
    position=RigidLaw(signal=_NOTHING, amplitude="position_s", usual=0.2),
    sought_alone="current_s",
)
