"""Fixtures for all tests."""

from __future__ import annotations

import gc
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest
from hypothesis import settings
from read_here import read_here

# Properties are tried on the same examples each run, so that a failure belongs to the change under test;
# `make test-slow` draws new ones (HYPOTHESIS_PROFILE=explore). No deadlines: each test has its time limit.
# What sets no number of its own is tried on an eighth of the examples of the slow tier, which draws new ones.
settings.register_profile("steady", derandomize=True, deadline=None, max_examples=12)
settings.register_profile("explore", derandomize=False, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "steady"))

if "PYTEST_XDIST_WORKER" in os.environ:  # one processor each: their threads would wait for each other
    os.environ.setdefault("OMP_NUM_THREADS", "1")

os.environ.pop("COLUMNS", None)  # of the terminal in which the tests run; tables have the width of a pipe

ROOT = Path(__file__).parents[1]
#: Folders of tests that read many log files and are of something else: not the readers, hostile input or faults.
READ_HERE = ("bench", "cli", "datasets", "fleet", "front", "pipelines", "registry", "reports", "site", "versions", "view")


def pytest_collection_finish() -> None:
    _collect_and_keep()


@pytest.fixture(scope="module", autouse=True)
def _memory_is_given_back() -> Iterator[None]:
    """Files are read in forked processes (:mod:`sysid.confined`), and a fork takes time in proportion to the memory in use.

    Closures in cycles hold the tables of a finished search until the collector finds them, which it seldom seeks to.
    """
    yield
    _collect_and_keep()


def _collect_and_keep() -> None:
    """Free what is in cycles; later collections skip what is left, such as modules, collected tests and compiled code."""
    gc.collect()
    gc.freeze()


@pytest.fixture(scope="session", autouse=True)
def _what_is_kept_stays_kept() -> Iterator[None]:
    """The loop of the runner collects all garbage, freezes the rest and lets go of it at the end, which would undo
    :func:`_collect_and_keep`: every loop in this process would then go through the objects of all tests, for half a second.
    """
    with pytest.MonkeyPatch.context() as patch:
        kept = {name: getattr(gc, name) for name in ("collect", "isenabled", "enable", "disable")}
        patch.setattr("sysid_rl.run.realtime.gc", SimpleNamespace(**kept, freeze=lambda: None, unfreeze=lambda: None))
        yield


@pytest.fixture(scope="module", autouse=True)
def _files_are_read_here(request: pytest.FixtureRequest) -> Iterator[None]:
    """In :data:`READ_HERE` log files are read in this process: a fork for every file takes longer than reading it.

    Not in processes that a test starts; a module decides for itself by ``READS_IN_PROCESSES``. That each reader gives the same
    in a process of its own, and that errors are the same, is tested in ``logs/test_confined.py``.
    """
    folder = request.path.relative_to(ROOT / "tests").parts[0]
    with pytest.MonkeyPatch.context() as patch:
        if not getattr(request.module, "READS_IN_PROCESSES", folder not in READ_HERE):
            for name in ("reader", "inspection"):
                patch.setattr(f"sysid.logs.{name}.confined", read_here)
        yield


@pytest.fixture
def shared_data() -> Path:
    """The folder of real measured data beside the repository; tests that need it skip where it is absent."""
    folder = (ROOT / "../shared/data").resolve()
    if not folder.is_dir():
        pytest.skip("the real data (../shared/data) are not here")
    return folder


@pytest.fixture
def datasets_folder() -> Path:
    """``datasets/`` of this repository."""
    return ROOT / "datasets"


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """One line at the end for each reason for which tests were skipped."""
    places = [report.longrepr for report in terminalreporter.stats.get("skipped", [])]
    reasons = Counter(str(place[2]).removeprefix("Skipped: ") for place in places if isinstance(place, tuple))
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"{count} tests were skipped: {reason}")
