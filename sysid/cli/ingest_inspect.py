"""``sysid ingest --inspect PATH…``: content of log files, and a drafted recipe. Nothing is stored."""

from __future__ import annotations

import os
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from sysid.cli.output import Printer, command, progress_bar, size_text, write_json
from sysid.errors import InputError, SettingsError
from sysid.files import written_whole

if TYPE_CHECKING:
    from sysid.logs.inspection import ClockSummary, FieldSummary, FileSummary, StreamSummary

#: Largest numbers of listed streams and fields; --json has all.
MAX_STREAMS, MAX_FIELDS = 40, 24
#: Stamps from 1990 on are interpreted as Unix time [ns].
_UNIX = 631_152_000 * 10**9


def inspect_paths(
    paths: Sequence[Path],
    machine: Path | None,
    draft: Path | None,
    reader: str | None,
    dbc: Path | None,
    json_file: str | None,
) -> None:
    """Show every log file below ``paths``, and print the drafted recipe or write it to ``draft``.

    Raises:
        InputError: a path without log files.
        SettingsError: ``draft`` exists already, or the machine description is wrong.
    """
    from dataclasses import asdict

    from sysid.datasets.draft import default_machine, draft_recipe
    from sysid.logs.inspection import inspect_file
    from sysid.machine import load_machine

    if draft is not None and draft.exists():
        raise SettingsError(f"--draft {draft}", "the file exists already", "a new file", "Choose another name.")
    files = log_files(paths, reader)
    machine_path = machine if machine is not None else default_machine(paths)
    description = load_machine(machine_path) if machine_path is not None else None
    summaries = []
    with progress_bar("inspect") as progress:
        for number, path in enumerate(files):
            progress(number / len(files), path.name)
            summaries.append(inspect_file(path, reader, dbc, description.rate_hz if description is not None else None))
    in_folders = any(file not in paths and file.parent not in paths for file in files)
    root = paths[0] if len(paths) == 1 and paths[0].is_dir() else None
    text = draft_recipe(
        summaries, description, _machine_entry(machine_path, draft), _logs_entry(paths, draft), in_folders, root
    )
    if draft is not None:  # before printing, which a pager may end early
        with written_whole(draft) as half:
            half.write_text(text, "utf-8")
    out = Printer(json_file)
    for summary in summaries:
        _show(out, summary)
    if draft is not None:
        out.line(f"drafted {draft}: fill in the parts in <…>, then {command('ingest', 'PATH', '--recipe', draft)}")
    else:
        out.line("A recipe to fill in (--draft R.toml writes it to a file):")
        out.line()
        out.block(text.rstrip())
    write_json(json_file, {"schema": 1, "files": [asdict(summary) for summary in summaries], "recipe": text})


def _machine_entry(machine: Path | None, draft: Path | None) -> str:
    """The path of the machine in the drafted recipe, relative to the recipe."""
    if machine is None:
        return "machine.toml"
    return Path(os.path.relpath(machine, draft.parent if draft is not None else machine.parent)).as_posix()


def _logs_entry(paths: Sequence[Path], draft: Path | None) -> str | None:
    """The folder of the recordings in the drafted recipe; None if it is not below the recipe."""
    if draft is None or len(paths) != 1 or not paths[0].is_dir():
        return None
    relative = Path(os.path.relpath(paths[0], draft.parent)).as_posix()
    return None if relative == "." or relative.startswith("..") else relative


def log_files(paths: Sequence[Path], reader: str | None) -> list[Path]:
    """The log files in ``paths`` and one folder below; with a named ``reader``, also those that only it reads."""
    from sysid.logs.lerobot import data_files, is_lerobot
    from sysid.logs.readers import NAMED, NO_LOGS, is_log

    found: list[Path] = []
    for path in paths:
        if not path.exists():
            raise InputError(path, "no such file or folder", "a log file or a folder of them", "Check the path.")
        if path.is_file():
            found.append(path)
            continue
        if is_lerobot(path):
            found += data_files(path)
            continue
        entries = [entry for pattern in ("*", "*/*") for entry in path.glob(pattern) if entry.is_file()]
        below = [entry for entry in entries if is_log(entry) or NAMED.get(entry.suffix.lower(), "") == reader]
        if not below:
            known = next((entry for entry in entries if entry.suffix.lower() in NO_LOGS), None)
            expected, remedy = "log files in it or one folder below", "Name the file itself."
            if known is not None:
                what, remedy = NO_LOGS[known.suffix.lower()]
                named = NAMED.get(known.suffix.lower())
                remedy = f"Inspect with --reader {named} where it is a log." if named is not None else remedy
                raise InputError(path, f"no log files; {known.name} is {what}", expected, remedy.format(name=known.name))
            raise InputError(path, "no log files", expected, remedy)
        found += sorted(below)
    return list(dict.fromkeys(found))


def _show(out: Printer, file: FileSummary) -> None:
    out.line(f"{file.path}: {file.reader}, {size_text(file.size)}, {_count(len(file.streams), 'stream')}")
    if file.refusal:
        out.line(f"cannot be ingested: {file.refusal}")
    if file.remarks:
        out.line(f"found: {'; '.join(file.remarks)}")
    if file.columns:
        out.line("the recipe must name the columns of a file without a header row; they are numbered here")
    for loss in file.losses:
        out.line(f"lost: {loss}")
    for key, value in file.stated.items():
        if key == "time_unit" and file.time_units:
            units = " or ".join(map(str, file.time_units))
            out.line(f"the recipe must state time_unit: {units} are plausible; shown here with {value!r}")
        else:
            out.line(f"the recipe must state {key}; shown here with {value!r}")
    timed = [stream for stream in file.streams if stream.clocks]
    if timed:
        header = ("stream", "type", "samples", "seconds", "rate [Hz]", "jitter [ms]", "gaps", "clocks")
        out.table(header, [_stream_row(stream) for stream in timed[:MAX_STREAMS]], right=(2, 3, 4, 5))
        if len(timed) > MAX_STREAMS:
            out.line(f"{len(timed) - MAX_STREAMS} more streams")
    fields = [(stream.name, field) for stream in file.streams for field in stream.fields]
    if len(fields) > MAX_FIELDS and any(field.high > field.low for _, field in fields):
        constant = sum(not field.high > field.low for _, field in fields)
        if constant:
            out.line(f"{_count(constant, 'field')} with constant or no numbers not shown")
        fields = [(stream, field) for stream, field in fields if field.high > field.low]
    rows = [(stream, *_field_row(field)) for stream, field in fields]
    if rows:
        out.table(("stream", "field", "unit", "lowest", "highest", "missing"), _thinned(rows), right=(3, 4, 5))
    if len(rows) > MAX_FIELDS:
        out.line(f"{len(rows) - MAX_FIELDS} more fields (--json FILE lists them all)")
        out.line()


def _thinned(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The first rows, with the name of a stream only in its first row."""
    shown = rows[:MAX_FIELDS]
    return [("" if number and shown[number - 1][0] == row[0] else row[0], *row[1:]) for number, row in enumerate(shown)]


def _stream_row(stream: StreamSummary) -> tuple[str, ...]:
    first = stream.clocks[0]
    gaps = "none" if not first.gaps else f"{first.gaps}, longest {first.longest_gap_s:.3g} s at {first.longest_gap_at_s:.1f} s"
    if first.backwards:
        gaps += f"; {first.backwards} backward steps"
    clocks = "; ".join(_clock(clock) for clock in stream.clocks)
    steady = (f"{first.rate_hz:.2f}", f"{1e3 * first.jitter_s:.2f}") if first.rate_hz > 0.0 else ("", "")
    numbers = (f"{first.seconds:.1f}", *steady)
    return (stream.name, stream.kind, str(stream.samples), *numbers, gaps, clocks)


def _clock(clock: ClockSummary) -> str:
    if clock.behind_s is None:
        begin = datetime.fromtimestamp(clock.first_ns * 1e-9, UTC).isoformat(" ", "seconds") if clock.first_ns > _UNIX else ""
        return f"{clock.name} from {begin[:19] or f'{clock.first_ns * 1e-9:.6g} s'}"
    middle, low, high = clock.behind_s
    if abs(middle) > 3600.0:
        return f"{clock.name} with another epoch"
    return f"{clock.name} {1e3 * middle:+.2f} ms ({1e3 * low:+.2f} … {1e3 * high:+.2f})"


def _field_row(field: FieldSummary) -> tuple[str, ...]:
    return (
        field.name,
        field.unit or "",
        f"{field.low:.6g}",
        f"{field.high:.6g}",
        f"{100.0 * field.missing:.1f} %" if field.missing else "",
    )


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"
