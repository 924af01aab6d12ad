"""The same machine description in MuJoCo and in PyBullet: its four joints driven at commanded speeds, the gripper free.

Neither has valves, backlash, sensors or linkages; both solve the rigid-body dynamics of six joints. At each step both give the
four joints, the boom tip and the gripper, as the plant does.
"""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import mujoco.rollout
import numpy as np
import numpy.typing as npt
import pybullet

from sysid.machine import Machine

Array = npt.NDArray[np.float64]

GRAVITY = 9.80665
PASSIVE = ("gripper_pitch_joint", "gripper_roll_joint")
POINTS = ("tip", "gripper")
#: Servo of the commanded speed in MuJoCo: stiffness and damping that follow it within a few percent at 100 Hz, all axes alike.
_STIFFNESS, _DAMPING = 2e4, 400.0
#: Largest force of PyBullet's speed control [N·m or N]: its own constraint, not a limit that is felt.
_FORCE = 1e4


def hanging(joints: Array) -> Array:
    """All six joints with the gripper hanging straight down: its first angle is boom + stick."""
    return np.array([*joints, joints[1] + joints[2], 0.0])


def must_follow(name: str, commanded: Array, done: Array) -> None:
    """Check that a simulation follows the commanded speeds (n, 4).

    Raises:
        SystemExit: more than a tenth of the commanded speed is missing on an axis.
    """
    missing = np.sqrt(np.mean((done - commanded) ** 2, axis=0) / np.mean(commanded**2, axis=0))
    if not (missing < 0.1).all():
        raise SystemExit(f"{name} does not follow the commanded speeds: {np.round(missing, 3)} of them are missing")


class MujocoCrane:
    """Rollouts over lanes on ``threads`` threads."""

    def __init__(self, machine: Machine, rate_hz: float, start: Array, threads: int) -> None:
        spec = mujoco.MjSpec.from_string(machine.urdf_text)
        spec.compiler.fusestatic = False
        spec.option.timestep = 1.0 / rate_hz
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.gravity = [0.0, 0.0, -GRAVITY]
        for axis in machine.axes:
            drive = spec.add_actuator(name=axis.name, target=axis.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
            drive.set_to_intvelocity(kp=_STIFFNESS, kv=_DAMPING)
        for point in POINTS:
            spec.add_sensor(type=mujoco.mjtSensor.mjSENS_FRAMEPOS, objtype=mujoco.mjtObj.mjOBJ_BODY, objname=point)
        self.model = spec.compile()
        self._data = [mujoco.MjData(self.model) for _ in range(threads)]
        names = [*(axis.joint for axis in machine.axes), *PASSIVE]
        joints = [self.model.joint(name) for name in names]
        self._speeds = [1 + self.model.nq + int(joint.dofadr[0]) for joint in joints]
        first = self._data[0]
        for joint, value in zip(joints, hanging(start), strict=True):
            first.qpos[joint.qposadr[0]] = value
        first.act[:] = start
        kind = mujoco.mjtState.mjSTATE_FULLPHYSICS
        self.start = np.empty(mujoco.mj_stateSize(self.model, kind))
        mujoco.mj_getState(self.model, first, self.start, kind)
        self._pool = mujoco.rollout.Rollout(nthread=threads)

    def rollout(self, speeds: Array, lanes: int = 1) -> Array:
        """The same ``speeds`` (n, 4) in all lanes from the start: states (lanes, n, size)."""
        states, _ = self._pool.rollout(self.model, self._data, np.tile(self.start, (lanes, 1)), speeds[None])
        return np.asarray(states)

    def step_by_step(self, speeds: Array) -> Array:
        """Every step of all lanes a call of its own, as an environment does: ``speeds`` (n, lanes, 4) → last states."""
        lanes = speeds.shape[1]
        before, after = np.tile(self.start, (2, lanes, 1, 1)).reshape(2, lanes, 1, -1)
        points = np.empty((lanes, 1, self.model.nsensordata))
        for speed in speeds:
            self._pool.rollout(self.model, self._data, before[:, 0], speed[:, None], state=after, sensordata=points)
            before, after = after, before
        return before[:, 0]

    def driven_speeds(self, states: Array) -> Array:
        """Speeds of the four driven joints, (n, 4), of one lane of ``rollout``."""
        return states[:, self._speeds[:4]]

    def close(self) -> None:
        self._pool.close()


class BulletCrane:
    """One machine, stepped from Python."""

    def __init__(self, machine: Machine, urdf: str, rate_hz: float, start: Array) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        pybullet.setTimeStep(1.0 / rate_hz, physicsClientId=self._client)
        pybullet.setGravity(0.0, 0.0, -GRAVITY, physicsClientId=self._client)
        self._body = pybullet.loadURDF(urdf, useFixedBase=True, physicsClientId=self._client)
        about = [self._about(i) for i in range(pybullet.getNumJoints(self._body, physicsClientId=self._client))]
        joints, links = {name: i for i, (name, _) in enumerate(about)}, {link: i for i, (_, link) in enumerate(about)}
        self._driven = [joints[str(axis.joint)] for axis in machine.axes]
        self._passive = [joints[name] for name in PASSIVE]
        self._points = [links[name] for name in POINTS]
        self._start = hanging(start)
        for joint in self._passive:  # the built-in motor of every joint would hold the gripper
            pybullet.setJointMotorControl2(
                self._body, joint, pybullet.VELOCITY_CONTROL, force=0.0, physicsClientId=self._client
            )

    def _about(self, joint: int) -> tuple[str, str]:
        info = pybullet.getJointInfo(self._body, joint, physicsClientId=self._client)
        return info[1].decode(), info[12].decode()

    def run(self, speeds: Array) -> Array:
        """From the start with ``speeds`` (n, 4): joints, their speeds, tip and gripper, (n, 14)."""
        body, client, driven, points = self._body, self._client, self._driven, self._points
        forces = [_FORCE] * len(driven)
        for joint, value in zip([*driven, *self._passive], self._start, strict=True):
            pybullet.resetJointState(body, joint, value, physicsClientId=client)
        out = np.empty((len(speeds), 14))
        rows: Sequence[list[float]] = speeds.tolist()
        for k, speed in enumerate(rows):
            pybullet.setJointMotorControlArray(
                body, driven, pybullet.VELOCITY_CONTROL, targetVelocities=speed, forces=forces, physicsClientId=client
            )
            pybullet.stepSimulation(physicsClientId=client)
            joints = pybullet.getJointStates(body, driven, physicsClientId=client)
            tip, gripper = pybullet.getLinkStates(body, points, computeForwardKinematics=1, physicsClientId=client)
            out[k] = [*(j[0] for j in joints), *(j[1] for j in joints), *tip[4], *gripper[4]]
        return out

    def close(self) -> None:
        pybullet.disconnect(physicsClientId=self._client)
