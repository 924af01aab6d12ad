"""Whether the gravity load of a position axis is known."""

from __future__ import annotations

import pytest
from sagging_servo import AXES, Servos, machine_files, recording

from sysid.gap.servo.sag import load_known
from sysid.machine import machine_from_files

EVERY = dict.fromkeys(AXES, True)


@pytest.mark.parametrize(
    ("masses", "known"),
    [(True, EVERY), (False, {**dict.fromkeys(AXES, False), "yaw": True}), (None, dict.fromkeys(AXES, False))],
)
def test_masses_or_a_vertical_axis_make_the_load_known(masses: bool | None, known: dict[str, bool]) -> None:
    machine = machine_from_files(machine_files(masses), "servos")
    motion = recording(Servos(), "take", 1, 10.0)
    assert {axis: load_known(machine, axis, [motion]) for axis in AXES} == known


def test_a_slide_carries_no_weight_where_it_is_horizontal() -> None:
    files = machine_files(False)
    for direction, known in (("0 0 1", False), ("1 0 0", True)):
        urdf = files["arm.urdf"].replace('"yaw_joint" type="revolute"', '"yaw_joint" type="prismatic"', 1)
        urdf = urdf.replace('<axis xyz="0 0 1"/>', f'<axis xyz="{direction}"/>', 1)
        machine = machine_from_files({**files, "arm.urdf": urdf}, "servos")
        assert load_known(machine, "yaw", [recording(Servos(), "take", 1, 10.0)]) == known


def test_without_a_recorded_posture_the_load_is_not_known() -> None:
    assert not load_known(machine_from_files(machine_files(False), "servos"), "yaw", [])
