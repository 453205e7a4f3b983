"""The configurations for recordings of real machines, where those recordings are.

They stand in ``configs/recordings/measured`` or in the folder that BAYESBL_MEASURED names.
"""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest
from places import CONFIGS, RECORDINGS

from bayesbl.cli import status

MEASURED = Path(os.environ.get("BAYESBL_MEASURED", RECORDINGS / "measured"))


def run(name: str, folder: Path, *changes: tuple[str, str]) -> dict[str, Any]:
    """Run a copy of a configuration on the recordings; its summary."""
    text = (CONFIGS / f"{name}.toml").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    files = [line.split('"')[1] for line in text.splitlines() if line.startswith("file = ")]
    missing = [Path(file).name for file in files if not (MEASURED / Path(file).name).is_file()]
    if missing:
        pytest.skip(f"measured recordings are absent: {', '.join(missing)} in {MEASURED}")
    for bench in CONFIGS.glob("bench_*.toml"):
        if not (folder / bench.name).exists():
            shutil.copy(bench, folder)
    text = text.replace("recordings/measured/", f"{MEASURED.absolute()}/")
    text = text.replace("../results/", "results/")
    (folder / f"{name}.toml").write_text(text)
    assert status(["run", str(folder / f"{name}.toml"), "--force"]) == 0
    (written,) = (folder / "results").rglob("summary.json")
    summary: dict[str, Any] = json.loads(written.read_text())
    return summary


def named(summary: dict[str, Any]) -> list[str]:
    return [effect["name"] for effect in summary["effects"]]


def disagreement(summary: dict[str, Any], use: str) -> dict[str, float]:
    found: dict[str, float] = summary["disagreement"]["over_all"][use]
    return found


def test_kuka_axis_lacks_coulomb_and_viscous_friction_and_a_ripple(tmp_path: Path) -> None:
    summary = run("diagnose_kuka_axis1", tmp_path)
    effects = dict(zip(named(summary), summary["effects"], strict=True))
    friction = {"motor_coulomb_friction", "motor_viscous_friction"}
    assert set(effects) == friction | {"motor_torque_ripple"}
    ripple = effects["motor_torque_ripple"]["parameters"]
    assert ripple["order"]["median"] == pytest.approx(8.0, abs=0.01)
    assert ripple["torque_nm"]["median"] == pytest.approx(0.5, abs=0.1)
    assert not any("stribeck" in a for e in summary["effects"] for a in e["indistinguishable_from"])
    assert disagreement(summary, "held_out")["before"] > 2.7
    assert disagreement(summary, "held_out")["after"] < 0.78


def test_kuka_axis_with_both_frictions_in_its_bench_is_within_085_on_the_third_recording(
    tmp_path: Path,
) -> None:
    first = run("diagnose_kuka_axis1", tmp_path)
    found = {e["name"]: e["parameters"] for e in first["effects"]}
    bench = (CONFIGS / "bench_kuka_axis1.toml").read_text()
    for name in ("motor_coulomb_friction", "motor_viscous_friction"):
        ((key, interval),) = found[name].items()
        bench += f'[[effects]]\nname = "{name}"\n'
        bench += f"parameters = {{{key} = {{value = {interval['median']}}}}}\n"
    (tmp_path / "bench_kuka_axis1.toml").write_text(bench)
    second = run("diagnose_kuka_axis1", tmp_path)
    assert named(second) == ["motor_torque_ripple"]
    assert disagreement(second, "held_out")["before"] < 0.85


def test_pendulum_is_stopped_by_both_frictions(tmp_path: Path) -> None:
    summary = run("diagnose_pendulum", tmp_path)
    assert set(named(summary)) == {"motor_coulomb_friction", "motor_viscous_friction"}
    assert disagreement(summary, "used")["after"] < 0.015
    assert disagreement(summary, "held_out")["after"] < 0.045


def test_cogging_is_named_as_torque_ripple(tmp_path: Path) -> None:
    summary = run("diagnose_cogging", tmp_path)
    assert named(summary)[0] == "motor_torque_ripple"
    ripple = summary["effects"][0]["parameters"]
    assert ripple["order"]["median"] == pytest.approx(7.0, abs=0.1)
    for use in ("used", "held_out"):
        assert disagreement(summary, use)["after"] < 0.5 * disagreement(summary, use)["before"]
