"""Checks of the points: the end effector against the kinematics of the joints, and the tool against the end effector."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sysid.datasets.checks.figures import CheckContext, thinned
from sysid.datasets.checks.finding import (
    Cause,
    Evidence,
    Finding,
    Severity,
    exchanged_columns,
    factor_text,
    opposite_sign,
    ratio_text,
)
from sysid.datasets.checks.mistakes import ANGLE, LENGTH, UnitMistake
from sysid.datasets.chunked import Array
from sysid.datasets.recording import Recording
from sysid.machine import Machine
from sysid.machine.kinematics import Kinematics
from sysid.names import listed
from sysid.signals import axis_signal, point_signals

#: Rows that are compared in all, and at least.
MAX_ROWS, MIN_ROWS = 2000, 12
#: Least motion of a coordinate for a comparison [m], and least correlation for a factor.
LEAST_M, CORRELATED = 0.02, 0.9
#: Factors between measured and computed motion beyond which it is named. A wrong link length changes it by a few per cent.
NOTICE, SEVERE = 1.5, 3.0
#: Share of the motion that is left after the best rotation and scale: below ``FITS`` the joints explain the end effector, above
#: ``FAILS`` they do not.
FITS, FAILS = 0.15, 0.5
#: Rotation of a capture frame that is named [rad], and how close to a right angle an exchange of axes has to be.
TURNED, RIGHT_ANGLE = math.radians(20.0), math.radians(5.0)


@dataclass(frozen=True)
class Registration:
    """Best rotation or reflection and scale from computed to measured motion.

    Args:
        rotation: orthogonal, (3, 3); ``scale``; ``left``: RMS of the rest relative to the RMS of the motion.
    """

    rotation: Array
    scale: float
    left: float


def check_points(data: CheckContext) -> Iterator[Finding]:
    """The motion of ``ee`` against that of the URDF with the measured joints, and the motion of ``tool`` against ``ee``.

    Joints are corrected first where another finding names their factor; where columns are exchanged they are not compared.
    """
    machine = data.machine
    kinematics = machine.kinematics()
    joints = [axis_signal(axis, "joint") for axis in machine.axis_names]
    if kinematics is not None and not data.exchanged:
        rows = _rows(data.recordings, (*joints, *point_signals("ee")))
        if len(rows) >= MIN_ROWS:
            factors = np.array([data.corrections.get(axis, 1.0) for axis in machine.axis_names])
            yield from _end_effector(machine, kinematics, rows[:, :-3] / factors, rows[:, -3:])
    rows = _rows(data.recordings, (*point_signals("ee"), *point_signals("tool")))
    if len(rows) >= MIN_ROWS:
        yield from _scaled("tool", rows[:, :3], rows[:, 3:], "ee")


def _rows(recordings: Sequence[Recording], signals: Sequence[str]) -> Array:
    """Rows in which all signals were measured, (n, signals)."""
    parts = []
    for recording in recordings:
        if all(signal in recording.signals for signal in signals):
            table = np.column_stack([thinned(recording.values(signal), MAX_ROWS) for signal in signals])
            parts.append(table[~np.isnan(table).any(axis=1)])
    rows = np.concatenate(parts) if parts else np.empty((0, len(signals)))
    return rows[:: max(1, math.ceil(len(rows) / MAX_ROWS))]


def _end_effector(machine: Machine, kinematics: Kinematics, q: Array, measured: Array) -> Iterator[Finding]:
    computed = kinematics.tip_position(q)
    if np.max(np.std(computed, axis=0)) < LEAST_M or not np.ptp(measured, axis=0).any():
        return
    found = list(_scaled("ee", computed, measured, "the URDF with the measured joints"))
    if found:
        yield from found
        return
    turned = registration(computed, measured)
    if turned.left > FITS:
        yield from _joints(machine, kinematics, q, measured, turned)
        return
    if not 1.0 / NOTICE < turned.scale < NOTICE:
        yield _scale_finding("ee", ("x", "y", "z"), [turned.scale] * 3, "the URDF with the measured joints", True)
    yield from _frame(turned, np.std(computed, axis=0), _direct(computed, measured))


def _scaled(point: str, expected: Array, measured: Array, by: str) -> Iterator[Finding]:
    """Coordinates that move in proportion to the expected ones, by another factor."""
    factors = np.ones(3)
    for k in range(3):
        a, b = expected[:, k] - expected[:, k].mean(), measured[:, k] - measured[:, k].mean()
        if np.std(a) > LEAST_M and np.std(b) > 0.0 and abs(a @ b) > CORRELATED * math.sqrt((a @ a) * (b @ b)):
            factors[k] = (a @ b) / (a @ a)
    wrong = [k for k in range(3) if not 1.0 / NOTICE < abs(factors[k]) < NOTICE]
    compared = int(np.count_nonzero(factors != 1.0))
    groups: dict[str, list[int]] = {}
    for k in wrong:
        groups.setdefault(_length(abs(factors[k])).is_, []).append(k)
    for members in groups.values():
        whole = point == "ee" and len(members) == compared > 1
        yield _scale_finding(point, ["xyz"[k] for k in members], [float(factors[k]) for k in members], by, whole)
    mirrored = [k for k in range(3) if k not in wrong and factors[k] < 0.0]
    if len(mirrored) % 2:
        signals = [f"{point}.{'xyz'[k]}" for k in mirrored]
        cause = opposite_sign(*signals, remedy="Set `sign = -1` in the recipe, or correct the frame")
        evidence = Evidence(f"{listed(signals)} moves against the motion of {by}", "the same direction")
        yield Finding(tuple(f"{signal}:sign" for signal in signals), "severe", (evidence,), (cause,))


def _length(factor: float) -> UnitMistake:
    return min(LENGTH, key=lambda mistake: mistake.distance(factor, 0.2))


def _scale_finding(point: str, coordinates: Sequence[str], factors: Sequence[float], by: str, whole: bool) -> Finding:
    """The finding; ``whole``: all coordinates have the factor, so that the URDF may have it as well."""
    mean = float(np.exp(np.mean(np.log(np.abs(factors)))))
    signals = [f"{point}.{each}" for each in coordinates]
    mistake = _length(mean)
    causes: tuple[Cause, ...] = ()
    if abs(math.log(mean / mistake.factor)) < math.log(NOTICE):
        remedy = f'Set `unit = "{mistake.is_}"` (motion capture: `length_unit`) in the recipe'
        causes = (mistake.cause(*signals, remedy=remedy),)
        if whole:
            inverse = mistake.inverse
            lengths = Cause("the lengths", ("of the URDF",), factor_text(inverse.factor), inverse.factor, "A URDF is in m")
            causes = (*causes, lengths)
    severity: Severity = "notice" if 1.0 / SEVERE < mean < SEVERE else "severe"
    found = f"{listed(signals)} move{'' if len(signals) > 1 else 's'} {ratio_text(mean)} the motion of {by}"
    keys = tuple(f"{signal}:scale" for signal in signals)
    return Finding(keys, severity, (Evidence(found, "the same"),), causes)


def registration(computed: Array, measured: Array) -> Registration:
    """Least squares over rotations, reflections and a scale (Umeyama, IEEE Trans. PAMI 13 (1991) 376), (n, 3) each."""
    a, b = computed - computed.mean(axis=0), measured - measured.mean(axis=0)
    u, values, v = np.linalg.svd(b.T @ a)
    rotation = u @ v
    scale = float(values.sum() / max(float(np.sum(a**2)), 1e-300))
    left = float(np.sqrt(np.sum((b - scale * a @ rotation.T) ** 2) / max(float(np.sum(b**2)), 1e-300)))
    return Registration(rotation, scale, left)


def _direct(computed: Array, measured: Array) -> float:
    """Share of the motion that is left without any rotation."""
    a, b = computed - computed.mean(axis=0), measured - measured.mean(axis=0)
    return float(np.sqrt(np.sum((b - a) ** 2) / max(float(np.sum(b**2)), 1e-300)))


def _frame(turned: Registration, spread: Array, direct: float) -> Iterator[Finding]:
    """Exchanged coordinates, and another frame."""
    if direct < FAILS:
        return
    nearest = np.zeros((3, 3))
    for row in range(3):
        column = int(np.argmax(np.abs(turned.rotation[row])))
        nearest[row, column] = np.sign(turned.rotation[row, column])
    # The direction in which a planar mechanism does not move is unknown.
    planar = np.min(spread) < LEAST_M
    square = np.all(np.abs(nearest).sum(axis=0) == 1.0) and np.abs(turned.rotation - nearest).max() < math.sin(RIGHT_ANGLE)
    axes = ", ".join(f"ee.{'xyz'[row]} = {_signed(nearest[row])}" for row in range(3))
    mirror = np.linalg.det(turned.rotation) < 0.0
    moved = [row for row in range(3) if nearest[row, row] != 1.0]
    keys = tuple(f"ee.{'xyz'[row]}:axes" for row in moved) or ("ee:frame",)
    if square and mirror and not planar:
        says = f"exchanged or of another sign ({axes} of the URDF's base)"
        cause = Cause("coordinates", ("of ee",), says, 1.0, "Correct the fields or signs in the recipe")
        evidence = Evidence(
            "the motion of ee is a mirror image of that of the URDF with the measured joints", "the same motion"
        )
        yield Finding(keys, "severe", (evidence,), (cause,))
        return
    says = f"exchanged, or those of another frame ({axes})" if square else "those of another frame"
    angle = math.degrees(math.acos(max(-1.0, min(1.0, (abs(float(np.trace(turned.rotation))) - 1.0) / 2.0))))
    found = "ee moves as the URDF with the measured joints does in a rotated frame" + ("" if square else f" (by {angle:.0f}°)")
    cause = Cause("coordinates", ("of ee",), says, 1.0, "Give its pose in `[streams.frame]` (sysid ingest --propose-frame)")
    yield Finding(("ee:frame",), "notice", (Evidence(found, "the base frame of the URDF"),), (cause,))


def _signed(row: Array) -> str:
    column = int(np.argmax(np.abs(row)))
    return f"{'−' if row[column] < 0.0 else ''}{'xyz'[column]}"


def _joints(machine: Machine, kinematics: Kinematics, q: Array, measured: Array, turned: Registration) -> Iterator[Finding]:
    """Mistakes in joints that make the URDF follow the end effector."""
    tried: list[tuple[float, Cause, tuple[str, ...]]] = []

    def attempt(changed: Array, cause: Cause, axes: tuple[str, ...]) -> None:
        fit = registration(kinematics.tip_position(changed), measured)
        if 1.0 / NOTICE < fit.scale < NOTICE:
            tried.append((fit.left, cause, tuple(f"{axis}.joint:kinematics" for axis in axes)))

    names = machine.axis_names
    revolute = [k for k, axis in enumerate(machine.axes) if machine.expected_unit(axis_signal(axis.name, "joint")) == "rad"]
    for k, name in enumerate(names):
        units = ANGLE if k in revolute else LENGTH
        for mistake in units:
            attempt(_with(q, [k], 1.0 / mistake.factor), mistake.cause(f"{name}.joint"), (name,))
        attempt(_with(q, [k], -1.0), opposite_sign(f"{name}.joint"), (name,))
    for mistake in ANGLE:
        cause = mistake.cause(*(f"{names[k]}.joint" for k in revolute))
        attempt(_with(q, revolute, 1.0 / mistake.factor), cause, tuple(names[k] for k in revolute))
    for a, b in itertools.combinations(range(len(names)), 2):
        order = list(range(len(names)))
        order[a], order[b] = order[b], order[a]
        attempt(q[:, order], exchanged_columns(f"{names[a]}.joint", f"{names[b]}.joint"), (names[a], names[b]))
    tried.sort(key=lambda item: item[0])
    found = f"the URDF and the joints do not give the motion of ee ({100 * turned.left:.0f} % of it is left)"
    evidence = Evidence(found, f"less than {100 * FITS:.0f} %")
    if tried and tried[0][0] < min(FITS, 0.4 * turned.left):
        best = tried[0][0]
        tied = [item for item in tried if item[0] < best + 0.02][:2]
        yield Finding(tied[0][2], "severe", (evidence,), tuple(item[1] for item in tied))
    elif turned.left > FAILS:
        yield Finding(("ee:kinematics",), "notice", (evidence,))


def _with(q: Array, columns: Sequence[int], factor: float) -> Array:
    changed = q.copy()
    changed[:, columns] *= factor
    return changed
