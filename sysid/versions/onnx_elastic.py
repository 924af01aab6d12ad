"""ONNX graph of a calibrated chain whose joints deflect under load or follow others.

The equations are those of :mod:`sysid.networks.geometry`, one node an operation: orientations are (n, 3, 3), vectors and loads
(n, 3, 1) and (n, 1, 1). The deflected pose is reached in a fixed number of steps, so that the graph has no loop.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.machine.kinematics import GRAVITY
from sysid.networks.reduced_chain import ElasticChain, ElasticJoint
from sysid.versions.onnx_nodes import Nodes

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


def elastic_tip(graph: Nodes, chain: ElasticChain, q: str) -> str:
    """Joint values (n, n_axes) → tip (n, 3)."""
    nodes = _Chain(graph, chain, q)
    loads = _Loads([None] * len(chain.joints), [None] * len(chain.joints))
    for _ in range(chain.settling):
        loads = nodes.loads(nodes.pose(loads))
    turn, at = nodes.pose(loads).moved[chain.after + 1]
    tip = graph.add("Add", at, graph.add("MatMul", turn, graph.constant(chain.point[:, None])))
    return graph.add("Reshape", tip, graph.constant([-1, 3], whole=True))


class _Chain:
    def __init__(self, graph: Nodes, chain: ElasticChain, q: str) -> None:
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
