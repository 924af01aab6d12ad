"""Fixtures for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# Properties are tried on the same examples each run, so that a failure belongs to the change under test;
# `make test-slow` draws new ones (HYPOTHESIS_PROFILE=explore). No deadlines: each test has its time limit.
settings.register_profile("steady", derandomize=True, deadline=None)
settings.register_profile("explore", derandomize=False, deadline=None)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "steady"))

if "PYTEST_XDIST_WORKER" in os.environ:  # one processor each: their threads would wait for each other
    os.environ.setdefault("OMP_NUM_THREADS", "1")

ROOT = Path(__file__).parents[1]


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
