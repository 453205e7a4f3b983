"""``kind = "identify"``: find the bench that a data sheet and recordings describe."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import xarray as xr

from bayesbl.bench.bench import Bench, heaviest, require_flank_change
from bayesbl.config.bench import load_bench
from bayesbl.config.kinds import IdentifyConfig
from bayesbl.errors import ConfigError
from bayesbl.identification.groups import identification_tree
from bayesbl.identification.identify import Identification, Problem, identify
from bayesbl.matching.observed import Observed, marginalising_motor_lines, observed
from bayesbl.model_search.always_in import with_friction
from bayesbl.recording.checks import ready_for_fit, require_alive
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import MOTOR_CURRENT
from bayesbl.results.identified import require_gap
from bayesbl.results.provenance import provenance_of
from bayesbl.results.work import WorkStore
from bayesbl.runs.workflow import Options, Plan, settings_of
from bayesbl.sampling.chains import SamplerSettings


def make(config: IdentifyConfig, options: Options, work: WorkStore) -> xr.DataTree:
    """Identify as configured. Raises UserError if data sheet or recordings cannot be used."""
    problem, notes = problem_of(config)
    level, seed = config.interval.level, np.random.SeedSequence(config.run.seed)
    match = work.get(
        "identification",
        (settings_of(config), problem),
        lambda: identify(problem, SamplerSettings(level=level), seed, options.progress),
        Identification,
    )
    tree = identification_tree(match, problem, level, config.interval.kind)
    tree.attrs["warnings"] = [*tree.attrs["warnings"], *notes]
    tree.attrs |= provenance_of(config)
    return tree


def describe(config: IdentifyConfig, plan: Plan) -> None:
    """What would be identified, and from what."""

    def problem() -> str:
        identified, notes = problem_of(config)
        plan.warnings += notes
        return (
            f"{', '.join(identified.parameters)} from {len(identified.used)} recordings, each with "
            f"its own gap; {len(identified.held_out)} held out"
        )

    plan.add("identify", problem)


def problem_of(config: IdentifyConfig) -> tuple[Problem, list[str]]:
    """Bench and recordings, ready to be compared, with notes on what is assumed of them."""
    bench = load_bench(config.bench)
    require_gap(bench, config.bench)
    parameters = _parameters(config, bench)
    notes: list[str] = []
    by_use: dict[str, list[Observed]] = {"fit": [], "hold_out": []}
    for entry in config.recordings:
        recording = read_recording(entry.file, name=entry.name, columns=config.column_specs)
        recording = ready_for_fit(recording, bench.value("gear_ratio"))
        require_alive(recording, (MOTOR_CURRENT,))
        known = {name.replace(".", "__"): value for name, value in entry.bench.items()}
        one = observed(recording, bench, entry.reference_speed_rpm)
        one = marginalising_motor_lines(replace(one, known={**one.known, **known}), bench)
        by_use[entry.use].append(one)
        notes += [f"{entry.name}: {note}" for note in (*recording.notes, *one.notes)]
    used = tuple(by_use["fit"])
    steady = all(one.motion is None for one in used)
    if steady:
        speeds = [one.reference_speed_rpm for one in used]
        require_flank_change(heaviest(bench), speeds, config.bench)
    if steady and len({one.reference_speed_rpm for one in used}) < 2:
        notes.append(
            "All recordings are at one speed in one direction: strokes to and fro, another speed "
            "and the other direction show much more."
        )
    if any(len(one.signals) < 2 for one in used):
        notes.append(
            "There is no motor current in every recording: torques are known only up to what the "
            "data sheet says."
        )
    bench = with_friction(bench, used)
    asked = config.identify.effects
    if asked != "catalogue":
        present = {effect.name for effect in bench.effects}
        asked = tuple(name for name in asked if name not in present)
    problem = Problem(
        bench,
        used,
        tuple(by_use["hold_out"]),
        parameters,
        asked,
        config.identify.gap_rad,
        config.run.workers,
    )
    return problem, notes


def _parameters(config: IdentifyConfig, bench: Bench) -> tuple[str, ...]:
    tolerances = bench.tolerances
    if not tolerances:
        raise ConfigError(
            "There is nothing to identify: no parameter of the bench has a tolerance.",
            file=config.bench,
            where="[parameters]",
            expected="relative_tolerance = 0.25 (± 25 %) for each uncertain value; "
            "`bayesbl init --bench` writes a file with all of them explained",
        )
    asked = config.identify.parameters
    if asked == "toleranced":
        return tuple(tolerances)
    for name in asked:
        if name not in tolerances:
            raise ConfigError(
                "A parameter is identified within its tolerance, and this one has none.",
                file=config.bench,
                where=f"[parameters] {name}",
                expected=f"a tolerance or relative_tolerance for {name}, or leave it out",
            )
    return tuple(asked)
