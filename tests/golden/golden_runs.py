"""The runs whose numbers are kept, and how a run's numbers are read from its output folder.

Only what users rely on is touched: the command line, ``summary.json``, variables of ``result.nc``
by their names. So the same file runs before and after the package is rebuilt inside.

What is read from a run stands in five sections, because a machine that rounds differently may
change them by different amounts:

``values``
    Numbers that no random walk enters: optimum, noise model, sweep rows, simulated samples.
``intervals``
    Median, low and high of what is answered.
``draws``
    Of each posterior variable the first and last five draws, mean and standard deviation.
``names``
    Verdict, named effects, kind of noise.
``chain``
    What hangs on every single draw: diagnostics, probabilities, outcomes.
"""

from __future__ import annotations

import csv
import json
import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np
import xarray as xr

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]
GOLDEN_FILE = HERE / "golden.json"
NUMERICAL_PACKAGES = ("numpy", "scipy", "numba", "emcee", "cma")
SECTIONS = ("values", "intervals", "draws", "names", "chain")

Numbers = dict[str, dict[str, Any]]
"""What a run gave: section, then name, then numbers or texts."""

DONE, WITHHELD = 0, 3
"""How a command ends that leaves a result."""
SAMPLES, THINNED = 8300, 4
"""Of the example recordings 8.3 s at 250 Hz are fitted: 2.3 rotations, a second of computing."""
ENDS = 5
"""Draws that are kept from either end of a posterior."""


@dataclass(frozen=True)
class Run:
    """A configuration of ``runs/``, the runs whose results it takes, and what is read from it."""

    read: Callable[[Path], Numbers]
    needs: tuple[str, ...] = ()


def origin_of_machine() -> dict[str, str]:
    """What decides how numbers are rounded: processor and numerical packages."""
    packages = {name: version(name) for name in NUMERICAL_PACKAGES}
    kernels = os.environ.get("OPENBLAS_CORETYPE", "of the processor")
    return {"cpu": _cpu(), "blas": kernels, "python": platform.python_version(), **packages}


def _cpu() -> str:
    """Model of the processor; virtual machines hide its name, so its numbers are told too."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return platform.processor() or platform.machine()
    first = text.split("\n\n", 1)[0].splitlines()
    told = {key.strip(): value.strip() for key, _, value in (line.partition(":") for line in first)}
    numbers = ", ".join(f"{k} {told.get(k, '?')}" for k in ("cpu family", "model", "stepping"))
    return f"{told.get('model name', platform.machine())} ({numbers})"


class Workshop:
    """A folder in which runs are made, each once, after the runs that it needs."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._found: dict[str, Numbers] = {}
        for source in (HERE / "runs").glob("*.toml"):
            text = source.read_text(encoding="utf-8")
            experiments = (REPOSITORY / "experiments").as_posix()
            (folder / source.name).write_text(text.replace("EXPERIMENTS", experiments), "utf-8")
        _cut_examples(folder)
        _write_axis(folder / "axis_first.csv", seed=70)
        _write_axis(folder / "axis_second.csv", seed=71)
        for seed, (name, start_rad) in enumerate(
            (("swing_small", 0.4), ("swing_large", -0.7), ("swing_check", 1.0))
        ):
            _write_swing(folder / f"{name}.csv", start_rad, seed)

    def numbers(self, name: str) -> Numbers:
        """What this run gives."""
        if name not in self._found:
            for needed in RUNS[name].needs:
                self.numbers(needed)
            ended = command("run", str(self.folder / f"{name}.toml"))
            if ended not in (DONE, WITHHELD):
                raise RuntimeError(f"The run {name} ended with status {ended}.")
            found = RUNS[name].read(self.folder / "out" / name)
            found["chain"]["exit_status"] = ended
            self._found[name] = found
        return self._found[name]


def _save_nothing(_: object, file: object, **__: object) -> None:
    if isinstance(file, Path):
        file.touch()


def command(*arguments: str) -> int:
    """Exit status of the installed command with these arguments, run in this process.

    Figures are not saved: drawing takes longer than the small runs and changes no number.
    """
    from bayesbl.cli import main

    with (
        mock.patch.object(sys, "argv", ["bayesbl", *arguments]),
        mock.patch.dict(os.environ),
        mock.patch("matplotlib.figure.Figure.savefig", _save_nothing),
    ):
        try:
            main()
        except SystemExit as end:
            return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0


# Recordings that the package has no part in; written with few digits, so that a sine which another
# processor rounds differently leaves the same files.


def _cut_examples(folder: Path) -> None:
    """The example recordings, short and thinned; they carry the package's own impacts."""
    for name in ("before", "after"):
        source = REPOSITORY / "configs" / "recordings" / f"wear_{name}.csv"
        lines = source.read_text().splitlines(keepends=True)
        (folder / f"{name}.csv").write_text(lines[0] + "".join(lines[1 : SAMPLES + 1 : THINNED]))


def _write_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, "%.8g", ",", header=",".join(columns), comments="")


def _write_axis(path: Path, seed: int) -> None:
    """A rigid axis swept to and fro: Coulomb friction of 0.5 N m, ripple of order 4 of 0.3 N m."""
    rng = np.random.default_rng(seed)
    time = np.arange(1500) / 250.0
    angle, speed, acceleration = (np.zeros_like(time) for _ in range(3))
    for cycles, size in ((0.13, 60.0), (0.31, 30.0), (0.73, 6.0)):
        w = 2.0 * np.pi * cycles * rng.uniform(0.9, 1.1)
        phase = rng.uniform(0.0, 2.0 * np.pi)
        angle += size * np.sin(w * time + phase)
        speed += size * w * np.cos(w * time + phase)
        acceleration -= size * w**2 * np.sin(w * time + phase)
    torque = (2e-3 + 60.0 / 100.0**2) * acceleration + 3.0 * np.sin(angle / 100.0)
    torque += 0.5 * np.sign(speed) + 0.3 * np.sin(4.0 * angle + 0.7)
    torque += 0.1 * rng.standard_normal(time.size)
    columns = {
        "time_s": time,
        "motor_position_rad": angle + 1e-4 * rng.standard_normal(time.size),
        "motor_speed_rpm": speed * 30.0 / np.pi,
        "motor_torque_nm": torque,
    }
    _write_columns(path, columns)


def _write_swing(path: Path, start_rad: float, seed: int) -> None:
    """A pendulum let go, with Coulomb and viscous friction, by Runge-Kutta steps of 0.2 ms."""

    def slope(state: np.ndarray) -> np.ndarray:
        angle, speed = state
        friction = 0.012 * np.tanh(speed / 0.02) + 3e-3 * speed
        return np.array([speed, (-0.5 * np.sin(angle) - friction) / 6e-3])

    steps, step_s = 17, 1.0 / (200.0 * 17)
    state, angles = np.array([start_rad, 0.0]), []
    for _ in range(500):
        angles.append(state[0])
        for _ in range(steps):
            k1 = slope(state)
            k2 = slope(state + 0.5 * step_s * k1)
            k3 = slope(state + 0.5 * step_s * k2)
            k4 = slope(state + step_s * k3)
            state = state + step_s / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    noise = 1e-3 * np.random.default_rng(seed).standard_normal(len(angles))
    time = np.arange(len(angles)) / 200.0
    _write_columns(path, {"time_s": time, "motor_position_rad": np.array(angles) + noise})


# What is read from an output folder.


def _empty() -> Numbers:
    return {section: {} for section in SECTIONS}


def _summary(output: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((output / "summary.json").read_text(encoding="utf-8"))
    return found


def _groups(output: Path) -> Iterator[tuple[str, xr.Dataset]]:
    """The groups of a result by their path, the parents first, each in the order of its name."""
    with xr.open_datatree(output / "result.nc", engine="netcdf4") as tree:
        for node in sorted(tree.subtree, key=lambda node: node.path):
            yield node.path, node.to_dataset(inherit=False)


def _posterior(output: Path) -> xr.Dataset:
    """Of the route that answers, or of a diagnosis."""
    route = _summary(output).get("route") or _summary(output).get("answer", {}).get("route")
    wanted = f"/{route}/posterior" if route else "/posterior"
    return next(group for path, group in _groups(output) if path == wanted)


def _numbers(value: object) -> list[float | None]:
    """Flat, as JSON can hold them: ``None`` where there is no number."""
    array = np.atleast_1d(np.asarray(value, dtype=float)).ravel()
    return [float(x) if np.isfinite(x) else None for x in array]


def _shortened(value: object) -> dict[str, Any]:
    """A long row: its ends, mean and standard deviation."""
    array = np.asarray(value, dtype=float).ravel()
    return {
        "first": _numbers(array[:ENDS]),
        "last": _numbers(array[-ENDS:]),
        "mean": _numbers([array.mean()])[0],
        "sd": _numbers([array.std()])[0],
    }


def _put(found: Numbers, name: str, value: object) -> None:
    """A part of a summary into the section that it belongs to, its keys joined by full stops."""
    if isinstance(value, Mapping) and {"median", "low", "high"} <= value.keys():
        found["intervals"][name] = _numbers([value["median"], value["low"], value["high"]])
        found["names"]["interval"] = f"{value['kind']} {value['level']}"
    elif isinstance(value, Mapping):
        for key, part in value.items():
            _put(found, f"{name}.{key}", part)
    elif isinstance(value, list) and any(isinstance(part, Mapping) for part in value):
        for number, part in enumerate(value):
            _put(found, f"{name}.{number}", part)
    elif isinstance(value, bool | int | float) or _is_row(value):
        found["values"][name] = _numbers(value)
    else:
        found["names"][name] = value


def _is_row(value: object) -> bool:
    return isinstance(value, list) and bool(value) and isinstance(value[0], int | float | list)


def _put_in_chain(found: Numbers, name: str, value: object) -> None:
    """The same for what every single draw decides; sentences are not held, they may be reworded."""
    if isinstance(value, Mapping):
        for key, part in value.items():
            if key not in ("reason", "reasons", "warnings", "notes"):
                _put_in_chain(found, f"{name}.{key}", part)
    elif isinstance(value, list):
        for number, part in enumerate(value):
            _put_in_chain(found, f"{name}.{number}", part)
    else:
        found["chain"][name] = value


def _put_snapshot(found: Numbers, part: Mapping[str, Any], name: str) -> None:
    for key in ("delta_rad", "amplitude_rpm", "parameters", "optimum", "noise", "cramer_rao_sd"):
        if key in part:
            _put(found, f"{name}.{key}", part[key])
    if part["route"] == "direct":
        by_amplitude = part["routes"]["amplitude"]["delta_rad"]
        _put(found, f"{name}.amplitude_route.delta_rad", by_amplitude)
    for key in ("budget", "diagnostics", "probability_above_limit", "predictive_check"):
        if key in part:
            _put_in_chain(found, f"{name}.{key}", part[key])


def _put_draws(found: Numbers, output: Path) -> None:
    """Of every posterior variable, a row for each snapshot.

    Variables that belong to one recording of a diagnosis are left out: their names are not part
    of what users rely on.
    """
    for name, variable in _posterior(output).data_vars.items():
        if "(" in str(name):
            continue
        if "snapshot" in variable.dims:
            for snapshot in variable["snapshot"].values:
                draws = variable.sel(snapshot=snapshot)
                found["draws"][f"{snapshot}.{name}"] = _shortened(draws.values)
        else:
            found["draws"][str(name)] = _shortened(variable.values)


def _put_beside(found: Numbers, summary: Mapping[str, Any], output: Path) -> None:
    """Draws of a route beside the answer: it is stored as whole as the answer."""
    for route in summary.get("routes", {}):
        if route != summary.get("answer", {}).get("route"):
            names = {path for path, _ in _groups(output)}
            found["names"][f"{route} is whole"] = {
                f"/{route}/{group}" for group in ("posterior", "optimum", "noise", "budget")
            } <= names


def read_fit(output: Path) -> Numbers:
    """One recording."""
    found = _empty()
    _put_snapshot(found, _summary(output), "fit")
    _put_draws(found, output)
    return found


def read_compare(output: Path) -> Numbers:
    """Snapshots and what lies between them."""
    found = _empty()
    summary = _summary(output)
    for part in summary["snapshots"]:
        _put_snapshot(found, part, part["name"])
    _put(found, "change_rad", summary["change_rad"])
    for step in summary["changes"]:
        name = f"from {step['from']} to {step['to']}"
        _put(found, f"{name}.change_rad", step["change_rad"])
        _put_in_chain(found, f"{name}.probability_increase", step["probability_increase"])
    for key in ("probability_increase", "wear", "outcome"):
        if summary.get(key) is not None:
            _put_in_chain(found, key, summary[key])
    _put_draws(found, output)
    _put_beside(found, summary, output)
    return found


def read_sweep(output: Path) -> Numbers:
    """Every row of the sweep, the curve through them, and the benches that were drawn."""
    found = _empty()
    wanted = {
        "amplitude_rpm",
        "angular_frequency_rad_per_s",
        "coefficients",
        "decay_rate_per_s",
        "departure",
        "gap_rad",
        "rmse_rpm",
        "shift",
        "start_angle_rad",
    }
    # The examples for the figures have gaps of their own.
    for _, group in _groups(output):
        for name in sorted(wanted & {str(key) for key in group.data_vars}):
            if "example" not in group[name].dims:
                found["values"][name] = _numbers(group[name].values)
    degrees = _summary(output)["degrees"].values()
    found["values"]["log_evidence"] = [float(fit["log_evidence"]) for fit in degrees]
    return found


def read_simulate(output: Path) -> Numbers:
    """The samples of every recording, and the truth that was drawn for it."""
    found = _empty()
    for path in sorted(output.glob("*.csv")):
        with path.open(newline="") as file:
            rows = list(csv.reader(file))
        table = np.array(rows[1:], dtype=float)
        for name, column in zip(rows[0], table.T, strict=True):
            for key, numbers in _shortened(column).items():
                found["values"][f"{path.stem}.{name}.{key}"] = _numbers(numbers)
        found["values"][f"{path.stem}.samples"] = [len(table)]
    truth = json.loads((output / "truth.json").read_text(encoding="utf-8"))
    for recording in truth["recordings"]:
        found["values"][f"{recording['name']}.start_angle_rad"] = _numbers(
            recording["start_angle_rad"]
        )
        # The whole file: elsewhere one last digit may be another.
        found["chain"][f"{recording['name']}.sha256"] = recording["sha256"]
    return found


def read_forward(output: Path) -> Numbers:
    """What is missing in a bench, with the posterior of its size and of the gap."""
    found = _read_diagnosis(output)
    summary = _summary(output)
    for key in ("delta_rad_before", "delta_rad_after"):
        _put(found, key, summary[key])
    _put_disagreement(found, summary, ("before", "after", "noise_floor", "closed_fraction"))
    _put_draws(found, output)
    return found


def read_rigid(output: Path) -> Numbers:
    """What is missing in a rigid bench; its noise floor is to be defined anew and not held."""
    found = _read_diagnosis(output)
    _put_disagreement(found, _summary(output), ("before", "after"))
    return found


def _read_diagnosis(output: Path) -> Numbers:
    found = _empty()
    summary = _summary(output)
    found["names"]["verdict"] = summary["verdict"]
    for effect in summary["effects"]:
        found["names"][f"{effect['name']}.indistinguishable_from"] = effect[
            "indistinguishable_from"
        ]
        _put(found, f"{effect['name']}", effect["parameters"])
        _put_in_chain(found, f"{effect['name']}.probability", effect["probability"])
    found["names"]["effects"] = [effect["name"] for effect in summary["effects"]]
    found["names"]["parameter_errors"] = [error["name"] for error in summary["parameter_errors"]]
    found["names"]["remaining"] = [line["channel"] for line in summary["remaining"]]
    return found


def _put_disagreement(found: Numbers, summary: Mapping[str, Any], keys: tuple[str, ...]) -> None:
    """Over all recordings; the key was ``gap`` before it was ``disagreement``."""
    table = summary.get("disagreement", summary.get("gap"))
    for use, part in table["over_all"].items():
        for key in keys:
            found["values"][f"disagreement.{use}.{key}"] = _numbers(part[key])


def read_identify(output: Path) -> Numbers:
    """Values of the bench and gaps, and what else would tell more."""
    found = _empty()
    summary = _summary(output)
    found["names"]["verdict"] = summary["verdict"]
    for name, parameter in summary["parameters"].items():
        _put(found, name, parameter["posterior"])
    for name, gap in summary["gaps"].items():
        _put(found, f"{name}.delta_rad", gap)
    _put_in_chain(found, "suggested_recording", summary["suggested_recording"])
    return found


def read_study(output: Path) -> Numbers:
    """Every case of every row: truth, rank, error and sd."""
    found = _empty()
    for _, group in _groups(output):
        row = group.attrs.get("name")
        for name in sorted(str(key) for key in group.data_vars):
            if group[name].dtype.kind in "fib" and not name.endswith("seconds"):
                _put_in_chain(found, f"{row}.{name}", _numbers(group[name].values))
    return found


RUNS: dict[str, Run] = {
    "fit_published": Run(read_fit),
    "fit_choices": Run(read_fit),
    "fit_started": Run(read_fit, ("fit_published",)),
    "compare_published": Run(read_compare),
    "sweep": Run(read_sweep),
    "sweep_draws": Run(read_sweep),
    "compare_swept": Run(read_compare, ("sweep",)),
    "compare_draws": Run(read_compare, ("sweep_draws",)),
    "simulate_wear": Run(read_simulate),
    "compare_dates": Run(read_compare, ("sweep", "simulate_wear")),
    "direct": Run(read_compare),
    "direct_effect": Run(read_compare),
    "simulate_hidden": Run(read_simulate),
    "diagnose_forward": Run(read_forward, ("simulate_hidden",)),
    "identify": Run(read_identify, ("simulate_hidden",)),
    "diagnose_inverse": Run(read_rigid),
    "diagnose_free_motion": Run(read_rigid),
    "study": Run(read_study, ("sweep",)),
}


def today() -> str:
    """The date, for the origin."""
    return date.today().isoformat()
