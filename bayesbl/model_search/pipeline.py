"""Find what the bench lacks, and the gap given that this is uncertain.

A diagnosis, an identification and the direct route of a measurement use the same steps. Each step
has one type, which is the input of the next:

1. fit: all recordings at once, aligned, with their own noise (:class:`SimulatedFit`);
2. linearise: laws and drift are linear at the fit; those far from their values in the fit become
   its unknowns (:class:`bayesbl.model_search.always_in.LinearisedFit`);
3. name: sets of hypotheses, each fitted in full and weighted by its evidence
   (:class:`bayesbl.model_search.closed_loop.Naming`);
4. refit: with the named hypotheses, and the others linearised again (:class:`AveragedFit`);
5. sample, and marginalise everything that the fit held fixed (:class:`DirectPosterior`).

The callers differ in their hypotheses, in what they always marginalise, and in what they do if no
hypothesis explains the recordings. A measurement searches only if its bench does not explain the
recordings, a diagnosis learns a torque, and an identification looks for a grossly wrong value.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bayesbl.bench.bench import Bench
from bayesbl.matching.alignment import fit_aligned, valid_variant
from bayesbl.matching.observed import Observed, marginalising_motor_lines
from bayesbl.matching.posterior import DirectPosterior, sample_direct, widened
from bayesbl.matching.signals import (
    Unknown,
    effect_unknowns,
    gap_unknown,
    reference_delay_unknown,
    start_angle_unknown,
    tolerance_unknowns,
)
from bayesbl.model_search.always_in import (
    LEAST_SHARE,
    Direction,
    LinearisedFit,
    directions,
    linearised_fit,
    marginalised,
    other_loops,
    with_far_terms_freed,
    with_friction,
)
from bayesbl.model_search.closed_loop import FittedSet, averaged
from bayesbl.model_search.joint_change import (
    JointFindings,
    changes_at_fit,
    find_changes,
    loops_and_parts,
    with_part,
)
from bayesbl.progress import Progress, StageProgress, joined, of_stage, silent
from bayesbl.sampling.chains import SamplerSettings

FRICTION = (
    "motor_viscous_friction",
    "motor_coulomb_friction",
    "load_viscous_friction",
    "load_coulomb_friction",
)


def direct_unknowns(
    bench: Bench,
    names: Sequence[str],
    gap_rad: tuple[float, float],
    moving: Sequence[str] = (),
) -> list[Unknown]:
    """Gap and start angle of each recording, and everything that the bench leaves open.

    ``moving``: names of the recordings of motions.
    """
    return [
        *(gap_unknown(*gap_rad, name) for name in names),
        *(start_angle_unknown(name) for name in names),
        *(reference_delay_unknown(name) for name in moving),
        *effect_unknowns(bench, names),
        *tolerance_unknowns(bench),
    ]


def friction_drift(
    unknowns: Sequence[Unknown], nuisances: Sequence[Direction], later: Sequence[str]
) -> list[Unknown]:
    """Drift of unknown friction in later recordings, in proportion to the friction.

    Drift of friction moves the mean current by many times its noise. A fit with the same friction
    in all recordings would move to a wrong bench, where a linearisation is useless. Speed alone
    shows little of this drift.
    """
    sizes = {u.name: u.centre or u.sd for u in unknowns if u.name.partition("__")[0] in FRICTION}
    return [
        Unknown(
            d.slot,
            (LEAST_SHARE - 1.0) * sizes[d.slot],
            sd=d.drift,
            recording=name,
            added=True,
            reference=sizes[d.slot],
        )
        for name in later
        for d in nuisances
        if d.slot in sizes and d.drift > 0.0
    ]


@dataclass(frozen=True, slots=True, kw_only=True)
class AveragedFit:
    """The fit that gives the answer, and the models that its draws are averaged over.

    ``linear_fit``: the fit, with the terms linearised at it; ``others``: other sets of what the
    bench may lack, each with its probability; ``nuisances``: directions to marginalise in each of
    these sets, if the search did not do so.
    """

    linear_fit: LinearisedFit | FittedSet
    others: Sequence[tuple[FittedSet, float]] = ()
    nuisances: Sequence[Direction] = ()

    def sampled(
        self,
        settings: SamplerSettings,
        seed: np.random.SeedSequence,
        drawing: Progress = silent,
        simulating: Progress = silent,
        *,
        withheld: bool = False,
    ) -> DirectPosterior:
        """Draw as :func:`sample_direct` does, and average over models unless ``withheld``."""
        fit = self.linear_fit.fit
        posterior = sample_direct(fit, settings, seed, drawing, simulating, withheld=withheld)
        return posterior if withheld else self.averaged(posterior, seed)

    def averaged(self, posterior: DirectPosterior, seed: np.random.SeedSequence) -> DirectPosterior:
        """Add to the draws the scatter of impacts, laws, drift, and all that the bench may lack."""
        scatter_seed, drift_seed, average_seed = seed.spawn(3)
        full = marginalised(widened(posterior, scatter_seed), self.linear_fit.posterior, drift_seed)
        return averaged(full, self.others, average_seed, self.nuisances) if self.others else full


@dataclass(frozen=True, slots=True, kw_only=True)
class JointFit(AveragedFit):
    """All recordings of a joint fitted together.

    ``joint``: whether one joint, as its bench describes it, made the recordings.
    """

    linear_fit: LinearisedFit
    joint: JointFindings

    @property
    def allows_for_misfit(self) -> bool:
        """Whether δ includes the possible effect of an unnamed law."""
        return not self.joint.explained and self.linear_fit.is_useful


def fit_jointly(
    bench: Bench,
    recordings: Sequence[Observed],
    gap_rad: tuple[float, float],
    drift: Mapping[str, float],
    workers: int = 1,
    progress: StageProgress | None = None,
) -> JointFit:
    """Fit all recordings together.

    Friction, laws that bias the gap before they show, and drift between the recordings are always
    allowed for. Anything else that the bench lacks, or that changed in the joint, is freed if it is
    named. ``drift``: relative standard deviations by name, in place of the defaults.
    """
    recordings = [marginalising_motor_lines(observation, bench) for observation in recordings]
    bench = with_friction(bench, recordings)
    nuisances = directions(bench, drift)
    moving = [r.name for r in recordings if r.motion is not None]
    unknowns = direct_unknowns(bench, [r.name for r in recordings], gap_rad, moving)
    with_current = [r.name for r in recordings[1:] if len(r.signals) > 1]
    unknowns += friction_drift(unknowns, nuisances, with_current)
    name = joined([r.name for r in recordings])
    aligning = of_stage(progress, f"Fitting the bench to {name}")
    nominal = valid_variant(
        fit_aligned(bench, recordings, unknowns, workers, aligning),
        lambda fit: linearised_fit(fit, nuisances).explains,
    )
    allowing = of_stage(progress, f"Allowing for what the bench lacks in {name}")
    linear_fit = with_far_terms_freed(nominal, nuisances, allowing)
    if linear_fit.explains:
        sets = loops_and_parts(linear_fit.fit, other_loops(linear_fit), nuisances)
        for best, probability in sets[:1]:
            if best.explanation.candidates:
                fit, part_values, part = with_part(nominal, best.explanation, probability)
                extended = [*nuisances, *part_values]
                part_fit = with_far_terms_freed(fit, extended, allowing)
                if part_fit.explains:
                    joint = changes_at_fit(part_fit.fit, extended, part)
                    return JointFit(linear_fit=part_fit, others=sets[1:], joint=joint)
        others = [(entry, p) for entry, p in sets if entry.fit.model is not linear_fit.fit.model]
        return JointFit(
            linear_fit=linear_fit, others=others, joint=changes_at_fit(linear_fit.fit, nuisances)
        )
    seeking = of_stage(progress, f"Seeking changes in {name}")
    naming, linear_fit, joint = find_changes(linear_fit.fit, nuisances, seeking)
    if not linear_fit.has_discrepancy:
        # Lags in place of what is now named may no longer be needed.
        unlagged = with_far_terms_freed(linear_fit.fit, nuisances, allowing)
        freed = unlagged.fit.model.unknowns[len(linear_fit.fit.model.unknowns) :]
        if all(u.recording is None for u in freed):
            linear_fit = unlagged
    # Sets that explain too little to be named know less about the misfit than the bench does.
    return JointFit(
        linear_fit=linear_fit, others=naming.others if naming.effects else (), joint=joint
    )
