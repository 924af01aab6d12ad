"""An exported arm of servos in MuJoCo: positions in, motion out.

>>> arm = Servos("robot.xml")
>>> arm.reset(joints)                    # (A,) at the sensors [rad or m]
>>> arm.step(commands)                   # one sample of the machine, several steps of MuJoCo; commands (A,) as in machine.toml

The model is complete by itself: in a loop of your own, write the commands, plus the offset of each joint, into ``data.ctrl``.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from sysid.export.standalone.parts import SensorReading


class Servos:
    """The model beside its table of axes, ``<model>.json``.

    Args:
        path: of the MJCF file.
    """

    def __init__(self, path: str | Path) -> None:
        path = Path(path)
        self.about = json.loads(path.with_suffix(".json").read_text("utf-8"))
        self.model = mujoco.MjModel.from_xml_path(str(path))
        self.data = mujoco.MjData(self.model)
        self.names = [axis["axis"] for axis in self.about["axes"]]
        self.substeps = int(self.about["substeps"])
        self.controls = [int(self.model.actuator_ctrladr[self.model.actuator(name).id]) for name in self.names]
        joints = [self.model.joint(axis["joint"]) for axis in self.about["axes"]]
        self.places, self.dofs = [int(j.qposadr[0]) for j in joints], [int(j.dofadr[0]) for j in joints]
        self.offsets = np.array([axis["offset"] for axis in self.about["axes"]])
        #: Axis → joint behind its backlash.
        self.behind = {k: self.model.joint(axis["behind"]) for k, axis in enumerate(self.about["axes"]) if axis["behind"]}
        self.sensors = {name: SensorReading(**values) for name, values in self.about["sensors"].items()}

    def reset(self, joints: Any, commands: Any = None, speeds: Any = None) -> dict[str, float]:
        """A state of motion; ``commands`` (A,) were held since long before, by default the joints. Returns the signals."""
        mujoco.mj_resetData(self.model, self.data)
        places = np.asarray(joints, dtype=np.float64)
        self.data.qpos[self.places] = places + self.offsets
        if speeds is not None:
            self.data.qvel[self.dofs] = speeds
        for row in self.about["passive"]:
            leader = self.names.index(row["axis"])
            value = row["ratio"] * self.data.qpos[self.places[leader]] + row["offset"]
            self.data.qpos[int(self.model.joint(row["joint"]).qposadr[0])] = value
        held = (places if commands is None else np.asarray(commands)) + self.offsets
        for k, name in enumerate(self.names):
            actuator = self.model.actuator(name).id
            if self.model.actuator_actnum[actuator] > 0:
                self.data.act[int(self.model.actuator_actadr[actuator])] = held[k]
            if (count := int(self.model.actuator_history[actuator, 0])) > 0:
                mujoco.mj_initCtrlHistory(self.model, self.data, actuator, None, np.full((count, 1), held[k]))
        self.data.ctrl[self.controls] = held
        mujoco.mj_forward(self.model, self.data)
        for k, joint in self.behind.items():  # the motor presses the flank that carries the links
            half = np.sign(self.data.qfrc_bias[int(joint.dofadr[0])]) * joint.range[1]
            self.data.qpos[self.places[k]] += half
            self.data.qpos[int(joint.qposadr[0])] -= half
        mujoco.mj_forward(self.model, self.data)
        return self.signals()

    def step(self, commands: Any) -> dict[str, float]:
        """Hold ``commands`` (A,) for one sample; returns the signals after it."""
        self.data.ctrl[self.controls] = np.asarray(commands) + self.offsets
        for _ in range(self.substeps):
            mujoco.mj_step(self.model, self.data)
        mujoco.mj_kinematics(self.model, self.data)
        return self.signals()

    def signals(self) -> dict[str, float]:
        """True positions of the joints at their sensors, and of the end effector where the model has one [rad or m]."""
        places = self.data.qpos[self.places] - self.offsets
        for k, joint in self.behind.items():
            places[k] += self.data.qpos[int(joint.qposadr[0])]
        found = {f"{name}.joint": float(value) for name, value in zip(self.names, places, strict=True)}
        if self.about["posed"]:
            found |= {f"ee.{axis}": float(value) for axis, value in zip("xyz", self.data.site("ee").xpos, strict=True)}
        return found

    def readings(self) -> dict[str, float]:
        """The signals as their sensors read them."""
        sensors = self.sensors
        return {name: sensors[name].read(x) if name in sensors else x for name, x in self.signals().items()}
