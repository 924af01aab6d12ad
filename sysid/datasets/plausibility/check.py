"""All checks of plausibility of a dataset.

They compare what is known twice: positions with stroke and limits, speeds with ``gain``, cylinders with joints, joints with
the end effector, commands with the motion that follows, stamps with ``rate_hz``. They are computed from the tables whenever
they are needed and not stored, so that they hold for versions of any age and for changed roles.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from sysid.datasets.plausibility.axes import (
    axis_finding,
    by_recording,
    corrections_of,
    figures_of,
    merged,
    partial_findings,
    ranged,
    swap_findings,
    usual_gain,
)
from sysid.datasets.plausibility.columns import (
    column_findings,
    end_stop_findings,
    sample_findings,
    sentinel_findings,
    wrap_findings,
)
from sysid.datasets.plausibility.finding import Evidence, Finding
from sysid.datasets.plausibility.points import point_findings
from sysid.datasets.plausibility.stamps import rates_of, time_findings
from sysid.datasets.recording import Dataset, Recording, Role
from sysid.datasets.roles.motion import motion_table
from sysid.datasets.roles.needs import lacks_of, role_amounts
from sysid.machine import Machine


def check_plausibility(dataset: Dataset) -> tuple[Finding, ...]:
    """What is implausible in a dataset, severe findings first.

    The command line calls it at ingest, for ``--quality`` and before ``gap``; :func:`sysid.gap.find_gap` does not.
    """
    streams = dataset.quality.get("streams", {})
    flags = dataset.quality.get("flags", ())
    return findings_of(dataset.recordings, dataset.machine, dataset.splits, streams, dataset.units, flags)


def findings_of(
    recordings: Sequence[Recording],
    machine: Machine,
    splits: Mapping[str, Role],
    streams: Mapping[str, Mapping[str, Mapping[str, Any]]] | None = None,
    units: Mapping[str, str] | None = None,
    flags: Sequence[Mapping[str, Any]] = (),
) -> tuple[Finding, ...]:
    """As :func:`check_plausibility`.

    Args:
        streams: recording → stream → figures of its raw samples (``quality["streams"]`` of a dataset): rate, counts.
        units: signal → SI unit that the logs or the recipe state, for joints of a machine without a URDF.
        flags: ``quality["flags"]`` of a dataset.
    """
    rates = rates_of(streams or {}, recordings)
    found, time_scale = time_findings(rates, recordings, machine.rate_hz)
    rate_ratio = float(np.median(list(rates.values()))) / machine.rate_hz if rates and not found else None
    recorded = {signal.partition(".")[0] for recording in recordings for signal in recording.signals}
    figures = {
        axis.name: figures_of(recordings, machine, axis, units or {}, rate_ratio, time_scale)
        for axis in machine.axes
        if axis.name in recorded
    }
    separate = by_recording(recordings).values()
    usual: dict[str, float] = {}  # gain of an axis that nobody states: that of most of its recordings
    for name, each in figures.items():
        if each.axis.actuation == "velocity" and "gain" in each.axis.estimated and each.response is not None:
            parts = [figures_of(own, machine, each.axis, units or {}, rate_ratio, time_scale) for own in separate]
            usual[name], missing = usual_gain(each, parts)
            figures[name] = replace(each, expected=abs(each.response.value) or each.expected)
            found += [missing] if missing is not None and time_scale == 1.0 else []
    wrapped = wrap_findings(recordings, machine)
    figures = {name: each for name, each in figures.items() if name not in wrapped}
    found += wrapped.values()
    sentinels = sentinel_findings(flags)
    figures = {name: each for name, each in figures.items() if name not in sentinels}
    found += sentinels.values()
    swaps, exchanged = swap_findings(recordings, figures, time_scale)
    own = [axis_finding(each) for name, each in figures.items() if name not in exchanged]
    single = [finding for finding in own if finding is not None]
    found += swaps
    found += merged(single)
    unclear = {*wrapped, *sentinels, *exchanged, *(finding.axis for finding in single)}
    partial = list(
        partial_findings(
            recordings,
            [each for name, each in figures.items() if name not in unclear],
            lambda some, axis: replace(
                figures_of(some, machine, axis, units or {}, rate_ratio, time_scale),
                expected=usual.get(axis.name, figures[axis.name].expected),
            ),
        )
    )
    found += partial
    found += point_findings(recordings, machine, corrections_of(single), exchanged)
    found += column_findings(recordings, machine)
    found += sample_findings(streams or {})
    found += [finding for finding in end_stop_findings(recordings, machine) if finding.keys[0].partition(":")[0] not in unclear]
    doubtful = {*ranged(single), *(re.split("[.:]", key)[0] for finding in partial for key in finding.keys)}
    still = {f"{name}:{STILL}" for name in doubtful}
    if time_scale == 1.0:
        found += [f for f in role_findings(recordings, machine, splits) if not still.issuperset(f.keys)]
    return tuple(sorted(found, key=lambda finding: finding.severity != "severe"))


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
