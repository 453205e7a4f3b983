"""A measured joint as MuJoCo has it: the same joint, and as uncertain."""

from __future__ import annotations

import json
import math
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray as xr
from places import AFTER, BEFORE, CONFIGS

import bayesbl
from bayesbl.bench.bench import Bench, BenchEffect, EffectParameterValue
from bayesbl.bench.mjcf import mjcf
from bayesbl.bench.simulation import simulate_channels
from bayesbl.config.bench import load_bench
from bayesbl.errors import BenchError, ConfigError, ResultError
from bayesbl.results.store import write_tree
from bayesbl.runs.export import export
from bayesbl.units import STANDARD_GRAVITY

GAP_RAD = 8e-4
FRICTION = {
    "motor_viscous_friction": ("coefficient_nm_s_per_rad", 2e-3),
    "motor_coulomb_friction": ("torque_nm", 0.3),
    "load_viscous_friction": ("coefficient_nm_s_per_rad", 60.0),
    "load_coulomb_friction": ("torque_nm", 40.0),
}


def joint(*, friction: bool = False, **parameters: float) -> Bench:
    bench = replace(load_bench(CONFIGS / "bench.toml"), gap_form="dead_zone")
    effects = [
        BenchEffect(name, {parameter: EffectParameterValue(size)})
        for name, (parameter, size) in FRICTION.items()
        if friction
    ]
    return bench.with_parameters(**parameters).with_effects(*effects)


LIGHT = joint(
    load_inertia_kg_m2=0.08, motor_inertia_kg_m2=5e-6, gravity_torque_nm=4.0,
    shaft_stiffness_nm_per_rad=2e4, shaft_damping_nm_s_per_rad=3.0,
    speed_gain_nm_s_per_rad=5e-4, integral_gain_nm_per_rad=0.01,
)  # fmt: skip
"""With the steps that a large joint needs, MuJoCo's speed is off by 2.6 % of its scatter."""


def turned_by_mujoco(bench: Bench, samples: int, hz: float) -> Any:
    """Motor speed, rpm, of the second rotation under the bench's controller."""
    mujoco = pytest.importorskip("mujoco")
    model = mujoco.MjModel.from_xml_string(mjcf(bench, GAP_RAD))
    data = mujoco.MjData(model)
    ratio, step_s = bench.value("gear_ratio"), model.opt.timestep
    gains = bench.value("speed_gain_nm_s_per_rad"), bench.value("integral_gain_nm_per_rad")
    wanted = bench.value("reference_speed_rpm") * math.pi / 30.0
    data.qvel[0], summed = wanted / ratio, 0.0
    steps = int(2.05 * bench.rotation_period_s() / step_s)
    angle, speed = np.empty(steps), np.empty(steps)
    for k in range(steps):
        error = wanted - data.qvel[0] * ratio
        summed += error * step_s
        data.ctrl[0] = gains[0] * error + gains[1] * summed
        angle[k], speed[k] = data.qpos.sum(), data.qvel[0] * ratio
        mujoco.mj_step(model, data)
    begin = int(np.argmin(np.abs(angle - 2.0 * math.pi)))
    time = np.arange(steps) * step_s
    return np.interp(time[begin] + np.arange(samples) / hz, time, speed) * 30.0 / math.pi


@pytest.mark.parametrize(
    "bench",
    [
        joint(),
        joint(friction=True),
        joint(gravity_angle_rad=0.4),
        LIGHT,
    ],
    ids=["bare", "with friction", "gravity turned", "light and stiff"],
)
def test_mujoco_turns_the_exported_joint_as_the_bench_turns(bench: Bench) -> None:
    """Two solvers of one joint: their motor speeds differ by less than one part in a hundred."""
    samples, hz = 3500, 1000.0
    own = simulate_channels(bench.vector(gap_rad=GAP_RAD), samples, hz)[0, 1]
    difference = turned_by_mujoco(bench, samples, hz) - own
    assert np.std(difference) < 0.01 * np.std(own)


def test_the_model_has_the_bench_s_inertia_weight_and_gap() -> None:
    bench = joint(gravity_angle_rad=0.3)
    root = ET.fromstring(mjcf(bench, GAP_RAD))

    def numbers(path: str, name: str) -> list[float]:
        element = root.find(f".//body[@name='{path}")
        assert element is not None
        return [float(text) for text in element.attrib[name].split()]

    assert numbers("load']/joint", "range") == [-GAP_RAD, GAP_RAD]
    x, _, z = numbers("load']/inertial", "pos")
    (mass,) = numbers("load']/inertial", "mass")
    own = [numbers(f"{body}']/inertial", "diaginertia")[0] for body in ("motor", "shaft", "load")]
    inertia = bench.value("load_inertia_kg_m2")
    assert sum(own) + mass * (x**2 + z**2) == pytest.approx(inertia, rel=1e-7)
    torque = mass * STANDARD_GRAVITY * math.hypot(x, z)
    assert torque == pytest.approx(bench.value("gravity_torque_nm"), rel=1e-7)
    assert math.atan2(-x, -z) == pytest.approx(0.3, rel=1e-7)
    of_motor = bench.value("motor_inertia_kg_m2") * bench.value("gear_ratio") ** 2
    assert numbers("motor']/joint", "armature") == [pytest.approx(of_motor, rel=1e-7)]


def test_what_mjcf_cannot_say_is_listed() -> None:
    bench = joint().with_effects(
        BenchEffect("shaft_hysteresis", {"torque_nm": EffectParameterValue(1.0)})
    )
    assert "Not written: shaft_hysteresis" in mjcf(bench, GAP_RAD)
    # Also what a recording showed and the bench has not.
    found = {"gap_damping__coefficient_nm_s_per_rad": 20.0}
    assert "Not written: gap_damping" in mjcf(joint(), GAP_RAD, found)
    with pytest.raises(BenchError, match="no gap"):
        mjcf(load_bench(CONFIGS / "bench_pendulum.toml"), GAP_RAD)


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("fit")
    fitted = bayesbl.fit(BEFORE, bench=CONFIGS / "joint.toml", route="direct", seed=1, workers=1)
    write_tree(fitted.to_datatree(), folder / "result.nc")
    return folder


def test_the_table_has_the_draws_and_the_model_their_median(result: Path, tmp_path: Path) -> None:
    model, table = export(result, CONFIGS / "joint.toml", tmp_path / "out")
    drawn = np.genfromtxt(table, delimiter=",", names=True)
    posterior = bayesbl.read_result(result)
    assert np.array_equal(drawn["gap_rad"], posterior["gap/delta_rad"].values.ravel())
    told = posterior["direct/posterior/shaft_stiffness_nm_per_rad"].values.ravel()
    assert np.array_equal(drawn["shaft_stiffness_nm_per_rad"], told)
    assert np.ptp(drawn["gear_ratio"]) == 0.0
    hinge = next(j for j in ET.parse(model).iter("joint") if j.get("name") == "gap")
    low, high = map(float, hinge.attrib["range"].split())
    assert high == -low == pytest.approx(float(np.median(drawn["gap_rad"])), rel=1e-8)


def test_another_bench_and_existing_files_are_refused(result: Path, tmp_path: Path) -> None:
    with pytest.raises(ResultError, match="another bench"):
        export(result, CONFIGS / "bench_precision.toml", tmp_path)
    with pytest.raises(ConfigError, match="no gap"):
        export(result, CONFIGS / "bench_pendulum.toml", tmp_path)
    export(result, CONFIGS / "joint.toml", tmp_path)
    with pytest.raises(ResultError, match="exists already"):
        export(result, CONFIGS / "joint.toml", tmp_path)
    assert len(export(result, CONFIGS / "joint.toml", tmp_path, force=True)) == 2


def test_the_bench_is_that_of_the_result_unless_another_is_given(
    result: Path, tmp_path: Path
) -> None:
    files = export(result, None, tmp_path / "out")
    given = export(result, CONFIGS / "joint.toml", tmp_path / "given")
    assert [f.read_text() for f in files] == [f.read_text() for f in given]
    tree = bayesbl.read_result(result).to_datatree()
    tree.attrs["config"] = tree.attrs["config"].replace("joint.toml", "moved.toml")
    write_tree(tree, tmp_path / "result.nc")
    with pytest.raises(ResultError, match=r"moved.toml.*--bench FILE"):
        export(tmp_path, None, tmp_path / "out")


def test_only_snapshots_with_a_gap_are_written(tmp_path: Path) -> None:
    """Of two recordings by the amplitude and the paper's curve, one with no gap to report."""
    both = bayesbl.compare(BEFORE, AFTER, curve="published", seed=1, workers=1).to_datatree()
    summary = json.loads(both.attrs["summary"])
    withheld(summary["snapshots"][0], both, summary)
    write_tree(both, tmp_path / "result.nc")
    written = export(tmp_path, CONFIGS / "joint.toml", tmp_path / "out")
    assert [path.name for path in written] == ["wear_after.xml", "wear_after.csv"]
    withheld(summary["snapshots"][1], both, summary)
    write_tree(both, tmp_path / "result.nc")
    with pytest.raises(ResultError, match="reports no gap"):
        export(tmp_path, CONFIGS / "joint.toml", tmp_path / "other")


def withheld(snapshot: Any, tree: xr.DataTree, summary: Any) -> None:
    """Have a result withhold the gap of a snapshot; its draws stay where they are."""
    for part in (snapshot, *snapshot["routes"].values()):
        part["delta_rad"] = None
    tree.attrs["summary"] = json.dumps(summary)
