"""One wrong force constant is one name where friction is described, and an alias of the inertia where it is not."""

from __future__ import annotations

import pytest
from plant_data import dataset_of, nominal, slide

from sysid.gap import find_gap
from sysid.gap.result import GapResult
from sysid.machine import KnownEffect

COULOMB = KnownEffect("coulomb_friction", "slide", {"force": 18.0})
VISCOUS = KnownEffect("viscous_friction", "slide", {"coefficient": 35.0})
CONSTANT = KnownEffect("force_constant_error", "slide", {"ratio": 0.85})


def searched(known: tuple[KnownEffect, ...], *truth: KnownEffect, seconds: float = 8.0) -> GapResult:
    """The result of a simulation that knows ``known``, on recordings of a machine with ``truth``."""
    return find_gap(dataset_of(nominal(*truth, machine=slide()), seconds), nominal(*known, machine=slide()))


def test_it_takes_the_place_of_inertia_and_friction() -> None:
    (found,) = searched((COULOMB, VISCOUS), COULOMB, VISCOUS, CONSTANT).effects
    assert (found.name, found.aliases) == ("force_constant_error", ())
    assert found.parameters["ratio"] == pytest.approx(0.85, rel=5e-3)


@pytest.mark.slow
def test_beside_a_friction_that_is_wrong_too() -> None:
    stronger = KnownEffect("coulomb_friction", "slide", {"force": 30.0})
    found = {e.name: e for e in searched((COULOMB, VISCOUS), stronger, VISCOUS, CONSTANT, seconds=15.0).effects}
    assert set(found) == {"force_constant_error", "coulomb_friction"}
    assert found["coulomb_friction"].parameters["force"] == pytest.approx(30.0, rel=0.02)


@pytest.mark.slow
def test_without_described_friction_it_is_an_alias() -> None:
    """Inertia and friction over the constant explain the same recordings: the name is that of the inertia."""
    result = searched((), COULOMB, VISCOUS, CONSTANT)
    found = {e.name: e for e in result.effects}
    assert set(found) == {"inertia_error", "coulomb_friction", "viscous_friction"}
    assert found["inertia_error"].aliases == (("force_constant_error", "slide"),)
    assert found["inertia_error"].parameters["ratio"] == pytest.approx(1.0 / 0.85, rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    "truth",
    [
        (COULOMB, VISCOUS, KnownEffect("inertia_error", "slide", {"ratio": 1.2})),
        (KnownEffect("coulomb_friction", "slide", {"force": 24.0}), VISCOUS),
        (COULOMB, KnownEffect("viscous_friction", "slide", {"coefficient": 60.0})),
    ],
    ids=["inertia", "coulomb", "viscous"],
)
def test_one_wrong_part_keeps_its_name(truth: tuple[KnownEffect, ...]) -> None:
    changed = next(item for item in truth if item not in (COULOMB, VISCOUS))
    (found,) = searched((COULOMB, VISCOUS), *truth).effects
    assert (found.name, found.aliases) == (changed.name, ())


@pytest.mark.slow
@pytest.mark.parametrize("velocity", [0.08, 0.15])
def test_stribeck_friction_of_a_wide_film(velocity: float) -> None:
    """At speeds of joints: every interval contains the truth."""
    truth = {"static_force": 40.0, "coulomb_force": 16.0, "stribeck_velocity": velocity}
    result = searched((VISCOUS,), KnownEffect("stribeck_friction", "slide", dict(truth)), VISCOUS, seconds=15.0)
    (found,) = (e for e in result.effects if e.name == "stribeck_friction")
    for name, value in truth.items():
        low, high = found.interval95[name]
        assert low <= value <= high, f"{name}: {low:.4g} to {high:.4g}"
