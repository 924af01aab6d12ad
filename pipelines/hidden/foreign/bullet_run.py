"""Runs a machine in PyBullet for one recording, without noise; every feature is a setting of PyBullet.

| feature | setting |
| --- | --- |
| lag of a position servo | ``positionGain``: the share of the error that a step closes |
| rate limit, weak motor | ``maxVelocity``, ``force`` of ``POSITION_CONTROL`` |
| viscous friction | ``jointDamping`` |
| dry friction | a motor of ``VELOCITY_CONTROL`` that holds zero speed with a limited force |
| soft wall | contact of a box with a ball, ``contactStiffness`` and ``contactDamping`` |
| weight | gravity |
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from hidden.foreign.description import arm_urdf
from hidden.foreign.excitation import Take
from hidden.foreign.machines import Tables, axes_of
from hidden.foreign.programs import arm_paths, counts, force_path, tracking_force
from sysid.world.client import connect, disconnect, pybullet

Array = npt.NDArray[np.float64]

#: Force of a servo that is not weak [N·m], and length of the lever that meets a wall [m].
STRONG, LEVER = 1e4, 0.5


class World:
    """Functions of the simulator, each for one client of it."""

    def __init__(self, module: Any, client: int) -> None:
        self._module, self._client = module, client

    def __getattr__(self, name: str) -> Any:
        return partial(getattr(self._module, name), physicsClientId=self._client)


def run_bullet(tables: Tables, take: Take) -> pd.DataFrame:
    """``time`` and the true signals of the machine on the controller's grid."""
    ticks, before, substeps = counts(tables, take)
    client = connect(window=False)
    try:
        world = World(pybullet(), client)
        world.setTimeStep(tables["step"])
        run = _arm if tables["family"] == "bullet_arm" else _lever
        rows, columns = run(world, tables, take, ticks, before, substeps)
    finally:
        disconnect(client)
    return pd.DataFrame(rows[before:], columns=columns).assign(time=np.arange(ticks - before) / tables["rate"])


def _load(world: World, urdf: str) -> int:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "machine.urdf"
        path.write_text(urdf, "utf-8")
        body: int = world.loadURDF(str(path), useFixedBase=True, flags=pybullet().URDF_USE_INERTIA_FROM_FILE)
    for link in range(-1, world.getNumJoints(body)):
        world.changeDynamics(body, link, linearDamping=0.0, angularDamping=0.0, jointDamping=0.0)
    return body


def _arm(world: World, tables: Tables, take: Take, ticks: int, before: int, substeps: int) -> tuple[Array, list[str]]:
    names = axes_of(tables)
    wanted = arm_paths(tables, take, ticks, before)
    body = _load(world, arm_urdf(tables))
    world.setGravity(0.0, 0.0, -9.81 * tables["gravity"])
    axes = list(tables["axes"].values())
    for k, value in enumerate(wanted[0]):
        world.resetJointState(body, k, value)
    drive, step, states = world.setJointMotorControl2, world.stepSimulation, world.getJointStates
    mode = pybullet().POSITION_CONTROL
    rows = np.empty((ticks, 2 * len(names)))
    for tick in range(ticks):
        rows[tick] = [*wanted[tick], *(state[0] for state in states(body, range(len(names))))]
        for k, axis in enumerate(axes):
            drive(
                body, k, mode, targetPosition=wanted[tick, k], positionGain=tables["step"] / axis["lag"],
                velocityGain=1.0, force=axis.get("strength", STRONG), maxVelocity=axis.get("slew_rate", 1e3),
            )  # fmt: skip
        for _ in range(substeps):
            step()
    return rows, [f"{name}.{part}" for part in ("command", "joint") for name in names]


def _lever(world: World, tables: Tables, take: Take, ticks: int, before: int, substeps: int) -> tuple[Array, list[str]]:
    """A lever about an upright axis; where it has an unbalance, about a level one."""
    wanted, speeds = force_path(tables, take, ticks, before)
    unbalance = tables.get("unbalance", 0.0)
    body = _load(world, _lever_urdf(tables))
    world.changeDynamics(body, 0, jointDamping=tables["viscous"], linearDamping=0.0, angularDamping=0.0)
    world.setGravity(0.0, 0.0, -9.81 if unbalance else 0.0)
    world.setJointMotorControl2(body, 0, pybullet().VELOCITY_CONTROL, targetVelocity=0.0, force=tables["coulomb"])
    world.resetJointState(body, 0, wanted[0])
    if "wall" in tables:
        _wall(world, body, tables)
    push, step, state = world.setJointMotorControl2, world.stepSimulation, world.getJointState
    mode = pybullet().TORQUE_CONTROL
    rows = np.empty((ticks, 2))
    for tick in range(ticks):
        position, velocity = state(body, 0)[:2]
        torque = tracking_force(tables, wanted[tick], speeds[tick], position, velocity)
        rows[tick] = torque, position
        for _ in range(substeps):
            # A torque acts for one step only.
            push(body, 0, mode, force=torque - tables["load"])
            step()
    return rows, ["lever.command", "lever.joint"]


def _lever_urdf(tables: Tables) -> str:
    """Inertia about the axis as in the tables, mass of the unbalance included."""
    unbalance = tables.get("unbalance", 0.0)
    about = "0 -1 0" if unbalance else "0 0 1"
    mass = 1.0
    away = unbalance / (mass * 9.81)
    own = tables["inertia"] - mass * away**2
    shape = ""
    if "wall" in tables:
        shape = f'<collision><origin xyz="{LEVER} 0 0"/><geometry><sphere radius="0.02"/></geometry></collision>'
    return (
        '<?xml version="1.0"?>\n<robot name="lever">\n  <link name="base"><inertial><mass value="1"/>'
        '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>\n'
        f'  <joint name="lever" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="{about}"/></joint>\n'
        f'  <link name="arm"><inertial><origin xyz="{away:.12g} 0 0"/><mass value="{mass}"/><inertia ixx="{own:.12g}" ixy="0" '
        f'ixz="0" iyy="{own:.12g}" iyz="0" izz="{own:.12g}"/></inertial>{shape}</link>\n</robot>\n'
    )


def _wall(world: World, lever: int, tables: Tables) -> None:
    """A soft block that the lever's ball meets at an angle."""
    wall = tables["wall"]
    block = world.createCollisionShape(pybullet().GEOM_BOX, halfExtents=[0.2, 0.05, 0.2])
    away = LEVER * np.array([np.cos(wall["at"]), np.sin(wall["at"]), 0.0])
    across = np.array([-np.sin(wall["at"]), np.cos(wall["at"]), 0.0])
    turned = pybullet().getQuaternionFromEuler([0.0, 0.0, wall["at"]])
    body = world.createMultiBody(0.0, block, basePosition=(away + (0.05 + 0.02) * across).tolist(), baseOrientation=turned)
    for each, link in ((body, -1), (lever, 0)):
        world.changeDynamics(
            each, link, contactStiffness=wall["stiffness"], contactDamping=0.01 * wall["stiffness"], lateralFriction=0.0
        )
