"""Axes that do not move in the recordings of a role: nothing can be estimated, compared or validated there."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

from sysid.datasets.plausibility.finding import Evidence, Finding
from sysid.datasets.recording import Recording, Role
from sysid.datasets.roles.lacks import lacks_of, role_amounts
from sysid.datasets.roles.motion import motion_table
from sysid.machine import Machine

#: Kind of these findings, the end of their keys.
STILL = "still"


def role_findings(recordings: Sequence[Recording], machine: Machine, splits: Mapping[str, Role]) -> Iterator[Finding]:
    """A notice for the axes that do not move in one of the roles, or in no recording (:mod:`sysid.datasets.roles`)."""
    motion = [r for r in recordings if r.kind == "motion" and r.name in splits]
    if not motion:
        return
    table = motion_table(motion, machine)
    for lack in lacks_of(role_amounts(table, splits), table.axes, machine):
        if lack.kind == "motion":
            keys = tuple(f"{axis}:{STILL}" for axis in lack.axes)
            yield Finding(keys, "notice", (Evidence(lack.text, "motion in the fit, selection and test recordings"),))
