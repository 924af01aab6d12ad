"""The stepper is the free run with the loop outside: same figures, for every effect in every place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from sysid.datasets.recording import Recording
from sysid.effects import BY_NAME, CATALOGUE, Effect
from sysid.errors import SettingsError
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import Plant, free_run, nominal_plant
from sysid.plant.stepper import LaneState, Stepper, held_commands, step_commands
from sysid.signals import axis_signal, point_signals
from sysid.testing import places_of
from sysid.testing.check import typical_values
from sysid.testing.probe import RATE_HZ, probe_machine, probe_recording

Array = npt.NDArray[np.float64]
SWAY = KnownEffect("gripper_sway", "tool", {"length": 0.25, "damping_ratio": 0.05})
REST = np.array([0.1, 0.2, 0.0, 0.3])


def placed(effect: Effect) -> list[tuple[str, KnownEffect]]:
    """The effect with typical values at each of its places, in its first form."""
    values = typical_values(effect, effect.forms[0])
    found = [KnownEffect(effect.name, place.target, values, place.side) for place in places_of(effect)]  # type: ignore[arg-type]
    return [(f"{item.name}-{item.target}-{item.side or ''}".rstrip("-"), item) for item in found]


PLACED = [entry for effect in CATALOGUE for entry in placed(effect)]


def recording() -> Recording:
    """Probe inputs, with a tool that begins off its rest."""
    source = probe_recording()
    swinging = np.cos(6.0 * source.values("time"))
    table = source.table.assign(
        **{name: source.values(f"ee.{name[-1]}") + 0.02 * swinging - 0.2 * (name == "tool.z") for name in point_signals("tool")}
    )
    return replace(source, table=table)


def columns(plant: Plant, states: list[LaneState], lane: int) -> dict[str, Array]:
    found: dict[str, Array] = {}
    for i, axis in enumerate(plant.machine.axes):
        found[axis.driven] = np.array([state.drive[lane, i] for state in states])
        found[axis_signal(axis.name, "joint")] = np.array([state.joints[lane, i] for state in states])
    for point in ("ee", "tool"):
        for k, name in enumerate(point_signals(point)):
            found[name] = np.array([getattr(state, point)[lane, k] for state in states])
    return found


def replay(plant: Plant, source: Recording, run: pd.DataFrame, lanes: int) -> list[LaneState]:
    stepper = Stepper(plant, source.rate_hz, lanes)
    states = [stepper.begin(source, run, 0)]
    commands = step_commands(plant.machine, held_commands(plant.machine, source))
    return [*states, *(stepper.step(command) for command in commands)]


@pytest.mark.parametrize("item", [item for _, item in PLACED], ids=[name for name, _ in PLACED])
def test_equals_the_free_run(item: KnownEffect) -> None:
    plant = nominal_plant(probe_machine()).with_effect(SWAY).with_effect(item)
    source = recording()
    run = free_run(plant, source)
    stepped = columns(plant, replay(plant, source, run, 3), 2)
    moved = [name for name in run.columns if name != "time"]
    assert {"slew.joint", "boom.cylinder", "boom.joint", "slide.joint", "wrist.joint", "ee.x", "tool.z"} <= set(moved)
    for name in moved:
        np.testing.assert_allclose(stepped[name], run[name], rtol=0.0, atol=1e-11, err_msg=name)


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
        SettingsError, match=r"axis boom: no linkage: a joint value does not say where the cylinder is; expected"
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
    assert {item.name for _, item in PLACED} == set(BY_NAME)
