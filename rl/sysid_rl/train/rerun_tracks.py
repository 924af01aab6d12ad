"""Rerun recordings of path tracking: path, machines, errors, commands, and text at its moment."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd

from sysid.display import shown_unit, with_unit
from sysid.machine import Machine
from sysid.signals import axis_signal, point_signals
from sysid.view.drawing import STYLES, TIMELINE, log_curve, log_machine, log_points, rerun_file, sdk, send_piece, styles_of
from sysid.view.layout import machine_view, screen

Array = npt.NDArray[np.float64]

#: Colour of a path [RGB].
_PATH = (230, 60, 90)


def write_tracks(
    path: Path,
    machine: Machine,
    target: Array,
    rows: Mapping[str, pd.DataFrame],
    name: str,
    *,
    point: str = "ee",
    texts: Sequence[tuple[float, str]] = (),
) -> Path:
    """Write the tracking of one path by one or several policies.

    Args:
        path: the ``.rrd`` file.
        target: end-effector targets, (n, 3) [m], in the rows of the tables.
        rows: policy → ``time`` [s], joints, ``ee``, and ``tool`` and commands if any (SI).
        name: of the recording.
        point: whose error is drawn, ``ee`` or ``tool``.
        texts: lines of a log, each with its time [s].
    """
    rr = sdk()
    with rerun_file(path, name, _track_layout(list(rows), bool(texts)), name) as stream:
        rr.log("machine", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, recording=stream)
        rr.log("machine/path", rr.LineStrips3D([target], colors=[_PATH], radii=0.0015), static=True, recording=stream)
        styles = [STYLES["measured"], *styles_of(rows)]
        kinematics = machine.kinematics()
        for number, (style, (policy, table)) in enumerate(zip(styles, rows.items(), strict=False)):
            if kinematics is not None:
                log_machine(stream, f"machine/{policy}", machine, kinematics, table, style)
            log_points(stream, f"machine/{policy}", machine, table, style, number)
            error = shown_unit("m")[0] * (table[list(point_signals(point))].to_numpy(dtype=np.float64) - target)
            commands = [axis_signal(axis, "command") for axis in machine.axis_names]
            curves = {f"error/{axis}/{policy}": (error[:, k], with_unit(policy, "m")) for k, axis in enumerate("xyz")}
            for signal in commands:
                if signal in table and table[signal].notna().any():
                    curves[f"commands/{signal}/{policy}"] = (table[signal].to_numpy(dtype=np.float64), policy)
            for entity, (values, label) in curves.items():
                log_curve(stream, entity, table["time"].to_numpy(dtype=np.float64), values, style.colour, label)
        if texts:
            times, lines = zip(*texts, strict=True)
            send_piece(stream, "texts", np.array(times), rr.TextLog.columns(text=list(lines)))
    return path


def _track_layout(policies: list[str], texts: bool) -> object:
    import rerun.blueprint as rrb

    points = [f"machine/{policy}/{point}" for policy in policies for point in ("ee", "tool")]
    errors = [rrb.TimeSeriesView(origin=f"error/{axis}", name=f"error {axis}") for axis in "xyz"]
    right = rrb.Vertical(*errors, rrb.TimeSeriesView(origin="commands", name="commands"))
    left = machine_view(points, TIMELINE)
    if texts:
        left = rrb.Vertical(left, rrb.TextLogView(origin="texts", name="findings"), row_shares=[3, 1])
    return screen(rrb.Horizontal(left, right), TIMELINE)
