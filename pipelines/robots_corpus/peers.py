"""Independent readers of a model: MuJoCo for MJCF, Pinocchio for the original text of a URDF.

Both give, at values of the machine's axes, the tip [m], the gravity torque of each axis and the mass matrix, without rotors.
Joints beside the chain rest at their reference; a passive joint of the chain follows as the machine says.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]

#: Standard gravity, which the machine has along −z of its base [m/s²].
GRAVITY = 9.80665


@dataclass(frozen=True)
class Pose:
    """At one pose: ``tip`` (3,) [m], ``torque`` (A,) that gravity needs [N·m or N], ``mass`` matrix (A, A)."""

    tip: Array
    torque: Array
    mass: Array


@dataclass(frozen=True)
class Coupling:
    """Joint → (axis, ratio, offset): the axis that moves it, itself (1, 0) or through a passive joint."""

    of: Mapping[str, tuple[int, float, float]]
    axes: int


class Peer(Protocol):
    """A reader; ``differs``: what of the model the machine cannot have, each of which a note has to name."""

    name: str
    differs: list[str]

    def at(self, q: Array) -> Pose: ...


@dataclass
class MujocoPeer:
    """MuJoCo with the model's file. What holds a base still leaves it where the model has it at its reference."""

    path: Path
    coupling: Coupling
    tip: str
    name: str = "MuJoCo"
    differs: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        import mujoco

        mujoco.set_mju_user_warning(lambda text: None)
        self.mujoco, self.model = mujoco, mujoco.MjModel.from_xml_path(str(self.path))
        self.data = mujoco.MjData(self.model)
        self.joints = {name: self._joint(name) for name in self.coupling.of}
        self.gain = np.zeros((self.model.nv, self.coupling.axes))
        for name, (axis, ratio, _) in self.coupling.of.items():
            self.gain[self.model.jnt_dofadr[self.joints[name]], axis] = ratio
        self.point = self._point()
        self._make_plain()

    def _joint(self, name: str) -> int:
        found = int(self.mujoco.mj_name2id(self.model, self.mujoco.mjtObj.mjOBJ_JOINT, name))
        return found if found >= 0 else int(name.rpartition("_")[2])  # a joint without a name is joint_<number>

    def _point(self) -> tuple[str, int]:
        """The body or site whose origin is the tip: the link of the machine is named like it, or with ``_tip`` behind it."""
        kinds = {"body": self.mujoco.mjtObj.mjOBJ_BODY, "site": self.mujoco.mjtObj.mjOBJ_SITE}
        bare = self.tip.removesuffix("_tip")
        for kind, name in (("body", self.tip), ("site", self.tip), ("site", bare), ("body", bare)):
            found = int(self.mujoco.mj_name2id(self.model, kinds[kind], name))
            if found >= 0:
                return kind, found
        if bare.startswith("body_"):
            return "body", int(bare.rpartition("_")[2])
        raise ValueError(f"tip {self.tip!r}: neither a body nor a site of the model")

    def _make_plain(self) -> None:
        """Gravity along −z of the world, no compensation, no rotors; ``differs`` names what the model has instead."""
        model = self.model
        own = np.array(model.opt.gravity)
        if not (own[2] < 0.0 and np.abs(own[:2]).max() <= 1e-3 * -own[2] and -own[2] <= 100.0):
            self.differs.append(f"gravity {own.tolist()} m/s²")
            model.opt.gravity[:] = [0.0, 0.0, -GRAVITY]
        moved = [body for body in range(1, model.nbody) if self._moved(body)]
        if model.opt.disableflags & self.mujoco.mjtDisableBit.mjDSBL_GRAVITY:
            self.differs.append("gravity disabled")
            model.opt.disableflags &= ~int(self.mujoco.mjtDisableBit.mjDSBL_GRAVITY)
        if any(model.body_gravcomp[body] and model.body_mass[body] for body in moved):
            self.differs.append("gravity compensation")
        if any(model.jnt_stiffness[joint] for joint in self.joints.values()):
            self.differs.append("spring")
        if model.opt.density or model.opt.viscosity:
            self.differs.append("fluid")
        model.body_gravcomp[:] = 0.0
        model.dof_armature[:] = 0.0
        model.tendon_armature[:] = 0.0
        if hasattr(model, "actuator_armature"):
            model.actuator_armature[:] = 0.0

    def _moved(self, body: int) -> bool:
        bodies = {int(self.model.jnt_bodyid[joint]) for joint in self.joints.values()}
        while body:
            if body in bodies:
                return True
            body = int(self.model.body_parentid[body])
        return False

    def at(self, q: Array) -> Pose:
        mujoco, model, data = self.mujoco, self.model, self.data
        mujoco.mj_resetData(model, data)
        data.qpos[:] = model.qpos0
        for name, (axis, ratio, offset) in self.coupling.of.items():
            data.qpos[model.jnt_qposadr[self.joints[name]]] = ratio * q[axis] + offset
        mujoco.mj_forward(model, data)
        whole = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, data, whole)
        kind, number = self.point
        tip = np.array((data.xpos if kind == "body" else data.site_xpos)[number])
        return Pose(tip, self.gain.T @ data.qfrc_bias, self.gain.T @ whole @ self.gain)

    @property
    def facts(self) -> dict[str, int]:
        return {"joints": int(self.model.njnt), "actuators": int(self.model.nactuator)}


@dataclass
class PinocchioPeer:
    """Pinocchio with the text of the URDF, all joints free; what the machine does not move is held at zero."""

    path: Path
    coupling: Coupling
    tip: str
    name: str = "Pinocchio"
    differs: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        import pinocchio as pin

        self.pin, self.model = pin, pin.buildModelFromXML(self.path.read_text("utf-8"))
        self.gain = np.zeros((self.model.nv, self.coupling.axes))
        for name, (axis, ratio, _) in self.coupling.of.items():
            self.gain[self.model.joints[self._joint(name)].idx_v, axis] = ratio
        if not self.model.existBodyName(self.tip):
            raise ValueError(f"no link {self.tip!r}")
        self.model.gravity.linear = np.array([0.0, 0.0, -GRAVITY])
        self.data = self.model.createData()

    def _joint(self, name: str) -> int:
        if not self.model.existJointName(name):
            raise ValueError(f"no moving joint {name!r}")
        return int(self.model.getJointId(name))

    def at(self, q: Array) -> Pose:
        pin, model, data = self.pin, self.model, self.data
        places = pin.neutral(model)
        for name, (axis, ratio, offset) in self.coupling.of.items():
            joint, value = model.joints[self._joint(name)], ratio * q[axis] + offset
            places[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else [np.cos(value), np.sin(value)]
        pin.framesForwardKinematics(model, data, places)
        still = np.zeros(model.nv)
        torque = np.array(pin.rnea(model, data, places, still, still))
        upper = np.triu(np.array(pin.crba(model, data, places)))
        mass = upper + np.triu(upper, 1).T
        tip = data.oMf[model.getFrameId(self.tip, pin.FrameType.BODY)].translation  # a joint may have the same name
        return Pose(np.array(tip), self.gain.T @ torque, self.gain.T @ mass @ self.gain)

    @property
    def facts(self) -> dict[str, int]:
        return {"joints": int(self.model.njoints) - 1}


#: What a model has → the word by which a note names it.
NOTED = {"gravity": "gravity", "gravity compensation": "compensation", "spring": "spring", "fluid": "fluid"}


def unnoted(differs: Sequence[str], notes: Sequence[str]) -> list[str]:
    """What of ``differs`` no note names."""
    text = " ".join(notes).lower()
    words = {what: next(word for key, word in reversed(NOTED.items()) if what.startswith(key)) for what in differs}
    return [what for what, word in words.items() if word not in text]


def coupling_of(drives: Mapping[str, Any], axes: Sequence[str], known: Sequence[str]) -> Coupling:
    """The joints of ``known`` that an axis moves, by the ``drives`` of the machine's kinematics."""
    found = {name: (drive.column, drive.ratio, drive.offset) for name, drive in drives.items() if name in known}
    return Coupling(found, len(axes))
