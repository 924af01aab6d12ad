"""The TorchScript module computes what the plant does, for a batch of machines with parameters of their own."""

from __future__ import annotations

import functools
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from test_drive_model import STICKING, TOGETHER, name_of, placed, probe_plant, shipped, true_value

from sysid.errors import SettingsError
from sysid.export.isaaclab import posterior_columns, reachable
from sysid.export.torchscript.graph import Graph
from sysid.export.torchscript.kernels import Kernels
from sysid.export.torchscript.model import load_script, parameter_columns, save_script, script_of
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import Plant, PlantNumber, Uncertainty, compile_plant, nominal_plant
from sysid.plant.stepper import LaneState, Stepper, held_commands, step_commands
from sysid.testing.probe import RATE_HZ, probe_recording

torch = pytest.importorskip("torch")
Array = npt.NDArray[np.float64]
JOINTS, DRIVE = np.array([0.1, 0.2, 0.0, 0.3]), np.array([0.1, 0.05, 0.0, 0.3])
HELD = np.array([0.4, -0.3, 0.0, 0.0])


def commands_of(plant: Plant) -> Array:
    return np.asarray(step_commands(plant.machine, held_commands(plant.machine, probe_recording())))


def by_plant(plant: Plant, commands: Array) -> list[LaneState]:
    stepper = Stepper(plant, RATE_HZ)
    first: LaneState = stepper.reset(JOINTS, drive=DRIVE, commands=HELD)
    return [first, *(stepper.step(command) for command in commands)]


def by_script(module: Any, theta: Any, commands: Array) -> list[dict[str, Any]]:
    """Signals of every sample; the same start and the same commands for all machines of the batch."""

    def rows(values: Array) -> Any:
        return torch.tensor(np.tile(values, (len(theta), 1)), dtype=theta.dtype)

    with torch.jit.optimized_execution(False), torch.inference_mode():
        state, signals = module.begin(theta, rows(JOINTS), rows(DRIVE), rows(HELD))
        found = [signals]
        for command in commands:
            state, signals = module(theta, state, rows(command))
            found.append(signals)
    return found


def assert_same(plant: Plant, signals: list[dict[str, Any]], lane: int, tolerance: float = 1e-9) -> None:
    states = by_plant(plant, commands_of(plant)[: len(signals) - 1])
    for name in ("drive", "joints", "structure", "ee", "tool"):
        expected = np.array([getattr(state, name)[0] for state in states])
        found = np.array([values[name][lane].numpy() for values in signals])
        np.testing.assert_allclose(found, expected, rtol=0.0, atol=tolerance, err_msg=name)
        assert np.ptp(expected, axis=0).max() > 1e-2, "the comparison is of motion"


def everything() -> Plant:
    plant = probe_plant()
    for item in placed():
        plant = plant.with_effect(KnownEffect(item.name, item.target, TOGETHER.get(item.name, item.parameters), item.side))
    return plant


@functools.cache
def of_everything() -> tuple[Plant, Any]:
    plant = everything()
    return plant, script_of(plant, RATE_HZ)


@pytest.mark.slow
@pytest.mark.parametrize("item", placed(), ids=name_of)
def test_equals_the_plant(item: KnownEffect) -> None:
    plant = probe_plant(item)
    module = script_of(plant, RATE_HZ)
    assert_same(plant, by_script(module, module.theta(1), commands_of(plant)), 0)


def test_equals_the_plant_with_everything_at_once(tmp_path: Path) -> None:
    """From its file, and with the readings of its sensors."""
    plant, made = of_everything()
    save_script(made, tmp_path / "drive_model.pt")
    module = load_script(tmp_path / "drive_model.pt")
    signals = by_script(module, module.theta(1), commands_of(plant))
    assert_same(plant, signals, 0)
    state, compiled = by_plant(plant, commands_of(plant))[-1], compile_plant(plant)
    readings = module.readings(module.theta(1), signals[-1])
    assert set(readings) == set(shipped(plant, tmp_path).readings(_only_lane(state)))
    for signal, value in readings.items():
        true = np.array([[true_value(plant, state, signal)]])
        assert float(value) == pytest.approx(compiled.sensed(compiled.theta[None], signal, true, 1.0 / RATE_HZ)[0, 0], abs=1e-9)


class _only_lane:  # noqa: N801
    def __init__(self, state: LaneState) -> None:
        for name in ("drive", "joints", "structure", "ee", "tool"):
            setattr(self, name, getattr(state, name)[0])


@pytest.mark.parametrize("lag", ["first_order_lag", "second_order_lag"])
def test_a_ramp_of_a_servo_before_its_dead_time_and_lag(lag: str) -> None:
    slow = {"time_constant": 0.04} | ({"damping_ratio": 0.5} if lag == "second_order_lag" else {})
    values: dict[str, Any] = {"command_rate_limit": {"rate": 0.5}, "input_delay": {"delay": 0.034}, lag: slow}
    plant = probe_plant(*(KnownEffect(name, "wrist", each) for name, each in values.items()))
    module = script_of(plant, RATE_HZ)
    assert_same(plant, by_script(module, module.theta(1), commands_of(plant)), 0)


def test_a_cylinder_without_a_linkage_is_its_own_joint() -> None:
    """As in the drive model; the plant has no joint there."""
    text = """schema = 1
name = "valve"
rate_hz = 50.0
[[axes]]
name = "boom"
actuation = "velocity"
drives = "cylinder"
gain = 0.02
stroke = [0.0, 0.1]
"""
    plant = nominal_plant(machine_from_files({"machine.toml": text}, "test"))
    module = script_of(plant, 50.0)
    theta, at = module.theta(1), torch.tensor([[0.05]], dtype=torch.float64)
    with torch.jit.optimized_execution(False), torch.inference_mode():
        state, _ = module.begin(theta, at, at, 0.0 * at)
        for _ in range(50):
            state, signals = module(theta, state, at / at)
    assert float(signals["drive"]) == pytest.approx(0.07)
    assert float(signals["structure"]) == float(signals["joints"]) == float(signals["drive"])


@pytest.mark.parametrize("beside", STICKING, ids=len)
def test_a_spool_that_sticks_at_its_centre(beside: tuple[KnownEffect, ...]) -> None:
    plant = probe_plant(*beside)
    module = script_of(plant, RATE_HZ)
    assert_same(plant, by_script(module, module.theta(1), commands_of(plant)), 0)


def test_each_machine_has_its_own_parameters() -> None:
    """Rows of the parameters, a longer dead time among them, move as the plants with these values do."""
    delays, widths = (0.03, 0.055), (0.01, 0.02)
    plants = [
        probe_plant(KnownEffect("input_delay", "slew", {"delay": d}), KnownEffect("backlash", "boom", {"width": w}, "drive"))
        for d, w in zip(delays, widths, strict=True)
    ]
    module = script_of(plants[0], RATE_HZ, np.array([plant.vector() for plant in plants]))
    names = list(parameter_columns(plants[0]))
    assert module.parameter_names[: len(names)] == names == ["input_delay.slew.delay", "backlash.boom.drive.width"]
    theta = module.theta(2)
    theta[1, 0], theta[1, 1] = delays[1], widths[1]
    signals = by_script(module, theta, commands_of(plants[0]))
    for lane, plant in enumerate(plants):
        assert_same(plant, signals, lane)


def test_single_precision() -> None:
    """An increment of a step is rounded to 2⁻²⁴ of the position: 600 of them stay within 600·6e-8 of a metre or radian."""
    plant = probe_plant(KnownEffect("first_order_lag", "boom", {"time_constant": 0.08}))
    module = script_of(plant, RATE_HZ).to(torch.float32)
    assert_same(plant, by_script(module, module.theta(1), commands_of(plant)), 0, 600 * 6e-8)


def test_every_tensor_is_on_the_device_of_the_parameters() -> None:
    """On a device without storage: an operation that mixes devices raises."""
    module = script_of(everything(), RATE_HZ).to("meta")
    theta, rows = module.theta(3), torch.empty(3, 4, dtype=torch.float64, device="meta")
    with torch.jit.optimized_execution(False), torch.inference_mode():
        state, _ = module.begin(theta, rows, module.drives(theta, rows), rows)
        state, signals = module(theta, state, rows)
        readings = module.readings(theta, signals)
    assert {str(values.device) for values in (state, *signals.values(), *readings.values())} == {"meta"}


def test_the_ring_of_a_delay_contains_its_draws() -> None:
    places = PlantNumber("input_delay", "slew", None, "delay"), PlantNumber("viscous_friction", "slide", None, "coefficient")
    plant = probe_plant(
        KnownEffect("input_delay", "slew", {"delay": 0.03}), KnownEffect("viscous_friction", "slide", {"coefficient": 20.0})
    ).with_uncertainty(Uncertainty(places, np.diag([0.005**2, 1.0])))
    columns = parameter_columns(plant)
    assert reachable(plant)[1, columns["input_delay.slew.delay"]] == pytest.approx(0.06)
    assert plant.sample(1000, 1)[:, columns["input_delay.slew.delay"]].max() < 0.06
    assert posterior_columns(plant, columns) == {
        "input_delay.slew.delay": [0],
        "viscous_friction.slide.coefficient": [1, 2],
    }, "one coefficient for both directions"


#: The number of sub-steps is that of the plant: their parameters are not drawn.
WITH_SUBSTEPS = ("gripper_sway.tool.length", "flexible_drive.slide.frequency", "flexible_drive.slide.inertia_ratio")


@functools.cache
def drawn_module() -> tuple[Plant, Any]:
    plant = everything()
    return plant, script_of(plant, RATE_HZ, 1.1 * plant.vector()[None])


@settings(max_examples=examples(80), deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_equals_the_kernels_for_drawn_parameters_and_commands(seed: int) -> None:
    """A few steps of all effects at once, three machines of a batch, to rounding."""
    (plant, module), rng = drawn_module(), np.random.default_rng(seed)
    columns, thetas = parameter_columns(plant), np.tile(plant.vector(), (3, 1))
    for name, at in columns.items():
        thetas[:, at] *= 1.0 if name in WITH_SUBSTEPS else rng.uniform(0.9, 1.1, 3)
    theta = torch.tensor(np.column_stack([thetas[:, list(columns.values())], np.zeros(3)]))
    joints, drives = JOINTS + rng.uniform(-0.1, 0.1, (3, 4)), DRIVE + rng.uniform(-0.03, 0.03, (3, 4))
    held, commands = rng.uniform(-1.0, 1.0, (3, 4)), rng.uniform(-1.0, 1.0, (6, 3, 4))
    stepper = Stepper(plant, RATE_HZ, 3, thetas)
    expected = [stepper.reset(joints, drive=drives, commands=held), *(stepper.step(command) for command in commands)]
    with torch.jit.optimized_execution(False), torch.inference_mode():
        state, signals = module.begin(theta, *map(torch.tensor, (joints, drives, held)))
        found = [signals]
        for command in commands:
            state, signals = module(theta, state, torch.tensor(command))
            found.append(signals)
    for ours, theirs in zip(found, expected, strict=True):
        for name in ("drive", "joints", "structure", "ee", "tool"):
            np.testing.assert_allclose(ours[name].numpy(), getattr(theirs, name), rtol=0.0, atol=1e-12, err_msg=name)


def test_derivatives_by_the_parameters() -> None:
    """Finite for every effect, and those of smooth ones as differences of runs give them."""
    plant, module = of_everything()
    commands = commands_of(plant)[:25]

    def output(theta: Any) -> Any:
        state, _ = module.begin(theta, *(torch.tensor(values)[None] for values in (JOINTS, DRIVE, HELD)))
        for command in commands:
            state, signals = module(theta, state, torch.tensor(command)[None])
        return signals["structure"].sum() + signals["tool"].sum() + sum(module.readings(theta, signals).values()).sum()

    theta, names = module.theta(1).requires_grad_(True), list(module.parameter_names)
    with torch.jit.optimized_execution(False):
        output(theta).backward()
        assert torch.isfinite(theta.grad).all()
        for name in (
            "first_order_lag.boom.time_constant", "oil_compressibility.boom.frequency", "second_order_lag.wrist.time_constant",
            "viscous_friction.slide.positive", "joint_compliance.boom.drive.compliance", "base_misalignment.base.rotation_z",
        ):  # fmt: skip
            moved = torch.zeros_like(theta)
            moved[0, names.index(name)] = size = 1e-6 * float(theta[0, names.index(name)].detach())
            with torch.no_grad():
                slope = float(output(theta + moved) - output(theta - moved)) / (2.0 * size)
            assert float(theta.grad[0, names.index(name)]) == pytest.approx(slope, rel=1e-4, abs=1e-6), name


def test_only_numbers_are_in_the_code() -> None:
    """Names of axes, signals and machines are values of the module."""
    _, module = of_everything()
    names = (*everything().machine.axis_names, "probe")
    assert not any(name in module.functions.step.code for name in names)


def halved(u: Any) -> Any:
    while u > 1.0:
        u = 0.5 * u
    return u


def counted(u: Any) -> Any:
    return math.ceil(u)


def turned(u: Any) -> Any:
    return math.atan(u)


def wrapped(u: Any) -> Any:
    return u % 2.0


@pytest.mark.parametrize("kernel", [halved, counted, turned, wrapped])
def test_what_a_batch_cannot_compute_is_refused(kernel: Any) -> None:
    graph = Graph()
    with pytest.raises(SettingsError) as refused:
        Kernels(graph, {})(kernel, graph.input("commands", 0))
    assert kernel.__name__ in refused.value.where
    assert refused.value.remedy
