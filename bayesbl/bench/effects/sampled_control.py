"""A controller that is sampled, as every digital drive's is.

    at t = k T:  ω_k = (θ_k − θ_{k−1})/T,  e_k = ω_ref − ω_k,  I_k = I_{k−1} + T e_k
    K_t i = K_p e_k + K_i I_k  held from t = (k + d) T to (k + 1 + d) T

The difference lags by half a period, what is held by another half, the computation by d periods: in
all about (1 + d) T that the loop is late, and its gain is K_i T/2 higher. A dead time of bus or
torque filter is part of d, which may be any number of periods. Drives show speed and current as
they are at their ticks, with d above one the mean current from there to the next; a recording
begins with a tick.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect, Shape

EFFECT = Effect(
    place=195,
    name="sampled_control",
    sentence="A digital controller: it differentiates the encoder and holds its torque.",
    equation="K_t i = K_p e_k + K_i T Σ e_j, ω_k = (θ_k − θ_{k−1})/T, held from (k + d) T on",
    parameters=(
        Amplitude(
            "period_s",
            "s",
            "period T of the speed controller",
            high=4e-3,
            typical=1e-3,
            not_negative=True,
            sought_from=1e-4,  # at the usual noise shorter ones do not show, and cost time
        ),
        Shape(
            "delay_periods",
            "",
            "computing and dead time d in periods",
            high=128.0,  # 8 ms of a bus at 62.5 µs, the shortest period of a drive
            typical=1.0,
            neutral=1.0,
            bounded=True,
            # At 0 the torque is out at once, which no slope leads to. Then each four times as far,
            # as the periods that a search tries: dead times from 0.4 to 14 ms.
            starts=(0.0, 4.0, 16.0),
        ),
    ),
    enters="loop",
    data="ringing less damped; current behind speed; steps if slower than the recorder",
)
