"""Settings of the motion capture system: bodies, noise, clock and faults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from sysid.config import Strict


@dataclass(frozen=True)
class BodySettings(Strict):
    """A rigid body of the capture system on ``link``; ``pivot`` is its origin in that link [m], None = centre of its markers.

    ``markers`` are marker positions in the link frame [m].
    """

    name: str
    link: Literal["column", "boom", "stick", "tip", "gripper"]
    markers: tuple[tuple[float, float, float], ...]
    pivot: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class SwapSettings(Strict):
    """Two markers of a body change places in ``recording`` from ``at`` for ``duration`` [s on the capture clock]."""

    recording: str
    body: str
    markers: tuple[int, int]
    at: float
    duration: float


@dataclass(frozen=True)
class MarkerExport(Strict):
    """The markers of ``body`` are exported as well in the take of ``recording``."""

    recording: str
    body: str


@dataclass(frozen=True)
class CaptureSettings(Strict):
    """The motion capture system.

    Args:
        rate: exported frames per second [Hz]; ``capture_rate`` is what the cameras ran at.
        noise: white noise of every marker coordinate [m].
        offset: range [s] from which the start of the capture after the start of the recording is drawn.
        skew: rate error of the capture clock [ppm]: ``t_machine = t_capture·(1 + 1e-6·skew) + offset``.
        latency: frames are stamped this much late [s].
        dropouts_per_minute: occlusions of one body each, lasting ``dropout_seconds`` (range, [s]).
        bodies, swaps, exported_markers: what is tracked, when markers are confused, whose markers are exported.
        translation, rpy: surveyed pose of the capture frame in the base frame [m, rad] (fixed-axis roll, pitch, yaw).
        export: file formats of a take; the first one is mapped by the site's recipe. C3D holds the markers alone.
        shift, tilt: error of the surveyed frame: seen = R(tilt)·true + shift [m, rotation vector rad].
    """

    rate: float = 60.0
    capture_rate: float = 240.0
    pose_rate: float = 10.0
    noise: float = 0.0
    offset: tuple[float, float] = (0.0, 0.0)
    skew: float = 0.0
    latency: float = 0.0
    dropouts_per_minute: float = 0.0
    dropout_seconds: tuple[float, float] = (0.1, 1.0)
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tilt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    bodies: tuple[BodySettings, ...] = ()
    swaps: tuple[SwapSettings, ...] = ()
    exported_markers: tuple[MarkerExport, ...] = ()
    export: tuple[Literal["motive", "c3d"], ...] = ("motive",)


def marker_label(body: str, index: int) -> str:
    """Name of marker ``index`` (from 0) of ``body`` in an export."""
    return f"{body}:Marker{index + 1}"
