"""A replay begins in the state in which the recording begins: force axes that move then keep their speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from test_drive_model import probe_plant
from test_targets import RUN

from sysid.datasets.recording import Recording
from sysid.export.export import target_named
from sysid.export.replay import replay
from sysid.export.target import Target
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import Plant, nominal_plant
from sysid.plant.stepper import Stepper, held_commands, step_commands
from sysid.testing.probe import RATE_HZ, probe_recording

#: Row of the probe's recording at which the cut one begins: every axis moves there.
CUT = 212
RUBBED = (
    KnownEffect("viscous_friction", "slide", {"positive": 3.0, "negative": 3.0}),
    KnownEffect("coulomb_friction", "slide", {"positive": 0.4, "negative": 0.4}),
)
CYLINDER = """
schema = 1
name = "ram"
rate_hz = 100.0
[[axes]]
name = "slide"
actuation = "force"
drives = "cylinder"
inertia = 20.0
joint_type = "revolute"
stroke = [0.0, 0.11]
linkage = {kind = "triangle", a = 0.12, b = 0.20, offset = 0.9, retracted = 0.15, sense = 1}
"""


def cut(plant: Plant, source: Recording, joints: list[float]) -> tuple[Recording, float]:
    """What a plant makes of the commands of a recording, from :data:`CUT` on, and the speed of the slide there."""
    machine, stepper = plant.machine, Stepper(plant, RATE_HZ)
    states = [stepper.reset(joints)]
    states += [stepper.step(command) for command in step_commands(machine, held_commands(machine, source))]
    table = {name: source.values(name) for name in source.signals if name.endswith(".command")}
    for i, axis in enumerate(machine.axes):
        table[f"{axis.name}.joint"] = np.array([state.joints[0, i] for state in states])
        table[axis.driven] = np.array([state.drive[0, i] for state in states])
    whole = pd.DataFrame(table)[CUT:].reset_index(drop=True)
    speed = np.gradient(table[machine.axis("slide").driven], 1.0 / RATE_HZ)[CUT]
    return Recording("cut", whole.assign(time=np.arange(len(whole)) / RATE_HZ), RATE_HZ), float(speed)


@pytest.mark.parametrize("target", RUN, ids=lambda target: target.name)
def test_a_recording_may_begin_in_motion(target: Target, tmp_path: Path) -> None:
    plant = probe_plant(*RUBBED)
    recording, speed = cut(plant, probe_recording(), [0.0, 0.2, 0.0, 0.0])
    assert abs(speed) > 0.1
    target.write(plant, RATE_HZ, tmp_path)
    simulation = target.simulation(plant, tmp_path)
    assert simulation is not None
    found = {row.signal: row for row in replay(plant, simulation, [recording], {}).rows}
    assert [row for row in found.values() if not row.agrees] == []
    row = found["slide.joint"]
    assert row.plant_error < 0.01 * row.motion
    assert row.export_error < 0.02 * row.motion


def test_a_cylinder_that_begins_in_motion(tmp_path: Path) -> None:
    """In MuJoCo the speed of the cylinder is that of the joint behind its linkage."""
    plant = nominal_plant(machine_from_files({"machine.toml": CYLINDER}, "ram")).with_effect(
        KnownEffect("viscous_friction", "slide", {"positive": 40.0, "negative": 40.0})
    )
    source = probe_recording()
    little = Recording("run", source.table[["time"]].assign(**{"slide.command": source.values("slide.command")}), RATE_HZ)
    recording, speed = cut(plant, little, [0.3])
    assert abs(speed) > 0.01
    target = target_named("mjcf")
    target.write(plant, RATE_HZ, tmp_path)
    simulation = target.simulation(plant, tmp_path)
    assert simulation is not None
    found = {row.signal: row for row in replay(plant, simulation, [recording], {}).rows}
    row = found["slide.cylinder"]
    assert row.plant_error < 1e-6 * row.motion
    assert row.export_error < 0.02 * row.motion, "from rest it is further away than it moves"
