"""Recordings: changes that must not change a sample, and damage that must not pass unseen."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from attack.damage import BYTES, Damage
from attack.engine import DONE, OTHER, SILENT, Ended, Finding, Group, Prepare, Trial
from attack.workshop import CURRENT, HEAD, JOINT, SHORT, SPEED, TIME, Table, example, plain_csv

CHECKED = HEAD.format(kind="fit") + JOINT + SHORT + '[[recordings]]\nname = "it"\nfile = "{file}"\n'
FIT = ("run", "config.toml", "--json")
CHECK = ("check", "config.toml")

Text = Callable[[str, np.random.Generator], str | bytes]


def with_separator(mark: str, decimal: str = ".") -> Text:
    return lambda text, rng: text.replace(",", mark).replace(".", decimal)


def by_columns(change: Callable[[list[str], np.random.Generator], list[str]]) -> Text:
    """A change of each line's cells, the same generator at the start of every line."""

    def changed(text: str, rng: np.random.Generator) -> str:
        seed = int(rng.integers(1 << 30))
        rows = (line.split(",") for line in text.splitlines())
        lines = [",".join(change(row, np.random.default_rng(seed))) for row in rows]
        return "\n".join(lines) + "\n"

    return changed


def by_number(form: Callable[[float], str]) -> Text:
    def changed(text: str, rng: np.random.Generator) -> str:
        head, *rows = text.splitlines()
        body = [",".join(form(float(cell)) for cell in row.split(",")) for row in rows]
        return "\n".join([head, *body]) + "\n"

    return changed


def blank_lines(text: str, rng: np.random.Generator) -> str:
    lines = text.splitlines()
    for place in rng.integers(1, len(lines), 5):
        lines.insert(int(place), str(rng.choice(["", "   ", ",,,"])))
    return "\n".join(lines) + "\n"


def with_column(name: str, cell: str) -> Text:
    def changed(text: str, rng: np.random.Generator) -> str:
        head, *rows = text.splitlines()
        return "\n".join([f"{head},{name}", *(f"{row},{cell}" for row in rows)]) + "\n"

    return changed


SAME: Mapping[str, Text] = {
    "lines end as on Windows": lambda text, rng: text.replace("\n", "\r\n"),
    "lines end as on old Macs": lambda text, rng: text.replace("\n", "\r"),
    "line ends mixed": lambda text, rng: text.replace("\n", "\r\n", 40),
    "no line end at the end": lambda text, rng: text.rstrip("\n"),
    "empty lines at the end": lambda text, rng: text + "\n\n\n",
    "empty lines before the header": lambda text, rng: "\n\n" + text,
    "blank lines between": blank_lines,
    "byte order mark": lambda text, rng: "\ufeff" + text,
    "UTF-16, little end first": lambda text, rng: ("\ufeff" + text).encode("utf-16-le"),
    "UTF-16, big end first": lambda text, rng: ("\ufeff" + text).encode("utf-16-be"),
    "semicolons": with_separator(";"),
    "tabs": with_separator("\t"),
    "semicolons and decimal commas": with_separator(";", ","),
    "tabs and decimal commas": with_separator("\t", ","),
    "columns in another order": by_columns(lambda row, rng: [row[i] for i in rng.permutation(4)]),
    "column of text": with_column("remark", "warm"),
    "column without a name": with_column("", "1"),
    "column of another language": with_column("Ölstand °C", "21.5"),
    "quoted header": lambda text, rng: '"' + text.replace(",", '","', 3).replace("\n", '"\n', 1),
    "quoted numbers": by_columns(lambda row, rng: [f'"{cell}"' for cell in row]),
    "blanks after numbers": by_columns(lambda row, rng: [f"{cell}  " for cell in row]),
    "blanks before numbers": by_columns(lambda row, rng: [f"  {cell}" for cell in row]),
    "blanks at the end of lines": lambda text, rng: text.replace("\n", "   \n"),
    "separator at the end of lines": lambda text, rng: text.replace("\n", ",\n"),
    "exponents": by_number(lambda x: f"{x:.17e}"),
    "large exponents": by_number(lambda x: f"{x:.17E}"),
    "plus signs": by_number(lambda x: f"{x:+.17g}"),
    "many digits": by_number(lambda x: f"{x:.25f}"),
    "numpy's digits": by_number(lambda x: np.format_float_scientific(x)),
}
"""What may be done to the text of a CSV file without changing a sample."""


def as_netcdf(path: Path, table: Table, kind: str) -> None:
    import xarray as xr

    data = xr.Dataset({name: ("sample", values) for name, values in table.items()})
    data.to_netcdf(path, format=kind)


def as_mat5(path: Path, table: Table, orientation: str = "column") -> None:
    from scipy.io import savemat

    savemat(path, dict(table), oned_as=orientation)


def as_mat73(path: Path, table: Table) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in table.items():
            file.create_dataset(name, data=np.atleast_2d(values))
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
    head = b"MATLAB 7.3 MAT-file, Platform: GLNXA64, Created on: Sun Mar  1 12:00:00 2026"
    with open(path, "r+b") as raw:
        raw.write(head.ljust(124) + b"\x00\x02IM")


def as_parquet(path: Path, table: Table) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(dict(table)), path)


def as_excel(path: Path, table: Table) -> None:
    import openpyxl

    book = openpyxl.Workbook(write_only=True)
    sheet = book.create_sheet()
    sheet.append(list(table))
    for row in zip(*(values.tolist() for values in table.values()), strict=True):
        sheet.append(list(row))
    book.save(path)


def as_mdf(path: Path, table: Table) -> None:
    import asammdf

    with asammdf.MDF() as file:
        signals = [
            asammdf.Signal(values, table[TIME], name=name)
            for name, values in table.items()
            if name != TIME
        ]
        file.append(signals)
        file.save(path, overwrite=True)


def as_tdms(path: Path, table: Table) -> None:
    import nptdms

    with nptdms.TdmsWriter(path) as file:
        file.write_segment([nptdms.ChannelObject("log", *column) for column in table.items()])


def as_bag(path: Path, table: Table) -> None:
    """As states of a joint called motor."""
    from recording_files import write_bag

    write_bag(path, {"motor": {"velocity": table[SPEED], "effort": table[CURRENT]}}, table[TIME])


def as_csv(path: Path, table: Table, name: str = "") -> None:
    path.write_text(plain_csv(table))


FORMATS: Mapping[str, tuple[str, Callable[[Path, Table], None]]] = {
    "CSV": ("a.csv", as_csv),
    "TSV": ("a.tsv", lambda path, table: path.write_text(plain_csv(table).replace(",", "\t"))),
    "NetCDF 3": ("a.nc", partial(as_netcdf, kind="NETCDF3_CLASSIC")),
    "NetCDF 3, 64 bit": ("a.nc", partial(as_netcdf, kind="NETCDF3_64BIT")),
    "NetCDF 4": ("a.nc", partial(as_netcdf, kind="NETCDF4")),
    "MATLAB 5": ("a.mat", as_mat5),
    "MATLAB 5, rows": ("a.mat", partial(as_mat5, orientation="row")),
    "MATLAB 7.3": ("a.mat", as_mat73),
    "Parquet": ("a.parquet", as_parquet),
    "MDF": ("a.mf4", as_mdf),
    "TDMS": ("a.tdms", as_tdms),
}
"""Formats that hold every number and name as it is."""

OTHER_FORMATS: Mapping[str, tuple[str, Callable[[Path, Table], None]]] = {
    "Excel": ("a.xlsx", as_excel),
    "MCAP": ("a.mcap", as_bag),
    "ROS 1 bag": ("a.bag", as_bag),
    "SQLite bag": ("a.db3", as_bag),
}
"""Formats that round, or name their columns themselves."""


def reversed_columns(table: Table) -> Table:
    return dict(reversed(table.items()))


def with_unknown(table: Table) -> Table:
    return {"other": np.arange(float(len(table[TIME]))), **table}


ARRANGED: Mapping[str, Callable[[Table], Table]] = {
    "": dict,
    "columns reversed": reversed_columns,
    "an unknown column": with_unknown,
}


def differences(file: str) -> Iterator[str]:
    """How the samples of a file differ from the example's."""
    from bayesbl.recording.readers import read_recording

    read = read_recording(file)
    found = {TIME: read.time_s, **read.channels}
    for name, values in example().items():
        if name not in found:
            yield f"{name} is gone"
        elif not np.array_equal(found[name], values):
            yield f"{name} has other samples"


def reading_is_equal(ended: Sequence[Ended]) -> Iterator[Finding]:
    told = ended[-1]
    if told.status != DONE:
        yield OTHER, f"refused: {told.err.strip()[:200]}"
    elif told.answer:
        yield SILENT, f"{told.answer}"


def configure(file: str) -> None:
    Path("config.toml").write_text(CHECKED.format(file=file))


def same_trial(file: str, rng: np.random.Generator) -> Trial:
    configure(file)

    def read() -> object:
        return list(differences(file))

    return Trial([CHECK, read], reading_is_equal, outputs=["result"])


def same_text(change: Text) -> Prepare:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        text = change(plain_csv(example()), rng)
        (place / "a.csv").write_bytes(text.encode() if isinstance(text, str) else text)
        return same_trial("a.csv", rng)

    return prepare


def same_arrays(form: str, arrange: Callable[[Table], Table]) -> Prepare:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        file, write = FORMATS[form]
        write(place / file, arrange(example()))
        return same_trial(file, rng)

    return prepare


# Damage to the bytes may change what a file says; one to its structure must be seen or be harmless.


def damaged(form: str, damage: Damage) -> Prepare:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        file, write = (FORMATS | OTHER_FORMATS)[form]
        write(place / file, example())
        (place / file).write_bytes(damage((place / file).read_bytes(), rng))
        configure(file)
        steps = [FIT if rng.random() < 0.04 else CHECK, ("init", file, "--out", "first.toml")]
        return Trial(steps, names=[file], outputs=["result", "first.toml"])

    return prepare


Judge = Callable[[Sequence[Ended]], Iterator[Finding]]
Lines = Callable[[list[str], np.random.Generator], list[str]]


def some_lines(lines: list[str], rng: np.random.Generator) -> tuple[int, int]:
    start = int(rng.integers(1, len(lines) - 1))
    return start, min(len(lines), start + int(rng.integers(1, 60)))


def doubled(lines: list[str], rng: np.random.Generator) -> list[str]:
    start, end = some_lines(lines, rng)
    return lines[:end] + lines[start:]


def exchanged(lines: list[str], rng: np.random.Generator) -> list[str]:
    first, second = sorted(int(i) for i in rng.integers(1, len(lines), 2))
    lines[first], lines[second] = lines[second], lines[first]
    return lines


def lost(lines: list[str], rng: np.random.Generator) -> list[str]:
    start, end = some_lines(lines, rng)
    return lines[:start] + lines[end:]


def put_in(*texts: str) -> Lines:
    def changed(lines: list[str], rng: np.random.Generator) -> list[str]:
        place = int(rng.integers(1, len(lines)))
        return lines[:place] + list(texts) + lines[place:]

    return changed


def cell(text: str, column: int | None = None) -> Lines:
    """One cell, of the given column or of any, becomes this text."""

    def changed(lines: list[str], rng: np.random.Generator) -> list[str]:
        row = int(rng.integers(1, len(lines)))
        cells = lines[row].split(",")
        cells[int(rng.integers(len(cells))) if column is None else column] = text
        lines[row] = ",".join(cells)
        return lines

    return changed


def header(old: str, new: str) -> Lines:
    return lambda lines, rng: [lines[0].replace(old, new), *lines[1:]]


def all_times(form: Callable[[int], str]) -> Lines:
    def changed(lines: list[str], rng: np.random.Generator) -> list[str]:
        rows = (line.partition(",")[2] for line in lines[1:])
        return [lines[0], *(f"{form(i)},{row}" for i, row in enumerate(rows))]

    return changed


def stamps(first: str) -> Lines:
    """Dates of every 10 ms, from a year that few programs know."""
    return all_times(lambda i: f"{first} 00:00:{i / 100:05.2f}")


def transposed(lines: list[str], rng: np.random.Generator) -> list[str]:
    return [",".join(column) for column in zip(*(line.split(",") for line in lines), strict=True)]


STRUCTURE: Mapping[str, Lines] = {
    "lines doubled": doubled,
    "lines exchanged": exchanged,
    "lines lost": lost,
    "first lines lost": lambda lines, rng: [lines[0], *lines[int(rng.integers(2, 400)) :]],
    "header in the middle": lambda lines, rng: put_in(lines[0])(lines, rng),
    "header missing": lambda lines, rng: lines[1:],
    "header only": lambda lines, rng: lines[:1],
    "header twice": lambda lines, rng: [lines[0], *lines],
    "two files in one": lambda lines, rng: lines + lines[1:],
    "a comment between": put_in("# the machine was stopped here"),
    "a line of text": put_in("stopped"),
    "a short line": put_in("0.5"),
    "a long line": put_in("," * 40),
    "a quote never closed": put_in('"0.5,1,2,3'),
    "an escape character": put_in("\x1b[31mred\x1b[0m"),
    "a NUL": put_in("\0"),
    "an empty cell": cell(""),
    "name of a column gone": header(SPEED, ""),
    "two columns of one name": header(CURRENT, SPEED),
    "an escape in a name": header(CURRENT, "\x1b]0;owned\x07current"),
    "an escape in a name, quoted": header(CURRENT, '"cur\x9brent"'),
    "a name of 10,000 letters": header(CURRENT, "i" * 10_000),
    "transposed": transposed,
    "300,000 columns": lambda lines, rng: [
        ",".join([lines[0], *(f"c{i}" for i in range(300_000))]),
        *lines[1:],
    ],
    "a line of 3 million letters": put_in("x" * 3_000_000),
}
"""What may happen to the lines of a CSV file: it is seen, or changes no sample."""

VALUES: Mapping[str, Lines] = {
    "a cell of text": cell("ERROR"),
    "a huge number": cell("1e308"),
    "a number beyond all": cell("1e999"),
    "a huge whole number": cell("9" * 400),
    "not a number": cell("nan"),
    "infinite": cell("-inf"),
    "hexadecimal": cell("0x1F"),
    "underlined number": cell("1_000"),
    "thousands": cell("1.999,5"),
    "Arabic digits": cell("١٩٩٥"),
    "a huge time": cell("1e300", 0),
    "a negative time": cell("-5", 0),
    "a huge speed": cell("2e153", 2),
    "speed and current exchanged": header(f"{SPEED},{CURRENT}", f"{CURRENT},{SPEED}"),
    "dates from the year 1": stamps("0001-01-01"),
    "dates of the year 9999": stamps("9999-12-31"),
    "dates that do not exist": stamps("2026-02-30"),
    "dates and numbers mixed": cell("2026-01-01 00:00:00", 0),
    "time stands still": all_times(lambda i: "1.0"),
    "time as text": all_times(lambda i: f"T{i}"),
    "time since 1970 in ns": all_times(lambda i: str(1_700_000_000_000_000_000 + i * 10_000_000)),
    "time beyond all": all_times(lambda i: f"{i}e306"),
}
"""What may stand where numbers stood: it is refused, or the samples are others by right."""


def with_lines(change: Lines, judge: Judge) -> Prepare:
    def prepare(place: Path, rng: np.random.Generator) -> Trial:
        lines = change(plain_csv(example()).splitlines(), rng)
        (place / "a.csv").write_bytes(("\n".join(lines) + "\n").encode("utf-8"))
        configure("a.csv")
        steps = [CHECK, ("init", "a.csv", "--out", "first.toml"), unseen]
        return Trial(steps, judge, names=["a.csv"], outputs=["result", "first.toml"])

    return prepare


def unseen() -> object:
    """What is wrong with samples that a damaged file gave without a note, in words."""
    from bayesbl.recording.readers import read_recording

    read = read_recording("a.csv")
    if read.notes or read.excluded is not None:
        return None
    # A column whose name is gone is listed as one that is not used.
    kept = [name for name in example() if name in read.channels]
    true = np.column_stack([example()[name] for name in (TIME, *kept)])
    found = np.column_stack([read.time_s, *(read.channels[name] for name in kept)])
    count = len(found)
    if not any(np.array_equal(found, part) for part in (true[:count], true[-count:])):
        return f"{count} samples of which some are not the recording's, and no note"
    return None


def must_be_seen(ended: Sequence[Ended]) -> Iterator[Finding]:
    if ended[-1].answer:
        yield SILENT, str(ended[-1].answer)


def need_not_be_seen(ended: Sequence[Ended]) -> Iterator[Finding]:
    return iter(())


HARMLESS = Group(
    "recordings, same samples",
    6,
    [
        *((name, same_text(change)) for name, change in SAME.items()),
        *(
            (f"{form} {arranged}".strip(), same_arrays(form, arrange))
            for arranged, arrange in ARRANGED.items()
            for form in FORMATS
        ),
    ],
)
DAMAGED = Group(
    "recordings, damaged",
    12,
    [
        *((name, with_lines(change, must_be_seen)) for name, change in STRUCTURE.items()),
        *((name, with_lines(change, need_not_be_seen)) for name, change in VALUES.items()),
        *(
            (f"{form}: {name}", damaged(form, damage))
            for name, damage in BYTES.items()
            for form in FORMATS | OTHER_FORMATS
        ),
    ],
)
