"""``sysid ingest --inspect PATH…``: content of log files, and a drafted recipe; ``--propose-frame``. Nothing is stored."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sysid.cli.output import Printer, command, progress_bar
from sysid.display import quantity, size_text
from sysid.errors import SettingsError
from sysid.files import written_whole

if TYPE_CHECKING:
    from sysid.datasets.frames.survey import SurveyResult
    from sysid.logs.inspection import ClockSummary, FieldSummary, FileSummary, StreamSummary


#: Largest numbers of listed streams, fields and losses; --json has all.
MAX_STREAMS, MAX_FIELDS, MAX_LOSSES = 40, 24, 12
#: Stamps from 1990 on are interpreted as Unix time [ns].
_UNIX = 631_152_000 * 10**9


def inspect_paths(
    paths: Sequence[Path],
    machine: Path | None,
    draft: Path | None,
    reader: str | None,
    dbc: Path | None,
    out: Printer,
) -> None:
    """Show every log file below ``paths``, those of one layout together, and print the drafted recipe or write it to ``draft``.

    Raises:
        InputError: a path without log files.
        SettingsError: ``draft`` exists already, or the machine description is wrong.
    """
    from sysid.datasets.draft import default_machine, draft_recipe, missing_strokes
    from sysid.datasets.layouts import alike
    from sysid.logs.inspection import inspect_file, log_files
    from sysid.machine import load_machine

    if draft is not None and draft.exists():
        raise SettingsError(f"--draft {draft}", "the file exists already", "a new file", "Choose another name.")
    files = log_files(paths, reader)
    machine_path = machine if machine is not None else default_machine(paths)
    description = load_machine(machine_path, unfinished=True) if machine_path is not None else None
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
    for group in alike(summaries):
        _show(out, group)
    needed = missing_strokes(summaries, description) if description is not None else []
    for line in needed:
        out.line(line)
    if draft is not None:
        out.line(f"drafted {draft}: fill in the parts in <…>, then {command('ingest', 'PATH', '--recipe', draft)}")
    else:
        out.line("A recipe to fill in (--draft R.toml writes it to a file):")
        out.line()
        out.block(text.rstrip())
    files_ = [asdict(summary) for summary in summaries]
    out.json({"schema": 1, "files": files_, "machine_needs": needed, "recipe": text})


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


def _show(out: Printer, group: Sequence[FileSummary]) -> None:
    """One file, or the files of one layout: what differs between them is summed up, or given as a range."""
    from sysid.datasets.layouts import merged

    file = merged(group) if len(group) > 1 else group[0]
    place = str(file.path) if len(group) == 1 else f"{len(group)} files of one layout, {file.path} … {group[-1].path.name}"
    size = size_text(sum(one.size for one in group))
    counts = sorted({len(one.streams) for one in group})
    streams = _count(counts[0], "stream") if len(counts) == 1 else f"{counts[0]} to {counts[-1]} streams"
    out.line(f"{place}: {file.reader}, {size}, {streams}{' each' if len(group) > 1 else ''}")
    if file.refusal:
        out.line(f"cannot be ingested: {file.refusal}")
    if file.remarks:
        out.line(f"found: {'; '.join(file.remarks)}")
    if file.columns:
        out.line("the recipe must name the columns of a file without a header row; they are numbered here")
    losses = [loss for one in group for loss in one.losses]
    for loss in losses[:MAX_LOSSES]:
        out.line(f"lost: {loss}")
    if len(losses) > MAX_LOSSES:
        out.line(f"lost: {len(losses) - MAX_LOSSES} more of these (--json FILE lists them all)")
    for key, value in file.stated.items():
        if key == "time_unit" and file.time_units:
            units = " or ".join(map(str, file.time_units))
            out.line(f"the recipe must state time_unit: {units} are plausible; shown here with {value!r}")
        else:
            out.line(f"the recipe must state {key}; shown here with {value!r}")
    timed: dict[str, list[StreamSummary]] = {}
    for one in group:
        for stream in one.streams if any(stream.clocks for stream in file.streams) else ():
            timed.setdefault(stream.name if len(one.streams) > 1 or len(group) == 1 else "", []).append(stream)
    if timed:
        header = ("stream", "type", "samples", "seconds", "rate [Hz]", "jitter [ms]", "gaps", "clocks")
        rows = [_stream_row(streams) for streams in timed.values()]
        out.table(header, rows[:MAX_STREAMS], right=(2, 3, 4, 5))
        if len(timed) > MAX_STREAMS:
            out.line(f"{len(timed) - MAX_STREAMS} more streams")
    together = len(group) > 1 and counts == [1]
    fields = [("all" if together else stream.name, field) for stream in file.streams for field in stream.fields]
    if len(fields) > MAX_FIELDS and any(field.high > field.low for _, field in fields):
        constant = sum(not field.high > field.low for _, field in fields)
        if constant:
            out.line(f"{_count(constant, 'field')} with constant or no numbers not shown")
        fields = [(stream, field) for stream, field in fields if field.high > field.low]
    table = [(stream, *_field_row(field)) for stream, field in fields]
    out.table(("stream", "field", "unit", "lowest", "highest", "missing"), _thinned(table), right=(3, 4, 5))
    if len(table) > MAX_FIELDS:
        out.line(f"{len(table) - MAX_FIELDS} more fields (--json FILE lists them all)")
        out.line()


def _thinned(rows: list[tuple[str, ...]]) -> list[tuple[str, ...]]:
    """The first rows, with the name of a stream only in its first row."""
    shown = rows[:MAX_FIELDS]
    return [("" if number and shown[number - 1][0] == row[0] else row[0], *row[1:]) for number, row in enumerate(shown)]


def _stream_row(streams: Sequence[StreamSummary]) -> tuple[str, ...]:
    """A row for a stream of one file, or of several: sums, ranges, and the worst gap."""
    firsts = [stream.clocks[0] for stream in streams]
    worst = max(firsts, key=lambda clock: clock.longest_gap_s if clock.gaps else 0.0)
    count, backwards = sum(clock.gaps for clock in firsts), sum(clock.backwards for clock in firsts)
    gaps = "none" if not count else f"{count}, longest {worst.longest_gap_s:.3g} s at {worst.longest_gap_at_s:.1f} s"
    if backwards:
        gaps += f"; {backwards} backward steps"
    rates = [clock.rate_hz for clock in firsts if clock.rate_hz > 0.0]
    jitter = [1e3 * clock.jitter_s for clock in firsts if clock.rate_hz > 0.0]
    seconds = f"{sum(clock.seconds for clock in firsts):.1f}"
    if len(streams) == 1:
        clocks = "; ".join(_clock(clock) for clock in streams[0].clocks)
    else:
        seconds += f" ({_range([clock.seconds for clock in firsts], 1)} each)"
        clocks = ", ".join(clock.name for clock in streams[0].clocks)
    name = streams[0].name if len({stream.name for stream in streams}) == 1 else _count(len(streams), "recording")
    samples = str(sum(stream.samples for stream in streams))
    return (name, streams[0].kind, samples, seconds, _range(rates, 2), _range(jitter, 2), gaps, clocks)


def _range(values: Sequence[float], digits: int) -> str:
    """The value, or the smallest and the largest; empty without values."""
    texts = [f"{end:.{digits}f}" for end in (min(values), max(values))] if values else [""]
    return " … ".join(dict.fromkeys(texts))


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


def propose(paths: Sequence[Path], machine: Path | None, recipe: Path | None, out: Printer) -> None:
    """Print a ``[streams.frame]`` for every survey in the recipe.

    Raises:
        SettingsError: no recipe, no survey in it, or no machine.
        InputError: a survey that does not determine the frame.
    """
    from sysid.datasets.draft import default_machine
    from sysid.datasets.frames.survey import propose_frames
    from sysid.datasets.recipe import check_against_machine, load_recipe
    from sysid.machine import load_machine

    recipe = recipe if recipe is not None else next((p / "recipe.toml" for p in paths if (p / "recipe.toml").is_file()), None)
    if recipe is None:
        raise SettingsError("--propose-frame", "no recipe", "a recipe with [streams.survey]", "Name it with --recipe.")
    rules = load_recipe(recipe)
    named = recipe.parent / rules.machine if rules.machine is not None else None
    machine = machine if machine is not None else named if named is not None else default_machine([*paths, recipe])
    if machine is None:
        raise SettingsError(
            recipe, "no machine description", "machine.toml", "Give one with --machine, or name it in the recipe."
        )
    description = load_machine(machine)
    check_against_machine(rules, description, recipe)
    found = propose_frames(paths, rules, description, recipe)
    for item in found:
        _show_frame(out, item)
    out.json({"schema": 1, "frames": [_plain(item) for item in found]})


def _show_frame(out: Printer, item: SurveyResult) -> None:
    proposal = item.proposal
    what = "static markers" if proposal.method == "markers" else "rotating points"
    left = f"residual {quantity(proposal.rms_m, 'm')} RMS, {quantity(proposal.max_m, 'm')} maximum"
    out.line(f"{item.source}: from {len(proposal.names)} {what} ({', '.join(proposal.names)}): {left}")
    rows = [
        (axis, quantity(place, "m", 4), _half(place95, "m"), quantity(turn, "rad", 4), _half(turn95, "rad"))
        for axis, place, place95, turn, turn95 in zip(
            "xyz", proposal.frame.translation, proposal.translation95, proposal.frame.rpy, proposal.rotation95, strict=True
        )
    ]
    out.table(("base axis", "place", "± 95 %", "rpy", "± 95 % about the axis"), rows, right=(1, 2, 3, 4))
    for text in proposal.open:
        out.line(f"open: {text}")
    for text in proposal.notes:
        out.line(f"note: {text}")
    of = "frame" if proposal.method == "markers" else "axis"
    out.line(f"The recipe's own {of} differs by {quantity(item.moved_m, 'm')} and {quantity(item.turned_rad, 'rad')}.")
    out.line("To use it, copy these lines to the recipe:")
    out.line()
    out.block(proposal.lines)
    out.line()


def _half(value: float, unit: str) -> str:
    return quantity(value, unit, 2) if math.isfinite(value) else "open"


def _plain(item: SurveyResult) -> dict[str, Any]:
    values = asdict(item.proposal)
    for key in ("translation95", "rotation95"):
        values[key] = [value if math.isfinite(value) else None for value in values[key]]
    differs = {"moved_m": item.moved_m, "turned_rad": item.turned_rad}
    return {"source": str(item.source), **values, "lines": item.proposal.lines, **differs}
