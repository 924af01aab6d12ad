"""Streams → immutable dataset versions: aligned, resampled, described, stored."""

from sysid.datasets.ingest import ingest
from sysid.datasets.recording import ClockRecord, Dataset, Kind, Recording, Role, Source
from sysid.datasets.store import Entry, Store

__all__ = ["ClockRecord", "Dataset", "Entry", "Kind", "Recording", "Role", "Source", "Store", "ingest"]
