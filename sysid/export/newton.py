"""``newton``: a USD stage with the Newton schemas, and the drive model for what they do not have."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.effects import Effect
from sysid.export.drive_data import drive_data
from sysid.export.drive_module import (
    MODULE,
    ModelSimulation,
    load_module,
    true_signals,
    write_drive_model,
    write_effect_table,
)
from sysid.export.mjcf_bodies import steps_of
from sysid.export.names import MachineNames
from sysid.export.target import Simulation, Support, Target
from sysid.export.urdf import END_EFFECTOR, NOTE, end_effector_signals, joint_values
from sysid.export.usd_stage import (
    ANCHOR,
    SCENE,
    actuator_path,
    is_native,
    joint_path,
    link_path,
    mimics,
    usd_names,
    write_bodies,
    write_drive,
    write_follower,
)
from sysid.machine.kinematics import pose_of
from sysid.plant import Plant
from sysid.plant.layout import axis_places

Array = npt.NDArray[np.float64]
FILE = "machine.usda"
NATIVE = {
    "viscous_friction": "`newton:damping` of the joint (the same in both directions; else by the drive model)",
    "coulomb_friction": "`newton:friction` of the joint (the same in both directions; else by the drive model)",
    "inertia_error": "`newton:armature` of the joint",
    "load_bias": "`newton:constEffort` of the actuator",
    "input_delay": "`newton:delaySteps` of the actuator of a position axis without further effects; else by the drive model",
}
COMPOSED = {
    "joint_offset": "`physics:localRot0` or `physics:localPos0` of the joint: its value is that of the sensor",
    "link_length_error": "`physics:localPos0` of the joints of the link",
    "tip_offset": f"site `{END_EFFECTOR}` on the link of the tip",
    "base_misalignment": "pose of the root link, and `physics:gravityDirection` turned with it",
}


class NewtonTarget(Target):
    """USD with the schemas of Newton."""

    name = "newton"
    title = "USD for Newton"
    modules = ("pxr", "newton_usd_schemas")
    #: UsdPhysics and the schemas of Newton have numbers of 32 bits.
    resolution = float(np.finfo(np.float32).eps)
    native, composed = NATIVE, COMPOSED
    notes = (
        "Newton was not run here. The schemas of its actuators are provisional: newton-usd-schemas 0.6.",
        f"For the replay the stage is opened again: `{MODULE}` moves the joints, native axes with the stage's numbers, "
        "and the end effector is computed from the frames of the stage.",
        "Joints with a `PhysicsDriveAPI` follow the drive model: after each sample, their target is `state.structure` minus "
        "the joint's offset. A force axis with a `NewtonActuator` takes its command as feedforward. A sliding joint that "
        "follows a turning one, or the reverse, has such a drive in place of a mimic, with the target of its `<mimic>`.",
        NOTE,
    )

    def names(self, plant: Plant) -> MachineNames:
        return usd_names(plant)

    def otherwise(self, effect: Effect) -> Support:
        return Support("plugin", f"`{MODULE}`, whose joint the drive follows")

    def write(self, plant: Plant, rate_hz: float, folder: Path) -> tuple[str, ...]:
        stage, names = _stage_in_memory(), self.names(plant)
        steps = round(rate_hz * steps_of(rate_hz))
        joints = write_bodies(stage, plant, names, steps)
        for axis in drive_data(plant, rate_hz)["axes"]:
            write_drive(stage, axis, names.axes[axis["name"]], joints[names.joint(axis["name"])], steps)
        for joint in joints.values():
            if joint.mimic is not None and not mimics(joint, joints):
                write_follower(stage, joint, steps)
        stage.GetRootLayer().customLayerData = {"plant": plant.reference or plant.machine.name, "sample": 1.0 / rate_hz}
        stage.GetRootLayer().Export(str(folder / FILE))
        return FILE, write_effect_table(plant, folder), *write_drive_model(plant, rate_hz, folder)

    def simulation(self, plant: Plant, folder: Path) -> Simulation | None:
        model = load_module(folder / MODULE).load()
        return ModelSimulation(model, StageSignals(plant, model, folder / FILE, self.names(plant)))


def _stage_in_memory() -> Any:
    import newton_usd_schemas  # noqa: F401 (registers the schemas)
    from pxr import Usd

    return Usd.Stage.CreateInMemory()


class StageSignals:
    """Signals of a stage whose joints the drive model moves; that has the stage's own numbers of its native axes."""

    def __init__(self, plant: Plant, model: Any, path: Path, names: MachineNames) -> None:
        import newton_usd_schemas  # noqa: F401 (registers the schemas)
        from pxr import Usd

        self.plant, self.model, self.names = plant, model, names
        self.stage = Usd.Stage.Open(str(path))
        self.kinematics = plant.machine.kinematics()
        for axis, data in zip(model.axes, drive_data(plant, plant.machine.rate_hz)["axes"], strict=True):
            if is_native(data):
                self._take(axis.drive, names.axes[data["name"]], joint_path(names.joint(data["name"])))
        chain = [] if self.kinematics is None else [names.joints[joint.name] for joint in self.kinematics.chain]
        chain = [names.added[ANCHOR], *chain] if chain else []
        self.frames = [self._frames(name) for name in chain]

    def _take(self, drive: Any, axis: str, path: str) -> None:
        """Numbers of the joint and of its actuator, in SI units."""
        joint, actuator = self.stage.GetPrimAtPath(path), self.stage.GetPrimAtPath(actuator_path(axis))
        if not hasattr(drive, "mass"):
            scene = self.stage.GetPrimAtPath(SCENE)
            seconds = actuator.GetAttribute("newton:delaySteps").Get() / scene.GetAttribute("newton:timeStepsPerSecond").Get()
            drive.parts[0] = type(drive.parts[0])(drive.dt, delay=seconds)
            return
        angular, places = joint.GetTypeName() == "PhysicsRevoluteJoint", axis_places()
        drive.mass = joint.GetAttribute("newton:armature").Get()
        drive.p[places["load_bias.force"]] = -actuator.GetAttribute("newton:constEffort").Get()
        damping, friction = (joint.GetAttribute(f"newton:{name}").Get() for name in ("damping", "friction"))
        for side in ("positive", "negative"):
            drive.p[places[f"viscous_friction.{side}"]] = math.degrees(damping) if angular else damping
            drive.p[places[f"coulomb_friction.{side}"]] = friction

    def _frames(self, name: str) -> tuple[str, Array, Array, bool]:
        """Name, frame on the parent and inverse of that on the child (4, 4), and whether it slides."""
        joint = self.stage.GetPrimAtPath(joint_path(name))
        first, second = (_frame(joint, side) for side in (0, 1))
        return name, first, np.asarray(np.linalg.inv(second), dtype=np.float64), joint.GetTypeName() == "PhysicsPrismaticJoint"

    def __call__(self, state: Any) -> dict[str, float]:
        found = true_signals(self.plant, state)
        if self.kinematics is None:
            return found
        offsets = np.array([axis.offset for axis in self.model.axes])
        values = joint_values(self.kinematics, self.names, state.structure - offsets)
        pose = np.eye(4)
        for name, first, second, slides in self.frames:
            pose = pose @ first @ _motion(values.get(name, 0.0), slides) @ second
        tip = self.stage.GetPrimAtPath(f"{link_path(self.names.links[self.kinematics.tip])}/{END_EFFECTOR}")
        place = pose[:3, :3] @ np.array(tip.GetAttribute("xformOp:translate").Get()) + pose[:3, 3]
        return found | end_effector_signals(place, state)


def _frame(joint: Any, side: int) -> Array:
    """Frame of a joint on one of its bodies (4, 4)."""
    from pxr import Gf

    turn = joint.GetAttribute(f"physics:localRot{side}").Get()
    return pose_of(np.array(Gf.Matrix3d(Gf.Quatd(turn))).T, np.array(joint.GetAttribute(f"physics:localPos{side}").Get()))


def _motion(value: float, slides: bool) -> Array:
    """Motion of a joint along or about x (4, 4)."""
    if slides:
        return pose_of(np.eye(3), np.array([value, 0.0, 0.0]))
    sine, cosine = math.sin(value), math.cos(value)
    return pose_of(np.array([[1.0, 0.0, 0.0], [0.0, cosine, -sine], [0.0, sine, cosine]]), np.zeros(3))
