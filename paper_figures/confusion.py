"""What was hidden against what was named: the confusion matrix of the diagnosis."""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
import xarray as xr
from common import PaperFigure, Stored, arrays, main
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from bayesbl.bench.effects import EFFECTS
from bayesbl.presentation.figures.style import DOUBLE_COLUMN_IN, grid, new_figure
from bayesbl.units import in_words

TABLES = ("hidden_effects_confusion", "hidden_effects_core_confusion")
"""The whole study where it was run, else its core."""

_VERDICTS = ("nothing_missing", "unexplained")
_OUTSIDE = "outside: "
_ROW_IN = 0.172
_LETTER_IN = 0.05
"""Mean width of a letter of 7 pt."""


def data(stored: Stored) -> xr.Dataset:
    """How often each answer was given to each single thing hidden; pairs are counted apart."""
    lines = stored.table(*TABLES)
    counts: dict[str, Counter[str]] = {}
    pairs = both = 0
    for line in lines:
        answers = {k: int(v) for k, v in line.items() if k not in ("row", "hidden") and v}
        if " + " in line["hidden"]:
            pairs += sum(answers.values())
            both += answers.get(" + ".join(sorted(line["hidden"].split(" + "))), 0)
            continue
        counts.setdefault(line["hidden"] or line["row"], Counter()).update(answers)
    effects = [effect.name for effect in EFFECTS]
    known = [n for n in effects if n in counts]
    others = [n for n in counts if n not in effects]
    hidden = known + sorted(others, key=lambda n: (n.startswith(_OUTSIDE), n))
    given = {answer for found in counts.values() for answer in found}
    columns = [n for n in hidden if n in given or not n.startswith((_OUTSIDE, "nothing"))]
    columns += sorted(given - set(columns) - set(_VERDICTS)) + list(_VERDICTS)
    matrix = [[counts[name][answer] for answer in columns] for name in hidden]
    right = [[answer == _right(name) for answer in columns] for name in hidden]
    return (
        arrays(
            count=(("hidden", "answer"), matrix, "1"),
            right=(("hidden", "answer"), right, "1"),
        )
        .assign_coords(hidden=hidden, answer=columns)
        .assign_attrs(pairs=pairs, both_named=both)
    )


def _right(hidden: str) -> str:
    if hidden.startswith(_OUTSIDE):
        return "unexplained"
    return "nothing_missing" if hidden.startswith("nothing") else hidden


def draw(shown: xr.Dataset) -> Figure:
    """A row for what was hidden, a column for what was answered; the right answer framed."""
    count, right = shown["count"].values, shown["right"].values.astype(bool)
    rows, columns = count.shape
    hidden, answers = ([_label(str(n)) for n in shown[k].values] for k in ("hidden", "answer"))
    left, top = (0.4 + _LETTER_IN * max(map(len, names)) for names in (hidden, answers))
    height = 0.1 + _ROW_IN * rows + top
    figure = new_figure(DOUBLE_COLUMN_IN, height)
    panel = figure.add_subplot(grid(figure, 1, 1, left=left, top=top, bottom=0.1)[0, 0])
    total = count.sum(axis=1, keepdims=True)
    panel.imshow(count / np.maximum(total, 1), cmap="Greys", vmin=0.0, vmax=1.3, aspect="auto")
    for row, column in np.argwhere((count > 0) | right):
        if right[row, column]:
            panel.add_patch(
                Rectangle((column - 0.5, row - 0.5), 1.0, 1.0, fill=False, linewidth=1.2,
                          edgecolor="#d55e00", zorder=3.0, clip_on=False)
            )  # fmt: skip
        if count[row, column]:
            share = count[row, column] / total[row, 0]
            panel.text(
                column, row, f"{count[row, column]}", ha="center", va="center_baseline",
                color="white" if share > 0.6 else "black",
            )  # fmt: skip
    panel.set_yticks(range(rows), hidden)
    panel.set_xticks(range(columns), answers, rotation=90)
    panel.set_xticks(np.arange(columns - 1) + 0.5, minor=True)
    panel.set_yticks(np.arange(rows - 1) + 0.5, minor=True)
    panel.grid(which="minor", color="#dcdcdc", linewidth=0.4)
    panel.tick_params(which="both", length=0.0, top=False, labeltop=True, labelbottom=False)
    panel.set_ylabel("Hidden")
    panel.set_xlabel("Named first")
    panel.xaxis.set_label_position("top")
    for spine in panel.spines.values():
        spine.set_visible(True)
    return figure


def _label(name: str) -> str:
    parts = name.removeprefix(_OUTSIDE).split(" + ")
    told = " + ".join(in_words(part) for part in parts)
    return f"{told} (no effect)" if name.startswith(_OUTSIDE) else told


def caption(shown: xr.Dataset) -> str:
    """What is seen, with how many were right."""
    count, right = shown["count"].values, shown["right"].values.astype(bool)
    names, answers = shown["hidden"].values, shown["answer"].values
    single = [i for i, name in enumerate(names) if _right(str(name)) == name]
    wrong = [
        f"{count[i, k]} × {_label(str(names[i]))}: {_label(str(answers[k]))}"
        for i, k in np.argwhere((count > 0) & ~right)
    ]
    told = (
        "What was hidden in simulated recordings (rows) and what the diagnosis named first "
        "(columns); how often, shaded by its share of the row; the right answer framed. Effects "
        "and parameters were named correctly in "
        f"{int(count[single][right[single]].sum())} of {int(count[single].sum())} datasets. All "
        f"other answers: {'; '.join(wrong) or 'none'}."
    )
    if shown.attrs["pairs"]:
        told += (
            f" Of {shown.attrs['pairs']} datasets with two effects, not shown, "
            f"{shown.attrs['both_named']} had both named."
        )
    return told


FIGURE = PaperFigure("confusion", data, draw, caption)

if __name__ == "__main__":
    sys.exit(main(FIGURE))
