"""Progress: one line in a terminal of any width, plain lines elsewhere."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import struct
import subprocess
import sys
import termios
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sysid import progress_bar
from sysid.progress_bar import LINE, PlainLines, cut, rest

SCRIPT = """
import time
from sysid.progress_bar import progress_bar
with progress_bar("train a policy with a very long name, 12 seeds") as progress:
    progress(0.5, "command stage of boom: " + "a very long list of effects, " * 20)
    time.sleep(0.5)
"""


@pytest.mark.parametrize("columns", [80, 60])
def test_in_a_terminal_bar_and_time_stay_on_one_line(columns: int) -> None:
    source, sink = pty.openpty()
    fcntl.ioctl(sink, termios.TIOCSWINSZ, struct.pack("HHHH", 24, columns, 0, 0))
    environment = {**os.environ, "TERM": "xterm"}
    environment.pop("COLUMNS", None)
    process = subprocess.Popen([sys.executable, "-c", SCRIPT], stderr=sink, env=environment)
    os.close(sink)
    seen = b""
    while True:
        try:
            seen += os.read(source, 4096)
        except OSError:
            break
    os.close(source)
    assert process.wait() == 0
    plain = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", seen.decode())
    drawn = [line for line in re.split(r"[\r\n]+", plain) if "50%" in line]
    assert drawn
    assert all(len(line.rstrip()) <= columns for line in drawn)
    assert all(re.search(r"50% +0:00:0\d +command", line) for line in drawn), "share, time and step beside one another"


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time that the lines see."""
    now = [0.0]
    monkeypatch.setattr(progress_bar.time, "monotonic", lambda: now[0])
    return now


def test_without_a_terminal_a_step_is_a_line_and_not_every_update(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    lines = PlainLines("gap")
    for second in range(120):
        clock[0] = float(second)
        for fit in range(50):
            lines.report(second / 120, f"stage {second // 60}: fit {fit}")
        lines.look()
    lines.end(complete=True)
    written = capsys.readouterr().err.splitlines()
    assert [re.search(r"after (\d+) s", line)[1] for line in written] == ["1", "31", "60", "90", "119"]  # type: ignore[index]
    assert written[0].startswith("gap:   1 % after 1 s  stage 0: fit ")
    assert written[1].startswith("gap:  26 % after 31 s, about 89 s left  stage 0: fit ")
    assert written[-1] == "gap: done  after 119 s"


@pytest.mark.parametrize(
    ("done", "seconds", "expected"),
    [
        (0.5, 4.9, ""),  # too early
        (0.04, 60.0, ""),  # too little done to say anything
        (0.8, 6.0, ""),  # short work
        (0.5, 5.0, "about 5 s left"),
        (0.1, 9.0, "about 81 s left"),
        (0.1, 12.0, "about 2 min left"),
        (0.05, 600.0, "about 3 h left"),
        (1.0, 60.0, ""),
        (0.0, 60.0, ""),
    ],
)
def test_the_rest_is_estimated_for_long_work(done: float, seconds: float, expected: str) -> None:
    assert rest(done, seconds) == expected


def test_long_silent_work_gives_a_line_every_half_minute(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    lines = PlainLines("fit")
    lines.report(0.1, "one")
    for second in range(100):
        clock[0] = float(second)
        lines.look()
    assert len(capsys.readouterr().err.splitlines()) == 4


def test_short_work_gives_no_line(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    lines = PlainLines("fit")
    lines.report(0.1, "one")
    clock[0] = 0.9
    lines.report(0.9, "two")
    lines.end(complete=True)
    assert capsys.readouterr().err == ""


def test_a_pipe_gets_no_control_characters() -> None:
    slow = SCRIPT.replace("time.sleep(0.5)", "time.sleep(2.0)")
    done = subprocess.run([sys.executable, "-c", slow], capture_output=True, text=True, check=True)
    assert done.stderr.startswith("train a policy")
    assert not re.search(r"[\x00-\x09\x0b-\x1f]", done.stderr)
    assert max(map(len, done.stderr.splitlines())) <= LINE


@given(st.text(max_size=200), st.integers(1, 100))
def test_cut_text_fits(text: str, width: int) -> None:
    assert len(cut(text, width)) <= width
    assert cut(text, width) == text or cut(text, width).endswith("…")


def test_a_notebook_shows_a_bar_that_is_gone_at_the_end(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn: list[str] = []
    display = SimpleNamespace(
        HTML=str, display=lambda html, display_id: drawn.append(html) or SimpleNamespace(update=drawn.append)
    )
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: SimpleNamespace(kernel=None)))
    monkeypatch.setitem(sys.modules, "IPython.display", display)
    with progress_bar.progress_bar("gap") as progress:
        progress(0.25, "stage <1>")
        progress(0.26, "too soon")
    assert drawn == ["", '<progress value="0.250" max="1"></progress> gap 25 % stage &lt;1&gt;', ""]
    assert capsys.readouterr().err == ""
