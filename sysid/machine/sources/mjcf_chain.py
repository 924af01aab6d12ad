"""The chain of an MJCF from the world to its end effector: joints, what drives each, and what cannot be expressed.

A machine of ``machine.toml`` is an open chain whose every joint has one actuator or follows another one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sysid.errors import SettingsError, nearest
from sysid.foreign import shown
from sysid.machine.mimic import Mimic
from sysid.machine.sources.draft import choose_tip
from sysid.machine.sources.mjcf_model import actuator_name, body_name, joint_name, joints_of, mujoco_library, path_to
from sysid.names import listed


@dataclass(frozen=True)
class ChainJoint:
    """A hinge or slide of the chain: driven by ``actuator``, or following another joint."""

    joint: int
    actuator: int | None = None
    follows: Mimic | None = None


@dataclass(frozen=True)
class Chain:
    """Bodies from the world to the body of the tip, and their joints; ``site``: the tip, or None for the body's origin."""

    bodies: tuple[int, ...]
    joints: tuple[ChainJoint, ...]
    site: int | None

    @property
    def driven(self) -> tuple[ChainJoint, ...]:
        return tuple(joint for joint in self.joints if joint.actuator is not None)


def find_chain(model: Any, source: str, tip: str | None = None) -> Chain:
    """The chain to ``tip``, a site or body; by default to the end of the longest driven chain.

    Raises:
        SettingsError: it contains what ``machine.toml`` cannot express; the message names it.
    """
    mujoco, drivers = mujoco_library(), joint_actuators(model)
    body, site = _tip(model, drivers, source) if tip is None else named_point(model, tip, f"{source}: tip")
    bodies = path_to(model, body)
    joints = [joint for each in bodies for joint in joints_of(model, each)]
    found = []
    for joint in joints:
        where, kind = f"{source}: joint {shown(joint_name(model, joint))}", int(model.jnt_type[joint])
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            raise _floating(model, joint, source)
        if kind == mujoco.mjtJoint.mjJNT_BALL:
            remedy = "Replace it by hinges, or choose an end effector in front of it with --tip."
            raise SettingsError(where, "a ball joint", "hinges and slides from the base to the end effector", remedy)
        actuators = drivers.get(joint, [])
        if len(actuators) > 1:
            names = listed([actuator_name(model, k) for k in actuators])
            remedy = "Keep one of them; of sensors, targets and dampers beside it the controller's one."
            raise SettingsError(where, f"{len(actuators)} actuators: {names}", "one actuator a joint", remedy)
        if actuators:
            found.append(ChainJoint(joint, actuators[0]))
            continue
        follows = _coupling(model, joint, {j for j in joints if j in drivers}, source)
        if follows is None:
            remedy = "Give it an actuator, couple it by <equality><joint>, or choose an end effector in front of it with --tip."
            raise SettingsError(where, "no actuator drives it, and it moves the end effector", "a driven joint", remedy)
        found.append(ChainJoint(joint, None, follows))
    if not any(joint.actuator is not None for joint in found):
        raise SettingsError(f"{source}: tip", "no driven joint moves it", "the end of a chain of driven joints")
    chain = Chain(tuple(bodies), tuple(found), site)
    _check_tendons(model, joints, source)
    _check_loops(model, joints, source)
    return chain


def joint_actuators(model: Any) -> dict[int, list[int]]:
    """Joint → actuators that act on it alone."""
    kinds = mujoco_library().mjtTrn
    found: dict[int, list[int]] = {}
    for k in range(model.nactuator):
        if int(model.actuator_trntype[k]) in (kinds.mjTRN_JOINT, kinds.mjTRN_JOINTINPARENT):
            found.setdefault(int(model.actuator_trnid[k, 0]), []).append(k)
    return found


def named_point(model: Any, name: str, where: str) -> tuple[int, int | None]:
    """A site with its body, or a body.

    Raises:
        SettingsError: neither has that name.
    """
    sites = {str(model.site(k).name): k for k in range(model.nsite)}
    bodies = {body_name(model, k): k for k in range(1, model.nbody)}
    if name in sites:
        return int(model.site_bodyid[sites[name]]), sites[name]
    if name not in bodies:
        raise SettingsError(where, f"unknown site or body {shown(name)}", nearest(name, [*sites, *bodies]))
    return bodies[name], None


def _tip(model: Any, drivers: dict[int, list[int]], source: str) -> tuple[int, int | None]:
    """End of the longest driven chain: behind its last joint along fixed bodies as far as they do not branch.

    The one site on that body, if there is one, is the tip.
    """
    children: dict[int, list[int]] = {}
    for body in range(1, model.nbody):
        children.setdefault(int(model.body_parentid[body]), []).append(body)
    moving = {*drivers, *(joint for pair in joint_equalities(model) for joint in pair if {*pair} & drivers.keys())}
    driven = {
        body: tuple(joint_name(model, j) for each in path_to(model, body) for j in joints_of(model, each) if j in moving)
        for body in range(1, model.nbody)
    }
    ends = [body for body in driven if any(j in moving for j in joints_of(model, body))]
    floating = {body: joint for body in ends if (joint := _free_joint(model, body)) is not None}
    if ends and len(floating) == len(ends):
        raise _floating(model, floating[ends[0]], source)
    last = {body_name(model, body): driven[body] for body in ends if body not in floating}
    chosen = choose_tip(last, source)
    body = next(body for body in driven if driven[body] == chosen and body_name(model, body) in last)
    while True:
        fixed = [child for child in children.get(body, []) if model.body_jntnum[child] == 0]
        if len(fixed) != 1:
            break
        body = fixed[0]
    sites = [k for k in range(model.nsite) if int(model.site_bodyid[k]) == body]
    return body, sites[0] if len(sites) == 1 else None


def _free_joint(model: Any, body: int) -> int | None:
    """The free joint that a body hangs on."""
    free = mujoco_library().mjtJoint.mjJNT_FREE
    return next((joint for joint in _above(model, body) if int(model.jnt_type[joint]) == free), None)


def _floating(model: Any, joint: int, source: str) -> SettingsError:
    base = body_name(model, int(model.jnt_bodyid[joint]))
    own = f"joint {shown(joint_name(model, joint))}" if model.joint(joint).name else f"body {shown(base)}"
    remedy = f"Remove the joint and its values in keyframes: {base} is fixed to the world then."
    return SettingsError(f"{source}: {own}", "a free joint", "a base that is fixed to the world", remedy)


def joint_equalities(model: Any) -> dict[tuple[int, int], int]:
    """Pairs of coupled joints, (joint1, joint2) → number of the active equality."""
    kind = mujoco_library().mjtEq.mjEQ_JOINT
    active = [k for k in range(model.neq) if int(model.eq_type[k]) == kind and model.eq_active0[k]]
    return {(int(model.eq_obj1id[k]), int(model.eq_obj2id[k])): k for k in active if int(model.eq_obj2id[k]) >= 0}


def _coupling(model: Any, joint: int, driven: set[int], source: str) -> Mimic | None:
    """``q = ratio·q_master + offset`` of an equality with a driven joint; MuJoCo's is ``y − y₀ = Σ aₖ·(x − x₀)ᵏ``."""
    for (y, x), k in joint_equalities(model).items():
        if joint not in (y, x) or not driven & {y, x}:
            continue
        curve = [float(value) for value in model.eq_data[k, :5]]
        y0, x0 = (float(model.qpos0[model.jnt_qposadr[j]]) for j in (y, x))
        name = f"{source}: equality of {joint_name(model, y)} and {joint_name(model, x)}"
        if any(curve[2:]):
            raise SettingsError(name, f"polycoef {curve}", "a straight line: polycoef = offset ratio 0 0 0")
        ratio, offset = curve[1], y0 + curve[0] - curve[1] * x0
        if joint == y:
            return Mimic(joint_name(model, x), ratio, offset)
        if ratio == 0.0:
            raise SettingsError(name, "ratio 0", "a joint that moves with the other one")
        return Mimic(joint_name(model, y), 1.0 / ratio, -offset / ratio)
    return None


def _check_tendons(model: Any, joints: Sequence[int], source: str) -> None:
    """An actuator that pulls a tendon across joints of the chain is not an axis of its own.

    Raises:
        SettingsError: there is one.
    """
    kinds = mujoco_library().mjtTrn
    for k in range(model.nactuator):
        trn, at = int(model.actuator_trntype[k]), int(model.actuator_trnid[k, 0])
        where = f"{source}: actuator {shown(actuator_name(model, k))}"
        remedy = "Replace it by an actuator on each joint."
        if trn == kinds.mjTRN_TENDON and (crossed := crossed_joints(model, at, joints)):
            found = f"it pulls a tendon across {listed([joint_name(model, j) for j in crossed])}"
            raise SettingsError(where, found, "an actuator on one joint", remedy)
        if trn in (kinds.mjTRN_SITE, kinds.mjTRN_SLIDERCRANK) and set(_above(model, int(model.site_bodyid[at]))) & {*joints}:
            raise SettingsError(where, "it acts on a site of the chain", "an actuator on one joint", remedy)


def crossed_joints(model: Any, tendon: int, joints: Sequence[int]) -> list[int]:
    """Joints of ``joints`` whose motion changes the length of a tendon."""
    wrap = mujoco_library().mjtWrap
    first, found, bodies = int(model.tendon_adr[tendon]), set[int](), []
    for k in range(first, first + int(model.tendon_num[tendon])):
        kind, at = int(model.wrap_type[k]), int(model.wrap_objid[k])
        if kind == wrap.mjWRAP_JOINT:
            found.add(at)
        elif kind == wrap.mjWRAP_SITE:
            bodies.append(int(model.site_bodyid[at]))
        elif kind in (wrap.mjWRAP_SPHERE, wrap.mjWRAP_CYLINDER):
            bodies.append(int(model.geom_bodyid[at]))
    above = [set(_above(model, body)) for body in bodies]
    if above:
        found |= {joint for joints_above in above for joint in joints_above if any(joint not in other for other in above)}
    return [joint for joint in joints if joint in found]


def _check_loops(model: Any, joints: Sequence[int], source: str) -> None:
    """A connection of two bodies with different joints of the chain above them closes a loop.

    Raises:
        SettingsError: there is one.
    """
    mujoco = mujoco_library()
    for k in range(model.neq):
        if int(model.eq_type[k]) not in (mujoco.mjtEq.mjEQ_CONNECT, mujoco.mjtEq.mjEQ_WELD) or not model.eq_active0[k]:
            continue
        ends = [int(model.eq_obj1id[k]), int(model.eq_obj2id[k])]
        if int(model.eq_objtype[k]) == mujoco.mjtObj.mjOBJ_SITE:
            ends = [int(model.site_bodyid[end]) for end in ends]
        closed = set(_above(model, ends[0])) ^ set(_above(model, ends[1]))
        if across := [joint for joint in joints if joint in closed]:
            names = listed([body_name(model, end) if end else "the world" for end in ends])
            found = f"a closed loop across {listed([joint_name(model, j) for j in across])}"
            remedy = "Replace the connection by <equality><joint>, as a gear between two joints."
            raise SettingsError(f"{source}: equality of {names}", found, "an open chain", remedy)


def _above(model: Any, body: int) -> list[int]:
    return [joint for each in path_to(model, body) for joint in joints_of(model, each)]
