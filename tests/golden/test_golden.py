"""The numbers of every kind of run are those that were kept: ``golden.json``, by ``make.py``.

On the machine of the kept numbers (same processor, Python and numerical packages, by its
``origin``) every number is held to 1e-9 relative, that of a draw relative to its posterior's
standard deviation where that is larger.

Elsewhere sums are rounded differently, a Markov chain makes another chain of that, and only what a
scientist would defend can be held:

* values that no random walk enters (optimum, noise model, sweep rows, simulated samples) to 1e-4,
  but what remains after naming to 0.5 %: there a fit may end a tenth of a standard deviation beside
  its optimum, and half of that square is what remains more;
* posterior means, and medians of intervals, to a quarter of the posterior's standard deviation,
  its standard deviation and the bounds of intervals to half of one;
* named effects, verdicts and kinds of noise exactly;
* nothing of diagnostics, probabilities, study cases and single draws.

Each run is made once.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from golden_runs import GOLDEN_FILE, REPOSITORY, RUNS, SECTIONS, Workshop, origin_of_machine
from quick import without_figures

import bayesbl

GOLDEN = json.loads(GOLDEN_FILE.read_text(encoding="utf-8"))
SAME_MACHINE = all(GOLDEN["origin"][key] == told for key, told in origin_of_machine().items())

EXACT = 1e-9
ELSEWHERE = 1e-4
REMAINS = re.compile(r"disagreement\..*\.after")
REMAINS_ELSEWHERE = 0.5 * 0.1**2
MEAN_SHARE, WIDTH_SHARE = 0.25, 0.5
"""Parts of a posterior standard deviation by which another machine may differ."""
QUICK = (
    *("fit_published", "sweep_draws", "simulate_wear", "direct"),
    *("diagnose_forward", "diagnose_inverse"),
)
"""Runs of a run of all tests that leaves out the long ones."""
SDS_IN_INTERVAL = 3.29
"""Width of a normal 90 % interval in standard deviations; narrower levels are held closer."""


@pytest.fixture(scope="module")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workshop]:
    """Where runs are made, each once."""
    assert Path(bayesbl.__file__).resolve().parents[1] == REPOSITORY
    with without_figures():
        yield Workshop(tmp_path_factory.mktemp("golden"))


def test_every_run_is_kept() -> None:
    assert list(GOLDEN["runs"]) == list(RUNS)


@pytest.mark.parametrize(
    "name",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.long) for name in RUNS],
)
def test_a_run_gives_the_numbers_that_were_kept(name: str, workshop: Workshop) -> None:
    found = json.loads(json.dumps(workshop.numbers(name)))
    wrong = list(differences(GOLDEN["runs"][name], found, exact=SAME_MACHINE))
    assert not wrong, f"{len(wrong)} numbers differ:\n" + "\n".join(wrong[:40])


def differences(
    golden: Mapping[str, Any], found: Mapping[str, Any], *, exact: bool
) -> Iterator[str]:
    """What differs, a line each; what is new beside the kept names does not count."""
    for section in SECTIONS:
        for name, kept in golden[section].items():
            place = f"{section} {name}"
            if section == "chain" and not exact:
                continue
            elsewhere = REMAINS_ELSEWHERE if REMAINS.fullmatch(name) else ELSEWHERE
            if name not in found[section]:
                yield f"{place}: missing"
            elif not _same(section, kept, found[section][name], exact, elsewhere):
                yield f"{place}: {found[section][name]}, kept {kept}"


def _same(section: str, kept: Any, new: Any, exact: bool, elsewhere: float) -> bool:
    if section == "draws":
        return _same_draws(kept, new, exact)
    if exact or section == "names":
        # A share of a variance is a difference of two.
        return _close(kept, new, EXACT, EXACT * (section == "chain"))
    if section == "intervals":
        return _same_interval(kept, new)
    return _close(kept, new, elsewhere)


def _same_draws(kept: Mapping[str, Any], new: Mapping[str, Any], exact: bool) -> bool:
    sd = kept["sd"] or 0.0
    if exact:
        return all(_close(kept[key], new[key], EXACT, EXACT * sd) for key in kept)
    mean = _close(kept["mean"], new["mean"], 0.0, MEAN_SHARE * sd)
    return mean and _close(sd, new["sd"] or 0.0, 0.0, WIDTH_SHARE * sd)


def _same_interval(kept: list[float | None], new: list[float | None]) -> bool:
    """Without bounds the value was held, or is an optimum."""
    median, low, high = kept
    if low is None or high is None:
        return _close(kept, new, ELSEWHERE)
    sd = (high - low) / SDS_IN_INTERVAL
    ends = _close(kept[1:], new[1:], 0.0, WIDTH_SHARE * sd)
    return ends and _close(median, new[0], 0.0, MEAN_SHARE * sd)


def _close(kept: Any, new: Any, relative: float, absolute: float = 0.0) -> bool:
    """Numbers within the tolerance, lists item by item, everything else equal."""
    if isinstance(kept, list) and isinstance(new, list):
        return len(kept) == len(new) and all(
            _close(a, b, relative, absolute) for a, b in zip(kept, new, strict=True)
        )
    numbers = [type(x) in (int, float) for x in (kept, new)]
    if all(numbers):
        return math.isclose(kept, new, rel_tol=relative, abs_tol=absolute)
    return bool(kept == new)


def test_a_number_that_moved_is_told() -> None:
    """The comparison itself: what passes on either machine, and what does not."""
    kept: dict[str, dict[str, Any]] = {
        "values": {"rmse_rpm": [1.5, None]},
        "intervals": {"delta_rad": [8e-4, 7e-4, 9e-4]},
        "draws": {"delta_rad": {"first": [8e-4], "last": [9e-4], "mean": 8e-4, "sd": 6e-5}},
        "names": {"verdict": "named"},
        "chain": {"r_hat": 1.001},
    }

    def told(section: str, name: str, value: Any, *, exact: bool) -> list[str]:
        return list(differences(kept, kept | {section: {name: value}}, exact=exact))

    def remains(value: float) -> dict[str, Any]:
        return kept | {"values": {"disagreement.used.after": [value]}}

    moved = dict(kept["draws"]["delta_rad"], mean=8.1e-4)
    for exact in (True, False):
        assert not list(differences(kept, kept, exact=exact))
        assert bool(told("values", "rmse_rpm", [1.5 * (1 + 1e-6), None], exact=exact)) is exact
        assert bool(told("intervals", "delta_rad", [8.1e-4, 7e-4, 9e-4], exact=exact)) is exact
        assert bool(told("draws", "delta_rad", moved, exact=exact)) is exact
        assert bool(told("chain", "r_hat", 1.002, exact=exact)) is exact
        assert told("values", "rmse_rpm", [1.51, None], exact=exact)
        assert told("values", "rmse_rpm", [1.5, 0.0], exact=exact)
        assert bool(list(differences(remains(1.0), remains(1.004), exact=exact))) is exact
        assert list(differences(remains(1.0), remains(1.006), exact=exact))
        assert told("intervals", "delta_rad", [8.3e-4, 7e-4, 9e-4], exact=exact)
        assert told("draws", "delta_rad", dict(moved, mean=8.2e-4), exact=exact)
        assert told("names", "verdict", "unexplained", exact=exact)
        assert told("values", "other", [1.5], exact=exact)
