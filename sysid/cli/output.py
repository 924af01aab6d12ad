"""What every verb prints: tables and lines for people on stdout, progress on stderr, JSON for machines."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from sysid.errors import SettingsError
from sysid.files import json_text, written_whole
from sysid.foreign import escaped_json, visible
from sysid.progress import Progress

json_option = click.option(
    "--json",
    "json_file",
    metavar="FILE",
    default=None,
    help="Also write the result as JSON ('-': to stdout, the text to stderr).",
)


#: Characters of one cell of a table.
MAX_CELL = 1000


class Printer:
    """Prints for people; on stderr when stdout carries JSON. What a terminal would obey is written out: ``sysid.foreign``."""

    def __init__(self, json_file: str | None = None) -> None:
        from rich.console import Console

        # A pipe has no width of its own: wide enough that no reference or path is wrapped.
        stream = sys.stderr if json_file == "-" else sys.stdout
        self.console = Console(file=stream, highlight=False, width=None if stream.isatty() else 160)

    def line(self, text: str = "") -> None:
        """One line: a line break in it is written out, since a name with one would forge the next line."""
        self.console.print(visible(text), markup=False, soft_wrap=True)

    def block(self, text: str) -> None:
        """Text of several lines."""
        self.console.print(visible(text, len(text), keep="\n\t"), markup=False, soft_wrap=True)

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]], right: Sequence[int] = ()) -> None:
        """Columns with ``header``; ``right`` numbers the columns that are aligned right."""
        from rich import box
        from rich.table import Table
        from rich.text import Text

        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="bold")
        for number, name in enumerate(header):
            table.add_column(Text(name), justify="right" if number in right else "left", overflow="fold")
        for row in rows:
            table.add_row(*(Text(visible(cell, MAX_CELL)) for cell in row))
        self.console.print(table)


@contextlib.contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """A callable ``progress(done, text)`` that drives a bar on stderr; silent where stderr is no terminal."""
    if not sys.stderr.isatty():
        yield lambda done, text: None
        return
    from rich.console import Console
    from rich.markup import escape
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar

    columns = (
        TextColumn("[bold]{task.fields[title]}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
    )
    with Bar(*columns, TextColumn("{task.description}"), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("", total=1.0, title=escape(visible(title, MAX_CELL)))

        def report(done: float, text: str) -> None:
            bar.update(task, completed=min(max(done, 0.0), 1.0), description=escape(visible(text, MAX_CELL)))

        yield report


def rerun_command(path: Path) -> str:
    """What to type to look at a Rerun file: the viewer comes with the SDK, but its folder need not be on the PATH."""
    beside = Path(sys.executable).with_name("rerun")
    viewer = "rerun" if shutil.which("rerun") or not beside.exists() else os.path.relpath(beside)
    return f"{viewer} {path}"


class PipelineProgress:
    """Runs the stations of a pipeline: a bar while one works, a line with its time when it is done.

    >>> with stations("ingest") as progress:
    ...     dataset = ingest(logs, workspace, progress=progress)
    """

    def __init__(self, out: Printer) -> None:
        self.out = out
        self.seconds: dict[str, float] = {}

    @contextlib.contextmanager
    def __call__(self, name: str) -> Iterator[Progress]:
        begin = time.perf_counter()
        with progress_bar(name) as progress:
            yield progress
        self.seconds[name] = time.perf_counter() - begin
        self.out.line(f"{name:<12} {self.seconds[name]:6.1f} s")


def write_json(json_file: str | Path | None, value: Mapping[str, Any]) -> None:
    """Write ``value`` whole or not at all; numbers that JSON does not have (NaN, infinity) become null.

    Raises:
        SettingsError: the folder of the file does not exist.
    """
    write_json_text(json_file, json_text(value) if json_file is not None else "")


def write_json_text(json_file: str | Path | None, text: str) -> None:
    """:func:`write_json` of text that is JSON already."""
    if json_file is None:
        return
    if json_file == "-":
        click.echo(escaped_json(text), nl=False)
        return
    path = Path(json_file)
    if not path.parent.is_dir():
        raise SettingsError(f"--json {path}", f"no folder {path.parent}", "a file in an existing folder")
    with written_whole(path) as half:
        half.write_text(text, "utf-8")
