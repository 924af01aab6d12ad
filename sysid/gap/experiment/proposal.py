"""Proposal of experiments: the shortest recordings within the machine's limits that are expected to resolve open hypotheses."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.gap.data import Data
from sysid.gap.excitation import excitation_of, measured_signals
from sysid.gap.experiment.excitation_signal import ExcitationSignal, design_excitation, simulate_recording
from sysid.gap.experiment.experiment import Experiment, Limits, Purpose, outside
from sysid.gap.experiment.motions import MOTIONS, FeasibleSet, MotionPattern, feasible_set_of, limits_of
from sysid.gap.experiment.open_hypothesis import OpenHypothesis, PlausibleModel, discrimination, precision
from sysid.gap.prepare.case import Case
from sysid.gap.problem import Problem
from sysid.names import listed
from sysid.plant import Model, Plant, compile_plant
from sysid.plant.force import ForceFilter
from sysid.release import __version__

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Planning:
    """Settings of the search for experiments.

    Args:
        nats: expected log-likelihood ratio from which a hypothesis counts as resolved. The workflow needs 5 on the fit and
            5 on the selection recordings; the rest is a margin for errors of the simulation.
        gap: a stage counts as explained when it is predicted to within this multiple of the noise floor; the error of an
            alternative has to exceed it, over all recordings together.
        lengths: durations that are tested, in ascending order [s].
        repeats: largest number of repetitions of one recording.
        margin: share of the range of each axis that is kept free at either end.
        fence: further limits, signal → (lowest, highest): ``{"ee.z": (0.2, 3.0)}`` keeps the tip above the ground.
        samples: number of plants, drawn from the parameter uncertainty, that have to stay within the limits as well.
    """

    nats: float = 20.0
    gap: float = 1.15
    lengths: tuple[float, ...] = (10.0, 20.0, 40.0, 80.0)
    repeats: int = 5
    margin: float = 0.05
    fence: Limits = field(default_factory=dict)
    samples: int = 4


@dataclass(frozen=True)
class ExperimentProposal:
    """Proposed experiments, and notes on hypotheses that none resolves."""

    experiments: tuple[Experiment, ...] = ()
    notes: tuple[str, ...] = ()


def propose(
    case: Case,
    repaired: Plant,
    hypotheses: Sequence[OpenHypothesis],
    settings: Planning | None = None,
    on_hypothesis: Callable[[str], None] = lambda text: None,
) -> ExperimentProposal:
    """The shortest experiment for each hypothesis; one that resolves several is proposed once.

    Args:
        repaired: the best plant so far, with which motions are designed and limits checked.
        on_hypothesis: called with the label of each hypothesis.
    """
    if not hypotheses:
        return ExperimentProposal()
    planner = Planner(case, repaired, settings or Planning())
    chosen: list[_Selected] = []
    notes = []
    for hypothesis in hypotheses:
        on_hypothesis(hypothesis.label)
        if any(planner.serves(item, hypothesis) for item in chosen):
            continue
        found = planner.best(hypothesis)
        if found is None:
            notes.append(f"{hypothesis.label}: no tested motion within the limits resolves it")
        else:
            chosen.append(found)
    for item in sorted(chosen, key=lambda item: item.excitation.seconds):  # drop those whose hypotheses longer ones resolve
        others = [other for other in chosen if other is not item]
        if all(any(planner.serves(other, hypothesis) for other in others) for hypothesis, _ in item.served):
            chosen = others
    made: list[Experiment] = []
    names: Counter[str] = Counter()
    for item in chosen:
        experiment = planner.experiment(item)
        names[experiment.name] += 1
        again = names[experiment.name]
        made.append(replace(experiment, name=f"{experiment.name}_{again}") if again > 1 else experiment)
    return ExperimentProposal(tuple(made), tuple(notes))


def dry_run(plant: Plant, experiment: Experiment) -> Recording:
    """The recording of the experiment on a machine equal to ``plant``, without noise."""
    return simulate_recording(
        compile_plant(plant), experiment.commands, experiment.start, experiment.rate_hz, name=experiment.name
    )


@dataclass(frozen=True)
class Forecast:
    """Expected information of an excitation signal on a hypothesis.

    Args:
        nats: of the least separated pair, from one recording.
        repeats: number of recordings that resolve the hypothesis.
        deviations: standard deviations of the unknowns of the first model, (k,).
    """

    nats: float
    repeats: int
    deviations: Array


@dataclass(frozen=True)
class _Selected:
    """An excitation signal and the hypotheses that it resolves."""

    excitation: ExcitationSignal
    served: list[tuple[OpenHypothesis, Forecast]]


class Planner:
    """Design of excitation signals for one plant, with its feasible sets and limits."""

    def __init__(self, case: Case, repaired: Plant, settings: Planning) -> None:
        self.case, self.settings = case, settings
        self.machine, self.linkages = repaired.machine, repaired.linkages
        compiled = compile_plant(repaired)  # signals are designed without its networks
        self.model = Model(compiled.machine, compiled.theta, compiled.arrays, compiled.linked, compiled.streams)
        recordings = (*case.split.seen, *case.split.held_out)
        feasible_sets = [feasible_set_of(repaired, axis, recordings, settings.margin) for axis in self.machine.axes]
        self.known = all(feasible is not None for feasible in feasible_sets)
        self.feasible_sets: list[FeasibleSet] = [feasible for feasible in feasible_sets if feasible is not None]
        self.limits = {**limits_of(self.feasible_sets), **settings.fence}
        self.rate_hz = case.split.seen[0].rate_hz
        self.measured = measured_signals(recordings)
        samples = repaired.sample(settings.samples, case.seed) if settings.samples else ()
        self._thetas: list[Array] = [self.model.theta, *samples]
        self._excitations: dict[tuple[str, tuple[int, ...], float], ExcitationSignal | None] = {}

    # -- choice ----------------------------------------------------------------------------------------------------

    def best(self, hypothesis: OpenHypothesis) -> _Selected | None:
        """The shortest signal that resolves it in one recording, else in the least total time; None where none resolves it."""
        repeated: list[tuple[ExcitationSignal, Forecast]] = []
        for seconds in self.settings.lengths if self.known else ():
            excitations = [s for m, axes in self._options(hypothesis) if (s := self.excitation(m, axes, seconds)) is not None]
            rated = [(s, f) for s in excitations if (f := self.forecast(s, hypothesis)) is not None]
            at_once = [item for item in rated if item[1].repeats == 1]
            if at_once:
                excitation, forecast = min(at_once, key=lambda item: (len(item[0].axes), -item[1].nats))
                return _Selected(excitation, [(hypothesis, forecast)])
            repeated += rated
        if not repeated:
            return None
        excitation, forecast = min(repeated, key=lambda item: item[0].seconds * item[1].repeats)
        return _Selected(excitation, [(hypothesis, forecast)])

    def serves(self, item: _Selected, hypothesis: OpenHypothesis) -> bool:
        """Whether an already selected signal resolves the hypothesis; if so, the hypothesis is added to it."""
        if any(known is hypothesis for known, _ in item.served):
            return True
        forecast = self.forecast(item.excitation, hypothesis)
        if forecast is None or forecast.repeats > 1:
            return False
        item.served.append((hypothesis, forecast))
        return True

    def _options(self, hypothesis: OpenHypothesis) -> list[tuple[MotionPattern, tuple[int, ...]]]:
        """Motions of the axis of the hypothesis, or of each axis where it concerns the whole arm, and of all axes together."""
        names = self.machine.axis_names
        target = hypothesis.stage.problem.target
        single = [names.index(target)] if target in names else list(range(len(names)))
        several = tuple(range(len(names)))
        options = [(motion, (axis,)) for motion in MOTIONS if not motion.several for axis in single]
        return options + [(motion, several) for motion in MOTIONS if motion.several and len(several) > 1]

    def excitation(self, motion: MotionPattern, axes: tuple[int, ...], seconds: float) -> ExcitationSignal | None:
        """The excitation signal; None where it does not fit, or where a sampled plant leaves the limits."""
        key = motion.name, axes, seconds
        if key not in self._excitations:
            signal = design_excitation(self.model, self.feasible_sets, motion, axes, seconds, self.rate_hz, self.case.seed)
            self._excitations[key] = signal if signal is not None and self._feasible(signal) else None
        return self._excitations[key]

    def _feasible(self, excitation: ExcitationSignal) -> bool:
        start = list(excitation.start_values(self.linkages).values())
        return bool(np.isfinite(start).all()) and all(self._inside(self._simulate(excitation, t)) for t in self._thetas)

    # -- forecast --------------------------------------------------------------------------------------------------

    def forecast(self, excitation: ExcitationSignal, hypothesis: OpenHypothesis) -> Forecast | None:
        """Expected information; None where it is insufficient, or where a model exceeds the limits or the pump flow."""
        datas: dict[int, Data] = {}
        for model in hypothesis.models:
            recording = self._simulate(excitation, model.theta, self.measured)
            if not self._inside(recording) or not self._pump_sufficient(recording, model, hypothesis):
                return None
            problem = self._problem(hypothesis, recording)
            if problem is None:
                return None
            datas[id(model)] = Data(problem, [recording], hypothesis.stage.sigma)
        apart = [discrimination(datas[id(a)], a, b, hypothesis.drifts, self.case.seed) for a, b in hypothesis.pairs]
        nats, rmse = min(nats for nats, _ in apart), min(rmse for _, rmse in apart)
        first = hypothesis.models[0]
        data = datas[id(first)]
        for repeats in range(1, self.settings.repeats + 1):
            if self._resolves(hypothesis, data, nats, rmse, repeats):
                return Forecast(nats, repeats, precision(data, first, hypothesis.drifts))
        return None

    def _resolves(self, hypothesis: OpenHypothesis, data: Data, nats: float, rmse: float, repeats: int) -> bool:
        """Whether so many recordings suffice: in nats, in excitation, and in the remaining error of the alternatives."""
        if repeats * nats < self.settings.nats:
            return False
        seen = (*hypothesis.stage.split.seen, *(list(data.recordings) * repeats))
        if not all(excitation_of(c, seen, self.machine).sufficient for c in hypothesis.candidates):
            return False
        if hypothesis.kind == "excitation":  # the stage is unexplained already
            return True
        before = sum(int(np.isfinite(hypothesis.stage.problem.measured(r)).sum()) for r in hypothesis.stage.split.seen)
        new = repeats * sum(int(np.isfinite(data.problem.measured(r)).sum()) for r in data.recordings)
        squares = before * hypothesis.stage.found.final_rmse**2 + new * rmse**2
        return math.sqrt(squares / (before + new)) > self.settings.gap

    def _problem(self, hypothesis: OpenHypothesis, recording: Recording) -> Problem | None:
        """The stage of the hypothesis for a simulated recording; None where that is too short to determine a force."""
        known = hypothesis.stage.problem
        problem = known.again(self.model, [recording], replace(known.force_filter or ForceFilter(), delay=0.0))
        return None if problem.only == frozenset() else problem

    def _simulate(self, excitation: ExcitationSignal, theta: Array, measured: frozenset[str] | None = None) -> Recording:
        model = replace(self.model, theta=theta)
        start = excitation.start_values(self.linkages)
        return simulate_recording(model, excitation.commands(model), start, self.rate_hz, measured)

    def _inside(self, recording: Recording) -> bool:
        """Whether a simulated motion is finite and within the limits throughout."""
        limited = recording.table[[signal for signal in self.limits if signal in recording.table.columns]]
        return bool(np.isfinite(limited.to_numpy(np.float64)).all()) and not outside(limited, self.limits)

    def _pump_sufficient(self, recording: Recording, model: PlausibleModel, hypothesis: OpenHypothesis) -> bool:
        """Whether the demanded flow is within the pump limit; not required where the hypothesis concerns the pump."""
        if any(candidate.target == "machine" for candidate in hypothesis.candidates):
            return True
        return float(replace(self.model, theta=model.theta).share(model.theta[None], recording).min()) >= 1.0

    # -- result ----------------------------------------------------------------------------------------------------

    def experiment(self, item: _Selected) -> Experiment:
        """The experiment of an excitation signal, with its expected information as text."""
        excitation, needed = item.excitation, self.settings.nats
        names = [self.machine.axis_names[axis] for axis in excitation.axes]
        thetas = [*self._thetas, *(model.theta for hypothesis, _ in item.served for model in hypothesis.models)]
        tables = [self._simulate(excitation, theta).table for theta in thetas]
        reached = {
            str(signal): (min(float(t[signal].min()) for t in tables), max(float(t[signal].max()) for t in tables))
            for signal in tables[0].columns
            if signal != "time" and not str(signal).endswith(".command") and not tables[0][signal].isna().any()
        }
        moved = "-".join(names) if len(names) < len(self.feasible_sets) or len(names) == 1 else "all"
        return Experiment(
            name=f"{moved}-{excitation.motion.name}",
            machine=self.machine.name,
            motion=excitation.motion.name,
            about=excitation.motion.about.format(axes=listed(names)),
            axes=tuple(names),
            rate_hz=self.rate_hz,
            repeats=max(forecast.repeats for _, forecast in item.served),
            start=excitation.start_values(self.linkages),
            limits=self.limits,
            predicted=reached,
            purposes=tuple(Purpose(h.kind, _text(h, f, needed), h.effects, f.nats, needed) for h, f in item.served),
            provenance={
                "dataset": self.case.dataset.reference,
                "dataset_digest": self.case.dataset.digest,
                "plant": self.case.plant.reference or "nominal",
                "seed": self.case.seed,
                "sysid": __version__,
            },
            commands=excitation.commands(self.model),
        )


def _text(hypothesis: OpenHypothesis, forecast: Forecast, needed: float) -> str:
    """Expected information as text."""
    often = f" in each of {forecast.repeats} recordings" if forecast.repeats > 1 else ""
    if hypothesis.kind == "tie":
        names = [f"{effect.name} on {effect.target}" for effect in hypothesis.effects]
        return f"{listed(names)}: expected log-likelihood ratio {forecast.nats:.0f} nats{often}, {needed:.0f} required."
    model = hypothesis.models[0]
    assert model.candidate is not None
    own = len(model.unknowns) - len(model.candidate.unknowns)
    sizes = ", ".join(
        f"{u.key} = {v:.3g} ± {2.0 * s:.1g}"
        for u, v, s in zip(model.unknowns[own:], model.values[own:], forecast.deviations[own:], strict=True)
    )
    return (
        f"{hypothesis.label} with {sizes}: expected log-likelihood gain {forecast.nats:.0f} nats{often}, {needed:.0f} required."
    )
