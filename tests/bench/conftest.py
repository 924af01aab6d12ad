"""The shipped bench recipe, whole and cut down to what a test needs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from simulated_bench import BenchRecipe, RecordingSettings, Run, load_recipe, simulate

AUTOLOG = Path(__file__).parents[2] / "datasets" / "autolog"


@pytest.fixture(scope="session")
def recipe() -> BenchRecipe:
    return load_recipe(AUTOLOG / "bench.toml")


@pytest.fixture(scope="session")
def manual(recipe: BenchRecipe) -> Run:
    """The first shipped recording by hand."""
    return simulate(recipe, "manual-01")


@pytest.fixture(scope="session")
def routine(recipe: BenchRecipe) -> Run:
    """A short calibration routine."""
    return simulate(recipe, RecordingSettings("poses", seed=7, poses=25))


@pytest.fixture(scope="session")
def short(recipe: BenchRecipe) -> BenchRecipe:
    """Two short recordings, with everything that can go wrong in them."""
    capture = replace(recipe.capture, dropouts_per_minute=20.0, swaps=(), exported_markers=())
    recordings = (RecordingSettings("drive", seed=1, seconds=12.0), RecordingSettings("poses", seed=2, poses=3))
    return replace(recipe, recordings=recordings, capture=capture)
