"""Delays of the speed loop, and changes of the channels by the recorder."""

from __future__ import annotations

import numpy as np

from bayesbl.bench.effect_declaration import (
    Effect,
    EffectParameter,
    Law,
    RigidLaw,
    amplitude,
    shape,
)

_LAG = amplitude(
    "time_s",
    "time constant T",
    high=0.01,
    typical=1e-3,
    sought_from=2e-4,  # shorter lags hardly show and cost the simulator tiny steps
)

# Nearly equivalent to a lag of the speed sensor together with a skew of the current. A rigid
# inverse comparison does not see it, because the recorded current is the actual one.
CURRENT_LOOP_LAG = Effect(
    place=170,
    name="current_loop_lag",
    sentence="The motor torque follows the controller with a first-order lag.",
    equation="T dτ_m/dt = τ_demand − τ_m",
    parameters=(_LAG,),
    enters="loop",
    data="ringing less damped; current behind speed",
    always_in=True,
    may_change=True,
)

# A filter between motor and controller. Nearly equivalent to a lag of the current loop with a skew.
SPEED_SENSOR_LAG = Effect(
    place=180,
    name="speed_sensor_lag",
    sentence="The speed that the controller sees and records is filtered.",
    equation="T dω_meas/dt = ω_m − ω_meas",
    parameters=(_LAG,),
    enters="loop",
    data="ringing less damped; pulse fronts rounded",
    always_in=True,
    may_change=True,
)

# At t = k T:  ω_k = (θ_k − θ_{k−1})/T,  e_k = ω_ref − ω_k,  I_k = I_{k−1} + T e_k
# K_t i = K_p e_k + K_i I_k  held from t = (k + d) T to (k + 1 + d) T
#
# The difference lags by half a period, the hold by another half, the computation by d periods. The
# loop is late by about (1 + d) T in all, and its gain is K_i T/2 higher. A dead time of bus or
# torque filter is part of d, which may be any number of periods. Drives report speed and current at
# their ticks, the current as its mean until the next tick, so it is d periods old; a recording
# begins with a tick.
# Most simulated controllers, and drives with a speed observer, use the instantaneous speed, which
# is T/2 less late: a share s of the instantaneous speed and 1 − s of the difference.
SAMPLED_CONTROL = Effect(
    place=195,
    name="sampled_control",
    sentence="A digital controller: it differentiates the encoder and holds its torque.",
    equation="K_t i = K_p e_k + K_i T Σ e_j, ω_k = s ω(kT) + (1 − s) (θ_k − θ_{k−1})/T, "
    "held from (k + d) T on",
    parameters=(
        amplitude(
            "period_s",
            "period T of the speed controller",
            high=4e-3,
            typical=1e-3,
            sought_from=1e-4,  # shorter periods do not show at the usual noise, and cost time
        ),
        shape(
            "delay_periods",
            "computing and dead time d in periods",
            high=128.0,  # 8 ms of a bus at 62.5 µs, the shortest period of a drive
            typical=1.0,
            neutral=1.0,
            bounded=True,
            # At 0 the torque acts at once, a value that no slope leads to. Then factors of four,
            # like the periods that a search tries: dead times from 0.4 to 14 ms.
            starts=(0.0, 4.0, 16.0),
        ),
        shape(
            "instant_share",
            "share s of the speed that is read at the instant",
            high=1.0,
            typical=0.5,
            bounded=True,
            starts=(1.0,),
        ),
    ),
    enters="loop",
    data="ringing less damped; current behind speed; steps if slower than the recorder",
)

_NOTHING: Law = lambda motion, bench, given: np.zeros_like(motion.speed)  # noqa: E731


def _skew(name: str, typical: float) -> EffectParameter:
    return amplitude(
        name,
        "time by which this channel lags the true signal",
        low=-0.01,
        high=0.01,
        typical=typical,
    )


# Caused by different filters and buses. A skew of all channels together is equivalent to a start
# angle, so a search in the loop frees only that of the current. In a rigid comparison, the skew
# shifts the motion, not the signal: its law adds nothing. Beside a digital controller, that of the
# current is always in: most drives measure it before the new torque acts, others log what they ask
# for. Otherwise its age would decide how late the loop is, and with it the gap.
CHANNEL_TIME_SKEW = Effect(
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
    sought_alone="current_s",
    may_change=True,
)

# It occurs with a differentiated encoder, where T is the sampling period, and with a trace that the
# drive smooths. The controller does not see it. It lowers the ringing, and with it the apparent
# gap.
SPEED_AVERAGING = Effect(
    place=205,
    name="speed_averaging",
    sentence="The recorded speed is a mean over the time before each sample.",
    equation="ω_meas(t) = (θ_meas(t) − θ_meas(t − T))/T",
    parameters=(
        amplitude(
            "time_s",
            "time T that the speed is averaged over",
            high=0.02,
            typical=4e-3,
            sought_from=2e-4,  # shorter times do not show
        ),
    ),
    enters="measurement",
    data="ringing lower in the speed than in the current, and later",
    always_in=True,
    may_change=True,
    in_bench_file="If the drive smooths the speed that it records, say so in the bench file: "
    "speed_filter_s under [measurement]; if the speed is the differentiated encoder, "
    'speed_source = "encoder".',
)
