"""Units of joints where neither a URDF nor the logs describe them."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.datasets import ingest
from sysid.datasets.plan import with_joint_units
from sysid.errors import SettingsError
from sysid.machine import Machine, machine_from_files

HEAD = 'schema = 1\nname = "m"\nrate_hz = 50.0\n'


def machine(actuation: str = "force", joint_type: str = "", drives: str = "joint") -> Machine:
    lines = ["[[axes]]", 'name = "a"', f'actuation = "{actuation}"', f'drives = "{drives}"', "inertia = 1.0", "stroke = [0, 1]"]
    lines += [f'joint_type = "{joint_type}"'] if joint_type else []
    return machine_from_files({"machine.toml": HEAD + "\n".join(lines)}, "test")


@pytest.mark.parametrize(
    ("stated", "expected"),
    [
        ({"a.joint": "1", "a.command": "1"}, {"a.joint": "rad", "a.command": "N·m"}),
        ({"a.joint": "m", "a.command": "1"}, {"a.joint": "m", "a.command": "N"}),
        ({"a.joint": "1", "a.command": "N"}, {"a.joint": "m", "a.command": "N"}),
        ({"a.joint": "1", "a.speed": "m/s"}, {"a.joint": "m", "a.speed": "m/s"}),
        ({"a.joint": "rad", "a.speed": "1"}, {"a.joint": "rad", "a.speed": "rad/s"}),
    ],
)
def test_one_stated_unit_determines_the_others_of_an_axis(stated: dict[str, str], expected: dict[str, str]) -> None:
    found, notes = with_joint_units(stated, machine())
    assert found == expected
    assert len(notes) == (set(stated.values()) == {"1"})


def test_an_assumed_unit_is_noted_with_its_remedy() -> None:
    found, (note,) = with_joint_units({"a.joint": "1", "a.command": "1"}, machine("position"))
    assert found == {"a.joint": "rad", "a.command": "rad"}
    assert "a: neither logs nor machine.toml state a unit" in note
    assert 'joint_type = "prismatic"' in note


def test_the_command_of_a_speed_drive_has_no_unit_and_a_cylinder_has_metres() -> None:
    assert with_joint_units({"a.joint": "1", "a.command": "1"}, machine("velocity"))[0] == {"a.joint": "rad", "a.command": "1"}
    stated = {"a.joint": "1", "a.cylinder": "m", "a.command": "N"}
    assert with_joint_units(stated, machine(drives="cylinder"))[0] == {**stated, "a.joint": "rad"}


def test_joint_type_states_the_units_of_plain_logs(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(machine(joint_type="prismatic").text, "utf-8")
    folder = tmp_path / "logs/one"
    folder.mkdir(parents=True)
    rows = "".join(f"{0.02 * k},{k % 7},{0.01 * (k % 11)}\n" for k in range(200))
    (folder / "log.csv").write_text("time,a.command,a.joint\n" + rows, "utf-8")
    dataset = ingest([tmp_path / "logs"], tmp_path / "workspace", tmp_path / "machine.toml", name="m")
    assert (dataset.units["a.joint"], dataset.units["a.command"]) == ("m", "N")


URDF = """<robot name="m"><link name="base"/><link name="tip"/>
<joint name="j" type="revolute"><parent link="base"/><child link="tip"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""


def test_a_joint_type_that_contradicts_the_urdf_is_an_error() -> None:
    axis = '[[axes]]\nname = "a"\njoint = "j"\nactuation = "position"\ndrives = "joint"\njoint_type = "prismatic"\n'
    files = {"machine.toml": f'{HEAD}urdf = "m.urdf"\ntip = "tip"\n{axis}', "m.urdf": URDF}
    with pytest.raises(SettingsError, match=r"'prismatic'.*expected 'revolute' as joint 'j' of the URDF"):
        machine_from_files(files, "test")
