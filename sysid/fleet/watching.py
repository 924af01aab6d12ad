"""Watching one machine: its effects are named once, and estimated in every recording that arrives after that.

The state is a file of the workspace: the dataset version at which watching began, the effects, and their values in every
recording so far. A call estimates the recordings that the newest version has beyond those; each value follows from its own
recording and the version of the beginning, so that it does not depend on how many arrive at once.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from sysid.errors import SettingsError, StoreError
from sysid.files import json_text, write_durably
from sysid.fleet.arrivals import QUIET_S, Arrivals, take_in
from sysid.fleet.differences import differences
from sysid.fleet.drift import Drift, drifts
from sysid.fleet.effects import ParameterHistory, union
from sysid.fleet.estimates import estimate, in_time
from sysid.fleet.machines import exact_references
from sysid.fleet.names import name_effects, plant_sha256
from sysid.fleet.result import FleetMachine, FleetResult
from sysid.names import check_dataset_name
from sysid.progress import Progress, part, silent
from sysid.workspace import Workspace, open_workspace

#: Accepted false alarms of the machine in 1000 hours of recorded motion.
FALSE_ALARMS = 1.0


@dataclass(frozen=True)
class WatchState:
    """What is kept between two calls.

    Args:
        machine: the version at which watching began, and the watched effects.
        plant: sha256 of the files of the plant under test.
        recordings: evaluated so far, with those of the beginning; ``hours``: of their motion.
    """

    machine: FleetMachine
    plant: str
    recordings: tuple[str, ...]
    hours: float
    histories: tuple[ParameterHistory, ...]

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> WatchState:
        histories = tuple(map(ParameterHistory.from_json, values["histories"]))
        machine = FleetMachine.from_json(values["machine"])
        return cls(machine, values["plant"], tuple(values["recordings"]), values["hours"], histories)

    def to_json(self) -> dict[str, Any]:
        return {
            "schema": 1,
            "machine": self.machine.to_json(),
            "plant": self.plant,
            "recordings": list(self.recordings),
            "hours": self.hours,
            "histories": [history.to_json() for history in self.histories],
        }


@dataclass(frozen=True)
class WatchResult:
    """Result of :func:`watch`.

    Args:
        fleet: the machine as a fleet of one, with all values so far and the drifts in them.
        dataset: the newest version. new: recordings that this call evaluated. arrivals: what it found in the log folders.
    """

    fleet: FleetResult
    dataset: str
    new: tuple[str, ...]
    arrivals: Arrivals

    @property
    def noticed(self) -> tuple[Drift, ...]:
        """The drifts that a recording of this call made known."""
        return tuple(drift for drift in self.fleet.drifts if drift.noticed in self.new)

    def to_json(self) -> dict[str, Any]:
        return {
            **self.fleet.to_json(),
            "dataset": self.dataset,
            "new": list(self.new),
            "noticed": [drift.to_json() for drift in self.noticed],
            "added": list(self.arrivals.added),
            "waiting": list(self.arrivals.waiting),
            "left_out": [{"recording": name, "reason": why} for name, why in self.arrivals.left_out],
        }


def watch(
    location: str | Path,
    name: str,
    folders: Sequence[Path] = (),
    plant: str | None = None,
    *,
    like: Sequence[str] = (),
    false_alarms_per_1000_hours: float = FALSE_ALARMS,
    quiet_s: float = QUIET_S,
    restart: bool = False,
    progress: Progress = silent,
) -> WatchResult:
    """Take in the recordings that arrived, estimate the named effects in them, and report those that drift.

    The first call names the effects on the newest version of the dataset, before it looks into the folders.

    Args:
        name: of the dataset, without a version.
        folders: log folders; their complete recordings are appended to the dataset.
        plant: the simulation under test; by default the nominal one.
        like: datasets of other machines of the type, whose named effects are watched as well; used when watching begins.
        quiet_s: a log without an end is complete if nothing was written to it for so long [s].
        restart: begin again at the newest version.

    Raises:
        SettingsError: a version in the name, another plant than at the beginning, or a newest version that does not continue
            the one of the beginning.
        InputError: a folder is missing.
        StoreError: no such dataset or plant.
    """
    if not false_alarms_per_1000_hours > 0.0:
        raise SettingsError("watch", f"{false_alarms_per_1000_hours} false alarms in 1000 h", "a positive rate")
    check_dataset_name(name, remedy="Name the dataset without a version: recordings are added to its newest one.")
    place = open_workspace(location)
    state = None if restart else _stored(place, name)
    if state is None:
        state = _begin(place, name, plant, like, part(progress, 0.0, 0.5))
        _keep(place, name, state)
    held = _base_names(_recordings(place, name))
    arrivals = take_in(folders, str(location), name, held, quiet_s, part(progress, 0.5, 0.8)) if folders else Arrivals()
    state, new = _continued(place, name, plant, state, part(progress, 0.8, 1.0))
    if new:
        _keep(place, name, state)
    progress(1.0, "done")
    changes = drifts(state.histories, false_alarms_per_1000_hours / 1000.0)
    values = differences(state.histories)
    fleet = FleetResult(
        (state.machine,), state.machine.effects, state.histories, values, changes, false_alarms_per_1000_hours, 0.0
    )
    return WatchResult(fleet, f"{name}@{place.datasets.manifest(name)['version']}", new, arrivals)


def _begin(place: Workspace, name: str, plant: str | None, like: Sequence[str], progress: Progress) -> WatchState:
    """The state at the newest version, with the effects of this machine and of those like it."""
    machines = []
    for number, reference in enumerate(exact_references(place, (name, *like))):
        progress(0.8 * number / (1 + len(like)), f"{reference}: naming its effects")
        machines.append(FleetMachine.from_json(name_effects(str(place.location), reference, plant)))
    machine = replace(machines[0], effects=union(item.effects for item in machines))
    dataset = place.dataset(machine.dataset)
    tested = place.plant(dataset, plant)
    histories = estimate(dataset, tested, machine.effects, progress=part(progress, 0.8, 1.0)) if machine.effects else ()
    motion = dataset.of_kind("motion")
    names = tuple(recording.name for recording in dataset.recordings)
    hours = sum(len(recording) / recording.rate_hz for recording in motion) / 3600.0
    return WatchState(machine, plant_sha256(tested), names, hours, histories)


def _continued(
    place: Workspace, name: str, plant: str | None, state: WatchState, progress: Progress
) -> tuple[WatchState, tuple[str, ...]]:
    """The state with the recordings of the newest version that it does not have, and their names.

    Raises:
        SettingsError: see :func:`watch`.
    """
    listed = _recordings(place, name)
    begun, where = state.machine.dataset, f"watch {name}"
    remedy = "Begin again with --restart."
    if missing := [recording for recording in state.recordings if recording not in listed]:
        found = f"{name}@{place.datasets.manifest(name)['version']} without recording {missing[0]}"
        raise SettingsError(where, found, f"a version that continues {begun}", remedy)
    later = [recording for recording in listed if recording not in state.recordings]
    base = place.dataset(begun)
    tested = place.plant(base, plant)
    if plant_sha256(tested) != state.plant:
        raise SettingsError(where, "another simulation than at its beginning", "the same one", remedy)
    if not later:
        return state, ()
    progress(0.0, f"{name}: {len(later)} new recordings")
    loaded = place.datasets.load(name, later)
    motion = in_time(loaded.of_kind("motion"), listed)
    hours, ends = state.hours, {}
    for recording in motion:
        hours += len(recording) / recording.rate_hz / 3600.0
        ends[recording.name] = hours
    histories = state.histories
    if motion and state.machine.effects:
        values = estimate(base, tested, state.machine.effects, progress=progress, later=motion)
        histories = tuple(_joined(own, values, ends) for own in state.histories)
    ordered = list(ends)
    rest = [recording for recording in later if recording not in ordered]
    return WatchState(state.machine, state.plant, (*state.recordings, *ordered, *rest), hours, histories), tuple(later)


def _joined(history: ParameterHistory, found: Sequence[ParameterHistory], ends: Mapping[str, float]) -> ParameterHistory:
    """A history with the values that were found later; ``ends``: hours of motion up to the end of each recording."""
    for more in found:
        if (more.effect, more.parameter) == (history.effect, history.parameter):
            return replace(
                history,
                recordings=history.recordings + more.recordings,
                ends=history.ends + tuple(ends[name] for name in more.recordings),
                values=history.values + more.values,
                deviations=history.deviations + more.deviations,
            )
    return history


def _recordings(place: Workspace, name: str) -> list[str]:
    """The recordings of the newest version."""
    return [item["name"] for item in place.datasets.manifest(name)["recordings"]]


def _base_names(recordings: Sequence[str]) -> set[str]:
    """Names before a recording was cut into blocks."""
    return {name.partition("#")[0] for name in recordings}


def _path(name: str) -> str:
    return f"fleet/watch/{name}.json"


def _stored(place: Workspace, name: str) -> WatchState | None:
    """The state of the last call.

    Raises:
        StoreError: it is damaged.
    """
    path = _path(name)
    if place.root.kind(path) != "file":
        return None
    try:
        return WatchState.from_json(json.loads(place.root.read(path)))
    except (ValueError, KeyError, TypeError) as error:
        where = str(place.root.path(path))
        raise StoreError(where, f"not readable ({error})", "the state of a watch", "Begin again with --restart.") from None


def _keep(place: Workspace, name: str, state: WatchState) -> None:
    content = json_text(state.to_json()).encode()
    write_durably(place.output(_path(name)), content, "watch", "Make room in the workspace, and call again.")
