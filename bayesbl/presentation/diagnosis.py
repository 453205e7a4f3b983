"""A diagnosis in words: what is missing, how sure that is, and what it explains.

The difference between simulation and recording, ``gap`` in ``summary.json``, is called
disagreement here: to a reader the gap is δ.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from bayesbl.presentation import words
from bayesbl.presentation.blocks import Block, Heading, Sentence, Table, numbers, table, text
from bayesbl.presentation.words import Summary
from bayesbl.units import in_words, number, quantity_and_unit

if TYPE_CHECKING:
    import xarray as xr

FAR_BEYOND_NOISE = 10.0
"""Standard deviations from zero above which their number is of no use to a reader."""

UNTOLD_SHARE = (
    "–: before naming, the disagreement is too small beside the noise to give a share of it."
)

_USES = {"used": "fitted on", "held_out": "held out"}


def blocks(summary: Summary) -> Iterator[Block]:
    """One sentence per effect and parameter, the disagreement, what still repeats."""
    for sentence in (*effects(summary), *parameter_errors(summary)):
        yield Sentence(sentence)
    yield _gap_table(summary)
    if any(gap["closed_fraction"] is None for *_, gap in _gaps(summary["gap"])):
        yield Sentence(UNTOLD_SHARE, "aside")
    for sentence in (*remaining(summary), *wear(summary), *suggestion(summary)):
        yield Sentence(sentence)


def located_blocks(tree: xr.DataTree, _: Summary) -> Iterator[Block]:
    """Residuals of a comparison of several channels, where the result holds them."""
    for heading, sentences in located(tree):
        yield Heading(heading)
        yield from map(Sentence, sentences)


def headline(summary: Summary) -> str:
    """The verdict as a sentence."""
    names = [in_words(effect["name"]) for effect in summary["effects"]]
    match summary["verdict"]:
        case "named":
            listed = names[0] if len(names) == 1 else ", ".join(names[:-1]) + " and " + names[-1]
            return f"Missing in the bench: {listed}."
        case "parameter_error":
            return "No effect is missing, but parameters of the bench are wrong."
        case "unexplained":
            return "Something repeats that no effect of the catalogue explains."
        case _:
            return "Nothing is missing: the residuals do not repeat, or no finding generalises."


def has_augmented_bench(summary: Summary) -> bool:
    """Whether the result's folder holds the bench with what was named: forward diagnoses write it.

    They compare several channels, so that the gap as a whole has no unit.
    """
    return summary["gap"]["unit"] is None and summary["verdict"] in ("named", "parameter_error")


def use_in_words(use: str) -> str:
    """``held out``."""
    return _USES[use]


def effects(summary: Summary) -> Iterator[str]:
    """Each named effect with its parameters and what it cannot be distinguished from."""
    for effect in summary["effects"]:
        parameters = ", ".join(
            _sized(name, interval) for name, interval in effect["parameters"].items()
        )
        text = f"{in_words(effect['name'])}: {parameters}; {_beyond_noise(effect['z'])}."
        alike = effect["indistinguishable_from"]
        if alike:
            text += f" Cannot be told apart from {', '.join(in_words(name) for name in alike)}."
        yield text[0].upper() + text[1:]


def parameter_errors(summary: Summary) -> Iterator[str]:
    """Parameters that do not hold what the bench file says."""
    for error in summary["parameter_errors"]:
        name, unit = quantity_and_unit(error["name"])
        tolerance = f" ± {_digits(error['tolerance'])}" if error["tolerance"] else ""
        believed = _with_unit(f"{_digits(error['believed'])}{tolerance}", unit)
        text = f"{in_words(name)} is {_value(error['fitted'], unit)}, not {believed}."
        yield text[0].upper() + text[1:]


def remaining(summary: Summary) -> Iterator[str]:
    """What still repeats after naming."""
    unit = summary["gap"]["unit"]
    for line in summary["remaining"]:
        if "dependence" in line:
            yield f"Still there: {_phrase(line)}."
            continue
        yield (
            f"The residuals repeat {line['order']:.2f} times per turn of the motor, with "
            f"{words.significant(line['amplitude'])} {unit}."
        )


def located(tree: xr.DataTree) -> Iterator[tuple[str, list[str]]]:
    """Residuals of a comparison of several channels before and after naming: heading, sentences."""
    from bayesbl.presentation.residuals import located_sentences

    stages = {"located_before": "Residuals of the bench before naming"}
    if tree.attrs.get("augmented_bench"):
        stages["located_after"] = "Residuals with what was named"
    for group, heading in stages.items():
        # Results of versions before this one hold no entries.
        if group in tree.children and "unexplained" in tree[group].attrs:
            yield heading, located_sentences(tree[group].to_dataset())


def wear(summary: Summary) -> Iterator[str]:
    """The gap before and after naming: what the effects do to it."""
    before, after = summary["delta_rad_before"], summary["delta_rad_after"]
    if before is None or after is None:
        return
    gap = words.in_mrad(after)
    if summary["verdict"] == "unexplained":
        yield (
            f"Fitted in spite of what is unexplained, the gap would be {gap}: do not rely on it."
        )
    elif summary["effects"] or summary["parameter_errors"]:
        away = 100.0 * (before["median"] / after["median"] - 1.0)
        size = f"{words.significant(abs(away))} % too {'small' if away < 0.0 else 'large'}"
        yield (
            f"The gap is {gap}; the bench before naming gives {1e3 * before['median']:.4g} mrad, "
            f"{size}."
        )
    else:
        yield f"The gap is {gap}."


def suggestion(summary: Summary) -> Iterator[str]:
    """The recording that would separate what these cannot."""
    found = summary["suggested_recording"]
    if found is None:
        return
    load = (
        "" if found["payload_share"] == 1.0 else f" with {found['payload_share']:g} times the load"
    )
    names = " and ".join(in_words(name) for name in found["separates"][0][:2])
    yield (
        f"A recording at {found['reference_speed_rpm']:g} rpm{load} would separate {names} "
        f"({found['distance']:.0f} standard deviations apart)."
    )


def _phrase(line: dict[str, Any]) -> str:
    # Imported here: the compiled simulator is behind it, which takes a second.
    from bayesbl.presentation.residuals import unexplained, unexplained_phrase

    return unexplained_phrase(unexplained(line))


def _sized(parameter: str, interval: dict[str, Any]) -> str:
    """``torque 15.00 N m (14.99 to 15.02)``; of one recording, ``phase (reverse) 0.71 rad``."""
    name, space, recording = parameter.partition(" ")
    quantity, unit = quantity_and_unit(name)
    return f"{quantity}{space}{recording} {_value(interval, unit)}"


def _value(interval: dict[str, Any], unit: str) -> str:
    if interval["low"] is None:
        return _with_unit(_digits(interval["median"]), unit)
    middle = number(interval["median"], words.decimals(interval))
    return f"{_with_unit(middle, unit)} ({words.bounds(interval)})"


def _digits(value: float) -> str:
    return words.significant(value, 4) if value % 1.0 else number(value, 0)


def _with_unit(value: str, unit: str) -> str:
    return f"{value} {unit}".rstrip()


def _beyond_noise(deviations: float) -> str:
    """How clearly an effect stands out."""
    if deviations > FAR_BEYOND_NOISE:
        return "far beyond noise"
    return f"{deviations:.0f} standard deviations from zero"


def _gap_table(summary: Summary) -> Table:
    unit = summary["gap"]["unit"]
    units = f" ({unit})" if unit else ""
    titles = (f"Disagreement\nbefore{units}", f"after{units}", f"Noise{units}", "Removed")
    rows = [
        (
            name,
            _USES[use],
            *(f"{gap[key]:.3g}{_own_unit(gap)}" for key in ("before", "after", "noise_floor")),
            removed(gap["closed_fraction"]),
        )
        for name, use, gap in _gaps(summary["gap"])
    ]
    return table((text("Recording"), text("Use"), *map(numbers, titles)), rows)


def _gaps(gap: Summary) -> Iterator[tuple[str, str, Summary]]:
    """(recording and channel, use, disagreement) of every row, those over all at the end."""
    from bayesbl.recording.types import CHANNELS  # numpy is behind it

    for recording, channels in gap["recordings"].items():
        for channel, uses in channels.items():
            name = recording if gap["unit"] else f"{recording}, {CHANNELS.get(channel, channel)}"
            yield from ((name, use, found) for use, found in uses.items())
    yield from (("all", use, found) for use, found in gap["over_all"].items())


def removed(closed: float | None) -> str:
    """The share of the disagreement that naming removes, never above all of it.

    Stored values may exceed 1, because the noise that they are counted from is an estimate.
    """
    if closed is None:
        return "–"
    shown = number(100.0 * min(closed, 1.0), 1)
    return "100 %" if shown == "100.0" else f"{shown} %"


def _own_unit(gap: Summary) -> str:
    unit = gap.get("unit")
    return "" if unit is None else " × noise" if unit == "noise" else f" {unit}"
