"""System identification for machines: logs in, named sim-to-real gaps out.

The public API is the sub-packages, in processing order::

    sysid.logs → sysid.datasets → sysid.networks, sysid.plant → sysid.gap → sysid.reports, sysid.view

Importing this package loads none of them. :func:`load` returns a stored dataset version as one pandas table.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

from sysid.current_folder import ignore_numba_file
from sysid.release import __version__

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["__version__", "load"]

ignore_numba_file()


def load(reference: str, workspace: str | os.PathLike[str] | None = None) -> pd.DataFrame:
    """A stored dataset version as one table, with units in ``attrs["units"]``: see :func:`sysid.datasets.load`."""
    from sysid.datasets import load as load_version

    return load_version(reference, workspace)
