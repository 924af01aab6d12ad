"""State of every sample of an aligned table: measured, bridged, held, or missing.

The states are not stored but computed from the raw channels, their clock records and the table, for every stored version.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.channel import stored_channels
from sysid.datasets.chunked import Array
from sysid.datasets.clocks.records import by_source, machine_times
from sysid.datasets.resample import LATE_SHARE
from sysid.datasets.versions.store import Store
from sysid.errors import StoreError, nearest
from sysid.names import uncut_name

States = npt.NDArray[np.int8]

STATES = ("missing", "measured", "bridged", "held")
#: Indices into :data:`STATES`.
MISSING, MEASURED, BRIDGED, HELD = range(4)
#: Samples further apart than this many periods of the source have a gap between them.
NEIGHBOURS = 1.5


def states(values: Array, at: Array, times: Array, rate_hz: float, command: bool = False) -> States:
    """The state of each sample of one signal, as index into :data:`STATES`, (n,).

    - missing: NaN in the table;
    - measured: on or between neighbouring samples of the source; a command that was sent since the last instant;
    - bridged: between samples further apart than :data:`NEIGHBOURS` periods of the source, inside the allowed gap;
    - held: no command was sent since the last instant; the previous one is held.

    Args:
        values: the signal in the table, (n,).
        at: instants of the table, (n,) [s].
        times: of known values of the source, increasing, (m,) [s], same origin.
    """
    result = np.full(len(values), MEASURED, dtype=np.int8)
    if len(times):
        if command:
            slack = LATE_SHARE / rate_hz
            last = np.searchsorted(times, at + slack, side="right") - 1
            age = at - times[np.clip(last, 0, len(times) - 1)]
            result[(last >= 0) & (age > 1.0 / rate_hz - slack)] = HELD
        elif len(times) > 1:
            right = np.clip(np.searchsorted(times, at, side="right"), 1, len(times) - 1)
            steps = times[right] - times[right - 1]
            on_sample = np.minimum(np.abs(at - times[right]), np.abs(at - times[right - 1])) < 1e-9
            result[(steps > NEIGHBOURS * float(np.median(np.diff(times)))) & ~on_sample] = BRIDGED
    result[np.isnan(values)] = MISSING
    return result


def validity_of(store: Store, reference: str, recording: str) -> pd.DataFrame:
    """``time`` [s] and, for every signal of a recording, the categorical state of each of its samples.

    Args:
        reference: dataset version, ``"name"`` or ``"name@3"``.
        recording: name in the dataset, also of a block (``"manual#2"``).

    Raises:
        StoreError: no such version or recording.
    """
    dataset = store.load(reference)
    found = dataset.recording(recording)
    channels = store.channels(dataset.reference)
    names = set(channels["recording"].unique())
    uncut = uncut_name(recording, names)
    if uncut not in names:
        raise StoreError(dataset.reference, f"no raw channels of {recording!r}", nearest(recording, names))
    channels = channels[channels["recording"] == uncut]
    start = int(channels.loc[channels["domain"] == "machine", "stamp_ns"].min())
    records = by_source(dataset.clocks, uncut)
    at = found.values("time") + (found.start_ns - start) * 1e-9
    result = pd.DataFrame({"time": found.values("time")})
    for signal in found.signals:
        values = found.values(signal)
        if found.kind == "poses":
            codes = np.where(np.isnan(values), MISSING, MEASURED).astype(np.int8)
        else:
            own = channels[(channels["signal"] == signal) & channels["primary"] & channels["value"].notna()]
            times = [machine_times(channel, start, records.get(channel.source)) for channel in stored_channels(own)]
            known = np.sort(np.concatenate(times)) if times else np.empty(0)
            codes = states(values, at, known, found.rate_hz, signal.endswith(".command"))
        result[signal] = pd.Categorical.from_codes(codes, categories=pd.Index(STATES))
    return result
