"""A plant version in PyBullet: the compiled chain moves the driven joints, rigid-body dynamics the tool and the logs.

The surroundings of the machine are ground and logs, as simple bodies.
"""

from __future__ import annotations

import math
import tempfile
import weakref
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.errors import SettingsError, nearest
from sysid.plant import Plant
from sysid.plant.layout import AT, base_place
from sysid.plant.plant import LINKAGE
from sysid.plant.stepper import LaneState, Stepper, held_commands, step_commands
from sysid.signals import axis_signal, point_signals
from sysid.world.bodies import Gripper, build_bodies, passive_joints
from sysid.world.client import connect, disconnect, pybullet

Array = npt.NDArray[np.float64]

#: Half side and thickness of the ground [m].
GROUND = (25.0, 0.05)


@dataclass(frozen=True)
class Log:
    """A loose horizontal log; a cylinder of constant density.

    Args:
        position: its centre in the machine's frame [m].
        yaw: direction of its axis about the vertical [rad].
        density: [kg/m³]; 700 is fresh pine.
    """

    position: tuple[float, float, float]
    yaw: float = 0.0
    length: float = 0.6
    radius: float = 0.03
    density: float = 700.0

    @property
    def mass(self) -> float:
        return self.density * math.pi * self.radius**2 * self.length


def add_ground(p: Any, client: int, height: float) -> int:
    """Add a wide flat box whose top is at ``height`` [m]; returns the body."""
    side, thick = GROUND
    half = [side, side, 0.5 * thick]
    shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=half, physicsClientId=client)
    look = p.createVisualShape(p.GEOM_BOX, halfExtents=half, rgbaColor=[0.80, 0.82, 0.78, 1.0], physicsClientId=client)
    body = p.createMultiBody(0.0, shape, look, [0.0, 0.0, height - 0.5 * thick], physicsClientId=client)
    p.changeDynamics(body, -1, lateralFriction=0.8, physicsClientId=client)
    return int(body)


def add_log(p: Any, client: int, log: Log) -> int:
    """Add a log at rest; returns the body."""
    shape = p.createCollisionShape(p.GEOM_CYLINDER, radius=log.radius, height=log.length, physicsClientId=client)
    look = p.createVisualShape(
        p.GEOM_CYLINDER, radius=log.radius, length=log.length, rgbaColor=[0.55, 0.40, 0.25, 1.0], physicsClientId=client
    )
    turn = p.getQuaternionFromEuler([0.0, 0.5 * math.pi, log.yaw])
    body = p.createMultiBody(log.mass, shape, look, list(log.position), turn, physicsClientId=client)
    p.changeDynamics(body, -1, lateralFriction=0.7, rollingFriction=1e-3, physicsClientId=client)
    return int(body)


Mode = Literal["kinematic", "dynamic"]

#: Force of a drive without limit [N or N·m].
_UNLIMITED = 1e9
#: Direction of the camera: about the vertical, and from above [rad].
_CAMERA = (0.7, -0.45)


@dataclass(frozen=True)
class WorldState:
    """The machine at one sample.

    Args:
        drive: driven coordinates, cylinder [m] or joint [rad or m], (axes,), from the compiled chain.
        joints: at the joint sensors, from the bodies, (axes,).
        ee, tool: from the bodies, (3,) [m].
    """

    drive: Array
    joints: Array
    ee: Array
    tool: Array


class World:
    """One machine in its own PyBullet client. Close it, or use it in a ``with`` statement.

    Args:
        plant: any plant version whose machine has a URDF and whose axes all have a linkage or drive their joint.
        rate_hz: steps per second; default: the machine's.
        substeps: of the rigid bodies per step.
        mode: ``kinematic``: the driven joints follow the chain exactly, whatever obstructs them;
            ``dynamic``: the drives are limited to the effort limits of the URDF.
        gripper: ``rigid`` with the URDF's masses and inertias, ``point`` with all mass in the tool's origin.
        logs: loose bodies.
        ground: height of the ground in the machine's frame [m]; default: under the first link.
        window: show PyBullet's own window.

    Raises:
        SettingsError: PyBullet is missing, the machine has no URDF, a linkage is missing, an unknown mode.
    """

    def __init__(
        self,
        plant: Plant,
        rate_hz: float | None = None,
        *,
        substeps: int = 4,
        mode: Mode = "kinematic",
        gripper: Gripper = "rigid",
        logs: tuple[Log, ...] = (),
        ground: float | None = None,
        window: bool = False,
    ) -> None:
        for name, value, valid in (("mode", mode, ("kinematic", "dynamic")), ("gripper", gripper, ("rigid", "point"))):
            if value not in valid:
                raise SettingsError("PyBullet world", f"{name} = {value!r}", nearest(value, valid))
        if substeps < 1:
            raise SettingsError("PyBullet world", f"substeps = {substeps}", "at least 1")
        self.plant, self.substeps, self.mode, self.logs = plant, substeps, mode, logs
        self.rate_hz = rate_hz or plant.machine.rate_hz
        self._bodies = build_bodies(plant, gripper)
        for axis in plant.machine.axes:
            if axis.drives == "cylinder" and axis.name not in plant.linkages:
                raise SettingsError("PyBullet world", f"axis {axis.name} has no linkage", LINKAGE)
        self._stepper = Stepper(plant, self.rate_hz)
        self._ground = self._bodies.ground if ground is None else ground
        self._p = pybullet()
        self._client = connect(window)
        self._folder = tempfile.TemporaryDirectory(prefix="sysid-world-")
        self._finish = weakref.finalize(self, _close, self._client, self._folder)
        (Path(self._folder.name) / "machine.urdf").write_text(self._bodies.urdf, "utf-8")
        self._begun = False
        self._target = np.zeros(len(plant.machine.axes))
        self._load()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """Release PyBullet's client; repeated calls have no effect."""
        self._finish()

    @property
    def closed(self) -> bool:
        return not self._finish.alive

    def reset(self, joints: npt.ArrayLike, commands: npt.ArrayLike | None = None) -> WorldState:
        """Set to rest at joint values (axes,), with the logs at their positions and ``commands``, default zero, held before."""
        self._check_open()
        return self._place(self._stepper.reset(joints, commands=commands))

    def step(self, commands: npt.ArrayLike) -> WorldState:
        """Hold ``commands`` (axes,) for one step.

        Raises:
            SettingsError: closed, not reset, or another number of commands.
        """
        self._check_open()
        if not self._begun:
            raise SettingsError("PyBullet world", "was never reset", "reset(joints) before the first step")
        state = self._stepper.step(commands)
        self._drive_to(state.structure[0])
        return self._read(state)

    def rollout(self, recording: Recording) -> pd.DataFrame:
        """Run of the world with the recorded commands.

        It starts and restarts where :func:`sysid.plant.free_run` does; rows without a command of any axis are NaN.

        Returns:
            The columns of the free run on the recording's rows, with the sensor effects of the plant.
        """
        machine = self.plant.machine
        values = np.full((len(recording), 2 * len(machine.axes) + 6), np.nan)
        for row, state in self.replay(recording):
            values[row] = np.concatenate([state.drive, state.joints, state.ee, state.tool])
        joints = [axis_signal(name, "joint") for name in machine.axis_names]
        points = [*point_signals("ee"), *point_signals("tool")]
        names = [*(axis.driven for axis in machine.axes), *joints, *points]
        table = dict(zip(names, values.T, strict=True))  # where the drive is the joint, that of the bodies is used
        model, dt = self._stepper.model, 1.0 / self.rate_hz
        speeds = {axis_signal(axis.name, "speed"): axis for axis in machine.axes}
        sensed = {
            name: model.sensed_rate(model.theta[None], speeds[name].name, table[speeds[name].driven][None], self.rate_hz)[0]
            if name in speeds
            else model.sensed(model.theta[None], name, table[name][None], dt)[0]
            for name in self._in_order(recording)
        }
        return pd.DataFrame({"time": recording.values("time"), **sensed})

    def replay(self, recording: Recording) -> Iterator[tuple[int, WorldState]]:
        """Run with the recorded commands: row of the recording and state, one at a time."""
        self._check_open()
        if recording.rate_hz != self.rate_hz:
            raise SettingsError(f"recording {recording.name}", f"{recording.rate_hz} Hz", f"{self.rate_hz} Hz, as the world")
        commands = held_commands(self.plant.machine, recording)
        steps = step_commands(self.plant.machine, commands)
        known = ~np.isnan(commands.sum(axis=1))
        for k in map(int, np.flatnonzero(known)):
            if k == 0 or not known[k - 1]:
                yield k, self._place(self._stepper.begin(recording, k))
            else:
                yield k, self.step(steps[k - 1])

    def picture(
        self,
        width: int = 640,
        height: int = 480,
        *,
        target: tuple[float, float, float] | None = None,
        distance: float | None = None,
    ) -> npt.NDArray[np.uint8]:
        """A camera picture, RGB (height, width, 3).

        Args:
            target: centre of the picture; default: halfway between base and tip.
            distance: of the camera from it [m]; default: so that the machine fits.
        """
        self._check_open()
        p = self._p
        ee = self._link(self._tip)[0]
        at = target if target is not None else tuple(0.5 * (self._base[0] + ee))
        away = distance if distance is not None else 1.25 * self._size
        yaw, pitch = (float(np.degrees(angle)) for angle in _CAMERA)
        view = p.computeViewMatrixFromYawPitchRoll(list(at), away, yaw, pitch, 0.0, 2)
        lens = p.computeProjectionMatrixFOV(45.0, width / height, 0.02 * away, 20.0 * away)
        pixels = p.getCameraImage(
            width, height, view, lens, renderer=p.ER_TINY_RENDERER, lightDirection=[1.0, -1.5, 3.0], shadow=0,
            physicsClientId=self._client,
        )[2]  # fmt: skip
        return np.array(np.reshape(pixels, (height, width, 4))[:, :, :3], dtype=np.uint8)

    def link_poses(self) -> dict[str, tuple[Array, Array]]:
        """Position (3,) [m] and orientation (x, y, z, w) of every link of the machine, by name."""
        self._check_open()
        found = {self._root: self._base}
        for name, link in self._links.items():
            place, turn = self._link(link)
            found[name] = (place, np.array(turn))
        return found

    def log_positions(self) -> Array:
        """Centres of the loose logs, (logs, 3) [m]."""
        self._check_open()
        found = [self._p.getBasePositionAndOrientation(log, physicsClientId=self._client)[0] for log in self._loose]
        return np.array(found, dtype=np.float64).reshape(-1, 3)

    def contacts(self) -> int:
        """Number of contact points of the machine."""
        self._check_open()
        return len(self._p.getContactPoints(bodyA=self._machine, physicsClientId=self._client))

    def _load(self) -> None:
        """Load all bodies again, so that runs from the same start are bit-identical."""
        p, client, machine = self._p, self._client, self.plant.machine
        p.resetSimulation(physicsClientId=client)
        p.setGravity(0.0, 0.0, -machine.gravity, physicsClientId=client)
        p.setPhysicsEngineParameter(
            fixedTimeStep=1.0 / (self.rate_hz * self.substeps), numSolverIterations=50, solverResidualThreshold=0.0,
            deterministicOverlappingPairs=1, physicsClientId=client,
        )  # fmt: skip
        self._base = self._base_pose()
        flags = p.URDF_USE_INERTIA_FROM_FILE
        self._machine: int = p.loadURDF(
            str(Path(self._folder.name) / "machine.urdf"), list(self._base[0]), list(self._base[1]), useFixedBase=True,
            flags=flags, physicsClientId=client,
        )  # fmt: skip
        self._ground_body = add_ground(p, client, self._ground)
        self._loose = [add_log(p, client, log) for log in self.logs]
        joint_of, link_of = {}, {}
        for k in range(p.getNumJoints(self._machine, physicsClientId=client)):
            info = p.getJointInfo(self._machine, k, physicsClientId=client)
            joint_of[info[1].decode()], link_of[info[12].decode()] = k, k
            # By default Bullet damps all bodies.
            p.changeDynamics(
                self._machine, k, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0, lateralFriction=0.7,
                maxJointVelocity=1e4, physicsClientId=client,
            )  # fmt: skip
        kinematics = machine.kinematics()
        assert kinematics is not None
        self._driven = [joint_of[axis.joint or ""] for axis in machine.axes]
        following = {name: drive for name, drive in kinematics.drives.items() if name not in kinematics.actuated}
        self._followers = [joint_of[name] for name in following]
        self._follow = tuple(following.values())
        self._tip = link_of[machine.tip or ""]
        self._links = link_of
        self._root: str = p.getBodyInfo(self._machine, physicsClientId=client)[0].decode()
        self._force = [_UNLIMITED if self.mode == "kinematic" else min(e, _UNLIMITED) for e in self._bodies.effort]
        self._passive: list[int] = []
        self._tool: int | None = None
        if self._bodies.hanging is not None:
            self._tool = link_of[self._bodies.hanging.tool]
            for joint, damping in zip(self._bodies.hanging.joints, self._bodies.hanging.damping, strict=True):
                self._passive.append(joint_of[joint.name])
                p.changeDynamics(self._machine, joint_of[joint.name], jointDamping=damping, physicsClientId=client)
                p.setJointMotorControl2(
                    self._machine, joint_of[joint.name], p.VELOCITY_CONTROL, force=0.0, physicsClientId=client
                )
        self._size = 1.0 + sum(float(np.linalg.norm(joint.origin[:3, 3])) for joint in kinematics.chain)

    def _base_pose(self) -> tuple[Array, Array]:
        """Position and orientation (x, y, z, w) of the machine in the frame in which tip and tool are measured."""
        base = base_place(len(self.plant.machine.axes)) + AT.base_misalignment
        shift, turn = np.split(self.plant.vector()[base : base + 6], 2)
        angle = float(np.linalg.norm(turn))
        axis = turn / angle if angle > 0.0 else turn
        return shift, np.array([*(np.sin(0.5 * angle) * axis), np.cos(0.5 * angle)])

    def _place(self, state: LaneState) -> WorldState:
        """Set the bodies to an initial state of the chain."""
        p, client, machine = self._p, self._client, self._machine
        if not np.isfinite(state.structure).all():
            raise SettingsError("PyBullet world", "a joint value is missing at the start", "a number for each joint")
        self._load()
        self._target = state.structure[0]
        for joint, value in zip((*self._driven, *self._followers), self._with_passive(self._target), strict=True):
            p.resetJointState(self._machine, joint, float(value), 0.0, physicsClientId=client)
        if self._bodies.hanging is not None:
            place, turn = self._link(self._tip)
            x, y, vx, vy = self._stepper.swing[0]
            rotation = np.array(p.getMatrixFromQuaternion(turn)).reshape(3, 3)
            flat = np.array([x, y]) - place[:2]
            angles, rates = passive_joints(self._bodies.hanging, rotation, flat, np.array([vx, vy]))
            for joint, angle, rate in zip(self._passive, angles, rates, strict=True):
                p.resetJointState(machine, joint, float(angle), float(rate), physicsClientId=client)
        self._begun = True
        return self._read(state)

    def _drive_to(self, target: Array) -> None:
        """Advance by one step while the driven joints move linearly to ``target``."""
        p, client, machine = self._p, self._client, self._machine
        joints, forces = [*self._driven, *self._followers], [*self._force, *(_UNLIMITED for _ in self._followers)]
        begin, end, parts = self._with_passive(self._target), self._with_passive(target), self.substeps
        slope = (end - begin) * self.rate_hz
        for part in range(parts):
            # Feed-forward speed plus position error.
            p.setJointMotorControlArray(
                machine, joints, p.POSITION_CONTROL, targetPositions=list(begin + (end - begin) * part / parts),
                targetVelocities=list(slope), forces=forces, positionGains=[1.0] * len(slope),
                velocityGains=[1.0] * len(slope), physicsClientId=client,
            )  # fmt: skip
            p.stepSimulation(physicsClientId=client)
        if self.mode == "kinematic":
            for joint, value, speed in zip(joints, end, slope, strict=True):
                p.resetJointState(machine, joint, float(value), float(speed), physicsClientId=client)
        self._target = target

    def _with_passive(self, target: Array) -> Array:
        """Values of the axes, then those of the passive joints that follow them."""
        return np.array([*target, *(drive.ratio * target[drive.column] + drive.offset for drive in self._follow)])

    def _read(self, state: LaneState) -> WorldState:
        angles = self._p.getJointStates(self._machine, self._driven, physicsClientId=self._client)
        missed = np.array([angle[0] for angle in angles]) - self._target
        ee = self._link(self._tip)[0]
        tool = self._link(self._tool)[0] if self._tool is not None else ee.copy()
        return WorldState(state.drive[0], state.joints[0] + missed, ee, tool)

    def _link(self, link: int) -> tuple[Array, tuple[float, ...]]:
        """Position (3,) and orientation (x, y, z, w) of a link's frame."""
        found = self._p.getLinkState(self._machine, link, computeForwardKinematics=1, physicsClientId=self._client)
        return np.array(found[4]), found[5]

    def _in_order(self, recording: Recording) -> list[str]:
        """Signals of a run in the order of :func:`sysid.plant.free_run`."""
        names: list[str] = []
        for axis in self.plant.machine.axes:
            names += dict.fromkeys((axis.driven, axis_signal(axis.name, "joint")))
            names += [speed for speed in (axis_signal(axis.name, "speed"),) if speed in recording.signals]
        model = self._stepper.model
        tool = point_signals("tool") if model.has_tool(model.theta, recording) else ()
        return [*names, *point_signals("ee"), *tool]

    def _check_open(self) -> None:
        if self.closed:
            raise SettingsError("PyBullet world", "is closed", "an open world", "Make a new one.")


def _close(client: int, folder: tempfile.TemporaryDirectory[str]) -> None:
    disconnect(client)
    folder.cleanup()
