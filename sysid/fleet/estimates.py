"""The effects of a fleet: those that the gap workflow names on one machine, stored by the plant under test, and their values,
estimated on every recording of one machine.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from sysid.config import parse_settings
from sysid.datasets.recording import Dataset, Recording
from sysid.effects.units import parameter_unit
from sysid.files import json_text, write_durably
from sysid.fleet.effects import FleetEffect, ParameterHistory
from sysid.fleet.result import FleetMachine
from sysid.gap.candidates import Candidate
from sysid.gap.data import Data
from sysid.gap.drift import to_bins
from sysid.gap.fit import Fit, fit_candidates, starting_values
from sysid.gap.intervals.criterion import criterion_at, curvature_at
from sysid.gap.prepare.case import Case, Stage, open_case, stage_candidates
from sysid.gap.problem import Problem, for_recordings
from sysid.plant import Plant, compile_plant
from sysid.progress import Progress, part, silent
from sysid.registry.version import sha256
from sysid.workspace import Workspace, open_workspace

Array = npt.NDArray[np.float64]


def name_effects(location: str, reference: str, plant: str | None) -> FleetMachine:
    """Task: the gap of one machine, from a stored result of this dataset version and plant if there is one.

    Args:
        plant: a registered plant; by default the nominal one of the dataset.
    """
    from sysid.gap import find_gap

    place = open_workspace(location)
    dataset = place.dataset(reference)
    tested = place.plant(dataset, plant)
    stored = place.gap(dataset)
    if stored is not None and place.tests(stored, tested):
        return _machine(dataset, stored.verdict, stored.effects)
    own = _own_file(place, dataset, tested)
    if own.exists():
        return parse_settings(json.loads(own.read_text("utf-8")), FleetMachine, own)
    result = find_gap(dataset, tested, place.models)
    if stored is None:
        place.keep_gap(dataset, result)  # for the report; one of another plant is not replaced
    machine = _machine(dataset, result.verdict, result.effects)
    write_durably(own, json_text(asdict(machine)).encode(), "fleet", "Make room in the workspace, and call again.")
    return machine


def _machine(dataset: Dataset, verdict: Any, effects: Any) -> FleetMachine:
    return FleetMachine(dataset.reference, verdict, tuple(map(FleetEffect.of, effects)))


def plant_sha256(plant: Plant) -> str:
    """Content address of a plant, by its files."""
    hashes = {file: sha256(content) for file, content in plant.to_files().items()}
    return sha256(json.dumps(hashes, sort_keys=True).encode())


def _own_file(place: Workspace, dataset: Dataset, plant: Plant) -> Path:
    """The names by this plant, in the results of the dataset version."""
    return place.output(f"fleet-{plant_sha256(plant)[:16]}.json", dataset)


#: A standard deviation above so many negligible changes: the recording does not determine the parameter. The prior of an
#: unknown in the curvature of a fit is a thousand of them wide.
UNDETERMINED = 100.0
#: Fewest degrees of freedom of the residuals of a recording, whose scatter is then known to 22 % (1/√(2·FREEDOM)): with none
#: left the fit is exact and the deviation zero.
FREEDOM = 10
#: 97.5 % quantile of the normal distribution.
_Z = float(stats.norm.ppf(0.975))


def estimate(
    dataset: Dataset,
    plant: Plant,
    effects: Sequence[FleetEffect],
    seed: int = 0,
    progress: Progress = silent,
    later: Sequence[Recording] = (),
) -> tuple[ParameterHistory, ...]:
    """Values of the effects in every recording that determines them.

    The effects of a stage are fitted together to all recordings of the machine, and from there to each recording alone, with
    the covariance of its own residuals (:mod:`sysid.gap.intervals.criterion`).

    Args:
        plant: the simulation of the type, the same for all machines.
        later: recordings of the same machine after those of the dataset. If there are any, only they get values, from the fit
            to the dataset; each is independent of the others. Their hours continue those of the dataset.

    Raises:
        ExcitationError: no stage is measured at both ends.
    """
    case, stages = open_case(dataset, plant, seed)
    ordered = _in_time(case)
    counted = (*ordered, *later)
    hours = np.cumsum([len(r) / r.rate_hz for r in counted]) / 3600.0
    ends = {recording.name: float(end) for recording, end in zip(counted, hours, strict=True)}
    found: list[ParameterHistory] = []
    for number, stage in enumerate(stages):
        chosen = _chosen(case, stage, effects)
        if chosen:
            own = part(progress, number / len(stages), (number + 1) / len(stages))
            found += _of_stage(case, stage, chosen, ordered, later, ends, own)
    progress(1.0, "estimated")
    return tuple(found)


def _in_time(case: Case) -> tuple[Recording, ...]:
    """The recordings of motion, of all roles, in the order of time; without stamps in the order of the dataset."""
    names = {recording.name: number for number, recording in enumerate(case.dataset.recordings)}
    return tuple(sorted((*case.split.seen, *case.split.held_out), key=lambda r: (r.start_ns, names[r.name])))


def _chosen(case: Case, stage: Stage, effects: Sequence[FleetEffect]) -> list[tuple[FleetEffect, Candidate]]:
    """The effects that belong to a stage, each with its candidate."""
    candidates = stage_candidates(case, stage)
    pairs = []
    for effect in effects:
        same = [c for c in candidates if c.key == effect.key]
        exact = [c for c in same if set(effect.parameters) <= set(c.form.names)]
        if same:
            pairs.append((effect, (exact or same)[0]))
    return pairs


def _of_stage(
    case: Case,
    stage: Stage,
    chosen: Sequence[tuple[FleetEffect, Candidate]],
    ordered: Sequence[Recording],
    later: Sequence[Recording],
    ends: dict[str, float],
    progress: Progress,
) -> list[ParameterHistory]:
    candidates = [candidate for _, candidate in chosen]
    problem = stage.problem
    recordings = _compared(problem, ordered)
    progress(0.0, f"{stage.label}: all recordings")
    whole = fit_candidates(
        Data(problem, recordings, stage.sigma), stage.theta, candidates, starting_values(candidates, [], case.seed)
    )
    if later:
        problem = for_recordings(problem, compile_plant(case.plant), later)
        recordings = _compared(problem, later)
    values, deviations = np.full((2, len(recordings), len(whole.unknowns)), np.nan)
    for k, recording in enumerate(recordings):
        progress((k + 1) / (len(recordings) + 1), f"{stage.label}: {recording.name}")
        values[k], deviations[k] = _of_recording(Data(problem, (recording,), stage.sigma), stage.theta, whole)
    found = []
    for effect, candidate in chosen:
        rows = whole.rows_of(candidate)
        for unknown, at in zip(candidate.unknowns, range(rows.start, rows.stop), strict=True):
            known = deviations[:, at] <= UNDETERMINED * unknown.negligible
            kept = [r.name for r, there in zip(recordings, known, strict=True) if there]
            unit = parameter_unit(
                effect.name, unknown.key.partition("[")[0], effect.target, case.plant.machine, case.dataset.units
            )
            found.append(
                ParameterHistory(
                    case.dataset.name, effect, unknown.key, unit, unknown.negligible, tuple(kept),
                    tuple(ends[name] for name in kept), tuple(map(float, values[known, at])),
                    tuple(map(float, deviations[known, at])),
                )
            )  # fmt: skip
    return found


def _compared(problem: Problem, recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings in which the stage can be compared."""
    return [r for r in recordings if problem.only is None or r.name in problem.only]


def _of_recording(data: Data, theta: Array, whole: Fit) -> tuple[Array, Array]:
    """Values (k,) fitted to one recording, from those of all, and their standard deviations; NaN if it has too few samples."""
    bins = [to_bins(data.problem.measured(recording), data.problem.rate(recording)) for recording in data.recordings]
    if sum(np.count_nonzero(~np.isnan(own)) for own in bins) < len(whole.unknowns) + FREEDOM:
        return np.full(len(whole.unknowns), np.nan), np.full(len(whole.unknowns), np.nan)
    fit = fit_candidates(data, theta, whole.candidates, [whole.values])
    curvature = curvature_at(criterion_at(data, theta, fit.unknowns, fit.values), fit.values)
    return fit.values, curvature.halves / _Z
