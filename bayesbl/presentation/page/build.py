"""The page of a result: the answer first, then everything that it rests on."""

from __future__ import annotations

import base64
import io
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import xarray as xr

from bayesbl.errors import UserError
from bayesbl.presentation import diagnosis as diagnosed
from bayesbl.presentation import wear as worn
from bayesbl.presentation import words
from bayesbl.presentation.advice import advice
from bayesbl.presentation.assumptions import assumptions
from bayesbl.presentation.captions import caption, is_for_specialists, reading_order
from bayesbl.presentation.citations import all_bibtex, citations
from bayesbl.presentation.console import print_details, print_result
from bayesbl.presentation.page.blocks import Collector
from bayesbl.presentation.study import print_study, study_headline
from bayesbl.presentation.words import Summary
from bayesbl.results.folder import FIGURES
from bayesbl.results.store import read_tree, write_text
from bayesbl.runs.summary import summarise
from bayesbl.units import number

PAGE_FILE = "report.html"

Draw = Callable[[xr.DataTree, Path], Sequence[Path]]
"""Draws all figures of a result into a folder and says which files it wrote."""

_KINDS = {
    "fit": "Backlash gap of a joint",
    "compare": "Backlash gap of a joint and its change",
    "sweep": "Gap curve of a virtual bench",
    "diagnose": "What a bench lacks",
    "study": "Study",
}


_UNITS = {"noise": "× noise"}


@dataclass(frozen=True, slots=True)
class Picture:
    """A figure as the page holds it: no file beside it is needed."""

    caption: str
    address: str
    special: bool = False
    """Whether it is of use to specialists only."""


@dataclass(frozen=True, slots=True)
class Card:
    """A number of the answer, large, with what it is and how sure it is."""

    label: str
    value: str
    unit: str
    note: str


def write_page(result: str | Path, draw: Draw) -> Path:
    """Write ``report.html`` beside a stored result, over an earlier one.

    Parameters
    ----------
    result
        An output folder or its ``result.nc``.
    draw
        Draws the figures where the folder holds none.

    Raises
    ------
    ResultError
        If there is no readable, finished result.
    """
    result = Path(result)
    tree = read_tree(result)
    folder = result if result.is_dir() else result.parent
    path = folder / PAGE_FILE
    write_text(page(tree, _pictures(tree, folder / FIGURES, draw)), path)
    return path


def page(tree: xr.DataTree, pictures: Sequence[Picture]) -> str:
    """The page as HTML; every text that a user may have given is escaped."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("bayesbl.presentation.page", "."),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["glued"] = words.glued
    style = environment.loader.get_source(environment, "page.css")[0]  # type: ignore[union-attr]
    return environment.get_template("page.html").render(style=style, **_content(tree, pictures))


def _content(tree: xr.DataTree, pictures: Sequence[Picture]) -> dict[str, Any]:
    summary = _summary(tree)
    numbers, details = Collector(), Collector()
    if summary["kind"] == "study":
        from bayesbl.runs.study import table_columns

        print_study(summary["rows"], table_columns(summary["rows"])[:-1], numbers)
    else:
        print_result(summary, None, numbers)
        print_details(tree, summary, details)
    snapshots = summary["kind"] in ("fit", "compare")
    return {
        "title": _KINDS.get(summary["kind"], summary["kind"]),
        "headline": _headline(summary),
        "advice": advice(summary),
        "cards": list(_cards(summary)),
        "explained": words.gap_in_plain_words(summary) if snapshots else "",
        "answer": _answer_picture(summary) if snapshots else next(iter(pictures), None),
        "pictures": [picture for picture in pictures if not picture.special],
        "special": [picture for picture in pictures if picture.special],
        "numbers": [block for block in numbers.blocks if block.text != _headline(summary)],
        "details": details.blocks,
        "budget": list(_budget(summary)),
        "assumptions": list(assumptions(summary)),
        "config": tree.attrs.get("config", ""),
        "origin": list(_origin(tree.attrs)),
        "inputs": json.loads(tree.attrs.get("input_sha256", "{}")),
        "versions": json.loads(tree.attrs.get("dependency_versions", "{}")),
        "citations": citations(),
        "bibtex": all_bibtex(),
    }


def _summary(tree: xr.DataTree) -> Summary:
    if tree.attrs["kind"] == "study":
        from bayesbl.runs.study import summarise_study

        return {"kind": "study", **summarise_study(tree)}
    return summarise(tree)


def _headline(summary: Summary) -> str:
    match summary["kind"]:
        case "sweep":
            return words.swept(summary)
        case "diagnose":
            return diagnosed.headline(summary)
        case "study":
            return study_headline(summary)
        case _:
            return next(worn.answer(summary))


def _cards(summary: Summary) -> Iterator[Card]:
    if summary["kind"] == "diagnose":
        yield from _gap_cards(summary)
    if summary["kind"] not in ("fit", "compare"):
        return
    if worn.is_told(summary):
        yield from _wear_cards(summary)
        return
    labelled = [
        (f"Gap δ, {name}" if name else "Gap δ", part["delta_rad"])
        for name, part in words.snapshots(summary)
    ]
    if summary["kind"] == "compare":
        labelled.append(("Change", summary["change_rad"]))
    places = words.common_decimals(found for _, found in labelled)
    for label, found in labelled:
        yield _card(label, found, places)


def _card(label: str, found: Mapping[str, Any] | None, places: int) -> Card:
    if found is None:
        return Card(label, "withheld", "", "")
    value = number(1e3 * found["median"], places)
    sign = "+" if label == "Change" and found["median"] > 0.0 else ""
    told = f"{100.0 * found['level']:g} %: {words.bounds(found, 1e3, places)}"
    return Card(label, sign + value, "mrad", told)


def _wear_cards(summary: Summary) -> Iterator[Card]:
    """The gap now, how fast it grows, and when it reaches the limit; the picture shows them all."""
    wear, last = summary["wear"], summary["snapshots"][-1]
    change = summary["change_rad"]
    places = words.common_decimals([last["delta_rad"], change])
    yield _card("Gap δ now", last["delta_rad"], places)
    if not worn.spans_repair(summary):
        yield _card("Change", change, places)  # across a repair it would say nothing of wear
    rate = wear["rate_rad_per_year"]
    note = f"{100.0 * rate['level']:g} %: {words.bounds(rate, 1e3)}"
    yield Card("Wear", worn.in_mrad(rate), "mrad a year", note)
    if wear["limit_date"] is not None:
        middle, bounds = worn.limit_dates(wear, worn.month)
        yield Card("Limit reached", middle, "", f"{100.0 * rate['level']:g} %: {bounds}")


def _gap_cards(summary: Summary) -> Iterator[Card]:
    """How far bench and measurement lie apart, on held-out recordings where there are any; δ."""
    gaps = summary["gap"]["over_all"]
    use = "held_out" if "held_out" in gaps else next(iter(gaps), None)
    if use is not None:
        unit = gaps[use].get("unit") or summary["gap"]["unit"]
        for label, key in (("Disagreement before naming", "before"), ("after naming", "after")):
            value = words.significant(gaps[use][key], 3)
            yield Card(label, value, _UNITS.get(unit, unit), diagnosed.use_in_words(use))
    found = summary["delta_rad_after"]
    if found is not None:
        yield _card("Gap δ", found, words.common_decimals([found]))


def _budget(summary: Summary) -> Iterator[tuple[str, list[tuple[str, float, str]]]]:
    """(of what, (source, share in percent, share in words), largest first)."""
    if summary["kind"] not in ("fit", "compare"):
        return
    for name, part in words.snapshots(summary):
        shares = sorted(part["budget"].items(), key=lambda item: -item[1])
        yield (
            name or "Gap",
            [(words.source_in_words(s), 100.0 * share, words.probability(share))
             for s, share in shares],
        )  # fmt: skip


def _origin(attributes: Mapping[Any, Any]) -> Iterator[tuple[str, str]]:
    labels = {
        "bayesbl_version": "Version",
        "git_commit": "Commit",
        "created_utc": "Made",
        "seed": "Seed",
        "python_version": "Python",
    }
    for key, label in labels.items():
        if key in attributes:
            yield label, str(attributes[key])


def _answer_picture(summary: Summary) -> Picture | None:
    """Every gap with its interval and the limit; nothing if all of them are withheld."""
    from bayesbl.presentation.figures.answer import answer

    parts = words.snapshots(summary)
    if all(part["delta_rad"] is None for _, part in parts):
        return None
    told = "; ".join(
        f"{name or 'gap'}: "
        + ("withheld" if part["delta_rad"] is None else words.in_mrad(part["delta_rad"]))
        for name, part in parts
    )
    buffer = io.BytesIO()
    places = words.common_decimals(part["delta_rad"] for _, part in parts)
    answer([(name, dict(part)) for name, part in parts], places).savefig(
        buffer, format="svg", metadata={"Date": None}
    )
    return Picture(told, _address(buffer.getvalue(), "svg+xml"))


def _pictures(tree: xr.DataTree, stored: Path, draw: Draw) -> list[Picture]:
    """The stored figures, or fresh ones where there are none."""
    files = {path.stem: path for path in stored.glob("*.png")}
    with tempfile.TemporaryDirectory() as folder:
        if not files:
            # A study's figure is drawn by its study file, which may be gone.
            with suppress(UserError):
                drawn = draw(tree, Path(folder))
                files = {path.stem: path for path in drawn if path.suffix == ".png"}
        order = reading_order(files, _snapshot_names(tree))
        return [
            Picture(
                caption(name),
                _address(files[name].read_bytes(), "png"),
                is_for_specialists(name),
            )
            for name in order
        ]


def _snapshot_names(tree: xr.DataTree) -> list[str]:
    if tree.attrs["kind"] != "compare":
        return []
    return [str(name) for name in tree["posterior"].to_dataset()["snapshot"].values]


def _address(data: bytes, kind: str) -> str:
    return f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
