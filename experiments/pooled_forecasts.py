"""Does the limit come when a pooled fleet says, and how much sharper is that than joint by joint?

    python experiments/pooled_forecasts.py [FLEETS]

Fleets of seven types of gearbox, twenty joints each, whose rates are log-normal in a type. Three
types wear by laws that the package has: evenly, running in, speeding up. Three wear by laws that it
has not, or hardly. Of the last, one joint in five wears by another law than its type. A joint is
seen 2, 3, 4 or 8 times, the last time at 0.3 to 0.8 of its life, or, one in four, at up to 1.3:
these are there to be called over their limit. Gaps are measured as in :mod:`forecasts`, whose laws
these are, and go through :func:`bayesbl.measurement.wear.wear` and
:func:`bayesbl.fleet.pooled_rates.pooled` as those of a fleet. What happens after the last snapshot
is held out. Writes ``experiments/results/pooled_forecasts.csv``.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from forecasts import ALPHA, HORIZON_ALPHA, LAST_AT, LEVEL, law_of, measured, reached
from numpy.typing import NDArray

from bayesbl.fleet.pooled_rates import Borrowed, alarms, pooled
from bayesbl.measurement.wear import WearDraws, wear
from bayesbl.recording.types import FloatArray
from bayesbl.results.provenance import git_commit

OWN = ("linear", "running_in", "power")
TYPES = {
    **{law: (law,) for law in (*OWN, "exponential", "logistic", "steps")},
    "mixed": ("linear", "linear", "power", "linear", "linear"),
}
"""Type to the laws of its joints, in turn."""

RATE = 1.5e-4
"""Median of a type's mean rates from new to the limit, rad/year."""

JOINTS = 20
SPREAD = 0.3
DATES = (2, 3, 4, 8)
FEW = 4
LIMIT_RAD = 1.2e-3

RESULT = Path(__file__).parent / "results" / "pooled_forecasts.csv"


@dataclass(frozen=True, slots=True)
class Seen:
    """A joint as its snapshots show it, and what became of it, times in years."""

    law: str
    dates: int
    last_at: float
    life: float
    remaining: float
    rate: FloatArray
    times: FloatArray
    kind: NDArray[np.int_]
    jump: FloatArray
    over_now: float


def joint(law: str, number: int, generator: np.random.Generator) -> Seen | None:
    """One joint; ``None`` where it was measured to shrink."""
    grown = law_of(law, generator)
    new_rad = generator.uniform(4e-4, 7e-4)
    way_rad = LIMIT_RAD - new_rad
    life = way_rad / (RATE * np.exp(SPREAD * generator.standard_normal()))
    last = LAST_AT[number % len(LAST_AT)] if number % 4 else generator.uniform(0.85, 1.3)
    dates = int(generator.choice(DATES))
    ages = np.linspace(generator.uniform(0.0, 0.2), last, dates)
    draws = measured(new_rad + way_rad * grown(ages), generator)
    seed = np.random.SeedSequence(int(generator.integers(2**32)))
    found = wear(draws, life * ages, seed, limit_rad=LIMIT_RAD)
    if found is None:
        return None
    span = life * (last - ages[0])
    one = {str(name): draws.values.ravel() for name, draws in found.items()}
    return Seen(
        law,
        dates,
        last,
        life,
        (reached(grown, last) - last) * life,
        (one["current_rad"] - one["first_rad"]) / span,
        one["years_to_limit"],
        one["law"],
        one["scatter_rad_per_root_year"] ** 2 * span / one["expected_growth_rad"],
        float(np.mean(one["current_rad"] > LIMIT_RAD)),
    )


def fleet(seed: int) -> list[dict[str, Any]]:
    """A line for each joint of one fleet: how its forecast did, pooled and alone."""
    generator, pooling = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    lines: list[dict[str, Any]] = []
    for name, laws in TYPES.items():
        made = (joint(laws[n % len(laws)], n, generator) for n in range(JOINTS))
        seen = [one for one in made if one is not None]
        found = pooled([WearDraws(one.rate, one.kind, one.jump, one.rate) for one in seen], pooling)
        assert found is not None
        for one, borrowed in zip(seen, found.joints, strict=True):
            line = {"type": name, "joint": one, "over": one.remaining == 0.0}
            line |= {"pooled": forecast(one, borrowed), "alone": scored(one.times, one)}
            lines.append(line)
    called = alarms([line["joint"].over_now for line in lines])
    return [line | {"called": call} for line, call in zip(lines, called, strict=True)]


def forecast(one: Seen, borrowed: Borrowed) -> dict[str, float]:
    """Of a joint with what its type says."""
    chosen = borrowed.chosen
    scores = scored(one.times if chosen is None else one.times[chosen], one)
    return scores | {"unlike": borrowed.probability_own}


def scored(times: FloatArray, one: Seen) -> dict[str, float]:
    """Of draws of the time to the limit."""
    low, high = np.quantile(times, [0.5 - 0.5 * LEVEL, 0.5 + 0.5 * LEVEL])
    error = np.abs(times - one.remaining)
    return {
        "held": float(low <= one.remaining <= high),
        "width": float(high - low) / one.life,
        "not_before": float(one.remaining >= np.quantile(times, 1.0 - LEVEL)),
        "near_remaining": float(np.mean(error < ALPHA * one.remaining) > 0.5),
        "near_life": float(np.mean(error < HORIZON_ALPHA * one.life) > 0.5),
    }


def row(name: str, lines: Sequence[Mapping[str, Any]]) -> dict[str, object]:
    """Shares over joints whose limit was ahead of them; widths are medians, in lives."""
    found: dict[str, object] = {"joints": name, "number": len(lines)}
    for key in ("held", "not_before", "near_remaining", "near_life", "width"):
        for way in ("alone", "pooled"):
            values = [line[way][key] for line in lines]
            found[f"{key}_{way}"] = (
                f"{np.median(values) if key == 'width' else np.mean(values):.3f}"
            )
    found["unlike_type"] = f"{np.mean([line['pooled']['unlike'] for line in lines]):.3f}"
    return found


def groups(lines: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, list[Mapping[str, Any]]]]:
    """Joints whose limit was ahead of them, in groups."""
    ahead = [line for line in lines if not line["over"]]
    own = [line for line in ahead if line["type"] in OWN]
    yield "three types", own
    yield f"up to {FEW} snapshots", [line for line in own if line["joint"].dates <= FEW]
    yield "8 snapshots", [line for line in own if line["joint"].dates > FEW]
    for last in LAST_AT:
        yield f"last at {last}", [line for line in own if line["joint"].last_at == last]
    for name, laws in TYPES.items():
        for law in dict.fromkeys(laws):
            one = [line for line in ahead if line["type"] == name and line["joint"].law == law]
            yield name if len(set(laws)) == 1 else f"{law}, in a type that is mostly linear", one


def main(fleets: int = 20) -> None:
    """A row for each group of joints, and a line for the alarms."""
    lines: list[dict[str, Any]] = []
    false_shares = []
    for seed in range(fleets):
        made = fleet(seed)
        lines += made
        false = [not line["over"] for line in made if line["called"]]
        false_shares += [np.mean(false)] if false else []
    over = [float(line["called"]) for line in lines if line["over"]]
    rows = [row(name, members) for name, members in groups(lines)]
    print(
        f"Of those called {np.mean(false_shares):.3f} are not over their limit, by fleets "
        f"± {np.std(false_shares) / len(false_shares) ** 0.5:.3f}; of those that are "
        f"{np.mean(over):.3f} are called."
    )
    for one in rows:
        print(*one.values())
    with RESULT.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [*rows[0], "fleets", "commit"], lineterminator="\n")
        writer.writeheader()
        writer.writerows({**one, "fleets": fleets, "commit": git_commit()} for one in rows)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:2]))
