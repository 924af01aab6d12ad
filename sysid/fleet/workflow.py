"""The gap workflow over the machines of a fleet, one dataset each, all of one type: names, values by recording, differences,
drifts.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path

from sysid.errors import SettingsError
from sysid.execution import Executor, LocalExecutor
from sysid.fleet.differences import differences
from sysid.fleet.drift import drifts, since_last_change
from sysid.fleet.effects import FleetEffect, ParameterHistory, union
from sysid.fleet.estimates import estimate, name_effects
from sysid.fleet.result import FleetMachine, FleetResult
from sysid.machine import Machine, machine_from_files
from sysid.progress import Progress, part, silent
from sysid.workspace import Workspace, open_workspace


def exact_references(place: Workspace, references: Sequence[str]) -> list[str]:
    """The exact dataset versions of machines of one type.

    Raises:
        SettingsError: no machine, one that is named twice, or machines of different types.
    """
    if not references:
        raise SettingsError("fleet", "no machine", "the dataset of at least one")
    exact: dict[str, Machine] = {}
    for reference in references:
        dataset, machine = described(place, reference)
        if dataset.partition("@")[0] in {other.partition("@")[0] for other in exact}:
            raise SettingsError("fleet", f"{dataset.partition('@')[0]} twice", "one dataset for each machine")
        exact[dataset] = machine
        first, kind = next(iter(exact.items()))
        if _type_of(machine) != _type_of(kind):
            raise SettingsError(
                f"fleet: {dataset}", f"axes {_words(machine)}", f"those of {first}: {_words(kind)}",
                "Compare machines of one type.",
            )  # fmt: skip
    return list(exact)


def described(place: Workspace, reference: str) -> tuple[str, Machine]:
    """The exact dataset version and its machine, from the manifest: no table is read."""
    manifest = place.datasets.manifest(reference)
    exact = f"{manifest['name']}@{manifest['version']}"
    return exact, machine_from_files(manifest["machine"], f"dataset {exact}")


def _type_of(machine: Machine) -> tuple[tuple[str, str, str], ...]:
    """What machines of one type share: axes with their actuation and what it drives."""
    return tuple((axis.name, axis.actuation, axis.drives) for axis in machine.axes)


def _words(machine: Machine) -> str:
    return ", ".join(f"{axis.name} ({axis.actuation}, {axis.drives})" for axis in machine.axes)


#: Accepted false alarms of drift for each machine, in 1000 hours of recorded motion.
FALSE_ALARMS = 1.0


def fleet_gap(
    location: str | Path,
    references: Sequence[str],
    plant: str | None = None,
    executor: Executor | None = None,
    *,
    false_alarms_per_1000_hours: float = FALSE_ALARMS,
    progress: Progress = silent,
) -> FleetResult:
    """Name the effects that the simulation of a type lacks, on which of its machines they differ, and which of them drift.

    Args:
        location: the workspace, which every worker must reach.
        references: one dataset for each machine, ``name`` or ``name@version``.
        plant: the simulation; by default the nominal one of each dataset.
        executor: where the machines are evaluated; by default one after another in this process.

    Raises:
        SettingsError: no machine, one that is named twice, or machines of different types; a rate that is not positive.
    """
    begin = time.perf_counter()
    if not false_alarms_per_1000_hours > 0.0:
        raise SettingsError("fleet", f"{false_alarms_per_1000_hours} false alarms in 1000 h", "a positive rate")
    executor = executor or LocalExecutor()
    place, text = open_workspace(location), str(location)
    exact = exact_references(place, references)
    calls = [(text, reference, plant) for reference in exact]
    histories: list[ParameterHistory] = []
    with executor.kept() as kept:
        machines: list[FleetMachine] = kept.run(name_effects, calls, part(progress, 0.0, 0.7))
        effects = union(machine.effects for machine in machines)
        if effects:
            fits = [(text, reference, plant, effects) for reference in exact]
            for rows in kept.run(estimate_effects, fits, part(progress, 0.7, 1.0)):
                histories += rows
    progress(1.0, "done")
    changes = drifts(histories, false_alarms_per_1000_hours / 1000.0)
    return FleetResult(
        tuple(machines),
        effects,
        tuple(histories),
        differences([since_last_change(history, changes) for history in histories]),
        changes,
        false_alarms_per_1000_hours,
        time.perf_counter() - begin,
    )


def estimate_effects(
    location: str, reference: str, plant: str | None, effects: Sequence[FleetEffect]
) -> tuple[ParameterHistory, ...]:
    """Task: the values of the fleet's effects in every recording of one machine."""
    place = open_workspace(location)
    dataset = place.dataset(reference)
    return tuple(estimate(dataset, place.plant(dataset, plant), effects))
