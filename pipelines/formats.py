"""Every real file in a folder, inspected, its drafted recipe completed, ingested and loaded, as a user does it.

    .venv/bin/python pipelines/formats.py ../shared/data

writes the table of ``reports/formats/``. Each file that has numbers becomes a version of a machine with one axis: the longest
stream is its joint, or its tool where it is of motion capture; the choice of the number has no meaning. The files are in no
package.
"""

from __future__ import annotations

import re
import sys
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from committed import markdown, write_tables
from sysid.datasets import ingest
from sysid.datasets.draft import draft_recipe
from sysid.errors import SysidError
from sysid.logs.inspection import FieldSummary, FileSummary, StreamSummary, inspect_file
from sysid.logs.readers import is_log

PAGE = Path(__file__).parents[1] / "reports" / "formats" / "README.md"
FOLDERS = ("mocap_files", "mcap_bags", "can_logs")
MACHINE = """\
schema = 1
name = "shown"
rate_hz = {rate}

[[axes]]
name = "axis"
actuation = "velocity"
drives = "joint"
gain = 1.0
limits = [-1e9, 1e9]
"""
#: The grid of the version has the rate of the stream within these limits [Hz].
SLOWEST, FASTEST = 5.0, 1000.0


@dataclass(frozen=True)
class FileResult:
    """One file: what it holds, and what became of it. ``rows`` of the stored table, or why there is none."""

    file: str
    seen: FileSummary | None
    rows: int = 0
    refusal: str = ""


def file_results(data: Path, databases: dict[str, str] | None = None) -> Iterator[FileResult]:
    """All files of the three folders of ``data``. ``databases``: log → DBC beside it, both as ``folder/name``."""
    for folder in FOLDERS:
        for path in sorted((data / folder).iterdir()):
            name = f"{folder}/{path.name}"
            if not is_log(path):
                yield FileResult(name, None, refusal=refusal_of(path))
                continue
            dbc = (databases or {}).get(name)
            seen = inspect_file(path, dbc=data / dbc if dbc is not None else None)
            yield walk(name, path, seen, data / dbc if dbc is not None else None)


def refusal_of(path: Path) -> str:
    """Error message for a file that is no log."""
    try:
        inspect_file(path)
    except SysidError as error:
        return error.found
    return ""


def walk(name: str, path: Path, seen: FileSummary, dbc: Path | None = None) -> FileResult:
    """The file through a drafted recipe to a stored version."""
    best = best_stream(seen)
    if seen.refusal or best is None:
        return FileResult(
            name, seen, refusal=reason(seen.refusal).removeprefix(f"{path.name}: ") or "no numbers in its messages"
        )
    rate = min(max(best.clocks[0].rate_hz, SLOWEST), FASTEST) if best.clocks[0].rate_hz > 0.0 else SLOWEST
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        (folder / path.name).write_bytes(path.read_bytes())  # links out of the folder are refused
        (folder / "machine.toml").write_text(MACHINE.format(rate=rate))
        text = filled_in(draft_recipe([seen]).replace("# machine =", "machine ="), seen, best, dbc)
        if dbc is not None:
            (folder / dbc.name).write_bytes(dbc.read_bytes())
        (folder / "recipe.toml").write_text(text, "utf-8")
        tomllib.loads(text)
        try:
            stored = ingest(folder / path.name, folder / "ws", recipe=folder / "recipe.toml")
        except SysidError as error:
            return FileResult(name, seen, refusal=reason(str(error)).removeprefix(f"{path.name}: axis.joint: "))
        return FileResult(name, seen, rows=sum(len(recording.table) for recording in stored.recordings))


def reason(message: str) -> str:
    """A refusal without the folder it was met in."""
    return re.sub(r"(\S*/)+", "", message).partition("; expected")[0]


def best_stream(seen: FileSummary) -> StreamSummary | None:
    """A body, else a marker, else the longest stream with a field that moves, else the longest."""
    timed = [stream for stream in seen.streams if stream.clocks and stream.fields]
    return max(timed, key=lambda stream: (place(stream), any(map(moves, stream.fields)), stream.samples), default=None)


def place(stream: StreamSummary) -> float:
    """Of a captured pose 2, of a captured position 1, less where it was not always seen; 0 for anything else."""
    names = {field.name for field in stream.fields}
    if stream.clocks[0].name != "capture" or not {"x", "y", "z"} <= names:
        return 0.0
    return ("qw" in names) + 1.0 - 0.5 * max(field.missing for field in stream.fields)


def moves(field: FieldSummary) -> bool:
    return field.high > field.low


def filled_in(draft: str, seen: FileSummary, stream: StreamSummary, dbc: Path | None) -> str:
    """The draft, completed for one signal: only the lines for a choice change."""
    head, _, _ = draft.partition("[streams.signals]" if "[streams.points]" not in draft else "[streams.points]")
    head = re.sub(r'^domain = "mocap"', 'domain = "machine"', head, flags=re.MULTILINE)
    if dbc is not None:
        head = re.sub(r"^# dbc = .*$", f'dbc = "{dbc.name}"', head, flags=re.MULTILINE)
    head = re.sub(r"^# (\[splits\]|fit = )", r"\1", head, flags=re.MULTILINE)
    names = {field.name for field in stream.fields}
    if place(stream):
        kind = "body" if "qw" in names else "marker"
        return f"{head}[streams.points]\ntool = {{ {kind} = {quoted(stream.name)} }}\n"
    field = max(stream.fields, key=lambda field: (moves(field), -field.missing))
    topic = "" if seen.reader in ("csv", "parquet", "mat") else f"topic = {quoted(stream.name)}, "
    # A number in another unit than an angle is scaled to one.
    unit = 'unit = "rad", scale = 0.5' if field.unit else 'unit = "rad"'
    return f'{head}[streams.signals]\n"axis.joint" = {{ {topic}field = {quoted(field.name)}, {unit} }}\n'


def quoted(text: str) -> str:
    """A TOML basic string."""
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def table(found: list[FileResult]) -> str:
    """Markdown, one row a file."""
    head = ("file", "reader", "streams", "longest", "rate [Hz]", "clocks", "became")
    parts = []
    for folder in FOLDERS:
        rows = [[c.replace("|", "\\|") for c in cells(item)] for item in found if item.file.startswith(f"{folder}/")]
        parts.append(f"### `{folder}`\n{markdown(head, rows, 'lllllll')}")
    return "\n\n".join(parts)


def cells(item: FileResult) -> tuple[str, ...]:
    """Cells of the row of a file."""
    name = f"`{item.file.partition('/')[2]}`"
    if item.seen is None:
        return name, "", "", "", "", "", f"refused: {item.refusal}"
    stream = best_stream(item.seen)
    if stream is None:
        return name, item.seen.reader, kinds(item.seen), "", "", "", f"refused: {item.refusal}"
    clock = stream.clocks[0]
    size = f"{stream.samples} in {clock.seconds:.1f} s" if stream.samples > 1 else "1"
    rate = f"{clock.rate_hz:.4g}" if clock.rate_hz > 0.0 else ""
    became = f"{item.rows} rows" if item.rows else f"refused: {item.refusal}"
    if item.seen.losses:
        became += "; said: " + "; ".join(loss.partition(": ")[2] for loss in item.seen.losses[:2])
    stated = "".join(f"; {key} to be stated" for key in item.seen.stated)
    clocks = ", ".join(clock.name for clock in stream.clocks)
    return name, item.seen.reader, kinds(item.seen), size, rate, clocks, became + stated


def kinds(seen: FileSummary) -> str:
    """How many streams of which kind."""
    counted: dict[str, int] = {}
    for stream in seen.streams:
        kind = stream.kind.rpartition("/")[2]
        counted[kind if not kind.startswith("CAN") else "CAN"] = (
            counted.get(kind if not kind.startswith("CAN") else "CAN", 0) + 1
        )
    return ", ".join(f"{count} {kind}".strip() for kind, count in counted.items())


def main(data: Path) -> None:
    found = list(file_results(data))
    write_tables(PAGE, table(found), "pipelines/formats.py")
    whole = sum(item.rows > 0 for item in found)
    print(f"{len(found)} files: {whole} ingested, {len(found) - whole} refused; {PAGE}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
