"""``kind = "simulate"``: write simulated recordings as CSV files, and the truth."""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from bayesbl import __version__
from bayesbl.bench.bench import Bench
from bayesbl.bench.motion import Motion, cycle, sine, torque_ramps
from bayesbl.config.bench import dump_bench
from bayesbl.config.kinds import MotionSection, SimulatedRecording, SimulateFile
from bayesbl.config.loading import load_file
from bayesbl.errors import BenchError, ConfigError, ResultError
from bayesbl.processes import in_threads
from bayesbl.recording.types import TIME, Recording
from bayesbl.results.folder import replacing, require_apart, require_inside, require_replaceable
from bayesbl.results.identified import bench_from
from bayesbl.runs.workflow import Plan, require_affordable, require_writable

BYTES_PER_SAMPLE = 400.0  # memory for a simulated sample: its channels, and all of them as text
SECONDS_PER_SAMPLE, SECONDS_PER_SECOND = 5e-6, 1e-4  # to write a sample, to integrate a second


def run_simulate(
    config_path: str | Path,
    out: str | Path | None = None,
    seed: int | None = None,
    workers: int | None = None,
    *,
    force: bool = False,
) -> list[Path]:
    """Simulate every recording of a simulate file and write it as CSV; return the files, the truth
    last.

    ``out`` is by default ``[run] output``, or else the configuration's folder; ``seed`` and
    ``workers`` replace those of ``[run]``, and workers do not change the numbers; ``force``
    replaces files. Raises ConfigError if the simulate file or its bench is wrong, and ResultError
    if a file exists, is an input, or a relative path leads out of the folder.
    """
    config_path = Path(config_path)
    config = load_file(Path(config_path), SimulateFile)
    bench = bench_from(config.bench)
    targets = _targets(config, config_path, out)
    _require_possible(config, config_path, bench)
    seed = config.run.seed if seed is None else seed
    workers = config.run.workers if workers is None else workers
    refuse_existing(targets, force)

    # A generator of its own for each recording: neither order nor workers change the numbers.
    seeds = np.random.SeedSequence(seed).spawn(len(config.recordings))
    recordings = in_threads(
        lambda i: _simulated(bench, config.recordings[i], seeds[i], config_path, i),
        range(len(config.recordings)),
        workers,
    )
    contents = [recording_csv(recording) for recording in recordings]
    if config.truth_file is not None:
        contents.append(_truth(bench, seed, config.recordings, recordings, contents))
    write_all(targets, contents)
    return targets


def describe(path: Path, plan: Plan) -> None:
    """Which recordings would be made, on which bench."""
    config = load_file(Path(path), SimulateFile)
    plan.add("bench", lambda: f"{config.bench}, gap form {bench_from(config.bench).gap_form}")
    plan.add("output", lambda: str(_targets(config, path)[0].parent))
    plan.add("size", lambda: _require_possible(config, path, bench_from(config.bench)))
    for entry in config.recordings:
        length = f"{entry.rotations:g} rotations"
        if entry.motion is not None:
            length = f"{entry.motion.kind} for {entry.motion.duration_s:g} s"
        text = f"{entry.file}, gap {entry.gap_rad:g} rad, {length}"
        plan.lines.append((f"recording {entry.name}", text))


def _targets(config: SimulateFile, config_path: Path, out: str | Path | None = None) -> list[Path]:
    """The files to write, the truth last, after checking that all can be written."""
    folder = Path(out or config.run.output or config_path.absolute().parent)
    names = [entry.file for entry in config.recordings]
    if config.truth_file is not None:
        names.append(config.truth_file)
    targets = [require_inside(folder, name) for name in names]
    require_apart(targets, [config_path, config.bench])
    for target in targets:
        require_replaceable(target)
    for parent in dict.fromkeys(target.absolute().parent for target in targets):
        try:
            require_writable(parent)
        except ResultError as problem:
            if out is not None:
                raise
            raise problem.at(ResultError, str(parent), config_path) from None
    return targets


def _require_possible(config: SimulateFile, config_path: Path, bench: Bench) -> None:
    """Require that all recordings fit into memory at once, and none is too short."""
    turned_s = [
        entry.rotations * bench.rotation_period_s(entry.reference_speed_rpm)
        if entry.motion is None
        else entry.motion.duration_s
        for entry in config.recordings
    ]
    pairs = zip(turned_s, config.recordings, strict=True)
    samples = sum(seconds * entry.sampling_hz for seconds, entry in pairs)
    require_affordable(
        "The simulation",
        "fewer rotations, or a lower sampling_hz under [[recordings]]",
        BYTES_PER_SAMPLE * samples,
        SECONDS_PER_SAMPLE * samples + SECONDS_PER_SECOND * sum(turned_s),
    )
    for number, entry in enumerate(config.recordings):
        if entry.motion is not None:
            continue
        with _of_entry(config_path, number):
            bench.samples(entry.rotations, entry.sampling_hz, entry.reference_speed_rpm)


def recording_csv(recording: Recording) -> str:
    """A recording as CSV with its channel names, ten significant digits."""
    names = (TIME, *recording.channels)
    table = np.column_stack([recording.time_s, *recording.channels.values()])
    text = io.StringIO()
    np.savetxt(text, table, fmt="%.10g", delimiter=",", header=",".join(names), comments="")
    return text.getvalue()


def _simulated(
    bench: Bench,
    entry: SimulatedRecording,
    seed: np.random.SeedSequence,
    config_path: Path,
    number: int,
) -> Recording:
    rng = np.random.default_rng(seed)
    drawn = float(rng.uniform(0.0, 2.0 * np.pi))
    with _of_entry(config_path, number):
        moving, ratio = entry.motion, bench.value("gear_ratio")
        return bench.simulate(
            entry.gap_rad,
            None if moving is None else motion_of(moving, ratio),
            rotations=entry.rotations,
            sampling_hz=entry.sampling_hz,
            start_angle_rad=drawn if entry.start_angle_rad is None else entry.start_angle_rad,
            reference_speed_rpm=entry.reference_speed_rpm,
            motor_start_angle_rad=entry.motor_start_angle_rad,
            seed=rng,
            name=entry.name,
        )


def motion_of(section: MotionSection, gear_ratio: float) -> Motion:
    """The motion that a configuration describes, at the motor of a gear of this ratio."""
    settings = section.model_dump(exclude={"kind"})
    if section.kind == "torque_ramp":
        return torque_ramps(**settings)
    if section.kind == "sine":
        return sine(gear_ratio, **settings)
    points_rad = settings.pop("range_rad" if section.kind == "strokes" else "points_rad")
    return cycle(gear_ratio, points_rad, **settings)


@contextmanager
def _of_entry(config_path: Path, number: int) -> Iterator[None]:
    """Turn what a bench cannot do into an error of the entry that asks for it."""
    try:
        yield
    except BenchError as error:
        raise error.at(ConfigError, f"[[recordings]] {number + 1} ", config_path) from None


def refuse_existing(targets: Sequence[Path], force: bool) -> None:
    """Require that these files do not exist, unless ``force``. Raises ResultError with the file."""
    for target in targets:
        if target.exists() and not force:
            raise ResultError(
                "This file exists already.",
                file=target,
                expected="another name, another folder, or --force to replace it",
            )


def _truth(
    bench: Bench,
    seed: int,
    entries: Sequence[SimulatedRecording],
    recordings: Sequence[Recording],
    contents: Sequence[str],
) -> str:
    """What was simulated, with the hashes of the files."""
    sealed: dict[str, Any] = {
        "version": __version__,
        "seed": seed,
        "bench": dump_bench(bench),
        "bench_fingerprint": bench.fingerprint(),
        "recordings": [
            {
                "name": entry.name,
                "file": entry.file,
                "sha256": hashlib.sha256(content.encode()).hexdigest(),
                "gap_rad": recording.metadata["gap_rad"],
                "start_angle_rad": recording.metadata["start_angle_rad"],
                "motor_start_angle_rad": entry.motor_start_angle_rad,
                "reference_speed_rpm": recording.metadata["reference_speed_rpm"],
                "rotations": entry.rotations if entry.motion is None else None,
                "motion": entry.motion and entry.motion.model_dump(),
                "sampling_hz": entry.sampling_hz,
            }
            for entry, recording, content in zip(entries, recordings, contents, strict=True)
        ],
    }
    return json.dumps(sealed, indent=2, ensure_ascii=False) + "\n"


def write_all(targets: Sequence[Path], contents: Sequence[str]) -> None:
    """Write all files or none. Raises ResultError if one cannot be written."""
    try:
        with ExitStack() as stack:
            for target, content in zip(targets, contents, strict=True):
                temporary = stack.enter_context(replacing(target))
                temporary.write_text(content, encoding="utf-8", newline="\n")
    except OSError as error:
        raise ResultError(
            "The files cannot be written.", file=error.filename, found=error.strerror
        ) from None
