"""A simulator of one's own, as in the guide: missing input and output effects are named, and nothing else is."""

from __future__ import annotations

import functools
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from plant_data import ROLES, arm, dataset_of, nominal, slide, steered

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import ExcitationError, InputError, SettingsError
from sysid.gap import Simulator, SimulatorAdapter, find_gap, starting_value, steps
from sysid.gap.adapters.adapter import adapt_simulator
from sysid.gap.adapters.simulator import RunCache
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import compile_plant, free_run

Array = npt.NDArray[np.float64]

PAGE = Path(__file__).parents[3] / "docs" / "guide" / "own-simulator.md"
NOISE = 2e-4
LIFT = f"""
schema = 1
name = "lift"
rate_hz = 50.0
[noise]
"lift.joint" = {NOISE}
[[axes]]
name = "lift"
actuation = "velocity"
drives = "joint"
gain = 0.3
limits = [-3.0, 3.0]
"""


@functools.cache
def page() -> tuple[str, ...]:
    return tuple(re.findall(r"```python\n(.*?)```", PAGE.read_text("utf-8"), flags=re.DOTALL))


@functools.cache
def lift() -> Any:
    """The class of the guide's first block."""
    names: dict[str, Any] = {}
    exec(compile(page()[0], str(PAGE), "exec"), names)
    return names["Lift"]


def dead_band(u: Array) -> Array:
    return np.where(u > 0.1, u - 0.1, np.where(u < -0.07, u + 0.07, 0.0))


def late(u: Array) -> Array:
    return np.concatenate([np.full(6, u[0]), u[:-6]])


def play(x: Array, width: float = 0.02) -> Array:
    y, out = x[0], np.empty(len(x))
    for k, value in enumerate(x):
        y = min(max(y, value - 0.5 * width), value + 0.5 * width)
        out[k] = y
    return out


def identity(x: Array) -> Array:
    return x


def lift_data(at_input: Any = identity, at_output: Any = identity, seconds: float = 30.0) -> Dataset:
    """Recordings of a machine that is the guide's simulator, with an effect at its input or output."""
    recordings, count = [], round(seconds * 50.0)
    for k in range(len(ROLES)):
        rng = np.random.default_rng([7, k])
        command = steered(count, 50.0, 0.3, 0.8, rng)
        angle = at_output(lift()().angle(at_input(command)[None], 0.1, 50.0)[0])
        columns = {
            "time": np.arange(count) / 50.0,
            "lift.command": command,
            "lift.joint": angle + rng.normal(0.0, NOISE, count),
        }
        recordings.append(Recording(f"run-{k + 1}", pd.DataFrame(columns), 50.0))
    splits = {r.name: role for r, role in zip(recordings, ROLES, strict=True)}
    return Dataset.of(machine_from_files({"machine.toml": LIFT}, "lift"), recordings, splits)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("dataset", "name", "parameters"),
    [
        (lambda: lift_data(at_input=late), "input_delay", {"delay": 0.12}),
        (lambda: lift_data(at_output=play), "backlash", {"width": 0.02}),
    ],
)
def test_hidden_effect_is_named(dataset: Any, name: str, parameters: dict[str, float]) -> None:
    result = find_gap(dataset(), lift()())
    (effect,) = result.effects
    assert (result.verdict, effect.name, effect.target) == ("named", name, "lift")
    assert dict(effect.parameters) == pytest.approx(parameters, rel=0.01)
    assert result.gap.after["lift.joint"] < 1.5 * NOISE < 10.0 * NOISE < result.gap.before["lift.joint"]
    assert result.plant_before == "lift model"
    assert any("lift model is not changed" in note for note in result.notes)


def test_nothing_hidden_is_named_nothing_at_the_cost_of_a_few_runs() -> None:
    result = find_gap(lift_data(), lift()())
    assert (result.verdict, result.effects, result.unnamed) == ("no_gap", (), ())
    (cost,) = [note for note in result.notes if "was called" in note]
    assert int(re.findall(r"for (\d+) runs", cost)[0]) < 40


def test_page_step_by_step(capsys: pytest.CaptureFixture[str]) -> None:
    dataset = lift_data(at_input=dead_band, seconds=15.0)
    names: dict[str, Any] = {"dataset": dataset}
    for block in page():
        exec(compile(block, str(PAGE), "exec"), names)
    printed = capsys.readouterr().out
    assert "named [('valve_deadband', 'lift'" in printed
    assert "command lift.joint" in printed
    (named,) = names["result"].effects
    assert dict(named.parameters) == pytest.approx({"positive": 0.1, "negative": 0.07}, rel=0.01)
    assert names["proof"].outcome.named[0].parameters == named.parameters
    assert names["requests"] == names["result"].next_experiment
    proposed = {item.label for item in names["proposals"]}
    assert {"valve_deadband(lift)", "backlash(lift, drive)", "oil_compressibility(lift)"} <= proposed
    assert not [label for label in proposed if "pump" in label or "load" in label]
    repaired, unseen = names["repaired"], dataset.recording("run-4")
    assert isinstance(repaired, SimulatorAdapter)
    assert isinstance(repaired, Simulator)
    assert [effect.name for effect in repaired.effects] == ["valve_deadband"]
    error = repaired.simulate(unseen)["lift.joint"].to_numpy() - unseen.values("lift.joint")
    assert np.sqrt(np.mean(error**2)) < 1.5 * NOISE
    again = find_gap(dataset, repaired)
    assert again.verdict == "no_gap"


class Bent:
    """Speed that depends on the angle as no effect of the toolkit does."""

    def simulate_many(self, recording: Recording, commands: dict[str, Array]) -> dict[str, Array]:
        u = commands["lift.command"]
        angle, out = np.full(len(u), starting_value(recording, "lift.joint")), np.empty(u.shape)
        for k in range(u.shape[1]):
            out[:, k] = angle
            angle = angle + 0.006 * u[:, k] * (1.0 + 0.5 * np.sin(4.0 * angle))
        return {"lift.joint": out}

    def simulate(self, recording: Recording) -> pd.DataFrame:
        many = self.simulate_many(recording, {"lift.command": recording.values("lift.command")[None]})
        return pd.DataFrame({signal: values[0] for signal, values in many.items()})


def bent_data(gain: float) -> Dataset:
    """Recordings of a machine that is the bent simulator, with another gain."""
    base = lift_data(seconds=10.0)
    made = []
    for k, recording in enumerate(base.recordings):
        table = recording.table.assign(**{"lift.command": gain * recording.values("lift.command")})
        angle = Bent().simulate(replace(recording, table=table))["lift.joint"]
        noise = np.random.default_rng(k).normal(0.0, NOISE, len(angle))
        made.append(replace(recording, table=recording.table.assign(**{"lift.joint": angle + noise})))
    return replace(base, recordings=tuple(made))


def test_only_an_accurate_surrogate_is_searched() -> None:
    for simulator, accurate in ((lift()(), True), (Bent(), False)):
        dataset = lift_data(seconds=10.0)
        adapter = adapt_simulator(simulator, dataset)
        (problem,) = adapter.problems(dataset)
        assert (adapter.search_problem(problem) is not problem) == accurate


@pytest.mark.slow
def test_without_a_surrogate_the_simulator_itself_is_searched() -> None:
    result = find_gap(bent_data(0.8), Bent(), forms="simple")
    assert [(e.name, round(float(e.parameters["ratio"]), 2)) for e in result.effects] == [("gain_error", 0.8)]  # type: ignore[arg-type]
    assert not any("surrogate" in note for note in result.notes)


class Opaque:
    """A plant of which nothing but its signals is known."""

    name = "crane model"

    def __init__(self, *inside: KnownEffect) -> None:
        self.model = compile_plant(nominal(*inside))

    def simulate(self, recording: Recording) -> pd.DataFrame:
        return free_run(self.model, recording)


INSIDE = (
    KnownEffect("first_order_lag", "wrist", {"time_constant": 0.15}),  # a servo that jumps throws the tool
    KnownEffect("first_order_lag", "boom", {"time_constant": 0.06}),
    KnownEffect("gain_curve", "slew", {"exponent": 1.2}),
    KnownEffect("gripper_sway", "tool", {"length": 0.25, "damping_ratio": 0.05}),
)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("hidden", "parameter"),
    [
        (KnownEffect("valve_deadband", "boom", {"positive": 0.08, "negative": 0.05}), "positive"),
        (KnownEffect("backlash", "boom", {"width": 0.012}, "drive"), "width"),
        (KnownEffect("joint_offset", "boom", {"offset": 0.01}), "offset"),
        (None, ""),
    ],
    ids=["input effect", "after a cylinder", "after the joints", "nothing"],
)
def test_crane_with_linkage_kinematics_and_a_swinging_tool(hidden: KnownEffect | None, parameter: str) -> None:
    truth = nominal(*INSIDE, *([hidden] if hidden else []))
    result = find_gap(dataset_of(truth, 20.0, seed=3), Opaque(*INSIDE))
    assert result.unnamed == ()
    assert [(e.name, e.target) for e in result.effects] == ([(hidden.name, hidden.target)] if hidden else [])
    assert any("gripper_sway on tool is already modelled by crane model: length = 0.25" in note for note in result.notes)
    for signal, after in result.gap.after.items():
        assert after < 1.6 * result.gap.noise_floor[signal], signal
    if hidden:
        found = float(result.effects[0].parameters[parameter])  # type: ignore[arg-type]
        assert found == pytest.approx(hidden.parameters[parameter], rel=0.03)


def test_a_gap_in_the_commands_restarts_the_simulator() -> None:
    dataset = lift_data(seconds=10.0)
    table = dataset.recordings[0].table.copy()
    table.loc[200:249, "lift.command"] = np.nan
    recording = replace(dataset.recordings[0], table=table)
    adapter = adapt_simulator(lift()(), dataset)
    angle = adapter.simulate(recording)["lift.joint"].to_numpy()
    # A command is held for a tenth of a second; the second stretch starts from what is measured there.
    assert np.flatnonzero(np.isnan(angle)).tolist() == list(range(205, 250))
    assert abs(np.median((angle - recording.values("lift.joint"))[250:260])) < 1e-12


def test_runs_are_computed_once() -> None:
    dataset = lift_data(seconds=5.0)
    recording = dataset.recordings[0]
    runs, command = RunCache(lift()(), dataset.machine), recording.values("lift.command")
    lanes = {"lift.command": np.array([command, 0.5 * command, command])}
    stretch = np.array([[0, len(recording)]])
    first = runs.of(recording, lanes, stretch)
    assert (runs.calls, runs.computed, runs.cached) == (1, 2, 1)
    again = runs.of(recording, {"lift.command": lanes["lift.command"][:1]}, stretch)
    assert (runs.calls, runs.computed, runs.cached) == (1, 2, 2)
    assert again[0] is first[0] is first[2]
    assert "was called 1 times for 2 runs" in runs.cost()


class Said:
    """A simulator that returns what it is told to."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer

    def simulate(self, recording: Recording) -> pd.DataFrame:
        said: pd.DataFrame | None = self.answer(len(recording))
        assert said is not None, "not licensed"
        return said


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda n: np.zeros(n), "returned ndarray; expected a pandas DataFrame"),
        (
            lambda n: pd.DataFrame({"lift.jiont": np.zeros(n)}),
            "'lift.jiont'; expected 'lift.joint'? (valid: ee.x, ee.y",
        ),
        (lambda n: pd.DataFrame({"lift.joint": np.zeros(n - 1)}), "lift.joint has the shape (249,); expected (250,)"),
        (lambda n: pd.DataFrame({"lift.joint": np.full(n, np.inf)}), "lift.joint is infinite"),
        (lambda n: pd.DataFrame({"time": np.zeros(n)}), "returned no signal; expected some of lift.cylinder, lift.joint"),
        (lambda n: None, "AssertionError: not licensed"),
    ],
)
def test_answers_that_are_none(answer: Any, message: str) -> None:
    with pytest.raises(InputError, match="simulator Said, recording run-1") as error:
        find_gap(lift_data(seconds=5.0), Said(answer))
    assert message in str(error.value)


def test_a_random_simulator_is_refused() -> None:
    rng = np.random.default_rng(0)
    with pytest.raises(InputError, match=r"lift.joint: two runs of the same commands differ.*Fix its random seed"):
        find_gap(lift_data(seconds=5.0), Said(lambda n: pd.DataFrame({"lift.joint": rng.normal(size=n)})))


def test_what_a_simulator_does_not_return_is_not_searched() -> None:
    with pytest.raises(ExcitationError, match="no stage is measured at both its ends"):
        find_gap(lift_data(seconds=5.0), Said(lambda n: pd.DataFrame({"lift.cylinder": np.zeros(n)})))


def test_effects_inside_and_registries_are_refused() -> None:
    dataset = dataset_of(nominal(machine=slide()), 2.0)
    adapter = adapt_simulator(Said(lambda n: pd.DataFrame({"slide.joint": np.zeros(n)})), dataset)
    with pytest.raises(SettingsError, match="simulator Said: coulomb_friction acts inside; expected an input or output effect"):
        adapter.with_effects([KnownEffect("coulomb_friction", "slide", {"force": 1.0})])
    assert any("slide is moved by force: " in note and "coulomb_friction" in note for note in adapter.notes([]))
    dataset = dataset_of(nominal(), 5.0)
    with pytest.raises(SettingsError, match="simulator crane model: cannot be stored"):
        find_gap(dataset, Opaque(), add=True)
    with pytest.raises(SettingsError, match="stages that were not searched"):
        steps.prove(steps.open_study(dataset, Opaque()))


def test_input_and_output_effects_act_as_in_the_plant() -> None:
    """An effect at the input or output of a simulator acts as in a plant whose other parts equal the simulator."""
    added = (
        KnownEffect("valve_deadband", "slew", {"positive": 0.1, "negative": 0.05}),
        KnownEffect("backlash", "slew", {"width": 0.01}, "drive"),
        KnownEffect("pump_flow_limit", "machine", {"limit": 0.8}),
        KnownEffect("input_delay", "wrist", {"delay": 0.08}),
        KnownEffect("backlash", "boom", {"width": 0.01}, "drive"),
        KnownEffect("base_misalignment", "base", {"translation": [0.01, 0.0, 0.0], "rotation": [0.0, 0.0, 0.02]}),
    )
    truth = nominal(*added)
    dataset = dataset_of(truth, 10.0)
    own = adapt_simulator(Opaque(), dataset, added)
    recording = dataset.recordings[-1]
    adapted, plant = own.simulate(recording), free_run(truth, recording)
    noise = arm().noise
    for signal in plant.columns:
        if signal != "time":
            apart = np.abs(adapted[signal].to_numpy() - plant[signal].to_numpy()).max()
            assert apart < 3.0 * noise[str(signal)], signal


def test_a_measured_speed_is_compared_with_that_of_the_simulator() -> None:
    """Its own speed where it returns one, else the rate of the joint that it returns."""

    class Rotates:
        def simulate(self, recording: Recording) -> pd.DataFrame:
            angle = 0.3 * np.cumsum(recording.values("lift.command")) / recording.rate_hz
            return pd.DataFrame({"lift.joint": angle})

    class StatesItsSpeed(Rotates):
        def simulate(self, recording: Recording) -> pd.DataFrame:
            return super().simulate(recording).assign(**{"lift.speed": 0.123})

    dataset = lift_data()
    recordings = tuple(replace(r, table=r.table.assign(**{"lift.speed": 0.0})) for r in dataset.recordings)
    dataset = replace(dataset, recordings=recordings)
    run = adapt_simulator(Rotates(), dataset).simulate(recordings[0])
    angle = run["lift.joint"].to_numpy()
    np.testing.assert_allclose(run["lift.speed"][1:-1], (angle[2:] - angle[:-2]) * 25.0, atol=1e-12)
    assert np.ptp(run["lift.speed"]) > 0.1
    assert (adapt_simulator(StatesItsSpeed(), dataset).simulate(recordings[0])["lift.speed"] == 0.123).all()
