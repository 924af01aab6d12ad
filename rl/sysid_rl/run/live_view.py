"""A run in Rerun while it is running: the machine and its target, setpoints and commands, lateness, and violations.

It reads the flight log in a separate process, so that the viewer cannot affect the loop. The view is at most one second late,
the interval of the log's syncs.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.display import shown_unit, with_unit
from sysid.files import written_whole
from sysid.machine import Machine
from sysid.signals import axis_signal, point_signals
from sysid.view.drawing import OTHER_COLOURS, STYLES, TIMELINE, log_points, log_poses, log_shapes, sdk
from sysid.view.layout import machine_view, screen
from sysid_rl.run.flight_messages import CYCLES, VERDICTS
from sysid_rl.run.tail import LogMessage, Tail

Array = npt.NDArray[np.float64]

#: Polling interval of the log [s].
POLL = 0.25
_TARGET = (230, 60, 90)
#: Log level of a violation by its reaction.
_LEVELS = {"clamp": "INFO", "hold": "WARN", "stop": "ERROR", "fault": "CRITICAL"}


def show_flight(path: Path, machine: Machine, out: Path | None = None, idle_s: float = 10.0) -> int:
    """Show the flight log at ``path`` until its writer ends it, or writes nothing for ``idle_s``.

    Args:
        machine: of the run.
        out: write an ``.rrd`` file instead of opening the viewer.

    Returns:
        The number of cycles shown.

    Raises:
        InputError: it is no flight log.
    """
    tail = Tail(path, frozenset((CYCLES, VERDICTS)))
    with _stream(path, machine, out) as stream:
        screen = _FlightView(stream, machine)
        grown = time.monotonic()
        while True:
            found = tail.new()
            if found:
                grown = time.monotonic()
                screen.show(found)
            if tail.finished or time.monotonic() - grown > idle_s:
                return screen.cycles
            if not found:
                time.sleep(POLL)


@contextmanager
def _stream(path: Path, machine: Machine, out: Path | None) -> Iterator[Any]:
    stream = sdk().RecordingStream("sysid", recording_id=f"{path.parent.name}/{path.stat().st_ino}")
    layout = _layout(machine)
    if out is None:
        stream.spawn(default_blueprint=layout)
        stream.send_recording_name(path.parent.name)
        yield stream
        stream.disconnect()
        return
    out.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(out) as half:
        stream.save(str(half), default_blueprint=layout)
        stream.send_recording_name(path.parent.name)
        yield stream
        stream.flush()
        stream.disconnect()


class _FlightView:
    """Draws the messages of one run."""

    def __init__(self, stream: Any, machine: Machine) -> None:
        rr = sdk()
        self.stream, self.machine, self.cycles = stream, machine, 0
        self._kinematics = machine.kinematics()
        self._begin: int | None = None
        self._state = ""
        rr.log("machine", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, recording=stream)
        look = rr.Points3D.from_fields(colors=[_TARGET], radii=[0.008])
        rr.log("machine/target", look, static=True, recording=stream)
        if self._kinematics is not None:
            log_shapes(stream, "machine/now", machine, self._kinematics, STYLES["measured"])
        self._factors = []
        for axis, colour in zip(machine.axis_names, OTHER_COLOURS * len(machine.axis_names), strict=False):
            unit = machine.expected_unit(axis_signal(axis, "joint"))
            self._factors.append(shown_unit(unit)[0])
            for name, style in (("joint", STYLES["measured"]), ("setpoint", STYLES["after"])):
                self._curve(f"axes/{axis}/{name}", style.colour, with_unit(name, unit))
            self._curve(f"commands/{axis}", colour, axis)
        self._curve("timing/lateness", STYLES["before"].colour, "lateness [µs]")
        self._curve("timing/turn", STYLES["after"].colour, "a cycle took [µs]")

    def show(self, messages: Sequence[LogMessage]) -> None:
        """Draw ``messages``, in their order."""
        self._begin = messages[0].log_ns if self._begin is None else self._begin
        cycles = [(message.log_ns, message.body) for message in messages if message.topic == CYCLES]
        if cycles:
            self._show_cycles([1e-9 * (log_ns - self._begin) for log_ns, _ in cycles], [body for _, body in cycles])
        for message in messages:
            if message.topic == VERDICTS:
                self._log_text(message.log_ns, message.body.text, _LEVELS.get(message.body.reaction, "INFO"))
            elif message.body.state != self._state:
                self._state = message.body.state
                self._log_text(message.log_ns, self._state, "CRITICAL" if self._state == "fault" else "INFO")

    def _show_cycles(self, seconds: list[float], cycles: list[Any]) -> None:
        rr = sdk()
        self.cycles += len(cycles)
        time_s, joints, ee = np.array(seconds), _stacked(cycles, "joint"), _stacked(cycles, "ee")
        setpoints, commands = _stacked(cycles, "setpoint"), _stacked(cycles, "command")
        columns = {axis_signal(axis, "joint"): joints[:, k] for k, axis in enumerate(self.machine.axis_names)}
        columns |= dict(zip(point_signals("ee"), ee.T, strict=True))
        table = pd.DataFrame({"time": time_s, **columns})
        if self._kinematics is not None:
            log_poses(self.stream, "machine/now", self.machine, self._kinematics, table)
        log_points(self.stream, "machine/now", self.machine, table, STYLES["measured"])
        target = _stacked(cycles, "target")
        known = np.isfinite(target).all(axis=1)
        if known.any():
            times = [rr.TimeColumn(TIMELINE, duration=time_s[known])]
            points = rr.Points3D.columns(positions=target[known])
            rr.send_columns("machine/target", indexes=times, columns=points, recording=self.stream)
        for k, axis in enumerate(self.machine.axis_names):
            self._values(f"axes/{axis}/joint", time_s, self._factors[k] * joints[:, k])
            self._values(f"axes/{axis}/setpoint", time_s, self._factors[k] * setpoints[:, k])
            self._values(f"commands/{axis}", time_s, commands[:, k])
        self._values("timing/lateness", time_s, np.array([1e-3 * cycle.lateness_ns for cycle in cycles]))
        self._values("timing/turn", time_s, np.array([1e-3 * cycle.latency_ns for cycle in cycles]))

    def _curve(self, entity: str, colour: tuple[int, int, int], label: str) -> None:
        rr = sdk()
        rr.log(entity, rr.SeriesLines(colors=[colour], names=[label]), static=True, recording=self.stream)

    def _values(self, entity: str, time_s: Array, values: Array) -> None:
        rr = sdk()
        known = np.isfinite(values)
        if known.any():
            times = [rr.TimeColumn(TIMELINE, duration=time_s[known])]
            scalars = rr.Scalars.columns(scalars=values[known])
            rr.send_columns(entity, indexes=times, columns=scalars, recording=self.stream)

    def _log_text(self, log_ns: int, text: str, level: str) -> None:
        assert self._begin is not None
        self.stream.set_time(TIMELINE, duration=1e-9 * (log_ns - self._begin))
        sdk().log("log", sdk().TextLog(text, level=level), recording=self.stream)


def _stacked(cycles: Sequence[Any], field: str) -> Array:
    return np.array([getattr(cycle, field) for cycle in cycles], dtype=np.float64)


def _layout(machine: Machine) -> Any:
    import rerun.blueprint as rrb

    axes = [rrb.TimeSeriesView(origin=f"axes/{axis}", name=axis) for axis in machine.axis_names]
    left = rrb.Vertical(
        machine_view(("machine/now/ee", "machine/target"), TIMELINE),
        rrb.TextLogView(origin="log", name="states and violations"),
        row_shares=[3, 1],
    )
    right = rrb.Vertical(
        rrb.Tabs(rrb.Grid(*axes, name="axes"), rrb.TimeSeriesView(origin="timing", name="timing")),
        rrb.TimeSeriesView(origin="commands", name="commands"),
        row_shares=[3, 1],
    )
    return screen(rrb.Horizontal(left, right), TIMELINE)
