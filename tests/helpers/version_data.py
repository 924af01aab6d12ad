"""Networks of the test crane without training: perceptrons that hold its linkages, and forward models of random weights."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import numpy.typing as npt
from crane_data import HIGH, LINKAGES, LOW, crane

from sysid.networks import ActuatorNetwork, Calibration, ForwardNetwork, Geometry, Mlp, Normalisation, StructuredForward
from sysid.networks.chain import fit_chain
from sysid.networks.mlp import Rectifier

Array = npt.NDArray[np.float64]
JOINTS = ("slew.joint", "boom.joint", "stick.joint", "telescope.joint")
REVOLUTE = (True, True, True, False)


def piecewise(xs: Array, ys: Array) -> Mlp:
    """A perceptron that interpolates (xs, ys): one rectifier a kink; weights as training stores them, in float32."""
    slopes = np.diff(ys) / np.diff(xs)
    weights = (np.ones((1, len(slopes))), np.r_[slopes[0], np.diff(slopes)][:, None])
    shift = np.r_[xs[0] - 1.0, xs[1:-1]]
    biases = (-shift, np.array([ys[0] - slopes[0]]))
    unit = Normalisation(np.zeros(1), np.ones(1))
    narrow = [tuple(array.astype(np.float32).astype(np.float64) for array in part) for part in (weights, biases)]
    return Mlp(narrow[0], narrow[1], unit, unit)


def actuator(axis: str = "boom", off: float = 0.0, low: float = -0.43, high: float = 1.4) -> dict[str, ActuatorNetwork]:
    """The linkage of one axis, its joint off by ``off`` [rad]."""
    if axis == "stick":
        low, high = -2.6, -0.1
    joints = np.linspace(low, high, 60)
    displacements = LINKAGES[axis].displacement(joints)
    order = np.argsort(displacements)
    ends = (float(displacements[order[0]]), float(displacements[order[-1]]))
    to_joint = piecewise(displacements[order], joints[order] + off)
    return {axis: ActuatorNetwork(axis, to_joint, piecewise(joints, displacements), ends, (low, high))}


def perceptron(inputs: int, outputs: int, seed: int, hidden: tuple[int, ...] = (24, 16), rectifier: Rectifier = "relu") -> Mlp:
    """Random weights of the size that training gives."""
    rng = np.random.default_rng(seed)
    sizes = (inputs, *hidden, outputs)
    weights = tuple(
        rng.normal(0.0, 1.0 / np.sqrt(a), (a, b)).astype(np.float32).astype(np.float64) for a, b in itertools.pairwise(sizes)
    )
    biases = tuple(rng.normal(0.0, 0.3, b).astype(np.float32).astype(np.float64) for b in sizes[1:])
    return Mlp(
        weights,
        biases,
        Normalisation(rng.normal(size=inputs), rng.uniform(0.5, 2.0, inputs)),
        Normalisation(rng.normal(size=outputs), rng.uniform(0.2, 1.0, outputs)),
        rectifier,
    )


def forward(features: str = "joints", members: int = 1, seed: int = 0, rectifier: Rectifier = "relu") -> ForwardNetwork:
    width = {"joints": 4, "sincos": 7, "products": 53}[features]
    every = tuple(perceptron(width, 3, seed + number, rectifier=rectifier) for number in range(members))
    return ForwardNetwork(
        joints=JOINTS, revolute=REVOLUTE, features=features, members=every, low=LOW, high=HIGH  # type: ignore[arg-type]
    )  # fmt: skip


def structured(kind: str = "calibrated", members: int = 0, seed: int = 0) -> StructuredForward:
    """The crane with a geometry that is a little off (and deflects under load), or the products of its chain."""
    rng = np.random.default_rng(seed)
    kinematics = crane().kinematics()
    assert kinematics is not None
    geometry = Geometry(kinematics)
    count = len(geometry.parameters)
    values = 0.5 * geometry.priors * rng.normal(size=count) * (~geometry.elastic | (kind == "elastic"))
    q = LOW + (HIGH - LOW) * rng.uniform(size=(200, 4))
    if kind in ("calibrated", "elastic"):
        structure: object = Calibration(geometry, values, np.diag((0.01 * geometry.priors) ** 2), 1e-3, ())
    else:
        structure = fit_chain(q, geometry.tip(q, values), REVOLUTE)
    rest = tuple(perceptron(7, 3, seed + number) for number in range(members))
    return StructuredForward(
        joints=JOINTS,
        revolute=REVOLUTE,
        structure=structure,  # type: ignore[arg-type]
        urdf=crane().urdf_text or "",
        members=rest,
        bound=0.01 if members else 0.0,
        low=LOW,
        high=HIGH,
    )


def reaching(model: StructuredForward, low: Array, high: Array) -> StructuredForward:
    return replace(model, low=low, high=high)
