"""``urdf``: the URDF with repaired geometry and joint friction, a table of the other effects, and the drive model."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import tostring

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.export.drive_module import MODULE, load_module, true_signals, write_drive_model, write_effect_table
from sysid.export.names import MachineNames, Names
from sysid.export.target import Simulation, Start, Support, support_of
from sysid.export.urdf_text import END_EFFECTOR, FIXED_WORLD, joint_values, urdf_names, urdf_of, xml_text
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
    resolution, arms = 0.0, False
    notes: tuple[str, ...] = (
        "A URDF has one friction for both directions: the mean of both is written, and both are in `effects.csv`.",
        "Meshes are referred to as in the URDF of the machine, and not copied.",
        "For the replay the drive model moves the joints, and MuJoCo reads the URDF and computes the end effector.",
    )

    def names(self, plant: Plant) -> MachineNames:
        return urdf_names(plant, Names([FIXED_WORLD]), Names())

    def support(self, effect: Effect) -> Support:
        return support_of(effect, NATIVE, COMPOSED, f"`{MODULE}`")

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        (folder / FILE).write_text(xml_text(urdf_of(plant, self.names(plant))), "utf-8")
        return FILE, write_effect_table(plant, folder), *write_drive_model(plant, rate_hz, folder)

    def simulation(self, plant: Plant, folder: Path) -> Simulation | None:
        model = load_module(folder / MODULE).load()
        return UrdfSimulation(plant, model, (folder / FILE).read_text("utf-8"), self.names(plant))


class UrdfSimulation:
    """The drive model moves the joints of the URDF in MuJoCo, which computes the end effector."""

    def __init__(self, plant: Plant, model: Any, urdf: str, names: MachineNames) -> None:
        import mujoco

        self.plant, self.model, self.names, self.mujoco = plant, model, names, mujoco
        self.kinematics = plant.machine.kinematics()
        drives = {} if self.kinematics is None else self.kinematics.drives
        moved = {names.joints[name] for name in drives} | {names.joint(axis) for axis in plant.machine.axis_names}
        spec = mujoco.MjSpec.from_string(skeleton(urdf, moved))
        spec.compiler.fusestatic = False
        spec.compiler.boundmass, spec.compiler.boundinertia = 1e-9, 1e-9
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
        for name, value in joint_values(self.kinematics, self.names, state.structure - offsets).items():
            self.data.qpos[self.body.joint(name).qposadr[0]] = value
        self.mujoco.mj_kinematics(self.body, self.data)
        place = self.data.body(self.names.added[END_EFFECTOR]).xpos
        ee, tool = dict(zip(point_signals("ee"), place, strict=True)), place + state.tool - state.ee
        return found | {name: float(x) for name, x in (ee | dict(zip(point_signals("tool"), tool, strict=True))).items()}


def skeleton(urdf: str, moved: Collection[str]) -> str:
    """Frames and moved joints of a URDF alone: without shapes, whose meshes need not be there, and without masses."""
    root = urdf_tree(urdf)
    for link in root.findall("link"):
        for part in list(link):
            link.remove(part)
    for joint in root.findall("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
        if joint.get("name") not in moved:
            joint.set("type", "fixed")
    return tostring(root, encoding="unicode")
