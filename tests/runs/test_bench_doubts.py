"""A bench file that is no robot's: what is probably wrong is named before anything runs."""

from __future__ import annotations

from pathlib import Path

import pytest
from places import CONFIGS

from bayesbl.runs.bench import describe
from bayesbl.runs.workflow import Plan


@pytest.mark.parametrize(
    ("value", "told"), [("20.0", ""), ("200.0", "pendulum 4.61 m long"), ("2.0", "0.0461 m")]
)
def test_inertia_and_gravity_of_one_load_go_together(value: str, told: str, tmp_path: Path) -> None:
    text = (CONFIGS / "bench.toml").read_text()
    wrong = tmp_path / "bench.toml"
    inertia = "load_inertia_kg_m2 = {value = "
    wrong.write_text(text.replace(f"{inertia}20.0", f"{inertia}{value}"))
    plan = Plan(wrong)
    describe(wrong, plan)
    assert (told in " ".join(plan.warnings)) if told else not plan.warnings
