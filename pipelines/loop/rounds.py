"""The loop: deploy → flight log → dataset → gap → repaired plant → deploy again, until nothing more is named.

The next round has the named effects of the repaired plant only (:func:`loop.models.named_part`).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from loop.deployment import USUAL, WIDE, Deployment
from loop.flight import SIGNALS, Flight, fly, simulate
from loop.models import named_part, register_forward, register_plant
from loop.recording import ingest_flights
from loop.sealed import SealedMachine
from sysid.datasets import Dataset
from sysid.gap import GapResult, find_gap
from sysid.gap.experiment import Experiment, Planning, write_experiment
from sysid.machine import load_machine
from sysid.plant import Plant, nominal_plant, plant_from_files
from sysid.workspace import Workspace, open_workspace

#: Paths of each deployment; the figures are those of the first helix and of the circle. The third run is the first round's
#: held-out recording.
PATHS = ("helix", "circle", "helix")
#: Rest at the beginning of a path, in which the tool stops swinging [s].
SETTLE_S = 15.0
#: Most repairs.
MOST = 3


@dataclass(frozen=True)
class Round:
    """One deployment and what its logs led to.

    Args:
        flights, simulated: path → run on the machine, and on the plant of the deployment.
        gap: result of the gap workflow on all logs so far; None after the last round.
        seconds: wall time of the steps.
        cpu_seconds: processor time of all steps.
        experiments: recordings that the gap workflow of the round before proposed, made in this round.
    """

    plant: str
    flights: Mapping[str, Flight]
    simulated: Mapping[str, Flight]
    gap: GapResult | None
    seconds: Mapping[str, float]
    cpu_seconds: float
    experiments: tuple[str, ...] = ()


@dataclass
class Site:
    """A sealed machine with its owner's description, logs and workspace; seeds of the runs count up.

    Args:
        machine: sealed; only the bench reads its ``real`` part.
    """

    machine: SealedMachine
    folder: Path
    runs: int = 0
    workspace: Workspace = field(init=False)

    def __post_init__(self) -> None:
        self.workspace = open_workspace(self.folder / "workspace")

    @property
    def description(self) -> Path:
        return self.folder / "site"

    @property
    def logs(self) -> Path:
        return self.folder / "flights"

    def nominal(self) -> Plant:
        """The plant of the owner's description, registered."""
        return self.registered(nominal_plant(load_machine(self.description / "machine.toml")))

    def registered(self, plant: Plant, lineage: Mapping[str, str] | None = None) -> Plant:
        """The plant as a version of the workspace, with its sources."""
        return replace(plant, reference=register_plant(self.workspace.models, plant, lineage or {}))

    def dataset(self) -> Dataset:
        """A version with all logs so far."""
        return ingest_flights(self.logs, self.machine.visible, tuple(SIGNALS), self.folder / "workspace")

    def plant(self, reference: str) -> Plant:
        return plant_from_files(self.workspace.models.load(reference).files, reference)

    def deployment(self, plant: Plant, identified: bool = True) -> Deployment:
        """Inverse kinematics and the controller of a registered plant, its setpoints shaped against the swing that it has.

        Args:
            identified: from logs of the machine; if not, the thresholds of the checks are wide.
        """
        shaper = "none" if plant.effect("gripper_sway", "tool") is None else "zv"
        forward = register_forward(self.workspace.models, plant)
        return Deployment(plant.reference, forward, checks=USUAL if identified else WIDE, shaper=shaper)

    def fly(self, deployment: Deployment, task: Mapping[str, Any], logs: Path | None = None) -> Flight:
        """A run on the machine, with its recording below ``logs``, by default the folder that is ingested."""
        self.runs += 1
        models = self.workspace.models
        return fly(self.machine.real, self.description, logs or self.logs, models, deployment, task, self.runs)


def path_task(path: str) -> dict[str, Any]:
    """The task of the runner to follow a path, after the tool has come to rest."""
    return {"mode": "track", "track": {"path": path, "settle_s": SETTLE_S}}


def fly_paths(site: Site, deployment: Deployment, paths: Sequence[str], logs: Path | None = None) -> dict[str, Flight]:
    """The first run of each path on the machine.

    Raises:
        SettingsError: the runner refuses a path, e.g. since it exceeds the top speed of the plant.
    """
    flights: dict[str, Flight] = {}
    for path in paths:
        flight = site.fly(deployment, path_task(path), logs)
        flights.setdefault(path, flight)
    return flights


def simulate_paths(site: Site, plant: Plant) -> dict[str, Flight]:
    """The same on the plant itself."""
    deployment, models = site.deployment(plant), site.workspace.models
    return {path: simulate(plant, site.description, models, deployment, path_task(path)) for path in dict.fromkeys(PATHS)}


def fly_experiments(site: Site, deployment: Deployment, experiments: Sequence[Experiment]) -> tuple[str, ...]:
    """Run proposed experiments on the machine, as often as each is needed; returns their names, one for each run."""
    made = []
    for experiment in experiments:
        path = write_experiment(site.folder / "experiments", experiment)
        for _ in range(experiment.repeats):
            site.fly(deployment, {"mode": "experiment", "experiment": {"file": str(path)}})
            made.append(experiment.name)
    return tuple(made)


def close_gap(site: Site, show: Callable[[str], None], planning: Planning | None = None) -> list[Round]:
    """Rounds until nothing more is named, at most :data:`MOST` repairs.

    A repair is deployed whether it is promoted or not: the version before it has adjusted values without a name, which the
    deployed plant has not, and may be closer in a signal that hides nothing.

    Args:
        planning: with it, every round also makes the recordings that the gap workflow of the round before proposed.
    """
    plant, rounds = site.nominal(), []
    experiments: Sequence[Experiment] = ()
    for number in range(MOST + 1):
        begin, cpu_begin = time.perf_counter(), time.process_time()
        deployment = site.deployment(plant, identified=bool(rounds) and plant.reference != rounds[0].plant)
        flights, simulated = fly_paths(site, deployment, PATHS), simulate_paths(site, plant)
        made = fly_experiments(site, deployment, experiments)
        seconds = {"deploy": time.perf_counter() - begin}
        show(f"round {number}, {plant.reference}: helix {flights['helix'].figures()}")
        gap = None
        if number < MOST:
            begin = time.perf_counter()
            dataset = site.dataset()
            seconds["ingest"], begin = time.perf_counter() - begin, time.perf_counter()
            gap = find_gap(dataset, plant, site.workspace.models, add=True, world=False, planning=planning)
            site.workspace.keep_gap(dataset, gap)
            seconds["gap"] = time.perf_counter() - begin
            show("named: " + (", ".join(f"{effect.name} on {effect.target}" for effect in gap.effects) or "nothing"))
        rounds.append(Round(plant.reference, flights, simulated, gap, seconds, time.process_time() - cpu_begin, made))
        if gap is None:
            return rounds
        experiments = gap.experiments
        if gap.effects:
            plant = site.registered(named_part(site.plant(gap.plant_after), gap), {"plant": gap.plant_after})
        elif not experiments:
            return rounds
    raise AssertionError("the last round returns")
