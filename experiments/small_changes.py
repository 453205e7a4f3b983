"""Two small changes at once that are not wear: are they called wear?

    bayesbl run configs/small_changes.toml

A case is a pair of recordings of one joint with the same gap; before the second, two of eight
parameters change by a few per cent, each up or down. Each pair is answered with the motor current
and by the speed alone. An increase is *called* if its probability is at least ``CALLED_AT`` and the
change is not withheld. The answer is the normal approximation of the direct route with all that it
allows for, from a fit that starts at the truth.

``wear_found`` is the smallest growth of the gap that is called in 95 of 100: twice the 95 %
quantile of the normal distribution times the standard deviation of the change. ``alone`` are the
same numbers with nothing allowed for but the gap, by the nominal fit.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import xarray as xr
from calibration_statistics import coverage_band
from pydantic import Field, NonNegativeFloat
from study_tools import SNAPSHOTS, StudyRow, held

from bayesbl.bench.bench import Bench
from bayesbl.config.bench import load_bench
from bayesbl.matching.alignment import refitted
from bayesbl.matching.least_squares import SimulatedFit, fit_simulated
from bayesbl.matching.motions import noise_of
from bayesbl.matching.observed import Observed, observed
from bayesbl.matching.predictive_check import agrees
from bayesbl.matching.signals import GAP, START_ANGLE, SimulatedSignals
from bayesbl.model_search.always_in import directions, with_far_terms_freed
from bayesbl.model_search.joint_change import find_changes
from bayesbl.model_search.pipeline import direct_unknowns
from bayesbl.probabilities import normal_isf
from bayesbl.recording.types import FloatArray

CALLED_AT = 0.95
DRAWS = 4000
GAP_RANGE_RAD = (1e-4, 1e-2)
PARAMETERS = (
    "motor_inertia_kg_m2",
    "load_inertia_kg_m2",
    "shaft_stiffness_nm_per_rad",
    "shaft_damping_nm_s_per_rad",
    "gravity_torque_nm",
    "torque_constant_nm_per_a",
    "speed_gain_nm_s_per_rad",
    "integral_gain_nm_per_rad",
)
PAIRS = tuple(itertools.combinations(range(len(PARAMETERS)), 2))


class Row(StudyRow):
    """A row: by how much two parameters change, and how many pairs of recordings there are.

    ``grown``: relative growth of the gap. ``bench_off``: the joint is drawn within the tolerances
    of its bench.
    """

    bench: Path
    share: NonNegativeFloat
    gap_rad: tuple[float, float]
    grown: float = Field(default=0.0, gt=-1.0)
    bench_off: bool = False


COLUMNS = {
    "first": ("1", "place of one changed parameter in the list, its sign that of the change"),
    "second": ("1", "the same of the other"),
    **{
        f"{answer}_{name}": (unit, f"{meaning}, {answer}")
        for answer in ("current", "speed")
        for name, unit, meaning in (
            ("probability_increase", "1", "posterior probability that the gap grew"),
            ("error_sd", "1", "error of the change in posterior standard deviations"),
            ("sd", "1", "posterior standard deviation of the change of ln δ"),
            ("covered", "1", "1 where the 90 % interval of the change holds the truth"),
            ("gap_error_sd", "1", "error of the second ln δ in posterior standard deviations"),
            ("gap_covered", "1", "1 where the 90 % interval of the second δ holds the truth"),
            ("withheld", "1", "1 where the change is withheld"),
            ("seen", "1", "1 where a change other than of the gap is reported"),
            ("alone_error_sd", "1", "as error_sd, of the nominal fit with only the gap free"),
            ("alone_sd", "1", "as sd, of that fit"),
            ("wider", "1", "sd of the second ln δ over that of the nominal fit"),
        )
    },
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One pair, answered with and without the current."""
    rng = np.random.default_rng(seed)
    chosen = PAIRS[index % len(PAIRS)]
    signs = rng.choice([-1.0, 1.0], 2)
    gap = math.exp(rng.uniform(*np.log(row.gap_rad)))
    bench = load_bench(row.bench)
    joint = bench.draw(rng) if row.bench_off else bench
    changed = joint.with_parameters(
        **{
            PARAMETERS[place]: joint.value(PARAMETERS[place]) * (1.0 + sign * row.share)
            for place, sign in zip(chosen, signs, strict=True)
        }
    )
    gaps = (gap, gap * (1.0 + row.grown))
    starts = rng.uniform(-math.pi, math.pi, 2)
    recordings = [
        made.simulate(own, start_angle_rad=float(start), seed=rng, name=name)
        for made, own, start, name in zip((joint, changed), gaps, starts, SNAPSHOTS, strict=True)
    ]
    truth = {GAP: np.log(gaps), START_ANGLE: starts}
    out = {
        "first": signs[0] * (chosen[0] + 1.0),
        "second": signs[1] * (chosen[1] + 1.0),
    }
    for answer in ("current", "speed"):
        seen = [observed(recording, bench) for recording in recordings]
        if answer == "speed":
            seen = [replace(s, signals=s.signals[:1]) for s in seen]
        own = _answered(bench, joint, seen, truth, rng)
        out |= {f"{answer}_{name}": value for name, value in own.items()}
    return out


def _answered(
    bench: Bench,
    joint: Bench,
    seen: Sequence[Observed],
    truth: Mapping[str, FloatArray],
    rng: np.random.Generator,
) -> dict[str, float]:
    """One way to answer: what :func:`bayesbl.model_search.pipeline.fit_jointly` does."""
    unknowns = direct_unknowns(bench, SNAPSHOTS, GAP_RANGE_RAD)
    point = [
        joint.value(u.name) if u.recording is None else truth[u.name][SNAPSHOTS.index(u.recording)]
        for u in unknowns
    ]
    model = SimulatedSignals(bench, seen, unknowns, [noise_of(s, s.signals) for s in seen])
    nominal = refitted(model, fit_simulated(model, np.array(point)))
    among = directions(bench, {})
    rest = with_far_terms_freed(nominal, among)
    withheld, told = False, any(u.added for u in rest.fit.model.unknowns)
    if not agrees(rest.check):
        _, rest, joint_findings = find_changes(rest.fit, among)
        told = bool(joint_findings.changed)
        withheld = not (joint_findings.explained or rest.is_useful)
    fit = rest.fit
    root = np.linalg.cholesky(fit.covariance)
    draws = fit.point + rng.standard_normal((DRAWS, fit.point.size)) @ root.T
    draws += rest.posterior.draw(rng, DRAWS).shift
    first, last = (draws[:, fit.model.index(GAP, name)] for name in SNAPSHOTS)
    change, grown = last - first, float(truth[GAP][1] - truth[GAP][0])
    alone, alone_sd = _change(nominal)
    return {
        "probability_increase": float(np.mean(change > 0.0)),
        "error_sd": float((change.mean() - grown) / change.std()),
        "sd": float(change.std()),
        "covered": held(change, grown),
        "gap_error_sd": float((last.mean() - truth[GAP][1]) / last.std()),
        "gap_covered": held(last, float(truth[GAP][1])),
        "withheld": float(withheld),
        "seen": float(told),
        "alone_error_sd": (alone - grown) / alone_sd,
        "alone_sd": alone_sd,
        "wider": float(last.std()) / nominal.sd(GAP, SNAPSHOTS[1]),
    }


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Share called wear, share withheld, and the least wear that is found."""
    size = cases.sizes["case"]
    line: dict[str, float | str] = {
        "pairs": float(size),
        "nominal_at_most": coverage_band(size, 1.0 - CALLED_AT)[1],
    }
    for answer in ("current", "speed"):
        own = {name: cases[f"{answer}_{name}"].values for name in _NAMES}
        given = own["withheld"] == 0.0
        needed = 2.0 * normal_isf(1.0 - CALLED_AT)
        errors = np.abs(own["error_sd"][given])
        line |= {
            f"{answer}_called": float(np.mean((own["probability_increase"] >= CALLED_AT) & given)),
            f"{answer}_alone_called": float(
                np.mean(own["alone_error_sd"] >= normal_isf(1.0 - CALLED_AT))
            ),
            f"{answer}_covered": float(own["covered"][given].mean()) if given.any() else math.nan,
            f"{answer}_gap_covered": float(own["gap_covered"].mean()),
            f"{answer}_wider": float(np.median(own["wider"])),
            f"{answer}_withheld": float(1.0 - given.mean()),
            f"{answer}_seen": float(own["seen"].mean()),
            f"{answer}_largest_error_sd": float(np.max(errors, initial=0.0)),
            f"{answer}_wear_found": float(np.expm1(needed * np.median(own["sd"]))),
            f"{answer}_alone_wear_found": float(np.expm1(needed * np.median(own["alone_sd"]))),
        }
    return line


_NAMES = (
    "probability_increase",
    "error_sd",
    "sd",
    "covered",
    "gap_error_sd",
    "gap_covered",
    "withheld",
    "seen",
    "alone_error_sd",
    "alone_sd",
    "wider",
)


def _change(fit: SimulatedFit) -> tuple[float, float]:
    """Of ln δ by a fit, with its standard deviation."""
    toward = np.zeros(fit.point.size)
    toward[fit.model.index(GAP, SNAPSHOTS[1])], toward[fit.model.index(GAP, SNAPSHOTS[0])] = 1, -1
    return float(toward @ fit.point), math.sqrt(float(toward @ fit.covariance @ toward))
