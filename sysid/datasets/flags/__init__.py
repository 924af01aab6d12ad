"""What a sensor should not do, found in the raw channels and written down; no value is changed."""

from sysid.datasets.flags.stamps import dropouts, jitter, repaired_stamps
from sysid.datasets.flags.stuck import saturation, stuck
from sysid.datasets.flags.values import jumps, outliers

__all__ = [
    "dropouts",
    "jitter",
    "jumps",
    "outliers",
    "repaired_stamps",
    "saturation",
    "stuck",
]
