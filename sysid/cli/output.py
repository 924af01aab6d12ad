"""Output of all verbs: text and tables on stdout, progress on stderr, JSON."""

from __future__ import annotations

import contextlib
import os
import shlex
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from sysid.errors import SettingsError
from sysid.figures import Table
from sysid.files import json_text, written_whole
from sysid.foreign import escaped_json, visible
from sysid.progress import Progress
from sysid.progress_bar import progress_bar as progress_bar

if TYPE_CHECKING:
    from rich.console import Console

#: Types of options and arguments: any path, a file, a folder.
PATH = click.Path(path_type=Path)
FILE = click.Path(dir_okay=False, path_type=Path)
FOLDER = click.Path(file_okay=False, path_type=Path)
#: Columns of a sentence.
WIDTH = 80


class Printer:
    """Prints text on stdout, or on stderr if stdout carries JSON; control characters are escaped (``sysid.foreign``).

    Args:
        json_file: as of :func:`write_json`.
    """

    def __init__(self, json_file: str | None = None) -> None:
        self.json_file = json_file

    @cached_property
    def console(self) -> Console:
        """Made for the first line, since a verb may open the standard streams before."""
        from rich.console import Console

        # A pipe has no width but that of COLUMNS: else 160 columns, so that references and paths are not wrapped.
        stream = sys.stderr if self.json_file == "-" else sys.stdout
        known = stream.isatty() or os.environ.get("COLUMNS", "").isdigit()
        return Console(file=stream, highlight=False, width=None if known else 160)

    def line(self, text: str = "") -> None:
        """One line; line breaks in it are escaped, so that a name cannot forge a line."""
        self.console.print(visible(text), markup=False, soft_wrap=True)

    def block(self, text: str) -> None:
        """Text of several lines."""
        self.console.print(visible(text, len(text), keep="\n\t"), markup=False, soft_wrap=True)

    def show(self, found: Table) -> None:
        """A table, or its text where it has no row."""
        from rich.text import Text

        if not found.rows:
            if found.empty:
                self.line(found.empty)
            return
        lines, head = found.text(self.console.width)
        for number, line in enumerate(lines[: head.stop + 1]):
            self.console.print(Text(line, "bold" if number in head else ""), soft_wrap=True)
        self.console.file.write("".join(f"{line}\n" for line in lines[head.stop + 1 :]))

    def table(self, header: Sequence[str], rows: Sequence[Sequence[object]], right: Collection[int] = ()) -> None:
        """Columns with ``header``, if there are rows; ``right`` numbers the columns that are aligned right."""
        self.show(Table(tuple(header), rows, right))

    def json(self, value: Mapping[str, Any]) -> None:
        """Write the result as JSON, where a file for it is named."""
        write_json(self.json_file, value)

    def entry(self, text: str, bullet: str = "") -> None:
        """A sentence, wrapped to :data:`WIDTH` columns between its words."""
        for line in textwrap.wrap(
            text,
            WIDTH,
            initial_indent=bullet,
            subsequent_indent=" " * len(bullet),
            break_long_words=False,
            break_on_hyphens=False,
        ):
            self.line(line.rstrip())


json_option = click.option(
    "--json",
    "out",
    metavar="FILE",
    callback=lambda context, parameter, value: Printer(value),
    help="Also write the result as JSON ('-': to stdout, the text to stderr).",
)


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


workers_option = click.option(
    "--workers", type=click.IntRange(1), default=1, show_default=True, help="Processes on this machine."
)


def cluster_option(describes: str = "Address of a Dask scheduler, as tcp://HOST:PORT.") -> Callable[[Any], Any]:
    """``--cluster`` and ``--trusted-network``; ``describes``: help of the first."""
    address = click.option("--cluster", envvar="SYSID_CLUSTER", metavar="ADDRESS", help=describes)
    trusted = click.option(
        "--trusted-network",
        envvar="SYSID_TRUSTED_NETWORK",
        is_flag=True,
        help="Accept a scheduler without TLS on another computer: any computer of the network can then run programs here.",
    )
    return lambda command: address(trusted(command))


def long_arrays_beside(location: str) -> None:
    """Until the command ends, large arrays are in a scratch file beside the workspace, or in memory where it has no room."""
    from sysid.datasets.versions.files import scratch_folder
    from sysid.scratch import scratch_in

    click.get_current_context().with_resource(scratch_in(scratch_folder(location), required=False))
