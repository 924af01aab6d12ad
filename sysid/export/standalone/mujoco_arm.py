"""An exported arm in MuJoCo: forces at its joints in, motion of its links out; and the forces that a motion needs.

>>> arm = Arm("robot.xml")
>>> arm.reset(joints, speeds)            # (A,) at the sensors [rad or m, and per s]
>>> arm.step(commands)                   # one sample of the machine, several steps of MuJoCo; commands (A,) as in machine.toml
>>> arm.forces(joints, speeds, accelerations)   # (n, A) each → commands (n, A)

Friction that MuJoCo has no element for changes `dof_damping` and `dof_frictionloss` before each step. In a loop of your own,
set `arm.commands` and call `arm.control(model, data)` before each `mj_step`, or install it:
`mujoco.set_mjcb_control(arm.control)`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

from sysid.effects.smooth_coulomb_friction import slope as smooth_coulomb_friction_slope
from sysid.export.standalone.parts import PLACES, SensorReading, axis_parameters
from sysid.plant.chain import dry as chain_dry
from sysid.plant.chain import servo_friction as chain_servo_friction

Array = npt.NDArray[np.float64]


class JointFriction:
    """Friction of one joint: its laws in the unit of the commands, ``scale`` of them a unit of force.

    ``share``: coefficient·|load| against the motion, load the torque of the links; with the shape of the smooth law where that
    acts.
    """

    def __init__(self, scale: float, laws: list[Any], share: float) -> None:
        self.scale, self.share, self.p = scale, share, axis_parameters(dict(laws))
        self.smooth = PLACES["smooth_coulomb_friction.force"]

    def damping(self, v: float, load: float) -> float:
        """Force over speed at a speed, for a torque of the links that the joint carries."""
        slope, smooth = float(sum(chain_servo_friction(v, self.p, 0))), self.p[self.smooth]
        if smooth > 0.0:
            by_load = self.share * abs(self.scale * load) / smooth
            slope += by_load * float(smooth_coulomb_friction_slope(v, self.p, self.smooth))
        return slope / self.scale

    def loss(self, v: float, load: float) -> float:
        """Dry friction at a speed."""
        by_load = 0.0 if self.p[self.smooth] > 0.0 else self.share * abs(self.scale * load)
        return (float(chain_dry(v, v, self.p, 0)) + by_load) / self.scale


class Arm:
    """The model beside its table of axes, ``<model>.json``.

    Args:
        path: of the MJCF file.
    """

    def __init__(self, path: str | Path) -> None:
        path = Path(path)
        self.about = json.loads(path.with_suffix(".json").read_text("utf-8"))
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.data = mujoco.MjData(self.model)
        self.axes: list[dict[str, Any]] = self.about["axes"]
        self.names = [axis["axis"] for axis in self.axes]
        self.substeps = int(self.about["substeps"])
        self.actuators = [self.model.actuator(name).id for name in self.names]
        self.frictions = [
            JointFriction(axis["scale"], axis["laws"], axis["load_dependent_friction"]) if axis["mode"] == "friction" else None
            for axis in self.axes
        ]
        joints = [self.model.joint(axis["joint"]) for axis in self.axes]
        self.places = [int(joint.qposadr[0]) for joint in joints]
        self.dofs = [int(joint.dofadr[0]) for joint in joints]
        self.offsets = np.array([axis["offset"] for axis in self.axes])
        passive = [(self.model.joint(row["joint"]), row) for row in self.about["passive"]]
        self.followers = [
            (int(joint.qposadr[0]), int(joint.dofadr[0]), self.names.index(row["axis"]), row["ratio"], row["offset"])
            for joint, row in passive
        ]
        self.sensors = {name: SensorReading(**values) for name, values in self.about["sensors"].items()}
        self.commands = np.zeros(len(self.names))

    def reset(self, joints: Any, speeds: Any = None) -> dict[str, float]:
        """A state of motion; at rest without speeds. Returns the signals."""
        mujoco.mj_resetData(self.model, self.data)
        self.commands = np.zeros(len(self.names))
        still = np.zeros(len(self.names))
        self._state(np.asarray(joints), still if speeds is None else np.asarray(speeds), still)
        mujoco.mj_forward(self.model, self.data)
        return self.signals()

    def control(self, model: Any, data: Any) -> None:
        """Controls and friction of the next step of MuJoCo, from ``commands``."""
        data.ctrl[self.actuators] = self.commands
        self._friction(model, data)

    def step(self, commands: Any) -> dict[str, float]:
        """Hold ``commands`` (A,) for one sample; returns the signals after it."""
        self.commands = np.array(commands, dtype=np.float64)
        for _ in range(self.substeps):
            self.control(self.model, self.data)
            mujoco.mj_step(self.model, self.data)
        self.control(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)
        return self.signals()

    def forces(self, joints: Any, speeds: Any, accelerations: Any) -> Array:
        """Commands that a motion needs, by MuJoCo's inverse dynamics: (n, A) each → (n, A)."""
        model, data = self.model, mujoco.MjData(self.model)
        flags = mujoco.mjtDisableBit
        before, own = model.opt.disableflags, self.data
        model.opt.disableflags |= flags.mjDSBL_LIMIT | flags.mjDSBL_EQUALITY | flags.mjDSBL_CONTACT
        motion = [np.asarray(part, dtype=np.float64) for part in (joints, speeds, accelerations)]
        out = np.empty(motion[0].shape)
        self.data = data
        try:
            for k in range(len(out)):
                self._state(*(part[k] for part in motion))
                mujoco.mj_fwdPosition(model, data)
                mujoco.mj_fwdVelocity(model, data)
                self._friction(model, data)
                mujoco.mj_inverse(model, data)
                out[k] = data.qfrc_inverse[self.dofs]
                for _, dof, axis, ratio, _ in self.followers:
                    out[k, axis] += ratio * data.qfrc_inverse[dof]
        finally:
            self.data, model.opt.disableflags = own, before
        bias, gain = model.actuator_biasprm[self.actuators, 0], model.actuator_gainprm[self.actuators, 0]
        return np.asarray((out - bias) / gain)

    def signals(self) -> dict[str, float]:
        """True signals: ``<axis>.joint``, ``ee.x`` … [rad, m]."""
        place = self.data.site("ee").xpos
        joints = self.data.qpos[self.places] - self.offsets
        found = {f"{name}.joint": float(x) for name, x in zip(self.names, joints, strict=True)}
        return found | {f"ee.{axis}": float(place[j]) for j, axis in enumerate("xyz")}

    def readings(self) -> dict[str, float]:
        """The signals as their sensors read them."""
        sensors = self.sensors
        return {name: sensors[name].read(x) if name in sensors else x for name, x in self.signals().items()}

    def _state(self, joints: Array, speeds: Array, accelerations: Array) -> None:
        data = self.data
        structure = joints + self.offsets
        data.qpos[self.places], data.qvel[self.dofs], data.qacc[self.dofs] = structure, speeds, accelerations
        for place, dof, axis, ratio, offset in self.followers:
            data.qpos[place] = ratio * structure[axis] + offset
            data.qvel[dof], data.qacc[dof] = ratio * speeds[axis], ratio * accelerations[axis]

    def _friction(self, model: Any, data: Any) -> None:
        """Friction at the speed and under the load of the links at the last step."""
        if all(friction is None for friction in self.frictions):
            return
        torque = np.zeros(model.nv)
        mujoco.mj_rne(model, data, 1, torque)
        for k, friction in enumerate(self.frictions):
            if friction is None:
                continue
            dof = self.dofs[k]
            load = float(torque[dof]) + sum(ratio * float(torque[d]) for _, d, axis, ratio, _ in self.followers if axis == k)
            v = float(data.qvel[dof])
            model.dof_damping[dof], model.dof_frictionloss[dof] = friction.damping(v, load), friction.loss(v, load)
