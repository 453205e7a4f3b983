"""The sentence of every reason that a measurement gives, from its code and numbers.

Measurements store codes and numbers only. Whoever shows them gets the sentence here, and nothing
reads a sentence back.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from string import Formatter
from typing import TYPE_CHECKING, Any

from bayesbl.errors import NoFlankChange
from bayesbl.units import number

if TYPE_CHECKING:
    from bayesbl.sampling.convergence import Flaw

FEW_WEIGH = (
    "Only {effective:.0f} of {draws} draws count after full simulation ({needed:.0f} are needed): "
)

UNLESS_REPAIRED = (
    "If the joint was repaired, mark the first recording after the repair (repaired = true). If "
    "not, check that no files or dates are swapped. If temperature or grease moves the gap from "
    "date to date, say by how much: relative_sd_per_date = 0.02 under [wear] is 2 %."
)


def sentence(reason: Mapping[str, Any]) -> str:
    """The sentence of a stored reason, with those of all reasons below it.

    ``reason`` has its ``code``, the values of its sentence, ``recordings`` if it concerns only
    some, and ``also`` with further reasons.
    """
    values = {k: v for k, v in reason.items() if k not in _NO_VALUES}
    made = SENTENCES.get(reason["code"], "{text}")
    if "text" in values:
        text = str(values["text"])
    elif callable(made):
        text = made(**values)
    else:
        text = _Phrases().vformat(made, (), values)
    if reason.get("recordings"):
        text = f"{', '.join(reason['recordings'])}: {text}"
    return " ".join([text, *map(sentence, reason.get("also", ()))])


_NO_VALUES = ("code", "recordings", "also", "withholds", "route", "delta_error_rad")


class _Phrases(Formatter):
    """``{share:.0f %}`` is a share in per cent, ``{gap_rad:.2g mrad}`` an angle given in rad,
    ``{x:abs .2g}`` a size, ``{x:±.2g}`` one of either sign, ``{x:wider}`` a factor of a width.

    ``{named:?yes|no}`` chooses by whether there is a value, ``{x:>0.5 yes|no}`` by its size; either
    text may have fields. Items of a list are separated by commas, of ``{names:or}`` by or. What is
    not given is empty.
    """

    def get_value(self, key: int | str, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
        """The value of a field, ``None`` if it is not given."""
        return kwargs.get(str(key))

    def format_field(self, value: Any, form: str) -> str:
        """A value as its format says."""
        if form.startswith(("?", ">")):
            yes, no = form[1:].split("|")
            if form[0] == "?":
                return no if value in (None, "", False) or value == [] else yes
            limit, yes = yes.split(" ", 1)
            return yes if value > float(limit) else no
        if isinstance(value, list):
            either = form == "or"
            items = (self.format_field(item, "" if either else form) for item in value)
            return (" or " if either else ", ").join(items)
        if value is None:
            return ""
        if form == "wider":
            return times_as_wide(value)
        if form.startswith("±"):
            return f"±{self.format_field(value, form[1:])}"
        if form.startswith("abs "):
            value, form = abs(value), form.removeprefix("abs ")
        for unit, one in ((" %", 100.0), (" mrad", 1e3)):
            if form.endswith(unit):
                return f"{one * value:{form.removesuffix(unit)}}{unit}"
        return format(value, form)


def times_as_wide(factor: float) -> str:
    """What became of an interval, in words."""
    return "hardly wider" if factor < 1.05 else f"{factor:.2g} times as wide"


def with_sentences(summary: Any) -> Any:
    """A stored summary with the sentence of every reason as ``text``."""
    if isinstance(summary, Mapping):
        whole = {key: with_sentences(value) for key, value in summary.items()}
        if "code" in summary:
            whole["text"] = sentence(summary)
        return whole
    return [with_sentences(item) for item in summary] if isinstance(summary, list) else summary


def of_flaw(flaw: str, **values: Any) -> str:
    """The sentence of a flaw of draws."""
    return sentence({"code": flaw, **values})


def flaws_in_words(flaws: Iterable[Flaw]) -> list[str]:
    """A sentence for each flaw."""
    return [of_flaw(flaw.code, **flaw.values) for flaw in flaws]


def bench_lacks(parameters: Sequence[Mapping[str, Any]], alike: Sequence[str]) -> str:
    """Values that explain the recordings, unlike the bench's, and what would look the same."""
    from bayesbl.bench.effects import EFFECT_BY_NAME

    several = len({parameter["recording"] for parameter in parameters}) > 1
    shown = [
        as_estimated(**parameter) + (f" in {parameter['recording'] or 'all'}" if several else "")
        for parameter in parameters
    ]
    others = f" {would_look_the_same(alike)}" if alike else ""
    effects = [EFFECT_BY_NAME.get(p["name"].partition(".")[0]) for p in parameters]
    return " ".join(
        [
            "The joint differs from its bench: the recordings show "
            f"{' and '.join(shown)}.{others} δ and its interval allow for that. Correct the bench "
            "file (`bayesbl diagnose` writes a corrected one).",
            *(e.in_bench_file for e in dict.fromkeys(effects) if e and e.in_bench_file),
        ]
    )


def spoken(name: str) -> str:
    """A bench parameter or ``effect.parameter`` in words, with its name."""
    from bayesbl.bench.parameters import PARAMETER_INFO, declaration_of

    effect, _, parameter = name.partition(".")
    if effect in PARAMETER_INFO:
        return f"{PARAMETER_INFO[effect].meaning} ({name})"
    if not parameter:
        return name.replace("_", " ")
    return f"{effect.replace('_', ' ')}, {declaration_of(name).meaning} ({name})"


def as_estimated(name: str, measured: float, expected: float, unit: str, recording: object) -> str:
    """A value that differs from the expected one, in words."""
    text = f"{spoken(name)} of {measured:.4g} instead of {expected:.4g} {unit}".rstrip()
    if not expected:
        return text
    percent = 100.0 * (measured / expected - 1.0)
    return f"{text} ({'+' if percent > 0.0 else ''}{number(percent, 1)} %)"


def would_look_the_same(names: Sequence[str]) -> str:
    """What the recordings cannot distinguish from what changed."""
    *others, last = map(spoken, names)
    listed = f"{', '.join(others)} or {last}" if others else last
    return f"{listed[0].upper()}{listed[1:]} would look the same."


def quantity_changed(
    quantity: str, measured: float, expected: float, unit: str, recording: str = ""
) -> str:
    """A quantity that the gap hardly affects changed; ``recording`` if there are more than two."""
    direction = "rose" if measured > expected else "fell"
    places = max(0, 2 - math.floor(math.log10(max(abs(measured - expected), 1e-9))))
    before, after = number(expected, places), number(measured, places)
    return (
        f"The {quantity} {direction} from {before} to {after} {unit}"
        f"{f' in {recording}' if recording else ''}: {CAUSES[quantity]}, not the gap."
    )


CAUSES = {
    "proportional gain": (
        "the speed controller's gains, the torque constant or a filter of the speed"
    ),
    "integral gain": "the speed controller's gains or the torque constant",
    "mean current": "friction, or a constant torque",
    "current at load order 1": "the payload or the torque constant",
    "current at load order 2": "friction that depends on the load",
    "speed at load order 1": "the payload or the controller's integral gain",
    "speed at load order 2": "the integral gain, or friction that depends on the load",
    "ringing frequency": "payload, stiffness, gains or a filter of the drive",
    "ringing decay": "damping, gains or a filter of the drive",
}
"""What in the joint affects a quantity by which snapshots are compared."""

UNSEEN_WITHOUT_CURRENT = "the speed controller's gains, the torque constant and friction"


def change_unseen(quantity: str, share: float | None) -> str:
    """How much a quantity may change; ``None`` if noise hides it."""
    change = f"a change of the {quantity}, which one of the recordings does not show"
    if share is not None:
        change = f"a change of the {quantity} by less than {100.0 * share:.2g} %"
    return f"{change} ({CAUSES[quantity]}; too small for these recordings to show)"


def parameter_unseen(name: str, size: float, expected: float, unit: str) -> str:
    """A change of the bench too small to detect: a share of its value, or in its unit."""
    change = f"{size:.2g} {unit}".rstrip()
    if expected:
        change = f"{100.0 * size / abs(expected):.2g} %"
    return f"{spoken(name)} by {change}"


def held_compliance_unseen(items: Sequence[Mapping[str, Any]]) -> str:
    """A change of friction or compliance, which changes the compliance that friction holds."""
    changes = []
    for item in items:
        milli = item["unit"].startswith("rad")
        scale, unit = (1e3, f"m{item['unit']}") if milli else (1.0, item["unit"])
        after, before = scale * item["measured"], scale * item["expected"]
        changes.append(f"{item['quantity']} of {after:.3g} instead of {before:.3g} {unit}")
    return f"compliance that friction holds, with {' and '.join(changes)} ({_LIKE_PLAY})"


_LIKE_PLAY = "ramps cannot distinguish it from play"


def by_amplitude_instead(because: Sequence[Mapping[str, Any]]) -> str:
    """The other route has no answer, ``because`` of these reasons."""
    why = " ".join(dict.fromkeys(map(sentence, because)))
    return f"The answer is the estimate by the ringing, because simulation has none: {why}"


def tolerance_decides(name: str, side: str, shift_rad: float) -> str:
    """δ depends on a value at or beyond the edge of the bench's tolerance."""
    effect, dot, _ = name.partition(".")
    width, mend = "tolerance", "Correct the bench file, or widen this tolerance."
    if dot:
        width = "range that is searched"
        mend = f"Something else acts like it, or {effect} belongs in the bench file."
    return (
        f"δ depends on {name}, which is at the {side} edge of the {width} or beyond. This could "
        f"move δ by {1e3 * shift_rad:.2g} mrad, more than its interval. {mend}"
    )


_DISAGREEMENT = (
    "Simulation and recording disagree beyond noise{times:?|, so δ cannot be trusted}: in "
    "{channel} of {recording}, {highest_order:>0 up to {is_motion:?order|load order} "
    "{highest_order}|in the mean}{is_motion:? of the cycle|}, {is_motion:?the residual|the part "
    "that repeats every rotation} has {ratio:.3g} times the power expected from noise "
    "(disagreement in {channels}). {times:?The bench lacks something that may move δ. The interval "
    "allows for it and is {times:wider}|The bench file lacks an effect or has wrong values}; "
    "{could_be:?{could_be:or} would explain most of it; |}{is_motion:?`bayesbl identify` with "
    "`--effects catalogue` looks|`bayesbl diagnose` looks} for what is missing."
)


SENTENCES: Mapping[str, str | Callable[..., str]] = {
    # Which route answers.
    "only_route": "it is the only route that was asked for",
    "witnessed": "it is the route that was asked for; the load's encoder gives a second opinion",
    "sharper_and_checked": "it uses the whole recording and passes its checks against the bench",
    "sharper": "it uses the whole recording, and allows for what the bench lacks",
    "direct_withheld": "it uses the whole recording, and its checks against the bench decide",
    "motion": "there is no gap curve for a joint that does not turn at one speed",
    "direct_has_no_answer": "simulation of the bench has no answer",
    "amplitude_has_no_answer": "the ringing cannot be measured in these recordings",
    # Against a gap.
    "no_curve": (
        "The same ringing means different gaps on different joints. For δ, give a bench of this "
        "joint (--bench FILE) or the curve of a sweep (--curve RESULT)."
    ),
    "ringing_contradicts_bench": (
        "The ringing's frequency and decay do not fit the curve's bench at this amplitude, even "
        "within its tolerances: this is another joint, or something besides the gap changed. "
        "Correct the bench or widen its tolerances."
    ),
    "few_curve_draws": (
        "Only {effective:.0f} of {total} draws of the curve match the ringing's frequency and "
        "decay, too few to narrow the bench's tolerances. State narrower tolerances."
    ),
    "curve_scaled": "A known gap scales the curve: every gap is {scale:.3g} times the curve's.",
    "known_gaps_disagree": (
        "No scale of the curve fits all known gaps. Check them, and the recordings to which they "
        "belong."
    ),
    "beyond_curve": (
        "{share:>0.99 More than 99 %|{share:.0f %}} of the posterior is beyond the range of the "
        "gap curve ({low_rad:.3g} to {high_rad:.3g} rad). δ is {is_above:?above|below} "
        "{bound_rad:.3g} rad with {level:g %} probability. Use a curve with a wider range, or "
        "allow extrapolation by [curve] allow_extrapolation = true."
    ),
    "box_search_missed": (
        "The search of eq. 6 in the ranges of Table 2, both as printed, missed the best fit. "
        "It ended at A = {amplitude_rpm:.3g} rpm "
        "with RMSE {rmse_rpm:.3g} rpm ({gap_as_printed_rad:.3g mrad} by eq. 4); the best fit has "
        "A = {optimum_amplitude_rpm:.3g} rpm and RMSE {optimum_rmse_rpm:.3g} rpm. Use "
        '[estimator.search] method = "guess".'
    ),
    "no_baseline": (
        "Without a baseline the pulses fit gravity's wave in the speed: A = {amplitude_rpm:.3g} "
        "rpm, but {with_baseline_rpm:.3g} rpm with one harmonic of the load angle. Set "
        "[estimator.model] baseline_harmonics = 1."
    ),
    "other_speed": (
        "The gap curve is for {curve_rpm:g} rpm, but the recording is at {recording_rpm:.4g} rpm, "
        "where the same gap rings differently: δ would be about {relative_error:abs .0f %} too "
        "{relative_error:>0 large|small}. Record at {curve_rpm:g} rpm, sweep a bench at the "
        "recording's speed, or allow extrapolation by [curve] allow_extrapolation = true."
    ),
    "other_rotation": (
        "The speed repeats every {rotation_s:.4g} s, but with a gear ratio of {gear_ratio:g} the "
        "load turns once in {expected_s:.4g} s at {speed_rpm:.4g} rpm. Is the gear ratio right (a "
        "ratio of {fitting_ratio:.4g} would fit the recording), and the unit of the speed?"
    ),
    "other_bench": (
        "The recording does not fit the curve's bench: the {quantity} is {measured:.4g} {unit}, "
        "but {expected:.4g} {unit} by the bench. Correct the bench file, or give uncertain values "
        "a tolerance (`bayesbl identify` finds the values)."
    ),
    "recording_contradicts_bench": (
        "The recording contradicts the bench, and the gap curve comes from that bench."
    ),
    "repeats_beyond_noise": _DISAGREEMENT,
    "allows_for_misfit": _DISAGREEMENT,
    "negative_law": (
        "Simulation and recording agree only if a damping, or another law that cannot be negative, "
        "is negative. The bench lacks something that may move δ. The interval allows for it and is "
        "{times:wider}; `bayesbl diagnose` looks for what is missing."
    ),
    "unexplained": (
        "Neither the bench nor any change of it explains the recordings, so δ cannot be trusted. "
        "`bayesbl diagnose` looks for what is missing."
    ),
    "bench_lacks": bench_lacks,
    "sheet_contradicted": (
        "The recordings contradict several values of the bench file at once, most of all {names}. "
        "One value may be wrong; several are a sign that the bench lacks something, and δ may be "
        "as wrong as they are. Check the file, widen tolerances that are too narrow, or see what "
        "`bayesbl diagnose` finds missing."
    ),
    # Of a change.
    "routes_disagree": (
        "{witness:?The answer and the two encoders of motor and load|The estimates by simulation "
        "and by the ringing} disagree beyond their intervals in {names}, {witness:?so|although "
        "both use the same bench, so} the change is withheld: {witness:?the bench or the curve is "
        "wrong for this joint (`bayesbl diagnose` looks for what is missing), or an encoder is "
        "loose or belongs to another joint|the bench lacks an effect or has wrong values (`bayesbl "
        "diagnose` looks for what is missing)}."
    ),
    "joint_changed": (
        "Something other than the gap changed between the snapshots and moves the ringing too, so "
        "the change of δ is withheld."
    ),
    "quantity_changed": quantity_changed,
    "filter_changed": (
        "The spectrum of the speed's noise changed{recording:? in {recording}|}, as if the speed "
        "were filtered differently or the noise had another source. Such a filter alone would "
        "{least_share:>0 raise|lower} the ringing by {least_share:abs .2g %} or more. Record all "
        "snapshots through the same filter, or the motor current as well."
    ),
    "line_changed": (
        "The {quantity} at motor order {order} {measured:>{expected} rose|fell} from "
        "{expected:.2g} to {measured:.2g} {unit}{recording:? in {recording}|}: an error of "
        "transmission or encoder, or a torque ripple, not the gap. It could change the ringing by "
        "up to {furthest_share:.2g %}, as much as was measured."
    ),
    "parameter_changed": lambda recording, **values: (
        f"In {recording} something other than the gap is different: "
        f"{as_estimated(recording=recording, **values)}."
    ),
    "would_look_the_same": would_look_the_same,
    "change_allows_for_it": "The change of δ allows for this.",
    # What a comparison cannot see.
    "gains_unseen": f"{UNSEEN_WITHOUT_CURRENT} (no motor current can be compared)",
    "change_unseen": change_unseen,
    "filter_unseen": (
        "a filter of the speed (these recordings have too little noise above the frequency of the "
        "ringing, were repaired, or have different sampling rates)"
    ),
    "filter_before_noise_unseen": (
        "a filter of the speed that comes before most of the noise, or before a recorder that "
        "keeps one sample in several (the noise does not show it)"
    ),
    "small_filter_unseen": (
        "a change of a filter of the speed that moves the ringing by less than {share:.2g %} "
        "(too small for the noise of these recordings to show)"
    ),
    "parameter_unseen": parameter_unseen,
    "softer_flanks_unseen": (f"flanks that became softer at small torque alone ({_LIKE_PLAY})"),
    "held_compliance_unseen": held_compliance_unseen,
    # What limits an answer.
    "by_amplitude_instead": by_amplitude_instead,
    "no_current": (
        "The recording has no motor current, so only the speed was used. With the "
        "current, the interval of δ would be several times narrower."
    ),
    "widened": (
        "Sensor noise fed back through the speed loop makes impacts vary. The interval allows for "
        "it and is {times:wider}."
    ),
    "gap_not_told": (
        "There may be no gap: the recording does not exclude a δ below {smallest_rad:.2g mrad}, "
        "which counts as no gap. δ is below {upper_rad:.2g mrad} with 95 % probability."
    ),
    "soft_edges": (
        "The gap has soft edges: contact builds up over about ±{sd_rad:.2f mrad}. δ is the middle "
        "of this range, and its interval includes the range; the change does not depend on it."
    ),
    "elastic_part": (
        "The joint probably has a part that the bench lacks: {name} with a resonance near "
        "{frequency_hz:.2g} Hz (probability {probability:.2g}). The interval of δ includes this; "
        "to narrow it, add the part to the bench file."
    ),
    "controller_period": (
        "The speed controller seems to compute every {period_s:.3g} s, and δ is for this period. "
        "The bench states none. If you know it, state it as sampled_control in the bench file."
    ),
    "counted_twice": (
        "The bench was identified from {name} too, so this recording counts twice and its interval "
        "is somewhat too narrow. Use the bench to measure later recordings."
    ),
    "tolerance_decides": tolerance_decides,
    # Of draws.
    "sampling": of_flaw,
    "sampling_doubt": of_flaw,
    NoFlankChange.code: of_flaw,
    "ringing_weak": (
        "The impact ringing is too weak: its amplitude is {deviations:.1f} standard deviations "
        "above zero ({needed:.0f} are needed). Record more rotations, or with less noise. If "
        "the load stays on one tooth flank (a vertical axis, a balanced arm, a load to one side), "
        f"no impact will show: take {NoFlankChange.MOTION}."
    ),
    "ensembles_disagree": lambda symbol, r_hat, needed: (
        f"The ensembles disagree: R̂ of {symbol} is {math.nan if r_hat is None else r_hat:.3f} "
        f"(below {needed} is needed); the posterior may have several modes or an ensemble may be "
        "stuck."
    ),
    "ensembles_differ": "R̂ of {symbol} is {r_hat:.3f} (below {good} is good).",
    "ensemble_stuck": (
        "Ensemble {number} of {ensembles} is stuck: it accepted {share:.1f %} of its proposals (at "
        "least {needed:.0f %} is needed)."
    ),
    "walker_stuck": "A walker never moved: it is stuck, and its ensemble cannot be trusted.",
    "chain_short": (
        "The chain is short: {steps} steps for an autocorrelation time of "
        "{autocorrelation_steps:.0f} (more than {needed:.0f} times that is needed)."
        "{needed_steps:? Set max_steps = {needed_steps} or more under [posterior].|}"
    ),
    "few_effective": "Only {draws:.0f} effective draws of {symbol}.",
    "bounds_moved": "The interval's bounds still moved at the last check.",
    "draws_at_bound": (
        "{share:.0f %} of the draws of {symbol} are at a bound of its range: the range, not the "
        "recording, decides there."
    ),
    "other_optimum": (
        "The posterior has several modes: another optimum, A = {amplitude_rpm:.3g} rpm, explains "
        "the recording nearly as well (probability {share:.0f %} against the chosen one). Record "
        "more rotations, or use a curve swept for this bench, which can tell them apart."
    ),
    "other_shape": (
        f"{FEW_WEIGH}the fast approximation does not match the posterior. Narrow the bench's "
        "tolerances, or find them from recordings (bayesbl identify)."
    ),
    "ticks_decide": (
        f"{FEW_WEIGH}the period or the delay of the drive's controller is unknown, and the signals "
        "depend on them tick by tick. State period_s and delay_periods of sampled_control under "
        "[[effects]] without sd, as the drive's manual gives them; a dead time of the bus or the "
        "torque filter adds to delay_periods."
    ),
    "simulations_failed": (
        "{share:.0f %} of the simulations near the optimum failed: the bench cannot run there."
    ),
    "at_edge": (
        "The recordings put {name} at the {side} edge of its tolerance or beyond ({low:.4g} to "
        "{high:.4g})."
    ),
    "gap_at_bound": (
        "The posterior of δ is at the {side} bound of its range ({low:.3g} to {high:.3g} rad): the "
        "range, not the recording, decides. Widen [estimator] gap_rad, or correct the bench."
    ),
    # Of a motion.
    "gap_unseen": (
        "In this motion the load never passes from one tooth flank to the other, so the recording "
        "does not show δ. {bound_rad:?It is {is_larger:?larger|smaller} than {bound_rad:.2g mrad} "
        "({level:.0f %}). |}Record a motion that {pull_rpm_per_s:>0 takes the load through the "
        "angle at which gravity's torque changes its sign (hanging straight down or standing "
        "upright), or one that brakes and accelerates the load harder than gravity pulls at it: "
        "here by more than {pull_rpm_per_s:.3g} rpm/s of the motor|brakes and accelerates the load "
        "both ways}. `bayesbl plan --bench FILE` ranks motions."
    ),
    "start_unknown": (
        "The flank at the start of the recording is unknown, because nothing presses the teeth "
        "together there, and the part that is compared still depends on it. Record the same motion "
        "for longer, or begin where gravity presses the load against a flank."
    ),
    "motion_once": (
        "The motion does not repeat, so whatever is faster than the motion counts as noise, and "
        "only slow disagreement with the bench is detected. For a better check, record the motion "
        "twice or more in a row."
    ),
    "reference_held": (
        "The reference is held from each sample to the next, as in a digital drive, because a "
        "straight line between samples does not explain the recording."
    ),
    "start_left_out": (
        "The first {begin_s:.2g} s are left out, because the state of teeth and controller at the "
        "start is unknown."
    ),
    # Of wear.
    "other_benches": (
        "Something other than the gap changed between the recordings, so the change of δ is "
        "withheld: no bench explains {needed} and the other recordings together. Run `bayesbl "
        "compare` on these recordings to find what changed."
    ),
    "one_date": (
        "{count:>0 There {count:>1 are only snapshots of one day|is only one snapshot}|There is no "
        "snapshot with a gap}{repaired:? since the repair|}: a rate needs two, at different dates."
    ),
    "gap_withheld": "The gap is withheld for {names}.",
    "gap_fell": (
        "{name} is {fall_rad:.3f mrad} below the snapshot before it "
        "({standard_deviations:.1f} standard deviations), but wear cannot shrink a gap. "
        f"{UNLESS_REPAIRED}"
    ),
    "gap_shrank": f"The gap shrank, which wear cannot cause. {UNLESS_REPAIRED}",
    # Of ramps of torque.
    "ramps_held": (
        "The ramps of ±{amplitude_nm:.3g} N m, with a friction of {friction_nm:.2g} N m, do not "
        "show the play: the angle that they leave may be wind-up held by friction or a preload. "
        "Add ramps to at least {needed_nm:.2g} N m if the gear is rated for it."
    ),
    "no_play": (
        "These ramps show no play: the joint is stiffer around zero torque than at larger torque "
        "({relative_compliance:.2g} times the compliance), like a preloaded joint. {lifts_nm:?Both "
        "flanks carry the torque up to about {lifts_nm:.2g} N m, where one lifts.|No flank lifts "
        "at any of these torques, so the preload is unknown.} The loop is up to {width_rad:.2g "
        "mrad} wide at zero torque, because friction holds the joint wound up; δ is at most half "
        "of that."
    ),
    "soft_flanks": (
        "{probability:>0.95 Around|There may be no play (probability of play {probability:.0f %}): "
        "around} zero torque the joint is {relative_compliance:.2g} times as soft as at larger "
        "torque. Flanks that are soft at small torque, as in a strain wave gear, look like play: "
        "flanks {times:.0f} times as soft, which is common, would explain {share:>1 all of δ, "
        "without any play|{share:.0f %} of δ, and more if softer}. That part is lost motion."
    ),
    "ramps_skipped": (
        "The ramps of {skipped_nm:±.3g} N m hardly move the joint, because friction holds it; "
        "those of ±{amplitude_nm:.3g} N m were used."
    ),
    "torque_offset": (
        "The joint moves freely around {high_nm:>{low_nm} {low_nm:.2g} to |}{high_nm:.2g} N m "
        "rather than around zero, more than friction explains: a weight hangs on it, or the torque "
        "sensor has an offset. This torque was subtracted."
    ),
    "torque_turned": "The torque's sign was opposite to the position's; it was reversed.",
    "no_gear_ratio": (
        "No gear_ratio is given: position and torque are taken as those of the output."
    ),
    "files_without_cycle": (
        "{missing} of {files} files have no cycle of ±{amplitude_nm:.3g} N m, and do not count "
        "for δ."
    ),
    "positions_differ": (
        "Each snapshot has one position, and these differ: the intervals allow for a gap that "
        "varies by up to 70 % over the turn. Give ramps at three positions or more "
        "(files = […])."
    ),
    "one_position": (
        "δ was measured at one position of the turn. How it varies over the turn is unknown and "
        "not in the interval: give ramps at three positions or more (files = […])."
    ),
    "one_cycle": (
        "With one cycle, the scatter of repeated ramps is unknown; the interval allows for a "
        "scatter of up to 70 % of the gap."
    ),
    # Of two encoders.
    "play_not_told": (
        "{probability:>0.5 Play is likely but not sure|There may be no play} (probability of play "
        "{probability:.0f %}): the two directions are {lost_mrad:.2g} mrad apart, which skew, "
        "wind-up or noise can cause. δ is below {upper_mrad:.2g} mrad with 95 % probability."
    ),
    "held_by_weight": (
        "The torque shows that weight, a spring or a hand exceeds the load's friction on one side, "
        "for {share:.0f %} more of the time than on the other. This may keep the load on one flank "
        "and hide any play (probability {probability:.0f %}). Record with the load balanced or the "
        "axis upright, or move the load over the top and back."
    ),
    "change_of_bounds": (
        "No recording shows play, so the change is unknown. With 95 % probability, the gap grew by "
        "less than {upper_rad:.3f mrad}."
    ),
    "weight_unknown": (
        "The load's weight may keep it on one flank (probability {probability:.0f %}). That would "
        "hide any play, and the lag would be wind-up. Record a torque or current that shows "
        "friction. If the axis is upright or the load is balanced, state upright = true under "
        "[joint] (--upright)."
    ),
    "nothing_told": (
        "These data do not limit the play: δ could be as large as {upper_mrad:.2g} mrad. Record "
        "more reversals, slow and fast ones, with friction or a brake at the output."
    ),
    "few_reversals": (
        "The motor {count:>1 reverses only {count} times|{count:>0 reverses only once|never "
        "reverses}}, and only reversals show play. Record ten or more, slow and fast, to separate "
        "play from a skew of the channels."
    ),
    "no_torque": (
        "Without torque, wind-up and weight are unknown: friction behind a soft coupling looks "
        "like play, and a change of this friction looks like wear. Wind-up is usually 0.05 mrad. "
        "If the joint is soft or its play is several milliradians, wind-up is assumed to be about "
        "a tenth of the lost motion, rarely two fifths, and the interval includes that. Record the "
        "torque or current."
    ),
    "torque_unused": (
        "The torque does not show how far the joint winds up between the flanks. That is usually "
        "0.05 mrad. If the joint is soft or its play is several milliradians, wind-up is assumed "
        "to be about a tenth of the lost motion, rarely two fifths, and the interval includes that."
    ),
    "positions_exchanged": (
        "The motor turns {seen:.4g} times per turn of the load: motor_position_rad and "
        "load_position_rad are exchanged, or a unit is wrong. If this is the true ratio, state it "
        "as gear_ratio."
    ),
    "ratio_differs": "The gear ratio looks like {seen:.6g}, not {stated:g} as stated.",
    "motor_at_output": (
        "The motor's position is already that at the output: the gear ratio was not applied again."
    ),
    "channels_skewed": (
        "The load's stamps are {skew_ms:abs .2g} ms {skew_ms:>0 late|early}; this was corrected."
    ),
    "skew_or_play": (
        "All motion has one speed, so play cannot be distinguished from a skew of the channels: "
        "the load's stamps seem {skew_ms:abs .2g} ms {skew_ms:>0 late|early}. Record slow and fast "
        "motion, or with friction or a brake at the load."
    ),
    "lag_changes": (
        "The two directions are {before_mrad:.2g} mrad apart in the first half of the recording "
        "and {after_mrad:.2g} mrad in the second, so the interval of δ includes both. Check for "
        "slip or a loose part, then record again, or give both halves as two recordings."
    ),
    "load_coasts": (
        "The load does not rest on a flank from one reversal to the next: it coasts, bounces or "
        "winds up by {misfit_mrad:.2g} mrad (the two directions are {lost_mrad:.2g} mrad apart), "
        "so the interval of δ is wide. Move more slowly, or with friction or a brake at the load."
    ),
    "misfit_repeats": lambda times: (
        "The misfit repeats in every cycle, so it is not noise, and the intervals are "
        f"{times_as_wide(math.sqrt(times))}."
    ),
}
"""Sentence by code, with fields for values, or the function that makes it."""
