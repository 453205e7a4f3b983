"""The undamaged originals: recordings in every format, configurations, and a result of each kind.

Made once, in the process that the cases are forked from, so that all is imported and compiled.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from contextlib import chdir
from functools import cache
from pathlib import Path

import numpy as np

from attack.engine import DONE, WITHHELD, captured

REPOSITORY = Path(__file__).resolve().parents[2]
EXAMPLES = REPOSITORY / "configs" / "recordings"
BENCH = (REPOSITORY / "configs" / "bench.toml").read_text(encoding="utf-8")

SAMPLES, THINNED = 8300, 10
"""Of the example recordings 8.3 s at 100 Hz: 2.3 rotations, fitted in a second or two."""

TIME, SPEED = "time_s", "motor_speed_rpm"
POSITION, CURRENT = "motor_position_rad", "motor_current_a"
Table = Mapping[str, np.ndarray]

HEAD = 'schema = 1\nkind = "{kind}"\n[run]\nseed = 1\nworkers = 1\noutput = "result"\n'
SHORT = "[posterior]\nensembles = 2\nmax_steps = 1000\n"
JOINT = "[joint]\ngear_ratio = 120.0\nlimit_rad = 9e-4\n"
CURVE = '[curve]\nsource = "published"\n'
TWO = (
    '[[recordings]]\nfile = "before.csv"\ndate = 2025-03-01\n'
    '[[recordings]]\nfile = "after.csv"\ndate = 2026-03-01\n'
)
STUDY = """
import numpy as np
from pathlib import Path

def count(row):
    return row["cases"]

def run_case(row, index, seed):
    return {"value": float(np.random.default_rng(seed).normal())}

def summarise(row, cases):
    return {"mean": float(cases["value"].mean())}

def figure(table, cases):
    Path("study_file_was_run").touch()
    from matplotlib.figure import Figure
    figure = Figure()
    figure.subplots().plot([line["mean"] for line in table])
    return figure
"""

CONFIGURATIONS: Mapping[str, str] = {
    "fit": HEAD.format(kind="fit")
    + JOINT
    + CURVE
    + SHORT
    + '[[recordings]]\nfile = "before.csv"\n',
    "compare": HEAD.format(kind="compare") + JOINT + CURVE + SHORT + TWO,
    "direct": HEAD.format(kind="compare")
    + JOINT
    + SHORT
    + '[estimator]\nroute = "direct"\nbench = "bench.toml"\n'
    + TWO,
    "sweep": HEAD.format(kind="sweep").replace("[run]", 'bench = "bench.toml"\n[run]')
    + "[sweep]\ngap_rad = {low = 2e-4, high = 2e-3, count = 6}\nstart_angles = 2\n"
    "rotations = 2.3\nsampling_hz = 250\ndegree = 2\n",
    "diagnose": HEAD.format(kind="diagnose").replace("[run]", 'bench = "rigid.toml"\n[run]')
    + '[comparison]\nmethod = "inverse"\nload_angle_known = true\nmotor_angle_known = true\n'
    '[unknowns]\nbench_parameters = ["load_inertia_kg_m2"]\n[candidates]\nmax_effects = 1\n'
    '[[recordings]]\nname = "first"\nfile = "axis.csv"\nuse = "split"\n',
    "study": HEAD.format(kind="study").replace("[run]", 'study = "study.py"\n[run]')
    + '[[rows]]\nname = "one"\ncases = 3\n[[rows]]\nname = "two"\ncases = 2\n',
    "simulate": HEAD.format(kind="simulate")
    .replace("workers = 1\n", "")
    .replace("[run]", 'bench = "bench.toml"\ntruth_file = "truth.json"\n[run]')
    + '[[recordings]]\nname = "made"\nfile = "made.csv"\ngap_rad = 8e-4\nrotations = 2.2\n'
    "sampling_hz = 100\nstart_angle_rad = 0.5\n",
    "identify": HEAD.format(kind="identify").replace("[run]", 'bench = "datasheet.toml"\n[run]')
    + '[identify]\nparameters = ["gravity_torque_nm"]\n'
    + TWO.replace("date", "reference_speed_rpm = 2000.0\ndate"),
    "plan": HEAD.format(kind="plan").replace("[run]", 'bench = "bench.toml"\n[run]')
    + "[limits]\nrange_rad = [-0.5, 0.5]\nspeed_rpm = 600.0\nduration_s = 5.0\n",
    "ramps": HEAD.format(kind="compare")
    + '[joint]\ngear_ratio = 1.0\n[estimator]\nroute = "torque_ramp"\n'
    + TWO.replace("before", "ramp").replace("after", "ramp_later"),
    "fleet": HEAD.format(kind="fleet")
    + SHORT
    + '[fleet]\njoints = "joints.csv"\nrecordings = "data/{joint}/{date}.csv"\n'
    'pool_by = "gearbox"\ndecide_before = 2027-06-01\n',
    "bench": BENCH,
}
RESULTS = ("fit", "sweep", "study")
"""The originals, by the names of their configurations; each is made in a few seconds."""

RIGID = """schema = 1
kind = "bench"
drive = "rigid"
[parameters]
gear_ratio = {value = 100.0}
motor_inertia_kg_m2 = {value = 2e-3}
load_inertia_kg_m2 = {value = 60.0, relative_tolerance = 0.1}
gravity_torque_nm = {value = 300.0}
"""


@cache
def example(name: str = "before") -> Table:
    """One of the example recordings, cut and thinned; columns as in the file."""
    path = EXAMPLES / f"wear_{name}.csv"
    with path.open() as stream:
        columns = stream.readline().strip().split(",")
    rows = np.loadtxt(path, delimiter=",", skiprows=1, max_rows=SAMPLES)[::THINNED]
    return dict(zip(columns, rows.T, strict=True))


def plain_csv(table: Table) -> str:
    """Numbers with all their digits."""
    rows = zip(*table.values(), strict=True)
    lines = [",".join(table), *(",".join(repr(float(x)) for x in row) for row in rows)]
    return "\n".join(lines) + "\n"


def put_inputs(folder: Path) -> None:
    """Recordings, benches and the study file, under the names that the configurations use."""
    for name in ("before", "after"):
        (folder / f"{name}.csv").write_text(plain_csv(example(name)))
    (folder / "axis.csv").write_text(_axis())
    (folder / "bench.toml").write_text(BENCH)
    (folder / "rigid.toml").write_text(RIGID)
    (folder / "study.py").write_text(STUDY)
    gravity = "gravity_torque_nm = {value = 425.0"
    assert gravity in BENCH
    tolerant = BENCH.replace(gravity, f"{gravity}, relative_tolerance = 0.1")
    (folder / "datasheet.toml").write_text(tolerant)
    for name, play in (("ramp", 2e-3), ("ramp_later", 3e-3)):
        (folder / f"{name}.csv").write_text(_ramp(play))
    (folder / "joints.csv").write_text(
        "joint,gearbox,bench,limit_rad,gear_ratio\n"
        "one,RV,bench.toml,1.2e-3,120\ntwo,RV,bench.toml,1.2e-3,120\n"
    )
    for joint in ("one", "two"):
        (folder / "data" / joint).mkdir(parents=True, exist_ok=True)
        for name, day in (("before", "2025-03-01"), ("after", "2026-03-01")):
            shutil.copy(folder / f"{name}.csv", folder / "data" / joint / f"{day}.csv")


def put_configuration(folder: Path, kind: str, text: str | None = None) -> Path:
    """A configuration with all that it names; its file."""
    put_inputs(folder)
    path = folder / f"{kind}.toml"
    path.write_text(CONFIGURATIONS[kind] if text is None else text)
    return path


@cache
def _axis() -> str:
    """A rigid axis swept to and fro, with Coulomb friction."""
    time = np.arange(600) / 100.0
    angle = 60.0 * np.sin(0.8 * time) + 30.0 * np.sin(2.0 * time)
    speed = 48.0 * np.cos(0.8 * time) + 60.0 * np.cos(2.0 * time)
    acceleration = -38.4 * np.sin(0.8 * time) - 120.0 * np.sin(2.0 * time)
    torque = (2e-3 + 6e-3) * acceleration + 3.0 * np.sin(angle / 100.0) + 0.5 * np.sign(speed)
    torque = torque + 0.1 * np.random.default_rng(1).standard_normal(time.size)
    rpm = speed * 30.0 / np.pi
    columns = {TIME: time, POSITION: angle, SPEED: rpm, "motor_torque_nm": torque}
    return plain_csv({name: np.round(values, 8) for name, values in columns.items()})


@cache
def _ramp(play_rad: float) -> str:
    """Torque to and fro over a gear with play and a stiffness, its output held."""
    time = np.arange(4000) / 100.0
    torque = 40.0 * np.sin(2.0 * np.pi * time / 10.0)
    rng = np.random.default_rng(3)
    angle = torque / 1e4 + 0.5 * play_rad * np.tanh(torque / 0.5)
    columns = {
        TIME: time,
        POSITION: angle + 1e-6 * rng.standard_normal(time.size),
        "motor_torque_nm": torque + 0.05 * rng.standard_normal(time.size),
    }
    return plain_csv({name: np.round(values, 9) for name, values in columns.items()})


class Originals:
    """Results that cases take copies of, in folders by the names of their configurations."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.resolve()
        for kind in RESULTS:
            place = self.folder / kind
            shutil.rmtree(place, ignore_errors=True)
            place.mkdir(parents=True)
            put_configuration(place, kind)
            ended = _run(place, ["run", f"{kind}.toml"])
            if ended[0] not in (DONE, WITHHELD):
                raise RuntimeError(f"The original {kind} ended with {ended}")
            (place / "study_file_was_run").unlink(missing_ok=True)

    def copy(self, kind: str, place: Path) -> Path:
        """An original with its inputs; the folder of the result."""
        shutil.copytree(self.folder / kind, place, dirs_exist_ok=True)
        return place / "result"


def _run(place: Path, arguments: list[str]) -> tuple[int, str]:
    from bayesbl.cli import status

    before = os.dup(1), os.dup(2)
    import sys

    streams = sys.stdout, sys.stderr
    with chdir(place), captured() as (_, err):
        code = status(arguments)
        sys.stderr.flush()
        err.seek(0)
        told = err.read().decode()
    sys.stdout, sys.stderr = streams
    for handle, number in zip(before, (1, 2), strict=True):
        os.dup2(handle, number)
        os.close(handle)
    return code, told
