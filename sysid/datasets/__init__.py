"""Streams → immutable dataset versions: aligned, resampled, described, stored."""

from sysid.datasets.append import append
from sysid.datasets.assemble import Entry
from sysid.datasets.diff import DatasetDiff, diff
from sysid.datasets.frame import frame_of, load
from sysid.datasets.ingest import ingest
from sysid.datasets.lineage import Lineage, lineage
from sysid.datasets.recording import ClockRecord, Dataset, Kind, Recording, Role, Source
from sysid.datasets.store import Store
from sysid.datasets.tables import PartTables
from sysid.datasets.vacuum import Vacuumed, vacuum

__all__ = [
    "ClockRecord",
    "Dataset",
    "DatasetDiff",
    "Entry",
    "Kind",
    "Lineage",
    "PartTables",
    "Recording",
    "Role",
    "Source",
    "Store",
    "Vacuumed",
    "append",
    "diff",
    "frame_of",
    "ingest",
    "lineage",
    "load",
    "vacuum",
]
