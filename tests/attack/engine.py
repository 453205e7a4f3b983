"""One case: a folder with files, commands on them in a child process, and what is wrong with it.

The child is forked, so a case costs no import. It judges itself and hands its findings back in a
file; the parent adds those that the child cannot tell: that it died, or never answered.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import os
import resource
import shutil
import signal
import stat
import struct
import sys
import tempfile
import time
import traceback
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn
from unittest import mock

import numpy as np

TRACEBACK, HANG, SILENT, HARM, OTHER = "traceback", "hang", "silent change", "harm", "other"
KINDS = (TRACEBACK, HANG, SILENT, HARM, OTHER)
"""What can be wrong: ``other`` is a status or a message that is not as it should be."""

LONGEST_S = 10.0
"""A command that takes longer hangs: of processor time, as the machine may be busy."""
STARVED = 60.0
"""However busy the machine is, a command takes at most so many times :data:`LONGEST_S`."""
MEMORY_BYTES = 3 << 30
"""What a case may take beyond what it begins with."""
NOBODY = 65534
DONE, WRONG, WITHHELD, STOPPED = 0, 2, 3, -1
"""Exit statuses; ``STOPPED`` is a command that was let go on long enough."""

KEPT = (".finished",)
"""Hidden folders that are kept on purpose: simulations that other sweeps need again."""

Finding = tuple[str, str]
"""One of :data:`KINDS`, and what happened."""
Step = Sequence[str] | Callable[[], object]
"""Arguments of the command line, or a function whose result is the answer."""


@dataclass(frozen=True)
class Ended:
    """How a step ended."""

    status: int
    out: str
    err: str
    answer: object = None


@dataclass(frozen=True)
class Trial:
    """What a case does once its files are in place.

    Attributes
    ----------
    steps
        One after the other, whatever becomes of those before.
    judge
        Further findings from how the steps ended.
    names
        A refusal must say one of these texts; none: any message will do.
    outputs
        Patterns of what the steps may write or change; all other files must stay as they are.
    statuses
        Exit statuses that are right.
    enough_s
        Stop a step after so much processor time and count it as :data:`STOPPED`.
    unprivileged
        Give up the rights of root before the steps: what they name must not be at risk.
    """

    steps: Sequence[Step]
    judge: Callable[[Sequence[Ended]], Iterator[Finding]] = field(default=lambda ended: iter(()))
    names: Sequence[str] = ()
    outputs: Sequence[str] = ()
    statuses: Sequence[int] = (DONE, WRONG, WITHHELD)
    enough_s: float | None = None
    unprivileged: bool = False


Prepare = Callable[[Path, np.random.Generator], Trial]
"""Puts a case's files into an empty folder, which is also the working directory."""


@dataclass(frozen=True)
class Group:
    """Cases of one sort: a table of what is done, gone through from its top again and again."""

    name: str
    share: int
    table: Sequence[tuple[str, Prepare]]


@dataclass(frozen=True)
class Result:
    """A case and what was found wrong with it."""

    number: int
    group: str
    name: str
    findings: tuple[Finding, ...]
    seconds: float
    """Of processor time."""


class Skipped(Exception):
    """A case that this machine cannot run; says why."""


class Hang(BaseException):
    """Not an Exception: no handler of the package may take it for its own."""


class Enough(BaseException):
    """A step has run as long as it was asked to."""


def _forget_alarms(ignored: Any) -> None:
    """In place of ``sys.unraisablehook``: an alarm in a callback is lost, and rings again."""
    if not isinstance(ignored.exc_value, (Hang, Enough)):
        sys.__unraisablehook__(ignored)


@dataclass(frozen=True)
class Attack:
    """All groups, and how their cases are numbered."""

    groups: Sequence[Group]
    seed: int

    def case(self, number: int) -> tuple[Group, str, Prepare]:
        """Group, name and preparation of a case: by turns through a round of all shares."""
        turns = [group for group in self.groups for _ in range(group.share)]
        order = np.random.default_rng(self.seed).permutation(len(turns))
        group = turns[order[number % len(turns)]]
        earlier = [turns[i] for i in order[: number % len(turns)]].count(group)
        index = number // len(turns) * group.share + earlier
        name, prepare = group.table[index % len(group.table)]
        return group, name, prepare

    def start(self, number: int, folder: Path) -> Running:
        """Start a case in a new folder below ``folder``."""
        group, name, prepare = self.case(number)
        place = folder / f"case{number}"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(number,)))
        return Running(
            number, group.name, name, place, Child(lambda: run_case(prepare, place, rng))
        )


class Child:
    """A forked process that hands back its findings in a file; this one never blocks on it."""

    def __init__(self, work: Callable[[], Sequence[Finding]]) -> None:
        self._answer = tempfile.TemporaryFile("w+", encoding="utf-8")  # noqa: SIM115
        self._latest = time.monotonic() + 2.0 * STARVED * LONGEST_S
        self._late = False
        self._number = os.fork()
        if self._number == 0:
            self._work(work)

    def _work(self, work: Callable[[], Sequence[Finding]]) -> NoReturn:
        os.setsid()
        found: Sequence[Finding]
        try:
            found = work()
        except Skipped as reason:
            found = [("skipped", str(reason))]
        except BaseException:
            found = [(OTHER, "the attack itself failed: " + traceback.format_exc())]
        resource.setrlimit(resource.RLIMIT_FSIZE, resource.getrlimit(resource.RLIMIT_FSIZE)[1:] * 2)
        with suppress(BaseException):
            json.dump(found, self._answer)
            self._answer.flush()
        os._exit(0)

    def poll(self) -> list[Finding] | None:
        """The findings once it has ended; whatever it has started ends with it."""
        number, status, used = os.wait4(self._number, os.WNOHANG)
        self.seconds = used.ru_utime + used.ru_stime
        if number == 0:
            if time.monotonic() > self._latest:
                self._late = True
                os.kill(self._number, signal.SIGKILL)
            return None
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(self._number, signal.SIGKILL)
        if self._late:
            return [(HANG, "the process did not answer, not even to its alarm")]
        if os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU:
            return [(HANG, "the process computed on and on, and did not answer to its alarm")]
        if os.WIFSIGNALED(status):
            return [(TRACEBACK, f"died by {signal.Signals(os.WTERMSIG(status)).name}")]
        with self._answer as stream:
            stream.seek(0)
            text = stream.read()
        if not text:
            return [
                (
                    TRACEBACK,
                    f"the process ended by itself, status {os.waitstatus_to_exitcode(status)}",
                )
            ]
        return [(kind, told) for kind, told in json.loads(text)]


@dataclass(frozen=True)
class Running:
    """A case under way."""

    number: int
    group: str
    name: str
    place: Path
    child: Child

    def poll(self) -> Result | None:
        """What was found, once it has ended; its folder is deleted unless it failed."""
        findings = self.child.poll()
        if findings is None:
            return None
        if not findings:
            shutil.rmtree(self.place, ignore_errors=True)
        return Result(self.number, self.group, self.name, tuple(findings), self.child.seconds)


def run_all(attack: Attack, numbers: Iterable[int], folder: Path, at_once: int) -> Iterator[Result]:
    """Results of cases as they end, so many at once."""
    running: list[Running] = []
    waiting = iter(numbers)
    while True:
        while len(running) < at_once and (number := next(waiting, None)) is not None:
            running.append(attack.start(number, folder))
        if not running:
            return
        for case in list(running):
            result = case.poll()
            if result is not None:
                running.remove(case)
                yield result
        time.sleep(0.01)


def run_case(prepare: Prepare, place: Path, rng: np.random.Generator) -> list[Finding]:
    os.chdir(place)
    os.environ["COLUMNS"] = "100"
    trial = prepare(place, rng)
    before = snapshot(place)
    _set_limits()
    if trial.unprivileged and os.geteuid() == 0:
        # numba looks for a place for its cache on import; nobody's is cold: half a minute.
        import bayesbl.runs.measure
        import bayesbl.runs.simulate  # noqa: F401

        give_to_nobody(place, *place.rglob("*"))
        give_up_root()
    findings: list[Finding] = []
    ended = []
    for step in trial.steps:
        told, found = run_step(step, trial.enough_s)
        ended.append(told)
        findings += found
        if found:
            break
        findings += _status_findings(step, told, trial)
    with suppress(OSError):
        os.chdir(place)
    findings += _harm(before, snapshot(place), trial.outputs)
    if not any(kind in (TRACEBACK, HANG) for kind, _ in findings):
        findings += trial.judge(ended)
    return findings


def run_step(step: Step, enough_s: float | None = None) -> tuple[Ended, list[Finding]]:
    """One step with what it printed, and whether it ended in a traceback or not at all."""
    with captured() as (out, err):
        status, answer, findings = _guarded(step, enough_s)
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        printed, told = (_text(stream) for stream in (out, err))
    if "Traceback" in printed + told or "This is a bug" in told:
        findings = [(TRACEBACK, f"{shown(step)}: {_last_line(told)}")]
    return Ended(status, printed, told, answer), findings


def _guarded(step: Step, enough_s: float | None) -> tuple[int, object, list[Finding]]:
    from bayesbl.cli import status
    from bayesbl.errors import UserError

    start = at = time.monotonic()
    begin, busy = session_seconds()

    def on_alarm(number: int, frame: FrameType | None) -> None:
        nonlocal at, busy
        now, (used, worked) = time.monotonic(), session_seconds()
        if worked - busy >= 0.5 * (now - at):
            at, busy = now, worked
        if enough_s is not None and used - begin >= enough_s:
            raise Enough
        if enough_s is None and used - begin >= LONGEST_S:
            raise Hang
        if now - start >= STARVED * LONGEST_S or now - at >= LONGEST_S:
            raise Hang

    signal.signal(signal.SIGALRM, on_alarm)
    sys.unraisablehook = _forget_alarms
    signal.setitimer(signal.ITIMER_REAL, 0.5, 0.5)
    try:
        if not callable(step):
            return status(list(step)), None, []
        try:
            return DONE, step(), []
        except UserError as error:
            print(error, file=sys.stderr)
            return WRONG, None, []
    except Enough:
        return STOPPED, None, []
    except Hang:
        return STOPPED, None, [(HANG, f"{shown(step)}: over {LONGEST_S:g} s")]
    except BaseException:
        return 1, None, [(TRACEBACK, f"{shown(step)}: {_last_line(traceback.format_exc())}")]
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)


def session_seconds() -> tuple[float, float]:
    """Processor time of this session's processes, s; and with what they waited for a processor.

    A process that a busy machine keeps waiting does not hang.
    """
    used, delayed, session = 0, 0, str(os.getsid(0))
    for place in Path("/proc").glob("[0-9]*"):
        with suppress(OSError):
            fields = (place / "stat").read_text(errors="replace").rpartition(")")[2].split()
            if fields[3] == session:
                used += sum(int(field) for field in fields[11:15])  # reaped children's too
                delayed += int((place / "schedstat").read_text().split()[1])
    seconds = used / os.sysconf("SC_CLK_TCK")
    return seconds, seconds + 1e-9 * delayed


def _status_findings(step: Step, ended: Ended, trial: Trial) -> Iterator[Finding]:
    if ended.status == STOPPED or "This is a bug" in ended.err:
        return
    if ended.status not in trial.statuses:
        yield OTHER, f"{shown(step)}: status {ended.status}; {_last_line(ended.err)}"
    elif ended.status == WRONG and not callable(step):
        if not ended.err.strip():
            yield OTHER, f"{shown(step)}: refused without a message"
        elif trial.names and not any(name in ended.err for name in trial.names):
            yield OTHER, f"{shown(step)}: {trial.names[0]} is not named: {_last_line(ended.err)}"
    escapes = [
        c for c in ended.out + ended.err if unicodedata.category(c) == "Cc" and c not in "\n\t\r"
    ]
    if escapes:
        yield OTHER, f"{shown(step)}: control character {escapes[0]!r} reaches the terminal"


def snapshot(folder: Path) -> dict[str, str]:
    """Each file below a folder with its hash, links and special files with what they are."""
    found = {}
    for path in sorted(folder.rglob("*")):
        mode = path.lstat().st_mode
        if stat.S_ISREG(mode):
            content = hashlib.sha256(path.read_bytes()).hexdigest()
        elif stat.S_ISLNK(mode):
            content = f"link to {os.readlink(path)}"
        else:
            content = "folder" if stat.S_ISDIR(mode) else f"mode {stat.S_IFMT(mode):o}"
        found[str(path.relative_to(folder))] = content
    return found


def _harm(
    before: dict[str, str], after: dict[str, str], outputs: Sequence[str]
) -> Iterator[Finding]:
    """Inputs that changed, and hidden files that were left."""
    for name, content in before.items():
        if after.get(name) != content and not _is_output(name, outputs):
            yield HARM, f"{name} was {'changed' if name in after else 'deleted'}"
    for name in after.keys() - before.keys():
        # Every group of a Zarr store has hidden files of its format.
        hidden = name.rpartition("/")[2].startswith(".") and ".zarr/" not in name
        hidden = hidden and name.rpartition("/")[2] not in KEPT
        if hidden and not _is_output(name, outputs):
            yield OTHER, f"{name} is left behind"


def _is_output(name: str, outputs: Sequence[str]) -> bool:
    return any(fnmatch(name, pattern) or name.startswith(f"{pattern}/") for pattern in outputs)


@contextmanager
def captured() -> Iterator[tuple[Any, Any]]:
    """Standard output and error into files, of Python and of all that lies below it."""
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        sys.stdout, sys.stderr = (
            open(os.dup(stream.fileno()), "w", encoding="utf-8", errors="surrogateescape")  # noqa: SIM115
            for stream in (out, err)
        )
        with mock.patch("matplotlib.figure.Figure.savefig", save_description):
            os.dup2(out.fileno(), 1)
            os.dup2(err.fileno(), 2)
            yield out, err
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()


def save_description(
    figure: Any, target: Any, *, metadata: Mapping[str, str | None] | None = None, **_: object
) -> None:
    """In place of a picture, its title and a hash of what it would show: a hundred times faster."""
    digest = hashlib.sha256()
    for artist in figure.findobj():
        for getter in ("get_text", "get_xydata", "get_offsets", "get_array", "get_path"):
            with suppress(Exception):
                content = getattr(artist, getter)()
                content = getattr(content, "vertices", content)
                digest.update(content.encode() if isinstance(content, str) else bytes(content))
    if isinstance(target, str | os.PathLike):
        Path(target).write_text(f"{(metadata or {}).get('Title')} {digest.hexdigest()}")
    else:
        target.write(digest.hexdigest().encode())


def shown(step: Step) -> str:
    """A step as one would type it."""
    if callable(step):
        return getattr(step, "__name__", "function")
    text = " ".join(str(argument) for argument in step)
    return text if len(text) < 120 else f"{text[:60]}…{text[-40:]}"


def _text(stream: Any) -> str:
    stream.seek(0)
    return stream.read().decode("utf-8", "replace")


def _last_line(text: str) -> str:
    lines = [line for line in text.splitlines() if line.strip()]
    # Of a traceback the last line says what it was, of a message the first.
    if not lines:
        return "nothing said"
    line = lines[-1] if any(line.startswith("Traceback") for line in lines) else lines[0]
    return line if len(line) < 240 else line[:200] + "…" + line[-39:]


def _set_limits() -> None:
    """Of memory, and of processor time for what hangs where Python does not see its alarm."""
    spent = int(time.process_time() + 4.0 * LONGEST_S)
    resource.setrlimit(resource.RLIMIT_CPU, (spent, spent + 5))
    with open("/proc/self/statm") as stream:
        now = int(stream.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (now + MEMORY_BYTES, now + MEMORY_BYTES))


def give_to_nobody(*paths: Path) -> None:
    """So that a process without the rights of root can write there."""
    for path in paths:
        os.chown(path, NOBODY, NOBODY, follow_symlinks=False)


def give_up_root() -> None:
    """Become nobody, who may still read everything: Python itself may lie in root's home."""
    libc = ctypes.CDLL(None, use_errno=True)
    keep_capabilities, ambient, ambient_raise = 8, 47, 2
    libc.prctl(keep_capabilities, 1, 0, 0, 0)
    os.setgroups([])
    os.setresgid(NOBODY, NOBODY, NOBODY)
    os.setresuid(NOBODY, NOBODY, NOBODY)
    read_all = 2  # CAP_DAC_READ_SEARCH
    head = struct.pack("Ii", 0x20080522, 0)
    libc.capset(head, struct.pack("6I", *[1 << read_all] * 3, 0, 0, 0))
    libc.prctl(ambient, ambient_raise, read_all, 0, 0)
