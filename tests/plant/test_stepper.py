"""The stepper is the free run with the loop outside: same figures, for every effect in every place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from plant_data import arm, arm_inputs, loaded_arm, measured

from sysid.datasets.recording import Recording
from sysid.effects import CATALOGUE, Effect
from sysid.errors import SettingsError
from sysid.machine import KnownEffect, Machine, machine_from_files
from sysid.plant import Plant, compile_plant, free_run, nominal_plant
from sysid.plant.stepper import LaneState, Stepper, held_commands, step_commands
from sysid.signals import axis_signal, point_signals
from sysid.testing import places_of
from sysid.testing.check import typical_values
from sysid.testing.probe import RATE_HZ, probe_machine, probe_recording, probe_servo

Array = npt.NDArray[np.float64]
SWAY = KnownEffect("gripper_sway", "tool", {"length": 0.25, "damping_ratio": 0.05})
REST = np.array([0.1, 0.2, 0.0, 0.3])


def placed(effect: Effect) -> list[tuple[str, KnownEffect]]:
    """The effect with typical values at each of its places, in its first form."""
    values = typical_values(effect, effect.forms[0])
    places = [place for place in places_of(effect) if place.target not in probe_servo().axis_names]
    found = [KnownEffect(effect.name, place.target, values, place.side) for place in places]  # type: ignore[arg-type]
    return [(f"{item.name}-{item.target}-{item.side or ''}".rstrip("-"), item) for item in found]


#: What acts in a run of the probe; forces of an arm are compared at measured motion only. Servos: test_servo_arm.py.
RUNNING = [effect for effect in CATALOGUE if not effect.of_links and effect.actuations != ("servo",)]
PLACED = [entry for effect in RUNNING for entry in placed(effect)]


def recording() -> Recording:
    """Probe inputs, with a tool that begins off its rest."""
    source = probe_recording()
    swinging = np.cos(6.0 * source.values("time"))
    table = source.table.assign(
        **{name: source.values(f"ee.{name[-1]}") + 0.02 * swinging - 0.2 * (name == "tool.z") for name in point_signals("tool")}
    )
    return replace(source, table=table)


def columns(plant: Plant, states: list[LaneState], lane: int) -> dict[str, Array]:
    """Signals by name as the sensors of the plant read them: a state itself is the truth."""
    model = compile_plant(plant)
    found = true_columns(plant, states, lane)
    return {name: model.sensed(model.theta[None], name, values[None], 1.0 / RATE_HZ)[0] for name, values in found.items()}


def true_columns(plant: Plant, states: list[LaneState], lane: int) -> dict[str, Array]:
    found: dict[str, Array] = {}
    for i, axis in enumerate(plant.machine.axes):
        found[axis.driven] = np.array([state.drive[lane, i] for state in states])
        found[axis_signal(axis.name, "joint")] = np.array([state.joints[lane, i] for state in states])
    for point in ("ee", "tool"):
        for k, name in enumerate(point_signals(point)):
            found[name] = np.array([getattr(state, point)[lane, k] for state in states])
    return found


def replay(plant: Plant, source: Recording, lanes: int, row: int = 0) -> list[LaneState]:
    stepper = Stepper(plant, source.rate_hz, lanes)
    states = [stepper.begin(source, row)]
    commands = step_commands(plant.machine, held_commands(plant.machine, source)[row:])
    return [*states, *(stepper.step(command) for command in commands)]


def assert_same(plant: Plant, states: list[LaneState], lane: int, run: pd.DataFrame) -> None:
    """Free run and stepped lane agree in every signal, to rounding."""
    stepped = columns(plant, states, lane)
    moved = [str(name) for name in run.columns if name != "time"]
    assert {*(a.driven for a in plant.machine.axes), "boom.joint", "ee.x", "tool.z"} <= set(moved)
    for name in moved:
        np.testing.assert_allclose(stepped[name], run[name], rtol=0.0, atol=1e-11, err_msg=name)


def probe_plant(*effects: KnownEffect) -> Plant:
    plant = nominal_plant(probe_machine(), streams={"capture": ("boom.joint", *point_signals("tool"))})
    for effect in (SWAY, *effects):
        plant = plant.with_effect(effect)
    return plant


@pytest.mark.parametrize("item", [item for _, item in PLACED], ids=[name for name, _ in PLACED])
def test_equals_the_free_run(item: KnownEffect) -> None:
    plant, source = probe_plant(item), recording()
    assert_same(plant, replay(plant, source, 3), 2, free_run(plant, source))


#: Every effect that a machine may have at once, small enough that all of them act.
ALL = {
    "input_delay": {"delay": 0.034},
    "valve_hysteresis": {"width": 0.03},
    "valve_deadband": {"positive": 0.06, "negative": 0.04},
    "gain_curve": {"exponent": 1.2},
    "flow_saturation": {"limit": 0.8},
    "command_rate_limit": {"rate": 6.0},
    "first_order_lag": {"time_constant": 0.05},
    "second_order_lag": {"time_constant": 0.06, "damping_ratio": 0.4},
    "gain_error": {"ratio": 1.2},
    "asymmetric_gain": {"ratio": 0.8},
    "temperature_drift": {"fraction": 0.3, "time_constant": 5.0},
    "load_dependent_flow": {"coefficient": 0.02},
    "internal_leakage": {"rate": 4e-4},
    "stiction": {"breakaway": 0.05, "release": 0.03},
    "oil_compressibility": {"frequency": 6.0, "damping_ratio": 0.1},
    "coulomb_friction": {"force": 0.4},
    "viscous_friction": {"positive": 1.0, "negative": 1.5},
    "stribeck_friction": {"static_force": 0.5, "coulomb_force": 0.2, "stribeck_velocity": 0.02},
    "smooth_coulomb_friction": {"force": 0.3, "width": 0.05},
    "inertia_error": {"ratio": 1.2},
    "force_constant_error": {"ratio": 0.9},
    "flexible_drive": {"frequency": 5.0, "damping_ratio": 0.1, "inertia_ratio": 1.5},
    "load_bias": {"force": -0.2},
    "backlash": {"width": 0.01},
    "joint_compliance": {"compliance": 1e-3},
    "joint_offset": {"offset": 0.02},
    "link_length_error": {"error": 0.01},
    "tip_offset": {"translation": [0.02, -0.01, 0.03]},
    "base_misalignment": {"translation": [0.1, 0.0, -0.1], "rotation": [0.02, 0.0, 0.1]},
    "gripper_sway": {"length": 0.25, "damping_ratio": 0.05},
    "pump_flow_limit": {"limit": 0.9},
    "sensor_scale": {"scale": 1.01},
    "sensor_bias": {"bias": 0.005},
    "sensor_quantisation": {"step": 0.001},
    "clock_skew": {"skew": 300.0},
    "clock_offset": {"offset": -0.013},
}


def everything(plant: Plant) -> Plant:
    """All effects of the catalogue at all axes, on both sides, and at the sensors of a joint and of the tool."""
    machine = plant.machine
    for effect in RUNNING:
        targets = {"axis": machine.axis_names, "signal": ("boom.joint", "tool.x"), "stream": tuple(plant.streams)}
        for target in targets.get(effect.target, (effect.target,)):
            if effect.target == "axis" and machine.axis(target).actuation not in effect.actuations:
                continue
            for side in effect.sides or (None,):
                plant = plant.with_effect(KnownEffect(effect.name, target, ALL[effect.name], side))  # type: ignore[arg-type]
    return plant


MACHINES = {"probe": probe_machine(), "arm": arm(), "loaded": loaded_arm()}


@pytest.mark.parametrize("name", MACHINES)
def test_equals_the_free_run_with_everything_at_once(name: str) -> None:
    plant = everything(nominal_plant(MACHINES[name], streams={"capture": ("boom.joint", *point_signals("tool"))}))
    source = recording() if name == "probe" else measured(plant, arm_inputs("run", 6.0, 2), 0)
    run = free_run(plant, source)
    assert_same(plant, replay(plant, source, 2), 1, run)
    moved = [axis.driven for axis in plant.machine.axes]
    assert all(run[signal].std() > 1e-3 for signal in moved), "the comparison is of motion"


def test_all_effects_are_on_when_everything_is() -> None:
    assert set(ALL) == {effect.name for effect in RUNNING}
    on = {effect.name for machine in (probe_machine(), arm()) for effect in everything_of(machine).effects}
    assert on == set(ALL)


def everything_of(machine: Machine) -> Plant:
    return everything(nominal_plant(machine, streams={"capture": ("boom.joint", *point_signals("tool"))}))


@pytest.mark.parametrize("name", MACHINES)
def test_begins_where_the_free_run_restarts(name: str) -> None:
    """After a gap in all commands: warm as the free run is by then, and in its place."""
    plant = everything_of(MACHINES[name])
    source = recording() if name == "probe" else measured(plant, arm_inputs("run", 6.0, 3), 0)
    gap = {axis_signal(a.name, "command"): source.values(axis_signal(a.name, "command")).copy() for a in plant.machine.axes}
    for values in gap.values():
        values[250:330] = np.nan
    source = replace(source, table=source.table.assign(**gap))
    # A clock reads NaN at the end of what is known, which differs between a whole run and a part of it.
    plant = plant.without_effect("clock_offset", "capture").without_effect("clock_skew", "capture")
    run = free_run(plant, source).iloc[330:].reset_index(drop=True)
    assert_same(plant, replay(plant, source, 2, 330), 1, run)


def test_lanes_of_different_plants_share_neither_pump_nor_load() -> None:
    """Each lane is what it is alone: strong and weak pumps, stiff and soft joints, loads that slow the boom or do not."""
    plants = [
        probe_plant(
            KnownEffect("pump_flow_limit", "machine", {"limit": limit}),
            KnownEffect("load_dependent_flow", "boom", {"coefficient": coefficient}),
            KnownEffect("joint_compliance", "boom", {"compliance": compliance}, "structure"),
            KnownEffect("oil_compressibility", "slew", {"frequency": 5.0 + limit, "damping_ratio": 0.1}),
        )
        for limit in (0.5, 1.0, 100.0)
        for coefficient in (0.0, 0.05)
        for compliance in (0.0, 2e-3)
    ]
    together = Stepper(plants[0], RATE_HZ, len(plants), np.array([p.vector() for p in plants]))
    alone = [Stepper(p, RATE_HZ) for p in plants]
    together.reset(REST)
    for stepper in alone:
        stepper.reset(REST)
    for k in range(60):
        command = [np.sin(0.1 * k), np.cos(0.07 * k), 0.5, 0.3]
        state = together.step(command)
        for lane, stepper in enumerate(alone):
            single = stepper.step(command)
            for name in ("drive", "joints", "structure", "ee", "tool"):
                np.testing.assert_array_equal(getattr(state, name)[lane], getattr(single, name)[0], err_msg=name)
    assert len(np.unique(state.drive[:, 1])) == 9, "a compliance moves no cylinder, unless its speed depends on the load"
    assert len(np.unique(state.ee[:, 2])) == 12


def test_lanes_of_different_plants_and_starts_know_nothing_of_each_other() -> None:
    plant = nominal_plant(probe_machine()).with_effect(SWAY)
    other = plant.with_effect(KnownEffect("backlash", "slew", {"width": 0.03}, "structure")).with_effect(
        KnownEffect("joint_offset", "boom", {"offset": 0.02})
    )
    mixed = Stepper(plant, RATE_HZ, 700, np.array([p.vector() for p in (plant, other)] * 350))
    starts = np.tile(REST, (700, 1)) + 0.01 * np.arange(700)[:, None] / 700.0
    alone = [Stepper(p, RATE_HZ) for p in (plant, other)]
    mixed.reset(starts)
    for lane in (0, 1):
        alone[lane].reset(starts[lane])
    rng = np.random.default_rng(0)
    for _ in range(40):
        command = rng.uniform(-1.0, 1.0, 4)
        state = mixed.step(command)
        for lane in (0, 1):
            single = alone[lane].step(command)
            for name in ("drive", "joints", "structure", "ee", "tool"):
                np.testing.assert_array_equal(getattr(state, name)[lane], getattr(single, name)[0], err_msg=name)
    assert np.ptp(state.ee[::2, 0]) > 1e-3


def test_a_lane_that_begins_in_a_recording_moves_with_its_own_spring() -> None:
    """At rest all plants have one state, without what is computed once from the spring of the plant that ran there."""
    source = recording()
    still = source.table.assign(**{name: source.table[name].iloc[0] for name in source.signals})
    still = still.assign(**{axis_signal(name, "command"): 0.0 for name in probe_machine().axis_names})
    soft, stiff = (
        probe_plant(
            KnownEffect(
                "flexible_drive", probe_machine().axis_names[2], {"frequency": f, "damping_ratio": 0.1, "inertia_ratio": 1.5}
            )
        )
        for f in (3.0, 9.0)
    )
    mixed = Stepper(soft, RATE_HZ, 2, np.array([plant.vector() for plant in (soft, stiff)]))
    alone = [Stepper(plant, RATE_HZ) for plant in (soft, stiff)]
    begun = replace(source, table=still)
    for stepper in (mixed, *alone):
        stepper.begin(begun, 50)
    for _ in range(40):
        state = mixed.step([0.0, 0.0, 0.8, 0.0])
        singles = [stepper.step([0.0, 0.0, 0.8, 0.0]).drive[0] for stepper in alone]
        np.testing.assert_allclose(state.drive, singles, rtol=0.0, atol=1e-12)
    assert abs(singles[0] - singles[1]).max() > 1e-6


def test_some_lanes_are_reset_while_the_others_go_on() -> None:
    plant = nominal_plant(probe_machine()).with_effect(SWAY)
    stepper, reference = (Stepper(plant, RATE_HZ, 4) for _ in range(2))
    stepper.reset(REST), reference.reset(REST)
    for _ in range(30):
        stepper.step([1.0, 1.0, 0.5, 0.6]), reference.step([1.0, 1.0, 0.5, 0.6])
    state = stepper.reset(REST, which=np.array([False, True, False, True]))
    fresh = Stepper(plant, RATE_HZ, 4).reset(REST)
    for name in ("drive", "joints", "ee", "tool"):
        np.testing.assert_array_equal(getattr(state, name)[[1, 3]], getattr(fresh, name)[[1, 3]])
    moved, expected = stepper.step(np.zeros(4)), reference.step(np.zeros(4))
    np.testing.assert_array_equal(moved.tool[[0, 2]], expected.tool[[0, 2]])


@pytest.mark.parametrize("name", MACHINES)
def test_a_restored_stepper_goes_on_to_the_last_bit(name: str) -> None:
    plant = everything_of(MACHINES[name])
    axes = len(plant.machine.axes)
    one, other = Stepper(plant, RATE_HZ, 2), Stepper(plant, RATE_HZ, 2)
    rng = np.random.default_rng(0)
    commands = rng.uniform(-0.4, 0.4, (30, 2, axes))
    one.reset(0.1 * np.arange(axes))
    for command in commands[:20]:
        state = one.step(command)
    kept = one.state()
    for again, expected in zip(vars(other.restore(kept)).values(), vars(state).values(), strict=True):
        np.testing.assert_array_equal(again, expected)
    for command in commands[20:]:
        for a, b in zip(vars(one.step(command)).values(), vars(other.step(command)).values(), strict=True):
            np.testing.assert_array_equal(a, b)
    with pytest.raises(SettingsError, match=r"a state with memory of shape \(2, .*expected \(3,"):
        Stepper(plant, RATE_HZ, 3).restore(kept)


def test_at_rest_nothing_moves_and_the_first_command_meets_the_dead_time() -> None:
    plant = nominal_plant(probe_machine(), None).with_effect(KnownEffect("input_delay", "slew", {"delay": 0.05}))
    stepper = Stepper(plant, RATE_HZ)
    begun = stepper.reset(REST)
    np.testing.assert_allclose(begun.joints[0], REST, atol=2e-6)
    still = stepper.step([0.0, 0.0, 0.0, REST[3]])
    np.testing.assert_array_equal(still.joints, begun.joints)
    turns = [stepper.step([1.0, 0.0, 0.0, REST[3]]).joints[0, 0] for _ in range(6)]
    assert turns[4] == begun.joints[0, 0]
    assert turns[5] == pytest.approx(begun.joints[0, 0] + 0.5 / RATE_HZ)


def test_states_are_the_callers_own() -> None:
    stepper = Stepper(nominal_plant(probe_machine()), RATE_HZ)
    begun = stepper.reset(REST)
    kept = begun.ee.copy()
    stepper.step([1.0, 1.0, 1.0, 1.0])
    np.testing.assert_array_equal(begun.ee, kept)


def test_without_a_linkage_joints_and_tip_are_unknown() -> None:
    files = probe_machine().files()
    text = "\n".join(line for line in files["machine.toml"].splitlines() if not line.startswith("linkage"))
    plant = nominal_plant(machine_from_files({**files, "machine.toml": text}, "probe"))
    stepper = Stepper(plant, RATE_HZ)
    with pytest.raises(
        SettingsError, match=r"axis boom: no linkage: the cylinder position does not follow from the joint; expected"
    ):
        stepper.reset(REST)
    state = stepper.reset(REST, drive=[0.1, 0.05, 0.0, 0.3])
    assert state.drive[0, 1] == 0.05
    assert np.isnan(state.joints[0, 1])
    assert np.isnan(state.ee).all()
    assert np.isfinite(state.joints[0, [0, 2, 3]]).all()


def test_mistakes_say_what_was_expected() -> None:
    plant = nominal_plant(probe_machine())
    with pytest.raises(SettingsError, match="0 lanes; expected at least one"):
        Stepper(plant, RATE_HZ, 0)
    with pytest.raises(SettingsError, match=r"rate_hz = 0\.0; expected a positive rate"):
        Stepper(plant, 0.0)
    with pytest.raises(SettingsError, match=r"thetas of shape \(1, 3\); expected \(2, \d+\)"):
        Stepper(plant, RATE_HZ, 2, np.zeros((1, 3)))
    stepper = Stepper(plant, RATE_HZ, 2)
    with pytest.raises(SettingsError, match="lane 0 was never reset"):
        stepper.step(np.zeros(4))
    stepper.reset(REST)
    with pytest.raises(SettingsError, match=r"commands of shape \(3,\); expected \(4,\) or \(2, 4\)"):
        stepper.step(np.zeros(3))


def test_every_effect_is_looked_at() -> None:
    assert {item.name for _, item in PLACED} == {effect.name for effect in RUNNING}
