"""Plant versions: what they accept, how they are stored, where each number stands."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_data import arm, nominal, slide, slide_inputs

from sysid.effects import BY_NAME, CATALOGUE, Effect
from sysid.errors import SettingsError, StoreError
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import Plant, compile_plant, effects_toml, layout, nominal_plant, plant_from_files
from sysid.plant.plant import effect_key
from sysid.signals import point_signals
from sysid.testing import places_of, probe_machine
from sysid.testing.probe import probe_servo

# -- layout ---------------------------------------------------------------------------------------------------------


#: What the probe's motion capture carries, for the effects of its clock.
STREAMS = {"capture": ("boom.joint", *point_signals("tool"))}


def targets_of(effect: Effect) -> tuple[str, ...]:
    machine = probe_machine()
    everywhere = {"axis": machine.axis_names, "signal": layout.signals_of(machine.axis_names), "stream": tuple(STREAMS)}
    return everywhere.get(effect.target, (effect.target,))


def test_every_slot_has_a_place_of_its_own() -> None:
    """One stream with all signals covers the clock of each."""
    machine = probe_machine()
    everything = {"capture": layout.signals_of(machine.axis_names)}
    places = []
    for effect in CATALOGUE:
        for target in targets_of(effect):
            for side in effect.sides or (None,):
                for slot in effect.slots:
                    places += layout.slot_indices(machine.axis_names, effect, target, side, slot.name, everything)
    assert sorted(places) == list(range(len(layout.neutral_vector(len(machine.axes)))))


def test_a_clock_has_a_place_at_each_signal_of_its_stream() -> None:
    axes = probe_machine().axis_names
    for name in ("clock_offset", "clock_skew"):
        (slot,) = BY_NAME[name].slots
        places = layout.slot_indices(axes, BY_NAME[name], "capture", None, slot.name, STREAMS)
        alone = [
            layout.slot_indices(axes, BY_NAME[name], "one", None, slot.name, {"one": (signal,)})[0]
            for signal in STREAMS["capture"]
        ]
        assert places == alone
        assert len(set(places)) == 4


def test_commands_of_a_stream_have_no_sensor() -> None:
    """A stream that carries commands as well: nothing reads them, so its clock has no place there."""
    axes = probe_machine().axis_names
    streams = {"machine": ("slew.command", "slew.joint", "time")}
    assert len(layout.slot_indices(axes, BY_NAME["clock_offset"], "machine", None, "offset", streams)) == 1


def test_neutral_values_stand_in_their_places() -> None:
    machine = probe_machine()
    theta = layout.neutral_vector(len(machine.axes)).copy()
    for effect in CATALOGUE:
        for slot in effect.slots:
            places = layout.slot_indices(machine.axis_names, effect, targets_of(effect)[-1], None, slot.name, STREAMS)
            assert (theta[places] == slot.neutral).all()


@st.composite
def plants(draw: st.DrawFn) -> Plant:
    """Plants of the probe machine with any set of effects."""
    plant = nominal_plant(probe_machine(), streams=STREAMS)
    for effect in draw(
        st.lists(st.sampled_from([e for e in CATALOGUE if not e.of_links and e.actuations != ("servo",)]), max_size=8)
    ):
        plant = plant.with_effect(draw(instances(effect)))
    return plant


@st.composite
def instances(draw: st.DrawFn, effect: Effect) -> KnownEffect:
    place = draw(st.sampled_from([p for p in places_of(effect) if p.target not in probe_servo().axis_names]))
    values: dict[str, Any] = {}
    for parameter in draw(st.sampled_from(effect.forms)).parameters:
        numbers = [draw(st.floats(*parameter.bounds)) for _ in parameter.components]
        values[parameter.name] = numbers[0] if len(numbers) == 1 else numbers
    return KnownEffect(effect.name, place.target, values, place.side)  # type: ignore[arg-type]


@given(plants())
def test_vector_holds_every_parameter(plant: Plant) -> None:
    theta = plant.vector()
    untouched = np.ones(len(theta), dtype=bool)
    for item in plant.effects:
        for name, value in item.parameters.items():
            groups = layout.parameter_indices(plant.machine.axis_names, item.name, item.target, item.side, name, STREAMS)
            for group, component in zip(groups, np.atleast_1d(value), strict=True):
                assert (theta[group] == component).all()
                untouched[group] = False
    assert (theta[untouched] == layout.neutral_vector(len(plant.machine.axes))[untouched]).all()


@given(plants())
def test_files_give_back_the_plant(plant: Plant) -> None:
    again = plant_from_files(plant.to_files(), "probe@3")
    assert again.reference == "probe@3"
    assert np.array_equal(again.vector(), plant.vector())
    assert {effect_key(e) for e in again.effects} == {effect_key(e) for e in plant.effects}
    assert again.machine == plant.machine
    assert again.streams == plant.streams
    for axis, table in plant.linkages.items():
        assert np.array_equal(again.linkages[axis].joints, table.joints)
    assert again.to_files() == plant.to_files(), "the same content is the same version"


def test_order_of_effects_does_not_change_the_files() -> None:
    one, other = KnownEffect("gain_error", "slew", {"ratio": 1.1}), KnownEffect("input_delay", "boom", {"delay": 0.1})
    assert nominal(one, other).to_files() == nominal(other, one).to_files()


def test_files_without_a_plant() -> None:
    with pytest.raises(StoreError, match=r"arm@1: no plant\.json among its files"):
        plant_from_files({"model.json": b"{}"}, "arm@1")


def test_effects_as_toml_are_the_machine_s() -> None:
    """What a repaired plant prints can be pasted into machine.toml."""
    plant = nominal(
        KnownEffect("valve_deadband", "boom", {"positive": 0.11, "negative": 0.08}),
        KnownEffect("backlash", "slew", {"width": 0.01}, "structure"),
        KnownEffect("base_misalignment", "base", {"translation": [0.1, 0.0, -0.2], "rotation": [0.0, 0.0, 0.01]}),
    )
    files = arm().files()
    text = files["machine.toml"] + "\n" + effects_toml(plant.effects)
    again = nominal_plant(machine_from_files({**files, "machine.toml": text}, "pasted"))
    assert np.array_equal(again.vector(), plant.vector())


# -- changes and mistakes -------------------------------------------------------------------------------------------


def test_a_repaired_plant_is_a_new_one() -> None:
    plant = plant_from_files(nominal().to_files(), "arm@1")
    repaired = plant.with_effect(KnownEffect("gain_error", "slew", {"ratio": 1.2}))
    assert plant.effects == ()
    assert repaired.reference == ""
    assert repaired.with_effect(KnownEffect("gain_error", "slew", {"ratio": 1.3})).effects[0].parameters == {"ratio": 1.3}
    assert repaired.without_effect("gain_error", "slew").effects == ()


def test_both_sides_of_a_play_are_two_effects() -> None:
    drive, structure = (KnownEffect("backlash", "slew", {"width": 0.01}, side) for side in ("drive", "structure"))
    plant = nominal(drive, structure)
    assert len(plant.effects) == 2
    assert plant.effect("backlash", "slew") is drive
    assert plant.effect("backlash", "slew", "structure") is structure


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (KnownEffect("valve_dedband", "boom", {}), "unknown effect 'valve_dedband'; expected 'valve_deadband'?"),
        (KnownEffect("gain_error", "bom", {"ratio": 1.0}), "unknown axis 'bom'; expected 'boom'?"),
        (KnownEffect("gain_error", "wrist", {"ratio": 1.0}), "target 'wrist' is position-actuated; expected velocity"),
        (KnownEffect("gain_error", "boom", {"ration": 1.0}), "gain_error: parameters {ration}; expected {ratio}"),
        (KnownEffect("gain_error", "boom", {}), "gain_error: parameters {}; expected {ratio}"),
        (KnownEffect("gain_error", "boom", {"ratio": 50.0}), "on boom: ratio = 50.0; expected a number in [0.05, 20.0]"),
        (KnownEffect("gain_error", "boom", {"ratio": [1.0, 1.0]}), "ratio = [1.0, 1.0]; expected a number"),
        (KnownEffect("gain_error", "boom", {"ratio": float("nan")}), "ratio = nan; expected a number"),
        (KnownEffect("gain_error", "boom", {"ratio": 1.0}, "drive"), "side 'drive'; expected no side"),
        (KnownEffect("backlash", "boom", {"width": 0.01}, "strukture"), "side 'strukture'; expected 'structure'?"),  # type: ignore[arg-type]
        (KnownEffect("gripper_sway", "boom", {"length": 0.2, "damping_ratio": 0.1}), "target 'boom'; expected 'tool'"),
        (KnownEffect("base_misalignment", "tool", {"translation": [0, 0, 0], "rotation": [0, 0, 0]}), "expected 'base'"),
        (KnownEffect("sensor_bias", "boom.joynt", {"bias": 0.01}), "target 'boom.joynt'; expected 'boom.joint'?"),
        (KnownEffect("sensor_bias", "slew.cylinder", {"bias": 0.01}), "target 'slew.cylinder'; expected"),
        (KnownEffect("clock_offset", "mocap", {"offset": 0.01}), "unknown target 'mocap'; expected no stream is known"),
        (KnownEffect("pump_flow_limit", "boom", {"limit": 1.0}), "target 'boom'; expected 'machine'"),
        (KnownEffect("base_misalignment", "base", {"translation": 0.1, "rotation": [0, 0, 0]}), "expected 3 numbers"),
    ],
    ids=lambda value: "" if isinstance(value, str) else value.name,
)  # fmt: skip
def test_mistakes_say_what_is_valid(effect: KnownEffect, message: str) -> None:
    with pytest.raises(SettingsError, match=re.escape(message)):
        nominal(effect)


def test_an_unknown_stream_suggests_the_nearest() -> None:
    with pytest.raises(SettingsError, match=r"effect clock_offset: unknown target 'captur'; expected 'capture'\?"):
        nominal_plant(probe_machine(), streams=STREAMS).with_effect(KnownEffect("clock_offset", "captur", {"offset": 0.01}))


def test_the_same_effect_twice() -> None:
    one = KnownEffect("gain_error", "boom", {"ratio": 1.1})
    with pytest.raises(SettingsError, match="gain_error on boom twice; expected one instance"):
        Plant(arm(), {}, (one, one))


def test_unknown_parameter_of_a_fit() -> None:
    with pytest.raises(SettingsError, match=r"unknown parameter 'widht'; expected 'width'\?"):
        layout.parameter_indices(("slew",), "backlash", "slew", None, "widht")


def test_a_machine_without_geometry_says_so() -> None:
    model = compile_plant(nominal_plant(slide()))
    with pytest.raises(SettingsError, match=r"machine slide: no URDF; expected urdf and tip in machine\.toml"):
        model.tip(model.theta[None], slide_inputs("run", 1.0, 0))
    with pytest.raises(SettingsError, match="axis slide: no linkage"):
        model.joint(model.theta[None], slide_inputs("run", 1.0, 0), "slide")
