"""Progress of long work: a bar in a notebook; on stderr one line that is redrawn in a terminal, plain lines elsewhere."""

from __future__ import annotations

import contextlib
import importlib
import sys
import threading
import time
from collections.abc import Iterator
from typing import Any

from sysid.foreign import visible
from sysid.progress import Progress

#: Characters of the title beside the bar, of the bar, and of a line without a terminal.
TITLE, BAR, LINE = 18, 14, 118
#: Without a terminal: seconds between two lines at least, and at most while something runs.
SOONEST_S, LATEST_S = 1.0, 30.0
#: Seconds between two drawings of the bar of a notebook, at least.
REDRAWN_S = 0.2
#: The rest is estimated after so many seconds and this share of the work, where the whole takes this long [s].
ESTIMATED_S, ESTIMATED_SHARE, LONG_S = 5.0, 0.05, 10.0
#: How often the plain lines look for something to print [s].
_POLL_S = 0.5


@contextlib.contextmanager
def progress_bar(title: str) -> Iterator[Progress]:
    """A callback that shows progress: in a notebook below the cell, which is empty again at the end; else on stderr.

    In a terminal a bar, the time, an estimate of the rest (:func:`rest`) and the current step stay on one line of any width.
    Elsewhere (pipe, CI) every new step is a line, at most one a second, and at least one every half minute; without control
    characters.
    """
    kind = _notebook if in_notebook() else _bar if sys.stderr.isatty() else _lines
    with kind(title) as progress:
        yield progress


def in_notebook() -> bool:
    """Whether this is the process of a notebook: an IPython shell with a kernel."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")


@contextlib.contextmanager
def _notebook(title: str) -> Iterator[Progress]:
    from html import escape

    notebook: Any = importlib.import_module("IPython.display")
    drawn, shown = notebook.display(notebook.HTML(""), display_id=True), 0.0

    def report(done: float, text: str) -> None:
        nonlocal shown
        if time.monotonic() - shown >= REDRAWN_S:
            shown = time.monotonic()
            words = escape(f"{visible(title, LINE)} {100.0 * done:.0f} % {visible(text, LINE)}")
            drawn.update(notebook.HTML(f'<progress value="{done:.3f}" max="1"></progress> {words}'))

    try:
        yield report
    finally:
        drawn.update(notebook.HTML(""))


def rest(done: float, seconds: float) -> str:
    """How long the rest of the work takes if it goes on as in the ``seconds`` until now; empty for short work and at first."""
    left = seconds * (1.0 - done) / done if done >= ESTIMATED_SHARE else 0.0
    if left <= 0.0 or seconds < ESTIMATED_S or seconds + left < LONG_S:
        return ""
    size, unit = next((pair for pair in ((3600.0, "h"), (60.0, "min")) if left >= 1.5 * pair[0]), (1.0, "s"))
    return f"about {max(left / size, 1.0):.0f} {unit} left"


@contextlib.contextmanager
def _bar(title: str) -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bar
    from rich.table import Column

    def text_column(text: str, ratio: int | None = None) -> TextColumn:
        column = Column(no_wrap=True, overflow="ellipsis", ratio=ratio)
        return TextColumn(text, markup=False, table_column=column)

    columns = (
        text_column("{task.fields[title]}"),
        BarColumn(BAR),
        text_column("{task.percentage:>3.0f}%"),
        TimeElapsedColumn(),
        text_column("{task.fields[rest]}"),
        text_column("{task.description}", ratio=1),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True, expand=True) as bar:
        task = bar.add_task("", total=1.0, title=cut(visible(title, LINE), TITLE), rest="")
        begin = time.monotonic()

        def report(done: float, text: str) -> None:
            share = min(max(done, 0.0), 1.0)
            bar.update(task, completed=share, description=visible(text, LINE), rest=rest(share, time.monotonic() - begin))

        yield report


@contextlib.contextmanager
def _lines(title: str) -> Iterator[Progress]:
    lines = PlainLines(title)
    over = threading.Event()

    def watch() -> None:
        while not over.wait(_POLL_S):
            lines.look()

    thread = threading.Thread(target=watch, name="progress", daemon=True)
    thread.start()
    try:
        yield lines.report
    finally:
        over.set()
        thread.join()
        lines.end(complete=sys.exc_info()[0] is None)


class PlainLines:
    """Decides which updates become lines."""

    def __init__(self, title: str) -> None:
        self.title = title
        self._begin = self._printed = time.monotonic()
        self._lock = threading.Lock()
        self._done, self._text, self._shown = 0.0, "", set[str]()
        self._new = self._any = False

    def report(self, done: float, text: str) -> None:
        """An update; its step is what precedes a colon."""
        with self._lock:
            self._done, self._text = done, text
            step = text.partition(": ")[0]
            if step and step not in self._shown:
                self._shown.add(step)
                self._new = True
        self.look()

    def look(self) -> None:
        """Print a line if one is due."""
        with self._lock:
            since = time.monotonic() - self._printed
            if (self._new and since >= SOONEST_S) or since >= LATEST_S:
                self._print(f"{100.0 * self._done:3.0f} %", self._text)

    def end(self, complete: bool) -> None:
        """The last line, if there was one before."""
        with self._lock:
            if self._any:
                self._print("done " if complete else "ended", "")

    def _print(self, share: str, text: str) -> None:
        seconds = time.monotonic() - self._begin
        with contextlib.suppress(OSError, ValueError):  # nobody reads it any more
            left = f", {left}" if text and (left := rest(self._done, seconds)) else ""
            line = f"{visible(self.title, LINE)}: {share} after {seconds:.0f} s{left}  {visible(text, LINE)}"
            sys.stderr.write(f"{cut(line.rstrip(), LINE)}\n")
            sys.stderr.flush()
        self._printed, self._new, self._any = time.monotonic(), False, True


def cut(text: str, width: int) -> str:
    """``text`` with an ellipsis in place of what is longer than ``width`` characters."""
    return text if len(text) <= width else f"{text[: width - 1]}…"
