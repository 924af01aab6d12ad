"""``urdf``: the URDF with repaired geometry and joint friction, a table of the other effects, and the drive model."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.export.drive_module import MODULE
from sysid.export.effect_table import write_effect_table
from sysid.export.shipped_run import load_module, true_signals, write_drive_model
from sysid.export.support import support_of
from sysid.export.target import Simulation, Start, Support
from sysid.export.urdf_text import END_EFFECTOR, joint_values, urdf_of
from sysid.machine.urdf_tree import urdf_tree
from sysid.plant import Plant
from sysid.signals import point_signals

Array = npt.NDArray[np.float64]
FILE = "robot.urdf"
NATIVE = {"viscous_friction": "`<dynamics damping>`", "coulomb_friction": "`<dynamics friction>`"}
COMPOSED = {
    "joint_offset": "`<origin>` of the joint: its value is that of the sensor",
    "link_length_error": "`<origin>` of the joints of the link",
    "tip_offset": f"link `{END_EFFECTOR}` on that of the tip",
    "base_misalignment": "link `measured_frame` above the root",
}


class UrdfTarget:
    """URDF, as ROS and most simulators read it."""

    name = "urdf"
    title = "URDF"
    modules: tuple[str, ...] = ("mujoco",)
    arms = False
    notes: tuple[str, ...] = (
        "A URDF has one friction for both directions: the mean of both is written, and both are in `effects.csv`.",
        "Meshes are referred to as in the URDF of the machine, and not copied.",
        "For the replay the drive model moves the joints, and MuJoCo reads the URDF and computes the end effector.",
    )

    def support(self, effect: Effect) -> Support:
        return support_of(effect, NATIVE, COMPOSED, f"`{MODULE}`")

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        (folder / FILE).write_text(urdf_of(plant), "utf-8")
        return FILE, write_effect_table(plant, folder), *write_drive_model(plant, rate_hz, folder)

    def simulation(self, plant: Plant, folder: Path) -> Simulation | None:
        return UrdfSimulation(plant, load_module(folder / MODULE).load(), (folder / FILE).read_text("utf-8"))


class UrdfSimulation:
    """The drive model moves the joints of the URDF in MuJoCo, which computes the end effector."""

    def __init__(self, plant: Plant, model: Any, urdf: str) -> None:
        import mujoco

        self.plant, self.model, self.mujoco = plant, model, mujoco
        self.kinematics = plant.machine.kinematics()
        spec = mujoco.MjSpec.from_string(without_shapes(urdf))
        spec.compiler.fusestatic = False
        spec.compiler.boundmass, spec.compiler.boundinertia, spec.compiler.balanceinertia = 1e-9, 1e-9, True
        self.body = spec.compile()
        self.data = mujoco.MjData(self.body)

    def reset(self, start: Start) -> Mapping[str, float]:
        return self._signals(self.model.reset(start.joints, start.drive, start.commands, start.speeds))

    def step(self, commands: Array) -> Mapping[str, float]:
        return self._signals(self.model.step(commands))

    def _signals(self, state: Any) -> dict[str, float]:
        found = true_signals(self.plant, state)
        if self.kinematics is None:
            return found
        offsets = np.array([axis.offset for axis in self.model.axes])
        for name, value in joint_values(self.kinematics, state.structure - offsets).items():
            self.data.qpos[self.body.joint(name).qposadr[0]] = value
        self.mujoco.mj_kinematics(self.body, self.data)
        place = self.data.body(END_EFFECTOR).xpos
        ee, tool = dict(zip(point_signals("ee"), place, strict=True)), place + state.tool - state.ee
        return found | {name: float(x) for name, x in (ee | dict(zip(point_signals("tool"), tool, strict=True))).items()}


def without_shapes(urdf: str) -> str:
    """A URDF without visual and collision shapes, whose meshes need not be there."""
    from xml.etree.ElementTree import tostring

    root = urdf_tree(urdf)
    for link in root.findall("link"):
        for shape in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(shape)
    return tostring(root, encoding="unicode")
