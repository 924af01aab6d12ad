"""A URDF from elsewhere may try to expand entities without end or to read other files: refused before anything is expanded."""

from __future__ import annotations

from pathlib import Path

import pytest

from sysid.errors import SettingsError
from sysid.machine import load_machine

MACHINE = """schema = 1
name = "demo"
rate_hz = 100.0
urdf = "arm.urdf"
tip = "arm"
[[axes]]
name = "a"
actuation = "velocity"
drives = "joint"
joint = "a"
"""
ROBOT = (
    '<robot name="{name}"><link name="base"/><link name="arm"/>'
    '<joint name="a" type="continuous"><parent link="base"/><child link="arm"/></joint></robot>'
)
LAUGHS = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))


@pytest.mark.parametrize(
    "head",
    [
        f'<!DOCTYPE robot [<!ENTITY a0 "ha">{LAUGHS}]>',
        '<!DOCTYPE robot [<!ENTITY a11 SYSTEM "file:///etc/passwd">]>',
        '<!DOCTYPE robot [<!ENTITY % more SYSTEM "http://localhost/x.dtd"> %more;]>',
        '<!DOCTYPE robot SYSTEM "http://localhost/robot.dtd">',
    ],
)
def test_entities_and_document_types_are_refused(tmp_path: Path, head: str) -> None:
    (tmp_path / "machine.toml").write_text(MACHINE)
    (tmp_path / "arm.urdf").write_text(ROBOT.format(name="demo"))
    assert load_machine(tmp_path / "machine.toml").kinematics() is not None
    (tmp_path / "arm.urdf").write_text(head + ROBOT.format(name="&a11;"))
    with pytest.raises(SettingsError, match=r"not readable as XML \(.*\); expected a URDF without DTD or entities"):
        load_machine(tmp_path / "machine.toml").kinematics()
