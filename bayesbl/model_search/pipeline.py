"""What does the bench lack, and what is the gap with that in doubt: one way for all who ask.

A diagnosis, an identification and the direct route of a measurement go it together. Each step has
one type, and makes the next one's:

1. fit: all recordings at once, aligned and with their own noise (:class:`SimulatedFit`);
2. linearise: laws and drift beside the fit, and what is far from none made an unknown of it
   (:class:`bayesbl.model_search.always_in.Beside`);
3. name: sets of hypotheses, each fitted in full and weighed
   (:class:`bayesbl.model_search.closed_loop.Naming`);
4. refit: with what is named, what is beside it linearised again (:class:`AveragedFit`);
5. sample, and marginalise all that the fit takes to be as it has it (:class:`DirectPosterior`).

Who asks differs in the hypotheses, in what is always beside them, and in what is done where none of
them explains the recordings: a measurement asks only where its bench explains them not, a diagnosis
learns a torque, an identification seeks a value that is wrong by far.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import logsumexp

from bayesbl.bench.bench import Bench
from bayesbl.matching.alignment import believed, fit_aligned
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
    Beside,
    Direction,
    beside,
    common_unknowns,
    directions,
    marginalised,
    other_loops,
    settled,
    with_friction,
)
from bayesbl.model_search.closed_loop import FittedSet, averaged, weighed
from bayesbl.model_search.joint_change import (
    JointFindings,
    changed_beside,
    elastic_parts,
    find_changes,
    with_part,
)
from bayesbl.model_search.refit import Explanation
from bayesbl.progress import Progress, StageProgress, of_stage, silent
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
    """A gap and a start angle for each recording, and what is not known of their bench.

    ``moving``: names of those that are of motions.
    """
    return [
        *(gap_unknown(*gap_rad, name) for name in names),
        *(start_angle_unknown(name) for name in names),
        *(reference_delay_unknown(name) for name in moving),
        *effect_unknowns(bench, names),
        *tolerance_unknowns(bench),
    ]


def friction_drift(
    unknowns: Sequence[Unknown], among: Sequence[Direction], later: Sequence[str]
) -> list[Unknown]:
    """What friction that is unknown anyway drifts by in later recordings, in proportion to it.

    It moves the current's mean by many times its noise: a fit that has it the same in all turns to
    a bench that never was, and nothing is linear there. A speed alone shows little of it.
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
        for d in among
        if d.slot in sizes and d.drift > 0.0
    ]


def rival_loops(
    rest: Beside, among: Sequence[Direction], whole: float
) -> list[tuple[FittedSet, float]]:
    """Other loops that explain the recordings as well, each with its share of a probability."""
    fits = [rest.fit, *other_loops(rest)]
    if len(fits) == 1:
        return []
    common = min(sum(1 for _ in common_unknowns(fits[0].model, f.model)) for f in fits[1:])
    sets = [weighed(Explanation((), fit), among) for fit in fits]
    evidence = np.array(
        [
            own.log_evidence - sum(math.log(u.prior_sd) for u in own.fit.model.unknowns[common:])
            for own in sets
        ]
    )
    share = whole * np.exp(evidence - logsumexp(evidence))
    return [(own, float(p)) for own, p in zip(sets[1:], share[1:], strict=True) if p > 0.0]


@dataclass(frozen=True, slots=True, kw_only=True)
class AveragedFit:
    """The fit that answers, and all that its draws are averaged over.

    Attributes
    ----------
    rest
        The fit, and what stands beside it.
    others
        Other sets of what the bench may lack, each with its probability.
    among
        What is always beside each of these, where the search had nothing there.
    """

    rest: Beside | FittedSet
    others: Sequence[tuple[FittedSet, float]] = ()
    among: Sequence[Direction] = ()

    def sampled(
        self,
        settings: SamplerSettings,
        seed: np.random.SeedSequence,
        drawing: Progress = silent,
        simulating: Progress = silent,
        *,
        withheld: bool = False,
    ) -> DirectPosterior:
        """As :func:`sample_direct` draws of the fit, and averaged unless ``withheld``."""
        fit = self.rest.fit
        posterior = sample_direct(fit, settings, seed, drawing, simulating, withheld=withheld)
        return posterior if withheld else self.averaged(posterior, seed)

    def averaged(self, posterior: DirectPosterior, seed: np.random.SeedSequence) -> DirectPosterior:
        """Draws of the fit with impacts that differ, laws, drift, and all that the bench may
        lack."""
        scattering, drifting, others = seed.spawn(3)
        whole = marginalised(widened(posterior, scattering), self.rest.posterior, drifting)
        return averaged(whole, self.others, others, self.among) if self.others else whole


@dataclass(frozen=True, slots=True, kw_only=True)
class JointFit(AveragedFit):
    """All recordings of a joint fitted together.

    ``joint``: whether one joint, as its bench describes it, made the recordings.
    """

    rest: Beside
    joint: JointFindings

    @property
    def allows_for_misfit(self) -> bool:
        """Whether δ includes what a law that nothing names may do to it."""
        return not self.joint.explained and self.rest.is_useful


def fit_jointly(
    bench: Bench,
    recordings: Sequence[Observed],
    gap_rad: tuple[float, float],
    drift: Mapping[str, float],
    workers: int = 1,
    progress: StageProgress | None = None,
) -> JointFit:
    """The optimum of all recordings together.

    Friction, laws that bias the gap before they show, and what drifts between the recordings, are
    always allowed for. What the bench lacks beside that, or changed in the joint, is freed where it
    is named. ``drift``: relative standard deviations by name, in place of the defaults.
    """
    recordings = [marginalising_motor_lines(observation, bench) for observation in recordings]
    bench = with_friction(bench, recordings)
    among = directions(bench, drift)
    moving = [r.name for r in recordings if r.motion is not None]
    unknowns = direct_unknowns(bench, [r.name for r in recordings], gap_rad, moving)
    with_current = [r.name for r in recordings[1:] if len(r.signals) > 1]
    unknowns += friction_drift(unknowns, among, with_current)
    name = " and ".join(r.name for r in recordings)
    aligning = of_stage(progress, f"Fitting the bench to {name}")
    nominal = believed(fit_aligned(bench, recordings, unknowns, workers, aligning))
    allowing = of_stage(progress, f"Allowing for what the bench lacks in {name}")
    rest = settled(nominal, among, allowing)
    if rest.explains:
        sets = () if moving else elastic_parts(rest.fit, among)
        for best, probability in sets[:1]:
            if best.explanation.candidates:
                fit, own_values, part = with_part(nominal, best.explanation, probability)
                wider = [*among, *own_values]
                own = settled(fit, wider, allowing)
                if own.explains:
                    joint = changed_beside(own.fit, wider, part)
                    return JointFit(rest=own, others=sets[1:], joint=joint)
        others = [(own, p) for own, p in sets if own.explanation.candidates]
        others += rival_loops(rest, among, 1.0 - sum(p for _, p in others))
        return JointFit(rest=rest, others=others, joint=changed_beside(rest.fit, among))
    seeking = of_stage(progress, f"Seeking changes in {name}")
    naming, joint = find_changes(rest.fit, among=among, progress=seeking)
    rest = naming.rest or beside(naming.final.fit, among)
    if not rest.has_discrepancy:
        # Lags that stood in for what is named need not stand in for anything any more.
        free, known = settled(rest.fit, among, allowing), len(rest.fit.model.unknowns)
        if all(u.recording is None for u in free.fit.model.unknowns[known:]):
            rest = free
    # Sets that explain too little to be named know less of the misfit than the bench does.
    return JointFit(rest=rest, others=naming.others if naming.effects else (), joint=joint)
