"""Fixtures for all tests."""

from __future__ import annotations

import gc
import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# Properties are tried on the same examples each run, so that a failure belongs to the change under test;
# `make test-slow` draws new ones (HYPOTHESIS_PROFILE=explore). No deadlines: each test has its time limit.
# What sets no number of its own is tried on a quarter of the examples of the slow tier, which draws new ones.
settings.register_profile("steady", derandomize=True, deadline=None, max_examples=25)
settings.register_profile("explore", derandomize=False, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "steady"))

if "PYTEST_XDIST_WORKER" in os.environ:  # one processor each: their threads would wait for each other
    os.environ.setdefault("OMP_NUM_THREADS", "1")

ROOT = Path(__file__).parents[1]


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
