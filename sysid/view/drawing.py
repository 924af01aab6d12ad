"""A machine in Rerun: colours, shapes and poses of its links, and the trails of its points.

Shapes are those of the URDF's <visual> elements. A dataset version does not contain mesh files: a link with a mesh only, or
without any visual, is a bar to its next joint.

Source: URDF specification (ROS wiki, ``urdf/XML/link``).
"""

from __future__ import annotations

import os
import shutil
import tempfile
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt
import pandas as pd
from scipy.spatial.transform import Rotation

from sysid.files import written_whole
from sysid.machine import Kinematics, Machine
from sysid.machine.kinematics import origin_pose
from sysid.machine.urdf_tree import urdf_tree
from sysid.scratch import pieces
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Shape:
    """A primitive in the frame of its link.

    Args:
        kind: ``box``: size is (x, y, z); ``cylinder``: (radius, length along z); ``sphere``: (radius,); ``bar``: the end point.
        size: [m].
        pose: centre and orientation in the link's frame, 4×4.
    """

    kind: Literal["box", "cylinder", "sphere", "bar"]
    size: tuple[float, ...]
    pose: Array


def link_shapes(urdf: str, kinematics: Kinematics) -> dict[str, tuple[Shape, ...]]:
    """Shapes of every link of the chain: at least one, except for a last link without visuals."""
    described = {str(link.get("name")): link for link in urdf_tree(urdf).findall("link")}
    links = [kinematics.chain[0].parent, *(joint.child for joint in kinematics.chain)]
    shapes: dict[str, tuple[Shape, ...]] = {}
    for link in links:
        element = described.get(link)
        found = tuple(
            shape for visual in (element.findall("visual") if element is not None else []) for shape in _shape(visual)
        )
        shapes[link] = found or _bar(link, kinematics)
    return shapes


def _shape(visual: Element) -> tuple[Shape, ...]:
    pose = origin_pose(visual.find("origin"))
    box, cylinder, sphere = (visual.find(f"geometry/{kind}") for kind in ("box", "cylinder", "sphere"))
    if box is not None:
        return (Shape("box", _numbers(box.get("size", "")), pose),)
    if cylinder is not None:
        return (Shape("cylinder", _numbers(f"{cylinder.get('radius')} {cylinder.get('length')}"), pose),)
    if sphere is not None:
        return (Shape("sphere", _numbers(sphere.get("radius", "")), pose),)
    return ()


def _bar(link: str, kinematics: Kinematics) -> tuple[Shape, ...]:
    """A bar from the link's frame to its child joint; empty where the two coincide."""
    for joint in kinematics.chain:
        if joint.parent == link:
            end = joint.origin[:3, 3]
            if float(np.linalg.norm(end)) > 1e-6:
                return (Shape("bar", (float(end[0]), float(end[1]), float(end[2])), np.eye(4)),)
    return ()


def _numbers(text: str) -> tuple[float, ...]:
    return tuple(float(word) for word in text.split())


TIMELINE = "time"


@dataclass(frozen=True)
class Style:
    """Colour (RGB) of one version of the machine, and whether its links are solid or wire frames."""

    colour: tuple[int, int, int]
    solid: bool


#: The measurement is solid; simulations are wire frames, so that both are visible where they agree.
STYLES = {
    "measured": Style((138, 148, 158), True),
    "before": Style((222, 104, 52), False),
    "after": Style((20, 160, 150), False),
}
OTHER_COLOURS = ((70, 130, 190), (200, 150, 40), (160, 100, 200), (120, 160, 60))


def sdk() -> Any:
    """The SDK, imported late (half a second), with its telemetry off."""
    os.environ.setdefault("TELEMETRY_ENABLED", "false")
    import rerun

    return rerun


@contextmanager
def rerun_file(path: Path, identity: str, layout: Any, name: str) -> Iterator[Any]:
    """A Rerun stream into ``path``, written whole or not at all; equal identities are one recording for the viewer."""
    stream = sdk().RecordingStream("sysid", recording_id=identity)
    with saved(stream, path, layout):
        stream.send_recording_name(name)
        yield stream


@contextmanager
def saved(stream: Any, path: Path, layout: Any) -> Iterator[None]:
    """What a stream is sent within, into ``path``.

    Raises:
        StorageError: the disk is full or fails; nothing is left.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    with written_whole(path) as half, _written_to(stream, half):
        sdk().send_blueprint(layout, make_active=True, make_default=True, recording=stream)
        yield


@contextmanager
def _written_to(stream: Any, path: Path) -> Iterator[None]:
    """What a stream is sent within, through a named pipe into a file: the writer of Rerun hangs on a full disk.

    Raises:
        OSError: the disk is full or fails.
    """
    if not hasattr(os, "mkfifo"):  # then in memory until the end
        content = stream.binary_stream()
        yield
        path.write_bytes(content.read())
        stream.disconnect()
        return
    errors: list[OSError] = []

    def copy() -> None:
        try:
            with path.open("wb") as file:
                shutil.copyfileobj(source, file)
        except OSError as error:
            errors.append(error)
            while source.read(2**16):  # so that the writer comes to its end
                pass

    with tempfile.TemporaryDirectory() as folder:
        pipe = Path(folder) / "stream.rrd"
        os.mkfifo(pipe)
        with open(os.open(pipe, os.O_RDONLY | os.O_NONBLOCK), "rb", buffering=0) as source:
            stream.save(pipe)
            os.set_blocking(source.fileno(), True)
            copier = threading.Thread(target=copy)
            copier.start()
            try:
                yield
            finally:
                stream.disconnect()
                copier.join()
    if errors:
        raise errors[0]


def log_curve(
    stream: Any, entity: str, time: Array, values: Array, colour: tuple[int, int, int], label: str, width: float | None = None
) -> None:
    """A curve (n,) over time (n,) [s], in display units."""
    rr = sdk()
    widths = None if width is None else [width]
    rr.log(entity, rr.SeriesLines(colors=[colour], names=[label], widths=widths), static=True, recording=stream)
    send_columns(stream, entity, time, lambda rows: rr.Scalars.columns(scalars=values[rows]))


def send_columns(stream: Any, entity: str, time: Array, columns: Callable[[slice], Any]) -> None:
    """Values of an entity at times (n,) [s], piece by piece; ``columns``: rows → those of Rerun."""
    for first, last in pieces(len(time)):
        send_piece(stream, entity, time[first:last], columns(slice(first, last)))


def send_piece(stream: Any, entity: str, time: Array, columns: Any) -> None:
    """Values of an entity at times (n,) [s], which the stream does not keep."""
    rr = sdk()
    rr.send_columns(entity, indexes=[rr.TimeColumn(TIMELINE, duration=time)], columns=columns, recording=stream)
    stream.flush()


def styles_of(names: Mapping[str, Any]) -> list[Style]:
    others = iter(Style(colour, False) for colour in OTHER_COLOURS * (1 + len(names)))
    return [STYLES[name] if name in STYLES else next(others) for name in names]


def log_machine(stream: Any, root: str, machine: Machine, kinematics: Kinematics, table: pd.DataFrame, style: Style) -> None:
    """Poses of all links over time, and their shapes. Rows with an unknown joint are omitted."""
    if log_poses(stream, root, machine, kinematics, table):
        log_shapes(stream, root, machine, kinematics, style)


def link_entity(root: str, link: str) -> str:
    """The entity of a link, beside the points of the machine; a link may have any name."""
    return f"{root}/links/{sdk().escape_entity_path_part(link)}"


def log_shapes(stream: Any, root: str, machine: Machine, kinematics: Kinematics, style: Style) -> None:
    """Shapes of the links, valid at all times."""
    rr = sdk()
    for link, shapes in link_shapes(machine.urdf_text or "", kinematics).items():
        for number, shape in enumerate(shapes):
            rr.log(f"{link_entity(root, link)}/shape-{number}", *primitives(shape, style), static=True, recording=stream)


def log_poses(stream: Any, root: str, machine: Machine, kinematics: Kinematics, table: pd.DataFrame) -> bool:
    """Poses of the links in the rows of ``table`` with all joints; returns whether there are any."""
    rr = sdk()
    columns = [axis_signal(axis.name, "joint") for axis in machine.axes]
    if not set(columns) <= set(table.columns):
        return False
    joints = table[columns].to_numpy(dtype=np.float64)
    known = np.isfinite(joints).all(axis=1)
    if not known.any():
        return False
    time, joints = table["time"].to_numpy(dtype=np.float64)[known], joints[known]
    for first, last in pieces(len(time)):  # a pose takes 128 bytes
        for link, pose in kinematics.link_poses(joints[first:last]).items():
            turn = Rotation.from_matrix(pose[:, :3, :3]).as_quat()
            place = rr.Transform3D.columns(translation=pose[:, :3, 3], quaternion=turn)
            send_piece(stream, link_entity(root, link), time[first:last], place)
    return True


def primitives(shape: Shape, style: Style) -> list[Any]:
    rr = sdk()
    mode = "Solid" if style.solid else "MajorWireframe"
    colour = [*style.colour, 255]
    turn = rr.Quaternion(xyzw=Rotation.from_matrix(shape.pose[:3, :3]).as_quat())
    place = rr.Transform3D(translation=shape.pose[:3, 3], quaternion=turn)
    if shape.kind == "box":
        # Wire frames are slightly larger than solids, so that they stay visible where both agree.
        scale = 1.0 if style.solid else 1.02
        half_sizes = [[0.5 * scale * side for side in shape.size]]
        return [place, rr.Boxes3D(half_sizes=half_sizes, colors=[colour], fill_mode=mode, radii=0.0015)]
    if shape.kind == "cylinder":
        radius, length = shape.size
        return [place, rr.Cylinders3D(radii=[radius], lengths=[length], colors=[colour], fill_mode=mode)]
    if shape.kind == "sphere":
        return [place, rr.Ellipsoids3D(half_sizes=[[shape.size[0]] * 3], colors=[colour], fill_mode=mode)]
    return [rr.LineStrips3D([[[0.0, 0.0, 0.0], list(shape.size)]], radii=0.012 if style.solid else 0.004, colors=[colour])]


def _moved(places: Array) -> Callable[[slice], Any]:
    """Positions (n, 3) [m] as columns of a point."""
    return lambda rows: sdk().Points3D.columns(positions=places[rows])


#: Distance of names in space above each other [m].
NAME_M = 0.12


def log_points(stream: Any, root: str, machine: Machine, table: pd.DataFrame, style: Style, number: int = 0) -> None:
    """Boom tip and tool as points, whose last seconds are the trail, and the line between them.

    Args:
        number: of the version; the name of each is above that of the one before, where all are at the same place.
    """
    rr = sdk()
    time = table["time"].to_numpy(dtype=np.float64)
    found: dict[str, Array] = {}
    for point in ("ee", "tool"):
        if set(point_signals(point)) <= set(table.columns):
            found[point] = table[list(point_signals(point))].to_numpy(dtype=np.float64)
    for point, values in found.items():
        known = np.isfinite(values).all(axis=1)
        if not known.any():
            continue
        radius = 0.008 if point == "tool" else 0.005
        look = rr.Points3D.from_fields(colors=[style.colour], radii=[radius])
        rr.log(f"{root}/{point}", look, static=True, recording=stream)
        at = time[known]
        send_columns(stream, f"{root}/{point}", at, _moved(values[known]))
        if point == list(found)[-1]:  # the legend in space; the point itself would leave a trail of labels
            name = rr.Points3D.from_fields(
                colors=[style.colour], radii=[0.001], labels=[root.rpartition("/")[2]], show_labels=True
            )
            rr.log(f"{root}/legend", name, static=True, recording=stream)
            above = np.array([0.0, 0.0, NAME_M * (number + 1)])
            send_columns(stream, f"{root}/legend", at, _moved(values[known] + above))
    if set(found) == {"ee", "tool"}:
        known = np.isfinite(np.hstack([found["ee"], found["tool"]])).all(axis=1)
        strips = np.stack([found["ee"][known], found["tool"][known]], axis=1)
        if len(strips):
            look = rr.LineStrips3D.from_fields(colors=[style.colour], radii=[0.002])
            rr.log(f"{root}/cable", look, static=True, recording=stream)
            send_columns(stream, f"{root}/cable", time[known], lambda rows: rr.LineStrips3D.columns(strips=list(strips[rows])))
