"""Smooth friction takes the place of sharp friction where it explains what that leaves, not where it fits a little better."""

from __future__ import annotations

import numpy as np
import pytest
from plant_data import Plant, dataset_of, nominal, slide

from sysid.datasets import Dataset
from sysid.gap import find_gap
from sysid.machine import KnownEffect

SHARP = KnownEffect("coulomb_friction", "slide", {"force": 18.0})
SMOOTH = KnownEffect("smooth_coulomb_friction", "slide", {"force": 18.0, "width": 0.15})
SLOW = KnownEffect("smooth_coulomb_friction", "slide", {"force": 18.0, "width": 0.15, "exponent": 1.5})


def measured(*truth: KnownEffect) -> tuple[Dataset, Plant]:
    return dataset_of(nominal(*truth, machine=slide()), 15.0), nominal(machine=slide())


@pytest.mark.slow
@pytest.mark.parametrize("effect", [SMOOTH, SLOW], ids=["tanh", "exponent"])
def test_named_alone_with_its_values(effect: KnownEffect) -> None:
    (found,) = find_gap(*measured(effect)).effects
    assert found.name == "smooth_coulomb_friction"
    assert found.parameters["force"] == pytest.approx(18.0, rel=0.05)
    assert found.parameters["width"] == pytest.approx(0.15, rel=0.05)


@pytest.mark.slow
def test_sharp_friction_keeps_its_name() -> None:
    (found,) = find_gap(*measured(SHARP)).effects
    assert found.name == "coulomb_friction"
    assert found.parameters["force"] == pytest.approx(18.0, rel=0.02)


@pytest.mark.slow
def test_beside_viscous_friction() -> None:
    found = find_gap(*measured(SMOOTH, KnownEffect("viscous_friction", "slide", {"coefficient": 20.0})))
    assert {e.name for e in found.effects} == {"smooth_coulomb_friction", "viscous_friction"}
    viscous = next(e for e in found.effects if e.name == "viscous_friction")
    assert np.mean(list(viscous.parameters.values())) == pytest.approx(20.0, rel=0.1)  # type: ignore[arg-type]
