"""Every command with odd arguments: names that collide, names that are hard, places that refuse."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from attack.engine import DONE, OTHER, WITHHELD, WRONG, Ended, Finding, Group, Skipped, Trial
from attack.workshop import CONFIGURATIONS, put_configuration, put_inputs

FIT = ("--config", "fit.toml", "--json")
"""Short sampling, whatever is fitted."""

NAMES: Mapping[str, str] = {
    "spaces": "my data.csv",
    "brackets": "data (1).csv",
    "square brackets": "data [bold].csv",
    "e and accent": "e\u0301te\u0301.csv",
    "é": "été.csv",
    "Chinese": "测量.csv",
    "an apostrophe": "Anna's.csv",
    "a dash first": "-data.csv",
    "a dot first": ".data.csv",
    "two dots": "data..csv",
    "capitals": "DATA.CSV",
    "an ampersand": "a&b=c;d.csv",
    "a newline": "a\nb.csv",
    "an escape": "a\x1b[31mb.csv",
    "not UTF-8": os.fsdecode(b"a\xff\xfe.csv"),
    "250 letters": "x" * 246 + ".csv",
    "a percent": "100%s {x}.csv",
    "right to left": "a\u202eb.csv",
    "the separator": "a,b.csv",
    "only digits": "2026-03-01.csv",
    "a name that is taken": "published.csv",
}
"""Files that are there: each is a recording, and is measured."""

MISSING: Mapping[str, str] = {
    "300 characters": "x" * 300 + ".csv",
    "5,000 characters": "x" * 5000,
    "nothing": "",
    "a blank": " ",
    "root": "/",
    "here": ".",
    "/dev/null": "/dev/null",
    "/dev/zero": "/dev/zero",
    "/dev/urandom": "/dev/urandom",
    "/dev/full": "/dev/full",
    "a FIFO": "fifo.csv",
    "a FIFO without suffix": "fifo",
    "a socket": "socket.csv",
    "a folder": "folder",
    "a folder named as a recording": "folder.csv",
    "a link to itself": "loop.csv",
    "a link to nothing": "dangling.csv",
    "a link to /dev/zero": "zero.csv",
    "a URL": "https://example.org/a.csv",
    "an option": "--nonsense",
    "a NUL": "a\0b",
    "an escape": "\x1b[31mred\x1b[0m.csv",
    "its own environment": "/proc/self/environ",
    "below a file": "before.csv/x.csv",
    "unreadable": "unreadable.csv",
}
"""Where no recording, configuration or result is."""

COMMANDS: Mapping[str, Callable[[str], Sequence[str]]] = {
    "run": lambda name: ("run", name),
    "check": lambda name: ("check", name),
    "fit": lambda name: ("fit", name),
    "compare": lambda name: ("compare", "before.csv", name),
    "simulate": lambda name: ("simulate", name),
    "sweep": lambda name: ("sweep", name),
    "diagnose": lambda name: ("diagnose", name),
    "identify": lambda name: ("identify", name, "--bench", "bench.toml"),
    "identify --bench": lambda name: ("identify", "before.csv", "--bench", name),
    "plan": lambda name: ("plan", "--bench", name),
    "fleet": lambda name: ("fleet", name),
    "collect": lambda name: ("collect", name, "--out", "results", "--once"),
    "watch --config": lambda name: ("watch", "data", "--config", name, "--once"),
    "effects": lambda name: ("effects", name),
    "figures": lambda name: ("figures", name),
    "report": lambda name: ("report", name),
    "inspect": lambda name: ("inspect", name),
    "init": lambda name: ("init", name, "--out", "new.toml"),
    "--curve": lambda name: ("fit", "before.csv", "--curve", name),
    "--bench": lambda name: ("fit", "before.csv", "--route", "direct", "--bench", name),
    "--start-from": lambda name: ("fit", "before.csv", "--start-from", name),
    "--config": lambda name: ("fit", "before.csv", "--config", name),
}

OUTPUTS: Mapping[str, str] = {
    "300 characters": "x" * 300,
    "root": "/",
    "here": ".",
    "above": "..",
    "/dev/null": "/dev/null",
    "/dev/full": "/dev/full",
    "/proc": "/proc/x/y",
    "a recording": "before.csv",
    "below a recording": "before.csv/x",
    "a configuration": "fit.toml",
    "a folder of others": "folder",
    "a FIFO": "fifo",
    "a link to itself": "loop.csv",
    "an escape": "a\x1b[31mb",
    "a NUL": "a\0b",
    "read-only": "readonly/x",
    "nothing": "",
}
"""Where no result may be written, or hardly one."""

WRITERS: Mapping[str, Callable[[str], Sequence[str]]] = {
    "fit": lambda out: ("fit", "before.csv", *FIT, "--out", out),
    "fit --force": lambda out: ("fit", "before.csv", *FIT, "--out", out, "--force"),
    "init": lambda out: ("init", "before.csv", "--out", out),
    "init --force": lambda out: ("init", "before.csv", "--out", out, "--force"),
    "simulate": lambda out: ("simulate", "simulate.toml", "--out", out),
    "simulate --force": lambda out: ("simulate", "simulate.toml", "--out", out, "--force"),
    "study": lambda out: ("run", "study.toml", "--out", out),
    "plan": lambda out: ("plan", "--bench", "bench.toml", "--out", out),
    "watch": lambda out: ("watch", "folder", "--config", "fleet.toml", "--once", "--out", out),
}

OPTIONS: Mapping[str, Sequence[str]] = {
    "--seed": ("-1", "1.5", "x", "1e3", str(2**70), ""),
    "--workers": ("0", "-1", "1000000000", "x"),
    "--level": ("0", "1", "-1", "nan", "inf", "90", "0,9", "1e-300"),
    "--limit-rad": ("0", "-1", "nan", "1.2", "1e-300", "1e300", "0,001"),
    "--gear-ratio": ("0", "-120", "nan", "inf", "1e300", "12", "x"),
    "--route": ("", "auto", "\x1b[31m", "x" * 5000),
    "--curve": ("", "Published", "nosuch", "before.csv", "fit.toml"),
    "--nonsense": ("1",),
}
"""Values of the options of ``fit``."""


def put_odd_places(folder: Path) -> None:
    """Inputs, and beside them all that is neither file nor folder."""
    import socket

    put_inputs(folder)
    for kind in ("fit", "simulate", "study", "fleet"):
        (folder / f"{kind}.toml").write_text(CONFIGURATIONS[kind])
    os.mkfifo(folder / "fifo")
    os.mkfifo(folder / "fifo.csv")
    with socket.socket(socket.AF_UNIX) as made:
        made.bind("socket.csv")
    for name in ("folder", "folder.csv", "readonly"):
        (folder / name).mkdir()
    (folder / "folder" / "mine.txt").write_text("mine\n")
    (folder / "readonly").chmod(0o500)
    for name, target in {"loop": "loop.csv", "dangling": "nothing", "zero": "/dev/zero"}.items():
        (folder / f"{name}.csv").symlink_to(target)
    (folder / "unreadable.csv").write_text("time_s,motor_speed_rpm\n")
    (folder / "unreadable.csv").chmod(0)


WRITTEN = ("results", "result", "new.toml", "made.csv", "truth.json", "study_file_was_run")


def asked_for_nothing(command: str, name: str) -> Callable[[Path, np.random.Generator], Trial]:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        put_odd_places(place)
        # A FIFO, socket or device has nothing to say; a message and nothing else.
        return Trial(
            [COMMANDS[command](name)], statuses=(WRONG,), outputs=WRITTEN, unprivileged=True
        )

    return prepare


def written_to(writer: str, out: str) -> Callable[[Path, np.random.Generator], Trial]:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        put_odd_places(place)
        # Who says --force to init has a configuration replaced.
        replaced = (out,) if (writer, out) == ("init --force", "fit.toml") else ()
        outputs = (*WRITTEN, "a\x1b*", *replaced)
        return Trial([WRITERS[writer](out)], outputs=outputs, unprivileged=True)

    return prepare


def with_option(option: str, value: str) -> Callable[[Path, np.random.Generator], Trial]:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        put_configuration(place, "fit")
        steps = [("fit", "before.csv", *FIT, option, value)]
        return Trial(steps, outputs=WRITTEN, enough_s=5.0)

    return prepare


def named(name: str) -> Callable[[Path, np.random.Generator], Trial]:
    """A recording of this name is looked at, configured and measured."""

    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        put_configuration(place, "fit")
        (place / "before.csv").rename(place / name)
        (place / "fit.toml").write_text(CONFIGURATIONS["fit"].partition("[[")[0])
        dashed = ("--", name) if name.startswith("-") else (name,)
        steps = [
            ("init", "--out", "new.toml", *dashed),
            ("check", "new.toml"),
            ("fit", *FIT, "--out", "result", *dashed),
        ]

        def judge(ended: Sequence[Ended]) -> Iterator[Finding]:
            if name != name.encode(errors="replace").decode():
                return  # no configuration can hold it: refused
            for step, told in zip(steps, ended, strict=True):
                if told.status not in (DONE, WITHHELD):
                    yield OTHER, f"{step[0]}: refused: {told.err.strip()[:200]}"

        return Trial(steps, judge, outputs=WRITTEN)

    return prepare


# Outputs that are inputs: refused, with or without --force, and nothing is touched.


def simulation(place: Path, *files: str, bench: str = "bench.toml", truth: str = "") -> None:
    put_inputs(place)
    entries = "".join(
        f'[[recordings]]\nname = "r{i}"\nfile = "{file}"\ngap_rad = {i + 5}e-4\nrotations = 2.2\n'
        "sampling_hz = 100\n"
        for i, file in enumerate(files)
    )
    truth = f'truth_file = "{truth}"\n' if truth else ""
    (place / "simulate.toml").write_text(
        f'schema = 1\nkind = "simulate"\nbench = "{bench}"\n{truth}{entries}'
    )


SIMULATE = ("simulate", "simulate.toml", "--force")


def bench_is_output(place: Path) -> Sequence[str]:
    simulation(place, "bench.toml")
    return SIMULATE


def bench_is_output_by_a_link(place: Path) -> Sequence[str]:
    simulation(place, "made.csv", bench="bench.toml")
    (place / "made.csv").symlink_to("bench.toml")
    return SIMULATE


def bench_is_output_by_a_detour(place: Path) -> Sequence[str]:
    (place / "folder").mkdir()
    simulation(place, "folder/../bench.toml")
    return SIMULATE


def bench_is_output_by_a_hard_link(place: Path) -> Sequence[str]:
    simulation(place, "made.csv")
    os.link(place / "bench.toml", place / "made.csv")
    return SIMULATE


def configuration_is_output(place: Path) -> Sequence[str]:
    simulation(place, "simulate.toml")
    return SIMULATE


def truth_is_bench(place: Path) -> Sequence[str]:
    simulation(place, "made.csv", truth="bench.toml")
    return SIMULATE


def truth_is_recording(place: Path) -> Sequence[str]:
    simulation(place, "made.csv", truth="./made.csv")
    return SIMULATE


def one_file_under_two_names(place: Path) -> Sequence[str]:
    simulation(place, "a.csv", "./a.csv")
    return ("simulate", "simulate.toml")


def output_leaves_the_folder(place: Path) -> Sequence[str]:
    (place / "inner").mkdir()
    simulation(place / "inner", "../../outside.csv")
    return ("simulate", "inner/simulate.toml", "--out", "inner/deep")


def init_over_its_recording(place: Path) -> Sequence[str]:
    put_inputs(place)
    return ("init", "before.csv", "--out", "before.csv", "--force")


def init_over_its_recording_by_a_link(place: Path) -> Sequence[str]:
    put_inputs(place)
    (place / "new.toml").symlink_to("before.csv")
    return ("init", "before.csv", "--out", "new.toml", "--force")


def init_over_its_recording_by_a_detour(place: Path) -> Sequence[str]:
    put_inputs(place)
    return ("init", "./before.csv", "after.csv", "--out", f"{place}/after.csv", "--force")


def init_over_a_recording_not_its_own(place: Path) -> Sequence[str]:
    put_inputs(place)
    return ("init", "before.csv", "--out", "after.csv", "--force")


def result_over_inputs(place: Path) -> Sequence[str]:
    """The output folder is the folder of the inputs, which looks like a result."""
    put_configuration(place, "fit")
    (place / "summary.json").write_text("{}")
    return ("run", "fit.toml", "--out", str(place), "--force")


def recording_in_the_output(place: Path) -> Sequence[str]:
    """A recording lies under a name that results have, in a folder that is to be replaced."""
    put_configuration(place, "fit")
    (place / "result" / "figures").mkdir(parents=True)
    (place / "result" / "summary.json").write_text("{}")
    (place / "before.csv").rename(place / "result" / "figures" / "before.csv")
    text = CONFIGURATIONS["fit"].replace('"before.csv"', '"result/figures/before.csv"')
    (place / "fit.toml").write_text(text)
    return ("run", "fit.toml", "--force")


COLLISIONS: Sequence[Callable[[Path], Sequence[str]]] = (
    bench_is_output,
    bench_is_output_by_a_link,
    bench_is_output_by_a_detour,
    bench_is_output_by_a_hard_link,
    configuration_is_output,
    truth_is_bench,
    truth_is_recording,
    one_file_under_two_names,
    output_leaves_the_folder,
    init_over_its_recording,
    init_over_its_recording_by_a_link,
    init_over_its_recording_by_a_detour,
    init_over_a_recording_not_its_own,
    result_over_inputs,
    recording_in_the_output,
)
"""Each must end with status 2 and no file changed."""


def collided(make: Callable[[Path], Sequence[str]]) -> Callable[[Path, np.random.Generator], Trial]:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        return Trial([make(place)], statuses=(WRONG,), outputs=[])

    return prepare


# A study file does what it likes; a file that fails is told, with its line.

STUDY_FILES: Mapping[str, str] = {
    "raises": "raise ValueError('no')",
    "asks to exit": "import sys; sys.exit(0)",
    "exits": "raise SystemExit('bye')",
    "raises what is no Exception": "class Odd(BaseException): pass\nraise Odd('odd')",
    "recurses": "def f(): f()\nf()",
    "does not parse": "def (",
    "is nested deeply": "x = " + "(" * 5000 + ")" * 5000,
    "is binary": "\x00\x01",
    "lacks functions": "x = 1",
    "has functions that are none": "count = run_case = summarise = 1",
    "counts text": "def count(row): return 'many'\ndef run_case(*_): ...\ndef summarise(*_): ...",
    "counts by raising": "def count(row): raise KeyError('x')\ndef run_case(*_): ...\n"
    "def summarise(*_): ...",
    "counts by exiting": "import sys\ndef count(row): sys.exit(3)\ndef run_case(*_): ...\n"
    "def summarise(*_): ...",
    "counts a billion": "def count(row): return 10**9\ndef run_case(*_): ...\n"
    "def summarise(*_): ...",
    "warns": "import warnings; warnings.warn('odd')",
}


def study_file(text: str) -> Callable[[Path, np.random.Generator], Trial]:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        put_configuration(place, "study")
        (place / "study.py").write_text(text + "\n")
        steps = [("check", "study.toml")]
        return Trial(steps, names=["study.py"], statuses=(DONE, WRONG), outputs=["__pycache__"])

    return prepare


# A disk that is full: every write beyond some bytes fails.


def full_disk(kind: str) -> Callable[[Path, np.random.Generator], Trial]:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        if not hasattr(resource, "RLIMIT_FSIZE"):
            raise Skipped("no limit of file sizes here")
        put_configuration(place, kind)
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        # What the step prints goes to files as well, so some bytes must be left.
        size = int(rng.choice([4096, 8192, 16384]))
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))

        def judge(ended: Sequence[Ended]) -> Iterator[Finding]:
            told = ended[0]
            if (
                told.status in (1, WRONG)
                and str(place) not in told.err
                and "result" not in told.err
            ):
                yield OTHER, f"no path in: {told.err.strip()[:200]}"

        step = ("run", f"{kind}.toml")
        return Trial(
            [step],
            judge,
            statuses=(DONE, 1, WRONG, WITHHELD),
            outputs=["result", "made.csv", "truth.json"],
        )

    return prepare


def group() -> Group:
    table = [
        *(
            (f"{c}: no {n}", asked_for_nothing(c, name))
            for n, name in MISSING.items()
            for c in COMMANDS
        ),
        *((f"{w} into {n}", written_to(w, out)) for n, out in OUTPUTS.items() for w in WRITERS),
        *((f"{o} {v[:20]!r}", with_option(o, v)) for o, values in OPTIONS.items() for v in values),
    ]
    order = np.random.default_rng(0).permutation(len(table))
    return Group("commands", 6, [table[i] for i in order])


def files_group() -> Group:
    """Names, collisions, study files and full disks: few, and each in every attack."""
    table = [
        *((make.__name__.replace("_", " "), collided(make)) for make in COLLISIONS),
        *((f"a name with {n}", named(name)) for n, name in NAMES.items()),
        *((f"a study file that {n}", study_file(text)) for n, text in STUDY_FILES.items()),
        *((f"a full disk: {kind}", full_disk(kind)) for kind in ("fit", "sweep", "simulate")),
    ]
    order = np.random.default_rng(0).permutation(len(table))
    return Group("files", 3, [table[i] for i in order])
