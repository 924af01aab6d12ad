"""Adapter for a user's simulator: input effects act on its commands, output effects on the signals that it returns.

The simulator is a black box. The command stage of an axis therefore runs through the simulator itself, one whole recording at
a time. The later stages are those of the plant, driven by measured signals, plus the discrepancy of the simulator from them:
``predicted(θ, measured) = stage(θ, measured) + [simulated output − stage(θ₀, simulated input)]``. The linkages of the simulator
are identified from its cylinder and joint signals, its tool sway from its tip and tool signals; its kinematics are compared
with those of the URDF.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Dataset, Recording
from sysid.effects import CATALOGUE
from sysid.errors import SettingsError
from sysid.gap.adapters.identification import Surrogate, fit_surrogate, identify_linkages, identify_sway
from sysid.gap.adapters.input_output_effects import apply_input_effects, apply_output_effects
from sysid.gap.adapters.simulator import RunCache, Signals, Simulator, SteppedSimulator, command_signals
from sysid.gap.prepare.noise import noise_levels
from sysid.gap.problem import Problem, joint_problem, problems_of, split_of, tip_problem, tool_problem
from sysid.gap.stage_kind import POSES, TIP, TOOL
from sysid.machine import KnownEffect, Machine
from sysid.plant import Model, Plant, compile_plant, nominal_plant
from sysid.plant.stretches import common_stretches, held
from sysid.signals import axis_signal, point_signals, split_signal

Array = npt.NDArray[np.float64]
Stretches = npt.NDArray[np.int64]


@dataclass(frozen=True)
class SimulatorAdapter:
    """A simulator of a machine with input effects and output effects; a simulator itself.

    Args:
        plant: the input and output effects, and what was identified inside the simulator: its linkages and its tool sway.
        signals: what the simulator returns.
        identified: effects that were identified inside the simulator.
    """

    runs: RunCache
    plant: Plant
    signals: frozenset[str]
    identified: tuple[KnownEffect, ...]
    _model: Model = field(repr=False)
    _surrogates: dict[str, Surrogate] = field(default_factory=dict, repr=False, compare=False)
    _stages: dict[tuple[str, str], Problem] = field(default_factory=dict, repr=False, compare=False)

    @property
    def name(self) -> str:
        return self.runs.name

    @property
    def machine(self) -> Machine:
        return self.plant.machine

    @property
    def effects(self) -> tuple[KnownEffect, ...]:
        """Input and output effects, without those identified inside the simulator."""
        return tuple(item for item in self.plant.effects if item not in self.identified)

    def with_effects(self, effects: Iterable[KnownEffect]) -> SimulatorAdapter:
        """The simulator with these input or output effects as well.

        Raises:
            SettingsError: an effect acts inside the simulator, or does not fit the machine.
        """
        plant = self.plant
        for item in effects:
            if any(axis.name == item.target and axis.actuation == "force" for axis in self.machine.axes):
                raise SettingsError(
                    f"simulator {self.name}", f"{item.name} acts inside", "an input or output effect", "Build it in."
                )
            plant = plant.with_effect(item)
        return replace(self, plant=plant)

    def simulate(self, recording: Recording) -> pd.DataFrame:
        """Sensor readings: commands through the input effects, the simulator, and the output effects."""
        return self.free_run(self.plant, recording)

    # -- interface of the workflow -------------------------------------------------------------------------------------

    def problems(self, dataset: Dataset) -> list[Problem]:
        """The stages that the dataset measures at both ends and the simulator returns."""
        return [self._problem(p, dataset) for p in problems_of(self._model, dataset) if self._covers(p)]

    def with_input_effects(self, problem: Problem, theta: Array) -> Problem:
        """The stage with the simulator run under the input effects ``theta``; a command stage is returned unchanged.

        The discrepancy of the simulator from the plant's stage may depend on its motion (a tool that sways).
        """
        own = self._stages.get((problem.stage, problem.target))
        return problem if own is None else replace(problem, predict=self._with_discrepancy(own, theta))

    def search_problem(self, problem: Problem) -> Problem:
        """The stage that is searched: the surrogate of the axis where it is accurate, else the stage itself."""
        surrogate = self._surrogates.get(problem.target) if problem.kind.commanded else None
        return surrogate.problem if surrogate is not None and surrogate.accurate else problem

    def free_run(self, plant: Plant, recording: Recording) -> pd.DataFrame:
        """The whole chain with the input and output effects of ``plant``."""
        thetas, known = plant.vector()[None], self.signals
        columns: dict[str, Array] = {"time": recording.values("time")}
        seen = recording.table.copy()

        def put(signals: Sequence[str], values: Array) -> None:
            for k, signal in enumerate(signals):
                columns[signal] = seen[signal] = values[0, :, k]

        def behind(problem: Problem) -> Array:
            at = replace(recording, table=seen)
            return problem.predict(thetas, at) + self._discrepancy(problem, thetas, recording)

        for axis in self.machine.axes:
            joint = axis_signal(axis.name, "joint")
            if axis.driven in known:
                put((axis.driven,), self._drive(thetas, recording, axis.name))
            if axis.drives == "cylinder" and joint in known:
                values = self._signals(thetas, recording, (joint,))
                if axis.name in self._model.linked:
                    values = behind(joint_problem(self._model, axis))
                put((joint,), values)
            speed = axis_signal(axis.name, "speed")
            if speed in recording.signals and speed in known:
                put((speed,), self._signals(thetas, recording, (speed,)))
            elif speed in recording.signals and axis.driven in columns:
                driven = columns[axis.driven][None]
                put((speed,), self._model.sensed_rate(thetas, axis.name, driven, recording.rate_hz)[:, :, None])
        ee, tool = point_signals("ee"), point_signals("tool")
        if known.issuperset(ee):
            values = self._signals(thetas, recording, ee)
            if self._kinematic:
                values = behind(tip_problem(self._model))
            put(ee, values)
        if known.issuperset(ee) and self._model.has_tool(thetas[0], recording):
            put(tool, behind(tool_problem(self._model)))
        elif known.issuperset(tool):
            put(tool, self._signals(thetas, recording, tool))
        return pd.DataFrame(columns)

    def notes(self, problems: Sequence[Problem]) -> tuple[str, ...]:
        """What was not searched and why, and how often the simulator was run."""
        searched = {(p.stage, p.target) for p in problems}
        notes = [
            f"{self.name} is not changed: parameters are those of input and output effects beside what it already models; "
            "load and pump effects act on its commands, with the load at measured joints"
        ]
        inside = [e.name for e in CATALOGUE if e.stage == "force"]
        for axis in self.machine.axes:
            if axis.actuation == "force":
                notes.append(f"{axis.name} is moved by force: {', '.join(inside)} act inside {self.name} and are not tested")
            elif ("command", axis.name) not in searched:
                lacking = "is not returned" if axis.driven not in self.signals else "is not measured beside a command"
                notes.append(f"{axis.name}: {axis.driven} {lacking}, so that no input effect of {self.name} is tested there")
        if ("end_effector", "ee") not in searched and self.signals.issuperset(point_signals("ee")):
            notes.append("ee: without a URDF and all joints returned and measured, its errors cannot be separated from theirs")
        for item in self.identified:
            shown = ", ".join(f"{key} = {value:.4g}" for key, value in item.parameters.items())
            notes.append(f"{item.name} on {item.target} is already modelled by {self.name}: {shown}")
        for axis_name, surrogate in self._surrogates.items():
            if surrogate.accurate:
                notes.append(
                    f"{axis_name}: searched on a surrogate of {self.name}, error {surrogate.error:.2g} of the sensor noise; "
                    f"fitted, compared and proven on {self.name} itself"
                )
        return (*notes, self.runs.cost())

    # -- stages --------------------------------------------------------------------------------------------------------

    @property
    def _kinematic(self) -> bool:
        """Whether the end effector can be compared with the joints through the URDF."""
        joints = (axis_signal(name, "joint") for name in self.machine.axis_names)
        return self._model.posed and self.signals.issuperset((*joints, *point_signals("ee")))

    def _covers(self, problem: Problem) -> bool:
        """Whether the simulator returns what the stage is compared by; it returns no forces."""
        inputs, outputs = problem.inputs, problem.signals
        needed = {TIP: (*inputs, *outputs), POSES: (*inputs, *outputs), TOOL: inputs}.get(problem.kind, outputs)
        return self.signals.issuperset(needed)

    def _problem(self, problem: Problem, dataset: Dataset) -> Problem:
        """A stage of the plant, turned into one of the simulator."""
        if problem.kind.commanded:
            axis = problem.target
            own = replace(problem, predict=partial(self._drive, axis=axis), short=None)
            (driven,), neutral = problem.signals, self._model.theta[None]
            runs = [self._as_simulated(neutral, recording, (driven,)) for recording in split_of(dataset).seen]
            surrogate = fit_surrogate(own, self.plant, self._model, runs, noise_levels(dataset)[driven])
            if surrogate is not None:
                self._surrogates[axis] = surrogate
                own = replace(own, short=surrogate.problem.short)
            return own
        self._stages[problem.stage, problem.target] = problem
        return self.with_input_effects(replace(problem, poses=False), self._model.theta)

    def _with_discrepancy(self, problem: Problem, theta: Array) -> Callable[[Array, Recording], Array]:
        known = dict[int, tuple[Recording, Array]]()

        def predict(thetas: Array, recording: Recording) -> Array:
            found = known.get(id(recording))
            if found is None or found[0] is not recording:
                own = self._discrepancy(problem, theta[None], recording)
                found = known[id(recording)] = recording, own
            return problem.predict(thetas, recording) + found[1]

        return predict

    def _drive(self, thetas: Array, recording: Recording, axis: str) -> Array:
        """Command → driven signal, (lanes, n, 1)."""
        driven = self.machine.axis(axis).driven
        simulated = self._signals(thetas, recording, (driven,))[:, :, 0]
        measured = self._model.true_signal(thetas, recording, driven)[0]
        load = self._model.load(thetas, recording)[self._model.axis_index(axis)]
        stretches = stretches_of(self._model, recording)
        out = apply_output_effects(self._model, thetas, simulated, measured, load, axis, stretches, recording.rate_hz)
        return self._model.sensed(thetas, driven, out, 1.0 / recording.rate_hz)[:, :, None]

    def _discrepancy(self, problem: Problem, thetas: Array, recording: Recording) -> Array:
        """Of the simulator from the plant's stage, (1, n, d); zero where it does not return both ends of the stage."""
        ends = (*problem.inputs, *problem.signals)
        if not self.signals.issuperset(ends):
            return np.zeros((1, 1, len(problem.signals)))
        own = problem.predict(self._model.theta[None], self._as_simulated(thetas, recording, ends))
        return self._signals(thetas, recording, problem.signals) - own

    # -- runs ----------------------------------------------------------------------------------------------------------

    def _as_simulated(self, thetas: Array, recording: Recording, signals: Sequence[str]) -> Recording:
        values = self._signals(thetas, recording, signals)
        return replace(recording, table=recording.table.assign(**{s: values[0, :, k] for k, s in enumerate(signals)}))

    def _signals(self, thetas: Array, recording: Recording, signals: Sequence[str]) -> Array:
        """Output of the simulator itself, (lanes, n, d); NaN where it returns none."""
        factor, fine = self._fine(recording)
        stretches = factor * stretches_of(self._model, recording)
        axes = [split_signal(name)[0] for name in command_signals(recording, self.machine)]
        inputs = apply_input_effects(self._model, thetas, fine, axes, stretches)
        commands = {axis_signal(axis, "command"): values for axis, values in inputs.items()}
        missing = np.full(len(fine), np.nan)
        found = self.runs.of(fine, commands, stretches)
        return np.array([[lane.get(s, missing)[::factor] for s in signals] for lane in found]).transpose(0, 2, 1)

    def _fine(self, recording: Recording) -> tuple[int, Recording]:
        """The steps of the simulator in a sample, and the recording with each row held over them.

        Input effects act at these steps: a dead time of one and a half samples, held over samples, would not be a dead time.
        """
        simulator = self.runs.simulator
        factor = simulator.steps_in_sample(recording.rate_hz) if isinstance(simulator, SteppedSimulator) else 1
        if factor == 1:
            return 1, recording
        key = "held over steps", factor
        if key not in recording.derived:
            rate = factor * recording.rate_hz
            table = recording.table.loc[recording.table.index.repeat(factor)].reset_index(drop=True)
            table = table.assign(time=np.arange(len(table)) / rate)
            recording.derived[key] = replace(recording, table=table, rate_hz=rate)
        return factor, recording.derived[key]


def stretches_of(model: Model, recording: Recording) -> Stretches:
    """First and last+1 row of each stretch in which all commands are present, (m, 2)."""
    names = command_signals(recording, model.machine)
    return common_stretches([held(recording.values(name), recording.rate_hz)[1] for name in names], len(recording))


def adapt_simulator(simulator: Simulator, dataset: Dataset, effects: Sequence[KnownEffect] = ()) -> SimulatorAdapter:
    """The adapter of a simulator for the recordings of a dataset, with ``effects`` at its inputs and outputs.

    The simulator is run once on every fit and selection recording, and once more to check that it is deterministic. The
    effects that ``machine.toml`` lists belong to the nominal plant; the simulator has its own.

    Raises:
        InputError: the simulator failed, returned no table of signals, or is not deterministic.
        SettingsError: an effect does not fit.
    """
    if isinstance(simulator, SimulatorAdapter):
        return simulator.with_effects(effects)
    runs = RunCache(simulator, dataset.machine)
    bare = replace(nominal_plant(dataset.machine.by_responses(), streams=dataset.streams), effects=(), linkages={})
    model = compile_plant(bare)
    simulated: list[Signals] = []
    for k, recording in enumerate(split_of(dataset).seen):
        names = command_signals(recording, dataset.machine)
        commands = {name: held(recording.values(name), recording.rate_hz)[0][None] for name in names}
        stretches = stretches_of(model, recording)
        if not names or not len(stretches):
            continue
        if k == 0:
            runs.check_repeatable(recording, commands, stretches)
        simulated += runs.of(recording, commands, stretches)
    signals = frozenset(signal for run in simulated for signal, values in run.items() if not np.isnan(values).all())
    plant = replace(bare, linkages=identify_linkages(dataset.machine, simulated))
    sway = identify_sway(plant, dataset, simulated)
    if sway is not None:
        plant = plant.with_effect(sway)
    return SimulatorAdapter(runs, plant, signals, plant.effects, compile_plant(plant)).with_effects(effects)
