"""The controllers of a run: a policy that was trained on the full path observes in a run what it observed in training."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from crane_model import Perfect, crane_plant

from sysid.machine import KnownEffect
from sysid.networks.mlp import Mlp, Normalisation
from sysid.networks.policy import PolicyNetwork
from sysid_rl.control import tune
from sysid_rl.control.input_shaper import InputShaper
from sysid_rl.control.pendulum import pendulum_of
from sysid_rl.run.chain import ControlChain
from sysid_rl.run.limits import LimitSettings, limits_of
from sysid_rl.run.valves import axis_valves
from sysid_rl.train.driven import DrivenEnvironment
from sysid_rl.train.inverse_kinematics import InverseKinematics, chain_of_plant
from sysid_rl.train.residual_observation import Residual, ResidualObservation
from sysid_rl.train.residual_policy import ResidualPolicy
from sysid_rl.train.task import ObservationSlices, Task

Array = npt.NDArray[np.float64]
PLANT = crane_plant(KnownEffect("gripper_sway", "tool", {"length": 0.22, "damping_ratio": 0.04}))
FORWARD = Perfect(PLANT)
AXES = PLANT.machine.axis_names


class Still:
    """A policy that observes everything."""

    def __init__(self, inputs: tuple[str, ...]) -> None:
        self.inputs, self.outputs = inputs, FORWARD.joints

    def act(self, observations: Array) -> Array:
        return observations[:, :4]


@pytest.fixture
def environment() -> DrivenEnvironment:
    return DrivenEnvironment(PLANT, FORWARD, task=Task(steps=1000))


def chain_for(inputs: tuple[str, ...]) -> ControlChain:
    inverse = InverseKinematics.of(chain_of_plant(PLANT), FORWARD.low, FORWARD.high)
    return ControlChain(PLANT, FORWARD, inverse, policy=Still(inputs))


def test_observations_of_a_run_are_those_of_the_training(environment: DrivenEnvironment) -> None:
    begin, target = np.array([0.0, 0.4, -1.2, 0.1]), np.array([0.8, 0.0, 0.3])
    seen = environment.begin(begin, target)
    chain = chain_for(environment.names)
    chain.rest(chain.controller.drive(begin)[0], begin)
    for k in range(200):
        seen, _, _ = environment.step(np.array([[0.3 if k < 60 else 0.0, 0.5, -1.2, 0.1]]))
        joints = seen[0, :4]
        chain.moved(joints, environment.commands[0])
        own = chain.view.seen(joints[None], seen[:, 4:7], target[None], chain._below)
        np.testing.assert_allclose(own, seen, atol=1e-6)
    assert np.abs(seen[0, -6:-4]).max() > 0.003, "the tool swings"
    chain.rest(chain.controller.drive(begin)[0], begin)
    np.testing.assert_allclose(chain._below, [[0.0, 0.0, -0.22]])


def test_a_policy_that_does_not_observe_the_tool_needs_no_estimate(environment: DrivenEnvironment) -> None:
    assert chain_for(environment.names[:10])._swing is None
    assert chain_for(environment.names)._swing is not None


def test_a_policy_that_offsets_inverse_kinematics_runs_with_the_estimated_swing(environment: DrivenEnvironment) -> None:
    """The offset is in proportion to the swing: a policy of constant actions shows what the run estimates of it."""
    inverse = InverseKinematics.of(chain_of_plant(PLANT), FORWARD.low, FORWARD.high)
    view = ResidualObservation(PLANT.machine.axis_names, pendulum_of(PLANT), Residual(), inverse.high - inverse.low)
    names = (*environment.names[:10], *view.names)
    same = Normalisation(np.zeros(len(names)), np.ones(len(names)))
    constant = Mlp((np.zeros((len(names), 4)),), (np.full(4, 0.5),), same, Normalisation(np.zeros(4), np.ones(4)))
    setting = {"share": 0.05, "full_swing": 0.05, "repeat": 1.0}
    network = PolicyNetwork(names, FORWARD.joints, constant, -np.ones(4), np.ones(4), full=True, residual=setting)
    chain = ControlChain(PLANT, FORWARD, inverse, policy=ResidualPolicy(network, PLANT, inverse))
    begin, target = np.array([0.0, 0.4, -1.2, 0.1]), np.array([0.8, 0.0, 0.3])
    for _ in range(2):  # the second time after a rest
        seen = environment.begin(begin, target)
        chain.rest(chain.controller.drive(begin)[0], begin)
        reference, largest = ResidualPolicy(network, PLANT, inverse), 0.0
        for k in range(120):
            own = chain.ask(seen[0, :4], seen[0, 4:7], target, 2**62, lambda: 0)
            np.testing.assert_allclose(own, reference.act(seen)[0], atol=1e-4)
            largest = max(largest, float(np.abs(own - inverse.solve(target[None], seen[:, :4])[0][0]).max()))
            seen, _, _ = environment.step(np.array([[0.3 if k < 60 else 0.0, 0.5, -1.2, 0.1]]))
            chain.moved(seen[0, :4], environment.commands[0])
        assert largest > 0.003, "the swing offsets the setpoints"


class Resting:
    """A policy that leads to ``joints``, by half of the way a step, or turns about them."""

    def __init__(self, joints: Array, turns: bool = False) -> None:
        self.joints, self.turns, self.inputs, self.outputs = joints, turns, ObservationSlices.of(4).names(AXES), FORWARD.joints

    def act(self, observations: Array) -> Array:
        away = observations[:, :4] - self.joints
        return np.asarray(self.joints + (-1.0 if self.turns else 0.5) * away)


def test_a_path_begins_where_the_policy_rests() -> None:
    inverse = InverseKinematics.of(chain_of_plant(PLANT), FORWARD.low, FORWARD.high)
    begin = np.array([0.0, 0.4, -1.2, 0.1])
    limits = limits_of(PLANT, axis_valves(tune(PLANT), 0.01), LimitSettings(), "test")
    other, far = begin + np.array([0.01, 0.0, 0.02, -0.01]), begin + np.array([0.5, 0.0, 0.0, 0.0])
    target = FORWARD.predict(begin[None])[0]

    def start(policy: Resting | None) -> Array:
        chain = ControlChain(PLANT, FORWARD, inverse, policy=policy)
        return chain.start(target, begin, limits, 0.03)

    np.testing.assert_allclose(start(Resting(other)), other, atol=1e-4)
    for policy in (None, Resting(other, turns=True), Resting(far)):  # a policy that does not rest, or not near the target
        np.testing.assert_array_equal(start(policy), begin)


def test_setpoints_of_a_policy_go_through_the_shaper_and_setpoints_of_a_task_do_not() -> None:
    inverse = InverseKinematics.of(chain_of_plant(PLANT), FORWARD.low, FORWARD.high)
    shaper, begin = InputShaper((0.0, 0.1), (0.6, 0.4)), np.array([0.0, 0.4, -1.2, 0.1])
    goal = begin + 0.01
    chain = ControlChain(PLANT, FORWARD, inverse, policy=Constant(goal), shaper=shaper)
    ee, target = FORWARD.predict(begin[None])[0], FORWARD.predict(goal[None])[0]
    for starts in (lambda: chain.rest(chain.controller.drive(begin)[0], begin), lambda: chain.solve_from(begin)):
        starts()
        asked = np.array([chain.ask(begin, ee, target, 2**62, lambda: 0) for _ in range(12)])
        shares = (asked - begin) / (goal - begin)
        np.testing.assert_allclose(shares, np.repeat([[0.6], [1.0]], [10, 2], axis=0) * np.ones(4), atol=1e-9)
    assert chain.shaped_s == 0.1


class Constant:
    """The same setpoints whatever it observes."""

    def __init__(self, joints: Array) -> None:
        self.joints, self.inputs, self.outputs = joints, ObservationSlices.of(4).names(AXES), FORWARD.joints

    def act(self, observations: Array) -> Array:
        return self.joints[None].copy()
