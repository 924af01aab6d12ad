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
        self.names = [axis["axis"] for axis in self.about["axes"]]
        self.follows = np.array([axis["mode"] == "drive_model" for axis in self.about["axes"]])
        self.actuators = [self.model.actuator(name).id for name in self.names]
        self.places = [int(self.model.joint(axis["joint"]).qposadr[0]) for axis in self.about["axes"]]
        self.offsets = np.array([axis["offset"] for axis in self.about["axes"]])
        self.commands = np.zeros(len(self.names))
        self.state: Any = None
        self.count = 0

    def reset(self, joints: Any, drive: Any = None, commands: Any = None) -> dict[str, float]:
        """At rest, with ``commands`` (A,) held since long before; returns the signals."""
        mujoco.mj_resetData(self.model, self.data)
        self.state = self.drives.reset(joints, drive, commands)
        self.count = 0
        self.commands = np.zeros(len(self.names)) if commands is None else np.array(commands, dtype=np.float64)
        structure = np.asarray(self.state.structure)
        for k, axis in enumerate(self.about["axes"]):
            self.data.qpos[self.places[k]] = structure[k]
            if axis["actuation"] == "position":
                self.commands[k] = structure[k] - self.offsets[k]
        for follower in self.about["passive"]:
            value = structure[self.names.index(follower["axis"])] * follower["ratio"] + follower["offset"]
            self.data.qpos[self.model.joint(follower["joint"]).qposadr[0]] = value
        for k, actuator in enumerate(self.actuators):
            if self.follows[k]:
                continue
            self.data.ctrl[actuator] = self.commands[k]
            if self.model.actuator_actadr[actuator] >= 0:
                self.data.act[self.model.actuator_actadr[actuator]] = self.commands[k]
            if self.model.actuator_history[actuator, 0] > 0:
                samples = np.full(self.model.actuator_history[actuator, 0], self.commands[k])
                mujoco.mj_initCtrlHistory(self.model, self.data, actuator, None, samples)
        mujoco.mj_forward(self.model, self.data)
        return self.signals()

    def control(self, model: Any, data: Any) -> None:
        """Controls of the next step of MuJoCo, from ``commands``."""
        phase = self.count % self.substeps
        if phase == 0:
            self.state = self.drives.step(self.commands)
        for k, actuator in enumerate(self.actuators):
            if self.follows[k]:  # the speed that ends at the drive model's joint with its sample
                left = (self.substeps - phase) * model.opt.timestep
                data.ctrl[actuator] = (self.state.structure[k] - data.qpos[self.places[k]]) / left
            else:
                data.ctrl[actuator] = self.commands[k]
        self.count += 1

    def step(self, commands: Any) -> dict[str, float]:
        """Hold ``commands`` (A,) for one sample; returns the signals after it."""
        self.commands = np.array(commands, dtype=np.float64)
        for _ in range(self.substeps):
            self.control(self.model, self.data)
            mujoco.mj_step(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)
        return self.signals()

    def readings(self) -> dict[str, float]:
        """The signals as their sensors read them."""
        sensors = self.drives.sensors
        return {name: sensors[name].read(x) if name in sensors else x for name, x in self.signals().items()}

    def signals(self) -> dict[str, float]:
        """True signals: ``<axis>.joint``, ``<axis>.cylinder``, ``ee.x`` …, ``tool.x`` … [rad, m]."""
        found = {}
        for k, axis in enumerate(self.about["axes"]):
            if self.follows[k]:
                found[axis["driven"]] = float(self.state.drive[k])
                behind = self.state.structure[k] - self.state.joints[k]  # what is between the sensor and the structure
                found[f"{self.names[k]}.joint"] = float(self.data.qpos[self.places[k]] - behind)
            else:
                found[f"{self.names[k]}.joint"] = float(self.data.qpos[self.places[k]] - self.offsets[k])
        if self.about["posed"]:
            place = self.data.site("ee").xpos
            found |= {f"ee.{axis}": float(place[j]) for j, axis in enumerate("xyz")}
            found |= {f"tool.{axis}": float(place[j] + self.state.tool[j] - self.state.ee[j]) for j, axis in enumerate("xyz")}
        return found
