"""Friction that grows with the torque of the links: named with its coefficient where it is present and excited, only there."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from planar_arm import C2, I2, M1, M2, planar

from sysid.datasets import Dataset, Recording
from sysid.gap import steps
from sysid.gap.arm.link_rows import axis_rows, linearised, with_carried
from sysid.gap.excitation import excitation_of
from sysid.gap.prepare.case import stage_candidates
from sysid.gap.stages import search_stages
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import compile_plant, nominal_plant
from sysid.plant.link_torque import inertial_parameters
from sysid.progress import silent
from sysid.testing.probe import probe_arm

pytest.importorskip("pinocchio", reason="the extra dynamics is not installed")

Array = npt.NDArray[np.float64]
#: Speed and torque of the links, (n,) each → friction of the lifting joint (n,) [N·m].
Friction = Callable[[Array, Array], Array]
RATE, NOISE, JOINT_NOISE = 200.0, 0.05, 1e-5
COULOMB, VISCOUS, COEFFICIENT = 2.0, 1.5, 0.12
NAME, OTHERS = "load_dependent_friction", {"coulomb_friction", "viscous_friction"}
#: Largest torque of the links on the lifting joint is about 20 N·m.
HALF = 10.0


def growing(v: Array, load: Array) -> Array:
    return VISCOUS * v + (COULOMB + COEFFICIENT * np.abs(load)) * np.sign(v)


def recording(name: str, seed: int, friction: Friction, reach: float) -> Recording:
    """Fifteen seconds in which both joints move about the horizontal; ``reach`` of the lifting joint [rad]."""
    draw = np.random.default_rng([seed, 28])
    t = np.arange(round(15.0 * RATE)) / RATE
    q, v, a = np.zeros((3, len(t), 2))
    for k, size in enumerate((reach, 0.3)):
        for rate in draw.uniform(0.5, 3.0, 4):
            part, phase = size * draw.uniform(0.5, 1.0) / 2.0, draw.uniform(0.0, 6.28)
            q[:, k] += part * np.sin(rate * t + phase)
            v[:, k] += part * rate * np.cos(rate * t + phase)
            a[:, k] -= part * rate**2 * np.sin(rate * t + phase)
    torque = planar(q, v, a, M1, M2, C2, I2)
    torque[:, 0] += friction(v[:, 0], torque[:, 0])
    torque += NOISE * draw.standard_normal(torque.shape)
    q += JOINT_NOISE * draw.standard_normal(q.shape)
    columns = {"lift.command": torque[:, 0], "lift.joint": q[:, 0], "elbow.command": torque[:, 1], "elbow.joint": q[:, 1]}
    return Recording(name, pd.DataFrame({"time": t, **columns}), RATE)


def dataset(friction: Friction, seed: int = 0, reach: float = 1.2) -> Dataset:
    arm = probe_arm()
    noise = f'\n[noise]\n"lift.joint" = {JOINT_NOISE}\n"elbow.joint" = {JOINT_NOISE}\n"lift.command" = {NOISE}\n'
    text = arm.text.replace("rate_hz = 100.0", f"rate_hz = {RATE}") + noise
    machine = machine_from_files({**arm.files(), "machine.toml": text}, "arm")
    roles = {"one": "fit", "two": "fit", "three": "select", "four": "held_out"}
    runs = tuple(recording(name, 10 * seed + k, friction, reach) for k, name in enumerate(roles))
    return Dataset.of(machine, runs, roles)  # type: ignore[arg-type]


def named(data: Dataset) -> dict[str, Array]:
    """Names and values of the lifting joint."""
    study = steps.open_study(data, nominal_plant(data.machine))
    own = [s for s in study.stages if (s.problem.stage, s.problem.target) == ("force", "lift")]
    (found,) = search_stages(study.case, own, "all", silent)
    fitted = found.found.stage_fit
    assert fitted is not None
    assert not any(c.effect.name == NAME for tie in fitted.decision.tied for c in tie)
    return {c.effect.name: fitted.decision.model.values_of(c) for c in fitted.decision.named}


SEEDS = [0, pytest.param(1, marks=pytest.mark.slow)]


@pytest.mark.parametrize("seed", SEEDS)
def test_the_coefficient_comes_back_beside_plain_friction(seed: int) -> None:
    found = named(dataset(growing, seed))
    assert set(found) == {NAME, *OTHERS}
    assert found[NAME] == pytest.approx([COEFFICIENT], rel=0.05)
    assert np.mean(found["coulomb_friction"]) == pytest.approx(COULOMB, rel=0.05)


PLAIN: dict[str, Friction] = {
    "sharp": lambda v, load: VISCOUS * v + COULOMB * np.sign(v),
    "smooth": lambda v, load: VISCOUS * v + COULOMB * np.tanh(v / 0.1),
    "falling": lambda v, load: VISCOUS * v + COULOMB * (1.0 + 0.5 * np.exp(-((v / 0.1) ** 2))) * np.sign(v),
    "by direction": lambda v, load: np.where(v > 0.0, COULOMB, -1.5 * COULOMB) + VISCOUS * v,
}


@pytest.mark.parametrize("kind", [pytest.param(kind, marks=() if kind == "sharp" else pytest.mark.slow) for kind in PLAIN])
@pytest.mark.parametrize("seed", SEEDS)
def test_plain_friction_under_a_load_that_varies_does_not_grow_with_it(kind: str, seed: int) -> None:
    assert NAME not in named(dataset(PLAIN[kind], seed))


@pytest.mark.slow
@pytest.mark.parametrize(
    "friction",
    [
        lambda v, load: VISCOUS * v + (COULOMB + COEFFICIENT * np.maximum(np.abs(load) - HALF, 0.0)) * np.sign(v),
        lambda v, load: VISCOUS * v + (COULOMB + COEFFICIENT * np.minimum(np.abs(load), HALF)) * np.sign(v),
        lambda v, load: (VISCOUS + 0.2 * np.abs(load)) * v + COULOMB * np.sign(v),
    ],
    ids=["from a threshold", "saturated", "with speed"],
)
def test_another_curve_over_the_load_gets_no_other_name(friction: Friction) -> None:
    assert set(named(dataset(friction))) <= {NAME, *OTHERS}


def test_a_load_that_does_not_vary_cannot_tell() -> None:
    """About the horizontal the weight changes by a few percent: the effect is a candidate that is not excited enough."""
    data = dataset(growing, reach=0.15)
    study = steps.open_study(data, nominal_plant(data.machine))
    stage = next(s for s in study.stages if (s.problem.stage, s.problem.target) == ("force", "lift"))
    candidate = next(c for c in stage_candidates(study.case, stage) if c.effect.name == NAME)
    found = excitation_of(candidate, stage.split.seen, data.machine)
    assert not found.sufficient
    assert found.unit == "% change of the magnitude of the gravity load"


def test_a_payload_loads_the_friction_of_a_joint() -> None:
    """The rows of the links contain friction under the torques of a payload as if the plant had it."""
    data, payload = dataset(growing), KnownEffect("payload", "tool", {"mass": 2.0, "centre": [0.0, 0.0, 0.0]})
    study = steps.open_study(data, nominal_plant(data.machine))
    stage = next(s for s in study.stages if s.problem.stage == "links")
    model, seen = compile_plant(study.case.plant), stage.split.seen
    loaded = study.case.plant.with_effect(payload).vector()
    rows = axis_rows(model, stage.problem, seen, stage.theta)
    found = with_carried(rows, model, stage.problem, seen, loaded)
    for own, other, before in zip(found, axis_rows(model, stage.problem, seen, loaded), rows, strict=True):
        assert own.friction == pytest.approx(other.friction, rel=1e-9, abs=1e-9)
        assert own.target == pytest.approx(before.target)
        assert np.abs(own.friction - before.friction).max() > 1.0, "the payload matters"


def test_rows_about_another_plant_are_exact_there() -> None:
    """What that plant leaves is what the linearised rows leave at its payload, its links and its force constants."""
    data = dataset(growing)
    study = steps.open_study(data, nominal_plant(data.machine))
    stage = next(s for s in study.stages if s.problem.stage == "links")
    model, seen = compile_plant(study.case.plant), stage.split.seen
    plant = study.case.plant.with_effect(KnownEffect("payload", "tool", {"mass": 2.0, "centre": [0.1, 0.0, 0.0]}))
    for axis, scale in (("lift", 1.3), ("elbow", 0.8)):
        values = {"mass": 0.3, "first_moment": [0.0, 0.1, 0.0], "inertia": [0.0] * 6, "rotor": 0.0, "scale": scale}
        plant = plant.with_effect(KnownEffect("inertial_error", axis, values))
    about = plant.vector()
    rows = linearised(axis_rows(model, stage.problem, seen, stage.theta), model, stage.theta, about)
    change = (inertial_parameters(model, about) - inertial_parameters(model, stage.theta)).reshape(-1)
    for own, exact, error in zip(rows, axis_rows(model, stage.problem, seen, about), (0.3, -0.2), strict=True):
        left = own.target - own.links @ change - error * own.carried
        assert left == pytest.approx(exact.target, rel=1e-9, abs=1e-9)
        assert own.carried * (1.0 + error) == pytest.approx(exact.carried, rel=1e-9, abs=1e-9)


def test_a_machine_without_masses_has_no_such_candidate() -> None:
    arm = probe_arm()
    bare = arm.files()["probe_arm.urdf"]
    while "<inertial>" in bare:
        bare = bare[: bare.index("<inertial>")] + bare[bare.index("</inertial>") + len("</inertial>") :]
    text = dataset(growing).machine.text.replace('drives = "joint"\n', 'drives = "joint"\ninertia = 1.0\n')
    machine = machine_from_files({"machine.toml": text, "probe_arm.urdf": bare}, "arm")
    given = dataset(growing)
    data = Dataset.of(machine, given.recordings, given.splits)
    study = steps.open_study(data, nominal_plant(machine))
    assert not [c for s in study.stages for c in stage_candidates(study.case, s) if c.effect.of_links]
