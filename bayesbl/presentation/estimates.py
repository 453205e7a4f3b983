"""What was estimated of each snapshot: parameters, noise, sampling, rival optima."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from bayesbl.presentation import answer, play, words
from bayesbl.presentation.blocks import Block, Heading, Table, aside, labelled, numbers, table, text
from bayesbl.units import number

if TYPE_CHECKING:
    import xarray as xr

    from bayesbl.measurement.summary_types import MeasuredSummary, RouteSummary


BOUND_EXPLAINED = (
    "Cramér-Rao: the smallest standard deviation that any unbiased estimate from these recordings "
    "can have without prior knowledge of the bench."
)

CHECK_EXPLAINED = (
    "Power of the difference between recording and simulation that repeats every {}, over the "
    "power expected from noise; the probability that noise alone gives as much."
)


def blocks(tree: xr.DataTree, summary: MeasuredSummary) -> Iterator[Block]:
    """Parameters and diagnostics of every snapshot."""
    for name, part in answer.snapshots(summary):
        routes = answer.answering(part)
        for route in routes:
            by = f", by {words.route_in_words(route['route'])}" if len(routes) > 1 else ""
            yield Heading((f"Snapshot {name}" if name else "Fit") + by)
            if "cramer_rao_sd" in route:
                yield from _of_simulation(route)
            elif "ramps" in route:
                yield from play.ramp_blocks(route)
            elif "transmission_error" in route:
                yield from play.encoder_blocks(route)
            else:
                yield from _of_amplitude(route, "; ".join(_rivals(tree, route, name)) or "none")


def noise(part: RouteSummary) -> str:
    """``AR(1), standard deviation 1.51 rpm in speed, coefficients 0.600``; the current's too."""
    found = part["noise"]
    kind = f"AR({found['order']})" if found["order"] else "white"
    if found.get("differentiated"):
        kind = f"differentiated {kind}"
    text = f"{kind}, standard deviation {found['sd_rpm']:.3g} rpm in speed"
    if found.get("sd_a") is not None:
        text += f", {found['sd_a']:.3g} A in current"
    elif found["order"]:
        text += ", coefficients " + ", ".join(number(c, 3) for c in found["coefficients"])
    if found["degrees_of_freedom"] is not None:
        text += f", Student-t with {found['degrees_of_freedom']:g} degrees of freedom"
    if (evidence := found.get("student_t_evidence")) is not None:
        text += f" (log evidence for Student-t: {number(evidence, 0)})"
    if found.get("repeating_rounding_sd_rpm"):
        text += (
            f"; and rounding of {found['repeating_rounding_sd_rpm']:.3g} rpm that repeats every "
            "rotation"
        )
    return text


def _of_amplitude(part: RouteSummary, rivals: str) -> Iterator[Block]:
    yield _parameter_table(part)
    lines = {
        "Search": part.get("start"),
        "Table 2's ranges": _box_search(part) if "box_search" in part else None,
        "Fit": f"RMSE {part['rmse_rpm']:.3f} rpm, relative {part['relative_rmse']:.3f}",
        "Repeating misfit": f"{part['misfit_rms_rpm']:.3f} rpm RMS, the same in every rotation",
        "Impacts": _impacts(part) if "impact_sd_rpm" in part else None,
        "Noise": noise(part),
        "Sampling": words.sampling(part),
        "Rival optima": rivals,
    }
    yield from labelled(lines)


def _impacts(part: RouteSummary) -> str:
    low, high = part["impact_sd_rpm"]["low"], part["impact_sd_rpm"]["high"]
    least = f"{low:.2g} to " if low > 0.0 else "at most "
    return f"differ from one another by {least}{high:.2g} rpm beyond noise"


def _box_search(part: RouteSummary) -> str:
    found = part["box_search"]
    return (
        f"the search ended at A = {found['amplitude_rpm']:.3g} rpm, RMSE {found['rmse_rpm']:.3g} "
        f"rpm; eq. 4 there: {1e3 * found['gap_as_printed_rad']:.3g} mrad"
    )


def _parameter_table(part: RouteSummary) -> Table:
    """All nine symbols, with intervals or as fixed."""
    from bayesbl.ringing.symbols import SYMBOLS

    kind = words.interval_kind(next(iter(part["parameters"].values())))
    columns = (text("Parameter"), *map(numbers, ("Optimum", "Median", kind)), text("Unit"))
    rows = []
    for name, symbol in SYMBOLS.items():
        best, found = part["optimum"][name], part["parameters"].get(name)
        cells = [f"{best:g}", "", "fixed"]
        if found is not None:
            places = words.decimals(found, units=20.0)
            cells = [number(value, places) for value in (best, found["median"])]
            cells.append(words.bounds(found, places=places))
        rows.append([name, *cells, symbol.unit])
    return table(columns, rows)


def _rivals(tree: xr.DataTree, part: RouteSummary, name: str) -> list[str]:
    """Other local optima of one snapshot, as amplitude and RMSE."""
    optimum = tree.children[part["route"]].children["optimum"].to_dataset()
    if name:
        optimum = optimum.sel(snapshot=name)
    amplitudes, errors = optimum["rival_amplitude_rpm"].values, optimum["rival_rmse_rpm"].values
    return [
        f"A = {a:.1f} rpm at RMSE {e:.3f} rpm"
        for a, e in zip(amplitudes, errors, strict=True)
        if a == a  # padding of snapshots with fewer rivals is NaN
    ]


def _of_simulation(part: RouteSummary) -> Iterator[Block]:
    """Every unknown with its interval and its bound, the predictive check, noise and sampling."""
    yield unknown_table(part)
    yield aside(BOUND_EXPLAINED)
    yield _check_table(part)
    turn = "cycle, or is slow where the motion does not repeat" if "motion" in part else "rotation"
    yield aside(CHECK_EXPLAINED.format(turn))
    found = part["diagnostics"]
    simulated = (
        f"{found['effective_after_simulation']:.0f} effective draws by {found['simulated_draws']} "
        f"simulations, surrogate fitted again {found['surrogate_refits']} times"
    )
    sampling = words.sampling(part)
    lines = {"Noise": noise(part), "Sampling": sampling, "Full simulation": simulated}
    yield from labelled(lines)


def unknown_table(part: RouteSummary) -> Table:
    """A row an unknown: optimum, standard deviation, its bound, interval."""
    kind = words.interval_kind(next(iter(part["parameters"].values())))
    titles = ("Optimum", "Posterior sd", "Cramér-Rao", kind)
    rows = [_unknown_row(part, name) for name in part["optimum"]]
    return table((text("Parameter"), *map(numbers, titles)), rows)


def _unknown_row(part: RouteSummary, name: str) -> tuple[str, ...]:
    found = part["delta_rad"] if name == "delta_rad" else part["parameters"][name]
    # What these recordings say nothing of has no finite bound.
    errors = (
        "–" if (sd := part[key][name]) is None else words.significant(sd, 3)
        for key in ("posterior_sd", "cramer_rao_sd")
    )
    if found is None:
        return name, "withheld", *errors, "withheld"
    best = f"{part['optimum'][name]:.6g}"
    return name, best, *errors, words.bounds(found, places=words.decimals(found))


def _check_table(part: RouteSummary) -> Table:
    orders = "Orders of the\ncycle up to" if "motion" in part else "Load orders\nup to"
    titles = (orders, "Repeating\nover noise", "Probability")
    rows = [
        (
            entry["channel"],
            entry["highest_order"] or "mean",
            words.significant(entry["ratio"], 3),
            words.probability(entry["probability"]),
        )
        for entry in part["predictive_check"]
    ]
    return table((text("Channel"), *map(numbers, titles)), rows)
