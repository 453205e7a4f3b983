"""Optima of an earlier result, to start a search from."""

from __future__ import annotations

import json
from pathlib import Path

from bayesbl.errors import ResultError
from bayesbl.results.store import read_tree, texts
from bayesbl.ringing.symbols import SYMBOLS
from bayesbl.ringing.warm_start import EarlierOptimum

KINDS = ("fit", "compare")


def read_earlier(path: str | Path) -> dict[str, EarlierOptimum]:
    """Optima of a fit or a comparison by the names of their recordings, in order.

    Raises
    ------
    ResultError
        If the result cannot be read, or is of another kind.
    """
    tree = read_tree(path)
    kind = tree.attrs.get("kind")
    if kind not in KINDS:
        raise ResultError(
            "This result holds no optimum to start from.",
            file=path,
            found=f'kind = "{kind}"',
            expected="the result of bayesbl fit or bayesbl compare",
        )
    optimum = tree["optimum"].to_dataset()
    verdicts = json.loads(tree["diagnostics"].attrs["verdicts"])
    if kind == "compare":
        parts = {str(n): optimum.sel(snapshot=n) for n in optimum["snapshot"].values}
    else:
        (name,) = texts(tree.attrs["recordings"])
        parts, verdicts = {name: optimum}, {name: verdicts["fit"]}
    return {
        name: EarlierOptimum(
            f'the optimum of "{name}" in {path}',
            {symbol: float(part[symbol]) for symbol in SYMBOLS},
            float(part["rmse_rpm"]),
            withheld=verdicts[name]["outcome"] == "withheld",
        )
        for name, part in parts.items()
    }
