"""Laws of the study of wear detection: curves are recovered, large wear is found."""

from __future__ import annotations

import numpy as np
import pytest
import xarray as xr
from places import ROOT
from scipy.stats import norm

from bayesbl.config.loading import load_config
from bayesbl.errors import ConfigError
from bayesbl.results.store import write_tree
from bayesbl.runs.kinds import result_of_run
from bayesbl.runs.study import load_study, prepare

pytestmark = pytest.mark.long

SWEEP = f"""
schema = 1
kind = "sweep"
bench = "{ROOT}/configs/bench.toml"
[run]
workers = 1
output = "sweep"
[sweep]
gap_rad = {{low = 4e-4, high = 2e-3, count = 6}}
start_angles = 2
rotations = 2.2
sampling_hz = 500.0
"""


@pytest.fixture(scope="module")
def study():
    return load_study(ROOT / "experiments/wear_detection.py")


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    """A row with a curve of its own: no wear and much, at little noise."""
    folder = tmp_path_factory.mktemp("sweep")
    (folder / "sweep.toml").write_text(SWEEP)
    write_tree(result_of_run(load_config(folder / "sweep.toml")), folder / "result.nc")
    return {
        "name": "small",
        "bench": str(ROOT / "configs/bench.toml"),
        "curve": str(folder / "result.nc"),
        "gap_rad": 8e-4,
        "changes_rad": [0.0, 3e-4],
        "cases": 2,
        "speed_noise_sd_rpm": 0.5,
        "rotations": 2.2,
        "sampling_hz": 500.0,
    }


def cases(changes, probability, withheld=0.0):
    size = len(changes)
    columns = {
        "change_rad": changes,
        "probability_increase": probability,
        "change_median_rad": changes,
        "change_sd_rad": np.full(size, 1e-5),
        "withheld": np.full(size, withheld),
    }
    return xr.Dataset({name: ("case", np.asarray(v, float)) for name, v in columns.items()})


@pytest.mark.parametrize(("middle", "width"), [(3.5e-5, 2e-5), (5e-6, 3e-6), (1e-4, 2e-5)])
def test_a_known_detection_curve_is_recovered(study, middle, width):
    module = study.module
    change = np.tile(np.linspace(0.0, 2.0 * middle, 5), 400)
    chance = norm.cdf((change - middle) / width)
    reported = (np.random.default_rng(1).uniform(size=change.size) < chance) * 1.0
    found = module.detection_curve(change, reported)
    smallest, truth = module.smallest_change(*found), middle + 1.6448536 * width
    # Four standard errors: a false alarm in 16000.
    assert abs(smallest - truth) < 4.0 * module._standard_error(change, *found)
    assert smallest == pytest.approx(truth, rel=0.15)


def test_the_detection_curve_scales_with_the_unit_of_the_change(study):
    change = np.tile(np.linspace(0.0, 8e-5, 5), 40)
    reported = (np.random.default_rng(2).uniform(size=200) < norm.cdf(change / 2e-5 - 1.6)) * 1.0
    once = study.module.detection_curve(change, reported)
    thousand = study.module.detection_curve(1e3 * change, reported)
    np.testing.assert_allclose(thousand, 1e3 * np.array(once), rtol=1e-4)


def test_false_alarms_are_counted_without_change_and_a_withheld_answer_reports_nothing(
    study, table
):
    changes, probability = [0.0, 0.0, 3e-4, 3e-4], [0.949, 0.951, 0.9999, 0.9]
    line = study.summarise(table, cases(changes, probability))
    assert line["false_alarms"] == 0.5
    assert line["reported"] == "0.500 0.500"
    silent = study.summarise(table, cases(changes, probability, withheld=1.0))
    assert (silent["reported"], silent["withheld"]) == ("0.000 0.000", 1.0)


def test_much_wear_is_found_and_every_change_has_its_pairs(study, table):
    assert study.count(table) == 4
    found = [study.run_case(table, n, np.random.SeedSequence([11, n])) for n in range(4)]
    assert [case["change_rad"] for case in found] == [0.0, 3e-4, 0.0, 3e-4]
    for case in found:
        error = case["change_median_rad"] - case["change_rad"]
        # Four claimed standard deviations: a false alarm in 16000 a case.
        assert abs(error) < 4.0 * case["change_sd_rad"]
        assert case["withheld"] == 0.0
    assert min(found[n]["probability_increase"] for n in (1, 3)) > 0.99
    assert max(found[n]["change_sd_rad"] for n in range(4)) < 5e-5


def test_pairs_without_wear_come_on_top_of_those_at_each_change(study, table):
    assert study.count(table | {"more_without_wear": 3}) == 7
    more = study.run_case(table | {"more_without_wear": 3}, 5, np.random.SeedSequence([11, 5]))
    assert more["change_rad"] == 0.0
    line = study.summarise(table, cases([0.0, 3e-4, 0.0, 0.0], [0.99, 1.0, 0.5, 0.5]))
    assert (line["pairs_without_wear"], line["false_alarms"]) == (3.0, pytest.approx(1 / 3))
    alone = study.summarise(table, cases([0.0] * 200, [0.99] * 10 + [0.5] * 190))
    assert alone["false_alarms"] == 0.05 < alone["false_alarms_at_most"] < 0.1
    assert "smallest_mrad" not in alone


def test_the_direct_route_finds_the_change_and_is_sharper(study, table):
    """By how much the study tells; here the noise of the current is what is left."""
    row = {key: value for key, value in table.items() if key != "curve"} | {"route": "direct"}
    seeds = [np.random.SeedSequence([12, n]) for n in range(2)]
    found = [study.run_case(row, n, seed) for n, seed in enumerate(seeds)]
    for case, change in zip(found, (0.0, 3e-4), strict=True):
        # Four claimed standard deviations: a false alarm in 16000 a case.
        assert abs(case["change_median_rad"] - change) < 4.0 * case["change_sd_rad"]
        assert case["withheld"] == 0.0
    assert found[1]["probability_increase"] > 0.99
    by_amplitude = study.run_case(table, 1, seeds[1])
    assert found[1]["change_sd_rad"] < 0.5 * by_amplitude["change_sd_rad"]


def test_the_amplitude_route_is_refused_without_a_curve(study, table):
    with pytest.raises(ConfigError, match="needs a curve"):
        study.count({key: value for key, value in table.items() if key != "curve"})


def test_the_shipped_study_is_valid_but_for_a_sweep_that_is_not_there_yet():
    _, rows = prepare(load_config(ROOT / "configs/wear_detection.toml"))
    assert all(0.0 in row.table["changes_rad"] for row in rows), "each row counts false alarms"
