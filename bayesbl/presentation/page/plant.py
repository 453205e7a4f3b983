"""The pages of a plant: all joints, the most urgent first, and one page for each.

They are made from the tables and the summary of a fleet, are static, and need no server or network.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections import defaultdict
from collections.abc import Callable, Sequence
from datetime import date as Date
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from bayesbl.presentation import words
from bayesbl.presentation.blocks import labelled, table
from bayesbl.presentation.fleet import (
    OUTCOMES,
    Cell,
    Row,
    headline,
    in_mrad,
    interval_of,
    limit_reached,
    state,
    types_in_words,
    unlike_type,
)
from bayesbl.presentation.page.build import source, templates
from bayesbl.presentation.wear import LAWS
from bayesbl.results.folder import SUMMARY_FILE
from bayesbl.results.store import write_text

if TYPE_CHECKING:
    from markupsafe import Markup


def picture(rows: Sequence[Row], limit_rad: float | None, *, axes: bool = False) -> Markup | str:
    """Medians with the band of their intervals and the limit as SVG; empty without a gap.

    ``axes``: large, with scales and a bar for each recording, starting at 0.
    """
    from markupsafe import Markup
    from matplotlib.ticker import MaxNLocator

    if not rows:
        return ""
    width, height, inset, radius = (760.0, 280.0, 8.0, 3.5) if axes else (132.0, 30.0, 3.0, 2.0)
    left, right, top, bottom = (52.0, 746.0, 14.0, 246.0) if axes else (0.0, 132.0, 3.0, 27.0)
    days = [Date.fromisoformat(row["date"]).toordinal() for row in rows]
    shares = [(day - days[0]) / (days[-1] - days[0] or 1) for day in days]
    begin, room = left + inset, right - left - 2.0 * inset
    x = [begin + room * share for share in (shares if len(rows) > 1 else [0.5])]
    highest = max([row["delta_rad_high"] for row in rows] + [limit_rad or 0.0])

    def y(gap_rad: float) -> float:
        return float(bottom + gap_rad / (1.08 * highest) * (top - bottom))

    low, middle, high = (
        [f"{at:.1f},{y(row[f'delta_rad_{end}']):.1f}" for at, row in zip(x, rows, strict=True)]
        for end in ("low", "median", "high")
    )
    drawn = ""
    if limit_rad is not None:
        drawn = f'<path class="limit" d="M{left:g} {y(limit_rad):.1f}H{right:g}"/>'
    if len(rows) > 1:
        band = " ".join([*high, *reversed(low)])
        drawn += f'<polygon points="{band}"/><polyline points="{" ".join(middle)}"/>'
    for place in middle if axes else middle[-1:]:
        cx, _, cy = place.partition(",")
        drawn += f'<circle cx="{cx}" cy="{cy}" r="{radius:g}"/>'
    ends = [(x[n], rows[n]) for n in sorted({0, len(rows) - 1})]
    kind = f'class="spark" width="{width:g}" height="{height:g}"'
    if axes:
        kind = 'class="history"'
        ticks = MaxNLocator(8, steps=[1, 2, 5, 10]).tick_values(0.0, 1e3 * highest)
        for value in ticks[ticks <= 1.08e3 * highest]:
            at = y(1e-3 * value)
            drawn = (
                f'<path class="grid" d="M{left} {at:.1f}H{right}"/>'
                f'<text x="{left - 6}" y="{at + 4:.1f}" text-anchor="end">{value:g}</text>{drawn}'
            )
        for (at, row), anchor in zip(ends, ("start", "end"), strict=False):
            place = f'x="{at:.1f}" y="{height - 10}" text-anchor="{anchor}"'
            drawn += f"<text {place}>{row['date']}</text>"
        for upper, lower in zip(high, low, strict=True):
            drawn += f'<path class="bar" d="M{upper} L{lower}"/>'
        drawn += f'<text x="{left}" y="{top - 2}">Gap (mrad)</text>'
    said = ", ".join(
        f"{1e3 * row['delta_rad_median']:.3g} mrad on {row['date']}" for _, row in ends
    )
    box = f'viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{said}"'
    return Markup(f"<svg {kind} {box}>{drawn}</svg>")


def write_pages(folder: Path) -> list[Path]:
    """Write ``index.html`` and ``joints/<joint>.html`` from the tables in a fleet's folder."""
    import pyarrow.parquet

    summary = json.loads((folder / SUMMARY_FILE).read_text(encoding="utf-8"))
    joints, recordings = (
        pyarrow.parquet.read_table(folder / f"{name}.parquet").to_pylist()
        for name in ("joints", "recordings")
    )
    environment = templates("plant.css")
    script = source(environment, "plant.js")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    of_joint: dict[str, list[Row]] = defaultdict(list)
    for row in recordings:
        of_joint[str(row["joint"])].append(row)
    names = {str(row["joint"]) for row in joints}
    level = f"{100.0 * summary['level']:g} %"
    index = environment.get_template("plant.html").render(
        level=level,
        script=script,
        script_digest=digest,
        headline=headline(summary),
        types=list(types_in_words(summary)),
        costed=any(row["expected_cost"] is not None for row in joints),
        rows=[_line(row, of_joint[str(row["joint"])], summary) for row in joints],
        gearboxes=sorted({str(row["gearbox"]) for row in joints if row["gearbox"]}),
        strange=[row for row in recordings if str(row["joint"]) not in names],
        before=summary["decide_before"],
        version=f"{summary['version']}, commit {summary['commit']}",
    )
    paths = [folder / "index.html"]
    write_text(index, paths[0])
    pages = folder / "joints"
    pages.mkdir(exist_ok=True)
    template = environment.get_template("plant_joint.html")
    for row in joints:
        # Not by a writer that makes each file whole: the folder as a whole appears so.
        paths.append(pages / f"{row['joint']}.html")
        page = template.render(level=level, **_page(row, of_joint[str(row["joint"])], summary))
        paths[-1].write_text(page, encoding="utf-8")
    return paths


def _line(row: Row, recordings: Sequence[Row], summary: Row) -> dict[str, Any]:
    """A row of the index."""
    return {
        **row,
        "address": f"joints/{quote(str(row['joint']))}.html",
        "gearbox": row["gearbox"] or "",
        "gap": in_mrad(row, "delta_rad", summary),
        "rate": in_mrad(row, "rate_rad_per_year", summary),
        "limit": limit_reached(row),
        "passed": _cell(row["probability_limit_now"], words.probability),
        "cost": _cell(row["expected_cost"], _cost),
        "state": state(row, summary),
        "picture": picture(_given(recordings), row["limit_rad"]),
    }


def _page(row: Row, recordings: Sequence[Row], summary: Row) -> dict[str, Any]:
    from bayesbl.fleet.plant_tables import JOINT_COLUMNS

    own = {key: v for key, v in row.items() if key not in JOINT_COLUMNS and v is not None}
    titles = ("Date", "#Gap (mrad)", "Outcome", "Used for the rate", "Notes", "File")
    cells = []
    for one in reversed(recordings):
        gap, why = in_mrad(one, "delta_rad", summary), one["reason"] or one["notes"] or ""
        outcome, used = OUTCOMES[str(one["outcome"])], "yes" if one["used"] else "no"
        cells.append(
            (one["date"], f"{gap.text} {gap.below}".strip(), outcome, used, why, one["file"])
        )
    return {
        "name": row["joint"],
        "gearbox": row["gearbox"],
        "headline": _headline(row, summary),
        "reason": row["reason"],
        "picture": picture(_given(recordings), row["limit_rad"], axes=True),
        "numbers": [*labelled({**_facts(row, summary), **own})],
        "recordings": [table(titles, cells)],
    }


def _headline(row: Row, summary: Row) -> str:
    gap = interval_of(row, "delta_rad", summary)
    rate = interval_of(row, "rate_rad_per_year", summary)
    if gap is None:
        return f"{row['joint']}: the gap is not known."
    said = f"{row['joint']}: the gap was {words.in_mrad(gap)} on {row['last_date']}"
    if rate is None:
        return f"{said}. The rate of wear is not known."
    if row["probability_wear"] < words.SURE and not row["pooled"]:
        shown = words.probability(row["probability_wear"])
        return f"{said}, and is not shown to have grown (probability {shown})."
    unlike = unlike_type(row, summary)
    how = f", {unlike} (by its own recordings alone)" if unlike else ""
    return f"{said}, and grows by {words.middle(rate, 1e3)} mrad a year{how}."


def _facts(row: Row, summary: Row) -> dict[str, str | None]:
    """What is known of a joint; ``None`` is not."""

    def rate(name: str) -> str | None:
        interval = interval_of(row, name, summary)
        if interval is None:
            return None
        return f"{words.middle(interval, 1e3)} ({words.bounds(interval, 1e3)}) mrad a year"

    def shown(name: str, in_words: Callable[[Any], str]) -> str | None:
        return None if row[name] is None else in_words(row[name])

    before, chance = summary["decide_before"], words.probability
    reached, ahead = limit_reached(row), row["limit_date_not_before"] or "1000 years"
    forecast = row["rate_rad_per_year_median"] is not None and row["limit_rad"] is not None
    return {
        "Rate of wear": rate("rate_rad_per_year"),
        "Rate by its own recordings": rate("rate_alone_rad_per_year") if row["pooled"] else None,
        "Uses other joints of its type": shown("law", lambda _: "yes" if row["pooled"] else "no"),
        "Probability that it wears unlike its type": shown("probability_unlike_type", chance),
        "Most likely law": shown("law", LAWS.__getitem__),
        "Probability of growth": shown("probability_wear", chance),
        "Limit": shown("limit_rad", lambda limit: f"{1e3 * limit:g} mrad"),
        "Probability above the limit": shown("probability_limit_now", chance),
        "Reaches the limit": f"{reached.text} ({reached.below})" if forecast else None,
        "Not before": ahead if forecast else None,
        f"Probability before {before}": shown("probability_limit_before", chance),
        f"Expected cost before {before}": shown("expected_cost", _cost),
        "Recordings": f"{row['recordings']}, {row['used']} of them used for the rate",
    }


def _cell(value: float | None, in_words: Callable[[float], str]) -> Cell:
    return Cell("–", key=-1.0) if value is None else Cell(in_words(value), key=value)


def _cost(value: float) -> str:
    return f"{value:,.0f}"


def _given(recordings: Sequence[Row]) -> list[Row]:
    return [row for row in recordings if row["delta_rad_median"] is not None]
