"""Queries beyond the data of a network are objected to, ways back are not; sensors that contradict each other stop."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from crane_store import learned
from runner_case import DT, MIDDLE, PLANT, case

from sysid.errors import SettingsError
from sysid.networks.mlp import Mlp, Normalisation
from sysid.networks.uncertainty import NetworkUncertainty
from sysid_rl.run.domain import TrainingDomains
from sysid_rl.run.faults import Injection, Scaled
from sysid_rl.run.modes.hold import Hold
from sysid_rl.run.state_estimator import StateEstimate
from sysid_rl.run.transport import RELEASED_INPUTS

AXES = PLANT.machine.axis_names


def at(joints: np.ndarray) -> StateEstimate:
    return StateEstimate(
        0, 0.0, 0, RELEASED_INPUTS, [], joints.copy(), np.ones(4, dtype=np.bool_), joints.copy(), joints.copy()
    )


def test_beyond_the_data_and_back() -> None:
    rng = np.random.default_rng(0)
    poses = MIDDLE + rng.uniform(-0.2, 0.2, (800, 4)) * [1.0, 1.0, 1.0, 0.2]
    model = replace(
        learned(PLANT), uncertainty=NetworkUncertainty.of(poses, 1e-3 * rng.standard_normal((800, 3)), np.zeros((800, 3)))
    )
    domains = TrainingDomains(model, {}, AXES)
    way = np.array([0.0, 0.1, 0.4, 0.6, 0.5, 0.3, 0.1])
    said = [bool(domains(at(MIDDLE + np.array([step, 0.0, 0.0, 0.0])))) for step in way]
    assert said == [False, False, True, True, False, False, False]


def test_a_network_that_does_not_know_its_data_is_refused() -> None:
    constant = Normalisation(np.zeros(3), np.ones(3))
    network = Mlp((np.zeros((4, 3)),), (np.zeros(3),), Normalisation(MIDDLE, np.ones(4)), constant)
    with pytest.raises(SettingsError) as caught:
        TrainingDomains(replace(learned(PLANT), members=(network,)), {}, AXES)
    assert (caught.value.where, caught.value.found) == ("checks.domain", "the forward version has no training domain")


def test_kinematics_without_networks_have_no_training_data_to_leave() -> None:
    domains = TrainingDomains(learned(PLANT), {}, AXES)
    assert domains(at(MIDDLE + 10.0)) == ""


def test_a_joint_sensor_that_contradicts_its_cylinder_stops_and_latches() -> None:
    made = case(lambda limits, chain: Hold(DT, 3.0), plan=[Injection(Scaled("boom.joint", 1.3), 0.6)], noise=False)
    made.loop.run()
    assert "contradiction" in made.verdicts()
    assert made.states()[-1] == "fault"
