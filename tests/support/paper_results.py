"""The quick experiments behind the paper's figures, small enough for tests, and their goldens.

Goldens are made anew, after a change that is meant to move them, by

    python tests/support/paper_results.py
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from contextlib import chdir
from pathlib import Path

import numpy as np
import xarray as xr
from places import ROOT
from quick import without_figures

GOLDEN = Path(__file__).with_name("golden_paper_figures.json")
POINTS = 13
"""Of an array along each dimension that a golden keeps: first, last, and evenly between."""

SAMPLED = ("chain", "draw", "ringing_chain", "ringing_draw")
SAMPLED += ("draw_regression", "draw_lack_of_fit", "draw_bench")
"""Dimensions of random draws: their 5, 50 and 95 % quantiles are kept."""

SMALLER = {
    "sweep.toml": {"count = 40": "count = 16", "start_angles = 4": "start_angles = 2"},
    "sweep_tolerances.toml": {
        "count = 40": "count = 16",
        "start_angles = 4": "start_angles = 2",
        "bench_draws = 50": "bench_draws = 12",
    },
}
"""What the tests leave out of the configurations: nothing that changes what is learnt."""


def make(folder: Path) -> Path:
    """Run all quick experiments in a copy of ``configs``; the folder of their results."""
    from common import RESULTS

    from bayesbl import cli

    shutil.copytree(ROOT / "configs", folder / "configs")
    for path in (folder / "configs").glob("*.toml"):
        text = path.read_text(encoding="utf-8").replace("workers = 2", "workers = 1")
        for old, new in SMALLER.get(path.name, {}).items():
            assert text.count(old) == 1, f"{path.name} no longer says {old}"
            text = text.replace(old, new)
        path.write_text(text, encoding="utf-8")
    with chdir(folder), without_figures():
        for made in RESULTS.values():
            for config in made.configs:
                assert cli.status(["run", config]) == 0, config
    return folder / "results"


def described(shown: xr.Dataset | xr.DataTree) -> dict[str, dict[str, object]]:
    """Every array of a figure by its path: sizes, unit and some of its values in order."""
    if isinstance(shown, xr.Dataset):
        shown = xr.DataTree(shown)
    found = {}
    for node in shown.subtree:
        data = node.to_dataset(inherit=False)
        for name in sorted(map(str, data.variables)):
            variable = data[name].variable
            if variable.dtype.kind in "fiub" and name not in SAMPLED:
                path = f"{node.path.strip('/')}/{name}".strip("/")
                found[path] = {
                    "sizes": {str(k): v for k, v in variable.sizes.items()},
                    "units": variable.attrs.get("units", ""),
                    "values": _some(variable).ravel().tolist(),
                }
    return found


def _some(variable: xr.Variable) -> np.ndarray:
    draws = [d for d in variable.dims if d in SAMPLED]
    if draws and variable.size > POINTS:
        variable = variable.astype(float).quantile([0.05, 0.5, 0.95], draws)
    kept = {
        d: np.unique(np.linspace(0, n - 1, min(n, POINTS)).round().astype(int))
        for d, n in variable.sizes.items()
    }
    return np.asarray(variable.isel(kept).values, dtype=float)


def _main() -> None:
    sys.path.insert(0, str(ROOT / "paper_figures"))
    from common import Stored
    from make_all import FIGURES

    with tempfile.TemporaryDirectory() as folder:
        stored = Stored(make(Path(folder)))
        goldens = {f.name: described(f.data(stored)) for f in FIGURES if f.name not in FROM_TABLES}
    text = json.dumps(_rounded(goldens), indent=0, ensure_ascii=False)
    GOLDEN.write_text(text + "\n", encoding="utf-8")
    print(GOLDEN)


FROM_TABLES = ("calibration", "shared_estimator", "confusion", "wear_detection", "efficiency")
"""Figures of committed tables alone, which are held against the tables instead."""


def _rounded(content: object) -> object:
    """Eight significant digits, which is far below any tolerance; NaN as null."""
    if isinstance(content, dict):
        return {key: _rounded(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_rounded(value) for value in content]
    if isinstance(content, float):
        return None if np.isnan(content) else float(f"{content:.8g}")
    return content


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    _main()
