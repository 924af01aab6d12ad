"""Effects around a simulator of one's own: in front of it on its commands, behind it on the signals that it returns.

Nothing is known of what is inside. So the command stage of an axis runs through the simulator itself, whole recordings at
a time; the stages behind it are the toolkit's own, driven by measured signals, plus what the simulator does otherwise:
``predicted(θ, measured) = stage(θ, measured) + [simulated output − stage(θ₀, simulated input)]``. Its linkages are read off its
own cylinders and joints, the swing of its tool off its own tip and tool; its kinematics are compared with those of the URDF.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Dataset, Recording
from sysid.effects import CATALOGUE
from sysid.errors import SettingsError
from sysid.gap.feed import fed, followed
from sysid.gap.likeness import Likeness, likeness_of
from sysid.gap.noise import noise_levels
from sysid.gap.problem import Problem, problems_of, split_of
from sysid.gap.read_off import linkages_of, swing_of
from sysid.gap.simulator import Runs, Signals, Simulator, command_signals
from sysid.machine import KnownEffect, Machine
from sysid.plant import Model, Plant, compile_plant, nominal_plant
from sysid.signals import axis_signal, point_signals, split_signal

Array = npt.NDArray[np.float64]
Stretches = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Around:
    """A simulator of a machine with effects around it; a simulator itself.

    Args:
        plant: the effects in front and behind, and what was read off the simulator: its linkages, and how its tool swings.
        signals: what the simulator returns.
        read_off: effects that were read off the simulator.
    """

    runs: Runs
    plant: Plant
    signals: frozenset[str]
    read_off: tuple[KnownEffect, ...]
    _model: Model = field(repr=False)
    _likenesses: dict[str, Likeness] = field(default_factory=dict, repr=False, compare=False)
    _stages: dict[tuple[str, str], Problem] = field(default_factory=dict, repr=False, compare=False)

    @property
    def name(self) -> str:
        return self.runs.name

    @property
    def machine(self) -> Machine:
        return self.plant.machine

    @property
    def effects(self) -> tuple[KnownEffect, ...]:
        """Around it, beside what was read off it."""
        return tuple(item for item in self.plant.effects if item not in self.read_off)

    def with_effects(self, effects: Iterable[KnownEffect]) -> Around:
        """The simulator with these effects around it as well.

        Raises:
            SettingsError: an effect sits inside, or does not fit the machine.
        """
        plant = self.plant
        for item in effects:
            if self._forced(item.target):
                raise SettingsError(
                    f"simulator {self.name}",
                    f"{item.name} acts inside",
                    "an effect around it",
                    "Build it in.",
                )
            plant = plant.with_effect(item)
        return replace(self, plant=plant)

    def simulate(self, recording: Recording) -> pd.DataFrame:
        """What the sensors read: commands through the effects in front, the simulator, and the effects behind."""
        return self.free_run(self.plant, recording)

    # -- what the workflow asks ----------------------------------------------------------------------------------------

    def problems(self, dataset: Dataset) -> list[Problem]:
        """The stages that the dataset measures at both ends and the simulator returns."""
        return [self._problem(p, dataset) for p in problems_of(self._model, dataset) if self._covers(p)]

    def settled(self, problem: Problem, theta: Array) -> Problem:
        """The stage with the simulator moving as under the effects ``theta`` in front of it; a command stage as it is.

        What a simulator does otherwise than the toolkit's own stage may depend on its motion (a tool that swings).
        """
        own = self._stages.get((problem.stage, problem.target))
        return problem if own is None else replace(problem, predict=self._with_what_is_beyond(own, theta))

    def to_search(self, problem: Problem) -> Problem:
        """What stands in for a stage while effects are searched: a faithful likeness of the axis, else the stage itself."""
        like = self._likenesses.get(problem.target) if problem.stage == "command" else None
        return like.problem if like is not None and like.faithful else problem

    def free_run(self, plant: Plant, recording: Recording) -> pd.DataFrame:
        """The whole chain with the effects of ``plant`` around the simulator."""
        thetas, known = plant.vector()[None], self.signals
        columns: dict[str, Array] = {"time": recording.values("time")}
        seen = recording.table.copy()

        def put(signals: Sequence[str], values: Array) -> None:
            for k, signal in enumerate(signals):
                columns[signal] = seen[signal] = values[0, :, k]

        for axis in self.machine.axes:
            joint = axis_signal(axis.name, "joint")
            if axis.driven in known:
                put((axis.driven,), self._drive(thetas, recording, axis.name))
            if axis.drives == "cylinder" and joint in known:
                values = self._signals(thetas, recording, (joint,))
                if axis.name in self._model.linked:
                    own = self._model.joint(thetas, replace(recording, table=seen), axis.name)[:, :, None]
                    values = own + self._beyond_linkage(thetas, recording, axis.name)
                put((joint,), values)
        ee, tool = point_signals("ee"), point_signals("tool")
        if known.issuperset(ee):
            values = self._signals(thetas, recording, ee)
            if self._kinematic:
                values = self._model.tip(thetas, replace(recording, table=seen)) + self._beyond_kinematics(thetas, recording)
            put(ee, values)
        if known.issuperset(ee) and self._model.has_tool(thetas[0], recording):
            at = replace(recording, table=seen)
            put(tool, self._model.tool(thetas, at) + self._beyond_tip(thetas, recording))
        elif known.issuperset(tool):
            put(tool, self._signals(thetas, recording, tool))
        return pd.DataFrame(columns)

    def notes(self, problems: Sequence[Problem]) -> tuple[str, ...]:
        """What was not searched and why, and what the simulator cost."""
        searched = {(p.stage, p.target) for p in problems}
        said = [
            f"{self.name} is taken as it is: parameters are those of effects around it, beside what is inside already; "
            "load and pump act on what it is fed, with the load at measured joints"
        ]
        inside = [e.name for e in CATALOGUE if e.stage == "force"]
        for axis in self.machine.axes:
            if axis.actuation == "force":
                said.append(f"{axis.name} is moved by force: {', '.join(inside)} act inside {self.name} and are not offered")
            elif ("command", axis.name) not in searched:
                lacking = "is not returned" if axis.driven not in self.signals else "is not measured beside a command"
                said.append(f"{axis.name}: {axis.driven} {lacking}, so that nothing in front of {self.name} is searched there")
        if ("end_effector", "ee") not in searched and self.signals.issuperset(point_signals("ee")):
            said.append("ee: without a URDF and all joints returned and measured, its errors cannot be told from theirs")
        for item in self.read_off:
            shown = ", ".join(f"{key} = {value:.4g}" for key, value in item.parameters.items())
            said.append(f"{item.name} on {item.target} is inside {self.name} already: {shown}")
        for axis_name, like in self._likenesses.items():
            if like.faithful:
                said.append(
                    f"{axis_name}: searched on a likeness of {self.name}, {like.error:.2g} of the sensor's noise away from it; "
                    f"fitted, judged and proven on {self.name} itself"
                )
        return (*said, self.runs.cost())

    # -- stages --------------------------------------------------------------------------------------------------------

    @property
    def _kinematic(self) -> bool:
        """Whether end effector and joints can be compared through the URDF."""
        joints = (axis_signal(name, "joint") for name in self.machine.axis_names)
        return self._model.posed and self.signals.issuperset((*joints, *point_signals("ee")))

    def _forced(self, target: str) -> bool:
        return any(axis.name == target and axis.actuation == "force" for axis in self.machine.axes)

    def _covers(self, problem: Problem) -> bool:
        if problem.stage == "force":
            return False
        if problem.stage == "end_effector":
            return self._kinematic
        if problem.stage == "tool":
            return self.signals.issuperset(point_signals("ee"))
        return self.signals.issuperset(problem.signals)

    def _problem(self, problem: Problem, dataset: Dataset) -> Problem:
        """A stage of the toolkit's own, turned into one of the simulator."""
        if problem.stage == "command":
            axis = problem.target

            def drive(thetas: Array, recording: Recording) -> Array:
                return self._drive(thetas, recording, axis)

            own = replace(problem, predict=drive, short=None)
            (driven,), neutral = problem.signals, self._model.theta[None]
            runs = [self._as_simulated(neutral, recording, (driven,)) for recording in split_of(dataset).seen]
            like = likeness_of(own, self.plant, self._model, runs, noise_levels(dataset)[driven])
            if like is not None:
                self._likenesses[axis] = like
                own = replace(own, short=like.problem.short)
            return own
        self._stages[problem.stage, problem.target] = problem
        return self.settled(replace(problem, poses=False), self._model.theta)

    def _with_what_is_beyond(self, problem: Problem, theta: Array) -> Callable[[Array, Recording], Array]:
        known = dict[int, tuple[Recording, Array]]()

        def beyond(recording: Recording) -> Array:
            if problem.stage == "joint":
                return self._beyond_linkage(theta[None], recording, problem.target)
            if problem.stage == "end_effector":
                return self._beyond_kinematics(theta[None], recording)
            return self._beyond_tip(theta[None], recording)

        def predict(thetas: Array, recording: Recording) -> Array:
            found = known.get(id(recording))
            if found is None or found[0] is not recording:
                found = known[id(recording)] = (recording, beyond(recording))
            return problem.predict(thetas, recording) + found[1]

        return predict

    def _drive(self, thetas: Array, recording: Recording, axis: str) -> Array:
        """Command → what it drives, (lanes, n, 1)."""
        driven = self.machine.axis(axis).driven
        simulated = self._signals(thetas, recording, (driven,))[:, :, 0]
        measured = self._model.believed(thetas, recording, driven)[0]
        load = self._model.load(thetas, recording)[self._model.axis_index(axis)]
        stretches = self._stretches(recording)
        out = followed(self._model, thetas, simulated, measured, load, axis, stretches, recording.rate_hz)
        return self._model.sensed(thetas, driven, out, 1.0 / recording.rate_hz)[:, :, None]

    # What the simulator does otherwise than the toolkit's own stage, each (1, n, d).

    def _beyond_linkage(self, thetas: Array, recording: Recording, axis: str) -> Array:
        joint = axis_signal(axis, "joint")
        if not {joint, self.machine.axis(axis).driven} <= self.signals:
            return np.zeros((1, 1, 1))
        at = self._as_simulated(thetas, recording, (self.machine.axis(axis).driven, joint))
        own = self._model.joint(self._model.theta[None], at, axis)
        return self._signals(thetas, recording, (joint,)) - own[:, :, None]

    def _beyond_kinematics(self, thetas: Array, recording: Recording) -> Array:
        at = self._as_simulated(thetas, recording, [axis_signal(name, "joint") for name in self.machine.axis_names])
        return self._signals(thetas, recording, point_signals("ee")) - self._model.tip(self._model.theta[None], at)

    def _beyond_tip(self, thetas: Array, recording: Recording) -> Array:
        ee, tool = point_signals("ee"), point_signals("tool")
        if not self.signals.issuperset((*ee, *tool)):
            return np.zeros((1, 1, 3))
        at = self._as_simulated(thetas, recording, (*ee, *tool))
        return self._signals(thetas, recording, tool) - self._model.tool(self._model.theta[None], at)

    # -- runs ----------------------------------------------------------------------------------------------------------

    def _as_simulated(self, thetas: Array, recording: Recording, signals: Sequence[str]) -> Recording:
        values = self._signals(thetas, recording, signals)
        return replace(recording, table=recording.table.assign(**{s: values[0, :, k] for k, s in enumerate(signals)}))

    def _signals(self, thetas: Array, recording: Recording, signals: Sequence[str]) -> Array:
        """What the simulator itself returns, (lanes, n, d); NaN where it says nothing."""
        stretches = self._stretches(recording)
        axes = [split_signal(name)[0] for name in command_signals(recording, self.machine)]
        asked = fed(self._model, thetas, recording, axes, stretches)
        commands = {axis_signal(axis, "command"): values for axis, values in asked.items()}
        missing = np.full(len(recording), np.nan)
        found = self.runs.of(recording, commands, stretches)
        return np.array([[lane.get(s, missing) for s in signals] for lane in found]).transpose(0, 2, 1)

    def _stretches(self, recording: Recording) -> Stretches:
        return stretches_of(self._model, recording)


def stretches_of(model: Model, recording: Recording) -> Stretches:
    """First and last+1 row of each stretch in which all commands are there, (m, 2)."""
    there = np.ones(len(recording), dtype=bool)
    for name in command_signals(recording, model.machine):
        held = np.zeros(len(recording), dtype=bool)
        for first, last in model.held(recording, split_signal(name)[0])[1]:
            held[first:last] = True
        there &= held
    edges = np.flatnonzero(np.diff(np.concatenate(([False], there, [False])).astype(np.int8)))
    return edges.reshape(-1, 2).astype(np.int64)


def around_simulator(simulator: Simulator, dataset: Dataset, effects: Sequence[KnownEffect] = ()) -> Around:
    """The simulator on the recordings of a dataset, with ``effects`` around it.

    The simulator is run once on every recording that a fit may see, and once more to see whether it repeats itself. The
    effects that ``machine.toml`` lists belong to the toolkit's own nominal plant; the simulator has its own.

    Raises:
        InputError: the simulator failed, returned no table of signals, or does not repeat itself.
        SettingsError: an effect does not fit.
    """
    if isinstance(simulator, Around):
        return simulator.with_effects(effects)
    runs = Runs(simulator, dataset.machine)
    bare = replace(nominal_plant(dataset.machine, streams=dataset.streams), effects=(), linkages={})
    model = compile_plant(bare)
    made: list[Signals] = []
    for k, recording in enumerate(split_of(dataset).seen):
        names = command_signals(recording, dataset.machine)
        commands = {name: model.held(recording, split_signal(name)[0])[0][None] for name in names}
        stretches = stretches_of(model, recording)
        if not names or not len(stretches):
            continue
        if k == 0:
            runs.check_repeatable(recording, commands, stretches)
        made += runs.of(recording, commands, stretches)
    signals = frozenset(signal for run in made for signal, values in run.items() if not np.isnan(values).all())
    plant = replace(bare, linkages=linkages_of(dataset.machine, made))
    swing = swing_of(plant, dataset, made)
    if swing is not None:
        plant = plant.with_effect(swing)
    return Around(runs, plant, signals, plant.effects, compile_plant(plant)).with_effects(effects)
