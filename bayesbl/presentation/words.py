"""Results in words: plain strings, no terminal. Every sentence that the console shows is here.

Angles are given in mrad, probabilities never as certain: a finite number of draws cannot show that.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from bayesbl.units import number

Summary = Mapping[str, Any]
"""``summary.json`` as :func:`bayesbl.runs.summary.summarise` makes it, or a part of it."""

RAREST = 1e-3
"""Probabilities closer than this to 0 or 1 are beyond what some thousand draws can tell."""

SURE = 0.95
"""Probability from which something is taken as shown, and below 1 minus which as not so."""

GAP_EXPLAINED = "The gap δ is half the total clearance, as an angle at the load."

BOUND_EXPLAINED = (
    "Cramér-Rao: the smallest standard deviation that any unbiased estimate from these recordings "
    "can have, what is known of the bench beforehand left out."
)

CHECK_EXPLAINED = (
    "Power of the difference between recording and simulation that repeats every rotation, over "
    "what noise would leave of it; the probability is that of as much from noise alone."
)

SHRANK = (
    "The gap shrank, and wear does not heal: are the files in order, or was the joint repaired "
    "between them?"
)

DEGREES_EXPLAINED = (
    "Departure of δ from a polynomial of that degree alone, fitted with relative weights. The log "
    "evidence is that of the degree with a smooth lack of fit beside it."
)

_SUPERSCRIPTS = str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹")

_SOURCES = {
    "noise": "noise of the recording",
    "start_angle": "start angle",
    "rounding": "rounding of the curve's coefficients",
    "regression": "coefficients of the curve",
    "lack_of_fit": "lack of fit of the curve",
    "bench": "tolerances of the bench",
}


def probability(value: float) -> str:
    """``78 %``, ``2.3 %``, ``> 99.9 %``; never 0 % or 100 %."""
    if value < RAREST:
        return f"< {100.0 * RAREST:g} %"
    if value > 1.0 - RAREST:
        return f"> {100.0 * (1.0 - RAREST):g} %"
    return f"{100.0 * value:.0f} %" if 0.1 <= value <= 0.9 else f"{100.0 * value:.1f} %"


def decimals(interval: Summary, scale: float = 1.0, units: float = 5.0) -> int:
    """Fewest decimals at which the interval is at least ``units`` of the last one wide."""
    width = abs(scale * (interval["high"] - interval["low"]))
    return max(0, math.ceil(math.log10(units / width))) if width > 0.0 else 3


def common_decimals(intervals: Iterable[Summary | None]) -> int:
    """Decimals in mrad that show the narrowest of some gaps in rad; 3 if there is none."""
    return max((decimals(found, 1e3) for found in intervals if found is not None), default=3)


def bounds(interval: Summary, scale: float = 1.0, places: int | None = None) -> str:
    """``0.685 to 0.731``."""
    shown = decimals(interval, scale) if places is None else places
    low, high = sorted((scale * interval["low"], scale * interval["high"]))
    return f"{number(low, shown)} to {number(high, shown)}"


def interval_kind(interval: Summary) -> str:
    """``90 % interval``: how much it holds, and of which kind."""
    kind = "highest-density interval" if interval["kind"] == "hdi" else "interval"
    return f"{100.0 * interval['level']:g} % {kind}"


def short_kind(interval: Summary) -> str:
    """As :func:`interval_kind`, for the head of a column."""
    kind = "HDI" if interval["kind"] == "hdi" else "interval"
    return f"{100.0 * interval['level']:g} % {kind}"


def in_mrad(interval: Summary, sign: float = 1.0) -> str:
    """``0.25 mrad (90 % interval 0.21 to 0.28 mrad)`` for an interval in rad."""
    scale = 1e3 * sign
    middle = number(scale * interval["median"], decimals(interval, scale))
    return f"{middle} mrad ({interval_kind(interval)} {bounds(interval, scale)} mrad)"


def headline(summary: Summary) -> str:
    """The answer in one or two sentences."""
    if summary["kind"] == "compare":
        return _change_headline(summary)
    if summary["delta_rad"] is None:
        return "The gap is withheld: these data do not give an answer that can be trusted."
    return f"The gap is {in_mrad(summary['delta_rad'])}."


def _change_headline(summary: Summary) -> str:
    change = summary["change_rad"]
    if change is None:
        return (
            "The change of the gap is withheld: these data do not give an answer that can be "
            "trusted."
        )
    return f"{change_in_words(change)}; {grew(summary['probability_increase'])}."


def change_in_words(change: Summary) -> str:
    """Whether the gap grew, shrank, or may have done neither."""
    if change["low"] > 0.0:
        return f"The gap grew by {in_mrad(change)}"
    if change["high"] < 0.0:
        return f"The gap shrank by {in_mrad(change, -1.0)}"
    return f"The gap may not have changed: the change is {in_mrad(change)}"


def grew(value: float) -> str:
    """The probability of growth as part of a sentence."""
    return f"probability that it grew: {probability(value)}"


def has_shrunk(summary: Summary) -> bool:
    """Whether a comparison without dates, which can tell no repair, shows less gap than before."""
    change = summary.get("change_rad")
    return change is not None and change["high"] < 0.0 and not summary.get("wear")


def steps(summary: Summary) -> list[str]:
    """Each step between neighbours, where there are more than two snapshots."""
    changes = summary.get("changes", [])
    if len(changes) < 2:
        return []
    return [
        f"From {step['from']} to {step['to']}: "
        + (
            "withheld."
            if step["change_rad"] is None
            else f"{in_mrad(step['change_rad'])}; {grew(step['probability_increase'])}."
        )
        for step in changes
    ]


def snapshots(summary: Summary) -> list[tuple[str, Summary]]:
    """(name, part) of every snapshot; the name of a fit's only one is empty."""
    if summary["kind"] == "compare":
        return [(part["name"], part) for part in summary["snapshots"]]
    return [("", summary)]


def is_direct(summary: Summary) -> bool:
    """Whether the answer comes from the simulated bench."""
    return snapshots(summary)[0][1].get("route") == "direct"


def by_other_machine(summary: Summary) -> bool:
    """Whether the answer rests on the gap curve of the paper's test bench."""
    from bayesbl.config.fields import PUBLISHED  # pydantic is behind it

    return summary.get("curve") == PUBLISHED and not is_direct(summary)


def gap_in_plain_words(summary: Summary) -> str:
    """What δ and the range beneath it are, and on what they stand."""
    stands = "the bench is as its file says" if is_direct(summary) else "the curve fits your joint"
    return (
        "The gap δ is half the play of the joint, as an angle at the load (1 mrad moves a point "
        "1 m away by 1 mm). The range beneath a number holds the true value with the probability "
        f"stated, if {stands}."
    )


def median_of(interval: Summary | None, places: int) -> str:
    """The median, or a dash where there are no draws."""
    return "–" if interval is None else number(interval["median"], places)


def above_limit(summary: Summary) -> str | None:
    """The probability of each snapshot above the limit; ``None`` without a limit."""
    parts = [(n, p) for n, p in snapshots(summary) if p.get("limit_rad") is not None]
    if not parts:
        return None
    told = ", ".join(
        _probability_or_withheld(part) + (f" ({name})" if name else "") for name, part in parts
    )
    limit = 1e3 * parts[0][1]["limit_rad"]
    return f"Probability that the gap is above its limit of {limit:g} mrad: {told}."


def _probability_or_withheld(part: Summary) -> str:
    value = part["probability_above_limit"]
    return "withheld" if value is None else probability(value)


def budget(summary: Summary) -> str | None:
    """Where the width of the last interval given comes from, in one line."""
    answered = [(n, p) for n, p in snapshots(summary) if p["delta_rad"] is not None]
    if not answered:
        return None
    name, part = answered[-1]
    shares = {source: share for source, share in part["budget"].items() if share >= RAREST}
    if not shares:
        return None
    ordered = sorted(shares, key=lambda source: -shares[source])
    told = ", ".join(f"{source_in_words(s)} {probability(shares[s])}" for s in ordered)
    return f"Variance of the gap{_of(name)}, by source: {told}."


def source_in_words(source: str) -> str:
    """A source of the interval's width as a reader knows it."""
    return _SOURCES.get(source, source.replace("_", " "))


def reasons(summary: Summary) -> Iterator[tuple[str, str]]:
    """(``Withheld`` or ``Note``, sentence) of all that is to be known of an answer, each told once.

    Names of the snapshots that it is said of stand before it.
    """
    names: dict[tuple[str, str], list[str]] = {}
    for name, part in snapshots(summary):
        found: Sequence[str] = part["diagnostics"]["reasons"]
        for sentence in found:
            label = "Withheld" if sentence in (part["reason"] or "") else "Note"
            names.setdefault((label, sentence), []).append(name)
    for (label, sentence), told in names.items():
        yield label, f"{', '.join(told)}: {sentence}" if any(told) else sentence


def significant(value: float, digits: int = 2) -> str:
    """``0.15``, ``32``, ``0.0007``: so many significant digits, never in powers of ten."""
    if value == 0.0:
        return "0"
    return number(value, max(0, digits - 1 - math.floor(math.log10(abs(value)))))


def percent(value: float) -> str:
    """A relative size with two significant digits, ``0.15 %``."""
    return f"{significant(100.0 * value)} %"


def swept(summary: Summary) -> str:
    """Over which gaps the bench was swept, and what ringing they make."""
    gaps, amplitudes = summary["gap_rad"], summary["amplitude_rpm"]
    first, last = (f"{1e3 * gap:g}" for gap in gaps)
    return (
        f"As the gap grows from {first} to {last} mrad, the amplitude A of the ringing grows from "
        f"{amplitudes[0]:.1f} to {amplitudes[1]:.1f} rpm."
    )


def curve_quality(summary: Summary) -> Iterator[str]:
    """How well the polynomial describes the sweep, how sure the curve is, how far from eq. 4."""
    kind = polynomial_kind(summary["degree"])
    found = summary["degrees"].get(str(summary["degree"]))
    if found is not None:
        yield (
            f"A {kind} describes δ of the sweep within {percent(found['largest_departure'])} "
            f"({percent(found['rms_departure'])} RMS)."
        )
    ordered = sorted(summary["relative_sd"].items(), key=lambda item: -item[1])
    told = ", ".join(f"{source_in_words(name)} {percent(sd)}" for name, sd in ordered)
    yield f"Largest standard deviation of δ along the curve, by source: {told}."
    yield (
        "At a given gap, A differs from that of the paper's eq. 4 by at most "
        f"{percent(summary['largest_departure_from_published'])}."
    )


def polynomial(summary: Summary) -> str:
    """What the coefficients are, and what they leave."""
    return (
        "δ(A) is the sum of these terms times a smooth correction for lack of fit, at most "
        f"{percent(summary['largest_correction'])}, which the stored curve holds: the coefficients "
        "alone are off by as much."
    )


def polynomial_kind(degree: int) -> str:
    """``cubic``, ``polynomial of degree 4``."""
    names = {1: "straight line", 2: "parabola", 3: "cubic"}
    return names.get(degree, f"polynomial of degree {degree}")


def power_of_amplitude(power: int) -> tuple[str, str]:
    """The term of a polynomial in A (rpm) for δ (rad), and its coefficient's unit."""
    if power == 0:
        return "1", "rad"
    raised = "" if power == 1 else str(power).translate(_SUPERSCRIPTS)
    return f"A{raised}", f"rad/rpm{raised}"


def noise(part: Summary) -> str:
    """``AR(1), standard deviation 1.51 rpm, coefficients 0.600, normal``."""
    found = part["noise"]
    kind = f"AR({found['order']})" if found["order"] else "white"
    if found["differentiated"]:
        kind = f"differentiated {kind}"
    text = f"{kind}, standard deviation {found['sd_rpm']:.3g} rpm"
    if found["order"]:
        text += ", coefficients " + ", ".join(number(c, 3) for c in found["coefficients"])
    if found["degrees_of_freedom"] is not None:
        text += f", Student-t with {found['degrees_of_freedom']:g} degrees of freedom"
    if found["student_t_evidence"] is not None:
        text += f" (log evidence for Student-t: {number(found['student_t_evidence'], 0)})"
    if found["repeating_rounding_sd_rpm"]:
        text += (
            f"; and rounding of {found['repeating_rounding_sd_rpm']:.3g} rpm that repeats every "
            "rotation"
        )
    return text


def outliers(summary: Summary) -> Iterator[str]:
    """A sentence for every snapshot whose noise is Student-t."""
    for name, part in snapshots(summary):
        freedom = part["noise"]["degrees_of_freedom"]
        if freedom is not None:
            evidence = number(part["noise"]["student_t_evidence"], 0)
            yield (
                f"The noise{_of(name)} has outliers: Student-t with {freedom:g} degrees of freedom "
                f"(log evidence against normal noise: {evidence})."
            )


def joint_noise(part: Summary) -> str:
    """``AR(1), standard deviation 1.51 rpm in speed, 0.0501 A in current``."""
    found = part["noise"]
    kind = f"AR({found['order']})" if found["order"] else "white"
    text = f"{kind}, standard deviation {found['sd_rpm']:.3g} rpm in speed"
    return text if found["sd_a"] is None else f"{text}, {found['sd_a']:.3g} A in current"


def corrected(part: Summary) -> str:
    """How much the surrogate had to be corrected."""
    found = part["diagnostics"]
    return (
        f"{found['effective_after_simulation']:.0f} effective of {found['simulated_draws']} draws, "
        f"surrogate fitted again {found['surrogate_refits']} times"
    )


def by_amplitude(name: str, route: Summary) -> str:
    """The amplitude route's δ, marked with the curve that it was read from."""
    whose = f"For comparison{_of(name)}, by the ringing's amplitude and the curve {route['curve']}"
    if route["delta_rad"] is None:
        return f"{whose}: no answer. {route['reason'] or ''}".rstrip()
    warning = " (that curve belongs to the paper's bench)" if route["curve"] == "published" else ""
    return f"{whose}{warning}: {in_mrad(route['delta_rad'])}."


def sampling(part: Summary) -> str:
    """Convergence in one line."""
    found = part["diagnostics"]
    return (
        f"{found['outcome']}, largest R̂ {found['r_hat']:.3f}, "
        f"smallest effective sample size {found['ess_bulk']:.0f}"
    )


def sampler_check(part: Summary) -> str | None:
    """What the second sampler says of every parameter; ``None`` where it was not asked."""
    check = part.get("sampler_check")
    if check is None:
        return None
    told = "; ".join(
        f"{symbol} {number(found['difference_sd'], 2)} sd, width × {found['width_ratio']:.2f}"
        for symbol, found in check["symbols"].items()
    )
    verdict = "agrees with" if check["agrees"] else "disagrees with"
    return f"Nested sampling {verdict} emcee (difference, width over emcee's): {told}."


def written(folder: object) -> str:
    """Where everything is."""
    return f"Written to {folder}"


def _of(name: str) -> str:
    return f" of {name}" if name else ""


def glued(sentence: str) -> str:
    """With no-break spaces between a number and its sign or unit."""
    before_unit = r"(?<=\d) (?=%|mrad|rpm|rad|A\b|N m|kg m)"
    within = r"(?<=[<>]) (?=\d)|(?<=\d N) (?=m)|(?<=\d kg) (?=m)"
    return re.sub(f"{before_unit}|{within}", "\N{NO-BREAK SPACE}", sentence)


def wrapped(sentence: str, width: int) -> str:
    """Broken into lines of ``width``, but never between a number and its sign or unit."""
    lines = textwrap.wrap(glued(sentence), width, break_on_hyphens=False)
    return "\n".join(lines).replace("\N{NO-BREAK SPACE}", " ")
