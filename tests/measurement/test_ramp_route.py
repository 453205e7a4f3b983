"""Torque ramps from files to the answer: packed files, coarse clocks, units, sides, refusals."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

import numpy as np
import pytest
from quick import without_figures
from recording_files import write_csv

from bayesbl.cli import status
from bayesbl.config.loading import dump_config, load_config
from bayesbl.errors import ConfigError, RecordingError
from bayesbl.recording.channels import ColumnSpec
from bayesbl.recording.guessing import guess_columns
from bayesbl.recording.readers import read_recording, read_table

pytestmark = pytest.mark.long

GAP, FRICTION, COMPLIANCE = 6e-3, 1.0, 4e-4
TICK_S = 0.0156


def ramps(gap=GAP, amplitudes=(3.0, 3.0, 3.0, 3.0, 15.0, 15.0), seed=0, scatter=0.01):
    """Time, torque and position of a play operator, its friction another in every cycle."""
    generator = np.random.default_rng(seed)
    phase = np.arange(600) / 600
    torque, position, at = [], [], 0.0
    grid = np.linspace(-0.2, 0.2, 40_001)
    force = (np.maximum(grid - gap, 0.0) - np.maximum(-grid - gap, 0.0)) / COMPLIANCE + 1e-9 * grid
    for amplitude in amplitudes:
        friction = FRICTION * (1.0 + scatter * generator.standard_normal())
        for value in amplitude * 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * phase)):
            low, high = np.interp((value - friction, value + friction), force, grid)
            at = min(max(at, low), high)
            torque.append(value)
            position.append(at)
    time = np.floor(np.arange(len(torque)) * 0.0025 / TICK_S) * TICK_S
    noise = 0.03 * generator.standard_normal(len(torque))
    return time, np.array(torque) + noise, np.array(position)


def write(path: Path, ratio: float = 1.0, **joint) -> Path:
    time, torque, position = ramps(**joint)
    columns = {
        "time_s": time,
        "motor_position_rad": position * ratio,
        "motor_torque_nm": torque / ratio,
    }
    if path.suffix != ".gz":
        return write_csv(path, columns)
    plain = write_csv(path.with_suffix(""), columns)
    path.write_bytes(gzip.compress(plain.read_bytes()))
    plain.unlink()
    return path


def run(folder: Path, *arguments: str) -> tuple[int, dict]:
    out = folder / "out"
    with without_figures():
        code = status([*arguments, "--out", str(out), "--force", "--workers", "1"])
    summary = out / "summary.json"
    return code, json.loads(summary.read_text()) if summary.exists() else {}


def test_a_packed_file_is_the_file(tmp_path: Path) -> None:
    packed = read_recording(write(tmp_path / "a.csv.gz"))
    plain = read_recording(write(tmp_path / "a.csv"))
    assert packed.name == plain.name == "a"
    for name, values in plain.channels.items():
        np.testing.assert_array_equal(packed.channels[name], values)


def test_a_damaged_packed_file_is_refused_by_name(tmp_path: Path, capsys) -> None:
    (tmp_path / "a.csv.gz").write_bytes(b"no gzip at all")
    code, _ = run(tmp_path, "fit", str(tmp_path / "a.csv.gz"), "--route", "torque_ramp")
    assert code == 2
    assert "cannot be unpacked" in capsys.readouterr().err


def test_a_coarse_clock_is_spread_and_noted(tmp_path: Path) -> None:
    recording = read_recording(write(tmp_path / "a.csv"))
    assert np.all(np.diff(recording.time_s) > 0.0)
    true = np.arange(recording.samples) * 0.0025
    assert np.abs(recording.time_s - true).max() < TICK_S
    assert any("ticks" in note for note in recording.notes)


def test_one_repeated_stamp_is_still_an_error(tmp_path: Path) -> None:
    time, torque, _ = ramps()
    time = np.arange(time.size) * 0.0025
    time[100] = time[99]
    path = write_csv(tmp_path / "a.csv", {"time_s": time, "motor_torque_nm": torque})
    with pytest.raises(Exception, match="does not advance"):
        read_recording(path)


def test_ramps_need_no_clock_but_recordings_do(tmp_path: Path) -> None:
    _, torque, position = ramps()
    columns = {"motor_position_rad": position, "motor_torque_nm": torque}
    timed = write_csv(tmp_path / "a.csv", {"time_s": np.arange(torque.size) * 0.0025, **columns})
    bare = write_csv(tmp_path / "a_bare.csv", columns)
    found = []
    for file in (timed, bare):
        code, summary = run(tmp_path, "fit", str(file), "--route", "torque_ramp")
        assert code == 0
        found.append(summary["delta_rad"])
    assert found[0] == found[1]
    with pytest.raises(RecordingError, match="time_s"):
        read_recording(bare)


def test_pauses_and_lost_samples_between_ramps_do_no_harm(tmp_path: Path) -> None:
    time, torque, position = ramps()
    time = np.arange(time.size) * 0.0025
    columns = {"time_s": time, "motor_position_rad": position, "motor_torque_nm": torque}
    whole = write_csv(tmp_path / "a.csv", columns)
    columns["time_s"] = time + 20.0 * (np.arange(time.size) >= 1800)
    columns["motor_position_rad"] = np.where(np.arange(time.size) % 97 == 5, np.nan, position)
    holes = write_csv(tmp_path / "b.csv", columns)
    found = []
    for file in (whole, holes):
        code, summary = run(tmp_path, "fit", str(file), "--route", "torque_ramp")
        assert code == 0
        found.append(summary["delta_rad"]["median"])
    assert found[1] == pytest.approx(found[0], rel=0.01)


def test_the_motors_side_and_the_outputs_give_one_answer(tmp_path: Path) -> None:
    at_output = write(tmp_path / "a.csv")
    at_motor = write(tmp_path / "b.csv", ratio=50.0)
    found = []
    for file, ratio in ((at_output, "1"), (at_motor, "50")):
        code, summary = run(
            tmp_path, "fit", str(file), "--route", "torque_ramp", "--gear-ratio", ratio
        )
        assert code == 0
        found.append(summary)
    first, second = found
    for key in ("delta_rad", "friction_torque_nm", "compliance_rad_per_nm", "lost_motion_rad"):
        assert second[key]["median"] == pytest.approx(first[key]["median"], rel=1e-3)
    width = first["parameters"]["width_rad"]["median"]
    assert width == pytest.approx(2.0 * (GAP + COMPLIANCE * FRICTION), rel=0.02)
    assert first["delta_rad"]["low"] < GAP < first["delta_rad"]["high"]
    assert first["friction_torque_nm"]["median"] == pytest.approx(FRICTION, rel=0.1)
    assert first["preload_torque_nm"]["high"] == 0.0
    assert first["held_windup_rad"]["median"] == pytest.approx(COMPLIANCE * FRICTION, rel=0.6)
    assert first["route"] == "torque_ramp"


def test_files_of_positions_are_compared_with_dates_and_a_limit(tmp_path: Path) -> None:
    states = {"new": (5e-3, 6e-3, 7e-3), "worn": (8e-3, 9e-3, 10e-3)}
    entries = ""
    for date, (state, gaps) in zip(("2025-01-01", "2026-01-01"), states.items(), strict=True):
        files = [
            write(tmp_path / f"{state}_{n}.csv.gz", gap=gap, seed=n).name
            for n, gap in enumerate(gaps)
        ]
        entries += f'[[recordings]]\nname = "{state}"\ndate = {date}\nfiles = {files}\n'
    config = tmp_path / "ramps.toml"
    config.write_text(
        'schema = 1\nkind = "compare"\n[joint]\ngear_ratio = 1.0\nlimit_rad = 1.2e-2\n'
        f'rated_torque_nm = 20.0\n[estimator]\nroute = "torque_ramp"\n{entries}'
    )
    loaded = load_config(config)
    again = tmp_path / "again.toml"
    again.write_text(dump_config(loaded))
    assert load_config(again) == loaded
    code, summary = run(tmp_path, "run", str(config))
    assert code == 0
    new, worn = summary["snapshots"]
    assert new["delta_rad"]["low"] < 6.4e-3 < new["delta_rad"]["high"]
    assert new["ramps"]["positions"] == 3
    assert new["lost_motion_torque_nm"] == pytest.approx(0.6)
    assert sum(new["budget"].values()) == pytest.approx(1.0)
    # The pattern around the turn stayed: the change is sharper than either gap.
    change = summary["change_rad"]
    assert change["low"] < 3e-3 < change["high"]
    gap_width = worn["delta_rad"]["high"] - worn["delta_rad"]["low"]
    assert change["high"] - change["low"] < gap_width
    assert summary["probability_increase"] > 0.95
    assert summary["wear"]["rate"]["median"] == pytest.approx(3e-3, rel=0.2)


def test_a_preloaded_joint_is_answered_by_no_play_and_a_bound(tmp_path: Path, capsys) -> None:
    file = write(tmp_path / "a.csv", gap=-2.0 * COMPLIANCE)
    code, summary = run(tmp_path, "fit", str(file), "--route", "torque_ramp", "--gear-ratio", "1")
    assert code == 0
    assert summary["preloaded"]
    assert summary["delta_rad"]["high"] < COMPLIANCE * FRICTION
    assert summary["preload_torque_nm"]["median"] == pytest.approx(4.0, rel=0.05)
    assert "both flanks carry the torque up to" in " ".join(capsys.readouterr().out.split())


def test_a_preload_beyond_what_the_ramps_tell_has_no_torque(tmp_path: Path, capsys) -> None:
    """One flank lifts at 12 N m, and the ramps go to 15."""
    file = write(tmp_path / "a.csv", gap=-6.0 * COMPLIANCE)
    code, summary = run(tmp_path, "fit", str(file), "--route", "torque_ramp", "--gear-ratio", "1")
    assert code == 0
    assert summary["preloaded"]
    assert summary["preload_torque_nm"] is None
    assert "the preload is unknown" in " ".join(capsys.readouterr().out.split())


def test_ramps_that_do_not_tell_are_withheld_with_the_torque_to_ramp_to(tmp_path: Path) -> None:
    file = write(tmp_path / "a.csv", amplitudes=[3.5] * 3)
    code, summary = run(tmp_path, "fit", str(file), "--route", "torque_ramp", "--gear-ratio", "1")
    assert code == 3
    assert summary["delta_rad"] is None
    assert "to at least 11 N m" in summary["reason"]["text"]


def test_a_weight_is_no_play_of_none_with_one_large_cycle(tmp_path: Path) -> None:
    """It pushes the joint over its play before the torque is at zero."""
    time, torque, position = ramps(amplitudes=(8.0, 8.0, 8.0, 30.0))
    columns = {
        "time_s": time, "motor_position_rad": position, "motor_torque_nm": torque + 2.5
    }  # fmt: skip
    file = write_csv(tmp_path / "a.csv", columns)
    code, summary = run(tmp_path, "fit", str(file), "--route", "torque_ramp", "--gear-ratio", "1")
    assert code == 0
    assert not summary["preloaded"]
    assert summary["delta_rad"]["low"] < GAP < summary["delta_rad"]["high"]


def test_ramps_of_one_size_are_withheld_as_held_windup_is_unknown(tmp_path: Path) -> None:
    file = write(tmp_path / "a.csv", amplitudes=[3.0] * 4)
    code, summary = run(tmp_path, "fit", str(file), "--route", "torque_ramp", "--gear-ratio", "1")
    assert code == 3
    assert summary["held_windup_rad"]["high"] > 0.9 * GAP
    assert "to at least 9.1 N m" in summary["reason"]["text"]


def test_growth_is_not_told_from_two_positions_of_the_turn(tmp_path: Path) -> None:
    """A gap of 6 mrad here and 7 mrad elsewhere may be the same joint twice."""
    first, here = write(tmp_path / "a.csv"), write(tmp_path / "b.csv", gap=7e-3, seed=1)
    lines = [line.split(",") for line in here.read_text().splitlines()]
    moved = [f"{t},{float(x) + 0.3!r},{n}" for t, x, n in lines[1:]]
    there = tmp_path / "c.csv"
    there.write_text("\n".join([",".join(lines[0]), *moved]) + "\n")
    found = []
    for second in (here, there):
        code, summary = run(tmp_path, "compare", str(first), str(second), "--route", "torque_ramp")
        assert code == 0
        found.append(summary)
    assert found[0]["probability_increase"] > 0.99
    assert 0.5 < found[1]["probability_increase"] < 0.95


def test_one_position_does_not_count_twice(tmp_path: Path, capsys) -> None:
    content = write(tmp_path / "a.csv", amplitudes=(3.0, 3.0)).read_bytes()
    (tmp_path / "b.csv").write_bytes(content)
    config = tmp_path / "c.toml"
    config.write_text(
        'schema = 1\nkind = "fit"\n[estimator]\nroute = "torque_ramp"\n'
        '[[recordings]]\nfiles = ["a.csv", "b.csv"]\n'
    )
    code, _ = run(tmp_path, "run", str(config))
    assert code == 2
    assert "are identical" in capsys.readouterr().err


def test_a_torque_that_goes_one_way_is_refused(tmp_path: Path, capsys) -> None:
    time, torque, position = ramps()
    columns = {
        "time_s": time, "motor_position_rad": position, "motor_torque_nm": np.abs(torque)
    }  # fmt: skip
    file = write_csv(tmp_path / "a.csv", columns)
    code, _ = run(tmp_path, "fit", str(file), "--route", "torque_ramp")
    assert code == 2
    assert "to the other side" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ('bench = "a.csv"', "bench: This has no use"),
        ('route = "amplitude"', "files: This has no use"),
    ],
)
def test_what_does_not_go_with_ramps_is_refused(tmp_path: Path, changed: str, words: str) -> None:
    for name in ("a.csv", "b.csv"):
        write(tmp_path / name, amplitudes=(3.0,))
    route = "" if changed.startswith("route") else 'route = "torque_ramp"\n'
    config = tmp_path / "c.toml"
    config.write_text(
        f'schema = 1\nkind = "fit"\n[estimator]\n{route}{changed}\n'
        '[[recordings]]\nfiles = ["a.csv", "b.csv"]\n'
    )
    with pytest.raises(ConfigError, match=words):
        load_config(config)


def test_init_takes_position_and_torque_without_a_speed_for_ramps(tmp_path: Path) -> None:
    time, torque, position = ramps()
    columns = {"TIME": time, "POSITION [rad]": position, "TORQUE [N m]": torque}
    file = write_csv(tmp_path / "a.csv", columns)
    assert guess_columns(read_table(file)).route == "torque_ramp"
    config = tmp_path / "a.toml"
    assert status(["init", str(file), "--out", str(config)]) == 0
    loaded = load_config(config)
    assert loaded.estimator.route == "torque_ramp"
    assert loaded.column_specs["motor_torque_nm"] == ColumnSpec("TORQUE [N m]", "N m")


def test_a_position_without_a_unit_is_asked_for_and_never_taken_as_radians(
    tmp_path: Path, capsys
) -> None:
    time, torque, position = ramps()
    turns = position / (2.0 * np.pi)
    file = write_csv(tmp_path / "a.csv", {"TIME": time, "POSITION": turns, "TORQUE [N m]": torque})
    config = tmp_path / "a.toml"
    assert status(["init", str(file), "--out", str(config)]) == 2
    assert "cannot run yet" in capsys.readouterr().err
    code, _ = run(tmp_path, "run", str(config))
    assert code == 2
    assert "motor_position_rad" in capsys.readouterr().err
    told = config.read_text().replace('"?"', '"rev"')
    config.write_text(told.replace("# motor_position_rad", "motor_position_rad"))
    code, summary = run(tmp_path, "run", str(config))
    assert code == 0
    assert summary["delta_rad"]["median"] == pytest.approx(GAP, rel=0.1)
