"""The outputs of a network of any kind: input signals, fitted ranges, and the function of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Recording
from sysid.networks import (
    ActuatorNetwork,
    ForwardNetwork,
    HistoryNetwork,
    Model,
    MotionNetwork,
    StructuredForward,
    history_networks,
    motion_networks,
    static_networks,
)
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: Number of points at which two networks are compared: in one dimension, and in several.
LINE_POINTS, CLOUD_POINTS = 1001, 4096
#: Prediction horizon of command → motion networks in row-wise evaluation [s].
HORIZON = 1.0


@dataclass(frozen=True)
class OutputMap:
    """One output of a network.

    Args:
        output, unit: the predicted signal and its SI unit.
        inputs, units: the signals that it is predicted from, and their SI units.
        low, high: range of each input in the rows that the network was fitted on, (d,).
        predict: inputs (n, d) → output (n,).
        run: of networks with history: a recording → output on its rows (n,), NaN where there is none.
        rate_hz: of networks with history: sampling rate of the rows of ``predict``.
    """

    output: str
    unit: str
    inputs: tuple[str, ...]
    units: tuple[str, ...]
    low: Array
    high: Array
    predict: Callable[[Array], Array]
    run: Callable[[Recording], Array] | None = None
    rate_hz: float = 0.0

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """Equal for outputs of two networks that can be compared."""
        return self.output, self.inputs


def output_maps(model: Model) -> tuple[OutputMap, ...]:
    """Both directions of every axis, its motion, or the three coordinates of the end effector."""
    if motions := motion_networks(model):
        return tuple(map(_motion, motions.values()))
    if isinstance(model, ForwardNetwork | StructuredForward):
        return tuple(_coordinate(model, number, output) for number, output in enumerate(point_signals("ee")))
    histories = history_networks(model)
    axes = static_networks(model).items()
    return tuple(
        item
        for axis, network in axes
        for item in (_with_history(histories[axis]) if axis in histories else _static(axis, network))
    )


def _coordinate(model: ForwardNetwork | StructuredForward, number: int, output: str) -> OutputMap:
    units = tuple("rad" if angle else "m" for angle in model.revolute)
    return OutputMap(output, "m", model.joints, units, model.low, model.high, lambda q: model.predict(q)[:, number])


def _static(axis: str, network: ActuatorNetwork) -> tuple[OutputMap, OutputMap]:
    return (
        _direction(axis, True, network.displacements, lambda values: network.joint(values[:, 0])),
        _direction(axis, False, network.joints, lambda values: network.displacement(values[:, 0])),
    )


def _with_history(network: HistoryNetwork) -> tuple[OutputMap, OutputMap]:
    """Both directions along a motion, sampled at the steps of the recurrent part."""
    cylinder, joint = axis_signal(network.axis, "cylinder"), axis_signal(network.axis, "joint")
    to_joint, to_cylinder = (1.0 / memory.interval for memory in (network.to_joint, network.to_cylinder))
    return (
        _direction(
            network.axis, True, network.static.displacements, lambda values: network.joint_along(values[:, 0], to_joint),
            lambda recording: network.joint_along(recording.values(cylinder), recording.rate_hz), to_joint,
        ),
        _direction(
            network.axis, False, network.static.joints, lambda values: network.displacement_along(values[:, 0], to_cylinder),
            lambda recording: network.displacement_along(recording.values(joint), recording.rate_hz), to_cylinder,
        ),
    )  # fmt: skip


def _direction(
    axis: str,
    to_joint: bool,
    ends: tuple[float, float],
    predict: Callable[[Array], Array],
    run: Callable[[Recording], Array] | None = None,
    rate_hz: float = 0.0,
) -> OutputMap:
    """One direction of an axis; ``ends`` of its input."""
    cylinder, joint = (axis_signal(axis, "cylinder"), "m"), (axis_signal(axis, "joint"), "rad")
    (source, unit), output = (cylinder, joint) if to_joint else (joint, cylinder)
    low, high = np.array(ends)[:, None]
    return OutputMap(*output, (source,), (unit,), low, high, predict, run, rate_hz)


def _motion(network: MotionNetwork) -> OutputMap:
    """The position after :data:`HORIZON` seconds on a recording; from rest in the middle for ``predict``."""

    def predict(values: Array) -> Array:
        middle = values[0, 0] if network.window.follows else 0.5 * sum(network.bounds.positions)
        stream = network.stream(float(middle))
        return np.array([stream.step(float(value)) for value in values[:, 0]])

    low, high = network.commands
    return OutputMap(
        network.driven,
        network.unit,
        (network.command,),
        (network.unit if network.window.follows else "1",),
        np.array([low]),
        np.array([high]),
        predict,
        lambda recording: network.ahead(recording, HORIZON),
        1.0 / network.window.step,
    )


def sweep_between(low: Array, high: Array) -> Array:
    """A swept sine through a range, (n, 1)."""
    turns = 6.0 * np.linspace(0.0, 1.0, LINE_POINTS) ** 2
    return np.asarray(low + (high - low) * (0.5 + 0.5 * np.sin(2.0 * np.pi * turns))[:, None])


def points_between(low: Array, high: Array) -> Array:
    """Points in a box, corners included, (n, d): evenly spaced in one dimension, else a scrambled Sobol sequence."""
    if len(low) == 1:
        return np.asarray(np.linspace(low, high, LINE_POINTS))
    from scipy.stats import qmc

    share = qmc.Sobol(len(low), seed=np.random.default_rng(0)).random(CLOUD_POINTS)
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * len(low))).reshape(len(low), -1).T[:1024]
    return np.asarray(low + np.vstack([share, corners]) * (high - low))
