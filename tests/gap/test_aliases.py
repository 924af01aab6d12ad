"""What no pose can tell apart is tried once."""

from __future__ import annotations

from pathlib import Path

from sysid.gap.candidates import candidates_at, without_aliases
from sysid.machine import load_machine
from sysid.plant import compile_plant, nominal_plant

CRANE = Path(__file__).parents[2] / "datasets" / "autolog" / "machine.toml"


def test_a_telescope_s_zero_is_the_length_before_it() -> None:
    plant = nominal_plant(load_machine(CRANE))
    offered = candidates_at(plant, plant.vector(), ("end_effector",), (*plant.machine.axis_names, "base"))
    found = {f"{c.effect.name}({c.target})": c for c in without_aliases(offered, compile_plant(plant))}
    assert ("joint_offset", "telescope") in found["link_length_error(stick)"].aliases
    assert "joint_offset(telescope)" not in found
    for apart in ("joint_offset(slew)", "joint_offset(boom)", "joint_offset(stick)", "link_length_error(boom)"):
        assert found[apart].aliases == ()


def test_a_base_that_is_turned_about_the_first_axis_is_that_axis_zero() -> None:
    """And nothing else of the kinematics is a special case of a base that stands askew."""
    plant = nominal_plant(load_machine(CRANE))
    offered = candidates_at(plant, plant.vector(), ("end_effector",), (*plant.machine.axis_names, "base"))
    found = {f"{c.effect.name}({c.target})": c for c in without_aliases(offered, compile_plant(plant))}
    base = found["base_misalignment(base)"]
    assert base.contains(found["joint_offset(slew)"])
    assert not any(base.contains(found[name]) for name in found if name.endswith(("(boom)", "(stick)")))
