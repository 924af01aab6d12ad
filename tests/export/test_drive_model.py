"""The shipped drive model computes what the plant does, for every effect in every place."""

from __future__ import annotations

import ast
import builtins
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from sysid.effects import CATALOGUE, gripper_sway
from sysid.export.drive_data import WITHOUT_PART, drive_data
from sysid.export.drive_module import DATA, MODULE, module_text
from sysid.export.kernel_source import kernel_source
from sysid.files import json_text
from sysid.machine import KnownEffect
from sysid.plant import Plant, chain, compile_plant, nominal_plant, pose, sensing
from sysid.plant.stepper import LaneState, Stepper, held_commands, step_commands
from sysid.testing import places_of
from sysid.testing.check import typical_values
from sysid.testing.probe import RATE_HZ, probe_machine, probe_recording, probe_servo

Array = npt.NDArray[np.float64]


#: A pendulum of the smaller start values is thrown over its pivot by these commands, and then any rounding grows.
VALUES: dict[str, dict[str, float | list[float]]] = {"gripper_sway": {"length": 1.0, "damping_ratio": 0.02}}


def placed() -> list[KnownEffect]:
    """Every effect that the model has, with typical values in each of its forms, at each of its places."""
    found = []
    for effect in CATALOGUE:
        if effect.name not in WITHOUT_PART:
            for form in effect.forms:
                values = VALUES.get(effect.name, typical_values(effect, form))
                places = [p for p in places_of(effect) if p.target not in probe_servo().axis_names]
                found += [KnownEffect(effect.name, p.target, values, p.side) for p in places]  # type: ignore[arg-type]
    return found


def name_of(item: KnownEffect) -> str:
    return "-".join(filter(None, (item.name, item.target, item.side, *item.parameters)))


def first_fast() -> list[Any]:
    """:func:`placed`, of which each form of an effect is in the fast tier at one place."""
    found, known = list[Any](), set[tuple[str, ...]]()
    for item in placed():
        form = (item.name, *item.parameters)
        found.append(pytest.param(item, id=name_of(item), marks=() if form not in known else pytest.mark.slow))
        known.add(form)
    return found


def probe_plant(*effects: KnownEffect) -> Plant:
    plant = nominal_plant(probe_machine())
    for effect in effects:
        plant = plant.with_effect(effect)
    return plant


def shipped(plant: Plant, folder: Path) -> Any:
    """The model of the two written files, executed as a file of its own."""
    data = drive_data(plant, RATE_HZ)
    (folder / DATA).write_text(json_text(data), "utf-8")
    module = ModuleType("drive_model")
    module.__file__ = str(folder / MODULE)
    sys.modules["drive_model"] = module  # where dataclasses look their annotations up
    exec(compile(module_text(data), MODULE, "exec"), module.__dict__)
    return module.load(folder / DATA)


def assert_same(plant: Plant, model: Any) -> None:
    stepper, source = Stepper(plant, RATE_HZ), probe_recording()
    commands = step_commands(plant.machine, held_commands(plant.machine, source))
    joints, drive = np.array([0.1, 0.2, 0.0, 0.3]), np.array([0.1, 0.05, 0.0, 0.3])
    held = np.array([0.4, -0.3, 0.0, 0.0])
    ours: list[LaneState] = [stepper.reset(joints, drive=drive, commands=held)]
    theirs = [model.reset(joints, drive, held)]
    for command in commands:
        ours.append(stepper.step(command))
        theirs.append(model.step(command))
    for name in ("drive", "joints", "structure", "ee", "tool"):
        expected = np.array([getattr(state, name)[0] for state in ours])
        found = np.array([getattr(state, name) for state in theirs])
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-9, err_msg=name)
        assert np.ptp(expected, axis=0).max() > 1e-2, "the comparison is of motion"
    compiled = compile_plant(plant)
    for signal, value in model.readings(theirs[-1]).items():
        true = true_value(plant, ours[-1], signal)
        expected = compiled.sensed(compiled.theta[None], signal, np.array([[true]]), 1.0 / RATE_HZ)[0, 0]
        assert value == pytest.approx(expected, abs=1e-9), signal


def true_value(plant: Plant, state: LaneState, signal: str) -> float:
    owner, kind = signal.split(".")
    if owner in ("ee", "tool"):
        return float(getattr(state, owner)[0, "xyz".index(kind)])
    i = plant.machine.axis_names.index(owner)
    return float((state.joints if kind == "joint" else state.drive)[0, i])


@pytest.mark.parametrize("item", first_fast())
def test_equals_the_plant(item: KnownEffect, tmp_path: Path) -> None:
    plant = probe_plant(item)
    assert_same(plant, shipped(plant, tmp_path))


@pytest.mark.parametrize("lag", ["first_order_lag", "second_order_lag"])
@pytest.mark.parametrize("rate", [0.5, 60.0])
def test_a_ramp_of_a_servo_before_its_dead_time_and_lag(lag: str, rate: float, tmp_path: Path) -> None:
    slow = {"time_constant": 0.04} | ({"damping_ratio": 0.5} if lag == "second_order_lag" else {})
    values: dict[str, Any] = {"command_rate_limit": {"rate": rate}, "input_delay": {"delay": 0.034}, lag: slow}
    plant = probe_plant(*(KnownEffect(name, "wrist", each) for name, each in values.items()))
    assert_same(plant, shipped(plant, tmp_path))


SPOOL = KnownEffect("stiction", "boom", {"spool_breakaway": 0.12, "spool_release": 0.01})
#: Alone, and with all that acts on the spool.
STICKING: tuple[tuple[KnownEffect, ...], ...] = (
    (SPOOL,),
    (
        SPOOL,
        KnownEffect("valve_deadband", "boom", {"positive": 0.15, "negative": 0.06}),
        KnownEffect("gain_curve", "boom", {"exponent": 1.2}),
        KnownEffect("flow_saturation", "boom", {"limit": 0.5}),
        KnownEffect("input_delay", "boom", {"delay": 0.034}),
        KnownEffect("command_rate_limit", "boom", {"rate": 4.0}),
        KnownEffect("first_order_lag", "boom", {"time_constant": 0.04}),
    ),
)


@pytest.mark.parametrize("beside", STICKING, ids=len)
def test_a_spool_that_sticks_at_its_centre(beside: tuple[KnownEffect, ...], tmp_path: Path) -> None:
    plant = probe_plant(*beside)
    assert_same(plant, shipped(plant, tmp_path))


#: Every effect that the model has at once, small enough that all of them act.
TOGETHER = {
    "gain_curve": {"exponent": 1.2},
    "flow_saturation": {"limit": 0.8},
    "pump_flow_limit": {"limit": 0.9},
    "load_dependent_flow": {"coefficient": 0.02},
    "sensor_quantisation": {"step": 0.001},
}


def test_equals_the_plant_with_everything_at_once(tmp_path: Path) -> None:
    plant = probe_plant()
    for item in placed():
        values = TOGETHER.get(item.name, item.parameters)
        plant = plant.with_effect(KnownEffect(item.name, item.target, values, item.side))
    model = shipped(plant, tmp_path)
    assert {effect.name for effect in plant.effects} == {effect.name for effect in CATALOGUE} - set(WITHOUT_PART)
    assert_same(plant, model)


def test_contains_only_the_effects_of_the_plant() -> None:
    plant = probe_plant(KnownEffect("valve_deadband", "boom", {"positive": 0.1, "negative": 0.1}))
    text = module_text(drive_data(plant, RATE_HZ))
    assert "class ValveDeadband" in text
    assert "class ValveHysteresis" not in text
    assert "GripperSway" not in text.replace("GripperSway(dt", "").replace("sway: GripperSway", "")


def test_runs_without_the_toolkit(tmp_path: Path) -> None:
    """In an interpreter that finds NumPy alone."""
    data = drive_data(probe_plant(KnownEffect("gripper_sway", "tool", {"length": 0.2, "damping_ratio": 0.1})), RATE_HZ)
    (tmp_path / DATA).write_text(json_text(data), "utf-8")
    (tmp_path / MODULE).write_text(module_text(data), "utf-8")
    code = (
        "import sys; import drive_model; m = drive_model.load(); m.reset([0.1, 0.2, 0.0, 0.3]); "
        "print(m.readings(m.step([1.0, 1.0, 1.0, 0.3]))['tool.z'], [n for n in sys.modules if n.startswith('sysid')])"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True, env={})
    assert done.stdout.strip().endswith("[]")
    assert np.isfinite(float(done.stdout.split()[0]))


def test_every_effect_is_in_the_model_or_has_a_reason() -> None:
    assert set(WITHOUT_PART) <= {effect.name for effect in CATALOGUE}


def test_source_of_the_kernels_needs_math_alone() -> None:
    """Every name is one of the text, of ``math`` or built in; what they call comes before its callers."""
    kernels = (chain.command_stage, chain.position_stage, chain.force_stage, pose.pose, gripper_sway.step, sensing.reading)
    text = kernel_source(kernels)
    known = {"math", *vars(builtins)}
    for definition in ast.parse(text).body:
        assert isinstance(definition, ast.FunctionDef)
        assert not definition.decorator_list
        nodes = list(ast.walk(definition))
        own = {node.arg for node in nodes if isinstance(node, ast.arg)}
        own |= {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
        assert {node.id for node in nodes if isinstance(node, ast.Name)} <= known | own, definition.name
        known.add(definition.name)
