"""The shortest recordings inside the machine's limits that are expected to answer what stopped the workflow."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from sysid import __version__
from sysid.datasets.recording import Recording
from sysid.gap.case import Case
from sysid.gap.data import Data
from sysid.gap.excitation import excitation_of
from sysid.gap.experiment.excitation_signal import Script, commands_of, perform, script_of, start_of
from sysid.gap.experiment.experiment import Experiment, Limits, Purpose, outside
from sysid.gap.experiment.feasible_set import Room, limits_of, room_of
from sysid.gap.experiment.information import Hypothesis, discrimination, precision
from sysid.gap.experiment.motions import MOTIONS, Motion
from sysid.gap.experiment.open_hypothesis import Question
from sysid.gap.problem import Problem, drive_problem, force_problem, joint_problem, tip_problem, tool_problem
from sysid.plant import Model, Plant, compile_plant

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Planning:
    """Settings of the search for experiments.

    Args:
        nats: expected log likelihood ratio from which a question counts as answered. The workflow needs 5 on recordings to fit
            and as much on those to select; the rest is for what a simulation does not know.
        gap: the workflow takes a stage for explained that is predicted to within this multiple of the noise floor: a rival has
            to be left with more, all recordings together.
        lengths: of recordings that are tried, the shortest first [s].
        repeats: most times that the same recording may be asked for.
        margin: share of each axis's range that is kept free at either end.
        fence: further limits, signal → (lowest, highest): ``{"ee.z": (0.2, 3.0)}`` keeps the tip above the ground.
        samples: plants as likely as the data allow that have to keep to the limits as well.
    """

    nats: float = 20.0
    gap: float = 1.15
    lengths: tuple[float, ...] = (10.0, 20.0, 40.0, 80.0)
    repeats: int = 5
    margin: float = 0.05
    fence: Limits = field(default_factory=dict)
    samples: int = 4


@dataclass(frozen=True)
class Proposal:
    """Experiments to make, and in words what none can answer."""

    experiments: tuple[Experiment, ...] = ()
    notes: tuple[str, ...] = ()


def propose(
    case: Case,
    repaired: Plant,
    questions: Sequence[Question],
    settings: Planning | None = None,
    tell: Callable[[str], None] = lambda text: None,
) -> Proposal:
    """The shortest experiment for each question; one that answers several is made once.

    Args:
        repaired: the best plant so far, on which motions are balanced and limits are checked.
        tell: called with what is being planned.
    """
    if not questions:
        return Proposal()
    planner = Planner(case, repaired, settings or Planning())
    chosen: list[_Chosen] = []
    notes = []
    for question in questions:
        tell(question.label)
        if any(planner.serves(item, question) for item in chosen):
            continue
        found = planner.best(question)
        if found is None:
            notes.append(f"{question.label}: no motion that was tried inside the limits shows it")
        else:
            chosen.append(_Chosen(found[0], [(question, found[1])]))
    for item in sorted(chosen, key=lambda item: item.script.seconds):  # what longer ones show as well needs no one of its own
        others = [other for other in chosen if other is not item]
        if all(any(planner.serves(other, question) for other in others) for question, _ in item.served):
            chosen = others
    made: list[Experiment] = []
    for item in chosen:
        experiment = planner.experiment(item.script, item.served)
        again = sum(other.name.split("_")[0] == experiment.name for other in made)
        made.append(replace(experiment, name=f"{experiment.name}_{again + 1}") if again else experiment)
    return Proposal(tuple(made), tuple(notes))


def rehearse(plant: Plant, experiment: Experiment) -> Recording:
    """The recording that a machine like ``plant`` would make of the experiment, without noise: a dry run."""
    return perform(compile_plant(plant), experiment.commands, experiment.start, experiment.rate_hz, name=experiment.name)


@dataclass(frozen=True)
class Forecast:
    """What a script is expected to say of a question.

    Args:
        nats: of the pair least apart, from one recording.
        repeats: how many recordings answer.
        deviations: of the unknowns of the first model, (k,).
    """

    nats: float
    repeats: int
    deviations: Array


@dataclass(frozen=True)
class _Chosen:
    """A script and the questions that it answers."""

    script: Script
    served: list[tuple[Question, Forecast]]


class Planner:
    """Scripts and what is the same for all of them: the plant, rooms and limits."""

    def __init__(self, case: Case, repaired: Plant, settings: Planning) -> None:
        self.case, self.plant, self.settings = case, repaired, settings
        self.model = compile_plant(repaired)
        self.machine = repaired.machine
        recordings = (*case.split.seen, *case.split.held_out)
        rooms = [room_of(repaired, axis, recordings, settings.margin) for axis in self.machine.axes]
        self.known = all(room is not None for room in rooms)
        self.rooms: list[Room] = [room for room in rooms if room is not None]
        self.limits = {**limits_of(repaired, self.rooms, settings.margin), **settings.fence}
        self.rate_hz = case.split.seen[0].rate_hz
        names = {signal for r in recordings for signal in r.signals if not np.isnan(r.values(signal)).all()}
        self.measured = frozenset(names)
        self._scripts: dict[tuple[str, tuple[int, ...], float], Script | None] = {}
        self._thetas = (
            repaired.sample(settings.samples, case.seed) if settings.samples else np.empty((0, len(self.model.theta)))
        )

    # -- choice ----------------------------------------------------------------------------------------------------

    def best(self, question: Question) -> tuple[Script, Forecast] | None:
        """The shortest script that answers at once; else what answers in least time if repeated; None where nothing does."""
        repeated: list[tuple[Script, Forecast]] = []
        for seconds in self.settings.lengths if self.known else ():
            scripts = [s for m, axes in self._options(question) if (s := self.script(m, axes, seconds)) is not None]
            rated = [(s, f) for s in scripts if (f := self.forecast(s, question)) is not None]
            at_once = [item for item in rated if item[1].repeats == 1]
            if at_once:
                return min(at_once, key=lambda item: (len(item[0].axes), -item[1].nats))
            repeated += rated
        return min(repeated, key=lambda item: item[0].seconds * item[1].repeats, default=None)

    def serves(self, item: _Chosen, question: Question) -> bool:
        """Whether a script that is to be made anyway answers the question; then it is noted there."""
        if any(known is question for known, _ in item.served):
            return True
        forecast = self.forecast(item.script, question)
        if forecast is None or forecast.repeats > 1:
            return False
        item.served.append((question, forecast))
        return True

    def _options(self, question: Question) -> list[tuple[Motion, tuple[int, ...]]]:
        """Motions of the axis of the question; of each axis where it is about the whole arm; of all axes together."""
        names = self.machine.axis_names
        target = question.stage.problem.target
        single = [names.index(target)] if target in names else list(range(len(names)))
        several = tuple(range(len(names)))
        options = [(motion, (axis,)) for motion in MOTIONS if not motion.several for axis in single]
        return options + [(motion, several) for motion in MOTIONS if motion.several and len(several) > 1]

    def script(self, motion: Motion, axes: tuple[int, ...], seconds: float) -> Script | None:
        """The script, where there is time and room for it and all likely plants keep to the limits."""
        key = motion.name, axes, seconds
        if key not in self._scripts:
            script = script_of(self._fresh(self.model.theta), self.rooms, motion, axes, seconds, self.rate_hz, self.case.seed)
            if script is not None and not all(
                self._inside(self._rehearse(script, theta, None)) for theta in (self.model.theta, *self._thetas)
            ):
                script = None
            self._scripts[key] = script
        return self._scripts[key]

    # -- forecast --------------------------------------------------------------------------------------------------

    def forecast(self, script: Script, question: Question) -> Forecast | None:
        """What the script says of the question; None where that is too little, or a model leaves the limits or the pump's."""
        datas: dict[int, Data] = {}
        for model in question.models:
            recording = self._rehearse(script, model.theta, self.measured)
            if not self._inside(recording) or not self._fed(recording, model, question):
                return None
            problem = self._problem(question, recording)
            datas[id(model)] = Data(problem, [recording], question.stage.sigma)
        apart = [discrimination(datas[id(a)], a, b, question.drifts, self.case.seed) for a, b in question.pairs]
        first = question.models[0]
        data = datas[id(first)]
        nats, rmse = min(item.nats for item in apart), min(item.rmse for item in apart)
        enough = (r for r in range(1, self.settings.repeats + 1) if self._answers(question, data, nats, rmse, r))
        repeats = next(enough, None)
        return None if repeats is None else Forecast(nats, repeats, precision(data, first, question.drifts))

    def _answers(self, question: Question, data: Data, nats: float, rmse: float, repeats: int) -> bool:
        """Whether so many recordings are enough: in nats, for the gate of the excitation, and to leave a rival unexplained."""
        if repeats * nats < self.settings.nats:
            return False
        seen = (*question.stage.split.seen, *(list(data.recordings) * repeats))
        if not all(excitation_of(c, seen, self.machine).sufficient for c in question.candidates):
            return False
        if question.kind == "excitation":  # asked for because the stage is unexplained
            return True
        before = sum(int(np.isfinite(question.stage.problem.measured(r)).sum()) for r in question.stage.split.seen)
        new = repeats * sum(int(np.isfinite(data.problem.measured(r)).sum()) for r in data.recordings)
        squares = before * question.stage.found.final_rmse**2 + new * rmse**2
        return math.sqrt(squares / (before + new)) > self.settings.gap

    def _problem(self, question: Question, recording: Recording) -> Problem:
        """The stage of the question for a rehearsed recording."""
        stage, model = question.stage.problem, self._fresh(self.model.theta)
        if stage.stage == "force":
            return force_problem(model, self.machine.axis(stage.target), [recording], 0.0)
        if stage.stage in ("command", "joint"):
            make = drive_problem if stage.stage == "command" else joint_problem
            return make(model, self.machine.axis(stage.target))
        return tip_problem(model) if stage.stage == "end_effector" else tool_problem(model)

    def _rehearse(self, script: Script, theta: Array, measured: frozenset[str] | None) -> Recording:
        model = self._fresh(theta)
        start = start_of(self.rooms, script, self.plant.linkages)
        return perform(model, commands_of(model, self.rooms, script), start, self.rate_hz, measured)

    def _inside(self, recording: Recording) -> bool:
        return not outside(recording.table, self.limits)

    def _fed(self, recording: Recording, model: Hypothesis, question: Question) -> bool:
        """Whether the pump feeds it all; where the question is about the pump it need not."""
        if any(candidate.effect.name == "pump_flow_limit" for candidate in question.candidates):
            return True
        share = self._fresh(model.theta).share(model.theta[None], recording)
        return float(share.min()) >= 1.0

    def _fresh(self, theta: Array) -> Model:
        """A model that remembers no recording: rehearsals are many and used once."""
        return Model(self.model.machine, theta, self.model.rig, self.model.linked, self.model.streams)

    # -- result ----------------------------------------------------------------------------------------------------

    def experiment(self, script: Script, served: Sequence[tuple[Question, Forecast]]) -> Experiment:
        """The script as an experiment, with what it is expected to say in words."""
        repeats = max(forecast.repeats for _, forecast in served)
        names = [self.machine.axis_names[axis] for axis in script.axes]
        thetas = [self.model.theta, *self._thetas, *(m.theta for question, _ in served for m in question.models)]
        tables = [self._rehearse(script, theta, None).table for theta in thetas]
        reached = {
            str(signal): (min(float(t[signal].min()) for t in tables), max(float(t[signal].max()) for t in tables))
            for signal in tables[0].columns
            if signal != "time" and not str(signal).endswith(".command") and not tables[0][signal].isna().any()
        }
        purposes = tuple(
            Purpose(q.kind, _text(q, f, self.settings.nats), q.effects, f.nats, self.settings.nats) for q, f in served
        )
        provenance: dict[str, str | int] = {
            "dataset": self.case.dataset.reference,
            "dataset_digest": self.case.dataset.digest,
            "plant": self.case.plant.reference or "nominal",
            "seed": self.case.seed,
            "sysid": __version__,
        }
        return Experiment(
            name=f"{'-'.join(names) if len(names) < len(self.rooms) or len(names) == 1 else 'all'}-{script.motion.name}",
            machine=self.machine.name,
            motion=script.motion.name,
            about=script.motion.about.format(axes=_listed(names)),
            axes=tuple(names),
            rate_hz=self.rate_hz,
            repeats=repeats,
            start=start_of(self.rooms, script, self.plant.linkages),
            limits=self.limits,
            predicted=reached,
            commands=commands_of(self._fresh(self.model.theta), self.rooms, script),
            purposes=purposes,
            provenance=provenance,
        )


def _text(question: Question, forecast: Forecast, needed: float) -> str:
    """What is expected, in words."""
    often = f" each of {forecast.repeats} times" if forecast.repeats > 1 else ""
    if question.kind == "tie":
        names = [f"{effect.name} on {effect.target}" for effect in question.effects]
        return f"{_listed(names)} should then differ by about {forecast.nats:.0f} nats{often}; {needed:.0f} decide."
    model = question.models[0]
    assert model.candidate is not None
    own = len(model.unknowns) - len(model.candidate.unknowns)
    sizes = ", ".join(
        f"{u.key} = {v:.3g} to ± {2.0 * s:.1g}"
        for u, v, s in zip(model.unknowns[own:], model.values[own:], forecast.deviations[own:], strict=True)
    )
    return f"{question.label} with {sizes} should then show by about {forecast.nats:.0f} nats{often}; {needed:.0f} decide."


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
