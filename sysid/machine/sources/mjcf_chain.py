"""The chain of an MJCF from its base to its end effector: joints, what drives each, and what cannot be expressed.

A machine of ``machine.toml`` is an open chain whose every joint has one actuator or follows another one.
"""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from sysid.errors import SettingsError, nearest
from sysid.foreign import shown
from sysid.machine.sources.draft import ChainChoice
from sysid.machine.sources.mjcf_model import (
    actuator_name,
    body_name,
    is_off,
    joint_actuators,
    joint_name,
    joints_of,
    mujoco_library,
    path_to,
)
from sysid.machine.urdf_tree import Mimic
from sysid.names import listed


@dataclass(frozen=True)
class ChainJoint:
    """A hinge or slide of the chain: driven by ``actuator`` (None where the model has none), or following another joint."""

    joint: int
    actuator: int | None = None
    follows: Mimic | None = None


@dataclass(frozen=True)
class Chain:
    """Bodies from the first that moves, or that is held still, to the body of the tip, and their joints.

    Args:
        site: the tip, or None for the body's origin.
        base: the body that is held still.
    """

    bodies: tuple[int, ...]
    joints: tuple[ChainJoint, ...]
    site: int | None
    base: int | None = None

    @property
    def driven(self) -> tuple[ChainJoint, ...]:
        return tuple(joint for joint in self.joints if joint.follows is None)


class Chains:
    """The chains of a model.

    Args:
        source: name of the file, for messages.
        base: body that is held still; joints on it and in front of it do not count.
        undriven: whether joints without an actuator are driven too, in a way that the model does not state.
    """

    def __init__(self, model: Any, source: str, base: str | None = None, undriven: bool = False) -> None:
        self.model, self.source = model, source
        self.drivers = joint_actuators(model)
        self.held = -1
        if base is not None:
            bodies = {body_name(model, k): k for k in range(1, model.nbody)}
            if base not in bodies:
                raise SettingsError(f"{source}: base", f"unknown body {shown(base)}", nearest(base, bodies))
            self.held = bodies[base]
        single = mujoco_library().mjtJoint
        equalities = joint_equalities(model)
        own = [j for j in range(model.njnt) if int(model.jnt_type[j]) in (int(single.mjJNT_SLIDE), int(single.mjJNT_HINGE))]
        driven = {j for j in own if j in self.drivers or undriven}
        if undriven:  # of two coupled joints without actuators the second leads
            driven -= {pair[0] for pair in equalities if not {*pair} & self.drivers.keys()}
        self.leading = driven
        self.moving = {*driven, *(joint for pair in equalities for joint in pair if {*pair} & driven)} & {*own}

    @property
    def ends(self) -> list[ChainChoice]:
        """The chain to every body that a joint moves."""
        model = self.model
        bodies = [body for body in range(1, model.nbody) if {*joints_of(model, body)} & self.moving]
        found = [self._choice(body) for body in bodies if self.held < 0 or self.held in path_to(model, body)]
        return [choice for choice in found if choice.joints]

    def at(self, tip: str) -> ChainChoice:
        """The chain to a site or body.

        Raises:
            SettingsError: neither has that name, or no driven joint moves it.
        """
        body, _ = named_point(self.model, tip, f"{self.source}: tip")
        choice = self._choice(body, tip)
        if choice.joints:
            return choice
        remedy = self._in_front(body)
        found, expected = choice.held or "no driven joint moves it", "the end of a chain of driven joints"
        raise SettingsError(f"{self.source}: tip {shown(tip)}", found, expected, remedy)

    def _in_front(self, body: int) -> str:
        """The remedy that takes the end of a chain in front of a body; empty where there is none."""
        front = next((each for each in reversed(path_to(self.model, body)) if self._choice(each).joints), None)
        return "" if front is None else f"Add --tip {shlex.quote(body_name(self.model, front))}, which is in front of it."

    def _choice(self, body: int, tip: str | None = None) -> ChainChoice:
        """The chain to a body behind the last of its joints that nothing drives; the tip is behind it as far as it is fixed."""
        model, path = self.model, path_to(self.model, body)
        first = path.index(self.held) + 1 if self.held in path else 0
        blocked = [k for k, each in enumerate(path[first:], first) if {*joints_of(model, each)} - self.moving]
        start, base, held = first, None, ""
        if blocked:
            start, base = blocked[-1] + 1, body_name(model, path[blocked[-1]])
            held = self._blocking(path[blocked[-1]])
        joints = [joint_name(model, j) for each in path[start:] for j in joints_of(model, each)]
        end = body if tip is not None else self._behind(body)
        names = tuple(body_name(model, each) for each in path)
        return ChainChoice(tuple(joints), names, tip if tip is not None else self._tip(end), base, held)

    def _blocking(self, body: int) -> str:
        """The joint of a body that no axis can move, in words."""
        joint = next(j for j in joints_of(self.model, body) if j not in self.moving)
        kinds = mujoco_library().mjtJoint
        kind = {int(kinds.mjJNT_FREE): "free", int(kinds.mjJNT_BALL): "a ball joint"}.get(int(self.model.jnt_type[joint]))
        name = str(self.model.joint(joint).name)
        own = f"joint {shown(name)}" if name else f"the joint of body {shown(body_name(self.model, body))}"
        return f"{own} is {kind}" if kind is not None else f"no actuator drives {own}, which moves the chain"

    def _behind(self, body: int) -> int:
        """The last body that is fixed to a body, as far as they do not branch."""
        while True:
            model = self.model
            children = [k for k in range(body + 1, model.nbody) if int(model.body_parentid[k]) == body]
            fixed = [child for child in children if model.body_jntnum[child] == 0]
            if len(fixed) != 1:
                return body
            body = fixed[0]

    def _tip(self, body: int) -> str:
        """The only site of a body that has a name, or the body."""
        sites = [str(self.model.site(k).name) for k in range(self.model.nsite) if int(self.model.site_bodyid[k]) == body]
        return sites[0] if len(sites) == 1 and sites[0] else body_name(self.model, body)

    def chain(self, choice: ChainChoice) -> Chain:
        """The chain of a choice.

        Raises:
            SettingsError: it contains what ``machine.toml`` cannot express; the message names it.
        """
        model, source = self.model, self.source
        body, site = named_point(model, choice.tip, f"{source}: tip")
        path = path_to(model, body)
        names = [body_name(model, each) for each in path]
        base = names.index(choice.base) if choice.base is not None else path.index(self.held) if self.held in path else None
        joints = [j for each in path[0 if base is None else base + 1 :] for j in joints_of(model, each)]
        found = [self._joint(joint, joints) for joint in joints]
        bodies = path if base is None else path[base:]
        _check_tendons(model, joints, source)
        _check_loops(model, joints, source)
        return Chain(tuple(bodies), tuple(found), site, None if base is None else path[base])

    def _joint(self, joint: int, joints: Sequence[int]) -> ChainJoint:
        model, actuators = self.model, self.drivers.get(joint, [])
        if len(actuators) > 1:
            where = f"{self.source}: joint {shown(joint_name(model, joint))}"
            names = [actuator_name(model, k) for k in actuators]
            remedy = f"Remove from <actuator> all but the one that the controller commands, such as {listed(names[1:])}."
            raise SettingsError(where, f"{len(actuators)} actuators: {listed(names)}", "one actuator a joint", remedy)
        if actuators:
            return ChainJoint(joint, actuators[0])
        follows = _coupling(model, joint, {j for j in joints if j in self.leading}, self.source)
        if follows is None and joint not in self.leading:
            where = f"{self.source}: joint {shown(joint_name(model, joint))}"
            remedy = self._in_front(int(model.body_parentid[int(model.jnt_bodyid[joint])]))
            found = "it follows a joint beside the chain"
            raise SettingsError(where, found, "a joint with an actuator, or that follows one of the chain", remedy)
        return ChainJoint(joint, None, follows)


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


def joint_equalities(model: Any) -> dict[tuple[int, int], int]:
    """Pairs of coupled joints, (joint1, joint2) → number of the active equality."""
    kind = mujoco_library().mjtEq.mjEQ_JOINT
    active = (
        [] if equalities_off(model) else [k for k in range(model.neq) if int(model.eq_type[k]) == kind and model.eq_active0[k]]
    )
    return {(int(model.eq_obj1id[k]), int(model.eq_obj2id[k])): k for k in active if int(model.eq_obj2id[k]) >= 0}


def equalities_off(model: Any) -> bool:
    """Whether a flag switches off all equalities."""
    bits = mujoco_library().mjtDisableBit
    return bool(model.opt.disableflags & (int(bits.mjDSBL_EQUALITY) | int(bits.mjDSBL_CONSTRAINT)))


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
        expected, remedy = (
            "an actuator on one joint (tendons are outside the scope)",
            "Replace it by an actuator on each joint.",
        )
        if is_off(model, k):
            continue
        if trn == kinds.mjTRN_TENDON and (crossed := crossed_joints(model, at, joints)):
            found = f"it pulls a tendon across {listed([joint_name(model, j) for j in crossed])}"
            raise SettingsError(where, found, expected, remedy)
        if trn in (kinds.mjTRN_SITE, kinds.mjTRN_SLIDERCRANK) and set(_above(model, int(model.site_bodyid[at]))) & {*joints}:
            raise SettingsError(where, "it acts on a site of the chain", expected, remedy)


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
    for k in range(0 if equalities_off(model) else model.neq):
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
            expected = "an open chain (closed loops are outside the scope)"
            raise SettingsError(f"{source}: equality of {names}", found, expected, remedy)


def _above(model: Any, body: int) -> list[int]:
    return [joint for each in path_to(model, body) for joint in joints_of(model, each)]
