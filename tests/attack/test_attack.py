"""The first cases of every group; all of them, and as many as wanted: ``tests/attack/run.py``."""

from __future__ import annotations

from pathlib import Path

import pytest

from attack.engine import Attack, run_all
from attack.run import all_groups, chosen, failures, told
from attack.workshop import Originals

SEED = 16

CORE = {
    "recordings, same samples": 40,
    "recordings, damaged": 20,
    "configurations that it wrote": 10,
    "configurations": 30,
    "commands": 15,
    "files": 6,
}
"""Cases of each group; what needs a process of its own has named tests."""

QUICK = ("recordings, damaged", "configurations that it wrote", "configurations", "commands")


@pytest.mark.parametrize(
    "group",
    [group if group in QUICK else pytest.param(group, marks=pytest.mark.long) for group in CORE],
)
def test_nothing_damaged_or_odd_does_harm(
    group: str, originals: Originals, open_path: Path
) -> None:
    attack = Attack(all_groups(originals), SEED)
    results = list(run_all(attack, chosen(attack, CORE[group], group), open_path, 2))
    # To repeat one: python tests/attack/run.py --case NUMBER
    assert not any(map(failures, results)), "\n".join(told(results))


def test_a_case_is_always_the_same(originals: Originals) -> None:
    first, second = (Attack(all_groups(originals), SEED) for _ in range(2))
    numbers = list(chosen(first, 50, None))
    assert [first.case(n)[1] for n in numbers] == [second.case(n)[1] for n in numbers]
    assert {first.case(n)[0].name for n in range(100)} == {g.name for g in first.groups}
