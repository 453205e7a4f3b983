"""How long the steps from recording to answer take.

    python experiments/benchmark.py

Prints, for 18 s of the disturbance model at 1 kHz: one evaluation of the sum of squares by the
kernel and by the formula in plain NumPy, the search, the posterior, both once more from the optimum
of an earlier recording; then the whole ``bayesbl compare`` of the example recordings, ``bayesbl
fit`` with its peak memory, what it takes to read three hours of CSV, and ``bayesbl --help``, each
in a fresh process. Times are the best of several runs after a warm-up; for fresh processes, the
median. Core-seconds, the least of several runs, are what a process takes where nothing else runs;
those of imports say how fast the machine is.
"""

from __future__ import annotations

import math
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path

import numpy as np
from made_recordings import synthetic_recording

from bayesbl.config.bench import load_bench
from bayesbl.config.kinds import DiagnoseConfig
from bayesbl.config.loading import load_config
from bayesbl.diagnosis.closed_loop.diagnosis import forward_problem, search
from bayesbl.diagnosis.task import Task
from bayesbl.noise.process import NoiseModel
from bayesbl.recording.readers import read_recording
from bayesbl.recording.types import Recording
from bayesbl.ringing.estimator import Estimator
from bayesbl.ringing.objective import Objective
from bayesbl.ringing.optimum import EarlierOptimum, Optimum, find_optimum, warm_optimum
from bayesbl.ringing.posterior import sample_posterior
from bayesbl.ringing.symbols import (
    AMPLITUDE,
    DECAY,
    FREQUENCY,
    MEAN,
    ROTATION,
    SEPARATION,
    START,
    WINDOW_END,
    WINDOW_START,
    DisturbanceModel,
)
from bayesbl.ringing.waveform import model_speed
from bayesbl.sampling.chains import SamplerSettings

RECORDINGS = Path(__file__).parents[1] / "configs" / "recordings"
POPULATION = 1000
BATCHES = 7
TRUTH = {
    AMPLITUDE: 30.0,
    START: 1.3,
    DECAY: 12.0,
    FREQUENCY: 62.0,
    MEAN: 2000.0,
    WINDOW_START: 0.0,
    WINDOW_END: 0.204,
    SEPARATION: 1.7,
    ROTATION: 3.6,
}
PROGRAM = str(Path(sys.executable).with_name("bayesbl"))
IMPORTED = ("numpy", "scipy", "matplotlib", "xarray", "numba")
PARTS = ("numpy", "scipy", "numba", "cma", "emcee", "bayesbl")


def main() -> None:
    print(f"{processor()}, Python {platform.python_version()}, " + versions())
    print(f"load when started: {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores\n")
    for harmonics in (0, 1):
        kernel, plain = evaluation_seconds(harmonics)
        baseline = "with baseline" if harmonics else "without baseline"
        show(f"kernel, one evaluation, {baseline}", 1e6 * kernel, "µs")
        show(f"plain NumPy, one evaluation, {baseline}", 1e3 * plain, "ms")
        show("  ratio, at least 1000", plain / kernel, "")
    search, posterior = fit_seconds()
    show("search, at most 1 s", search, "s")
    show("posterior, four ensembles until converged, at most 6 s", posterior, "s")
    search, posterior = warm_seconds()
    show("optimum from an earlier one, at most 50 ms", 1e3 * search, "ms")
    show("posterior around it, at most 2 s", posterior, "s")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        for told, options in (
            ("bayesbl fit, {}, at most 300 MB", ()),
            ("bayesbl fit without figures, {}, at most 250 MB", ("--no-figures",)),
        ):
            resident, own = fit_megabytes(place / f"fit{len(options)}", *options)
            show(told.format("peak memory"), resident, "MB")
            show(told.format("of it not pages of files"), own, "MB")
        compiling, _ = fit_megabytes(place / "first", NUMBA_CACHE_DIR=f"{folder}/compiled")
        show("bayesbl fit, peak memory of a first run, which compiles", compiling, "MB")
    with tempfile.TemporaryDirectory() as folder:
        for told, (seconds, megabytes) in reading_costs(Path(folder)).items():
            show(f"{told} 1e7 samples of four columns of CSV, at most 15 s", seconds, "core-s")
            show("  peak memory, at most 1000 MB", megabytes, "MB")
    imports = f"import {', '.join(IMPORTED)}"
    importing = core_seconds([sys.executable, "-c", imports])
    show(imports, importing, "core-s")
    with tempfile.TemporaryDirectory() as folder:
        readme = ["run", str(RECORDINGS.parent / "wear_snapshots.toml"), "--force", "--out", folder]
        process_seconds(readme, 1)
        taken = core_seconds([PROGRAM, *readme], 3)
        show("bayesbl run configs/wear_snapshots.toml, both routes, figures", taken, "core-s")
        show("  over these imports, at most 8", taken / importing, "")
    with tempfile.TemporaryDirectory() as folder:
        for told, options in (
            ("bayesbl compare, at most 5 s", ()),
            ("bayesbl compare without figures, at most 3 s", ("--no-figures",)),
        ):
            command = compare_command(Path(folder), *options)
            show(told, process_seconds(command, 3), "s")
            show("  of which a core worked", core_seconds([PROGRAM, *command]), "core-s")
    with tempfile.TemporaryDirectory() as folder:
        for name, told in (
            ("sweep", "of 40 gaps, at most 10 s"),
            ("sweep_tolerances", "with 50 bench draws, at most 300 s"),
        ):
            config = str(RECORDINGS.parent / f"{name}.toml")
            taken = process_seconds(["sweep", config, "--out", str(Path(folder) / name)], 1)
            show(f"bayesbl sweep {told}", taken, "s")
    with tempfile.TemporaryDirectory() as folder:
        for bench, told in (("bench", "bench known"), ("bench_tolerances", "seven tolerances")):
            show(f"direct fit, {told}, at most 60 s", direct_seconds(Path(folder), bench), "s")
    with tempfile.TemporaryDirectory() as folder:
        naming, whole = diagnose_seconds(Path(folder))
        show("locating and naming, three recordings, at most 20 s", naming, "s")
        show("bayesbl diagnose, posterior and figures too, at most 120 s", whole, "s")
    show("bayesbl --help, below 0.4 s", process_seconds(["--help"], 7), "s")


def recording(harmonics: int, seed: int = 1, **changes: float) -> Recording:
    """18 s at 1 kHz with AR(1) noise."""
    return synthetic_recording(
        {**TRUTH, **changes},
        NoiseModel(1.5, (0.6,)),
        np.random.default_rng(seed),
        baseline_rpm=(5.0, -3.0)[: 2 * harmonics],
    )


def evaluation_seconds(harmonics: int) -> tuple[float, float]:
    """Seconds of one sum of squares: by the kernel in populations, and by the plain formula.

    The formula takes all nine symbols and the baseline as given; the kernel solves the linear ones.
    """
    measured = recording(harmonics)
    objective = Objective(DisturbanceModel(harmonics), measured.time_s, measured.motor_speed_rpm)
    centre = np.array([TRUTH[name] for name in objective.searched])
    points = centre * (1.0 + 1e-3 * np.random.default_rng(2).standard_normal((POPULATION, 5)))
    kernel = best_seconds(lambda: objective.sum_of_squares(points)) / POPULATION

    def formula() -> float:
        model = model_speed(measured.time_s, TRUTH, (5.0, -3.0)[: 2 * harmonics])
        return float(np.sum((measured.motor_speed_rpm - model) ** 2))

    return kernel, best_seconds(formula)


def fit_seconds() -> tuple[float, float]:
    """Seconds of the search and of the sampling of one recording."""
    measured = recording(1)
    point = Estimator().estimate(measured, np.random.SeedSequence(1))

    def search() -> object:
        return find_optimum(point.objective, "guess", np.random.default_rng(1))

    def sample() -> object:
        return sample_posterior(point, SamplerSettings(), np.random.SeedSequence(1))

    return best_seconds(search, 3), best_seconds(sample, 3)


def warm_seconds() -> tuple[float, float]:
    """Seconds from a recording to its optimum, and of the sampling, a month after another one."""
    old = Estimator().estimate(recording(1), np.random.SeedSequence(1)).optimum
    earlier = EarlierOptimum("the old optimum", old.symbols, old.rmse_rpm)
    measured = recording(1, 2, **{AMPLITUDE: 36.0, START: 2.9})

    def search() -> Optimum:
        objective = Objective(old.model, measured.time_s, measured.motor_speed_rpm)
        return warm_optimum(objective, earlier)

    objective = Objective(old.model, measured.time_s, measured.motor_speed_rpm)
    point = Estimator().around(measured, objective, search())

    def sample() -> object:
        return sample_posterior(point, SamplerSettings(), np.random.SeedSequence(1))

    return best_seconds(search), best_seconds(sample, 3)


def fit_megabytes(folder: Path, *options: str, **environment: str) -> tuple[float, float]:
    """Largest memory of ``bayesbl fit`` on an example recording, in MB (10⁶ bytes).

    Resident, and that part of it which is of no file; the latter is known on Linux only.
    """
    file = str(RECORDINGS / "wear_before.csv")
    arguments = [*options, "fit", file, "--out", str(folder / "fit")]
    own = math.nan
    with subprocess.Popen(
        [PROGRAM, *arguments], stdout=subprocess.DEVNULL, env={**os.environ, **environment}
    ) as process:
        while True:
            ended, status, usage = os.wait4(process.pid, os.WNOHANG)
            if ended:
                break
            own = float(np.fmax(own, _anonymous_megabytes(process.pid)))
            time.sleep(0.01)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"bayesbl fit ended with status {process.returncode}")
    unit = 1 if sys.platform == "darwin" else 1024
    return 1e-6 * unit * float(usage.ru_maxrss), own


READING = {
    "reading": "readers import read_recording as f; f('long.csv')",
    "guessing columns of": "guessing import guess_columns as g; "
    "from bayesbl.recording.readers import read_table as r; g('long.csv', r('long.csv'))",
}


def reading_costs(folder: Path) -> dict[str, tuple[float, float]]:
    """Core-seconds and peak memory in MB (10⁶ bytes) of a long recording, imports included."""
    head, *lines = (RECORDINGS / "wear_before.csv").read_text().splitlines()
    channels = [line.partition(",")[2] for line in lines]
    with (folder / "long.csv").open("w") as file:
        file.write(head + "\n")
        for begin in range(0, 10_000_000, len(lines)):
            file.writelines(f"{(begin + i) / 1e3:.3f},{x}\n" for i, x in enumerate(channels))
    costs = {}
    for told, program in READING.items():
        code = f"from bayesbl.recording.{program}"
        child = subprocess.Popen([sys.executable, "-c", code], cwd=folder)
        _, status, usage = os.wait4(child.pid, 0)
        child.returncode = os.waitstatus_to_exitcode(status)
        if child.returncode:
            raise RuntimeError(f"{told} ended with status {child.returncode}")
        unit = 1 if sys.platform == "darwin" else 1024
        costs[told] = usage.ru_utime + usage.ru_stime, 1e-6 * unit * float(usage.ru_maxrss)
    return costs


def _anonymous_megabytes(process: int) -> float:
    """Memory now that is of no file; not a number where the system does not tell."""
    try:
        status = Path(f"/proc/{process}/status").read_text()
    except OSError:
        return math.nan
    kilobytes = re.search(r"RssAnon:\s+(\d+)", status)
    return math.nan if kilobytes is None else 1.024e-3 * int(kilobytes[1])


def compare_command(folder: Path, *options: str) -> list[str]:
    """The main job on the example recordings; run once, so that it is compiled."""
    files = [str(RECORDINGS / f"wear_{name}.csv") for name in ("before", "after")]
    command = [*options, "compare", *files, "--force", "--out", str(folder / "compared")]
    process_seconds(command, 1)
    return command


def direct_seconds(folder: Path, bench: str) -> float:
    """Seconds of a fit by the direct route, amplitude route and figures included."""
    options = ["--route", "direct", "--bench", str(RECORDINGS.parent / f"{bench}.toml")]
    file = str(RECORDINGS / "wear_before.csv")
    return process_seconds(["fit", file, *options, "--out", str(folder / bench)], 1)


def diagnose_seconds(folder: Path) -> tuple[float, float]:
    """Seconds to name what is hidden in the example, the whole catalogue open, and of the command.

    Three recordings of five rotations; two threads, as its configuration says.
    """
    data, result = folder / "data", folder / "diagnosis"
    hidden = RECORDINGS.parent / "simulate_hidden_friction.toml"
    process_seconds(["simulate", str(hidden), "--out", str(data)], 1)
    text = (RECORDINGS.parent / "diagnose_hidden_friction.toml").read_text()
    text = text.replace('"../results/hidden_friction_data/', f'"{data}/')
    text = text.replace('"bench.toml"', f'"{RECORDINGS.parent / "bench.toml"}"')
    file = folder / "diagnose.toml"
    file.write_text(text)
    config = load_config(file)
    assert isinstance(config, DiagnoseConfig)
    recordings = [read_recording(e.file, name=e.name) for e in config.recordings]
    task = Task(config, load_bench(config.bench), tuple(recordings))
    used, held_out, unknowns, _ = forward_problem(task)

    def name() -> object:
        return search(load_bench(config.bench), used, held_out, unknowns, workers=2)

    naming = best_seconds(name, 1)
    return naming, process_seconds(["diagnose", str(file), "--out", str(result)], 1)


def best_seconds(run: Callable[[], object], batches: int = BATCHES) -> float:
    """The shortest of several runs after one to warm up."""
    run()
    times = []
    for _ in range(batches):
        begin = time.perf_counter()
        run()
        times.append(time.perf_counter() - begin)
    return min(times)


def process_seconds(arguments: list[str], repeats: int) -> float:
    """Median wall time of ``bayesbl`` in a fresh process."""
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        subprocess.run([PROGRAM, *arguments], check=True, capture_output=True)
        times.append(time.perf_counter() - begin)
    return statistics.median(times)


def core_seconds(command: list[str], repeats: int = 5) -> float:
    """Least core-seconds of a command in a fresh process."""
    taken = []
    for _ in range(repeats):
        before = os.times()
        subprocess.run(command, check=True, capture_output=True)
        after = os.times()
        user = after.children_user - before.children_user
        taken.append(user + after.children_system - before.children_system)
    return min(taken)


def processor() -> str:
    """Name of the processor, if the system gives it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.split(":")[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


def versions() -> str:
    """Versions of what the times depend on."""
    return ", ".join(f"{name} {version(name)}" for name in PARTS)


def show(what: str, value: float, unit: str) -> None:
    print(f"{what:58s} {value:10.3g} {unit}", flush=True)


if __name__ == "__main__":
    main()
