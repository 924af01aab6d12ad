"""Output of all verbs: text and tables on stdout, progress on stderr, JSON."""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import sys
import textwrap
import time
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sysid.errors import SettingsError
from sysid.files import json_text, written_whole
from sysid.foreign import escaped_json, visible
from sysid.progress import Progress
from sysid.progress_bar import progress_bar as progress_bar

if TYPE_CHECKING:
    from sysid.figures import Table

json_option = click.option(
    "--json",
    "json_file",
    metavar="FILE",
    default=None,
    help="Also write the result as JSON ('-': to stdout, the text to stderr).",
)


#: Characters of one cell of a table, and columns of a sentence.
MAX_CELL, WIDTH = 1000, 80


class Printer:
    """Prints text on stdout, or on stderr if stdout carries JSON; control characters are escaped (``sysid.foreign``)."""

    def __init__(self, json_file: str | None = None) -> None:
        from rich.console import Console

        # A pipe has no width: 160 columns, so that references and paths are not wrapped.
        stream = sys.stderr if json_file == "-" else sys.stdout
        self.console = Console(file=stream, highlight=False, width=None if stream.isatty() else 160)

    def line(self, text: str = "") -> None:
        """One line; line breaks in it are escaped, so that a name cannot forge a line."""
        self.console.print(visible(text), markup=False, soft_wrap=True)

    def block(self, text: str) -> None:
        """Text of several lines."""
        self.console.print(visible(text, len(text), keep="\n\t"), markup=False, soft_wrap=True)

    def show(self, found: Table) -> None:
        """A table, or its text where it has no row."""
        if found.rows:
            self.table(found.header, found.rows, found.right)
        elif found.empty:
            self.line(found.empty)

    def entry(self, text: str, bullet: str = "") -> None:
        """A sentence, wrapped to :data:`WIDTH` columns."""
        for line in textwrap.wrap(text, WIDTH, initial_indent=bullet, subsequent_indent=" " * len(bullet)):
            self.line(line.rstrip())

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]], right: Collection[int] = ()) -> None:
        """Columns with ``header``; ``right`` numbers the columns that are aligned right."""
        from rich import box
        from rich.cells import cell_len
        from rich.table import Table
        from rich.text import Text

        cells = [[visible(cell, MAX_CELL) for cell in row] for row in rows]
        widths = [max(map(cell_len, column)) for column in zip(header, *cells, strict=True)]
        if sum(widths) + 3 * len(widths) - 1 <= self.console.width:  # a tenth of the time of a table that has to be folded
            lines = [_aligned(row, widths, right) for row in (header, *cells)]
            blank, rule = " " * (sum(widths) + 3 * len(widths) - 1), "─" * (sum(widths) + 3 * len(widths) - 3)
            for head in (Text(blank), Text(lines[0], "bold"), Text(f" {rule} ")):
                self.console.print(head, soft_wrap=True)
            self.console.file.write("\n".join((*lines[1:], blank, "")))
            return
        table = Table(box=box.SIMPLE_HEAD, pad_edge=False, header_style="bold")
        for number, name in enumerate(header):
            table.add_column(Text(name), justify="right" if number in right else "left", overflow="fold")
        for row in cells:
            table.add_row(*map(Text, row))
        self.console.print(table)


def _aligned(row: Sequence[str], widths: Sequence[int], right: Collection[int]) -> str:
    """The cells of a row side by side, padded to widths in columns of the terminal."""
    from rich.cells import cell_len

    parts = []
    for number, (cell, width) in enumerate(zip(row, widths, strict=True)):
        space = " " * (width - cell_len(cell))
        parts.append(f"{space}{cell}" if number in right else f"{cell}{space}")
    return f" {'   '.join(parts)} "


def rerun_command(path: Path) -> str:
    """The command that shows a Rerun file; the viewer of the SDK need not be on the PATH."""
    beside = Path(sys.executable).with_name("rerun")
    viewer = "rerun" if shutil.which("rerun") or not beside.exists() else os.path.relpath(beside)
    return shlex.join((viewer, str(path)))


def command(*words: object, workspace: str | Path | None = None) -> str:
    """A command to copy: ``sysid [--workspace DIR] WORDS``, quoted as a shell needs it."""
    place = ("--workspace", workspace) if workspace is not None else ()
    return shlex.join(map(str, ("sysid", *place, *words)))


class PipelineProgress:
    """Progress of the steps of a pipeline: a bar while a step runs, then a line with its time.

    >>> with steps("ingest") as progress:
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
    """Write ``value`` atomically; NaN and infinity become null.

    Raises:
        SettingsError: the folder of the file does not exist.
    """
    write_json_text(json_file, json_text(value) if json_file is not None else "")


def write_json_text(json_file: str | Path | None, text: str) -> None:
    """As :func:`write_json`, for JSON text."""
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


def open_standard_streams() -> None:
    """Open closed standard streams on the null device; else a device would get their descriptor and receive printed text."""
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115 - as long as the process


@contextlib.contextmanager
def closed_stdout_ignored(ignore: bool = True) -> Iterator[None]:
    """Printing within to a closed stdout does not change the exit status, unless ``ignore`` is false."""
    try:
        yield
        sys.stdout.flush()
    except (OSError, SystemExit):  # rich raises SystemExit on a broken pipe
        if not ignore:
            raise
        nowhere = os.open(os.devnull, os.O_WRONLY)
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError, ValueError):
                stream.flush()
                continue
            with contextlib.suppress(OSError, ValueError):
                os.dup2(nowhere, stream.fileno())
