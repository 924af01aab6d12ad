"""Errors inside the controllers of servos: named from commands and positions alone, with values inside their intervals."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import numpy.typing as npt
import pytest
from servo_arms import arm_text, commands, drafted, recording_of

from sysid.datasets.recording import Dataset
from sysid.gap import find_gap
from sysid.gap.arm import servos as servo_arm
from sysid.gap.candidates import Scales, candidates_at, without_servo_aliases
from sysid.gap.prepare.case import stage_candidates
from sysid.gap.steps import open_study
from sysid.machine import Machine
from sysid.plant import nominal_plant

Array = npt.NDArray[np.float64]

DT, NOISE = 0.01, 3e-4
ROLES = ("fit", "fit", "select", "held_out")


def nothing(model: Any) -> None:
    """The machine is as its description."""


def stiffness(model: Any) -> None:
    model.actuator_gainprm[1, 0] *= 0.8
    model.actuator_biasprm[1, 1] *= 0.8


def damping(model: Any) -> None:
    model.actuator_biasprm[2, 2] *= 1.5


def limited(model: Any) -> None:
    model.actuator_forcerange[1] = [-3.0, 3.0]


def armature(model: Any) -> None:
    model.dof_armature[2] *= 2.5
    mujoco.mj_setConst(model, mujoco.MjData(model))


def friction(model: Any) -> None:
    model.dof_frictionloss[1] = 0.3


def heavier(model: Any, body: str, ratio: float) -> None:
    model.body_mass[model.body(body).id] *= ratio
    model.body_inertia[model.body(body).id] *= ratio
    mujoco.mj_setConst(model, mujoco.MjData(model))


def three(model: Any) -> None:
    model.dof_frictionloss[1] = 0.4
    heavier(model, "b2", 1.3)


def mass(model: Any) -> None:
    heavier(model, "b1", 1.3)


def mass_and_stiffness(model: Any) -> None:
    heavier(model, "b2", 0.8)
    model.actuator_gainprm[1, 0] *= 0.85
    model.actuator_biasprm[1, 1] *= 0.85


@dataclass(frozen=True)
class Hidden:
    """What a machine has beyond its description: a change of the model, steps of dead time by joint, and what to find."""

    change: Callable[[Any], None]
    found: Mapping[tuple[str, str], float] = field(default_factory=dict)
    late: Mapping[int, int] = field(default_factory=dict)


CASES = {
    "nothing": Hidden(nothing),
    "stiffness": Hidden(stiffness, {("stiffness_error", "j1"): 0.8}),
    "damping": Hidden(damping, {("damping_error", "j2"): 1.5}),
    "limit": Hidden(limited, {("force_limit", "j1"): 3.0}),
    "armature": Hidden(armature, {("armature_error", "j2"): 2.5}),
    "friction": Hidden(friction, {("coulomb_friction", "j1"): 0.3}),
    "mass": Hidden(mass, {("link_mass_error", "j1"): 1.3}),
    "mass-and-stiffness": Hidden(mass_and_stiffness, {("link_mass_error", "j2"): 0.8, ("stiffness_error", "j1"): 0.85}),
    "three": Hidden(
        three,
        {("coulomb_friction", "j1"): 0.4, ("link_mass_error", "j2"): 1.3, ("input_delay", "j0"): 0.02},
        {0: 20},
    ),
}


def logged(text: str, hidden: Hidden, wanted: Array, seed: int) -> Array:
    model = mujoco.MjModel.from_xml_string(text)
    hidden.change(model)
    data, steps = mujoco.MjData(model), round(DT / model.opt.timestep)
    data.ctrl[:] = wanted[0]
    for _ in range(4000):
        mujoco.mj_step(model, data)
    found, each = np.empty(wanted.shape), np.repeat(wanted, steps, axis=0)
    for k in range(len(wanted)):
        found[k] = data.qpos
        for i in range(k * steps, (k + 1) * steps):
            data.ctrl[:] = each[i]
            for joint, late in hidden.late.items():
                data.ctrl[joint] = each[max(0, i - late), joint]
            mujoco.mj_step(model, data)
    return found + np.random.default_rng(seed).normal(0.0, NOISE, found.shape)


@functools.cache
def dataset_of(case: str) -> tuple[Machine, Dataset]:
    hidden, text = CASES[case], arm_text(3, 4, limited=0.3)
    with tempfile.TemporaryDirectory() as folder:
        machine = replace(drafted(Path(folder), text), rate_hz=1.0 / DT)
    runs = []
    for k in range(len(ROLES)):
        wanted = commands(3, 1500, DT, seed=k)
        runs.append(replace(recording_of(wanted, logged(text, hidden, wanted, k), DT, machine), name=f"run-{k}"))
    return machine, Dataset.of(machine, runs, {run.name: role for run, role in zip(runs, ROLES, strict=True)})


@pytest.mark.parametrize("case", [name if name == "nothing" else pytest.param(name, marks=pytest.mark.slow) for name in CASES])
def test_what_an_arm_has_beyond_its_description(case: str) -> None:
    machine, dataset = dataset_of(case)
    result, wanted = find_gap(dataset, nominal_plant(machine)), CASES[case].found
    assert {(effect.name, effect.target) for effect in result.effects} == set(wanted)
    assert result.verdict == ("named" if wanted else "no_gap")
    for effect in result.effects:
        (value,), ((low, high),) = effect.parameters.values(), effect.interval95.values()
        true = wanted[effect.name, effect.target]
        assert float(np.asarray(value)) == pytest.approx(true, rel=5e-3, abs=1e-4)
        assert low - 0.002 * true <= true <= high + 0.002 * true
    for signal, after in result.gap.after.items():
        assert after < 1.2 * result.gap.noise_floor[signal]


@pytest.mark.parametrize("joint", ["j0", "j1"])
def test_the_first_link_is_an_armature_where_its_weight_does_not_load_its_joint(joint: str) -> None:
    """j0 is vertical; the axes before j1 carry its link."""
    _, dataset = dataset_of("nothing")
    study = open_study(dataset, nominal_plant(dataset.machine))
    stage = next(stage for stage in study.stages if stage.problem.target == joint)
    offered = {(c.effect.name, c.target): c.aliases for c in stage_candidates(study.case, stage)}
    masses = {target for name, target in offered if name == "link_mass_error"}
    assert masses == {"j1", "j2"}
    assert offered["armature_error", joint] == ((("link_mass_error", "j0"),) if joint == "j0" else ())


@pytest.mark.parametrize("limit", [0.0, 0.3])
def test_friction_is_damping_where_no_force_is_limited(limit: float, tmp_path: Path) -> None:
    machine = drafted(tmp_path, arm_text(2, 1, limited=limit))
    plant = nominal_plant(machine)
    found = candidates_at(plant, plant.vector(), ("command", "force"), ("j0",), Scales())
    assert {"stiffness_error", "force_limit", "armature_error", "coulomb_friction", "input_delay"} <= {
        c.effect.name for c in found
    }
    merged = without_servo_aliases(found, machine, spins=False)
    aliases = {(c.effect.name, c.aliases) for c in merged if c.aliases}
    single = [c for c in merged if c.effect.name == "viscous_friction" and len(c.unknowns) == 1]
    assert aliases == (set() if limit else {("damping_error", (("viscous_friction", "j0"),))})
    assert bool(single) is bool(limit)


def test_each_axis_moves_as_it_was_measured_before_it_is_searched() -> None:
    machine, dataset = dataset_of("three")
    study = open_study(dataset, nominal_plant(machine))
    case, stages = study.case, study.stages
    before = [servo_arm._error(stage) for stage in stages]
    fitted = servo_arm._fitted_motion(case, stages)
    whole = servo_arm._together(case, fitted.values())
    after = [
        servo_arm._error(replace(servo_arm._beside(case, stage, whole), theta=fitted[k])) for k, stage in enumerate(stages)
    ]
    assert max(before) > 20.0
    assert max(after) < 2.0
