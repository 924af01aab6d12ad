"""Servo axes against MuJoCo, Pinocchio and closed forms."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from servo_arms import STIFF, alone, arm_text, commands, drafted, logged, recording_of, shares

from sysid.datasets.recording import Recording
from sysid.effects import CATALOGUE, Effect
from sysid.machine import KnownEffect, Machine, machine_from_files
from sysid.machine.moved_bodies import PARAMETERS
from sysid.machine.rigid_body import RigidBody
from sysid.plant import compile_plant, free_run, nominal_plant
from sysid.plant.arm_dynamics import BODY, dynamics, link_series
from sysid.plant.servo_law import weight
from sysid.plant.stepper import Stepper
from sysid.testing.check import typical_values
from sysid.testing.probe import probe_recording, probe_servo

Array = npt.NDArray[np.float64]

#: Largest RMS difference from MuJoCo as a share of the motion's range; with Coriolis forces that are implicit there, and with
#: backlash.
PARITY, CORIOLIS, FLANK = 1e-6, 3e-4, 2e-3


def compare(
    folder: Path, text: str, joints: int, dt: float = 0.01, seconds: float = 30.0, true: str = "", *effects: KnownEffect
) -> tuple[Array, Array]:
    """Shares of the difference from MuJoCo, of the coupled free run and of each axis by itself.

    ``true``: the model that moves, where it is not the described one, which lacks the ``effects``.
    """
    machine = drafted(folder, text)
    wanted = commands(joints, round(seconds / dt), dt)
    measured, plant = logged(true or text, wanted, dt), nominal_plant(machine)
    for effect in effects:
        plant = plant.with_effect(effect)
    recording, model = recording_of(wanted, measured, dt, machine), compile_plant(plant)
    run = free_run(model, recording)
    whole = run[[f"{name}.joint" for name in machine.axis_names]].to_numpy()
    return shares(whole, measured), shares(alone(model, recording), measured)


@pytest.mark.parametrize("joints", [2, 3, 4, 5, 6, 7])
def test_arms_of_mujoco(tmp_path: Path, joints: int) -> None:
    whole, single = compare(tmp_path, arm_text(joints, joints), joints)
    assert whole.max() < PARITY
    assert single.max() < PARITY


@pytest.mark.parametrize("joints", [2, 4, 7])
def test_force_limits_that_saturate(tmp_path: Path, joints: int) -> None:
    text = arm_text(joints, joints, limited=0.15)
    free, _ = compare(tmp_path, arm_text(joints, joints), joints, seconds=10.0)
    whole, _ = compare(tmp_path, text, joints)
    limits = [axis.servo.force_limit for axis in drafted(tmp_path, text).axes if axis.servo is not None]
    assert None not in limits
    assert whole.max() < PARITY
    assert free.max() < PARITY


@pytest.mark.parametrize("joints", [2, 5])
def test_dry_friction_that_holds(tmp_path: Path, joints: int) -> None:
    text = arm_text(joints, 3, rubs=STIFF)
    assert {e.name for e in drafted(tmp_path, text).effects} == {"viscous_friction", "coulomb_friction"}
    whole, single = compare(tmp_path, text, joints)
    assert whole.max() < PARITY
    assert single.max() < PARITY


@pytest.mark.parametrize("joints", [2, 5])
def test_friction_that_gives_way_as_that_of_mujoco_does_by_default(tmp_path: Path, joints: int) -> None:
    text = arm_text(joints, 3, rubs=" ")
    assert {e.name for e in drafted(tmp_path, text).effects} == {"viscous_friction", "coulomb_friction"}
    whole, single = compare(tmp_path, text, joints)
    assert whole.max() < PARITY
    assert single.max() < PARITY


@pytest.mark.parametrize("integrator", ["implicitfast", "implicit", "Euler"])
def test_long_steps_of_mujoco(tmp_path: Path, integrator: str) -> None:
    whole, _ = compare(tmp_path, arm_text(3, 1, step=0.002, integrator=integrator, limited=0.3), 3, 0.02)
    assert whole.max() < (CORIOLIS if integrator == "implicit" else PARITY)


def test_dead_time_of_the_control(tmp_path: Path) -> None:
    """MuJoCo holds a control until the first step after its delay; one that ends with a step ends with either, by rounding."""
    text = arm_text(3, 2, delay=0.0246)
    machine = drafted(tmp_path, text)
    delays = [e.parameters["delay"] for e in machine.effects if e.name == "input_delay"]
    assert delays == pytest.approx([0.025] * 3)
    whole, _ = compare(tmp_path, text, 3)
    assert whole.max() < PARITY


@pytest.mark.parametrize("rubs", ["", " "])
@pytest.mark.parametrize("joints", [2, 4])
def test_backlash_between_motor_and_joint(tmp_path: Path, joints: int, rubs: str) -> None:
    """MuJoCo's joint limits are springs with damping, which a flank is not: a tenth of the width is left."""
    width = 0.02
    described, true = (arm_text(joints, 5, rubs=rubs, backlash=value) for value in (0.0, width))
    effects = [KnownEffect("backlash", f"j{k}", {"width": width}, "drive") for k in range(joints)]
    whole, single = compare(tmp_path, described, joints, 0.01, 30.0, true, *effects)
    assert whole.max() < FLANK
    assert single.max() < FLANK
    assert compare(tmp_path, described, joints, 0.01, 30.0, true)[0].min() > 3.0 * FLANK


@pytest.mark.parametrize("kind", ["filterexact", "filter"])
def test_filter_of_the_control(tmp_path: Path, kind: str) -> None:
    text = arm_text(3, 2, lag=0.03, limited=0.3)
    if kind == "filter":
        text = text.replace("<position", "<general").replace('timeconst="0.03"', 'dyntype="filter" dynprm="0.03"')
        text = re.sub(r'kp="([^"]*)" kv="([^"]*)"', r'gainprm="\1" biastype="affine" biasprm="0 -\1 -\2"', text)
    machine = drafted(tmp_path, text)
    assert sum(e.name == "first_order_lag" for e in machine.effects) == 3
    whole, single = compare(tmp_path, text, 3)
    assert whole.max() < PARITY
    assert single.max() < PARITY


ODD = """<robot name="odd"><link name="base"/>
  <link name="one"><inertial><origin xyz="0.1 0.02 0.3" rpy="0.3 0.1 -0.4"/><mass value="2"/>
    <inertia ixx="0.03" iyy="0.02" izz="0.015" ixy="0.001" ixz="-0.002" iyz="0.003"/></inertial></link>
  <link name="two"><inertial><origin xyz="0 0.2 0.05"/><mass value="1.2"/>
    <inertia ixx="0.02" iyy="0.01" izz="0.018" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="three"><inertial><origin xyz="0.05 0 0.1"/><mass value="0.7"/>
    <inertia ixx="0.004" iyy="0.003" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <link name="side"><inertial><origin xyz="0 0.1 0"/><mass value="0.4"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="a" type="revolute"><parent link="base"/><child link="one"/><origin xyz="0 0 0.2" rpy="0.2 0.1 0.3"/>
    <axis xyz="0.2 1 0.3"/><limit lower="-2" upper="2"/></joint>
  <joint name="b" type="prismatic"><parent link="one"/><child link="two"/><origin xyz="0.1 0.3 0" rpy="0 0.4 0"/>
    <axis xyz="1 0.5 0"/><limit lower="-1" upper="1"/></joint>
  <joint name="c" type="revolute"><parent link="two"/><child link="three"/><origin xyz="0 0.1 0.2"/>
    <axis xyz="0 0.3 1"/><limit lower="-2" upper="2"/><mimic joint="a" multiplier="-0.7" offset="0.2"/></joint>
  <joint name="beside" type="fixed"><parent link="two"/><child link="side"/><origin xyz="0.2 0 0" rpy="1 0 0"/></joint>
  <joint name="end" type="revolute"><parent link="three"/><child link="tip"/><axis xyz="1 0 0"/>
    <limit lower="-2" upper="2"/></joint><link name="tip"/>
</robot>"""


def odd_machine() -> Machine:
    axes = "".join(
        f'[[axes]]\nname = "{n}"\njoint = "{n}"\nactuation = "servo"\ndrives = "joint"\n'
        "inertia = 0.01\nservo = { kp = 20.0, kv = 1.0 }\n"
        for n in ("a", "b", "end")
    )
    text = f'schema = 1\nname = "odd"\nrate_hz = 100.0\nurdf = "odd.urdf"\ntip = "tip"\n{axes}'
    return machine_from_files({"machine.toml": text, "odd.urdf": ODD}, "odd")


@given(st.lists(st.floats(-1.5, 1.5), min_size=9, max_size=9))
def test_mass_matrix_and_bias_are_those_of_pinocchio(values: list[float]) -> None:
    """Of sliding, passive and fixed joints."""
    pytest.importorskip("pinocchio")
    machine = odd_machine()
    kinematics, arrays = machine.kinematics(), compile_plant(nominal_plant(machine)).arrays
    assert kinematics is not None
    body = RigidBody(kinematics, ODD)
    q, v, a = np.array(values).reshape(3, 3)
    mass, bias = np.empty((3, 3)), np.empty(3)
    dynamics(q, v, arrays.links, arrays.bodies, np.empty((len(arrays.bodies), BODY)), mass, bias)
    wanted = body.torque(q[None], v[None], a[None], body.nominal)[0]
    np.testing.assert_allclose(mass @ a + bias, wanted, atol=1e-9)
    np.testing.assert_allclose(mass, mass.T, atol=1e-12)
    assert arrays.bodies.shape[1] == PARAMETERS


@given(st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3))
def test_the_change_of_the_weight_by_the_own_position(values: list[float]) -> None:
    """Of sliding joints, and of an axis that moves two joints of the chain."""
    arrays = compile_plant(nominal_plant(odd_machine())).arrays
    step, q = 1e-5, np.array(values)
    places = np.vstack([q, *(q + sign * step * row for row in np.eye(3) for sign in (1.0, -1.0))])
    still = np.zeros_like(places)
    own, bias, coupled, slope = np.zeros((4, 3, len(places)))
    link_series(arrays.links, arrays.bodies, places, still, still, 1.0, own, bias, coupled, slope)
    wanted = [(bias[i, 1 + 2 * i] - bias[i, 2 + 2 * i]) / (2.0 * step) for i in range(3)]
    np.testing.assert_allclose(slope[:, 0], wanted, atol=1e-6)
    assert np.abs(slope[0, 0]) > 0.0


def heavier(urdf: str, *links: str) -> str:
    """The model with links of 1.4 times their masses."""
    for link in links:
        head, name, rest = urdf.partition(f'<link name="{link}">')
        inertial, end, rest = rest.partition("</inertial>")
        scaled = re.sub(r'(value|i[xyz]{2})="([^"]*)"', lambda m: f'{m[1]}="{1.4 * float(m[2])}"', inertial)
        urdf = head + name + scaled + end + rest
    return urdf


@pytest.mark.parametrize(("axis", "links"), [("a", ("one",)), ("b", ("two", "side"))])
def test_a_heavier_link_is_one_of_another_model(axis: str, links: tuple[str, ...]) -> None:
    """With what is fixed to it, without what a passive joint moves on it; of the arm and of each axis by itself."""
    machine = odd_machine()
    changed = replace(machine, urdf_text=heavier(ODD, *links))
    wanted = commands(3, 600, 0.01)
    recording = recording_of(wanted, 0.7 * wanted, 0.01, machine)
    effect = nominal_plant(machine).with_effect(KnownEffect("link_mass_error", axis, {"ratio": 1.4}))
    found, expected = (compile_plant(plant) for plant in (effect, nominal_plant(changed)))
    np.testing.assert_allclose(free_run(found, recording), free_run(expected, recording), atol=1e-9)
    np.testing.assert_allclose(alone(found, recording), alone(expected, recording), atol=1e-9)
    assert np.abs(alone(found, recording) - alone(compile_plant(nominal_plant(machine)), recording)).max() > 1e-3


@given(st.floats(1e-6, 50.0))
def test_the_weight_makes_decay_exact(z: float) -> None:
    """(1 − (1 − θ)·z)/(1 + θ·z) = exp(−z)."""
    theta = weight(z)
    assert (1.0 - (1.0 - theta) * z) / (1.0 + theta * z) == pytest.approx(math.exp(-z), abs=1e-6)


def servo(rate_hz: float, wanted: Array, *effects: KnownEffect) -> Array:
    """Positions of the servo of the probe at each sample, from rest at zero."""
    plant = nominal_plant(probe_servo())
    for effect in effects:
        plant = plant.with_effect(effect)
    stepper = Stepper(plant, rate_hz)
    stepper.reset([0.0], commands=[0.0])
    return np.array([0.0, *(stepper.step([u]).joints[0, 0] for u in wanted[:-1])])


def second_order(time: Array, kp: float, damping: float, inertia: float, goal: float) -> Array:
    """Step response of an underdamped mass, spring and damper."""
    natural, ratio = math.sqrt(kp / inertia), damping / (2.0 * math.sqrt(kp * inertia))
    fast = natural * math.sqrt(1.0 - ratio**2)
    decay = np.exp(-ratio * natural * time)
    return np.asarray(goal * (1.0 - decay * (np.cos(fast * time) + ratio * natural / fast * np.sin(fast * time))))


CASES = {
    "described": ((), (20.0, 1.2, 0.05)),
    "stiffness": ((KnownEffect("stiffness_error", "turn", {"ratio": 1.5}),), (30.0, 1.2, 0.05)),
    "damping": ((KnownEffect("damping_error", "turn", {"ratio": 0.5}),), (20.0, 0.6, 0.05)),
    "armature": ((KnownEffect("armature_error", "turn", {"ratio": 3.0}),), (20.0, 1.2, 0.15)),
    "viscous": ((KnownEffect("viscous_friction", "turn", {"coefficient": 0.4}),), (20.0, 1.6, 0.05)),
}


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("rate", [50.0, 100.0, 1000.0])
def test_step_response_below_the_force_limit(case: str, rate: float) -> None:
    effects, law = CASES[case]
    time = np.arange(round(2.0 * rate)) / rate
    found = servo(rate, np.full(len(time), 0.2), *effects)
    np.testing.assert_allclose(found, second_order(time, *law, 0.2), atol=4e-4 * 0.2 * 3)


def test_a_force_limit_bounds_the_acceleration() -> None:
    rate, limit = 1000.0, 0.5
    found = servo(rate, np.full(100, 1.5), KnownEffect("force_limit", "turn", {"limit": limit}))
    time = np.arange(100) / rate
    np.testing.assert_allclose(found, 0.5 * limit / 0.05 * time**2, atol=1e-6)


@pytest.mark.parametrize("goal", [0.03, -0.03])
def test_dry_friction_holds_what_the_controller_cannot_move(goal: float) -> None:
    """kp·0.03 = 0.6 N·m is below friction of 0.7; a larger step stops within friction over stiffness of its goal."""
    rubs = KnownEffect("coulomb_friction", "turn", {"force": 0.7})
    assert not servo(200.0, np.full(200, goal), rubs).any()
    far = servo(200.0, np.full(400, 10.0 * goal), rubs)
    assert abs(far[-1] - 10.0 * goal) <= 0.7 / 20.0
    assert far[-1] == far[-50]


def test_commands_between_samples_act_when_they_change() -> None:
    """A dead time of 12.5 ms at 100 Hz is that of 2.5 samples: the same as at 400 Hz."""
    late = KnownEffect("input_delay", "turn", {"delay": 0.0125})
    slow = servo(100.0, np.full(60, 0.2), late)
    fast = servo(400.0, np.full(240, 0.2), late)
    np.testing.assert_allclose(slow, fast[::4], atol=2e-4)


def test_a_run_begins_at_the_measured_position_and_speed() -> None:
    rate, machine = 100.0, probe_servo()
    time = np.arange(300) / rate
    wanted = np.where(time > 0.2, 0.3, 0.0)
    joint = servo(rate, wanted)
    whole = Recording("r", pd.DataFrame({"time": time, "turn.command": wanted, "turn.joint": joint}), rate)
    middle = Recording("m", whole.table.iloc[25:].reset_index(drop=True), rate)
    model = compile_plant(nominal_plant(machine))
    for recording in (whole, middle):
        found = free_run(model, recording)["turn.joint"].to_numpy()
        np.testing.assert_allclose(found, recording.values("turn.joint"), atol=4e-3)
        np.testing.assert_allclose(found, model.drive(model.theta[None], recording, "turn")[0], atol=3e-4)


def test_both_axes_wait_while_one_has_no_command(tmp_path: Path) -> None:
    text = arm_text(2)
    machine = drafted(tmp_path, text)
    wanted = commands(2, 400, 0.01)
    measured = logged(text, wanted, 0.01)
    wanted[100:180, 1] = np.nan
    run = free_run(nominal_plant(machine), recording_of(wanted, measured, 0.01, machine))
    gap = run["j0.joint"].isna().to_numpy()
    assert gap[115:180].all()
    assert not gap[:100].any()
    assert not gap[180:].any()


RUNNING = [effect for effect in CATALOGUE if "servo" in effect.actuations and effect.stage in ("command", "force", "joint")]


@pytest.mark.parametrize("effect", RUNNING, ids=lambda effect: effect.name)
def test_lanes_equal_the_free_run(effect: Effect) -> None:
    """Also where they begin in the middle of it; the lanes have other parameters beside them."""
    source = probe_recording(4.0)
    joint = np.where(np.arange(len(source)) < 20, 0.0, np.nan)
    source = replace(source, table=source.table.assign(**{"turn.joint": joint}))
    plant = nominal_plant(probe_servo())
    changed = plant.with_effect(KnownEffect(effect.name, "turn", typical_values(effect, effect.forms[-1])))
    run = free_run(changed, source)["turn.joint"].to_numpy()
    assert np.abs(run - free_run(plant, source)["turn.joint"].to_numpy()).max() > 1e-4
    wanted = source.values("turn.command")
    stepper = Stepper(changed, source.rate_hz, 2, np.stack([plant.vector(), changed.vector()]))
    for row in (0, 150):
        found = [stepper.begin(source, row).joints[1, 0], *(stepper.step([u]).joints[1, 0] for u in wanted[row:-1])]
        np.testing.assert_allclose(found, run[row:], atol=1e-11)


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4), (1, 0, 4, 2, 3), (4, 3, 2, 1, 0)])
def test_what_a_recording_keeps_of_one_plant_is_not_used_for_another(tmp_path: Path, order: tuple[int, ...]) -> None:
    """Plants that differ in anything on which the motion of the joints depends."""
    machine = drafted(tmp_path, arm_text(2))
    first = machine.axes[0]
    assert first.servo is not None
    softer = replace(first, servo=replace(first.servo, kp=0.8 * first.servo.kp))
    moon = drafted(tmp_path, arm_text(2).replace("<option ", '<option gravity="0 0 -1.6" '))
    plants = [
        nominal_plant(machine),
        nominal_plant(replace(machine, convention="written_before_read")),
        nominal_plant(moon),
        nominal_plant(replace(machine, axes=(softer, *machine.axes[1:]))),
        nominal_plant(machine).with_effect(KnownEffect("armature_error", first.name, {"ratio": 1.5})),
    ]
    wanted = commands(2, 200, 0.02)
    joints = logged(arm_text(2), wanted, 0.02)
    shared = recording_of(wanted, joints, 0.02, machine)
    runs = {k: alone(compile_plant(plants[k]), shared) for k in order}
    for k, run in runs.items():
        np.testing.assert_array_equal(run, alone(compile_plant(plants[k]), recording_of(wanted, joints, 0.02, machine)))
        assert k == 0 or np.abs(run - runs[0]).max() > 1e-4
