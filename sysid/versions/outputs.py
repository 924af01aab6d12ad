"""What a network of any kind answers, output by output: from which signals, over which ranges, by which function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.networks import ForwardNetwork, Model, StructuredForward
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: Points at which two networks are compared: along a line, and in more dimensions than one.
LINE_POINTS, CLOUD_POINTS = 1001, 4096


@dataclass(frozen=True)
class OutputMap:
    """One output of a network.

    Args:
        output, unit: the predicted signal and its SI unit.
        inputs, units: the signals that it is predicted from, and their SI units.
        low, high: range of each input in the rows that the network was fitted on, (d,).
        predict: inputs (n, d) → output (n,).
    """

    output: str
    unit: str
    inputs: tuple[str, ...]
    units: tuple[str, ...]
    low: Array
    high: Array
    predict: Callable[[Array], Array]

    @property
    def key(self) -> tuple[str, tuple[str, ...]]:
        """What is the same of two networks that answer the same question."""
        return self.output, self.inputs


def output_maps(model: Model) -> tuple[OutputMap, ...]:
    """Both directions of every axis, or the three coordinates of the end effector."""
    if isinstance(model, ForwardNetwork | StructuredForward):
        units = tuple("rad" if angle else "m" for angle in model.revolute)
        return tuple(
            OutputMap(
                output,
                "m",
                model.joints,
                units,
                model.low,
                model.high,
                lambda q, number=number: model.predict(q)[:, number],  # type: ignore[misc]
            )
            for number, output in enumerate(point_signals("ee"))
        )
    found = []
    for axis, network in model.items():
        cylinder, joint = axis_signal(axis, "cylinder"), axis_signal(axis, "joint")
        for output, source, unit, source_unit, ends, predict in (
            (joint, cylinder, "rad", "m", network.displacements, network.joint),
            (cylinder, joint, "m", "rad", network.joints, network.displacement),
        ):
            low, high = np.array([ends[0]]), np.array([ends[1]])
            found.append(
                OutputMap(
                    output,
                    unit,
                    (source,),
                    (source_unit,),
                    low,
                    high,
                    lambda values, predict=predict: predict(values[:, 0]),  # type: ignore[misc]
                )
            )
    return tuple(found)


def points_between(low: Array, high: Array, seed: int = 0) -> Array:
    """Points that fill a box evenly, its corners among them, (n, d): a line of them, or a scrambled Sobol sequence."""
    if len(low) == 1:
        return np.asarray(np.linspace(low, high, LINE_POINTS))
    from scipy.stats import qmc

    share = qmc.Sobol(len(low), seed=np.random.default_rng(seed)).random(CLOUD_POINTS)
    corners = np.array(np.meshgrid(*[[0.0, 1.0]] * len(low))).reshape(len(low), -1).T[:1024]
    return np.asarray(low + np.vstack([share, corners]) * (high - low))


def shown(value: float, unit: str, digits: int = 3) -> str:
    """A figure in the unit that people read it in: ``shown(0.0034, "m") == "3.40 mm"``, angles in mrad."""
    factor, label = {"m": (1e3, " mm"), "rad": (1e3, " mrad"), "1": (1.0, "")}.get(unit, (1.0, f" {unit}"))
    scaled = factor * value
    if scaled == 0.0 or not np.isfinite(scaled):
        return f"{scaled:g}{label}"
    decimals = max(0, digits - 1 - int(np.floor(np.log10(abs(scaled)))))
    return f"{scaled:.{min(decimals, 9)}f}{label}"
