"""What recordings tell of parameters only together: ratios and products."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Literal

import numpy as np

from bayesbl.identification.summary import TogetherSummary
from bayesbl.recording.types import FloatArray

SHARPER = 0.5
"""Spread of a combination, as a share of that of its sharper member, below which it is reported.
It chooses words and no number."""


def not_told_apart(names: Sequence[str], draws: FloatArray) -> list[TogetherSummary]:
    """Groups known by their ratios, each parameter in one of them; pairs by their product.

    Parameters
    ----------
    draws
        Of all parameters, above zero, shape (n, k).
    """
    logarithms = np.log(draws)
    alone = logarithms.std(axis=0)

    def sd(i: int, j: int, sign: float) -> float:
        return float((logarithms[:, i] + sign * logarithms[:, j]).std())

    def is_sharp(i: int, j: int, sign: float) -> bool:
        return sd(i, j, sign) < SHARPER * float(min(alone[i], alone[j]))

    told: list[tuple[Sequence[int], Literal["ratios", "product"], float]] = []
    left: list[int] = np.argsort(alone).tolist()
    while left:
        first, *left = left
        group = sorted([first, *(k for k in left if is_sharp(k, first, -1.0))])
        left = [k for k in left if k not in group]
        if len(group) > 1:
            told.append((group, "ratios", max(sd(*pair, -1.0) for pair in combinations(group, 2))))
    groups = [set(group) for group, *_ in told]
    for pair in combinations(range(len(names)), 2):
        if is_sharp(*pair, 1.0) and not any(group.issuperset(pair) for group in groups):
            told.append((pair, "product", sd(*pair, 1.0)))
    return [
        {
            "parameters": [names[i] for i in group],
            "told": how,
            "alone_sd": float(alone[list(group)].max()),
            "together_sd": together,
        }
        for group, how, together in told
    ]
