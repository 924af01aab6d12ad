"""Rows of what moves the machine: steps of the environment in the paper's setting, and inverse kinematics."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from benchmarks.crane import crane
from benchmarks.rows import in_turns, row
from sysid.plant import Plant, compile_plant
from sysid.signals import axis_signal
from sysid_rl.train.inverse_kinematics import InverseKinematics, KinematicChain, chain_of_plant
from sysid_rl.train.kinematic import KinematicEnvironment
from sysid_rl.train.reach import joint_limits, tips
from sysid_rl.train.task import Task

Array = npt.NDArray[np.float64]

COPIES = (64, 1024)
STEPS, TARGETS, REPEATS = 60, 20, 25
#: Lengths of the crane [m]: height of the boom's joint, boom, stick.
HEIGHT, BOOM, STICK = 0.285, 0.576, 0.400


class Forward:
    """The plant as a forward model."""

    def __init__(self, plant: Plant) -> None:
        self.plant, self.joints = plant, tuple(axis_signal(name, "joint") for name in plant.machine.axis_names)
        self.low, self.high = joint_limits(plant)

    def predict(self, q: npt.ArrayLike) -> Array:
        return tips(compile_plant(self.plant), np.atleast_2d(np.asarray(q, dtype=np.float64)))

    def spread(self, q: npt.ArrayLike) -> Array:
        return np.zeros((len(np.atleast_2d(q)), 3))


class Batched:
    """The same environment as one writes it in NumPy: closed kinematics of this crane, all copies in each operation."""

    def __init__(self, low: Array, high: Array, targets: Array, task: Task) -> None:
        self.low, self.high, self.targets, self.task = low, high, targets, task
        self.count = np.zeros(len(targets), dtype=np.int64)

    def step(self, actions: Array) -> tuple[Array, Array, npt.NDArray[np.bool_]]:
        q = np.clip(actions, self.low, self.high)
        outside = (q != actions).any(axis=1)
        stick = q[:, 1] + q[:, 2]
        reach = BOOM * np.cos(q[:, 1]) + (STICK + q[:, 3]) * np.cos(stick)
        height = HEIGHT + BOOM * np.sin(q[:, 1]) + (STICK + q[:, 3]) * np.sin(stick)
        ee = np.column_stack([reach * np.cos(q[:, 0]), reach * np.sin(q[:, 0]), height])
        away = np.sqrt(np.sum((self.targets - ee) ** 2, axis=1))
        rewards = self.task.step_reward + self.task.near_reward - away + self.task.outside_reward * outside
        self.count += 1
        return np.concatenate([q, ee, self.targets], axis=1), rewards, self.count >= self.task.steps


def motion_rows() -> list[dict[str, Any]]:
    plant = replace(crane(), effects=(), reference="")
    return [*(_environment(plant, copies) for copies in COPIES), _inverse(plant)]


def _environment(plant: Plant, copies: int) -> dict[str, Any]:
    task = Task(steps=10**9)
    ours = KinematicEnvironment(plant, Forward(plant), size=copies, task=task)
    seen = ours.reset()
    theirs = Batched(ours.action_low, ours.action_high, ours.targets(seen), task)
    actions = seen[:, :4] + 0.1 * np.random.default_rng(0).standard_normal((copies, 4))
    for mine, other in zip(ours.step(actions), theirs.step(actions), strict=True):
        np.testing.assert_allclose(mine, other, atol=1e-12)  # both are the same machine

    def run(environment: KinematicEnvironment | Batched) -> None:
        for _ in range(STEPS):
            environment.step(actions)

    taken = in_turns({"ours": lambda: run(ours), "theirs": lambda: run(theirs)}, REPEATS)
    rates = {name: [STEPS * copies / t for t in times] for name, times in taken.items()}
    return row(
        f"environment_{copies}", "NumPy, batched", rates["ours"], rates["theirs"], "steps/s",
        "the paper's setting; joints, end effector, reward and observation of every copy in each step", more_is_better=True,
    )  # fmt: skip


def _inverse(plant: Plant) -> dict[str, Any]:
    chain, (low, high) = chain_of_plant(plant), joint_limits(plant)
    assert isinstance(chain, KinematicChain)
    rng = np.random.default_rng(0)
    joints = rng.uniform(low, high, (TARGETS, len(low)))
    targets = chain.predict(joints)
    begin = np.clip(joints + 0.05 * rng.standard_normal(joints.shape), low + 1e-6, high - 1e-6)
    inverse = InverseKinematics.of(chain, low, high)

    def theirs() -> None:
        for target, start in zip(targets, begin, strict=True):
            least_squares(lambda q, target=target: chain.predict(q)[0] - target, start, bounds=(low, high), xtol=1e-8)

    taken = in_turns({"ours": lambda: inverse.solve(targets, begin), "theirs": theirs}, REPEATS)
    per_target = {name: [1e6 * t / TARGETS for t in times] for name, times in taken.items()}
    return row(
        "inverse_kinematics", "scipy least_squares", per_target["ours"], per_target["theirs"], "µs",
        "a bounded target from joints nearby, to 0.1 µm; SciPy: trust-region reflective on the same compiled kinematics",
    )  # fmt: skip
