"""Estimates of each snapshot: parameters, noise, sampling, rival optima."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from bayesbl.presentation import answer, words
from bayesbl.presentation.blocks import Block, Sentence, Table, aside, labelled, table
from bayesbl.units import number, quantity_and_unit

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.measurement.summary_types import MeasuredSummary, RouteSummary
    from bayesbl.results.store import Interval


BOUND_EXPLAINED = (
    "Cramér-Rao: the smallest standard deviation that an unbiased estimate from these recordings "
    "can have without prior knowledge of the bench."
)

RELATIVE_EXPLAINED = (
    "Relative compliance: the compliance between the positions that ramps leave at zero torque, "
    "over that behind them. With play it is above 1, because the joint crosses the play at nearly "
    "no torque; with preload it is below 1, because both flanks carry the torque there. Soft "
    "flanks without play have up to 4."
)

CHECK_EXPLAINED = (
    "Repeating over noise: the power of the difference between recording and simulation that "
    "repeats every {}, over that expected from noise. Probability: that noise alone gives as much."
)


def blocks(tree: xr.DataTree, summary: MeasuredSummary) -> Iterator[Block]:
    """Parameters and diagnostics of every snapshot."""
    for name, part in answer.snapshots(summary):
        routes = answer.answering(part)
        for route in routes:
            by = f", by {words.in_words(route['route'])}" if len(routes) > 1 else ""
            yield Sentence((f"Snapshot {name}" if name else "Fit") + by, "heading")
            yield parameter_table(route)
            if "cramer_rao_sd" in route:
                yield from _of_simulation(route)
            elif "ramps" in route:
                yield from _of_ramps(route)
            elif "transmission_error" in route:
                sure = words.probability(route["probability_of_play"])
                turned = route["reversals"]
                yield from labelled({"Probability of play": sure, "Reversals of the motor": turned})
            else:
                yield from _of_amplitude(route, "; ".join(_rivals(tree, route, name)) or "none")


def parameter_table(part: RouteSummary) -> Table:
    """A row for each parameter: optimum, median or standard deviations, interval."""
    intervals: dict[str, Interval | None] = dict.fromkeys(part["optimum"])
    intervals.pop("rmse_rpm", None)
    intervals |= part["parameters"]
    if "delta_rad" in intervals:
        intervals["delta_rad"] = part["delta_rad"]
    for error in part["transmission_error"]["harmonics"] if "transmission_error" in part else ():
        name = f"order {error['order']} per turn of the {error['of']}_rad"
        intervals[name] = error["amplitude_rad"]
    heads = ["Posterior sd", "Cramér-Rao"] if "cramer_rao_sd" in part else ["Median"]
    if part["optimum"]:
        heads = ["Optimum", *heads]
    kind = words.interval_kind(next(iter(part["parameters"].values())))
    rows = [_row(part, name, interval, len(heads)) for name, interval in intervals.items()]
    return table(["Parameter", *(f"#{head}" for head in (*heads, kind)), "Unit"], rows)


def _row(part: RouteSummary, name: str, interval: Interval | None, values: int) -> list[str]:
    """Name, values, interval and unit; fixed and withheld parameters have no interval."""
    quantity, unit = quantity_and_unit(name.replace("__", ": "))
    optimum = part["optimum"]
    if interval is None and name == "delta_rad":
        return [quantity, *["withheld"] * values, "withheld", unit]
    if interval is None:
        return [quantity, f"{optimum[name]:g}", "", "fixed", unit]
    scale = 1.0
    if name == "delta_rad" or (not optimum and unit.startswith(("rad", "s"))):
        scale, unit = 1e3, f"m{unit}"
    places = words.decimals(interval, scale, units=20.0)
    shown = [number(scale * optimum[name], places)] if optimum else []
    if "cramer_rao_sd" in part:
        # What these recordings say nothing of has no finite bound.
        bound = part["cramer_rao_sd"][name]
        shown.append(words.significant(scale * part["posterior_sd"][name], 3))
        shown.append("–" if bound is None else words.significant(scale * bound, 3))
    else:
        shown.append(number(scale * interval["median"], places))
    return [quantity, *shown, words.bounds(interval, scale, places), unit]


def noise(part: RouteSummary) -> str:
    """``AR(1), standard deviation 1.51 rpm in speed, coefficients 0.600``; also of the current."""
    model = part["noise"]
    kind = f"AR({model['order']})" if model["order"] else "white"
    if model.get("differentiated"):
        kind = f"differentiated {kind}"
    text = f"{kind}, standard deviation {model['sd_rpm']:.3g} rpm in speed"
    if model.get("sd_a") is not None:
        text += f", {model['sd_a']:.3g} A in current"
    elif model["order"]:
        text += ", coefficients " + ", ".join(number(c, 3) for c in model["coefficients"])
    if model["degrees_of_freedom"] is not None:
        text += f", Student-t with {model['degrees_of_freedom']:g} degrees of freedom"
    if (evidence := model.get("student_t_evidence")) is not None:
        text += f" (log evidence for Student-t: {number(evidence, 0)})"
    if model.get("repeating_rounding_sd_rpm"):
        text += (
            f"; and rounding of {model['repeating_rounding_sd_rpm']:.3g} rpm that repeats every "
            "rotation"
        )
    return text


def _of_amplitude(part: RouteSummary, rivals: str) -> Iterator[Block]:
    boxed = impacts = ""
    if (optimum := part.get("box_search")) is not None:
        boxed = (
            f"the search ended at A = {optimum['amplitude_rpm']:.3g} rpm, RMSE "
            f"{optimum['rmse_rpm']:.3g} rpm; eq. 4 there: "
            f"{1e3 * optimum['gap_as_printed_rad']:.3g} mrad"
        )
    if (sd := part.get("impact_sd_rpm")) is not None:
        least = f"{sd['low']:.2g} to " if sd["low"] > 0.0 else "at most "
        impacts = f"differ from one another by {least}{sd['high']:.2g} rpm beyond noise"
    lines = {
        "Search": part.get("start"),
        "Table 2's ranges": boxed,
        "Fit": f"RMSE {part['rmse_rpm']:.3f} rpm, relative {part['relative_rmse']:.3f}",
        "Repeating misfit": f"{part['misfit_rms_rpm']:.3f} rpm RMS, the same in every rotation",
        "Impacts": impacts,
        "Noise": noise(part),
        "Sampling": words.sampling(part),
        "Rival optima": rivals,
    }
    yield from labelled(lines)


def _rivals(tree: xr.DataTree, part: RouteSummary, name: str) -> list[str]:
    """Other local optima of a snapshot, as amplitude and RMSE."""
    from bayesbl.measurement.stored import of_snapshot

    optimum = of_snapshot(tree.children[part["route"]].children["optimum"], name)
    amplitudes, errors = optimum["rival_amplitude_rpm"].values, optimum["rival_rmse_rpm"].values
    rivals = zip(amplitudes, errors, strict=True)
    return [f"A = {a:.1f} rpm at RMSE {e:.3f} rpm" for a, e in rivals]


def _of_simulation(part: RouteSummary) -> Iterator[Block]:
    """Predictive check, noise and sampling of a simulation."""
    yield aside(BOUND_EXPLAINED)
    orders = "#Orders of the\ncycle up to" if "motion" in part else "#Load orders\nup to"
    rows = [
        (
            entry["channel"],
            entry["highest_order"] or "mean",
            words.significant(entry["ratio"], 3),
            words.probability(entry["probability"]),
        )
        for entry in part["predictive_check"]
    ]
    yield table(("Channel", orders, "#Repeating\nover noise", "#Probability"), rows)
    turn = "cycle, or is slow where the motion does not repeat" if "motion" in part else "rotation"
    yield aside(CHECK_EXPLAINED.format(turn))
    diagnostics = part["diagnostics"]
    simulated = (
        f"{diagnostics['effective_after_simulation']:.0f} effective draws by "
        f"{diagnostics['simulated_draws']} simulations, surrogate fitted again "
        f"{diagnostics['surrogate_refits']} times"
    )
    sampling = words.sampling(part)
    lines = {"Noise": noise(part), "Sampling": sampling, "Full simulation": simulated}
    yield from labelled(lines)


def _of_ramps(part: RouteSummary) -> Iterator[Block]:
    """What shows whether there is play."""
    relative = part["relative_compliance"]
    shown = "not known, without larger ramps" if relative is None else words.significant(relative)
    sure = words.probability(part["probability_of_play"])
    lines = {"Relative compliance": f"{shown}; probability of play: {sure}"}
    yield from labelled({**lines, "Sampling": words.sampling(part)})
    yield aside(RELATIVE_EXPLAINED)
