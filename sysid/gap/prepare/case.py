"""One run of the workflow: the dataset, the simulation under test, its stages, and what may be missing at each."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.checks.roles import check_needs, is_pose_set
from sysid.datasets.chunked import median_of
from sysid.datasets.recording import Dataset, Recording
from sysid.effects import coulomb_friction
from sysid.errors import ExcitationError
from sysid.gap.adapters.adapter import SimulatorAdapter, adapt_simulator
from sysid.gap.adapters.simulator import Simulator
from sysid.gap.candidates import Candidate, Scales, candidates_at
from sysid.gap.data import Data
from sysid.gap.excitation import excitation_of
from sysid.gap.fit import Fit, fit_candidates, spread_of
from sysid.gap.prepare.clocks import with_order
from sysid.gap.prepare.drives import DriveResonance, SpeedResonance, drive_delay, drive_resonance, speed_resonance
from sysid.gap.prepare.measured_input import with_measured_input
from sysid.gap.prepare.noise import noise_of_signals, problem_floors
from sysid.gap.prepare.resolution import CoarseSensor, coarse_sensors, with_steps
from sysid.gap.problem import Problem, Split, force_problem, pose_split, problems_of, split_of, why_no_force
from sysid.gap.result import Excitation, ForceComparison
from sysid.gap.stage_result import StageResult
from sysid.gap.statement import CommandOrder, FloorSource
from sysid.machine.rigid_body import moves_masses
from sysid.plant import Plant, compile_plant, free_run, gravity_load
from sysid.plant.layout import parameter_indices

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Case:
    """A dataset against a simulation.

    Args:
        plant: the plant under test; for a user's simulator, its input and output effects (none at first) and linkages.
        theta: vector of the plant.
        noise: standard deviation by signal, and how it is known (``sources``); ``coarse``: sensors whose steps exceed their
            specified noise, included in it.
        adapter: the user's simulator under test, with its input and output effects.
        order: of command and sample in the recordings; None where nothing depends on it.
    """

    dataset: Dataset
    plant: Plant
    theta: Array
    noise: Mapping[str, float]
    split: Split
    seed: int
    adapter: SimulatorAdapter | None = None
    coarse: tuple[CoarseSensor, ...] = ()
    order: CommandOrder | None = None
    sources: Mapping[str, FloorSource] = field(default_factory=dict)

    @property
    def reference(self) -> str:
        """Name of the simulation under test."""
        return self.adapter.name if self.adapter is not None else self.plant.reference or "nominal"

    def runner(self, plant: Plant) -> Callable[[Recording], pd.DataFrame]:
        """Recording → free run of the whole chain, with ``plant`` in place of the plant under test."""
        adapter = self.adapter
        if adapter is not None:
            return lambda recording: adapter.free_run(plant, recording)
        model = compile_plant(plant)
        return lambda recording: free_run(model, recording)


@dataclass(frozen=True)
class Stage:
    """One problem of the case.

    Args:
        sigma: noise floor by signal, (d,).
        theta: vector of the plant under test, with the sensor scales that other stages found.
        result: of the search.
        resonance: of the drive of a force axis, where its force responds to its motion like that of a load behind a spring.
        oscillation: of a speed-commanded axis, where its speed responds like that of a load behind a spring.
        open_load: of a force axis, standard deviation of the constant load that its adjusted links may have [N·m or N].
    """

    problem: Problem
    split: Split
    sigma: Array
    theta: Array
    result: StageResult | None = None
    resonance: DriveResonance | None = None
    oscillation: SpeedResonance | None = None
    open_load: float = 0.0

    @property
    def label(self) -> str:
        return f"{self.problem.stage} stage of {self.problem.target}"

    @property
    def nominal(self) -> Fit:
        """The plant under test, without effects."""
        return Fit((), (), np.empty(0), self.theta)

    @property
    def found(self) -> StageResult:
        """Result of a stage that was searched."""
        assert self.result is not None
        return self.result


def open_case(dataset: Dataset, simulation: Plant | Simulator, seed: int) -> tuple[Case, list[Stage]]:
    """The case and its stages, not searched yet.

    Args:
        simulation: a plant, or a user's simulator.

    Raises:
        ExcitationError: no stage is measured at both ends, or no recording to fit, to select or to hold out.
    """
    check_needs(dataset)
    split, known = split_of(dataset), noise_of_signals(dataset)
    noise = {signal: each.level for signal, each in known.items()}
    order = own = None
    if isinstance(simulation, Plant):
        plant, order = with_order(simulation, dataset, split, noise)
        problems = problems_of(compile_plant(plant), dataset)
    else:
        own = adapt_simulator(simulation, dataset)
        plant, problems = own.plant, own.problems(dataset)
    if not problems:
        lacking = filter(None, _untested_forces(plant, split, ()).values())
        nothing = "no stage is measured at both its ends", "commands and the motion they cause"
        raise next(lacking, ExcitationError(dataset.reference, *nothing))
    coarse = coarse_sensors(plant, split.seen, noise)
    sources = {signal: each.source for signal, each in known.items()}
    case = Case(dataset, plant, plant.vector(), with_steps(plant, coarse, noise), split, seed, own, coarse, order, sources)
    run = case.runner(plant) if own is None else None  # a user's simulator may be slow, and its effects are not known yet
    return case, _stages(case, [with_measured_input(problem, case.noise, run) for problem in problems])


def _stages(case: Case, problems: Sequence[Problem]) -> list[Stage]:
    found, parts = list[Stage](), list[tuple[Problem, Array, Sequence[Recording]]]()
    for each in problems:
        split = stage_split(case, each)
        problem, resonance = _with_resonance(case, each, split)
        moves_by_speed = problem.kind.integrates and case.adapter is None
        oscillation = speed_resonance(problem, split.seen, case.theta) if moves_by_speed else None
        found.append(Stage(problem, split, np.zeros(0), case.theta, resonance=resonance, oscillation=oscillation))
        parts.append((problem, case.theta if resonance is None else _with_spring(case, problem.target, resonance), split.fit))
    floors = problem_floors(parts, case.noise, case.seed)
    return [replace(stage, sigma=np.maximum(floor, 1e-12)) for stage, floor in zip(found, floors, strict=True)]


def _with_resonance(case: Case, problem: Problem, split: Split) -> tuple[Problem, DriveResonance | None]:
    """A force stage with the delay that its recordings show beside the resonance of the drive, and that resonance.

    Other stages stay as they are, and those of an arm, where other axes move the force as well.
    """
    settings = problem.force_filter
    if settings is None or (model := compile_plant(case.plant)).rigid is not None:
        return problem, None
    axis = model.machine.axis(problem.target)
    resonance = drive_resonance(split.seen, axis, settings)
    if resonance is None:
        return problem, None
    settings = replace(settings, delay=drive_delay(split.seen, axis, settings, resonance))
    delayed = force_problem(model, axis, (*split.seen, *split.held_out), settings)
    return delayed, drive_resonance(split.seen, axis, settings) or resonance


def _with_spring(case: Case, axis: str, resonance: DriveResonance) -> Array:
    """The vector of the plant with a flexible drive: near its antiresonance, noise of the motion causes most of the noise."""
    theta = case.theta.copy()
    for name, value in resonance.parameters.items():
        (places,) = parameter_indices(case.plant.machine.axis_names, resonance.effect, axis, None, name)
        theta[places] = value
    return theta


def stage_split(case: Case, problem: Problem) -> Split:
    """The recordings of a stage by role: those of motion, and static poses where they excite it too."""
    split = case.split
    if problem.only is not None:
        split = Split(*(tuple(r for r in part if r.name in problem.only) for part in split.roles))
    if problem.poses:  # static poses show kinematics best
        poses = pose_split(case.dataset)
        split = Split((*split.fit, *poses.fit), (*split.select, *poses.select), (*split.held_out, *poses.held_out))
    return split


def held_out_of(case: Case) -> tuple[Recording, ...]:
    """The recordings on which the result is proven; of a dataset of static poses alone, its held-out poses."""
    return pose_split(case.dataset).held_out if is_pose_set(case.dataset) else case.split.held_out


def untested_forces(case: Case, stages: Sequence[Stage]) -> tuple[str, ...]:
    """Notes on force axes without a stage: they have to move in a recording of each role."""
    tested = [stage.problem.target for stage in stages if stage.problem.force_filter is not None]
    return tuple(
        f"{axis} is not tested: it has to move, measured with its force, in a recording of each role"
        + (f" ({lacking})" if lacking else "")
        for axis, lacking in _untested_forces(case.plant, case.split, tested).items()
    )


def _untested_forces(plant: Plant, split: Split, tested: Sequence[str]) -> dict[str, ExcitationError | None]:
    """Force axes that are not ``tested``, and what a recording lacks for it."""
    axes = [axis for axis in plant.machine.axes if axis.actuation == "force" and axis.name not in tested]
    if not axes:
        return {}
    model = compile_plant(plant)
    return {axis.name: why_no_force(model, axis, split) for axis in axes}


def force_comparisons(stages: Sequence[Stage]) -> tuple[ForceComparison, ...]:
    """The filter of every force stage."""
    found = []
    for stage in stages:
        settings, recordings = stage.problem.force_filter, stage.split.seen
        if settings is not None and recordings:
            delay = settings.delay / recordings[0].rate_hz
            found.append(ForceComparison(stage.problem.target, settings.force_hz, settings.position_hz, delay))
    return tuple(found)


def stage_candidates(case: Case, stage: Stage) -> list[Candidate]:
    """Every effect that may be missing at the stage, excited or not."""
    problem = stage.problem
    scales = _scales_of(case.plant, stage)
    found = candidates_at(case.plant, stage.theta, problem.kind.stages, problem.targets, scales)
    found += candidates_at(case.plant, stage.theta, ("links",), problem.carried, scales)
    found = [c for c in found if _has_nominal(c, case.plant, problem, scales)]
    if stage.resonance is not None:
        # A spring reverses the motor several times in each motion, where errors of its damping and of the delay of the force
        # hide the shape of dry friction at low speeds.
        found = [c for c in found if coulomb_friction.EFFECT.name not in c.effect.generalises]
    spins = len(problem.carried) == len(case.plant.machine.axes) and not scales.loads.get(problem.target)
    return problem.kind.distinct(found, compile_plant(case.plant), spins)


def excitation(case: Case, stages: list[Stage]) -> tuple[Excitation, ...]:
    """For every candidate, whether the fit and selection recordings excite it."""
    found = {}
    for stage in stages:
        for candidate in stage_candidates(case, stage):
            if candidate.key not in found:  # the same for all forms of an effect
                found[candidate.key] = excitation_of(candidate, stage.split.seen, case.plant.machine)
    return tuple(found.values())


def _has_nominal(candidate: Candidate, plant: Plant, problem: Problem, scales: Scales) -> bool:
    """Whether the plant has what the effect acts by: links with masses, gravity on a link about its own joint, an inertia.

    An effect that the adjusted parameters of links contain is compared without links only. A link whose weight does not load
    the joint of a servo acts on it as the rotor does.
    """
    effect, target = candidate.effect, candidate.target
    if effect.ratio_of == "mass" and target in problem.carried:
        rotates_alone = target == problem.target and not scales.loads.get(target)
        return not (rotates_alone and plant.machine.axis(target).inertia)
    if (effect.of_links, effect.in_links)[moves_masses(plant.machine)]:
        return False
    if effect.ratio_of == "mass":
        return bool(scales.loads.get(target))
    if effect.ratio_of == "damping":
        servo = plant.machine.axis(target).servo
        return servo is not None and servo.kv > 0.0
    return effect.ratio_of != "inertia" or bool(plant.machine.axis(target).inertia)


def _scales_of(plant: Plant, stage: Stage) -> Scales:
    """Typical force and gravity loads in the fit recordings; a load below a thousandth of the largest counts as zero."""
    force = _typical_force(stage) if "force" in stage.problem.kind.stages else 1.0
    loads = [gravity_load(plant.machine, r) for r in stage.split.fit]

    def sizes(load: Array, i: int, first: int, last: int) -> Array:
        return np.abs(np.nan_to_num(load[first:last, i]))

    axes = range(len(plant.machine.axes))
    typical = np.array([median_of([(len(load), functools.partial(sizes, load, i)) for load in loads]) for i in axes])
    typical[typical < 1e-3 * typical.max()] = 0.0
    return Scales(force, dict(zip(plant.machine.axis_names, map(float, typical), strict=True)), _responses(plant, stage))


def _typical_force(stage: Stage) -> float:
    """Median of the commanded forces; of those of the simulation at the measured motion, where none is commanded.

    Of a servo, whose force is not measured, it is that of the described controller at the measured motion.

    Where most are at rest (below a thousandth of the largest), it is the median of the others; zero without any force.
    """
    problem = stage.problem

    def commanded(recording: Recording) -> Array:
        return problem.measured(recording)[:, 0]

    def simulated(recording: Recording) -> Array:
        return problem.predict(stage.theta[None], recording)[0, :, 0]

    for force in (commanded, simulated) if problem.force is None else (problem.force,):
        sizes = np.abs(np.concatenate([force(recording) for recording in stage.split.fit]))
        sizes = sizes[~np.isnan(sizes)]
        acting = sizes[sizes > 1e-3 * sizes.max(initial=0.0)]
        if len(acting):
            return float(np.median(sizes if 2 * len(acting) > len(sizes) else acting))
    return 0.0


def _responses(plant: Plant, stage: Stage) -> dict[tuple[str, str], Mapping[str, float]]:
    """Start values of drives with a spring: those that the response shows, else those of the plant."""
    axis = stage.problem.target
    shown = stage.oscillation or stage.resonance
    if shown is not None:
        return {(shown.effect, axis): shown.parameters}
    known = plant.effect(DriveResonance.effect, axis) if axis in plant.machine.axis_names else None
    if known is None:
        return {}
    return {(known.name, axis): {k: float(v) for k, v in known.parameters.items() if isinstance(v, float | int)}}


def on_itself(result: StageResult, stage: Stage, theta: Array) -> StageResult:
    """A result found on a surrogate of the stage, fitted to the stage itself."""
    seen = Data(stage.problem, stage.split.seen, stage.sigma)
    unseen = Data(stage.problem, stage.split.select, stage.sigma)
    fit = fit_candidates(seen, theta, result.fit.candidates, [result.fit.values])  # noqa: PD011
    nominal, final = (spread_of(unseen.residuals(values[None])) for values in (theta, fit.theta))
    return replace(result, problem=stage.problem, fit=fit, nominal_rmse=nominal, final_rmse=final, names_alone=None)
