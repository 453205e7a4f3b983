"""A joint's wear from recordings that were measured before: what counts, and what withholds it.

The answers of the recordings are made here, as an earlier run would have kept them, so nothing is
fitted.
"""

from __future__ import annotations

from dataclasses import replace
from hashlib import sha256

import numpy as np
import pytest
from places import CONFIGS

from bayesbl.config.loading import load_config
from bayesbl.fleet.inventory import Found, Joint
from bayesbl.fleet.measured_joint import JointJob, RecordingAnswer, measure_joint

DATES = ("2025-01-01", "2025-07-01", "2026-01-01", "2026-07-01")
GAPS = (5e-4, 6e-4, 7e-4, 8e-4)
RATE = 2e-4
UNKNOWN = 7
"""Tolerances of the bench file."""


@pytest.fixture
def job(tmp_path):
    """A joint with four recordings, all known, each matched with its bench by itself."""
    (tmp_path / "joints.csv").write_text("joint\nJ1\n")
    config = tmp_path / "fleet.toml"
    config.write_text(
        'schema = 1\nkind = "fleet"\nrun = {output = "out"}\n[fleet]\njoints = "joints.csv"\n'
        'recordings = "{joint}/{date}.csv"\n'
    )
    found = []
    for day in DATES:
        file = tmp_path / f"{day}.csv"
        file.write_text(day)
        found.append(Found("J1", day, str(file), sha256=sha256(day.encode()).hexdigest()))
    joint = Joint(joint="J1", bench=str(CONFIGS / "bench_tolerances.toml"), limit_rad=1.2e-3)
    whole = JointJob.of(load_config(config), joint, found)
    return replace(whole, known=dict(enumerate(answers())))


def answers() -> list[RecordingAnswer]:
    """A bench that is known to 5 % moves all gaps alike; noise moves each by 0.1 %."""
    generator = np.random.default_rng(1)
    found = []
    for gap in GAPS:
        bench = generator.standard_normal((UNKNOWN, 1000))
        log = np.log(gap) + 0.05 * bench[2] + 1e-3 * generator.standard_normal(1000)
        found.append(RecordingAnswer("converged", None, (), "direct", True, np.exp(log), bench))
    return found


def with_answer(job: JointJob, number: int, **changed: object) -> JointJob:
    return replace(job, known={**job.known, number: replace(job.known[number], **changed)})


def test_what_is_not_known_of_the_bench_cancels_in_the_rate(job):
    answered, wear = measure_joint(job)
    assert answered == tuple(job.known.values())
    assert wear.reason is None
    assert wear.used == (0, 1, 2, 3)
    low, high = np.quantile(wear.wear.rate_rad_per_year, (0.05, 0.95))
    assert low < RATE < high
    # Independent gaps would leave 0.04 mrad of scatter: 13 % of the growth.
    assert np.std(wear.wear.rate_rad_per_year) < 0.08 * RATE
    assert wear.gap_rad.shape == (4, 2000)
    assert np.corrcoef(wear.gap_rad)[0, 3] > 0.9


def test_the_same_joint_gives_the_same_numbers(job):
    np.testing.assert_array_equal(
        measure_joint(job)[1].wear.rate_rad_per_year, measure_joint(job)[1].wear.rate_rad_per_year
    )


def test_a_recording_that_contradicts_the_bench_leaves_no_rate(job):
    _, wear = measure_joint(with_answer(job, 3, agrees=False, outcome="withheld", reason="It is."))
    assert wear.wear is None
    assert "2026-07-01: the recording contradicts the bench" in str(wear.reason)


def test_a_bench_that_changed_leaves_no_rate_and_is_named(job):
    generator = np.random.default_rng(2)
    known = {}
    for number, one in job.known.items():
        bench = one.bench.copy()
        bench[1] = (1.5 if number == 3 else -1.0) + 0.1 * generator.standard_normal(1000)
        known[number] = replace(one, bench=bench)
    _, wear = measure_joint(replace(job, known=known))
    assert wear.wear is None
    assert "Something other than the gap changed" in str(wear.reason)
    assert "2026-07-01 (load_inertia_kg_m2" in str(wear.reason)


def test_what_is_withheld_for_itself_is_left_out(job):
    _, wear = measure_joint(with_answer(job, 1, outcome="withheld", reason="Too noisy."))
    assert wear.used == (0, 2, 3)
    assert wear.reason is None


def test_gaps_by_different_routes_are_not_mixed(job):
    _, wear = measure_joint(with_answer(job, 0, route="amplitude", bench=None))
    assert wear.used == (1, 2, 3)


def other_joint(job, **given):
    """The job's joint with other cells in its row of the inventory."""
    return Joint(**job.joint.model_dump(by_alias=True, exclude_none=True) | given)


def test_only_what_was_recorded_since_the_repair_counts(job):
    repaired = replace(job, joint=other_joint(job, repaired="2025-12-01"))
    _, wear = measure_joint(repaired)
    assert wear.used == (2, 3)
    assert wear.reason is None
    late = replace(job, joint=other_joint(job, repaired="2026-06-01"))
    _, wear = measure_joint(late)
    assert wear.wear is None
    assert "only one snapshot since the repair" in str(wear.reason)
    assert wear.gap_rad.shape == (1, 1000)


def test_a_gap_that_fell_leaves_no_rate(job):
    swapped = replace(job, known={n: job.known[3 - n] for n in range(4)})
    _, wear = measure_joint(swapped)
    assert wear.wear is None
    assert "cannot shrink a gap" in str(wear.reason)


def test_a_date_that_cannot_be_is_the_reason_and_no_error(job):
    joint = other_joint(job, in_service_since="2026-01-01")
    _, wear = measure_joint(replace(job, joint=joint))
    assert "cannot have gone into service after" in str(wear.reason)


def test_the_bench_of_the_paper_gives_no_date(job):
    joint = other_joint(job, bench=None, curve="published")
    _, wear = measure_joint(replace(job, joint=joint))
    assert "paper's test bench" in str(wear.reason)


def test_addresses_follow_what_decides_the_numbers(job):
    """The limit decides no gap; a name, a speed and the file do."""
    same = replace(job, joint=other_joint(job, limit_rad=2e-3, load=3.0))
    assert same.problem_of(0) == job.problem_of(0)
    assert same.problem() != job.problem()
    first = replace(job.recordings[0], sha256="f" * 64)
    other = replace(job, recordings=(first, *job.recordings[1:]))
    assert other.problem_of(0) != job.problem_of(0)
    assert other.problem_of(1) == job.problem_of(1)
