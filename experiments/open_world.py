"""What does a diagnosis make of laws that no catalogue has?

    bayesbl run configs/open_world_core.toml       # or open_world.toml

A case hides one to three laws in the simulator of ``independent_bench.py`` that differ from the
catalogue's, with strengths log-uniform over a decade: recordings at 2000, −2000 and 1200 rpm and
one at 1600 rpm that is held out, a random gap, random start angles, coloured noise. A name is
right if it is of the hidden law's family. Of what is left a learned torque should close most.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Annotated

import numpy as np
import xarray as xr
from hidden_effects import GAP_RANGE_RAD, HELD_OUT_RPM, LEVEL_SD, NAMES, VERDICTS, closed_share
from independent_bench import SPEEDS_RPM, random_recordings, values_of
from pydantic import Field, field_validator
from study_tools import StudyRow, mean

from bayesbl.bench.learned import VARIABLES
from bayesbl.config.bench import reference_bench
from bayesbl.diagnosis.closed_loop.diagnosis import diagnosis_of, search
from bayesbl.matching.observed import observed
from bayesbl.matching.signals import gap_unknown, start_angle_unknown
from bayesbl.model_search.closed_loop import laws_of_shaft, weighed

MOTOR_FRICTION = ("motor_coulomb_friction", "motor_viscous_friction", "motor_stribeck_friction")
LOAD_FRICTION = ("load_coulomb_friction", "load_viscous_friction")

LAWS: Mapping[str, tuple[str, float, tuple[str, ...]]] = {
    "Coulomb, other smoothing": ("outside__load_coulomb_nm", 8.0, LOAD_FRICTION),
    "LuGre": ("outside__lugre_nm", 0.1, MOTOR_FRICTION),
    "Stribeck, exponent 1": ("outside__stribeck_1_nm", 0.2, MOTOR_FRICTION),
    "ripple with harmonics": ("outside__ripple_nm", 0.04, ("motor_torque_ripple",)),
    "friction over position": ("outside__position_friction_nm", 8.0, LOAD_FRICTION),
    "damping by root of compression": (
        "outside__contact_damping_nm_s_per_rad",
        3e3,
        ("contact_damping", "shaft_damping_nm_s_per_rad"),
    ),
    "Bouc-Wen": ("outside__bouc_wen_nm", 12.0, ("shaft_hysteresis",)),
}
"""Law to its parameter, a middling strength, and the names that are its family."""

SHAFT_LAWS = ("damping by root of compression", "Bouc-Wen")

LEARNED_AT = ("motor", "load", "encoder")
"""Where what was learned may act, numbered in this order."""

CLEAR = 100.0
"""χ² by which the bench as believed misses what it was fitted to, from which on a law is clear."""


class Row(StudyRow):
    """``laws``: how many are hidden at once, or their names in every case."""

    laws: Annotated[int, Field(ge=1, le=3)] | tuple[str, ...]

    @field_validator("laws")
    @classmethod
    def _are_laws(cls, laws: int | tuple[str, ...]) -> int | tuple[str, ...]:
        if not isinstance(laws, int) and not (laws and set(laws) <= set(LAWS)):
            raise ValueError(f"laws must be among {', '.join(LAWS)}")
        return laws

    @property
    def count(self) -> int:
        """Laws hidden at once."""
        return self.laws if isinstance(self.laws, int) else len(self.laws)


COLUMNS = {
    "truth": ("1", "bits of the laws hidden"),
    "strength": ("1", "of the first law, over the middling one"),
    "verdict": ("1", f"place in {', '.join(VERDICTS)}"),
    "named": ("1", "bits of the names given"),
    "right": ("1", "laws of which a name of the family was given"),
    "false": ("1", "names given of no hidden law's family, nor told apart from one"),
    "miss": ("1", "χ² of the bench as believed beyond the number of samples"),
    "learned": ("1", "0: nothing, else 1 + 4 place + variable, 100 more where it reverses"),
    "orders": ("1", "of the learned torque"),
    "closed_held_out": ("1", "closed share of the distance to the noise-free truth, held out"),
    "delta_rad": ("rad", "gap simulated"),
    "delta_z_before": ("1", "error of ln δ in standard deviations, bench as believed"),
    "delta_z_after": ("1", "the same with what was named and learned; nan where withheld"),
    "delta_ratio_before": ("1", "gap fitted with the bench as believed, over the one simulated"),
    "delta_ratio_after": ("1", "the same with what was named and learned"),
    "form_share": (
        "1",
        "χ² that repeats after naming over that before, if a law of the shaft is named",
    ),
    "diagnosis_s": ("s", "time of the diagnosis alone"),
}


def run_case(row: Row, index: int, seed: np.random.SeedSequence) -> Mapping[str, float]:
    """One dataset, diagnosed and compared with the truth."""
    generator = np.random.default_rng(seed)
    if not isinstance(row.laws, int):
        laws = list(row.laws)
    elif row.laws == 1:
        laws = [list(LAWS)[index % len(LAWS)]]
    else:
        laws = [str(name) for name in generator.choice(list(LAWS), row.laws, replace=False)]
    strengths = 10.0 ** generator.uniform(-0.5, 0.5, len(laws))
    settings = {
        LAWS[law][0]: strength * LAWS[law][1] for law, strength in zip(laws, strengths, strict=True)
    }
    if "ripple with harmonics" in laws:
        settings["outside__ripple_order"] = float(generator.integers(1, 7))
    if "friction over position" in laws:
        settings["outside__position_friction_phase_rad"] = generator.uniform(-math.pi, math.pi)
    speeds = (*SPEEDS_RPM, HELD_OUT_RPM)
    bench = reference_bench()
    made = random_recordings(values_of(bench), settings, generator, speeds_rpm=speeds)
    begin = time.perf_counter()
    seen = [observed(m.recording, bench, m.truth.reference_speed_rpm) for m in made]
    unknowns = [gap_unknown(*GAP_RANGE_RAD, m.recording.name) for m in made[:-1]]
    unknowns += [start_angle_unknown(m.recording.name) for m in made[:-1]]
    found = search(bench, seen[:-1], seen[-1:], unknowns)
    diagnosis = diagnosis_of(found)
    seconds = time.perf_counter() - begin
    families = [LAWS[law][2] for law in laws]
    sets = [effect.members for effect in found.naming.effects]
    fit = found.naming.nominal.fit
    learned = diagnosis.learned
    code = 0.0
    if learned is not None:
        term = learned.term
        code = 1.0 + 4.0 * LEARNED_AT.index(term.side) + VARIABLES.index(term.variable)
        code += 100.0 * term.reverses
    gap = made[0].truth.gap_rad
    score = {
        "truth": float(sum(1 << list(LAWS).index(law) for law in laws)),
        "strength": float(strengths[0]),
        "verdict": float(VERDICTS.index(diagnosis.verdict)),
        "named": float(sum(1 << NAMES.index(members[0]) for members in sets)),
        "right": float(sum(any(set(family) & set(m) for m in sets) for family in families)),
        "false": float(sum(not any(set(family) & set(m) for family in families) for m in sets)),
        "miss": fit.chi_square - fit.residual.size,
        "learned": code,
        "orders": math.nan if learned is None else float(learned.term.orders),
        "closed_held_out": closed_share(found, made, "held_out"),
        "delta_rad": gap,
        "form_share": math.nan,
        "diagnosis_s": seconds,
    }
    if laws_of_shaft(found.naming.final):
        before, after = (weighed(e).excess for e in (found.naming.nominal, found.naming.final))
        score["form_share"] = after / max(before, 1e-300)
    for stage, estimate in (
        ("before", diagnosis.delta_before),
        ("after", diagnosis.delta_after),
    ):
        error = math.nan if estimate is None else estimate.value - math.log(gap)
        score[f"delta_z_{stage}"] = math.nan if estimate is None else error / estimate.sd
        score[f"delta_ratio_{stage}"] = math.exp(error)
    return score


def summarise(row: Row, cases: xr.Dataset) -> Mapping[str, float | str]:
    """Names, what was learned, what it closes, how δ is covered."""
    column = {name: cases[name].values for name in COLUMNS}
    clear = column["miss"] > CLEAR
    some = column["learned"] > 0.0
    verdicts = [VERDICTS[int(v)] for v in column["verdict"]]
    line: dict[str, float | str] = {"n": float(len(verdicts))}
    line |= {name: float(verdicts.count(name)) for name in VERDICTS}
    line |= {
        "clear": float(clear.sum()),
        "right_of_clear": mean(column["right"][clear] >= 1.0),
        "all_right_of_clear": mean(column["right"][clear] >= row.count),
        "right_or_learned_of_clear": mean(
            (column["right"] >= 1.0)[clear] | (some & (column["closed_held_out"] >= 0.8))[clear]
        ),
        "false_name": mean(column["false"] > 0.0),
        "learned": float(some.sum()),
        "closed_learned_median": float(np.median(column["closed_held_out"][some]))
        if some.any()
        else math.nan,
        "closed_learned_enough": mean(column["closed_held_out"][some] >= 0.8),
        "unexplained_unlearned": float(
            sum(v == "unexplained" and not s for v, s in zip(verdicts, some, strict=True))
        ),
    }
    for stage in ("before", "after"):
        errors = column[f"delta_z_{stage}"]
        errors = errors[np.isfinite(errors)]
        line[f"cover_90_{stage}"] = mean(np.abs(errors) < LEVEL_SD)
        line[f"delta_given_{stage}"] = float(errors.size)
    # What a law's form leaves, and does to δ.
    error = np.log(column["delta_ratio_after"])
    moved = np.log(column["delta_ratio_before"]) - error
    for law in SHAFT_LAWS if row.count == 1 else ():
        of_law = column["truth"] == float(1 << list(LAWS).index(law))
        of_law &= np.isfinite(column["form_share"]) & np.isfinite(error)
        line[f"{law}: form_share_max"] = float(np.max(column["form_share"][of_law], initial=0.0))
        line[f"{law}: error/moved"] = float(np.sqrt(np.mean((error / moved)[of_law] ** 2)))
    line["median_s"] = float(np.median(column["diagnosis_s"]))
    return line
