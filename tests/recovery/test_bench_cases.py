"""The simulated test bench, which shares no code with the plant: what its logs hide is named, else nothing is."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from simulated_bench import load_recipe, without_hidden, write_all
from sysid.datasets import Dataset, ingest
from sysid.gap import GapResult, find_gap
from sysid.networks import NetworkRecipe, fit_actuator
from sysid.plant import nominal_plant

AUTOLOG = Path(__file__).parents[2] / "datasets" / "autolog"

pytestmark = pytest.mark.slow


def gap_of(dataset: Dataset) -> GapResult:
    return find_gap(dataset, nominal_plant(dataset.machine, fit_actuator(dataset, NetworkRecipe())))


def test_shipped_logs_hide_exactly_three_effects(tmp_path: Path) -> None:
    result = gap_of(ingest(AUTOLOG, tmp_path))
    truth = json.loads((AUTOLOG / "logs" / "truth.json").read_text("utf-8"))
    hidden = {(entry["name"], entry["target"]): entry["parameters"] for entry in truth["effects"] if entry["hidden"]}
    assert {(e.name, e.target) for e in result.effects} == set(hidden)
    for effect in result.effects:
        for key, value in hidden[effect.name, effect.target].items():
            assert effect.parameters[key] == pytest.approx(value, rel=0.1), f"{effect.name}: {key}"


@pytest.mark.parametrize("seed", [None, 1000])
def test_nothing_is_named_where_nothing_is_hidden(tmp_path: Path, seed: int | None) -> None:
    """The same machine without its hidden effects, once with the shipped recordings' seeds and once with others."""
    recipe = without_hidden(load_recipe(AUTOLOG / "bench.toml"))
    if seed is not None:
        other = tuple(replace(r, seed=r.seed + seed) for r in recipe.recordings)
        recipe = replace(recipe, seed=recipe.seed + seed, recordings=other)
    write_all(recipe, tmp_path / "logs")
    result = gap_of(ingest(tmp_path / "logs", tmp_path / "workspace", AUTOLOG / "machine.toml", AUTOLOG / "recipe.toml"))
    assert [(e.name, e.target, dict(e.parameters)) for e in result.effects] == []
    assert result.ambiguous == ()
