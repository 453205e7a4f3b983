"""A simulation without noise is diagnosed as a recording is."""

from __future__ import annotations

import numpy as np
import pytest

from bayesbl.diagnosis.inference import (
    AffineModel,
    Candidate,
    Discrepancy,
    Inference,
    Look,
    Piece,
    Rows,
)

LAWS = ("coulomb", "viscous", "offset")


@pytest.mark.parametrize("noise_nm", [0.0, 1e-12, 1e-3])
@pytest.mark.parametrize("hidden", [(), ("coulomb",), LAWS])
def test_what_is_hidden_is_named_and_nothing_else(noise_nm, hidden):
    time_s = np.arange(2000) / 500.0
    speed = np.sin(2.0 * time_s) + 0.3 * np.sin(5.0 * time_s)
    inertia_nm = np.gradient(speed, time_s)
    columns = dict(zip(LAWS, (np.tanh(speed / 0.01), speed, np.ones(2000)), strict=True))
    measured = inertia_nm + sum(0.3 * columns[name] for name in hidden)
    measured = measured + noise_nm * np.random.default_rng(1).standard_normal(2000)
    candidates = tuple(
        Candidate(name, "effect", name, ("size",), (Look({}, column[:, None]),), 0.3)
        for name, column in columns.items()
    )
    drift = np.cos(np.pi * np.outer(time_s / time_s[-1], np.arange(1, 7))) / np.arange(1, 7)
    model = AffineModel(
        Rows((Piece("one", "motor_torque_nm", "used", time_s, measured),)),
        inertia_nm,
        {"inertia": inertia_nm},
        candidates,
        (Discrepancy("time", drift),),
    )
    assert set(Inference(model).posterior.named) == set(hidden)
