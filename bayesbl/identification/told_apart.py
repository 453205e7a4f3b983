"""What recordings tell of parameters only together: ratios and products."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations
from typing import Literal

import numpy as np

from bayesbl.identification.summary import TogetherSummary
from bayesbl.recording.types import FloatArray

SHARPER = 0.5
"""Spread of a combination, as a share of that of its sharper member, below which it is reported.
It chooses words and no number."""


def not_told_apart(names: Sequence[str], draws: FloatArray) -> list[TogetherSummary]:
    """Groups known by their ratios, and pairs by their product.

    Parameters
    ----------
    draws
        Of all parameters, above zero, shape (n, k).
    """
    logarithms = np.log(draws)
    groups = list(_groups(logarithms))
    known_together = [
        _together(names, logarithms, group, "ratios", _largest(logarithms, group))
        for group in groups
    ]
    for i, j in combinations(range(len(names)), 2):
        if any(i in group and j in group for group in groups):
            continue
        product = float((logarithms[:, i] + logarithms[:, j]).std())
        if product < SHARPER * min(logarithms[:, i].std(), logarithms[:, j].std()):
            known_together.append(_together(names, logarithms, (i, j), "product", product))
    return known_together


def _together(
    names: Sequence[str],
    logarithms: FloatArray,
    group: Sequence[int],
    told: Literal["ratios", "product"],
    sd: float,
) -> TogetherSummary:
    alone = max(float(logarithms[:, i].std()) for i in group)
    return {
        "parameters": [names[i] for i in group],
        "told": told,
        "alone_sd": alone,
        "together_sd": sd,
    }


def _groups(logarithms: FloatArray) -> Iterator[tuple[int, ...]]:
    """Each parameter with those that its ratio to is sharp, nearest first; each in one group."""
    spread = logarithms.std(axis=0)
    left = list(np.argsort(spread))
    while left:
        first = int(left.pop(0))
        members = [
            int(k)
            for k in left
            if (logarithms[:, k] - logarithms[:, first]).std()
            < SHARPER * min(spread[k], spread[first])
        ]
        if members:
            left = [k for k in left if k not in members]
            yield tuple(sorted((first, *members)))


def _largest(logarithms: FloatArray, group: Sequence[int]) -> float:
    """Standard deviation of the least known ratio within a group."""
    return max(
        float((logarithms[:, i] - logarithms[:, j]).std()) for i, j in combinations(group, 2)
    )
