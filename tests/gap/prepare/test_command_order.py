"""The order of command and sample: estimated from the motion in both orders, for every axis and rate, and never named."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy import signal

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import StoreError
from sysid.gap import GapResult, find_gap
from sysid.gap.prepare.clocks import with_order
from sysid.gap.prepare.noise import noise_levels
from sysid.gap.problem import split_of
from sysid.gap.statement import order_sentence
from sysid.machine import Convention, Machine, machine_from_files
from sysid.plant import free_run, nominal_plant, plant_from_files
from sysid.plant.machine_text import machine_difference
from sysid.plant.model import compile_plant

Array = npt.NDArray[np.float64]

ORDERS: tuple[Convention, ...] = ("read_before_written", "written_before_read")
#: Time constants of the servo and of the valve [s], damping ratio, full speed [rad/s], standard deviation of the sensor [rad].
SERVO, VALVE, DAMPING, GAIN, NOISE = 0.04, 0.06, 0.9, 0.5, 2e-4


def described(kind: str, rate: float, more: str = "") -> Machine:
    effect = f'name = "second_order_lag"\nparameters = {{ time_constant = {SERVO}, damping_ratio = {DAMPING} }}'
    if kind == "velocity":
        effect = f'name = "first_order_lag"\nparameters = {{ time_constant = {VALVE} }}'
    gain = f"gain = {GAIN}\n" if kind == "velocity" else ""
    text = f"""schema = 1
name = "m"
rate_hz = {rate}
{more}
[[axes]]
name = "a"
actuation = "{kind}"
drives = "joint"
joint_type = "revolute"
limits = [-20, 20]
{gain}
[[effects]]
target = "a"
{effect}

[noise]
"a.joint" = {NOISE}
"""
    return machine_from_files({"machine.toml": text}, "m")


def joint_of(kind: str, command: Array, step: float) -> Array:
    """Exact motion under a command held over each step, (n,) → (n + 1,)."""
    if kind == "position":
        matrix = np.array([[0.0, 1.0], [-1.0 / SERVO**2, -2.0 * DAMPING / SERVO]])
        drive, start = np.array([[0.0], [1.0 / SERVO**2]]), [command[0], 0.0]
    else:
        matrix, drive, start = np.array([[0.0, 1.0], [0.0, -1.0 / VALVE]]), np.array([[0.0], [GAIN / VALVE]]), [0.0, 0.0]
    a, b, *_ = signal.cont2discrete((matrix, drive, np.eye(2), np.zeros((2, 1))), step)
    states = [np.array(start)]
    for u in command:
        states.append(a @ states[-1] + b[:, 0] * u)
    return np.array(states)[:, 0]


def steps_and_waves(rng: np.random.Generator, time: Array, motion: str) -> Array:
    if motion == "steps":
        command = rng.uniform(-0.6, 0.6, 1 + int(time[-1] / 0.8))[(time / 0.8).astype(int)]
    else:
        command = sum(0.25 * np.sin(2.0 * np.pi * rng.uniform(0.1, 0.8) * time + rng.uniform(0.0, 6.0)) for _ in range(3))
    return np.where(time < 1.0, command[0], command)


def dataset_of(machine: Machine, order: Convention, motion: str, seconds: float = 20.0, delay: float = 0.0) -> Dataset:
    """Four recordings of a machine that does what its description says, but for a dead time of whole rows."""
    (axis,), rate, rows = machine.axes, machine.rate_hz, round(delay * machine.rate_hz)
    recordings = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        time = np.arange(round(seconds * rate)) / rate
        command = steps_and_waves(rng, time, motion)
        command[: round(rate)] *= axis.actuation == "position"
        acts = command[np.maximum(np.arange(len(command)) - rows, 0)]
        joint = joint_of(axis.actuation, acts, 1.0 / rate)
        seen = joint[:-1] if order == "read_before_written" else joint[1:]
        seen = seen + NOISE * rng.standard_normal(len(seen))
        recordings.append(Recording(f"r{seed}", pd.DataFrame({"time": time, "a.command": command, "a.joint": seen}), rate))
    roles = dict(zip((r.name for r in recordings), ("fit", "fit", "select", "held_out"), strict=True))
    return Dataset.of(machine, recordings, roles)  # type: ignore[arg-type]


def order_of(dataset: Dataset) -> Convention:
    order = with_order(nominal_plant(dataset.machine), dataset, split_of(dataset), noise_levels(dataset))[1]
    assert order is not None
    return order.convention


def names(result: GapResult) -> list[tuple[str, str]]:
    return [(effect.name, effect.target) for effect in result.effects]


@pytest.mark.parametrize("order", ORDERS)
@pytest.mark.parametrize("motion", ["steps", "waves"])
@pytest.mark.parametrize("kind", ["position", "velocity"])
@pytest.mark.parametrize("rate", [20.0, 50.0, 100.0, 250.0, 1000.0])
def test_both_orders_are_found(kind: str, motion: str, rate: float, order: Convention) -> None:
    assert order_of(dataset_of(described(kind, rate), order, motion, 10.0 if rate > 500.0 else 20.0)) == order


@pytest.mark.parametrize("order", [ORDERS[0], pytest.param(ORDERS[1], marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind", ["position", "velocity"])
@pytest.mark.parametrize("rate", [50.0, *(pytest.param(rate, marks=pytest.mark.slow) for rate in (20.0, 100.0, 250.0, 1000.0))])
@pytest.mark.parametrize("motion", ["steps", pytest.param("waves", marks=pytest.mark.slow)])
def test_no_order_is_a_gap(kind: str, motion: str, rate: float, order: Convention) -> None:
    dataset = dataset_of(described(kind, rate), order, motion, 10.0 if rate > 500.0 else 20.0)
    result = find_gap(dataset, nominal_plant(dataset.machine))
    assert (result.verdict, result.effects, result.written) == ("no_gap", (), ())
    assert result.order is not None
    assert (result.order.convention, result.order.source, result.order.open_s) == (order, "estimated", 1.0 / rate)


@pytest.mark.parametrize("kind", ["position", "velocity"])
@pytest.mark.parametrize("rate", [0.5, 1.0, 1.2])
def test_rows_further_apart_than_any_dead_time_do_not_show_the_order(kind: str, rate: float) -> None:
    dataset = dataset_of(described(kind, rate), "written_before_read", "waves", 60.0)
    assert order_of(dataset) == "read_before_written"


@pytest.mark.parametrize(("kind", "order"), [("position", ORDERS[0]), ("velocity", ORDERS[1])])
def test_a_stated_order_leaves_the_dead_time(kind: str, order: Convention) -> None:
    """A dead time of one row, which an estimate could not distinguish from the order, has a name and its value."""
    machine = described(kind, 50.0, f'convention = "{order}"')
    result = find_gap(dataset_of(machine, order, "steps", delay=0.02), nominal_plant(machine))
    assert names(result) == [("input_delay", "a")]
    low, high = result.effects[0].interval95["delay"]
    assert low <= 0.02 <= high
    assert high - low < 4e-3
    assert order_sentence(result.order) == ""


@pytest.mark.parametrize("kind", [pytest.param("position", marks=pytest.mark.slow), "velocity"])
def test_a_dead_time_of_several_rows_has_a_name_in_an_estimated_order(kind: str) -> None:
    machine = described(kind, 50.0)
    result = find_gap(dataset_of(machine, "read_before_written", "steps", delay=0.08), nominal_plant(machine))
    assert names(result) == [("input_delay", "a")]
    assert result.effects[0].parameters["delay"] == pytest.approx(0.08, abs=1e-3)
    assert "may be one row longer" in order_sentence(result.order)


@pytest.mark.parametrize("kind", ["position", "velocity"])
@pytest.mark.parametrize("order", ORDERS)
def test_a_stored_plant_keeps_the_order(kind: str, order: Convention) -> None:
    machine = described(kind, 50.0)
    plant = replace(nominal_plant(machine), machine=replace(machine, convention=order))
    again = plant_from_files(plant.to_files())
    assert again.machine.convention == order
    dataset = dataset_of(machine, order, "steps")
    run = free_run(compile_plant(again), dataset.recordings[0])["a.joint"].to_numpy()
    error = run - dataset.recordings[0].values("a.joint")
    assert float(np.std(error)) == pytest.approx(NOISE, rel=0.1)
    difference = machine_difference(nominal_plant(machine), plant)
    assert [line for line in difference.splitlines()[3:] if line[0] in "+-"] == [f'+convention = "{order}"']


def test_an_order_that_is_none_is_refused() -> None:
    plant = nominal_plant(described("position", 50.0))
    other = replace(plant, machine=replace(plant.machine, convention="sometimes"))  # type: ignore[arg-type]
    with pytest.raises(StoreError, match="convention"):
        plant_from_files(other.to_files())
