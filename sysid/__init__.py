"""System identification for machines: logs in, named sim-to-real gaps out.

The functions here are those of the command line. They work on a workspace, a folder of datasets, models and results::

    import sysid
    dataset = sysid.ingest("my-crane/logs")    # a folder of logs → a dataset version
    gap = sysid.find_gap(dataset)              # prints as a table: which effects the simulation lacks
    gap.repaired.export("mjcf", "my-crane.mjcf")

The sub-packages are their parts, in processing order::

    sysid.logs → sysid.datasets → sysid.networks, sysid.plant → sysid.gap → sysid.reports, sysid.view

A name is imported when it is used.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sysid.current_folder import ignore_numba_file
from sysid.lazy import functions_beside_packages, lazy_names
from sysid.release import __version__

if TYPE_CHECKING:
    from sysid.datasets.recording import Dataset, Recording
    from sysid.datasets.versions.store import load
    from sysid.errors import ExcitationError, InputError, SettingsError, StoreError, SysidError
    from sysid.export.export import Export
    from sysid.front.files import export, report
    from sysid.front.gap import GapResult, RepairedPlant, find_gap
    from sysid.front.logs import ingest, start
    from sysid.front.networks import FittedNetwork, Validation, fit, validate
    from sysid.front.place import open  # noqa: A004
    from sysid.front.shipped import demo_logs
    from sysid.plant import Plant
    from sysid.workspace import Workspace

__all__ = [
    "Dataset",
    "ExcitationError",
    "Export",
    "FittedNetwork",
    "GapResult",
    "InputError",
    "Plant",
    "Recording",
    "RepairedPlant",
    "SettingsError",
    "StoreError",
    "SysidError",
    "Validation",
    "Workspace",
    "__version__",
    "demo_logs",
    "export",
    "find_gap",
    "fit",
    "ingest",
    "load",
    "open",
    "report",
    "start",
    "validate",
]

__getattr__ = lazy_names(
    __name__,
    {
        "datasets.recording": ["Dataset", "Recording"],
        "datasets.versions.store": ["load"],
        "errors": ["ExcitationError", "InputError", "SettingsError", "StoreError", "SysidError"],
        "export.export": ["Export"],
        "front.files": ["export", "report"],
        "front.gap": ["GapResult", "RepairedPlant", "find_gap"],
        "front.logs": ["ingest", "start"],
        "front.networks": ["FittedNetwork", "Validation", "fit", "validate"],
        "front.place": ["open"],
        "front.shipped": ["demo_logs"],
        "plant": ["Plant"],
        "workspace": ["Workspace"],
    },
)
functions_beside_packages(__name__, {"export": "front.files", "validate": "front.networks"})
ignore_numba_file()
