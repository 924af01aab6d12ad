"""A card from a result of the workflow, values beside those of a card, and the cards that ship, made again."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from sysid.actuators import card_named
from sysid.actuators.make import alone
from sysid.actuators.words import compared, comparison_table
from sysid.effects.units import parameter_unit
from sysid.gap.result import WrittenEffect
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import Plant, PlantNumber, Uncertainty, nominal_plant

URDF = """<robot name="r"><link name="base"/>
<link name="arm"><inertial><origin xyz="0 0 -0.1"/><mass value="0.5"/>
<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 -1 0"/>
<limit lower="-3" upper="3" effort="1" velocity="20"/></joint></robot>"""
MACHINE = """schema = 1
name = "r"
rate_hz = 100.0
urdf = "r.urdf"
tip = "arm"
[[axes]]
name = "arm"
joint = "j"
actuation = "force"
drives = "joint"
"""


def arm(rotor: float) -> Plant:
    plant = nominal_plant(machine_from_files({"machine.toml": MACHINE, "r.urdf": URDF}, "test"))
    links: dict[str, float | list[float]] = {
        "mass": 0.01,
        "first_moment": [0.0] * 3,
        "inertia": [0.0] * 6,
        "rotor": rotor,
        "scale": 1.0,
    }
    for item in (
        KnownEffect("viscous_friction", "arm", {"coefficient": 0.04}),
        KnownEffect("inertial_error", "arm", links),
    ):
        plant = plant.with_effect(item)
    places = (PlantNumber("viscous_friction", "arm", None, "coefficient"),)
    return plant.with_uncertainty(Uncertainty(places, np.array([[1e-6]])))


def test_the_actuator_alone_keeps_what_is_its_own() -> None:
    plant, machine_only, assumed = alone(arm(rotor=0.002))
    assert plant.machine.urdf is None
    assert plant.machine.axis("arm").inertia == 0.002
    assert plant.machine.axis("arm").limits == (-3.0, 3.0)
    assert parameter_unit("viscous_friction", "coefficient", "arm", plant.machine) == "N·m·s/rad"
    assert [item.name for item in plant.effects] == ["viscous_friction"]
    assert plant.uncertainty.covariance.tolist() == [[1e-6]]
    assert machine_only == ("Inertial parameters of a link of arm",)
    assert assumed == ()


def test_an_inertia_that_no_recording_shows_is_assumed_and_said() -> None:
    plant, _, assumed = alone(arm(rotor=-0.001))
    assert plant.machine.axis("arm").inertia == 1.0
    assert assumed == ("inertia of arm: 1 kg·m²",)


def test_a_valve_on_a_machine_with_links_keeps_its_gain_and_backlash() -> None:
    text = MACHINE.replace('"force"', '"velocity"') + "gain = 0.7\n"
    plant = nominal_plant(machine_from_files({"machine.toml": text, "r.urdf": URDF}, "test"))
    for name, values in (("backlash", {"width": 0.01}), ("link_length_error", {"error": 0.002})):
        plant = plant.with_effect(KnownEffect(name, "arm", dict(values)))
    found, machine_only, _ = alone(plant)
    assert found.machine.axis("arm").gain == 0.7
    assert [item.name for item in found.effects] == ["backlash"]
    assert machine_only == ("Link length error of arm",)


def test_values_beside_those_of_a_card() -> None:
    card = card_named("emps-drive")
    theirs = next(item for item in card.values if item.name == "coulomb_friction")
    value = float(theirs.parameters["force"])
    mine = replace(theirs, target="x", parameters={"force": 2.1 * value}, interval95={"force": (2.0 * value, 2.2 * value)})
    other = WrittenEffect("input_delay", "x", "named", {"delay": 0.1}, interval95={"delay": (0.0, 0.2)})
    (row,) = compared(card, [mine, other])
    assert row.ratio == pytest.approx(2.1)
    assert not row.overlap
    (cells,) = comparison_table(card, [row]).rows
    assert cells[0] == "Dry friction of x, force"
    assert cells[3:] == ("2.1×", "intervals apart")


@pytest.mark.slow
def test_a_card_made_again_has_the_values_of_the_one_that_ships(shared_data: Path, tmp_path: Path) -> None:
    import actuator_cards

    (remade,) = actuator_cards.main(shared_data, tmp_path, only="emps-drive")
    assert (tmp_path / "cards" / "emps-drive.json").is_file()
    shipped = card_named("emps-drive")
    assert remade.data.digest == shipped.data.digest
    assert {(item.name, item.target) for item in remade.values} == {(item.name, item.target) for item in shipped.values}
    for new, old in zip(remade.values, shipped.values, strict=True):
        for key, (low, high) in old.interval95.items():
            assert float(low) <= float(new.parameters[key]) <= float(high)  # type: ignore[arg-type]
    for new_error, old_error in zip(remade.errors, shipped.errors, strict=True):
        assert new_error.card == pytest.approx(old_error.card, rel=0.05)
    whole = remade.replays[0]
    assert whole.ratio is not None
    assert 0.9 < whole.ratio < 1.1
