"""Averaging: the recorded speed is a mean over the time before each sample.

    ω_meas(t) = (θ_meas(t) − θ_meas(t − T))/T

An encoder that is differentiated shows it, with T its sampling period, and a trace that the drive
smooths. The controller does not see it. It lowers the ringing, and the gap that is read from it.
"""

from __future__ import annotations

from bayesbl.bench.effect_declaration import Amplitude, Effect

EFFECT = Effect(
    place=205,
    name="speed_averaging",
    sentence="The recorded speed is a mean over the time before each sample.",
    equation="ω_meas(t) = (θ_meas(t) − θ_meas(t − T))/T",
    parameters=(
        Amplitude(
            "time_s",
            "s",
            "time T that the speed is averaged over",
            high=0.02,
            typical=4e-3,
            not_negative=True,
            sought_from=2e-4,  # shorter ones do not show
        ),
    ),
    enters="measurement",
    data="ringing lower in the speed than in the current, and later",
    in_bench_file="If the drive smooths the speed that it records, say so in the bench file: "
    "speed_filter_s under [measurement]; if the speed is the differentiated encoder, "
    'speed_source = "encoder".',
)
