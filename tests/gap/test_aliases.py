"""What no pose can tell apart is tried once."""

from __future__ import annotations

from plant_data import dataset_of, nominal

from sysid.gap.case import open_case, stage_candidates


def test_a_telescope_s_zero_is_the_length_before_it() -> None:
    plant = nominal()
    case, stages = open_case(dataset_of(plant, 5.0), plant, 0)
    (tip,) = (s for s in stages if s.problem.stage == "end_effector")
    found = {f"{c.effect.name}({c.target})": c for c in stage_candidates(case, tip)}
    assert ("joint_offset", "telescope") in found["link_length_error(stick)"].aliases
    assert "joint_offset(telescope)" not in found
    for apart in ("joint_offset(slew)", "joint_offset(boom)", "joint_offset(stick)", "link_length_error(boom)"):
        assert found[apart].aliases == ()
