"""Limits as makers state them: every form means one gap, and is read back as it was written."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from places import ROOT

from bayesbl.config.loading import config_from_options, dump_config, load_config
from bayesbl.config.measurement import Limit
from bayesbl.errors import ConfigError
from bayesbl.measurement.compatibility import limit_rad_of
from bayesbl.presentation.answer import in_unit_of_limit

ANGLES = ("rad", "mrad", "deg", "arcmin", "arcsec")
RECORDING = ROOT / "configs/recordings/wear_before.csv"
SIZES = st.floats(1e-6, 1e6)


@st.composite
def limits(draw: st.DrawFn) -> Limit:
    unit = draw(st.sampled_from((*ANGLES, "mm")))
    kind = draw(st.sampled_from(("delta", "play", "lost_motion")))
    radius = draw(st.floats(1e-3, 1e3)) if unit == "mm" else None
    share = draw(st.integers(1, 999)) / 1000.0 if kind == "lost_motion" else None
    return Limit(value=draw(SIZES), unit=unit, of=kind, at_m=radius, at_torque_share=share)


@given(limits())
def test_what_is_written_is_read_back(limit: Limit) -> None:
    read = Limit.model_validate(str(limit))
    assert (read.value, read.unit, read.of, read.at_m) == (
        limit.value,
        limit.unit,
        limit.of,
        limit.at_m,
    )
    assert read.at_torque_share == pytest.approx(limit.at_torque_share)


@given(limits(), st.floats(0.0, 0.9))
def test_a_gap_at_its_limit_is_stated_as_the_limit(limit: Limit, share: float) -> None:
    windup = 0.0
    if limit.of == "lost_motion":
        windup = share * 2.0 * limit.delta_rad()
    assert limit.stated(limit.delta_rad(windup), windup) == pytest.approx(limit.value)


@given(SIZES, st.sampled_from(ANGLES))
def test_play_is_twice_the_gap_and_lost_motion_no_less(value: float, unit: str) -> None:
    delta, play = (Limit(value=value, unit=unit, of=kind) for kind in ("delta", "play"))
    assert play.delta_rad() == pytest.approx(0.5 * delta.delta_rad())
    lost = Limit(value=value, unit=unit, of="lost_motion", at_torque_share=0.03)
    assert lost.delta_rad(0.0) == play.delta_rad()


@pytest.mark.parametrize(
    ("text", "mrad"),
    [
        ("3 arcmin play", 0.4363),
        ("3′ play", 0.4363),
        ("1.2 mrad delta", 1.2),
        ("1.2e-3 rad δ", 1.2),
        ("0.1° play", 0.8727),
        ("180 arcsec play", 0.4363),
        ("0.5 mm play at 0.4 m", 0.625),
        ("3 arcmin lost motion at 3 %", 0.4363),
    ],
)
def test_limits_of_data_sheets_are_gaps(text: str, mrad: float) -> None:
    assert 1e3 * Limit.model_validate(text).delta_rad() == pytest.approx(mrad, rel=1e-4)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "This is no limit"),
        ("three arcmin play", "This is no limit"),
        ("3 arcmin", "says whether it is of δ, of play"),
        ("3 parsec play", "not one of the choices"),
        ("3 rpm play", "not one of the choices"),
        ("-3 arcmin play", "greater than 0"),
        ("0 arcmin play", "greater than 0"),
        ("0.5 mm play", "no radius"),
        ("3 arcmin play at 0.4 m", "a radius with arcmin"),
        ("3 arcmin lost_motion", "no torque"),
        ("3 arcmin play at 3 %", "a torque with play"),
        ("3 arcmin lost_motion at 300 %", "less than 1"),
    ],
)
def test_a_limit_that_says_too_little_or_too_much_is_refused(text: str, told: str) -> None:
    with pytest.raises(ConfigError, match=told) as caught:
        config_from_options("fit", [RECORDING], None, limit=text)
    assert caught.value.where == "--limit"
    assert caught.value.found
    assert caught.value.expected


def measured(tmp_path: Path, joint: str, bench: str | None = None) -> Path:
    estimator = "" if bench is None else f'[estimator]\nbench = "{ROOT / "configs" / bench}"\n'
    path = tmp_path / "fit.toml"
    path.write_text(
        f'schema = 1\nkind = "fit"\n[joint]\ngear_ratio = 120.0\n{joint}\n{estimator}'
        f'[[recordings]]\nfile = "{RECORDING}"\n'
    )
    return path


@pytest.mark.parametrize(
    "joint",
    [
        'limit = "3 arcmin play"',
        'limit = {value = 3.0, unit = "arcmin", of = "play"}',
        f"limit_rad = {math.pi / 7200.0!r}",
    ],
)
def test_every_form_in_a_file_is_one_limit_and_is_kept(tmp_path: Path, joint: str) -> None:
    config = load_config(measured(tmp_path, joint))
    assert limit_rad_of(config) == pytest.approx(1.5 / 60.0 * math.pi / 180.0)
    kept = tmp_path / "kept.toml"
    kept.write_text(dump_config(config))
    assert load_config(kept).joint == config.joint


def test_lost_motion_is_play_and_what_the_bench_gives_way(tmp_path: Path) -> None:
    joint = 'rated_torque_nm = 1000.0\nlimit = "5 arcmin lost_motion at 3 %"'
    config = load_config(measured(tmp_path, joint, "bench.toml"))
    windup = 2.0 * 0.03 * 1000.0 / 1.2e5
    assert limit_rad_of(config) == pytest.approx(0.5 * (5.0 * math.pi / 10_800.0 - windup))


@pytest.mark.parametrize(
    ("joint", "bench", "told"),
    [
        ("", "bench.toml", "no rated torque"),
        ("rated_torque_nm = 1000.0\n", None, "no stiffness"),
        ("rated_torque_nm = 1e5\n", "bench.toml", "no room for a gap"),
    ],
)
def test_lost_motion_that_the_joint_does_not_tell_is_refused(
    tmp_path: Path, joint: str, bench: str | None, told: str
) -> None:
    text = f'{joint}limit = "5 arcmin lost_motion at 3 %"'
    with pytest.raises(ConfigError, match=told):
        limit_rad_of(load_config(measured(tmp_path, text, bench)))


@pytest.mark.parametrize(
    ("joint", "told"),
    [
        ('limit = "3 arcmin play"\nlimit_rad = 1e-3', "two limits"),
        ('limit = "3 arcmin"', "says whether it is"),
        ('limit = "30 deg play"', "larger than any gap"),
        ('limit = {value = 3.0, unit = "arcmin", of = "slack"}', "delta"),
        ('limit = {value = 3.0, unit = "mm", of = "play"}', "no radius"),
    ],
)
def test_a_limit_in_a_file_that_cannot_be_meant_is_refused_with_its_place(
    tmp_path: Path, joint: str, told: str
) -> None:
    with pytest.raises(ConfigError, match=told) as caught:
        load_config(measured(tmp_path, joint))
    assert "limit" in str(caught.value.where)


def test_an_option_goes_before_the_limit_of_a_file_in_either_form(tmp_path: Path) -> None:
    path = measured(tmp_path, "limit_rad = 1e-3")
    config = config_from_options("fit", [RECORDING], path, limit="3 arcmin play")
    assert limit_rad_of(config) == pytest.approx(math.pi / 7200.0)
    path = measured(tmp_path, 'limit = "3 arcmin play"')
    assert limit_rad_of(config_from_options("fit", [RECORDING], path, limit_rad=1e-3)) == 1e-3
    with pytest.raises(ConfigError, match="two limits"):
        config_from_options("fit", [RECORDING], None, limit="3 arcmin play", limit_rad=1e-3)
    with pytest.raises(ConfigError, match="says whether") as caught:
        config_from_options("fit", [RECORDING], None, limit="3 arcmin")
    assert caught.value.where == "--limit"


def test_an_answer_is_told_as_the_limit_was_given() -> None:
    limit = Limit.model_validate("3 arcmin play")
    low, median, high = (limit.stated(1e-3 * mrad) for mrad in (0.68, 0.7, 0.72))
    measured = {"low": low, "median": median, "high": high, "level": 0.9, "kind": "equal_tailed"}
    stated = {"text": str(limit), "unit": limit.name, "measured": measured}
    summary: Any = {"kind": "fit", "limit": stated}
    # 2 · 0.7 mrad are 4.81 arcmin.
    assert in_unit_of_limit(summary) == "The gap in arcmin of play: 4.81 (4.68 to 4.95)."
    assert in_unit_of_limit({"kind": "fit"}) is None  # type: ignore[arg-type, typeddict-item]
