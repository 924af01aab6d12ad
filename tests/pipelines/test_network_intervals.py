"""The counted intervals of networks: the page shows the committed figures, and what they say is checked."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def counted(pipeline: Callable[[str], ModuleType]) -> tuple[ModuleType, dict[str, list[dict[str, dict[str, object]]]]]:
    models = json.loads((ROOT / "reports/network_intervals/result.json").read_text())["models"]
    return pipeline("network_intervals"), models


def test_the_page_shows_the_committed_figures(counted: tuple[ModuleType, dict]) -> None:  # type: ignore[type-arg]
    module, models = counted
    assert module.tables(models) in (ROOT / "reports/networks/README.md").read_text()


def test_intervals_hold_as_often_as_they_say_on_poses_like_those_learned_from(counted: tuple[ModuleType, dict]) -> None:  # type: ignore[type-arg]
    module, models = counted
    for runs in models.values():
        for level in module.LEVELS:
            held = np.mean([run["like"]["held"][f"{level:g}"]["all"] for run in runs])
            assert held == pytest.approx(level, abs=0.07 if level < 0.9 else 0.03)
        assert np.mean([run["like"]["flagged"] for run in runs]) < 0.02
        assert np.mean([run["beyond"]["flagged"] for run in runs]) > 0.99


@pytest.mark.slow
def test_one_model_is_judged_again(counted: tuple[ModuleType, dict]) -> None:  # type: ignore[type-arg]
    """Where the data are depends on the poses alone: the same are flagged again."""
    from sysid.machine import load_machine
    from sysid.networks import ForwardRecipe

    module, models = counted
    machine = load_machine(ROOT / "datasets" / "autolog" / "machine.toml")
    again = module.evaluated(machine, ForwardRecipe(model="structured", residual=False), 0)
    assert again["like"]["flagged"] == pytest.approx(models["structured"][0]["like"]["flagged"], abs=5e-3)
    assert again["like"]["held"]["0.95"]["all"] > 0.9
