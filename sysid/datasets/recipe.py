"""Ingest recipe (TOML): the mapping of fields of files to signals. Its keys are described in ``docs/recipes.md``."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Any, Literal

from sysid.config import Strict, inside, parse_settings, settings_text, toml_values
from sysid.errors import InputError, SettingsError, nearest
from sysid.logs.readers import reader_named
from sysid.logs.time_unit import SECONDS
from sysid.machine import Machine
from sysid.names import check_file_name, check_pattern
from sysid.numbers import Factor, Finite, Interval, NonNegative, Positive, Rate, Raw
from sysid.signals import POINTS, split_signal
from sysid.units import si_factor


@dataclass(frozen=True)
class SignalMap(Strict):
    """One field of a stream as a signal: ``SI = sign · scale · (raw − zero)/span · factor(unit) + offset``.

    Args:
        field: column (CSV, Parquet, MATLAB) or message field, e.g. ``position[boom]``, ``pose.position.x``.
        topic: MCAP topic; not used by the other readers.
        unit: of the value after zero, span and scale; None: that of the file, SI where it states none.
        zero, span: raw value at zero and raw span of one, for counts and duty cycles.
        scale: further factor, e.g. 35.15 N/V with ``unit = "N"``.
        offset: added at the end, in SI.
        modulus: period of the raw values where they wrap, e.g. 360, or 65536 for a counter of 16 bits; None: found from their
            steps; 0: they do not wrap.
        missing: raw values that stand for "no value", e.g. -9999.
        primary: False for a second source, which is used to align clocks and for checks, but is not in the dataset's tables.
    """

    field: str
    topic: str | None = None
    unit: str | None = None
    zero: Raw = 0.0
    span: Factor = 1.0
    scale: Factor = 1.0
    offset: Finite = 0.0
    sign: Literal[1, -1] = 1
    modulus: NonNegative | None = None
    missing: tuple[Finite, ...] = ()
    primary: bool = True


@dataclass(frozen=True)
class FramePose(Strict):
    """Surveyed pose of the capture frame in the machine's base frame; roll, pitch, yaw about fixed axes as in a URDF."""

    translation: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    rpy: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PointMap(Strict):
    """A rigid body, or a surveyed point ``at`` in its frame [m], or a single marker, as ``ee`` or ``tool``."""

    body: str | None = None
    at: tuple[Finite, Finite, Finite] = (0.0, 0.0, 0.0)
    marker: str | None = None


@dataclass(frozen=True)
class Reference(Strict):
    """The pose that determines the mount of each body on its link: the machine at rest with known joint values.

    Args:
        seconds: from, to, on the stream's own clock counted from its first stamp.
        joints: axis → joint value [rad or m].
        recording: glob of the recordings that contain it (mounts are averaged over them, so capture frame and bodies must not
            move in between); None: every recording starts with it.
    """

    seconds: Interval
    joints: dict[str, Finite]
    recording: str | None = None


@dataclass(frozen=True)
class Survey(Strict):
    """Recording for a proposal of the capture frame, used only by ``sysid ingest --propose-frame``.

    Args:
        markers: static marker (or rigid body) → its known position in the base frame [m].
        axis: the one that turns alone in this recording; no other axis moves it.
        turning: markers or bodies that it carries.
        sense: 1 where it turns in its positive direction first, else −1.
        recording: glob of the recording; None: the first one with such a file.
        seconds: from, to, on the stream's own clock counted from its first stamp; None: all of it.
    """

    markers: dict[str, tuple[Finite, Finite, Finite]] = field(default_factory=dict)
    axis: str | None = None
    turning: tuple[str, ...] = ()
    sense: Literal[1, -1] = 1
    recording: str | None = None
    seconds: Interval | None = None


@dataclass(frozen=True)
class StreamMap(Strict):
    """One kind of file in a recording's folder.

    Args:
        files: glob inside the recording's folder.
        recordings: globs of the recordings to which the entry applies; empty: all.
        clock: the stamps to use; None: the reader's first.
        domain: the device whose clock that is. All others are aligned to ``machine``.
        time, time_unit, rate_hz, delimiter, decimal, length_unit, rotation: see :class:`sysid.logs.ReadOptions`.
        columns: names of the columns of a CSV file without a header row, or instead of its own.
        dbc: database of a CAN log, relative to the recipe; the absolute path once the recipe has been read.
        interpolation: between samples of measured signals; commands are held.
        max_gap_s: gaps longer than this stay empty; None: three sample periods.
        secondary: signals of this stream that are not primary.
        bodies: rigid body → URDF link.
        marker_sets: new rigid body → its markers, at least three.
    """

    files: str
    recordings: tuple[str, ...] = ()
    reader: str | None = None
    clock: str | None = None
    domain: str = "machine"
    time: str | None = None
    time_unit: str | None = None
    rate_hz: Rate | None = None
    columns: tuple[str, ...] = ()
    delimiter: Literal[",", ";", "\t", "|", " "] | None = None
    decimal: Literal[".", ","] | None = None
    length_unit: str | None = None
    rotation: str | None = None
    dbc: str | None = None
    interpolation: Literal["linear", "cubic"] = "linear"
    max_gap_s: Positive | None = None
    signals: dict[str, SignalMap] = field(default_factory=dict)
    secondary: tuple[str, ...] = ()
    frame: FramePose = FramePose()
    bodies: dict[str, str] = field(default_factory=dict)
    marker_sets: dict[str, tuple[str, ...]] = field(default_factory=dict)
    points: dict[str, PointMap] = field(default_factory=dict)
    reference: Reference | None = None
    survey: Survey | None = None

    @property
    def key(self) -> str:
        """The entry in messages and in a version: its glob, and its recordings where it states them."""
        return f"{self.files} in {', '.join(self.recordings)}" if self.recordings else self.files

    def applies_to(self, recording: str) -> bool:
        """Whether the entry maps files of ``recording``."""
        return not self.recordings or any(fnmatchcase(recording, pattern) for pattern in self.recordings)


@dataclass(frozen=True)
class Recordings(Strict):
    """Globs over the sub-folders of the ingested path, or single files that are a recording each.

    Args:
        left_out: globs of ``recording/file`` that are not read although they are there, as damaged ones; of a LeRobot dataset
            ``chunk-000/file-000.parquet``, or an episode, ``episode-000001/*``.
    """

    motion: tuple[str, ...] = ("*",)
    poses: tuple[str, ...] = ()
    files: dict[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()

    def leaves_out(self, recording: str, file: str) -> bool:
        """Whether a file of ``recording`` is not to be read."""
        return any(fnmatchcase(f"{recording}/{file}", pattern) for pattern in self.left_out)


@dataclass(frozen=True)
class Splits(Strict):
    """Recording globs; the other recordings are assigned automatically.

    Args:
        held_out_last: recording → share of its end that is held out; the rest is cut into blocks.
        guard_s: gap between two blocks of one recording [s].
    """

    fit: tuple[str, ...] = ()
    select: tuple[str, ...] = ()
    held_out: tuple[str, ...] = ()
    held_out_last: dict[str, float] = field(default_factory=dict)
    guard_s: NonNegative = 1.0


@dataclass(frozen=True)
class StillPhases(Strict):
    """A static pose: every measured signal stays within ``tolerance`` of its range for ``seconds``."""

    seconds: Positive = 0.4
    tolerance: Positive = 2e-3


@dataclass(frozen=True)
class IngestRecipe(Strict):
    """``recipe.toml``; paths in it are relative to its folder and stay inside it."""

    schema: Literal[1]
    name: str | None = None
    machine: str | None = None
    logs: str | None = None
    recordings: Recordings = Recordings()
    splits: Splits = Splits()
    still: StillPhases = StillPhases()
    streams: tuple[StreamMap, ...] = ()
    hold_s: NonNegative = 0.5
    text: str = ""


#: Where none is given, so that the columns have canonical names; the only one without a text.
NO_RECIPE = IngestRecipe(schema=1)


def load_recipe(path: Path) -> IngestRecipe:
    """Read and check a recipe.

    Raises:
        SettingsError: an unknown key, reader or value, or a path that leaves the recipe's folder.
    """
    text = settings_text(path)
    recipe = _checked(toml_values(text, path), text, path)
    for stream in recipe.streams:
        if "/" in stream.files:
            folder, _, name = stream.files.rpartition("/")
            remedy = f'Write `files = "{name}"` and `recordings = ["{folder}"]`.'
            raise SettingsError(f"{path}: streams {stream.files!r}: files", "a folder", "a glob of file names", remedy)
    for key in ("machine", "logs"):
        value = getattr(recipe, key)
        if value is not None:
            inside(path.parent, value, f"{path}: {key}")
    return replace(recipe, streams=tuple(_with_database(stream, path) for stream in recipe.streams))


def stored_recipe(text: str, where: object) -> IngestRecipe:
    """The recipe of a stored version, without the files that it names.

    Raises:
        SettingsError: it names a CAN database, which is not stored.
    """
    recipe = _checked(toml_values(text, where), text, where)
    for stream in recipe.streams:
        if stream.dbc is not None:
            found = f"the recipe names the database {stream.dbc!r}, which is not stored with the version"
            raise SettingsError(where, found, "the recipe's folder", "Name the recipe with --recipe.")
    return recipe


def _checked(values: dict[str, Any], text: str, where: object) -> IngestRecipe:
    if "text" in values:
        raise SettingsError(where, "unknown key 'text'", "the keys of a recipe", "Remove it.")
    recipe = parse_settings({**values, "text": text}, IngestRecipe, where)
    for name in recipe.recordings.files:
        check_file_name(name, f"{where}: recordings.files")
    for pattern in (*recipe.recordings.files.values(), *(stream.files for stream in recipe.streams)):
        check_pattern(pattern, f"{where}: files")
    for stream in recipe.streams:
        _check_stream(stream, where)
    for name, share in recipe.splits.held_out_last.items():
        if not 0.0 < share < 1.0:
            raise SettingsError(f"{where}: splits.held_out_last.{name}", str(share), "a share between 0 and 1")
    return recipe


def _with_database(stream: StreamMap, path: Path) -> StreamMap:
    """The stream with the absolute path of its CAN database."""
    if stream.dbc is None:
        return stream
    where = f"{path}: streams {stream.files!r}: dbc"
    database = inside(path.parent, stream.dbc, where)
    if not database.is_file():
        present = [file.name for file in path.parent.glob("*.dbc")]
        raise SettingsError(where, f"no file {stream.dbc!r}", nearest(stream.dbc, present), "Correct the path.")
    return replace(stream, dbc=str(database))


def _check_stream(stream: StreamMap, recipe: object) -> None:
    where = f"{recipe}: streams {stream.files!r}"
    if stream.reader is not None:
        reader = reader_named(stream.reader, where)
        if stream.clock is not None and stream.clock not in reader.clocks:
            raise SettingsError(where, f"unknown clock {stream.clock!r}", nearest(stream.clock, reader.clocks))
    if stream.time_unit is not None:
        _check_time_unit(stream.time_unit, f"{where}: time_unit")
    if len({*stream.columns}) < len(stream.columns):
        twice = next(name for name in stream.columns if stream.columns.count(name) > 1)
        raise SettingsError(f"{where}: columns", f"{twice!r} twice", "a name for each column")
    if stream.decimal is not None and stream.decimal == stream.delimiter:
        raise SettingsError(where, f"{stream.decimal!r} as `decimal` and as `delimiter`", "two different marks")
    if stream.rate_hz is not None and stream.time is not None:
        raise SettingsError(where, "both `time` and `rate_hz`", "a time column, or the rate of evenly spaced rows [Hz]")
    for point, entry in stream.points.items():
        if point not in POINTS:
            raise SettingsError(f"{where}: points", f"unknown point {point!r}", nearest(point, POINTS))
        if (entry.body is None) == (entry.marker is None):
            found = "neither a body nor a marker" if entry.body is None else "both a body and a marker"
            raise SettingsError(f"{where}: points.{point}", found, "one of them")
        if entry.marker is not None and any(entry.at):
            raise SettingsError(f"{where}: points.{point}", "`at` with a marker", "a body: a single marker has no rotation")
    survey = stream.survey
    if survey is not None and bool(survey.turning) != (survey.axis is not None):
        found = "points that turn without an axis" if survey.turning else f"axis {survey.axis!r} without points that it turns"
        raise SettingsError(f"{where}: survey", found, "both `axis` and `turning`")
    if survey is not None and not survey.turning and not survey.markers:
        expected = "`markers` with known positions, or `axis` and `turning`"
        raise SettingsError(f"{where}: survey", "neither markers nor an axis", expected)
    for body, markers in stream.marker_sets.items():
        if len(set(markers)) < 3 or len(set(markers)) < len(markers):
            raise SettingsError(f"{where}: marker_sets.{body}", f"markers {list(markers)}", "at least three different ones")


def _check_time_unit(unit: str, where: str) -> None:
    try:
        si = si_factor(unit, where)[1]
    except InputError as error:
        remedy = "Fill in the unit." if "<" in unit else "Correct the unit."
        raise SettingsError(where, error.found, nearest(unit, SECONDS), remedy) from None
    if si != "s":
        raise SettingsError(where, f"{unit!r}, a unit of [{si}]", nearest(unit, SECONDS), "Correct the unit.")


def check_against_machine(recipe: IngestRecipe, machine: Machine, where: object) -> None:
    """Raise SettingsError where the recipe names an unknown signal, link or axis of the machine."""
    for stream in recipe.streams:
        for signal in stream.signals:
            _check_signal(signal, machine, f"{where}: streams {stream.files!r}")
        for signal in stream.secondary:
            _check_signal(signal, machine, f"{where}: streams {stream.files!r}: secondary")
        for axis in stream.reference.joints if stream.reference else ():
            machine.axis(axis)
        if stream.survey is not None and stream.survey.axis is not None:
            machine.axis(stream.survey.axis)
        kinematics = machine.kinematics()
        if stream.bodies and kinematics is None:
            raise SettingsError(f"{where}: bodies", "rigid bodies on links", "a machine with a urdf")
        links = {kinematics.chain[0].parent, *(j.child for j in kinematics.joints.values())} if kinematics else set()
        for body, link in stream.bodies.items():
            if link not in links:
                raise SettingsError(f"{where}: bodies: {body!r}", f"unknown link {link!r}", nearest(link, links))


def _check_signal(signal: str, machine: Machine, where: str) -> None:
    if signal not in machine.signals:
        owner, _ = split_signal(signal)
        known = (
            machine.signals
            if owner in (*machine.axis_names, *POINTS, *machine.markers)
            else (*machine.signals, *machine.axis_names)
        )
        raise SettingsError(where, f"unknown signal {signal!r}", nearest(signal, known))
