"""Parse a file in a process of its own, so that a library that crashes, hangs or takes all memory
spoils only that file.

The process is a fresh interpreter. A fork would copy the state of threads of numba, Arrow or Dask;
``multiprocessing`` is not allowed in Dask's workers, and runs the user's script again. Bytes go in
through a pipe, so the child opens no path; columns come back through an unnamed file.
"""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from contextlib import suppress
from typing import IO, TYPE_CHECKING
from zipfile import BadZipFile

from bayesbl.errors import RecordingError, UnavailableError, UserError, shortened
from bayesbl.libraries import absent
from bayesbl.recording import formats
from bayesbl.recording.input_bytes import beyond_memory, memory_bytes, require_memory

if TYPE_CHECKING:
    from bayesbl.recording.array_table import ArrayTable

LONGEST_S = 120.0  # longest time to parse a file. A workbook of a million lines takes a minute.
SPARE_MB = 700.0  # memory for the libraries themselves, on top of the limit

_PROGRAM = (
    "import json, sys; request = json.loads(sys.argv[1]); sys.path[:] = request['path'];"
    "from bayesbl.recording.own_process import answer; answer(request)"
    # A library's own end may hang or crash after all is said.
    "; import os; os._exit(0)"
)
_WHOLE = "a whole {kind} file; save it again, or as CSV"
_IN_MEMORY = re.compile("[\"']?<_io.BytesIO[^>]*>[\"']?")  # libraries' name for a file in memory
_ONE_THREAD = {f"{name}_NUM_THREADS": "1" for name in ("OMP", "OPENBLAS", "MKL", "NUMEXPR")}


def parsed_apart(format_: formats.Format, data: bytes) -> ArrayTable:
    """The result of ``format_.read``, called in a process of its own.

    Raises RecordingError as the format does, or if the process dies, or takes longer than
    :data:`LONGEST_S` or more memory than the limit.
    """
    request = {
        "path": [str(path) for path in sys.path],
        "module": format_.module,
        "library": format_.library,
        "name": format_.name,
        "memory": memory_bytes() + int(1e6 * SPARE_MB),
    }
    with tempfile.TemporaryFile() as answer_file:
        try:
            ended = subprocess.run(
                # Isolated: what is imported is what this process would, not what a folder holds.
                [sys.executable, "-I", "-c", _PROGRAM, json.dumps(request)],
                input=data,
                stdout=answer_file,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **_ONE_THREAD},
                timeout=LONGEST_S,
            )
        except subprocess.TimeoutExpired:
            raise UnavailableError(  # a quieter machine may end it
                f"Reading this file as {format_.name} takes too long.",
                found=f"no end after {LONGEST_S:g} s",
                expected=_WHOLE.format(kind=format_.name),
            ) from None
        answer_file.seek(0)
        with suppress(EOFError, ValueError, KeyError, TypeError, BadZipFile):
            return _received(answer_file)
    raise _broken(format_.name, ended.returncode)


def _broken(kind: str, status: int) -> RecordingError:
    actual = f"{signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
    # Of the machine, not of the file: no memory, or no room for what is read.
    passes = {-signal.SIGKILL: ", as where the system is out of memory", os.EX_IOERR: ", no room"}
    kept = UnavailableError if status in passes else RecordingError
    return kept(
        f"The library that reads {kind} breaks down on this file.",
        found=actual + passes.get(status, ""),
        expected=_WHOLE.format(kind=kind),
    )


def answer(request: dict[str, object]) -> None:
    """The child's part: bytes from standard input, a table or an error to standard output."""
    stream = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what a library prints is no part of the answer
    with suppress(ValueError):
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    kind = str(request["name"])
    # Taken into account from here on: the file's bytes are part of what it takes.
    _limit(int(request["memory"]))  # type: ignore[call-overload]
    result: ArrayTable | UserError
    extras = {"dask", "matplotlib", "numba", "pyarrow"} - {str(request["library"])}
    try:
        # pandas and xarray import them where they are there; no reader needs them for that.
        with absent(*extras):
            data = sys.stdin.buffer.read()
            table = formats.reader_of(str(request["module"]))(data)
        values = sum(column.size for column in table.arrays.values())
        require_memory(len(data) + 8.0 * values, f"its bytes and {values} numbers")
        result = table
    except UserError as error:
        result = error
    except MemoryError:
        result = beyond_memory(f"more, reading it as {kind}")
    except Exception as error:
        # Parsers let nearly everything out on a damaged file: KeyError, zlib.error, struct.error, …
        lines = _IN_MEMORY.sub("it", str(error)).strip().splitlines()
        result = RecordingError(
            f"The file cannot be read as {kind}.",
            found=shortened(lines[0] if lines else type(error).__name__, 160),
            expected=_WHOLE.format(kind=kind),
        )
    try:
        with stream:
            _send(stream, result)
    except OSError:
        os._exit(os.EX_IOERR)


_ERROR = ("problem", "where", "found", "expected")
_NAMED = ("units", "clocks", "withheld", "repairs", "one_origin")


def _send(stream: IO[bytes], result: ArrayTable | UserError) -> None:
    """Write JSON and NumPy arrays; the parent unpickles nothing."""
    import numpy as np

    if isinstance(result, UserError):
        details = {key: getattr(result, key) for key in _ERROR}
        details["is_unavailable"] = isinstance(result, UnavailableError)
        np.savez(stream, json.dumps(details))
        return
    head = {key: getattr(result, key) for key in _NAMED} | {"columns": list(result.arrays)}
    np.savez(stream, json.dumps(head), *result.plain_arrays())


def _received(stream: IO[bytes]) -> ArrayTable:
    import numpy as np

    from bayesbl.recording.array_table import ArrayTable

    with np.load(stream, allow_pickle=False) as sent:
        text, *columns = (sent[name] for name in sent.files)
    head = json.loads(str(text))
    if "problem" in head:
        kind = UnavailableError if head.pop("is_unavailable") else RecordingError
        raise kind(head.pop("problem"), **head)
    return ArrayTable(arrays=dict(zip(head.pop("columns"), columns, strict=True)), **head)


def _limit(size: int) -> None:
    """Limit the memory for data to ``size`` bytes, and the time in case the parent has died."""
    import resource

    for what, most in ((resource.RLIMIT_DATA, size), (resource.RLIMIT_CPU, int(2 * LONGEST_S))):
        _, hard = resource.getrlimit(what)
        least = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (least, hard))
