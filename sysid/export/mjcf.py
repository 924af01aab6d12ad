"""``mjcf``: a MuJoCo model with the effects that MuJoCo has, and the drive model for the others."""

from __future__ import annotations

import inspect
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.errors import SettingsError
from sysid.export.drive_data import WITHOUT_PART, drive_data
from sysid.export.drive_module import MODULE
from sysid.export.mjcf_bodies import add_bodies
from sysid.export.mjcf_drives import add_drive, mode_of
from sysid.export.shipped_run import load_module, write_drive_model
from sysid.export.standalone import mujoco_robot
from sysid.export.target import Simulation, Start, Support
from sysid.machine.rigid_body import moves_masses
from sysid.plant import Plant

Array = npt.NDArray[np.float64]
FILE, ROBOT = "robot.xml", "mujoco_robot.py"
#: Longest step of the integrator [s]; a sample of the machine is a whole number of steps.
LONGEST_STEP = 1e-3
_ELEMENTS = {
    "input_delay": "actuator `delay` and `nsample`",
    "first_order_lag": "actuator `dyntype=filterexact`",
    "second_order_lag": "position servo against the armature",
    "gain_error": "actuator `gainprm`",
    "internal_leakage": "actuator `biasprm`",
    "viscous_friction": "joint `damping` (the same in both directions; else by the drive model)",
    "coulomb_friction": "joint `frictionloss` (the same in both directions; else by the drive model)",
    "inertia_error": "joint `armature`",
    "load_bias": "actuator `biasprm`",
    "joint_offset": "actuator `biasprm` and `range`, subtracted from the joint's sensor",
}
_GEOMETRY = {
    "link_length_error": "`pos` of the bodies of the link",
    "tip_offset": "`pos` of the site `ee`",
    "base_misalignment": "pose of the root body, and `gravity` turned with it",
}


class MjcfTarget:
    """MuJoCo 4."""

    name = "mjcf"
    title = "MuJoCo"
    modules: tuple[str, ...] = ("mujoco",)
    notes: tuple[str, ...] = (
        "`robot.json` states for each axis whether its actuator takes the command or follows the drive model.",
    )

    def support(self, effect: Effect) -> Support:
        if effect.name in _ELEMENTS:
            return Support("native", _ELEMENTS[effect.name])
        if effect.name in _GEOMETRY:
            return Support("composed", _GEOMETRY[effect.name])
        if effect.name in WITHOUT_PART:
            return Support("not_representable", WITHOUT_PART[effect.name])
        return Support("plugin", f"`{MODULE}`, whose joint the actuator follows")

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        if moves_masses(plant.machine):
            found, expected = "force axes that move links with masses", "axes driven by position, velocity or an inertia"
            raise SettingsError(f"export of {plant.machine.name} to mjcf", found, expected)
        import mujoco

        data = drive_data(plant, rate_hz)
        substeps = max(1, math.ceil(1.0 / (rate_hz * LONGEST_STEP) - 1e-9))
        spec = mujoco.MjSpec()
        spec.modelname = plant.machine.name
        spec.compiler.degree = False
        spec.option.timestep = 1.0 / rate_hz / substeps
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        bodies = add_bodies(spec, plant)
        entries = [mode_of(plant, axis, data["pump_limit"] is not None) for axis in data["axes"]]
        for axis, joint, entry in zip(data["axes"], bodies.joints, entries, strict=True):
            add_drive(spec, axis, spec.joint(joint), entry, spec.option.timestep)
        spec.compile()
        (folder / FILE).write_text(spec.to_xml(), "utf-8")
        about = {
            "plant": plant.reference,
            "substeps": substeps,
            "posed": bodies.posed,
            "axes": [
                {
                    **asdict(entry),
                    "joint": joint,
                    "offset": axis["offset"],
                    "driven": f"{axis['name']}.{axis['drives']}",
                    "actuation": axis["actuation"],
                }
                for axis, joint, entry in zip(data["axes"], bodies.joints, entries, strict=True)
            ],
            "passive": _passive(plant),
        }
        (folder / FILE).with_suffix(".json").write_text(json.dumps(about, indent=1), "utf-8")
        (folder / ROBOT).write_text(inspect.getsource(mujoco_robot), "utf-8")
        return FILE, f"{Path(FILE).stem}.json", ROBOT, *write_drive_model(plant, rate_hz, folder)

    def simulation(self, plant: Plant, folder: Path) -> Simulation | None:
        return MujocoSimulation(load_module(folder / ROBOT).Robot(folder / FILE, load_module(folder / MODULE).load()))


class MujocoSimulation:
    """The shipped loop."""

    def __init__(self, robot: Any) -> None:
        self.robot = robot

    def reset(self, start: Start) -> dict[str, float]:
        found: dict[str, float] = self.robot.reset(start.joints, start.drive, start.commands)
        return found

    def step(self, commands: Array) -> dict[str, float]:
        found: dict[str, float] = self.robot.step(commands)
        return found


def _passive(plant: Plant) -> list[dict[str, Any]]:
    """Passive joints and the axes that they follow."""
    kinematics = plant.machine.kinematics()
    if kinematics is None:
        return []
    names = plant.machine.axis_names
    return [
        {"joint": joint, "axis": names[drive.column], "ratio": drive.ratio, "offset": drive.offset}
        for joint, drive in kinematics.drives.items()
        if joint not in kinematics.actuated
    ]
