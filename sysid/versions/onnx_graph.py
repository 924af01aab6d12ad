"""Networks as ONNX graphs of arithmetic operators, built without torch.

The tip of an open chain is linear in products of one factor a joint, (1, sin q, cos q) or (1, q) (:mod:`sysid.networks.chain`).
A calibrated geometry therefore has the same nodes as a fitted chain: its weights follow exactly from the tip position at three
values of each revolute joint and two of each prismatic one. Chains that deflect under load or have passive joints are graphs of
their own (:mod:`sysid.versions.onnx_elastic`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from sysid.networks import Calibration, FittedChain, ForwardNetwork, Mlp, StructuredForward
from sysid.networks.policy import PolicyNetwork
from sysid.versions.onnx_elastic import elastic_tip
from sysid.versions.onnx_nodes import Nodes

Array = npt.NDArray[np.float64]

#: Supported by ONNX Runtime from 1.14 (early 2023) on.
OPSET, IR_VERSION = 18, 8
#: Joint values at which the tip determines the weights of its factors.
ANGLES, SLIDES = (0.0, math.pi / 2.0, math.pi), (0.0, 1.0)


class Graph(Nodes):
    """The nodes of a network."""

    def mlp(self, network: Mlp, value: str) -> str:
        """A perceptron with its normalisations."""
        h = self.add("Div", self.add("Sub", value, self.constant(network.inputs.mean)), self.constant(network.inputs.scale))
        last = len(network.weights) - 1
        for number, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
            h = self.add("Gemm", h, self.constant(weight), self.constant(bias))
            if number < last:
                h = self.add("Relu", h) if network.rectifier == "relu" else self.rounded(h)
        return self.add("Add", self.add("Mul", h, self.constant(network.outputs.scale)), self.constant(network.outputs.mean))

    def rounded(self, x: str) -> str:
        """The smooth rectifier (:data:`sysid.networks.mlp.Rectifier`)."""
        root = self.add("Sqrt", self.add("Add", self.add("Mul", x, x), self.constant([4.0])))
        return self.add("Sub", self.add("Mul", self.add("Add", x, root), self.constant([0.5])), self.constant([1.0]))

    def policy(self, model: PolicyNetwork, value: str) -> str:
        """Observations (n, O) → setpoints (n, A) within their limits."""
        shares = self.add("Tanh", self.mlp(model.mlp, value))
        half, centre = 0.5 * (model.high - model.low), 0.5 * (model.high + model.low)
        setpoints = self.add("Add", self.add("Mul", shares, self.constant(half)), self.constant(centre))
        return self.add("Min", self.add("Max", setpoints, self.constant(model.low)), self.constant(model.high))

    def mean(self, values: Sequence[str]) -> str:
        """The mean of members; ONNX Runtime has the operator ``Mean`` only for float32."""
        total = values[0]
        for value in values[1:]:
            total = self.add("Add", total, value)
        return total if len(values) == 1 else self.add("Mul", total, self.constant([1.0 / len(values)]))

    def features(self, q: str, revolute: Sequence[bool]) -> str:
        """Sines and cosines of revolute joints, values of prismatic ones, in the order of
        :func:`sysid.networks.forward.to_features`."""
        angles = [number for number, angle in enumerate(revolute) if angle]
        slides = [number for number, angle in enumerate(revolute) if not angle]
        parts = []
        if angles:
            turned = self.columns(q, angles)
            parts += [self.add("Sin", turned), self.add("Cos", turned)]
        if slides:
            parts.append(self.columns(q, slides))
        return parts[0] if len(parts) == 1 else self.add("Concat", *parts, axis=1)

    def products(self, q: str, revolute: Sequence[bool]) -> str:
        """All products of one factor a joint, the constant first, (n, P + 1)."""
        rows = ""
        for number, angle in enumerate(revolute):
            column = self.columns(q, [number])
            one = self.add("Add", self.add("Mul", column, self.constant([0.0])), self.constant([1.0]))
            own = [one, self.add("Sin", column), self.add("Cos", column)] if angle else [one, column]
            factor = self.add("Concat", *own, axis=1)
            if not rows:
                rows = factor
                continue
            outer = self.add(
                "Mul",
                self.add("Unsqueeze", rows, self.constant([2], whole=True)),
                self.add("Unsqueeze", factor, self.constant([1], whole=True)),
            )
            rows = self.add("Flatten", outer, axis=1)
        return rows

    def forward(self, model: ForwardNetwork | StructuredForward, q: str) -> str:
        """Joint values (n, n_axes) → tip (n, 3)."""
        if isinstance(model, ForwardNetwork):
            if model.features == "products":
                every = self.products(q, model.revolute)
                inputs = self.columns(every, range(1, len(model.members[0].inputs.mean) + 1))
            else:
                inputs = q if model.features == "joints" else self.features(q, model.revolute)
            return self.mean([self.mlp(member, inputs) for member in model.members])
        if isinstance(model.structure, Calibration) and not is_multilinear(model.structure):
            tip = elastic_tip(self, model.structure.geometry.elastic_chain(model.structure.values), q)
        else:
            stretch, weights = chain_weights(model.structure, model.revolute)
            turned = self.add("Mul", q, self.constant(stretch)) if np.any(stretch != 1.0) else q
            tip = self.add("MatMul", self.products(turned, model.revolute), self.constant(weights))
        if not model.members:
            return tip
        inputs, bound = self.features(q, model.revolute), self.constant([model.bound])
        rest = [
            self.add("Mul", self.add("Tanh", self.add("Div", self.mlp(member, inputs), bound)), bound)
            for member in model.members
        ]
        return self.add("Add", tip, self.mean(rest))


def is_multilinear(structure: Calibration) -> bool:
    """Whether the tip is linear in the products of one factor a joint: none deflects under load or follows another."""
    return not structure.elastic and not any(joint.passive for joint in structure.geometry.chain)


def chain_weights(structure: Calibration | FittedChain, revolute: Sequence[bool]) -> tuple[Array, Array]:
    """Scale of each joint's measurement, (n_axes,), and weights of the products, (P + 1, 3), the constant first."""
    if isinstance(structure, FittedChain):
        weights = structure.weights / structure.scale[:, None]
        return np.ones(len(revolute)), np.vstack([structure.level - structure.mean @ weights, weights])
    moved = {
        parameter.key: float(value) for parameter, value in zip(structure.geometry.parameters, structure.values, strict=True)
    }
    stretch = np.array([1.0 + moved[f"{name}.scale"] for name in structure.geometry.kinematics.actuated])
    places = [ANGLES if angle else SLIDES for angle in revolute]
    grid = np.stack([axis.ravel() for axis in np.meshgrid(*places, indexing="ij")], axis=1)
    weights = structure.predict(grid / stretch).reshape(*(len(place) for place in places), 3)
    for number, (angle, place) in enumerate(zip(revolute, places, strict=True)):
        at = np.array(place)
        factors = np.stack([np.ones_like(at), np.sin(at), np.cos(at)] if angle else [np.ones_like(at), at], axis=1)
        weights = np.moveaxis(np.tensordot(np.linalg.inv(factors), weights, axes=(1, number)), 0, number)
    return stretch, weights.reshape(-1, 3)
