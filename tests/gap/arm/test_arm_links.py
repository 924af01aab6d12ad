"""Links of a simulated arm: what is hidden in them is named beside small errors of everything else, and nothing else is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from planar_arm import C2, I2, M1, M2, planar

from sysid.datasets import Dataset, Recording
from sysid.errors import ExcitationError
from sysid.gap import find_gap, steps
from sysid.gap.arm.forces import without
from sysid.gap.arm.link_rows import axis_rows, doubled, plausible
from sysid.gap.arm.link_stage import fit_links_stage
from sysid.gap.arm.posture import posture_share
from sysid.gap.candidates import Candidate
from sysid.gap.data import Data, SearchInput
from sysid.gap.prepare.case import stage_candidates
from sysid.gap.stages import search_stages
from sysid.machine import machine_from_files
from sysid.plant import compile_plant, nominal_plant
from sysid.progress import silent
from sysid.testing.probe import probe_arm

pytest.importorskip("pinocchio")

Array = npt.NDArray[np.float64]
RATE = 200.0
#: Viscous coefficients [N·m·s/rad], Coulomb torques and torque noise [N·m], noise of the encoders [rad].
VISCOUS, COULOMB, NOISE, JOINT_NOISE = np.array([1.5, 0.6]), np.array([2.0, 1.0]), np.array([0.1, 0.05]), 2e-5


def recording(
    name: str, seed: int, m1: float, m2: float, c2: Array, i2: float, constants: Array, friction: float, reach: float = 1.0
) -> Recording:
    """Fifteen seconds of both joints; torque of the links and of friction, times a constant of each joint.

    ``reach``: share of their usual motion.
    """
    draw = np.random.default_rng(seed)
    t = np.arange(round(15.0 * RATE)) / RATE
    q, v, a = (np.zeros((len(t), 2)) for _ in range(3))
    for k in range(2):
        for rate in draw.uniform(0.8, 5.0, 5):
            size, phase = draw.uniform(0.1, 0.35), draw.uniform(0.0, 6.28)
            q[:, k] += size * np.sin(rate * t + phase)
            v[:, k] += size * rate * np.cos(rate * t + phase)
            a[:, k] -= size * rate**2 * np.sin(rate * t + phase)
    q, v, a = reach * q, reach * v, reach * a
    torque = planar(q, v, a, m1, m2, c2, i2) + friction * (VISCOUS * v + COULOMB * np.sign(v))
    torque = constants * torque + NOISE * draw.standard_normal(torque.shape)
    q = q + JOINT_NOISE * draw.standard_normal(q.shape)
    columns = {"time": t}
    for k, axis in enumerate(("lift", "elbow")):
        columns |= {f"{axis}.command": torque[:, k], f"{axis}.joint": q[:, k]}
    return Recording(name, pd.DataFrame(columns), RATE)


def dataset(
    m1: float = M1,
    m2: float = M2,
    c2: Array = C2,
    i2: float = I2,
    constants: tuple[float, float] = (1.0, 1.0),
    seed: int = 0,
    friction: float = 1.0,
    reach: float = 1.0,
) -> Dataset:
    arm = probe_arm()
    text = (
        arm.text.replace("rate_hz = 100.0", f"rate_hz = {RATE}")
        + f'\n[noise]\n"lift.joint" = {JOINT_NOISE}\n"elbow.joint" = {JOINT_NOISE}\n'
    )
    machine = machine_from_files({**arm.files(), "machine.toml": text}, "arm")
    roles = {"one": "fit", "two": "fit", "three": "select", "four": "held_out"}
    runs = tuple(
        recording(name, 10 * seed + k, m1, m2, c2, i2, np.array(constants), friction, reach) for k, name in enumerate(roles)
    )
    return Dataset.of(machine, runs, roles)  # type: ignore[arg-type]


def with_payload(mass: float, at: Array) -> dict[str, object]:
    """Second link with a point mass ``at`` (2,) in its plane [m]."""
    whole = M2 + mass
    centre = (M2 * C2 + mass * at) / whole
    inertia = I2 + M2 * float(np.sum((C2 - centre) ** 2)) + mass * float(np.sum((at - centre) ** 2))
    return {"m2": whole, "c2": centre, "i2": inertia}


def links(data: Dataset) -> tuple[list[str], list[str], dict[str, Array]]:
    """Names, ties and values of the links stage alone."""
    study = steps.open_study(data, nominal_plant(data.machine))
    own = [stage for stage in study.stages if stage.problem.stage == "links"]
    (found,) = search_stages(study.case, own, "all", silent)
    fitted = found.found.stage_fit
    if fitted is None:  # explained without any effect
        return [], [], {}
    decision = fitted.decision
    values = {c.effect.name: decision.model.values_of(c) for c in decision.model.candidates}
    ties = [c.effect.name for tie in decision.tied for c in tie]
    return [c.effect.name for c in decision.named], ties, values


def test_an_arm_has_one_stage_of_its_links_before_those_of_its_axes() -> None:
    study = steps.open_study(dataset(friction=0.0), nominal_plant(dataset().machine))
    assert {(s.problem.stage, s.problem.target) for s in study.stages} == {
        ("links", "arm"),
        ("force", "lift"),
        ("force", "elbow"),
    }


@pytest.mark.parametrize("seed", range(3))
def test_small_errors_of_masses_are_adjusted_and_not_named(seed: int) -> None:
    draw = np.random.default_rng(seed)
    one, two = draw.uniform(0.95, 1.05, 2)
    named, ties, _ = links(dataset(m1=M1 * one, m2=M2 * two, i2=I2 * two, seed=seed))
    assert (named, ties) == ([], [])


def test_a_wrong_constant_of_a_drive_is_not_a_mass() -> None:
    named, ties, _ = links(dataset(constants=(0.9, 1.0)))
    assert (named, ties) == ([], [])


@pytest.mark.parametrize("seed", range(2))
def test_a_payload_is_named_with_its_mass(seed: int) -> None:
    named, ties, values = links(dataset(**with_payload(1.5, np.array([0.34, 0.0])), seed=seed))  # type: ignore[arg-type]
    assert "payload" in {*named, *ties}
    assert not {*named, *ties} - {"payload", "link_mass_error"}
    assert values["payload"][0] == pytest.approx(1.5, rel=0.15)


def left_by_links(data: Dataset) -> dict[str, float]:
    """Standard deviation of the torque [N·m] that the adjusted links leave beside any friction, by joint."""
    study = steps.open_study(data, nominal_plant(data.machine))
    (stage,) = (stage for stage in study.stages if stage.problem.stage == "links")
    (found,) = search_stages(study.case, [stage], "all", silent)
    fitted = found.found.stage_fit
    assert fitted is not None
    rows = axis_rows(compile_plant(study.case.plant), stage.problem, stage.split.seen, fitted.decision.model.theta)
    return {own.axis: float(np.std(without(own.target, own.friction))) for own in rows}


def test_a_payload_is_in_proportion_to_wrong_constants_of_the_drives() -> None:
    """Torques are constants times links with payload; the sum of both changes alone leaves a share of this product."""
    heavy, constants = with_payload(1.5, np.array([0.34, 0.0])), {"lift": 0.9, "elbow": 1.1}
    exact = left_by_links(dataset(**heavy))  # type: ignore[arg-type]
    found = left_by_links(dataset(**{**heavy, "constants": tuple(constants.values())}))  # type: ignore[arg-type]
    assert found == {axis: pytest.approx(constant * exact[axis], rel=0.15) for axis, constant in constants.items()}


def study_of(data: Dataset) -> steps.Study:
    return steps.open_study(data, nominal_plant(data.machine))


@pytest.mark.parametrize(("reach", "open_"), [(1.0, False), (0.1, True)])
def test_a_constant_load_is_open_where_a_link_turns_by_few_degrees(reach: float, open_: bool) -> None:
    """Its first moment causes the same torque there. Five per cent of that of the second link weigh 0.15 N·m, of both 0.9."""
    study = study_of(dataset(m1=1.15 * M1, m2=0.9 * M2, constants=(1.1, 0.9), reach=reach))
    stage = next(stage for stage in study.stages if stage.problem.stage == "links")
    model = compile_plant(study.case.plant)
    some = stage_candidates(study.case, stage)
    names = [c.label for c in some]
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    fit = fit_links_stage(SearchInput(model, seen, stage.theta, some, names, lambda text: None))
    assert set(fit.open_loads) == {"lift", "elbow"}
    typical = {"lift": 0.9, "elbow": 0.15}
    for axis, load in fit.open_loads.items():
        assert (load > 0.3 * typical[axis]) if open_ else (0.0 < load < 0.05 * typical[axis])


def test_a_much_heavier_upper_arm_is_no_payload() -> None:
    named, ties, values = links(dataset(m1=1.8 * M1))
    assert "payload" not in {*named, *ties}
    assert named == ["link_mass_error"]
    assert values["link_mass_error"][0] == pytest.approx(1.8, rel=0.15)


@pytest.mark.slow
def test_friction_of_both_joints_is_named_beside_wrong_masses_and_a_payload() -> None:
    data = dataset(**{**with_payload(1.5, np.array([0.34, 0.0])), "m1": 1.04 * M1})  # type: ignore[arg-type]
    gap = find_gap(data, nominal_plant(data.machine))
    found = {(e.name, e.target): e.parameters for e in gap.effects}
    assert set(found) - {("payload", "tool")} == {
        (name, axis) for name in ("coulomb_friction", "viscous_friction") for axis in ("lift", "elbow")
    }
    for k, axis in enumerate(("lift", "elbow")):
        assert found["coulomb_friction", axis]["force"] == pytest.approx(COULOMB[k], rel=0.05)
        assert found["viscous_friction", axis]["coefficient"] == pytest.approx(VISCOUS[k], rel=0.05)


def test_an_arm_with_a_joint_that_is_not_measured_has_no_force_stage() -> None:
    data = dataset()
    blind = tuple(replace(r, table=r.table.assign(**{"elbow.joint": np.nan})) for r in data.recordings)
    with pytest.raises(ExcitationError, match="elbow: force and motion are not measured together"):
        steps.open_study(replace(data, recordings=blind), nominal_plant(data.machine))


def without_masses(data: Dataset) -> Dataset:
    """The same recordings of a machine without a URDF, its inertias about right."""
    axes = "".join(
        f'[[axes]]\nname = "{name}"\nactuation = "force"\ndrives = "joint"\ninertia = {inertia}\n'
        for name, inertia in (("lift", 0.8), ("elbow", 0.07))
    )
    noise = f'[noise]\n"lift.joint" = {JOINT_NOISE}\n"elbow.joint" = {JOINT_NOISE}\n'
    machine = machine_from_files({"machine.toml": f'schema = 1\nname = "m"\nrate_hz = {RATE}\n{axes}{noise}'}, "m")
    return Dataset.of(machine, data.recordings, data.splits)


def test_without_masses_gravity_depends_on_the_posture_and_friction_does_not() -> None:
    data = without_masses(dataset())
    shares = {}
    for recordings in (data, without_masses(replace(data, recordings=tuple(weightless(r) for r in data.recordings)))):
        study = steps.open_study(recordings, nominal_plant(data.machine))
        for stage in study.stages:
            share = posture_share(stage.problem, data.machine, stage.split.seen, float(stage.sigma[0]), {})
            assert share is not None
            shares.setdefault(stage.problem.target, []).append(share.dominates)
    assert shares == {"lift": [True, False], "elbow": [True, False]}


def weightless(recording: Recording) -> Recording:
    """Torque of an inertia and of friction at each joint instead of that of the links."""
    draw, table = np.random.default_rng(7), recording.table.copy()
    for k, (name, inertia) in enumerate((("lift", 0.8), ("elbow", 0.07))):
        v = np.gradient(table[f"{name}.joint"].to_numpy(), 1.0 / RATE)
        torque = inertia * np.gradient(v, 1.0 / RATE) + VISCOUS[k] * v + COULOMB[k] * np.tanh(v / 0.1)
        table[f"{name}.command"] = torque + NOISE[k] * draw.standard_normal(len(table))
    return replace(recording, table=table)


@pytest.mark.slow
def test_without_masses_nothing_is_named_and_they_are_requested() -> None:
    data = without_masses(dataset())
    gap = find_gap(data, nominal_plant(data.machine))
    assert gap.effects == ()
    assert {u.target for u in gap.unnamed if "give the masses" in u.form} == {"lift", "elbow"}


@pytest.fixture(scope="module")
def candidates() -> dict[tuple[str, str], Candidate]:
    data = dataset()
    study = steps.open_study(data, nominal_plant(data.machine))
    return {c.key[:2]: c for c in stage_candidates(study.case, study.stages[0])}


def test_a_payload_has_a_mass_and_a_centre_in_reach(candidates: dict[tuple[str, str], Candidate]) -> None:
    carried, deviations = candidates["payload", "tool"], np.full(4, 0.1)
    assert plausible(carried, np.array([1.0, 0.1, 0.0, 0.0]), deviations)
    assert not plausible(carried, np.array([0.15, 0.0, 0.0, 0.0]), deviations), "it may have no mass"
    assert not plausible(carried, np.array([1.0, 3.0, 0.0, 0.0]), deviations), "three metres from the tip"


def test_a_payload_contains_the_mass_of_the_link_that_carries_it(candidates: dict[tuple[str, str], Candidate]) -> None:
    model = compile_plant(nominal_plant(dataset().machine))
    carried = candidates["payload", "tool"]
    assert doubled(model, [carried, candidates["link_mass_error", "elbow"]])
    assert not doubled(model, [carried, candidates["link_mass_error", "lift"]])
    assert not doubled(model, [candidates["link_mass_error", "elbow"]])
