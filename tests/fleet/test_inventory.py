"""Joints and recordings as tables and patterns give them; what is wrong is told with its place."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bayesbl.config.loading import load_config
from bayesbl.errors import ConfigError
from bayesbl.fleet.inventory import find_recordings, read_joints

HEAD = 'schema = 1\nkind = "fleet"\n[fleet]\n'
JOINTS = """joint,gearbox,bench,limit_rad,gear_ratio,payload_kg,cell
R1-J2,RV-80,bench.toml,1.2e-3,120,50,A
R1-J3,RV-20,,,,,B
"""


@pytest.fixture
def plant(tmp_path: Path) -> Path:
    (tmp_path / "joints.csv").write_text(JOINTS)
    (tmp_path / "bench.toml").write_text("")
    for name in ("R1-J2/2026-03-01", "R1-J2/2026-01-01", "R1-J3/spring", "R9-J9/2026-03-01"):
        file = tmp_path / "data" / f"{name}.csv"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(name)
    return tmp_path


def section(plant: Path, text: str = 'recordings = "data/{joint}/{date}.csv"'):
    joints = "" if "joints =" in text else 'joints = "joints.csv"\n'
    (plant / "fleet.toml").write_text(HEAD + joints + text)
    return load_config(plant / "fleet.toml").fleet


def test_an_inventory_is_read_with_its_own_columns(plant):
    first, second = read_joints(section(plant))
    assert (first.name, first.gearbox, first.limit_rad, first.gear_ratio) == (
        "R1-J2",
        "RV-80",
        1.2e-3,
        120.0,
    )
    assert first.bench == str(plant / "bench.toml")
    assert first.covariates == {"payload_kg": 50.0, "cell": "A"}
    assert (second.bench, second.limit_rad) == (None, None)
    assert first.group("cell") == "A"


@pytest.mark.parametrize("separator", [";", "\t"])
def test_an_inventory_may_have_the_separator_of_another_region(plant, separator):
    (plant / "joints.csv").write_text(JOINTS.replace(",", separator))
    assert [joint.name for joint in read_joints(section(plant))] == ["R1-J2", "R1-J3"]


def test_recordings_of_an_object_store_are_refused_in_words(plant):
    with pytest.raises(ConfigError, match="Recordings are files"):
        section(plant, 'recordings = "s3://plant/{joint}/{date}.csv"')


def test_a_pattern_finds_recordings_in_order_and_says_what_is_strange(plant):
    chosen = section(plant)
    found = find_recordings(chosen, read_joints(chosen))
    assert [(one.joint, one.date, one.reason is None) for one in found] == [
        ("R1-J2", "2026-01-01", True),
        ("R1-J2", "2026-03-01", True),
        ("R1-J3", "spring", False),
        ("R9-J9", "2026-03-01", False),
    ]
    assert "no date" in str(found[2].reason)
    assert "no joint 'R9-J9' in the inventory" in str(found[3].reason)


def test_letters_that_mean_something_to_a_shell_are_letters(plant):
    folder = plant / "a [b]*"
    (folder / "R1-J2").mkdir(parents=True)
    (folder / "R1-J2" / "2026-05-01.csv").write_text("")
    chosen = section(plant, 'recordings = "a [b]*/{joint}/{date}.csv"')
    assert [one.date for one in find_recordings(chosen, read_joints(chosen))] == ["2026-05-01"]


def test_a_table_finds_recordings(plant):
    (plant / "list.csv").write_text(
        "joint,date,file\nR1-J2,2026-01-01,data/R1-J2/2026-01-01.csv\nR1-J3,2026-02-01,gone.csv\n"
    )
    chosen = section(plant, 'recordings = "list.csv"')
    first, second = find_recordings(chosen, read_joints(chosen))
    assert first.file == str(plant / "data/R1-J2/2026-01-01.csv")
    assert "There is no such file." in str(second.reason)


def test_a_limit_may_be_stated_as_on_a_data_sheet(plant):
    (plant / "joints.csv").write_text("joint,limit\nR1-J2,3 arcmin play\nR1-J3,\n")
    first, second = read_joints(section(plant))
    assert first.limit_rad == pytest.approx(np.pi / 7200.0)
    assert second.limit_rad is None
    assert first.covariates == {}


@pytest.mark.parametrize(
    ("row", "told"),
    [
        ("3 arcmin,", "row 1, limit.*Expected: VALUE UNIT KIND"),
        ("3 arcmin lost_motion at 3 %,", "a limit of play or delta in a fleet"),
        ("30 deg play,", "row 1, limit.*at most"),
        ("3 arcmin play,1e-3", "row 1, limit.*one limit"),
    ],
)
def test_a_limit_that_cannot_be_used_is_told_with_its_place(plant, row, told):
    (plant / "joints.csv").write_text(f"joint,limit,limit_rad\nR1-J2,{row}\n")
    with pytest.raises(ConfigError, match=told):
        read_joints(section(plant))


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("R1-J2,RV-80,none.toml,,,,", "row 1, bench"),
        ("R1-J2,RV-80,,1.2,,,", "row 1, limit_rad"),
        ("R1-J2,RV-80,,narrow,,,", "row 1, limit_rad"),
        (",RV-80,,,,,", "row 1, joint"),
        ("../up,RV-80,,,,,", "row 1, joint"),
        ("R1-J2,RV-80,,,,,\nr1-j2,RV-80,,,,,", "Two joints have the same name"),
        ("R1-J2,RV-80", "row 1"),
        ("", "no joint"),
        ("R1-J2,RV-80,,,,,,9e4\nR1-J3,RV-80,,,,,,", "row 2, cost_at_limit"),
        ("R1-J2,RV-80,,,,,,9e4", "decide_before"),
    ],
)
def test_a_row_that_cannot_be_used_is_told_with_its_place(plant, line, told):
    header = JOINTS.splitlines()[0] + ",cost_at_limit" * ("9e4" in line)
    (plant / "joints.csv").write_text(f"{header}\n{line}\n")
    with pytest.raises(ConfigError, match=told) as caught:
        read_joints(section(plant))
    assert "joints.csv" in str(caught.value)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('recordings = "data/{joint}.csv"', "the date of a file"),
        ('recordings = "data/*.csv"', "contain the joint"),
        ('recordings = "none.csv"', "no such file"),
        ('recordings = "{joint}/{date}.csv"\npool_by = "gearbocks"', 'did you mean "gearbox'),
        (
            'recordings = "{joint}/{date}.csv"\npool_by = "gearbox"\ncovariates = ["payload"]',
            'did you mean "payload_kg',
        ),
        (
            'recordings = "{joint}/{date}.csv"\npool_by = "gearbox"\ncovariates = ["payload_kg"]',
            "row 2, payload_kg",
        ),
        ('recordings = "{joint}/{date}.csv"\ncovariates = ["payload_kg"]', "without pool_by"),
        ('recordings = "{joint}/{date}.csv"\n[curve]\nsource = "published"', "belongs to a joint"),
    ],
)
def test_a_configuration_that_cannot_be_one_is_refused(plant, text, told):
    with pytest.raises(ConfigError, match=f"(?i){told}"):
        read_joints(section(plant, text))
