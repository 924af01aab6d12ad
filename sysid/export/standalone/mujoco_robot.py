"""An exported machine in MuJoCo: the loop around ``mj_step`` that runs the drive model for the axes that need it.

>>> robot = Robot("robot.xml")
>>> robot.reset(joints)                  # (A,) at the sensors [rad or m]
>>> robot.step(commands)                 # one sample of the machine, several steps of MuJoCo; commands (A,) as in machine.toml

In a loop of your own, set ``robot.commands`` and call ``robot.control(model, data)`` before each ``mj_step``, or install it:
``mujoco.set_mjcb_control(robot.control)``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


class Robot:
    """The model beside its table of axes (``<model>.json``) and its drive model.

    Args:
        path: of the MJCF file.
        drives: the drive model, ``drive_model.load()``.
    """

    def __init__(self, path: str | Path, drives: Any) -> None:
        path = Path(path)
        self.about = json.loads(path.with_suffix(".json").read_text("utf-8"))
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.data = mujoco.MjData(self.model)
        self.drives, self.substeps = drives, int(self.about["substeps"])
        self.axes: list[dict[str, Any]] = self.about["axes"]
        self.names = [axis["axis"] for axis in self.axes]
        self.actuators = [self.model.actuator(name).id for name in self.names]
        self.modelled = any(axis["mode"] != "native" for axis in self.axes) or not self.about["swings"]
        self.commands = np.zeros(len(self.names))
        self.inputs: list[float] = []  # of the actuators in this sample, and in the one before
        self.before: list[float] = []
        self.state: Any = None
        self.sample, self.resetting = -1, False

    def reset(self, joints: Any, drive: Any = None, commands: Any = None, speeds: Any = None) -> dict[str, float]:
        """``commands`` (A,) were held since long before; ``speeds`` (A,) of the drives of force axes. Returns the signals."""
        mujoco.mj_resetData(self.model, self.data)
        self.state = self.drives.reset(joints, drive, commands, speeds)
        self.sample, self.resetting = -1, True
        self.commands = np.zeros(len(self.names)) if commands is None else np.array(commands, dtype=np.float64)
        for k, axis in enumerate(self.axes):
            if axis["actuation"] == "position":
                self.commands[k] = self.state.drive[k]
            link = self.drives.axes[k].linkage
            driven = self.state.drive[k] if link is None else link.joint(float(self.state.drive[k]))
            self._set(axis["drive_joint"], driven + axis["offset"])
            self._set(axis["joint"], self.state.structure[k])
            if speeds is not None and axis["actuation"] == "force" and axis["mode"] == "native":
                slope = 1.0 if link is None else _slope(link, float(self.state.drive[k]))
                self.data.qvel[self.model.joint(axis["drive_joint"]).dofadr[0]] = slope * float(speeds[k])
        for follower in self.about["passive"]:
            value = self.state.structure[self.names.index(follower["axis"])] * follower["ratio"] + follower["offset"]
            self._set(follower["joint"], value)
        self.inputs = [self._input(k) for k in range(len(self.axes))]
        for k, actuator in enumerate(self.actuators):
            if self.axes[k]["mode"] != "drive_model":
                self._hold(actuator, self.inputs[k])
        if self.about["swings"]:
            mujoco.mj_kinematics(self.model, self.data)
            gimbal = self.model.joint(self.about["gimbal"])
            place, parent = gimbal.qposadr[0], self.model.body_parentid[gimbal.bodyid[0]]
            mujoco.mju_negQuat(self.data.qpos[place : place + 4], self.data.xquat[parent])
        mujoco.mj_forward(self.model, self.data)
        self.resetting = False
        return self.signals()

    def control(self, model: Any, data: Any) -> None:
        """Controls of the next step of MuJoCo, from ``commands``; a second call at the same time changes nothing."""
        if self.resetting:
            return
        sample, phase = divmod(round(data.time / model.opt.timestep), self.substeps)
        if sample != self.sample:
            self.sample = sample
            self.before = self.inputs
            if self.modelled:
                self.state = self.drives.step(self.commands)
            self.inputs = [self._input(k) for k in range(len(self.axes))]
        for k, actuator in enumerate(self.actuators):
            if self.axes[k]["mode"] == "drive_model":  # the speed that ends at the drive model's joint with its sample
                left = (self.substeps - phase) * model.opt.timestep
                data.ctrl[actuator] = (self.state.structure[k] - self._value(self.axes[k]["joint"])) / left
            elif self.axes[k]["led"]:
                data.ctrl[actuator] = self.before[k] + (self.inputs[k] - self.before[k]) * (phase + 1) / self.substeps
            else:
                data.ctrl[actuator] = self.inputs[k]

    def step(self, commands: Any) -> dict[str, float]:
        """Hold ``commands`` (A,) for one sample; returns the signals after it."""
        self.commands = np.array(commands, dtype=np.float64)
        for _ in range(self.substeps):
            self.control(self.model, self.data)
            mujoco.mj_step(self.model, self.data)
        for update in (mujoco.mj_kinematics, mujoco.mj_comPos, mujoco.mj_tendon, mujoco.mj_transmission):
            update(self.model, self.data)
        return self.signals()

    def readings(self) -> dict[str, float]:
        """The signals as their sensors read them."""
        sensors = self.drives.sensors
        return {name: sensors[name].read(x) if name in sensors else x for name, x in self.signals().items()}

    def signals(self) -> dict[str, float]:
        """True signals: ``<axis>.joint``, ``<axis>.cylinder``, ``ee.x`` …, ``tool.x`` … [rad, m]."""
        found = {}
        for k, axis in enumerate(self.axes):
            if axis["mode"] == "drive_model":
                found[axis["driven"]] = float(self.state.drive[k])
                behind = self.state.structure[k] - self.state.joints[k]  # what is between the sensor and the structure
                found[f"{self.names[k]}.joint"] = self._value(axis["joint"]) - behind
            else:
                found[axis["driven"]] = float(self.data.actuator_length[self.actuators[k]]) - axis["zero"]
                found[f"{self.names[k]}.joint"] = self._value(axis["sensed_joint"]) - axis["offset"]
        if self.about["posed"]:
            place = self.data.site("ee").xpos
            tool = self.data.site("tool").xpos if self.about["swings"] else place + self.state.tool - self.state.ee
            found |= {f"ee.{axis}": float(place[j]) for j, axis in enumerate("xyz")}
            found |= {f"tool.{axis}": float(tool[j]) for j, axis in enumerate("xyz")}
        return found

    def _input(self, k: int) -> float:
        """What the actuator of an axis takes: its command, or what the first parts of the drive model make of it."""
        count = self.axes[k]["prefix"] if self.axes[k]["mode"] == "command" else 0
        return float(self.drives.axes[k].drive.values[count - 1] if count else self.commands[k])

    def _hold(self, actuator: int, value: float) -> None:
        """The actuator as if it had held ``value`` since long before."""
        self.data.ctrl[actuator] = value
        if self.model.actuator_actadr[actuator] >= 0:
            self.data.act[self.model.actuator_actadr[actuator]] = value
        count = self.model.actuator_history[actuator, 0]
        if count > 0:
            mujoco.mj_initCtrlHistory(self.model, self.data, actuator, None, np.full(count, value))

    def _value(self, joint: str) -> float:
        return float(self.data.qpos[self.model.joint(joint).qposadr[0]])

    def _set(self, joint: str, value: float) -> None:
        self.data.qpos[self.model.joint(joint).qposadr[0]] = value


def _slope(link: Any, place: float, near: float = 1e-6) -> float:
    """Speed of a joint at unit speed of its cylinder."""
    return float(link.joint(place + near) - link.joint(place - near)) / (2.0 * near)
