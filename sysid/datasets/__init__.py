"""Dataset versions: streams of logs, aligned, resampled, described and stored."""

from sysid.datasets.ingest import ingest
from sysid.datasets.recording import ClockRecord, Dataset, Kind, Recording, Role, Source
from sysid.datasets.versions.append import append
from sysid.datasets.versions.assemble import Entry
from sysid.datasets.versions.diff import DatasetDiff, diff
from sysid.datasets.versions.frame import frame_of, load
from sysid.datasets.versions.lineage import Lineage, lineage
from sysid.datasets.versions.store import Store
from sysid.datasets.versions.tables import PartTables
from sysid.datasets.versions.vacuum import VacuumResult, vacuum

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
    "VacuumResult",
    "append",
    "diff",
    "frame_of",
    "ingest",
    "lineage",
    "load",
    "vacuum",
]
