"""Compares a machine with an independent reader of its model, in a process of its own: prints one JSON object.

    python -m robots_corpus.check MACHINE.toml MODEL

All three figures are the largest over random poses within the limits: of the tip in metres, of torque and mass matrix relative
to the largest entry of all poses.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from robots_corpus.corpus import SEED
from robots_corpus.peers import MujocoPeer, Peer, PinocchioPeer, Pose, coupling_of
from sysid.errors import SysidError
from sysid.machine.description import Machine, load_machine
from sysid.machine.rigid_body import RigidBody

Array = npt.NDArray[np.float64]
POSES = 20
#: A largest entry below this is rounding: an axis along gravity needs no torque [N·m, N; kg·m², kg].
NOTHING = 1e-4
#: Ends of an axis without limits, and of one that reaches further [rad or m].
WIDEST = math.pi


def poses_of(machine: Machine) -> Array:
    """Random poses within the limits (n, A)."""
    ends = np.array([(-WIDEST, WIDEST) if axis.limits is None else axis.limits for axis in machine.axes])
    low, high = np.clip(ends, -WIDEST, WIDEST).T
    return np.asarray(np.random.default_rng(SEED).uniform(low, high, (POSES, len(ends))))


def ours(machine: Machine, poses: Array) -> list[Pose]:
    """The machine's own tip, gravity torque and mass matrix: columns of the mass matrix are torques of unit accelerations."""
    kinematics = machine.kinematics()
    assert kinematics is not None
    assert machine.urdf_text is not None
    body, (n, count) = RigidBody(kinematics, machine.urdf_text), poses.shape
    still = np.zeros_like(poses)
    torque = body.torque(poses, still, still, body.nominal)
    mass = np.empty((n, count, count))
    for k in range(count):
        unit = np.zeros_like(poses)
        unit[:, k] = 1.0
        mass[:, :, k] = body.torque(poses, still, unit, body.nominal) - torque
    return [Pose(*each) for each in zip(kinematics.tip_position(poses), torque, mass, strict=True)]


def peer_of(machine: Machine, model: Path) -> Peer:
    """The independent reader of a model."""
    kinematics = machine.kinematics()
    assert kinematics is not None
    on_chain = [joint.name for joint in kinematics.chain]
    own = [name for name in kinematics.drives if name in on_chain or model.suffix == ".urdf"]
    coupling = coupling_of(kinematics.drives, machine.axis_names, own)
    kind = PinocchioPeer if model.suffix == ".urdf" else MujocoPeer
    return kind(model, coupling, machine.tip or "")


def compared(machine: Machine, peer: Peer) -> dict[str, float]:
    """Largest differences over all poses."""
    poses = poses_of(machine)
    here, there = ours(machine, poses), [peer.at(q) for q in poses]
    found = {"tip_m": max(float(np.abs(a.tip - b.tip).max()) for a, b in zip(here, there, strict=True))}
    for key, name in (("torque", "torque"), ("mass", "mass_matrix")):
        size = max(float(np.abs(getattr(pose, key)).max()) for pose in there)
        most = max(float(np.abs(getattr(a, key) - getattr(b, key)).max()) for a, b in zip(here, there, strict=True))
        found[name] = most / max(size, NOTHING)
    return found


def check(description: Path, model: Path) -> dict[str, Any]:
    """The outcome; ``failed`` where one of both does not read the model."""
    machine = load_machine(description)
    try:
        peer = peer_of(machine, model)
    except (ValueError, KeyError, RuntimeError) as error:
        return {"peer_failed": " ".join(str(error).split())[:300]}
    found: dict[str, Any] = {"axes": len(machine.axes), "actuation": sorted({axis.actuation for axis in machine.axes})}
    found |= {"peer": peer.name, "differs": peer.differs}
    try:
        return found | compared(machine, peer)
    except SysidError as error:
        return found | {"failed": str(error)[:300]}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("machine", type=Path)
    parser.add_argument("model", type=Path)
    given = parser.parse_args()
    print(json.dumps(check(given.machine, given.model)))
