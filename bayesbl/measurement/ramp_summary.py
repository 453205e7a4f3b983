"""``summary.json`` of a snapshot that was measured by torque ramps."""

from __future__ import annotations

import numpy as np

from bayesbl.measurement.stored_snapshot import StoredSnapshot
from bayesbl.measurement.summary_types import SnapshotSummary

QUANTITIES = (
    "lost_motion_rad",
    "compliance_rad_per_nm",
    "stiffness_nm_per_rad",
    "friction_torque_nm",
    "held_windup_rad",
)

PRELOAD = "preload_torque_nm"


def summarise_ramps(stored: StoredSnapshot) -> SnapshotSummary:
    """The contract's keys, and beside them what the play was read from."""
    cycles = stored.groups["cycles"]
    used = stored.values("cycles", "used") > 0.5
    file = stored.values("cycles", "file")
    found = {name: stored.interval("posterior", name) for name in QUANTITIES}
    # All NaN where no flank is seen to lift.
    if stored.values("posterior", PRELOAD).size:
        found[PRELOAD] = stored.interval("posterior", PRELOAD)
    return {
        "route": "torque_ramp",
        "routes": {"torque_ramp": {"delta_rad": stored.delta_rad, "reason": stored.reason}},
        "delta_rad": stored.delta_rad,
        "amplitude_rpm": None,
        "lost_motion_rad": found["lost_motion_rad"],
        "lost_motion_torque_nm": float(cycles["lost_motion_torque_nm"]),
        "compliance_rad_per_nm": found["compliance_rad_per_nm"],
        "stiffness_nm_per_rad": found["stiffness_nm_per_rad"],
        "friction_torque_nm": found["friction_torque_nm"],
        "held_windup_rad": found["held_windup_rad"],
        "preload_torque_nm": found.get(PRELOAD),
        "preloaded": float(cycles["probability_of_play"]) <= 0.5 and not stored.withheld,
        "probability_of_play": float(cycles["probability_of_play"]),
        "relative_compliance": float(cycles["relative_compliance"]),
        "ramps": {
            "positions": int(np.unique(file[used]).size),
            "cycles": int(used.sum()),
            "torque_nm": float(stored.values("cycles", "amplitude_nm")[used].mean()),
            "width_rad": [
                float(stored.values("cycles", "width_rad")[used & (file == n)].mean())
                for n in np.unique(file[used])
            ],
        },
        "parameters": {
            **found,
            "width_rad": stored.interval("posterior", "width_rad"),
            "scatter_rad": stored.interval("posterior", "scatter_rad"),
        },
        "optimum": {},
        "noise": {
            "kind": "repeated",
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
