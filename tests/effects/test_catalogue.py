"""Every effect of the catalogue has all properties, and the checker finds violations."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from sysid.datasets.recording import Recording
from sysid.effects import BY_NAME, CATALOGUE, Effect, Form, Need, Parameter, Slot, effect_named, form_for
from sysid.errors import SettingsError
from sysid.gap.excitation import COUNTS
from sysid.testing import PROPERTIES, EffectError, Run, check_effect, failures_of, places_of, plant_run

Array = npt.NDArray[np.float64]
LAG, DEADBAND, PLAY = BY_NAME["first_order_lag"], BY_NAME["valve_deadband"], BY_NAME["backlash"]


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_properties(effect: Effect) -> None:
    check_effect(effect)


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_looked_at_in_every_place(effect: Effect) -> None:
    """The probe machine has a place for each kind of target and side that the effect allows."""
    places = places_of(effect)
    assert {p.side for p in places} == (set(effect.sides) or {None})
    if effect.target == "axis":
        kinds = {
            "slew": "velocity",
            "boom": "velocity",
            "slide": "force",
            "wrist": "position",
            "lift": "force",
            "elbow": "force",
            "turn": "servo",
        }
        # The arm of the probe has no servo, and its servo moves no link; the structure is the same behind every drive.
        shown = set(effect.actuations) - ({"servo"} if effect.stage in ("end_effector", "links") else set())
        assert {kinds[p.target] for p in places} == shown


#: Names that have a fixed meaning: none is taken away or given to something else.
CONTRACT_NAMES = {
    *("input_delay", "first_order_lag", "valve_deadband", "valve_hysteresis", "gain_error", "asymmetric_gain"),
    *("gain_curve", "flow_saturation", "command_rate_limit", "load_dependent_flow", "pump_flow_limit"),
    *("internal_leakage", "temperature_drift", "stiction", "oil_compressibility"),
    *("coulomb_friction", "viscous_friction", "stribeck_friction", "inertia_error", "force_constant_error", "load_bias"),
    *("backlash", "joint_compliance", "joint_offset", "link_length_error", "base_misalignment", "gripper_sway"),
    *("sensor_bias", "sensor_scale", "sensor_quantisation", "clock_offset", "clock_skew"),
}


def test_no_name_of_the_contract_is_missing() -> None:
    assert set(BY_NAME) >= CONTRACT_NAMES
    assert len(BY_NAME) == len(CATALOGUE)


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_what_separates_two_effects_is_written_once(effect: Effect) -> None:
    both = [other for other in effect.confused_with if effect.name in BY_NAME[other].confused_with]
    assert not both
    assert all(text.strip() for text in effect.confused_with.values())


@pytest.mark.parametrize("effect", CATALOGUE, ids=lambda effect: effect.name)
def test_every_effect_says_what_it_needs(effect: Effect) -> None:
    """Something that is counted, more than nothing of it, and what to record, addressed to the target where there are many."""
    assert effect.need.count in COUNTS
    assert effect.need.least > 0
    assert effect.need.advice.format(axis="boom").endswith(".")
    assert ("{axis}" in effect.need.advice) == (effect.target in ("axis", "signal"))


def test_no_count_is_there_for_nothing() -> None:
    assert set(COUNTS) == {effect.need.count for effect in CATALOGUE}


def test_unknown_effect_suggests_the_nearest() -> None:
    with pytest.raises(SettingsError, match=r"unknown effect 'valve_deadban'; expected 'valve_deadband'\?"):
        effect_named("valve_deadban")


def test_wrong_parameters_list_the_forms() -> None:
    with pytest.raises(SettingsError, match=r"parameters \{force, positive\}; expected \{force\} or \{positive, negative\}"):
        form_for(BY_NAME["coulomb_friction"], frozenset({"force", "positive"}), "here")


# -- broken metadata ------------------------------------------------------------------------------------------------


def with_parameter(effect: Effect, **changes: object) -> Effect:
    first = effect.forms[0].parameters[0]
    changed = replace(first, **changes)  # type: ignore[arg-type]
    return replace(effect, forms=(Form((changed, *effect.forms[0].parameters[1:])),))


@pytest.mark.parametrize(
    ("effect", "message"),
    [
        (replace(LAG, source=" "), "metadata: source is empty"),
        (replace(LAG, sentences=("It lags by {lag}.",)), "no sentence has the parameters {time_constant} alone"),
        (replace(LAG, excited_by=""), "metadata: excited_by is empty"),
        (replace(LAG, name="own_lag", confused_with={}), "confused_with is empty"),
        (replace(LAG, confused_with={"input_dela": "one"}), "confused_with names 'input_dela', expected 'input_delay'?"),
        (replace(LAG, confused_with={"first_order_lag": "one"}), "confused_with names 'first_order_lag'"),
        (replace(LAG, actuations=()), "an axis effect names no kind of actuation"),
        (replace(LAG, forms=()), "1 slots and 0 forms"),
        (replace(LAG, slots=(Slot("time_constant"), Slot("spare"))), "no form writes the slots ['spare']"),
        (with_parameter(LAG, unit="ms"), "time_constant: unit 'ms' is not one of"),
        (with_parameter(LAG, bounds=(2.0, 0.0)), "time_constant: bounds [2.0, 0.0]"),
        (with_parameter(LAG, bounds=(0.0, 0.05)), "starts [0.1, 0.3] lie outside of the bounds [0.0, 0.05]"),
        (with_parameter(LAG, starts=()), "no value to start a fit from"),
        (with_parameter(LAG, about=""), "time_constant: about is empty"),
        (with_parameter(LAG, negligible=-1.0), "negligible = -1.0"),
    ],
)
def test_broken_metadata_are_found(effect: Effect, message: str) -> None:
    with pytest.raises(EffectError, match=re.escape(message)):
        check_effect(effect)


def test_bounds_that_leave_out_the_neutral_value_are_found() -> None:
    """With a lag of at least 0.05 s a fit could never say that there is none."""
    effect = with_parameter(LAG, bounds=(0.05, 2.0), starts=(0.1,))
    assert {f.check for f in failures_of(effect)} == {"neutral"}


# -- broken behaviour: the compiled plant, spoiled in one way ------------------------------------------------------


def looks_ahead(sound: Run) -> Run:
    return lambda values, recording: np.roll(sound(values, recording), -3, axis=0)


def remembers(sound: Run) -> Run:
    state = {"last": 0.0}

    def run(values: object, recording: Recording) -> Array:
        out = sound(values, recording) + 1e-6 * state["last"]  # type: ignore[arg-type]
        state["last"] = float(np.nanmax(np.abs(out)))
        return out

    return run


def noisy(sound: Run) -> Run:
    rng = np.random.default_rng(0)
    return lambda values, recording: sound(values, recording) * (1.0 + 1e-12 * rng.standard_normal())


def never_absent(sound: Run) -> Run:
    return lambda values, recording: sound(values, recording) * (1.0 if values is None else 1.001)


def does_nothing(sound: Run) -> Run:
    return lambda values, recording: sound(None, recording)


def overflows(sound: Run) -> Run:
    def run(values: object, recording: Recording) -> Array:
        out = sound(values, recording)  # type: ignore[arg-type]
        return np.where(np.abs(out - out[0]) > 0.3 * np.abs(_widest(sound)), np.nan, out)

    return run


def _widest(sound: Run) -> float:
    from sysid.testing import probe_recording

    out = sound(None, probe_recording())
    return float(np.nanmax(np.abs(out - out[0])))


def depends_on_time(sound: Run) -> Run:
    def run(values: object, recording: Recording) -> Array:
        out = sound(values, recording)  # type: ignore[arg-type]
        return out * (1.0 + 1e-3 * np.arange(len(out)) / len(out))[:, None] if values is not None else out

    return run


def keeps_memory(sound: Run) -> Run:
    """A dead-band with a lag behind it."""

    def run(values: object, recording: Recording) -> Array:
        out = sound(values, recording)  # type: ignore[arg-type]
        steps = np.diff(out, axis=0)
        steps[1:] = 0.9 * steps[1:] + 0.1 * steps[:-1]
        return np.vstack([out[:1], out[0] + np.cumsum(steps, axis=0)])

    return run


@pytest.mark.parametrize(
    ("effect", "spoil", "name"),
    [
        (LAG, looks_ahead, "causal"),
        (LAG, remembers, "deterministic"),
        (LAG, noisy, "deterministic"),
        (LAG, never_absent, "neutral"),
        (LAG, does_nothing, "acts"),
        (LAG, overflows, "finite"),
        (LAG, depends_on_time, "time_invariant"),
        (DEADBAND, keeps_memory, "memoryless"),
        (BY_NAME["valve_hysteresis"], keeps_memory, "rate_independent"),
        (BY_NAME["input_delay"], depends_on_time, "shift"),
    ],
    ids=lambda value: value.__name__ if callable(value) else "",
)
def test_broken_behaviour_is_found(effect: Effect, spoil: Callable[[Run], Run], name: str) -> None:
    run = spoil(plant_run(effect, places_of(effect)[0]))
    slew_only = replace(effect, actuations=("velocity",))
    found = failures_of(slew_only, run)
    assert name in {f.check for f in found}, [str(f) for f in found]
    assert any(re.search(r"\d", f.figures) for f in found if f.check == name)
    with pytest.raises(EffectError, match=f"effect {effect.name}: .*{name} at slew"):
        check_effect(slew_only, run)


def test_a_run_that_depends_on_the_one_before_is_found() -> None:
    """State that survives only a run of other data is caught by ``reset``, not by ``deterministic``."""
    sound = plant_run(LAG, places_of(LAG)[0])
    seen: list[int] = []

    def run(values: object, recording: Recording) -> Array:
        mark = hash(recording.values("slew.command").tobytes())
        seen.append(mark)
        return sound(values, recording) + (1e-3 if len(set(seen[-2:])) > 1 else 0.0)  # type: ignore[arg-type]

    assert "reset" in {f.check for f in failures_of(replace(LAG, actuations=("velocity",)), run)}


def test_an_effect_of_one_s_own_is_checked_through_its_function() -> None:
    """An effect that the compiled plant does not have: quadratic droop of the speed."""
    droop = Effect(
        name="droop",
        title="Speed droop",
        sentences=("The {target} loses {amount} of its speed at full command.",),
        part="valve",
        stage="command",
        target="axis",
        slots=(Slot("amount"),),
        forms=(Form((Parameter("amount", "1", (0.0, 0.5), (0.1,), 0.01, "speed lost at full command"),)),),
        equation="v = u·(1 − amount·|u|)",
        source="own measurement",
        excited_by="commands of many magnitudes",
        confused_with={"flow_saturation": "a bend from the beginning, or a corner"},
        need=Need("motion", 5, "Record {axis} at five openings."),
        actuations=("velocity",),
    )

    def run(values: object, recording: Recording) -> Array:
        amount = 0.0 if values is None else values["amount"]  # type: ignore[index]
        u = np.nan_to_num(recording.values("slew.command"))
        return np.concatenate([[0.0], np.cumsum(u * (1 - amount * np.abs(u)))[:-1]])[:, None]

    (slew, _) = places_of(droop)
    assert slew.target == "slew"
    found = [f for f in failures_of(droop, run) if f.place == str(slew)]
    assert found == []


def test_every_property_is_violated_by_a_test() -> None:
    """Every property in the list is violated by a test above."""
    broken = {"neutral", "acts", "causal", "deterministic", "reset", "finite", "time_invariant", "memoryless"}
    assert set(PROPERTIES) == broken | {"rate_independent", "shift"}
