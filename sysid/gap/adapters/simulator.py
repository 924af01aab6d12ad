"""Interface of a user's simulator, which maps commands to signals, where its joints start, and a cache of its runs.

A joint is in motion at the start if the slope of its first :data:`FIRST` seconds is certain. Its position and speed are then
those of a parabola through the first :data:`WINDOW` seconds; both times are longer where samples are few. Otherwise it is at
rest, at the median of the first 0.2 s.
"""

from __future__ import annotations

import hashlib
import time
from collections import OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.datasets.recording import Recording
from sysid.errors import InputError, nearest
from sysid.machine import Machine
from sysid.plant.model import START_WINDOW
from sysid.signals import axis_signal, canonical_signals, split_signal

Array = npt.NDArray[np.float64]
Stretches = npt.NDArray[np.int64]
#: What one run returned: signal → (n,).
Signals = Mapping[str, Array]

#: Largest size of the cached runs [bytes]; the oldest are dropped first.
MAX_CACHE = 256_000_000
#: Time in which a motion has to show [s], time of the parabola [s], and least numbers of samples in both.
FIRST, WINDOW, SAMPLES = 0.06, 0.12, (5, 8)
#: Longest time of the parabola [s]: a joint with fewer samples starts at rest.
LONGEST = 0.2
#: Standard deviations by which a slope differs from zero.
CERTAIN = 6.0


@runtime_checkable
class Simulator(Protocol):
    """Maps the commands of a recording to the signals that the machine's sensors would read.

    :meth:`simulate` takes a recording of n rows, ``time`` [s] even at ``recording.rate_hz``, with ``<axis>.command`` in each
    row of every axis that was commanded (never NaN; in the units of ``machine.toml``, and not clipped: with a gain above
    one at the input of a simulator, a command exceeds 1). The table also contains the measured signals, NaN where not measured,
    for the initial state only (:func:`starting_value`).

    It returns a table of n rows, row k at ``time`` k, whose columns have canonical signal names
    (``boom.cylinder`` [m], ``boom.joint`` [rad or m], ``ee.x`` … and ``tool.x`` … [m, base frame]); NaN where it returns no
    value. Other columns than these and ``time`` are an error. The same recording has to give the same output.

    A simulator may have a ``name``; otherwise the name of its class is used.
    """

    def simulate(self, recording: Recording) -> pd.DataFrame: ...


@runtime_checkable
class BatchSimulator(Simulator, Protocol):
    """A simulator that runs many commands for the same recording at once.

    :meth:`simulate_many` takes ``<axis>.command`` → (lanes, n) and returns signal → (lanes, n); lane k has to be what
    :meth:`simulate` gives for the k-th commands.
    """

    def simulate_many(self, recording: Recording, commands: Mapping[str, Array]) -> Mapping[str, Array]: ...


@runtime_checkable
class SteppedSimulator(Simulator, Protocol):
    """A simulator with a time step of its own, which takes commands at it.

    :meth:`steps_in_sample` is the number of its steps in a sample at a rate [Hz]. It is then run on recordings with that many
    rows a sample, with the commands held, so that input effects act at its steps.
    """

    def steps_in_sample(self, rate_hz: float) -> int: ...


def starting_value(recording: Recording, signal: str, default: float = 0.0) -> float:
    """Median of the measurement in the first 0.2 s [unit of the signal]; ``default`` without one."""
    values = recording.values(signal)[: max(3, round(START_WINDOW * recording.rate_hz))]
    values = values[~np.isnan(values)]
    return float(np.median(values)) if len(values) else default


@dataclass(frozen=True)
class JointStart:
    """``position`` [rad or m] and ``speed`` [rad/s or m/s] at the first row."""

    position: float
    speed: float


def joint_start(recording: Recording, signal: str, default: float = 0.0) -> JointStart:
    """The start of a joint from its sensor; ``default`` position where it is not measured."""
    values = recording.values(signal)
    there = np.flatnonzero(~np.isnan(values))
    time = there / recording.rate_hz
    first, whole = (max(int(np.sum(time < most)), least) for most, least in zip((FIRST, WINDOW), SAMPLES, strict=True))
    if len(time) < whole or time[whole - 1] > LONGEST:
        return JointStart(starting_value(recording, signal, default), 0.0)
    (_, slope), deviation = _polynomial(time[:first], values[there[:first]], 1)
    found, deviations = _polynomial(time[:whole], values[there[:whole]], 2)
    moves = abs(slope) > CERTAIN * deviation[1] and abs(found[1]) > CERTAIN * deviations[1] and found[1] * slope > 0.0
    if not moves:
        return JointStart(starting_value(recording, signal, default), 0.0)
    return JointStart(float(found[0]), float(found[1]))


def _polynomial(time: Array, values: Array, degree: int) -> tuple[Array, Array]:
    """Coefficients of a polynomial from the constant on, and their standard deviations by the scatter about it."""
    powers = np.vander(time, degree + 1, increasing=True)
    found: Array = np.asarray(np.linalg.lstsq(powers, values, rcond=None)[0], dtype=np.float64)
    freedom = max(len(time) - degree - 1, 1)
    variance = float(np.sum((values - powers @ found) ** 2)) / freedom
    return found, np.asarray(np.sqrt(variance * np.diag(np.linalg.inv(powers.T @ powers))), dtype=np.float64)


def name_of(simulator: Simulator) -> str:
    """Name of the simulator in messages."""
    return str(getattr(simulator, "name", type(simulator).__name__))


@dataclass
class RunCache:
    """Runs of a simulator, each computed once: a run with the same commands for the same recording is taken from the cache.

    Args:
        calls: how often the simulator was called.
        computed, cached: number of runs computed by the simulator, and of those taken from the cache.
        seconds: time spent in the simulator.
    """

    simulator: Simulator
    machine: Machine
    calls: int = 0
    computed: int = 0
    cached: int = 0
    seconds: float = 0.0
    _cache: OrderedDict[tuple[int, bytes], tuple[Recording, Signals]] = field(default_factory=OrderedDict, repr=False)
    _size: int = field(default=0, repr=False)

    @property
    def name(self) -> str:
        return name_of(self.simulator)

    def of(self, recording: Recording, commands: Mapping[str, Array], stretches: Stretches) -> list[Signals]:
        """What the simulator returns for each lane of commands.

        Args:
            commands: ``<axis>.command`` → (lanes, n), without NaN inside the stretches.
            stretches: (m, 2) first and last+1 row of each stretch with commands; the simulator is restarted in each; rows
                between them are NaN.

        Raises:
            InputError: the simulator failed, or returned no table of signals.
        """
        lanes = len(next(iter(commands.values())))
        keys = [(id(recording), _digest([part[k] for part in commands.values()])) for k in range(lanes)]
        missing = {key: k for k, key in enumerate(keys) if key not in self._cache}
        self.cached += lanes - len(missing)
        found = {key: self._cache[key][1] for key in keys if key not in missing}
        if missing:
            chosen = {signal: part[list(missing.values())] for signal, part in commands.items()}
            for key, signals in zip(missing, self._run(recording, chosen, stretches), strict=True):
                found[key] = signals
                self._store(key, recording, signals)
        return [found[key] for key in keys]

    def cost(self) -> str:
        """Number and duration of the runs, for the notes of a result."""
        per_call = 1e3 * self.seconds / max(self.calls, 1)
        return (
            f"{self.name} was called {self.calls} times for {self.computed} runs "
            f"({self.seconds:.1f} s, {per_call:.1f} ms a call); "
            f"{self.cached} more were taken from the cache"
        )

    def check_repeatable(self, recording: Recording, commands: Mapping[str, Array], stretches: Stretches) -> None:
        """Check that two runs of the same commands agree: a fit needs a deterministic simulator.

        Raises:
            InputError: they differ.
        """
        (known,) = self.of(recording, commands, stretches)
        (again,) = self._run(recording, commands, stretches)
        differ = [s for s in known if not np.array_equal(known[s], again.get(s, np.empty(0)), equal_nan=True)]
        if differ:
            raise InputError(
                f"simulator {self.name}, recording {recording.name}",
                f"{', '.join(differ)}: two runs of the same commands differ",
                "the same output every time",
                "Fix its random seed, and keep no state between calls.",
            )

    def _run(self, recording: Recording, commands: Mapping[str, Array], stretches: Stretches) -> list[Signals]:
        lanes = len(next(iter(commands.values())))
        whole: list[dict[str, Array]] = [{} for _ in range(lanes)]
        for first, last in stretches:
            part = rows_of(recording, int(first), int(last))
            for k, signals in enumerate(self._call(part, {s: u[:, first:last] for s, u in commands.items()})):
                for signal, values in signals.items():
                    whole[k].setdefault(signal, np.full(len(recording), np.nan))[first:last] = values
        self.computed += lanes
        return list(whole)

    def _call(self, part: Recording, commands: Mapping[str, Array]) -> list[Signals]:
        lanes, count = next(iter(commands.values())).shape
        begin = time.perf_counter()
        try:
            if isinstance(self.simulator, BatchSimulator):
                self.calls += 1
                many = self.simulator.simulate_many(part, commands)
                checked = self._checked(many, part, (lanes, count))
                return [{signal: values[k] for signal, values in checked.items()} for k in range(lanes)]
            found: list[Signals] = []
            for k in range(lanes):
                self.calls += 1
                table = part.table.assign(**{signal: values[k] for signal, values in commands.items()})
                returned = self.simulator.simulate(replace(part, table=table))
                found.append(self._checked(returned, part, (count,)))
            return found
        except InputError:
            raise
        except Exception as error:
            raise InputError(
                f"simulator {self.name}, recording {part.name}", f"{type(error).__name__}: {error}", "a table of signals"
            ) from error
        finally:
            self.seconds += time.perf_counter() - begin

    def _checked(self, returned: object, part: Recording, shape: tuple[int, ...]) -> dict[str, Array]:
        where = f"simulator {self.name}, recording {part.name}"
        if not isinstance(returned, Mapping | pd.DataFrame):
            raise InputError(where, f"returned {type(returned).__name__}", "a pandas DataFrame with a column for each signal")
        valid = [s for s in canonical_signals(self.machine.axis_names) if split_signal(s)[1] != "command"]
        found = {}
        for name in returned:
            signal = str(name)
            if signal == "time" or split_signal(signal)[1] == "command":
                continue
            if signal not in valid:
                raise InputError(where, f"returned the column {signal!r}", nearest(signal, valid))
            values = np.asarray(returned[name], dtype=np.float64)
            if values.shape != shape:
                raise InputError(where, f"{signal} has the shape {values.shape}", f"{shape}, a value for each row")
            if np.isinf(values).any():
                raise InputError(where, f"{signal} is infinite", "finite numbers, or NaN where there is no value")
            found[signal] = values
        if not found:
            raise InputError(where, "returned no signal", f"some of {', '.join(valid)}")
        return found

    def _store(self, key: tuple[int, bytes], recording: Recording, signals: Signals) -> None:
        self._cache[key] = (recording, signals)  # the recording is kept, so that its id is not reused
        self._size += _bytes(signals)
        while self._size > MAX_CACHE and len(self._cache) > 1:
            _, (_, dropped) = self._cache.popitem(last=False)
            self._size -= _bytes(dropped)


def _bytes(signals: Signals) -> int:
    return sum(values.nbytes for values in signals.values())


def _digest(parts: Sequence[Array]) -> bytes:
    digest = hashlib.blake2b(digest_size=16)
    for part in parts:
        digest.update(np.ascontiguousarray(part).data)
    return digest.digest()


def rows_of(recording: Recording, first: int, last: int) -> Recording:
    """Rows ``first … last`` as a separate recording whose time starts at zero."""
    if first == 0 and last == len(recording):
        return recording
    table = recording.table.iloc[first:last].reset_index(drop=True)
    start = float(table["time"].iloc[0])
    return replace(recording, table=table.assign(time=table["time"] - start), start_ns=recording.start_ns + round(1e9 * start))


def command_signals(recording: Recording, machine: Machine) -> list[str]:
    """Command signals that the recording contains."""
    names = (axis_signal(name, "command") for name in machine.axis_names)
    return [name for name in names if not np.isnan(recording.values(name)).all()]
