"""The list of log formats; a new format is one more entry here."""

from __future__ import annotations

import re
from pathlib import Path

from sysid.errors import InputError, SettingsError, nearest
from sysid.logs.ardupilot import ArduPilotReader
from sysid.logs.c3d import C3dReader
from sysid.logs.can import CanReader
from sysid.logs.csv import CsvReader
from sysid.logs.json import JsonReader
from sysid.logs.lerobot import LeRobotReader, dataset_info
from sysid.logs.mat import MatReader
from sysid.logs.mcap import McapReader
from sysid.logs.mf4 import Mf4Reader
from sysid.logs.motive import MotiveReader
from sysid.logs.npz import NpzReader
from sysid.logs.parquet import ParquetReader
from sysid.logs.qualisys import QualisysReader
from sysid.logs.reader import LogReader
from sysid.logs.rosbag import Ros1Reader, Rosbag2Reader
from sysid.logs.trc import TrcReader
from sysid.logs.ulog import UlogReader
from sysid.logs.vicon import SECTIONS, ViconReader

READERS: tuple[LogReader, ...] = (
    McapReader(),
    Ros1Reader(),
    Rosbag2Reader(),
    CsvReader(),
    MotiveReader(),
    C3dReader(),
    TrcReader(),
    ViconReader(),
    QualisysReader(),
    CanReader(),
    Mf4Reader(),
    UlogReader(),
    ArduPilotReader(),
    ParquetReader(),
    LeRobotReader(),
    MatReader(),
    NpzReader(),
    JsonReader(),
)

#: First bytes of a file (after a byte order mark) → its reader, where the suffix is ambiguous.
SIGNATURES: tuple[tuple[re.Pattern[bytes], str], ...] = (
    (re.compile(rb"\x89MCAP"), "mcap"),
    (re.compile(rb"#ROSBAG"), "rosbag1"),
    (re.compile(rb"ULog\x01\x12\x35"), "ulog"),
    (re.compile(rb"\xa3\x95\x80"), "ardupilot"),
    (re.compile(rb"SQLite format 3\0"), "rosbag2"),
    (re.compile(rb'"?Format Version"?,'), "motive"),
    (re.compile(rb"(comment|info|righthanded|lefthanded)\b(.*\n)?info,version,", re.IGNORECASE | re.DOTALL), "motive"),
    (re.compile(rb"info,version,", re.IGNORECASE), "motive"),
    (re.compile(rb"PathFileType\b"), "trc"),
    (re.compile(rb";(\$FILEVERSION=|#{20})"), "can"),  # PEAK traces share the suffix of TRC
    (re.compile(rb"(NO_OF_FRAMES|FILE_VERSION)\t"), "qualisys"),
    (re.compile(rb'"?(' + "|".join((*SECTIONS, "Events")).encode() + rb')"?[,;\t ]*\r?\n'), "vicon"),
)


_CAN_DATABASE = "a database of CAN messages, not a log"
_SHEET = ("a spreadsheet", "Save the sheet as CSV: one header row, one time column.")
_PACKED = ("a packed file", "Unpack it first.")
#: Files beside logs, and logs without a reader: suffix → what it is and what to do.
NO_LOGS: dict[str, tuple[str, str]] = {
    ".dbc": (
        _CAN_DATABASE,
        'The recipe of the log names it: `dbc = "{name}"`; sysid ingest --inspect LOG --dbc {name} tries it.',
    ),
    ".arxml": (_CAN_DATABASE, "Export it as DBC; the recipe of the log names it with `dbc`."),
    ".kcd": (_CAN_DATABASE, "Export it as DBC; the recipe of the log names it with `dbc`."),
    ".yaml": ("metadata of a log (rosbag2: metadata.yaml), not a log", "Give the .db3 or .mcap beside it."),
    ".toml": ("a recipe or a machine description, not a log", "Give it with --recipe or --machine, and the logs as PATH."),
    ".urdf": ("the description of a robot, not a log", "machine.toml names it with `urdf`."),
    ".tak": ("a take of Motive", "Export it from Motive as CSV or C3D."),
    ".active": ("a ROS 1 bag whose recorder was killed", "Close it: `rosbag reindex {name}`, and give it the suffix .bag."),
    ".h5": ("an HDF5 file", "Save its tables as Parquet or CSV."),
    ".mdf": ("an MDF file of version 3", "Convert it to version 4 (.mf4)."),
    ".json": (
        "no log unless its reader is named",
        'A list of records is read where the reader is named: `reader = "json"`.',
    ),
    ".log": (
        "no log unless its reader is named",
        'A candump log is read where the reader is named: `reader = "can"`.',
    ),
    **dict.fromkeys((".xlsx", ".xls", ".ods"), _SHEET),
    **dict.fromkeys((".zip", ".gz", ".bz2", ".xz", ".7z", ".tar", ".zst"), _PACKED),
}
#: Suffix → the reader that has to be named for it.
NAMED = {".json": "json", ".log": "can"}
NO_LOGS |= {".yml": NO_LOGS[".yaml"], ".hdf5": NO_LOGS[".h5"]}


def reader_named(name: str, where: object) -> LogReader:
    """The reader with this name; raises :class:`SettingsError` for an unknown one."""
    for reader in READERS:
        if reader.name == name:
            return reader
    raise SettingsError(where, f"unknown reader {name!r}", nearest(name, [reader.name for reader in READERS]))


def reader_for(path: Path) -> LogReader:
    """The reader by the dataset or the first bytes of ``path``, else the first reader of its suffix.

    Raises:
        InputError: no reader for the suffix, or a LeRobot dataset of another version.
    """
    takes = [reader for reader in READERS if path.suffix.lower() in reader.suffixes]
    if not takes:
        suffixes = sorted({suffix for reader in READERS for suffix in reader.suffixes})
        unknown = (f"no reader for {path.suffix or 'a file without suffix'!r}", "")
        found, remedy = NO_LOGS.get(path.suffix.lower(), unknown)
        raise InputError(path, found, f"one of {', '.join(suffixes)}", remedy.format(name=path.name))
    name = "lerobot" if path.suffix == ".parquet" and dataset_info(path) is not None else _by_content(path)
    by_content = [reader for reader in READERS if reader.name == name]
    others = [reader for reader in takes if reader.name not in {name for _, name in SIGNATURES}]
    return (by_content or others or takes)[0]


def _by_content(path: Path) -> str | None:
    if not path.is_file():
        return None
    try:
        with path.open("rb") as file:
            head = file.read(4096).removeprefix(b"\xef\xbb\xbf")
    except PermissionError:  # reported when it is read
        return None
    return next((name for pattern, name in SIGNATURES if pattern.match(head)), None)


#: Suffixes that many programs use for other files: a log only where its first bytes say so.
SHARED = (".bin",)


def is_log(path: Path) -> bool:
    """Whether there is a reader for the suffix of ``path``, and for the content where other files share the suffix."""
    suffix = path.suffix.lower()
    known = path.is_file() and any(suffix in reader.suffixes for reader in READERS)
    return known and (suffix not in SHARED or _by_content(path) is not None)
