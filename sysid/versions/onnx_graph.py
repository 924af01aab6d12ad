"""Networks as ONNX graphs of arithmetic operators, built without torch.

The tip of an open chain is linear in products of one factor a joint, (1, sin q, cos q) or (1, q) (:mod:`sysid.networks.chain`).
A calibrated geometry therefore has the same nodes as a fitted chain: its weights follow exactly from the tip position at three
values of each revolute joint and two of each prismatic one.

Chains that deflect under load or have passive joints are graphs of their own. The equations are those of
:mod:`sysid.networks.geometry`, one node an operation: orientations are (n, 3, 3), vectors and loads (n, 3, 1) and (n, 1, 1).
The deflected pose is reached in a fixed number of steps, so that the graph has no loop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.machine.kinematics import GRAVITY
from sysid.networks import Calibration, FittedChain, ForwardNetwork, Mlp, StructuredForward
from sysid.networks.calibrated_chain import ElasticChain, ElasticJoint
from sysid.networks.policy import PolicyNetwork

Array = npt.NDArray[np.float64]


#: Added to a squared angle, so that its root is not zero.
TINY = 1e-30


@dataclass(frozen=True)
class _Pose:
    """Names of the orientations after the tilt, of the origins, and of the frames that the joints move."""

    tilted: list[str]
    origins: list[str]
    moved: list[tuple[str, str]]


@dataclass(frozen=True)
class _Loads:
    """Names of the load of each joint's axis and of the two moments across it; None for zero."""

    own: list[str | None]
    across: list[tuple[str, str] | None]


def elastic_tip(graph: Graph, chain: ElasticChain, q: str) -> str:
    """Joint values (n, n_axes) → tip (n, 3)."""
    nodes = _Chain(graph, chain, q)
    loads = _Loads([None] * len(chain.joints), [None] * len(chain.joints))
    for _ in range(chain.settling):
        loads = nodes.loads(nodes.pose(loads))
    turn, at = nodes.pose(loads).moved[chain.after + 1]
    tip = graph.add("Add", at, graph.add("MatMul", turn, graph.constant(chain.point[:, None])))
    return graph.add("Reshape", tip, graph.constant([-1, 3], whole=True))


class _Chain:
    def __init__(self, graph: Graph, chain: ElasticChain, q: str) -> None:
        self.graph, self.chain = graph, chain
        whole = graph.constant([-1, 1, 1], whole=True)
        used = {joint.column for joint in chain.joints}
        self.values = {column: graph.add("Reshape", graph.columns(q, [column]), whole) for column in sorted(used)}

    def pose(self, loads: _Loads) -> _Pose:
        """The pose under given loads."""
        graph = self.graph
        turn = graph.constant(self.chain.frame[None, :3, :3])
        at = graph.constant(self.chain.frame[None, :3, 3:])
        found = _Pose([], [], [(turn, at)])
        for number, joint in enumerate(self.chain.joints):
            at = graph.add("Add", at, graph.add("MatMul", turn, graph.constant(joint.shift[:, None])))
            turn = graph.add("MatMul", turn, graph.constant(joint.turn))
            across = loads.across[number]
            if across is not None and np.any(joint.lateral):
                turn = graph.add("MatMul", turn, self._tilt(joint, across))
            found.tilted.append(turn)
            found.origins.append(at)
            value = self._motion(joint, loads)
            if joint.prismatic:
                along = graph.add("MatMul", turn, graph.constant(joint.axis[:, None]))
                at = graph.add("Add", at, graph.add("Mul", along, value))
            else:
                cross = _cross(joint.axis)
                sine, cosine = graph.add("Sin", value), graph.add("Cos", value)
                own = self._rotation(sine, graph.add("Sub", graph.constant([1.0]), cosine), cross, cross @ cross)
                turn = graph.add("MatMul", turn, own)
            found.moved.append((turn, at))
        return found

    def _motion(self, joint: ElasticJoint, loads: _Loads) -> str:
        """Value of a joint, (n, 1, 1)."""
        graph, value = self.graph, self.values[joint.column]
        load = loads.own[joint.master] if joint.master is not None else None
        if joint.scale:
            value = graph.add("Mul", value, graph.constant([1.0 + joint.scale]))
        if load is not None and joint.compliance:
            value = graph.add("Sub", value, graph.add("Mul", load, graph.constant([joint.compliance])))
        if joint.ratio == 1.0 and joint.offset == 0.0:
            return value
        return graph.add("Add", graph.add("Mul", value, graph.constant([joint.ratio])), graph.constant([joint.offset]))

    def _rotation(self, sine: str, versine: str, cross: Array, square: Array) -> str:
        """1 + sine·cross + versine·square, (n, 3, 3)."""
        graph = self.graph
        parts = graph.add("Mul", sine, graph.constant(cross)), graph.add("Mul", versine, graph.constant(square))
        return graph.add("Add", graph.constant(np.eye(3)), graph.add("Add", *parts))

    def _tilt(self, joint: ElasticJoint, across: Sequence[str]) -> str:
        """Rotation of the lateral deflection, (n, 3, 3) (Rodrigues)."""
        graph = self.graph
        matrices, squares = [], []
        for moment, lateral, direction in zip(across, joint.lateral, joint.across, strict=True):
            angle = graph.add("Mul", moment, graph.constant([lateral]))
            matrices.append(graph.add("Mul", angle, graph.constant(_cross(direction))))
            squares.append(graph.add("Mul", angle, angle))
        cross = graph.add("Add", *matrices)
        angle = graph.add("Sqrt", graph.add("Add", graph.add("Add", *squares), graph.constant([TINY])))
        half = graph.add("Sin", graph.add("Mul", angle, graph.constant([0.5])))
        share = graph.add("Div", half, angle)  # (1 − cos a)/a² = 2·(sin(a/2)/a)²
        versine = graph.add("Mul", graph.add("Mul", share, share), graph.constant([2.0]))
        sine = graph.add("Div", graph.add("Sin", angle), angle)
        turned = graph.add("Mul", versine, graph.add("MatMul", cross, cross))
        return graph.add("Add", graph.constant(np.eye(3)), graph.add("Add", graph.add("Mul", sine, cross), turned))

    def loads(self, pose: _Pose) -> _Loads:
        """Gravity loads of a pose: suffix sums of mass and first moment from the tip to the base."""
        graph = self.graph
        down = -GRAVITY * self.chain.frame[:3, 2]
        against = graph.constant(-_cross(down))  # a × down = −[down]·a
        count = len(self.chain.joints)
        found = _Loads([None] * count, [None] * count)
        mass, first = 0.0, graph.constant(np.zeros((1, 3, 1)))
        for number in reversed(range(count)):
            joint = self.chain.joints[number]
            turn, at = pose.moved[number + 1]
            mass += joint.mass
            centre = graph.add("Add", at, graph.add("MatMul", turn, graph.constant(joint.centre[:, None])))
            first = graph.add("Add", first, graph.add("Mul", centre, graph.constant([joint.mass])))
            lever = graph.add("Sub", first, graph.add("Mul", pose.origins[number], graph.constant([mass])))
            moment = graph.add("MatMul", against, lever)
            if joint.master is not None:
                force = graph.constant(mass * down[None, :, None]) if joint.prismatic else moment
                own = graph.add("Mul", self._along(pose.tilted[number], joint.axis, force), graph.constant([-joint.ratio]))
                before = found.own[joint.master]
                found.own[joint.master] = own if before is None else graph.add("Add", before, own)
            one, other = (self._along(pose.tilted[number], direction, moment) for direction in joint.across)
            found.across[number] = one, other
        return found

    def _along(self, turn: str, direction: Array, vector: str) -> str:
        """Component of a vector (n, 3, 1) in a direction of a frame, (n, 1, 1).

        As a sum, since ONNX Runtime merges a product of matrices with a factor behind it and rounds that to 32 bits.
        """
        graph = self.graph
        turned = graph.add("MatMul", turn, graph.constant(direction[:, None]))
        return graph.add("ReduceSum", graph.add("Mul", turned, vector), graph.constant([1], whole=True), keepdims=1)


def _cross(vector: Array) -> Array:
    """The matrix of a cross product from the left, (3, 3)."""
    x, y, z = vector
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


#: Supported by ONNX Runtime from 1.14 (early 2023) on.
OPSET, IR_VERSION = 18, 8
#: Joint values at which the tip determines the weights of its factors.
ANGLES, SLIDES = (0.0, math.pi / 2.0, math.pi), (0.0, 1.0)


class Graph:
    """Nodes and constants in the order of their addition; values are referred to by name.

    Args:
        dtype: of all numbers.
    """

    def __init__(self, dtype: type[np.float32] | type[np.float64]) -> None:
        self.dtype = dtype
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def add(self, operator: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """One node; returns the name of its output."""
        from onnx import helper

        name = output or f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [name], name=f"node_{len(self.nodes)}", **attributes))
        return name

    def constant(self, values: npt.ArrayLike, whole: bool = False) -> str:
        """A constant of the graph's type, or of whole numbers."""
        from onnx import numpy_helper

        name = f"constant_{len(self.constants)}"
        array = np.asarray(values, dtype=np.int64 if whole else self.dtype)
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def columns(self, value: str, which: Sequence[int]) -> str:
        return self.add("Gather", value, self.constant(list(which), whole=True), axis=1)

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
