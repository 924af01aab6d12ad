"""Watching one machine: its effects are named once, and estimated in every recording that arrives after that.

The state is a file of the workspace: the dataset version at which watching began, the effects, and their values in every
recording so far. A call estimates the recordings that the newest version has beyond those, or with other content. Each value
follows from its own recording and the version of the beginning, and later recordings are in the order of their time stamps: the
state follows from these two versions, however many recordings arrived at once and wherever a call was interrupted.
"""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Literal, TypeVar

from sysid.config import Strict, parse_settings
from sysid.datasets.recording import Recording
from sysid.datasets.versions.manifest import Manifest, contents_of
from sysid.errors import SettingsError, StoreError
from sysid.files import json_text, write_durably
from sysid.fleet.arrivals import QUIET_S, Arrivals, SeenLogs, take_in
from sysid.fleet.differences import differences
from sysid.fleet.drift import Drift, drifts
from sysid.fleet.effects import FleetEffect, ParameterHistory, union
from sysid.fleet.estimates import estimate, name_effects, plant_sha256
from sysid.fleet.result import FleetMachine, FleetResult
from sysid.fleet.workflow import FALSE_ALARMS, exact_references
from sysid.foreign import MAX_NAME, visible
from sysid.names import check_dataset_name, uncut_name
from sysid.numbers import NonNegative
from sysid.parse import parse_json
from sysid.progress import Progress, part, silent
from sysid.workspace import Workspace, open_workspace

#: Recordings between two writes of the state, so that a process that is killed loses no more work than that.
BATCH = 32
#: Bytes of a file of state.
_MOST = 2**28

T = TypeVar("T")


@dataclass(frozen=True)
class WatchedRecording(Strict):
    """A recording whose values are known.

    Args:
        content: digest of its raw files.
        start_ns: its first stamp.
        hours: of its motion; 0 for static poses.
    """

    name: str
    content: str
    start_ns: int
    hours: NonNegative


@dataclass(frozen=True)
class ReportedDrift(Strict):
    """A drift that a call has reported: the parameter, and the recording that made it known."""

    effect: FleetEffect
    parameter: str
    noticed: str


@dataclass(frozen=True)
class WatchState(Strict):
    """What is kept between two calls.

    Args:
        machine: the version at which watching began, and the watched effects.
        plant: sha256 of the files of the plant under test.
        recordings: evaluated so far, with those of the beginning, in the order of their time stamps.
        reported: drifts that a call has reported.
    """

    schema: Literal[2]
    machine: FleetMachine
    plant: str
    recordings: tuple[WatchedRecording, ...] = ()
    histories: tuple[ParameterHistory, ...] = ()
    reported: tuple[ReportedDrift, ...] = ()

    def __post_init__(self) -> None:
        """Check what the types do not say.

        Raises:
            ValueError: a history of other recordings or of another parameter, or one without a value for each.
        """
        known = {recording.name for recording in self.recordings}
        if len(known) < len(self.recordings):
            raise ValueError("each recording once")
        for history in self.histories:
            if not len(history.recordings) == len(history.ends) == len(history.values) == len(history.deviations):
                raise ValueError(f"one value for each recording of {history.parameter}")
            if history.parameter.partition("[")[0] not in history.effect.parameters:
                raise ValueError(f"a history of a parameter of {history.effect.name}, not of {history.parameter!r}")
            if unknown := [name for name in history.recordings if name not in known]:
                raise ValueError(f"histories of the recordings that are listed, not of {unknown[0]!r}")


@dataclass(frozen=True)
class WatchResult:
    """Result of :func:`watch`.

    Args:
        fleet: the machine as a fleet of one, with all values so far and the drifts in them.
        dataset: the newest version.
        new: recordings that this call evaluated; ``dropped``: those that the newest version does not hold any more.
        noticed: the drifts that no call has reported before.
        arrivals: what it found in the log folders.
    """

    fleet: FleetResult
    dataset: str
    new: tuple[str, ...]
    dropped: tuple[str, ...]
    noticed: tuple[Drift, ...]
    arrivals: Arrivals

    def to_json(self) -> dict[str, Any]:
        found = self.arrivals
        return {
            **self.fleet.to_json(),
            "dataset": self.dataset,
            "new": list(self.new),
            "dropped": list(self.dropped),
            "noticed": [asdict(drift) for drift in self.noticed],
            "added": list(found.added),
            "replaced": [{"recording": name, "by": by} for name, by in found.replaced],
            "repeated": [{"recording": name, "of": other} for name, other in found.repeated],
            "cut": [{"recording": name, "note": note} for name, note in found.notes],
            "waiting": list(found.waiting),
            "left_out": [{"recording": name, "reason": why} for name, why in found.left_out],
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
        folders: log folders; their complete recordings are added to the dataset.
        plant: the simulation under test; by default the nominal one.
        like: datasets of other machines of the type, whose named effects are watched as well; used when watching begins.
        quiet_s: a log without an end is complete if nothing changes in its recording for so long [s]; the call waits for it.
        restart: begin again at the newest version.

    Raises:
        SettingsError: a version in the name, another plant than at the beginning, or a newest version that does not continue
            the one of the beginning.
        InputError: a folder is missing.
        StoreError: no such dataset or plant, or a damaged state.
    """
    if not false_alarms_per_1000_hours > 0.0:
        raise SettingsError("watch", f"{false_alarms_per_1000_hours} false alarms in 1000 h", "a positive rate")
    rate = false_alarms_per_1000_hours / 1000.0
    check_dataset_name(name, remedy="Name the dataset without a version: recordings are added to its newest one.")
    place = open_workspace(location)
    state = _stored(place, _path(name), WatchState, "the state of a watch", "Begin again with --restart.", restart)
    if state is None:
        state = _begin(place, name, plant, like, rate, part(progress, 0.0, 0.3))
        _keep(place, _path(name), state)
    _check_continues(place, name, state)
    arrivals = Arrivals()
    if folders:
        remedy = "Remove it: the logs are then compared with the dataset again."
        seen = _stored(place, _seen_path(name), SeenLogs, "what a watch has seen", remedy, restart) or SeenLogs()
        fixed = contents_of(place.datasets.manifest(state.machine.dataset))
        arrivals, seen = take_in(folders, place.datasets, name, [*fixed], quiet_s, seen, part(progress, 0.3, 0.6))
        _keep(place, _seen_path(name), seen)
    state, new, dropped = _continued(place, name, plant, state, part(progress, 0.6, 1.0))
    progress(1.0, "done")
    changes = drifts(state.histories, rate)
    reported = _reported(changes)
    noticed = tuple(drift for drift, own in zip(changes, reported, strict=True) if own not in state.reported)
    if reported != state.reported:
        state = replace(state, reported=reported)
        _keep(place, _path(name), state)
    values = differences(state.histories)
    fleet = FleetResult(
        (state.machine,), state.machine.effects, state.histories, values, changes, false_alarms_per_1000_hours, 0.0
    )
    return WatchResult(fleet, f"{name}@{place.datasets.manifest(name)['version']}", new, dropped, noticed, arrivals)


def _begin(
    place: Workspace, name: str, plant: str | None, like: Sequence[str], false_alarms_per_hour: float, progress: Progress
) -> WatchState:
    """The state at the newest version, with the effects of this machine and of those like it."""
    machines = []
    for number, reference in enumerate(exact_references(place, (name, *like))):
        progress(0.8 * number / (1 + len(like)), f"{reference}: naming its effects")
        machines.append(name_effects(str(place.location), reference, plant))
    machine = replace(machines[0], effects=union(item.effects for item in machines))
    dataset = place.dataset(machine.dataset)
    tested = place.plant(dataset, plant)
    histories = estimate(dataset, tested, machine.effects, progress=part(progress, 0.8, 1.0)) if machine.effects else ()
    manifest = place.datasets.manifest(machine.dataset)
    state = WatchState(2, machine, plant_sha256(tested))
    state = _arranged(state, manifest, (), _watched(dataset.recordings, manifest), histories)
    return replace(state, reported=_reported(drifts(state.histories, false_alarms_per_hour)))


def _reported(changes: Iterable[Drift]) -> tuple[ReportedDrift, ...]:
    return tuple(ReportedDrift(drift.effect, drift.parameter, drift.noticed) for drift in changes)


def _watched(recordings: Sequence[Recording], manifest: Manifest) -> list[WatchedRecording]:
    contents = contents_of(manifest)
    return [
        WatchedRecording(
            recording.name,
            contents.get(uncut_name(recording.name, contents), ""),
            recording.start_ns,
            len(recording) / recording.rate_hz / 3600.0 if recording.kind == "motion" else 0.0,
        )
        for recording in recordings
    ]


def _check_continues(place: Workspace, name: str, state: WatchState) -> None:
    """Check that the newest version holds the recordings of the beginning as they were.

    Raises:
        SettingsError: it does not.
        StoreError: the version of the beginning is gone.
    """
    begun, newest = place.datasets.manifest(state.machine.dataset), place.datasets.manifest(name)
    contents, where = contents_of(newest), f"watch {name}"
    for recording, content in contents_of(begun).items():
        if contents.get(recording) != content:
            found = f"{name}@{newest['version']} {'with another' if recording in contents else 'without'} recording {recording}"
            expected = f"a version that continues {state.machine.dataset}"
            raise SettingsError(where, found, expected, "Begin again with --restart.")


def _continued(
    place: Workspace, name: str, plant: str | None, state: WatchState, progress: Progress
) -> tuple[WatchState, tuple[str, ...], tuple[str, ...]]:
    """The state of the newest version, written; the recordings that were evaluated, and those that are not in it any more.

    Raises:
        SettingsError: see :func:`watch`.
    """
    base = place.dataset(state.machine.dataset)
    tested = place.plant(base, plant)
    if plant_sha256(tested) != state.plant:
        other, remedy = "another simulation than at its beginning", "Begin again with --restart."
        raise SettingsError(f"watch {name}", other, "the same one", remedy)
    begun = {recording.name for recording in base.recordings}
    manifest = place.datasets.manifest(name)
    contents = contents_of(manifest)
    held = {item["name"]: contents.get(uncut_name(item["name"], contents), "") for item in manifest["recordings"]}
    kept = [own for own in state.recordings if held.get(own.name) == own.content]
    names = {own.name for own in kept}
    later = [recording for recording in held if recording not in names]
    dropped = tuple(own.name for own in state.recordings if own.name not in held)
    if kept != list(state.recordings):
        state = _arranged(state, manifest, begun, kept, state.histories)
        _keep(place, _path(name), state)
    for number in range(0, len(later), BATCH):
        share = part(progress, number / len(later), min(1.0, (number + BATCH) / len(later)))
        share(0.0, f"{name}: {len(later) - number} new recordings")
        loaded = place.datasets.load(f"{name}@{manifest['version']}", later[number : number + BATCH])
        motion = loaded.of_kind("motion")
        found: Sequence[ParameterHistory] = ()
        if motion and state.machine.effects:
            found = estimate(base, tested, state.machine.effects, progress=share, later=motion)
        recordings = (*state.recordings, *_watched(loaded.recordings, manifest))
        state = _arranged(state, manifest, begun, recordings, (*state.histories, *found))
        _keep(place, _path(name), state)
    return state, tuple(later), dropped


def _arranged(
    state: WatchState,
    manifest: Manifest,
    begun: Collection[str],
    recordings: Sequence[WatchedRecording],
    histories: Sequence[ParameterHistory],
) -> WatchState:
    """The state with these recordings and their values, those of the beginning first, else in the order of their time stamps.

    Blocks of one recording are together; without stamps the order is that of the dataset.

    Args:
        begun: recordings of the beginning.
        histories: of one parameter there may be several, with values of different recordings.
    """
    places = {item["name"]: number for number, item in enumerate(manifest["recordings"])}
    contents = contents_of(manifest)
    starts: dict[str, int] = {}
    for own in recordings:
        whole = uncut_name(own.name, contents)
        starts[whole] = min(own.start_ns, starts.get(whole, own.start_ns))

    def place(own: WatchedRecording) -> tuple[bool, int, int]:
        return own.name not in begun, starts[uncut_name(own.name, contents)], places[own.name]

    ordered = sorted(recordings, key=place)
    ends = dict(zip((own.name for own in ordered), itertools.accumulate(own.hours for own in ordered), strict=True))
    rows: dict[tuple[FleetEffect, str], dict[str, tuple[float, float]]] = {}
    for history in histories:
        rows.setdefault((history.effect, history.parameter), {}).update(_rows(history))
    parameters = {(history.effect, history.parameter): history for history in histories}
    joined = tuple(_with_rows(own, rows[key], ends) for key, own in parameters.items())
    return replace(state, recordings=tuple(ordered), histories=joined)


def _rows(history: ParameterHistory) -> dict[str, tuple[float, float]]:
    """Recording → value and standard deviation."""
    return dict(zip(history.recordings, zip(history.values, history.deviations, strict=True), strict=True))


def _with_rows(
    history: ParameterHistory, rows: Mapping[str, tuple[float, float]], ends: Mapping[str, float]
) -> ParameterHistory:
    """A history with these values; ``ends``: hours of motion up to the end of each recording, in their order."""
    names = tuple(name for name in ends if name in rows)
    values, deviations = (tuple(rows[name][column] for name in names) for column in (0, 1))
    return replace(history, recordings=names, ends=tuple(ends[name] for name in names), values=values, deviations=deviations)


def _path(name: str) -> str:
    return f"fleet/watch/{name}.json"


def _seen_path(name: str) -> str:
    return f"fleet/arrivals/{name}.json"


def _stored(place: Workspace, path: str, kind: type[T], what: str, remedy: str, restart: bool) -> T | None:
    """A file of state as the last call wrote it; None if there is none, or if it is to be begun again.

    Raises:
        StoreError: it is damaged, or something else is in its place.
    """
    where, found = place.root.folder / path, place.root.kind(path)
    if found is None:
        return None
    if found != "file":
        shown = "a folder" if found == "folder" else "a link" if found == "link" else "a pipe or a device"
        raise StoreError(where, f"is {shown}", f"a file with {what}", "Remove it, or move it elsewhere.")
    if restart:
        return None
    try:
        with place.root.open(path) as file:
            content = file.read(_MOST + 1)
        if len(content) > _MOST:
            raise ValueError(f"more than {_MOST} bytes")
        values = parse_json(content)
        if not isinstance(values, dict):
            raise ValueError("no JSON object")
        return parse_settings(values, kind, where)
    except (ValueError, SettingsError) as error:
        found_text = error.found if isinstance(error, SettingsError) else str(error)
        raise StoreError(where, f"damaged ({visible(found_text, MAX_NAME)})", what, remedy) from None


def _keep(place: Workspace, path: str, state: WatchState | SeenLogs) -> None:
    content = json_text(asdict(state)).encode()
    write_durably(place.output(path), content, "watch", "Make room in the workspace, and call again.")
