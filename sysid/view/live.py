"""Live view in Rerun of a plant in its PyBullet world."""

from __future__ import annotations

import os
import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np

from sysid.datasets.recording import Dataset, Recording
from sysid.display import shown_unit, with_unit
from sysid.machine import Machine
from sysid.plant import Plant
from sysid.signals import axis_signal, point_signals
from sysid.view.drawing import STYLES, TIMELINE, link_entity, link_shapes, log_shapes, saved, sdk
from sysid.view.layout import blueprint
from sysid.world import World, WorldState

#: Camera pictures per second of the machine's time, and their size.
CAMERA_HZ, CAMERA = 5.0, (320, 240)
#: States per second of the machine's time.
STATE_HZ = 50.0


def show_live(dataset: Dataset, recording: str, plant: Plant, path: Path | None = None) -> int:
    """Step the world through the commands of a recording and show each state.

    Args:
        plant: its machine needs a URDF.
        path: write an ``.rrd`` file at full speed instead of opening the viewer.

    Returns:
        The number of states shown.

    Raises:
        StoreError: the dataset has no such recording.
        SettingsError: PyBullet is missing, or the machine has no URDF.
    """
    source = dataset.recording(recording)
    rr = sdk()
    with World(plant, source.rate_hz) as world:
        stream = rr.RecordingStream(
            "sysid", recording_id=f"{dataset.reference}/{recording}/live/{os.getpid()}/{time.time_ns()}"
        )
        layout = blueprint(dataset, source, {"measured": source.table, "world": source.table}, TIMELINE)
        with ExitStack() as files:
            if path is None:
                stream.spawn(default_blueprint=layout)
            else:
                files.enter_context(saved(stream, path, layout))
            stream.send_recording_name(f"{dataset.reference} {recording}, {plant.reference or 'nominal plant'} in PyBullet")
            shown = _replay(stream, world, source, dataset.units, path is None)
            if path is None:
                stream.flush()
                stream.disconnect()
    return shown


def _replay(stream: Any, world: World, source: Recording, units: Mapping[str, str], real_time: bool) -> int:
    """Show the run, in real time or at full speed; returns the number of states."""
    rr = sdk()
    machine = world.plant.machine
    kinematics = machine.kinematics()
    assert kinematics is not None  # the world has checked it
    rr.log("machine", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True, recording=stream)
    links = link_shapes(machine.urdf_text or "", kinematics)
    factors = {}
    for signal in source.signals:
        factors[signal], _ = shown_unit(units.get(signal))
        for name, style in (("measured", STYLES["measured"]), ("world", STYLES["after"])):
            look = rr.SeriesLines(colors=[style.colour], names=[with_unit(name, units.get(signal))])
            rr.log(f"signals/{signal}/{name}", look, static=True, recording=stream)
    log_shapes(stream, "machine/world", machine, kinematics, STYLES["measured"])
    every = max(1, round(source.rate_hz / STATE_HZ))
    picture_every = every * max(1, round(source.rate_hz / CAMERA_HZ / every))
    begin, first, shown = time.monotonic(), None, 0
    times = source.values("time")
    for row, state in world.replay(source):
        if row % every:
            continue
        first = float(times[row]) if first is None else first
        early = begin + (float(times[row]) - first) - time.monotonic()
        if real_time and early > 0.0:
            time.sleep(early)
        stream.set_time(TIMELINE, duration=float(times[row]))
        _log_bodies(stream, world, state, links)
        _log_signals(stream, machine, source, row, state, factors)
        if row % picture_every == 0:
            rr.log("camera", rr.Image(world.picture(*CAMERA)).compress(), recording=stream)
            stream.flush()
        shown += 1
    return shown


def _log_bodies(stream: Any, world: World, state: WorldState, links: Iterable[str]) -> None:
    rr = sdk()
    poses = world.link_poses()
    for link in links:
        place, turn = poses[link]
        pose = rr.Transform3D(translation=place, quaternion=rr.Quaternion(xyzw=turn))
        rr.log(link_entity("machine/world", link), pose, recording=stream)
    colour = STYLES["after"].colour
    for point, place in (("ee", state.ee), ("tool", state.tool)):
        rr.log(f"machine/world/{point}", rr.Points3D([place], radii=[0.008], colors=[colour]), recording=stream)
    cable = rr.LineStrips3D([[state.ee, state.tool]], radii=[0.003], colors=[colour])
    rr.log("machine/world/cable", cable, recording=stream)


def _log_signals(
    stream: Any, machine: Machine, source: Recording, row: int, state: WorldState, factors: Mapping[str, float]
) -> None:
    rr = sdk()
    simulated = {axis.driven: value for axis, value in zip(machine.axes, state.drive, strict=True)}
    simulated |= {axis_signal(name, "joint"): value for name, value in zip(machine.axis_names, state.joints, strict=True)}
    for point, place in (("ee", state.ee), ("tool", state.tool)):
        simulated |= dict(zip(point_signals(point), place, strict=True))
    for signal in source.signals:
        measured = source.values(signal)[row]
        for name, value in (("measured", measured), ("world", simulated.get(signal, np.nan))):
            if np.isfinite(value):
                rr.log(f"signals/{signal}/{name}", rr.Scalars(factors[signal] * float(value)), recording=stream)
