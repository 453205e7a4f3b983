"""Is what is missing in a bench named, and nothing else?

    bayesbl run configs/hidden_effects_core.toml       # or hidden_effects.toml
    python experiments/hidden_effects.py results/hidden_effects_core/result.nc confusion.csv

A case hides something in the simulator of ``independent_bench.py``, which shares only the equations
with the package: recordings at 2000, −2000 and 1200 rpm and one at 1600 rpm that is held out, a
random gap, random start angles, coloured noise. The diagnosis gets the reference bench and the
recordings; the truth is looked at afterwards. The second command writes what was answered for what.
"""

from __future__ import annotations

import csv
import json
import math
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
import xarray as xr
from independent_bench import SPEEDS_RPM, TYPICAL, Made, random_recordings, values_of
from pydantic import Field
from study_tools import StudyRow, mean

from bayesbl.bench.effects import effect_named
from bayesbl.bench.parameters import CORRECTABLE_PARAMETERS
from bayesbl.config.bench import reference_bench
from bayesbl.diagnosis.closed_loop.diagnosis import CHANNELS, Findings, diagnosis_of, search
from bayesbl.diagnosis.diagnosis import Diagnosis
from bayesbl.matching.observed import observed
from bayesbl.matching.posterior import sample_direct
from bayesbl.matching.signals import GAP, START_ANGLE, Unknown, gap_unknown
from bayesbl.matching.signals import start_angle_unknown as start_angle
from bayesbl.model_search.catalogue import candidates
from bayesbl.model_search.refit import Explanation, refit
from bayesbl.sampling.chains import SamplerSettings

HELD_OUT_RPM = 1600.0
GAP_RANGE_RAD = (1e-4, 4e-3)
KNOWN_ANGLE_SD_RAD = 1e-3
LEVEL_SD = 1.6449
"""Half-width of a 90 % interval in standard deviations."""

EFFECT_NAMES = tuple(name for name in TYPICAL if effect_named(name).replaces is None)
"""Without the gap, which is unknown anyway."""
NAMES = (*EFFECT_NAMES, *CORRECTABLE_PARAMETERS)
"""Place of a name is its bit in ``set_1`` and so on."""
VERDICTS = ("nothing_missing", "named", "parameter_error", "unexplained")
MOST_NAMED = 3

CLEAR = 10.0
"""|z| of the signature from which on the right name is asked for."""
APART = 5.0
"""|z| from every other candidate's best fit, likewise."""

OUTSIDE: Mapping[str, Mapping[str, float]] = {
    "time_torque": {"outside__time_torque_nm": 0.1},
    "belt": {"outside__belt_torque_nm": 0.2},
    "second_gap": {"outside__second_gap_rad": 5e-4},
    "dropouts": {"outside__dropouts_per_s": 1.0},
}
WRONG: Mapping[str, float] = {
    "shaft_stiffness_nm_per_rad": 0.9,
    "gravity_torque_nm": 1.05,
    "motor_inertia_kg_m2": 1.1,
    "speed_gain_nm_s_per_rad": 0.9,
}
"""True value over the one believed."""

_SAME_IN_THESE = (
    {"motor_coulomb_friction", "motor_stribeck_friction"},
    {"motor_viscous_friction", "motor_stribeck_friction"},
    {"friction_drift", "motor_coulomb_friction"},
    {"friction_drift", "motor_stribeck_friction"},
    {"motor_torque_offset", "load_torque_offset"},
    {"motor_viscous_friction", "load_viscous_friction"},
    {"current_loop_lag", "speed_sensor_lag"},
    {"current_loop_lag", "channel_time_skew"},
    {"speed_sensor_lag", "channel_time_skew"},
    {"speed_averaging", "channel_time_skew"},
)
"""Pairs declared indistinguishable beforehand; a drift contains a constant.

See docs/design.md, "What recordings cannot tell apart".
"""
_NEVER_TOGETHER = (
    {"sampled_control", "speed_sensor_lag"},
    {"sampled_control", "speed_averaging"},
)
"""The simulator's digital controller shows the speed of its ticks."""
_WITH_OTHERS = [name for name in EFFECT_NAMES if name != "gravity_phase"]
"""It shows only where the load's angle is known."""
PAIRS = tuple(
    pair
    for pair in combinations(_WITH_OTHERS, 2)
    if set(pair) not in (*_SAME_IN_THESE, *_NEVER_TOGETHER)
)


class Row(StudyRow):
    """A row: what is hidden, how strong, seen at which speeds.

    ``hide``: ``effect`` goes through the catalogue case by case, ``pair`` draws two of it,
    ``outside`` and ``parameter`` take the entry ``which``, as does ``effect`` if it is given.
    ``sampled`` samples the posterior of δ too, to compare the Laplace approximation with it.
    """

    hide: Literal["effect", "nothing", "pair", "outside", "parameter"]
    which: str | None = None
    strength: float = Field(1.0, gt=0.0)
    speeds_rpm: tuple[float, ...] = SPEEDS_RPM
    sampled: bool = False


COLUMNS = {
    "truth": ("1", "bits of the names hidden"),
    "verdict": ("1", f"place in {', '.join(VERDICTS)}"),
    **{f"set_{k}": ("1", f"bits of the names in set {k}") for k in range(1, MOST_NAMED + 1)},
    **{f"first_{k}": ("1", f"place of the first name of set {k}") for k in range(1, 4)},
    "z": ("1", "signature left after the best refit of all that is declared unknown"),
    "nearest": ("1", "distance of the truth's best fit to the nearest other candidate's"),
    "closed_used": ("1", "closed share of the disagreement with the noise-free truth, fitted"),
    "closed_held_out": ("1", "the same, held-out recording"),
    "delta_rad": ("rad", "gap simulated"),
    "delta_z_before": ("1", "error of ln δ in standard deviations, bench as believed"),
    "delta_z_after": ("1", "the same with what was named"),
    "delta_ratio_before": ("1", "fitted gap over the one simulated, bench as believed"),
    "delta_ratio_after": ("1", "the same with what was named"),
    "sampled_shift_sd": ("1", "posterior mean of ln δ by emcee less the optimum, in its sd"),
    "sampled_sd_ratio": ("1", "posterior sd of ln δ by emcee over the Laplace approximation's"),
    "suggested_rpm": ("rpm", "speed of the suggested recording"),
    "chi_square_before": ("1", "χ² per sample of the nominal fit"),
    "diagnosis_s": ("s", "time of the diagnosis alone"),
}


class Hidden(NamedTuple):
    """What only the maker of the recordings knows.

    ``names`` are those that an answer must hold; none for what is in no catalogue.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    settings: Mapping[str, float]


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One dataset, diagnosed and compared with the truth."""
    data_seed, sampling_seed = seed.spawn(2)
    generator = np.random.default_rng(data_seed)
    hidden = hide(row, index, generator)
    speeds = (*row.speeds_rpm, HELD_OUT_RPM)
    made = random_recordings(hidden.values, hidden.settings, generator, speeds_rpm=speeds)
    begin = time.perf_counter()
    found = _diagnosed(hidden, made, generator)
    diagnosis = diagnosis_of(found)
    seconds = time.perf_counter() - begin
    return {
        **_answer(found, diagnosis),
        **_score(found, diagnosis, hidden, made),
        **(_sampled(found, diagnosis, sampling_seed) if row.sampled else {}),
        "diagnosis_s": seconds,
    }


def hide(row: Row, index: int, generator: np.random.Generator) -> Hidden:
    """What a case hides."""
    values = values_of(reference_bench())
    if row.hide == "nothing":
        return Hidden((), values, {})
    if row.hide == "outside":
        assert row.which is not None
        return Hidden((), values, {k: row.strength * v for k, v in OUTSIDE[row.which].items()})
    if row.hide == "parameter":
        assert row.which is not None
        return Hidden((row.which,), values | {row.which: WRONG[row.which] * values[row.which]}, {})
    if row.hide == "pair":
        names: Sequence[str] = PAIRS[generator.integers(len(PAIRS))]
    else:
        names = (row.which or EFFECT_NAMES[index % len(EFFECT_NAMES)],)
    settings: dict[str, float] = {}
    for name in names:
        settings |= _strong(name, row.strength)
    return Hidden(tuple(names), values, settings)


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """How often which verdict, the right name, a set that holds it, a false name."""
    scores = [_judged(cases, k) for k in range(cases.sizes["case"])]
    line: dict[str, float | str] = {"n": float(len(scores))}
    verdicts = [VERDICTS[int(v)] for v in cases["verdict"].values]
    line |= {name: float(verdicts.count(name)) for name in VERDICTS}
    line["false_name"] = mean([bool(s.false) for s in scores])
    if any(s.truth for s in scores):
        clear = [s for s in scores if s.clear]
        other = [s for s in scores if not s.clear and s.visible]
        faint = [s for s in scores if not s.visible]
        line |= {
            "all_named": mean([s.all_first for s in scores]),
            "all_held": mean([s.all_held for s in scores]),
            "clear": float(len(clear)),
            "clear_named": mean([s.all_first and not s.false for s in clear]),
            "close": float(len(other)),
            "close_held": mean([s.all_held for s in other]),
            "faint": float(len(faint)),
            "faint_false": mean([bool(s.false) for s in faint]),
            "set_size": mean([size for s in scores for size in s.sizes]),
        }
    named = np.array([bool(s.sizes) for s in scores])
    for name, enough in (("closed_used", 0.95), ("closed_held_out", 0.9)):
        closed = cases[name].values[named]
        line[f"median_{name}"] = float(np.median(closed)) if closed.size else math.nan
        line[f"enough_{name}"] = mean(list(closed >= enough))
    for stage in ("before", "after"):
        errors = cases[f"delta_z_{stage}"].values
        errors = errors[np.isfinite(errors)]
        line[f"cover_90_{stage}"] = mean(list(np.abs(errors) < LEVEL_SD))
        ratios = np.abs(np.log(cases[f"delta_ratio_{stage}"].values))
        line[f"delta_factor_{stage}"] = float(np.exp(np.nanmedian(ratios)))
    if "sampled_sd_ratio" in cases:
        line["sampled_shift_most_sd"] = float(np.nanmax(np.abs(cases["sampled_shift_sd"].values)))
        line["sampled_sd_ratio_low"] = float(np.nanmin(cases["sampled_sd_ratio"].values))
        line["sampled_sd_ratio_high"] = float(np.nanmax(cases["sampled_sd_ratio"].values))
    line["median_s"] = float(np.median(cases["diagnosis_s"].values))
    return line


@dataclass(frozen=True, slots=True)
class Judged:
    """A case beside its truth.

    Attributes
    ----------
    false
        First names of sets that hold nothing of what was hidden.
    visible, clear
        Whether |z| is large enough to be seen, and apart from every other candidate besides.
    """

    truth: tuple[str, ...]
    verdict: str
    firsts: tuple[str, ...]
    false: tuple[str, ...]
    all_first: bool
    all_held: bool
    visible: bool
    clear: bool
    sizes: tuple[int, ...] = field(default=())


def _judged(cases: xr.Dataset, k: int) -> Judged:
    case = cases.isel(case=k)
    truth = _names(float(case["truth"]))
    sets = [_names(float(case[f"set_{i}"])) for i in range(1, MOST_NAMED + 1)]
    sets = [names for names in sets if names]
    firsts = tuple(NAMES[int(case[f"first_{i}"])] for i in range(1, len(sets) + 1))
    pairs = zip(firsts, sets, strict=True)
    visible = not float(case["z"]) < CLEAR
    return Judged(
        truth,
        VERDICTS[int(case["verdict"])],
        firsts,
        tuple(first for first, names in pairs if not set(names) & set(truth)),
        set(truth) <= set(firsts),
        all(any(name in names for names in sets) for name in truth),
        visible,
        visible and not float(case["nearest"]) < APART,
        tuple(len(names) for names in sets),
    )


def write_confusion(groups: Mapping[str, xr.Dataset], file: Path) -> None:
    """A line for every row and thing hidden, a column for every answer, with how often."""
    lines: dict[tuple[str, str], Counter[str]] = {}
    for row, cases in groups.items():
        for k in range(cases.sizes["case"]):
            judged = _judged(cases, k)
            answer = " + ".join(sorted(judged.firsts)) or judged.verdict
            lines.setdefault((row, " + ".join(judged.truth)), Counter())[answer] += 1
    answers = sorted({answer for counts in lines.values() for answer in counts})
    with open(file, "w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["row", "hidden", *answers])
        for (row, truth), counts in lines.items():
            writer.writerow([row, truth, *(counts[a] or "" for a in answers)])


def _strong(name: str, strength: float) -> dict[str, float]:
    """A typical effect, made stronger; its shape stays."""
    amplitudes = {item.name for item in effect_named(name).amplitudes}
    return {
        f"{name}__{key}": strength * value if key in amplitudes else value
        for key, value in TYPICAL[name].items()
    }


def _diagnosed(hidden: Hidden, made: Sequence[Made], generator: np.random.Generator) -> Findings:
    bench = reference_bench()
    seen = [observed(m.recording, bench, m.truth.reference_speed_rpm) for m in made]
    unknowns = [gap_unknown(*GAP_RANGE_RAD, item.recording.name) for item in made[:-1]]
    angle_known = "gravity_phase" in hidden.names
    for item in made[:-1]:
        name, angle = item.recording.name, item.truth.start_angle_rad
        if angle_known:
            angle += KNOWN_ANGLE_SD_RAD * generator.standard_normal()
            sd = KNOWN_ANGLE_SD_RAD
            unknowns.append(Unknown(START_ANGLE, centre=angle, sd=sd, recording=name))
        else:
            unknowns.append(start_angle(name))
    return search(bench, seen[:-1], seen[-1:], unknowns, load_angle_known=angle_known)


def _answer(found: Findings, diagnosis: Diagnosis) -> dict[str, float]:
    answer = {"verdict": float(VERDICTS.index(diagnosis.verdict))}
    effects = found.naming.effects
    for k in range(MOST_NAMED):
        there = k < len(effects)
        answer[f"set_{k + 1}"] = _bits(effects[k].members) if there else 0.0
        answer[f"first_{k + 1}"] = float(NAMES.index(effects[k].name)) if there else math.nan
    suggestion = diagnosis.suggestion
    answer["suggested_rpm"] = math.nan if suggestion is None else suggestion.reference_speed_rpm
    fit = found.naming.nominal.fit
    answer["chi_square_before"] = fit.chi_square / fit.residual.size
    return answer


def _score(
    found: Findings, diagnosis: Diagnosis, hidden: Hidden, made: Sequence[Made]
) -> dict[str, float]:
    z, nearest = _signature(found, hidden)
    score = {"truth": _bits(hidden.names), "z": z, "nearest": nearest}
    for use in ("used", "held_out"):
        score[f"closed_{use}"] = closed_share(found, made, use)
    first = made[0].truth
    gap = score["delta_rad"] = first.gap_rad
    for stage, estimate in (
        ("before", diagnosis.delta_before),
        ("after", diagnosis.delta_after),
    ):
        error = math.nan if estimate is None else estimate.value - math.log(gap)
        score[f"delta_ratio_{stage}"] = math.exp(error)
        score[f"delta_z_{stage}"] = math.nan if estimate is None else error / estimate.sd
    return score


def _sampled(
    found: Findings, diagnosis: Diagnosis, seed: np.random.SeedSequence
) -> dict[str, float]:
    """The posterior of the gap by emcee beside the Laplace approximation, of the chosen bench."""
    if diagnosis.delta_after is None:
        return {}
    laplace, first = found.final.fit, found.final.fit.model.recordings[0].name
    posterior = sample_direct(found.final.fit, SamplerSettings(), seed)
    log_gap = np.log(posterior.values(GAP, first))
    return {
        "sampled_shift_sd": (float(log_gap.mean()) - math.log(laplace.value(GAP, first)))
        / laplace.sd(GAP, first),
        "sampled_sd_ratio": float(log_gap.std()) / laplace.sd(GAP, first),
    }


def _signature(found: Findings, hidden: Hidden) -> tuple[float, float]:
    """√Δχ² of the truth's own fit over the nominal one, and its distance to the nearest other."""
    if len(hidden.names) != 1:
        return math.nan, math.nan
    nominal, own = found.naming.nominal, _own_fit(found, hidden)
    if own is None:
        return math.nan, math.nan
    others = [e for e in _alone(found) if e.names != own.names]
    gain = max(0.0, nominal.fit.chi_square - own.fit.chi_square)
    return math.sqrt(gain), min((_distance(own, other) for other in others), default=math.nan)


def _alone(found: Findings) -> list[Explanation]:
    """Fitted sets of a single candidate, the most probable first."""
    sets = [entry.explanation for entry, _ in found.naming.sets]
    return [explanation for explanation in sets if len(explanation.candidates) == 1]


def _distance(a: Explanation, b: Explanation) -> float:
    """|z| between the best fits of two explanations: their difference in units of noise."""
    return float(np.linalg.norm(a.fit.residual - b.fit.residual))


def _own_fit(found: Findings, hidden: Hidden) -> Explanation | None:
    """The truth's fit; made here if the diagnosis saw no order to begin with."""
    nominal, name = found.naming.nominal, hidden.names[0]
    for own in _alone(found):
        if own.names == (name,):
            return own
    order = TYPICAL[name].get("order", 1.0)
    known = candidates(nominal.fit.model.bench, nominal.fit.model.recordings, [name], [order])
    for candidate in known:
        if candidate.name == name:
            size = candidate.neutral + np.nan_to_num(candidate.usual)
            return refit(nominal, [(candidate, size)], np.zeros(nominal.fit.point.size))
    return None


def closed_share(found: Findings, made: Sequence[Made], use: str) -> float:
    """Share of the mean square distance to the noise-free truth that naming has closed."""
    clean = {item.recording.name: item.clean[1:] for item in made}
    before = after = 0.0
    for piece in found.pieces:
        if piece.use == use:
            truth = clean[piece.recording][CHANNELS.index(piece.channel)]
            weight = 1.0 / piece.noise_floor**2
            before += float(np.sum(weight * (truth - piece.before) ** 2))
            after += float(np.sum(weight * (truth - piece.after) ** 2))
    return 1.0 - after / before


def _bits(names: Sequence[str]) -> float:
    return float(sum(1 << NAMES.index(name) for name in set(names)))


def _names(bits: float) -> tuple[str, ...]:
    whole = 0 if math.isnan(bits) else int(bits)
    return tuple(name for k, name in enumerate(NAMES) if whole >> k & 1)


def _main() -> None:
    result, target = Path(sys.argv[1]), Path(sys.argv[2])
    with xr.open_datatree(result) as tree:
        groups = {
            json.loads(tree[key].attrs["line"])["name"]: tree[key].to_dataset()
            for key in sorted(tree.children, key=lambda key: int(key.removeprefix("row_")))
        }
        write_confusion(groups, target)


if __name__ == "__main__":
    _main()
