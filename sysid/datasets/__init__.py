"""Dataset versions: streams of logs, aligned, resampled, described and stored.

The modules are imported when a name is used, so that listing versions needs none of the numerical libraries.
"""

from typing import TYPE_CHECKING

from sysid.lazy import lazy_names

if TYPE_CHECKING:
    from sysid.datasets.clocks import ClockRecord
    from sysid.datasets.ingestion import ingest
    from sysid.datasets.recording import Dataset, Kind, Recording, Role, Source
    from sysid.datasets.versions.append import append
    from sysid.datasets.versions.assemble import frame_of
    from sysid.datasets.versions.diff import DatasetDiff, diff
    from sysid.datasets.versions.index import Entry
    from sysid.datasets.versions.lineage import Lineage, lineage
    from sysid.datasets.versions.store import Store, load
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

__getattr__ = lazy_names(
    __name__,
    {
        "clocks": ["ClockRecord"],
        "ingestion": ["ingest"],
        "recording": ["Dataset", "Kind", "Recording", "Role", "Source"],
        "versions.append": ["append"],
        "versions.assemble": ["frame_of"],
        "versions.diff": ["DatasetDiff", "diff"],
        "versions.index": ["Entry"],
        "versions.lineage": ["Lineage", "lineage"],
        "versions.store": ["Store", "load"],
        "versions.tables": ["PartTables"],
        "versions.vacuum": ["VacuumResult", "vacuum"],
    },
)
