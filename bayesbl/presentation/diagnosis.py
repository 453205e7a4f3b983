"""A diagnosis in words: what the bench lacks, how certain that is, and what it explains."""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import starmap
from typing import TYPE_CHECKING, Literal, get_args

from bayesbl.presentation import words
from bayesbl.presentation.blocks import Advice, Block, Sentence, Table, aside, table
from bayesbl.presentation.words import capitalised, significant
from bayesbl.recording.types import CHANNELS
from bayesbl.results.folder import AUGMENTED_BENCH
from bayesbl.units import in_words, number, quantity_and_unit

if TYPE_CHECKING:
    from bayesbl.diagnosis.disagreement import DisagreementSummary, DisagreementTableSummary, Use
    from bayesbl.diagnosis.groups import (
        Answer,
        DiagnosisSummary,
        EffectSummary,
        HeldValue,
        LearnedDependence,
        LearnedSummary,
        RemainingSummary,
    )
    from bayesbl.identification.groups import EffectFound
    from bayesbl.results.store import Interval


MOST_RIVALS = 2  # largest number of rivals that a headline names
UNTOLD_SHARE = "–: the disagreement before naming is too close to the noise to state a share."

USES = {"used": "fitted on", "held_out": "held out"}

_Stage = Literal["before", "after", "noise_floor"]
_STAGES: tuple[_Stage, ...] = get_args(_Stage)


def blocks(summary: DiagnosisSummary) -> Iterator[Block]:
    """A sentence for each effect and parameter, the model error, and what still repeats."""
    effects = map(effect_in_words, summary["effects"])
    yield from map(Sentence, (*effects, *parameter_errors(summary), *learned(summary)))
    disagreement = disagreement_table(summary["disagreement"])
    yield disagreement
    if any(removed(None) in row for row in disagreement.rows):
        yield aside(UNTOLD_SHARE)
    yield from map(Sentence, (*remaining(summary), *wear(summary), *suggestion(summary)))


def headline(summary: DiagnosisSummary) -> str:
    """The verdict with the size of what is missing."""
    match summary["verdict"]:
        case "named":
            names = [_size_in_short(effect) for effect in summary["effects"]]
            are, them = ("is", "it") if len(names) == 1 else ("are", "them")
            held_out = summary["disagreement"]["over_all"].get("held_out")
            gone = ""
            if held_out is not None and held_out["closed_fraction"] is not None:
                share = removed(held_out["closed_fraction"])
                gone = f": adding {them} removes {share} of the disagreement on held-out data"
            return capitalised(f"{'; '.join(names)} {are} missing from the bench{gone}.")
        case "parameter_error":
            what = "No effect is missing, but the bench is wrong"
            if "gap_withheld" in summary:
                what = (
                    "The bench is wrong by more than the search covers, or lacks an effect that is "
                    "not in the catalogue"
                )
            return f"{what}: {next(parameter_errors(summary))}"
        case "unexplained" if (known := learned_of(summary)) is not None:
            return f"No known effect explains the disagreement. It looks like {dependence(known)}."
        case "unexplained" if summary["remaining"]:
            what = next(remaining(summary)).partition(": ")[2]
            return f"Something repeats that no known effect explains: {what}"
        case verdict:
            used = summary["disagreement"]["over_all"].get("used")
            if used is None or (verdict != "unexplained" and used["closed_fraction"] is None):
                return "Nothing is missing: noise may cause all of the disagreement."
            after, noise = _sized_rms(used, "after"), _sized_rms(used, "noise_floor")
            return (
                f"No effect could be named: bench and recordings disagree by {after}, and the "
                f"noise is {noise}."
            )


def _size_in_short(effect: EffectSummary) -> str:
    """``load Coulomb friction 6.1 N m (5.8 to 6.4)``, with order and rivals."""
    parameters = dict(effect["parameters"])
    order = parameters.pop("order", None)
    name, size = next(iter(parameters.items()))
    of = "" if order is None else f" (order {_digits(order['median'])})"
    text = f"{in_words(effect['name'])}{of} {_value(size, quantity_and_unit(name)[1])}"
    rivals = effect["indistinguishable_from"]
    alike = " or ".join(map(in_words, rivals))
    if len(rivals) > MOST_RIVALS:
        alike = f"one of {len(rivals)} others that look the same"
    return f"{text}, or {alike}" if alike else text


def effect_in_words(effect: EffectSummary | EffectFound) -> str:
    """A named effect with its parameters and the effects that look the same."""
    parameters = ", ".join(starmap(sized, effect["parameters"].items()))
    text = f"{in_words(effect['name'])}: {parameters}."
    if alike := effect["indistinguishable_from"]:
        text += f" Cannot be distinguished from {', '.join(map(in_words, alike))}."
    return capitalised(text)


def parameter_errors(summary: DiagnosisSummary) -> Iterator[str]:
    """Parameters that differ from the bench file."""
    for error in summary["parameter_errors"]:
        name, unit = quantity_and_unit(error["name"])
        tolerance = f" ± {_digits(error['tolerance'])}" if error["tolerance"] else ""
        believed = _with_unit(f"{_digits(error['believed'])}{tolerance}", unit)
        text = f"{in_words(name)} is {_value(error['fitted'], unit)}, not {believed}."
        yield capitalised(text)


def learned_of(summary: Answer) -> LearnedSummary | None:
    """The learned term, if there is one."""
    return summary.get("learned_torque") or summary.get("encoder_error")


def learned(summary: DiagnosisSummary) -> Iterator[str]:
    """The learned term: its variable, size, and alternatives."""
    term = learned_of(summary)
    if term is None:
        return
    if "amplitude_rad" in term:
        size = f"{significant(1e3 * term['amplitude_rad'])} mrad"
    else:
        size = f"{significant(term['amplitude_nm'])} N m"
    text = f"Learned, because no known effect explains it: {dependence(term)}, {size}."
    if term["alike"]:
        others = "; ".join(dependence(other) for other in term["alike"])
        text += f" It cannot be distinguished from {others}."
    yield text
    if withheld := summary.get("gap_withheld"):
        yield withheld


def dependence(term: LearnedDependence | LearnedSummary) -> str:
    """``a torque at the load over the load angle, orders 1 to 7``, or an error of the encoder."""
    turn = 2.0 * math.pi / term["period"]
    over, base = {
        "motor_angle": ("the motor angle", turn),
        "load_angle": ("the load angle", turn),
        "motor_speed": ("the motor speed", 1.0),
        "time": ("time", 1.0 / term["period"]),
    }[term["variable"]]
    orders = [number(k * base, 3).rstrip("0").rstrip(".") for k in (1, term["orders"])]
    listed = f"order {orders[0]}" if term["orders"] == 1 else f"orders {orders[0]} to {orders[1]}"
    if term["variable"] == "time":
        listed = f"{orders[0]} Hz" if term["orders"] == 1 else f"{orders[0]} to {orders[1]} Hz"
    if term["variable"] == "motor_speed":
        listed = f"{term['orders']} waves over {significant(term['period'])} rad/s"
    reverses = " that reverses with the direction" if term["reverses"] else ""
    if term["side"] == "encoder":
        return f"an error of the motor's encoder over {over}, {listed}"
    return f"a torque at the {term['side']}{reverses} over {over}, {listed}"


def remaining(summary: DiagnosisSummary) -> Iterator[str]:
    """What still repeats after naming."""
    for line in summary["remaining"]:
        yield f"Still there: {unexplained_phrase(line)}."


def wear(summary: DiagnosisSummary) -> Iterator[str]:
    """Each gap after naming, and the first one before."""
    before, after = summary["delta_rad_before"], summary["delta_rad_after"]
    if learned_of(summary) is None and (withheld := summary.get("gap_withheld")):
        yield f"The gap is withheld: {withheld}"
    if before is None or after is None:
        return
    gaps, where = summary.get("gaps", {}), ""
    gap = words.in_mrad(after)
    if len(gaps) > 1:
        gap = ", ".join(f"{words.in_mrad(own)} in {name}" for name, own in gaps.items())
        where = f" in {next(iter(gaps))}"
    if learned_of(summary) is not None:
        yield f"With what was learned, the gap is {gap}."
    elif summary["verdict"] == "unexplained":
        yield (f"A fit that ignores the disagreement gives a gap of {gap}: do not rely on it.")
    elif summary["effects"] or summary["parameter_errors"]:
        away = 100.0 * (before["median"] / after["median"] - 1.0)
        size = f"{significant(abs(away))} % too {'small' if away < 0.0 else 'large'}"
        yield (
            f"The gap is {gap}; the bench as given yields {1e3 * before['median']:.4g} mrad"
            f"{where}, {size}."
        )
    else:
        yield f"The gap is {gap}."


def suggestion(summary: DiagnosisSummary) -> Iterator[str]:
    """The recording that would separate hypotheses that look the same."""
    recording = summary["suggested_recording"]
    if recording is None:
        return
    share = recording["payload_share"]
    load = "" if share == 1.0 else f" with {share:g} times the load"
    names = " and ".join(in_words(name) for name in recording["separates"][0][:2])
    yield (
        f"A recording at {recording['reference_speed_rpm']:g} rpm{load} would separate {names} "
        f"({recording['distance']:.0f} standard deviations apart)."
    )


def sized(parameter: str, interval: Interval | HeldValue) -> str:
    """``torque 15.00 N m (14.99 to 15.02)``; for one recording, ``phase (reverse) 0.71 rad``."""
    name, space, recording = parameter.partition(" ")
    quantity, unit = quantity_and_unit(name)
    return f"{quantity}{space}{recording} {_value(interval, unit)}"


def _value(interval: Interval | HeldValue, unit: str) -> str:
    if interval["low"] is None:
        return _with_unit(_digits(interval["median"]), unit)
    middle = number(interval["median"], words.decimals(interval))
    return f"{_with_unit(middle, unit)} ({words.bounds(interval)})"


def _digits(value: float) -> str:
    return significant(value, 4) if value % 1.0 else number(value, 0)


def _with_unit(value: str, unit: str) -> str:
    return f"{value} {unit}".rstrip()


def disagreement_table(summary: DisagreementTableSummary) -> Table:
    """RMS of the model error by recording and channel, and over all."""
    pieces = list(compared_pieces(summary))
    several = len({channel for _, channel, *_ in pieces}) > 1
    pieces += [("all", "", use, row) for use, row in summary["over_all"].items()]
    cells = []
    for name, channel, use, row in pieces:
        of = f", {CHANNELS.get(channel, channel)}" if several and channel else ""
        each = [_sized_rms(row, key) for key in _STAGES]
        cells.append((name + of, USES[use], *each, removed(row["closed_fraction"])))
    sizes = ("#Disagreement\nbefore", "#after", "#Noise", "#Removed")
    return table(("Recording", "Use", *sizes), cells)


def compared_pieces(
    table: DisagreementTableSummary,
) -> Iterator[tuple[str, str, Use, DisagreementSummary]]:
    """Recording, channel, use and model error of everything compared."""
    for recording, channels in table["recordings"].items():
        for channel, uses in channels.items():
            yield from ((recording, channel, use, row) for use, row in uses.items())


def removed(closed: float | None) -> str:
    """Share of the model error that naming removes; at most 1, though the floor is estimated."""
    if closed is None:
        return "–"
    shown = number(100.0 * min(closed, 1.0), 1)
    return "100 %" if shown == "100.0" else f"{shown} %"


def _sized_rms(row: DisagreementSummary, key: _Stage) -> str:
    """``3.34 rpm``; over all channels ``4.2 × noise``."""
    unit = " × noise" if row["unit"] == "noise" else f" {row['unit']}"
    return f"{significant(row[key], 3)}{unit}"


ASSUMPTIONS = (
    "What is missing, if anything, is in the catalogue (bayesbl effects).",
    "Noise does not repeat.",
    "The other parameters are as the bench file says, within their tolerances.",
)


def advice(summary: DiagnosisSummary) -> Advice:
    """Whether the bench can be used, and how to complete it."""
    withheld = summary.get("gap_withheld")
    if withheld and learned_of(summary) is None:
        return Advice("watch", "Correct the bench before you use it.", (withheld,))
    verdict = summary["verdict"]
    wrong = tuple(parameter_errors(summary)) if verdict == "parameter_error" else ()
    if "augmented_bench" in summary:
        title = f"Continue with {AUGMENTED_BENCH}."
        sentences = (*wrong, *_go_on(summary))
        return Advice("watch" if verdict == "unexplained" else "note", title, sentences)
    if verdict == "named":
        names = ", ".join(in_words(effect["name"]) for effect in summary["effects"])
        add = f"Add to its file under [[effects]]: {names}. Then simulate and sweep again."
        return Advice("note", "Complete the bench before you use it.", (add,))
    if verdict == "parameter_error":
        return Advice("note", "Correct the bench before you use it.", wrong)
    if verdict == "unexplained":
        where = "No effect of the catalogue explains them; the figures show where they occur."
        return Advice("watch", "Look at the residuals before you rely on the bench.", (where,))
    why = "These recordings show no error in it."
    return Advice("fine", "The bench may be used as it is.", (why,))


def _go_on(summary: DiagnosisSummary) -> Iterator[str]:
    """What to do with the bench that the diagnosis wrote."""
    yield (f"{AUGMENTED_BENCH}, in the folder of this page, is your bench file with the additions.")
    if any(effect["indistinguishable_from"] for effect in summary["effects"]):
        yield "These recordings cannot separate all effects."
        yield from suggestion(summary)
    if learned_of(summary) and summary["delta_rad_after"] is None:
        return
    yield (
        "To make a gap curve, copy configs/sweep.toml, enter this bench and a new output folder "
        f'(bench = "…/{AUGMENTED_BENCH}"), run `bayesbl sweep` on the copy, and use its result in '
        "a comparison: `--curve …/result.nc`"
    )
    yield (
        "To measure without a curve: `bayesbl compare FIRST SECOND --route direct --bench "
        f"{AUGMENTED_BENCH}`"
    )


def unexplained_phrase(entry: RemainingSummary) -> str:
    """``motor current: 0.13 A at 7.3 Hz, periodic in time``."""
    size = f"{significant(entry['amplitude'])} {entry['unit']}"
    order, highest, hertz = entry["lowest_order"], entry["highest_order"], entry["frequency_hz"]
    match entry["dependence"]:
        case "offset" | "drift" as kind:
            what = f"{'an' if kind == 'offset' else 'a'} {kind} of {size}"
        case "load angle":
            orders = f"order {order:.0f}"
            if order != highest:
                orders = f"orders {order:.0f} to {highest:.0f}"
            what = f"{size} with the load angle, mostly at {orders}"
        case "motor angle":
            what = f"{size} at order {order:.4g} of the motor"
        case "time":
            what = f"{size} at {hertz:.4g} Hz, periodic in time"
        case _:
            what = (
                f"{size} at {hertz:.4g} Hz or order {order:.4g} of the motor (these recordings do "
                "not show which)"
            )
    return f"{CHANNELS.get(entry['channel'], entry['channel'])}: {what}"
