"""Write a measured joint for simulators: a MuJoCo model, and a table of its draws."""

from __future__ import annotations

import csv
import io
import tomllib
from pathlib import Path

import numpy as np
import xarray as xr

from bayesbl.bench.bench import Bench
from bayesbl.bench.effects import effect_named
from bayesbl.bench.kernel import Slot
from bayesbl.bench.mjcf import mjcf
from bayesbl.bench.parameters import BENCH_PARAMETERS, simulated_range
from bayesbl.errors import ResultError
from bayesbl.measurement.stored import stored_answers
from bayesbl.recording.types import FloatArray
from bayesbl.results.folder import require_inside
from bayesbl.results.identified import bench_from, require_gap
from bayesbl.runs.kinds import read_result
from bayesbl.runs.simulate import refuse_existing, write_all

GAP = Slot.gap_rad.name
DRIFT = "drift__"


def export(
    result: Path,
    bench: Path | None = None,
    folder: str | Path | None = None,
    *,
    force: bool = False,
) -> list[Path]:
    """Write ``SNAPSHOT.xml`` and ``SNAPSHOT.csv`` for every snapshot with a reported gap; return
    the files.

    The model has the medians. The table has a row for each draw, with gap and bench parameters;
    those that the recordings do not show are as in the bench. ``bench`` is by default that of the
    stored configuration, ``folder`` is ``RESULT_export`` beside the result; ``force`` replaces
    existing files. Raises ResultError if the result has no gap, belongs to another bench, or a file
    exists, and ConfigError if the bench cannot be used.
    """
    tree = read_result(result)
    if bench is None:
        config = tomllib.loads(tree.attrs.get("config", ""))
        named = config.get("estimator", {}).get("bench")
        if named is None or not Path(named).is_file():
            raise ResultError(
                "The bench of this result is not known.",
                file=result,
                found=f"no file {named}" if named else "no bench in its configuration",
                expected="--bench FILE, the bench that it was measured with",
            )
        bench = Path(named)
    own = bench_from(bench)
    require_gap(own, bench)
    measured = stored_answers(tree) if "route" in tree.attrs else []
    reported = [snapshot for snapshot in measured if not snapshot.withheld]
    if not reported:
        raise ResultError(
            "This result reports no gap.",
            file=result,
            found=f"{tree.attrs['kind']}, {tree.attrs.get('outcome')}",
            expected="the result of a fit or a comparison that is not withheld",
        )
    measured_with = tree.attrs.get("bench")
    if measured_with not in (None, own.fingerprint()):
        raise ResultError(
            "This result was measured with another bench.",
            file=bench,
            found=own.fingerprint(),
            expected=f"the bench of {result}, {measured_with}",
        )
    beside = (result if result.is_dir() else result.parent).absolute()
    home = Path(folder or beside.with_name(f"{beside.name}_export"))
    targets, contents = [], []
    for snapshot in reported:
        draws = _draws(snapshot.group("posterior"), own)
        medians = {slot: float(np.median(values)) for slot, values in draws.items()}
        targets += [require_inside(home, f"{snapshot.name}.{kind}") for kind in ("xml", "csv")]
        contents += [mjcf(own, medians.pop(GAP), medians), _table(draws)]
    refuse_existing(targets, force)
    home.mkdir(parents=True, exist_ok=True)
    write_all(targets, contents)
    return targets


def _draws(posterior: xr.Dataset, bench: Bench) -> dict[str, FloatArray]:
    """Draws by slot for one snapshot, shape (draw,)."""
    gap = posterior["delta_rad"].values.ravel()
    slots = [info.name for info in BENCH_PARAMETERS]
    for effect in (effect_named(present.name) for present in bench.effects):
        slots += [slot.name for slot in effect.slots.values()]
    # Nor is what the joint has beside its bench left out.
    slots += [slot for slot in Slot.__members__ if "__" in slot and slot in posterior]
    draws = {GAP: gap}
    for slot in dict.fromkeys(slots):
        values = np.full(gap.size, bench.value(slot))
        if slot in posterior:
            values = posterior[slot].values.ravel()
        if DRIFT + slot in posterior:
            drift = posterior[DRIFT + slot].values.ravel()
            values = np.clip(values + np.nan_to_num(drift), *simulated_range(slot))
        draws[slot] = values
    return draws


def _table(draws: dict[str, FloatArray]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(draws)
    writer.writerows(zip(*(values.tolist() for values in draws.values()), strict=True))
    return text.getvalue()
