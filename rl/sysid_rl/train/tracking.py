"""A policy follows a path: end effector at t + 1 against target at t + 1, as in the paper.

A policy with memory also has ``reset(observations)``, which is called once before the first step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np
import numpy.typing as npt

from sysid.errors import InputError, SettingsError
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid_rl.train.driven import DrivenEnvironment
from sysid_rl.train.environment import Environment, Policy
from sysid_rl.train.factory import make_environment
from sysid_rl.train.inverse_kinematics import InverseKinematics
from sysid_rl.train.paths import Path
from sysid_rl.train.reach import Reach
from sysid_rl.train.task import ObservationSlices, Task

Array = npt.NDArray[np.float64]

#: A machine that starts at rest has reached its moving target after this time [s].
SETTLED_S = 1.0


@runtime_checkable
class StatefulPolicy(Protocol):
    """A policy with memory."""

    def reset(self, observations: Array) -> None: ...


class InversePolicy:
    """Bounded least-squares inverse kinematics as a policy: the solution nearest to the last setpoint."""

    def __init__(self, inverse: InverseKinematics) -> None:
        self.inverse, self._slices = inverse, ObservationSlices.of(len(inverse.low))
        self._last: Array | None = None

    def reset(self, observations: Array) -> None:
        """Search from the measured joints."""
        self._last = np.array(observations[:, self._slices.joints], dtype=np.float64)

    def act(self, observations: Array) -> Array:
        if self._last is None or len(self._last) != len(observations):
            self.reset(observations)
        assert self._last is not None
        self._last, _ = self.inverse.solve(observations[:, self._slices.target], self._last)
        return self._last.copy()


@dataclass(frozen=True)
class TrackingResult:
    """A tracking run; row k is step k, which leads to time ``(k + 1)/rate_hz``.

    Args:
        policy, path: names.
        lookahead: of the policy [s].
        time: (n,) [s].
        target, ee: (n, 3) [m].
        joints, actions: measured joints and setpoints, (n, A) [rad or m].
        tool: (n, 3) [m], NaN in the paper's setting; ``commands`` (n, A) to the valves, NaN there.
    """

    policy: str
    path: str
    lookahead: float
    time: Array
    target: Array
    ee: Array
    joints: Array
    actions: Array
    tool: Array
    commands: Array

    @property
    def error(self) -> Array:
        """(n, 3) [m]."""
        return self.ee - self.target

    @property
    def rmse(self) -> Array:
        """Per axis, (3,) [m]."""
        return np.asarray(np.sqrt(np.mean(self.error**2, axis=0)))

    @property
    def worst(self) -> Array:
        """Largest error per axis, (3,) [m]."""
        return np.asarray(np.abs(self.error).max(axis=0))

    def after(self, seconds: float) -> TrackingResult:
        """Without the first ``seconds``, in which a machine that starts at rest approaches its moving target."""
        late = self.time > seconds
        rows = {item.name: getattr(self, item.name)[late] for item in fields(self)[3:]}
        return replace(self, **rows)

    def to_json(self) -> dict[str, Any]:
        """The figures, in millimetres; ``settled``: after the first second; sway: horizontal distance of tool and tip."""
        late = self.after(SETTLED_S)
        return {
            "policy": self.policy,
            "path": self.path,
            "lookahead_s": self.lookahead,
            "steps": len(self.time),
            **self._figures(),
            "settled": {"after_s": SETTLED_S, **late._figures()} if len(late.time) else None,
        }

    def _figures(self) -> dict[str, Any]:
        distance = np.linalg.norm(self.error, axis=1)
        sway = np.linalg.norm((self.tool - self.ee)[:, :2], axis=1)
        swings = bool(np.isfinite(sway).all()) and len(sway) > 0
        return {
            "rmse_mm": [float(1e3 * value) for value in self.rmse],
            "max_mm": [float(1e3 * value) for value in self.worst],
            "distance_mm": {"rms": float(1e3 * np.sqrt(np.mean(distance**2))), "max": float(1e3 * distance.max())},
            "sway_mm": {"rms": float(1e3 * np.sqrt(np.mean(sway**2))), "max": float(1e3 * sway.max())} if swings else None,
        }


def track(
    environment: Environment, policy: Policy, path: Path, start: npt.ArrayLike, *, lookahead: float = 0.0, name: str = ""
) -> TrackingResult:
    """Follow ``path`` with one copy of a machine that begins at rest at the joints ``start`` (A,).

    Args:
        lookahead: the policy observes the target this long after the next sample [s].

    Raises:
        SettingsError: several copies, an episode shorter than the path, another rate.
        InputError: the policy answers with another shape or with a number that is not finite.
    """
    steps = len(path.points) - 1
    if environment.size != 1:
        raise SettingsError("tracking", f"{environment.size} copies", "one")
    if environment.steps <= steps:
        raise SettingsError("tracking", f"an episode of {environment.steps} steps", f"more than the {steps} of {path.name}")
    if environment.rate_hz != path.rate_hz:
        raise SettingsError("tracking", f"a path at {path.rate_hz} Hz", f"{environment.rate_hz} Hz")
    ahead = round(lookahead * path.rate_hz)
    parts = ObservationSlices.of(environment.actions)
    seen = environment.begin(start, path.at(ahead))
    if isinstance(policy, StatefulPolicy):
        policy.reset(seen)
    ee, joints = np.empty((steps, 3)), np.empty((steps, environment.actions))
    actions, commands = np.empty_like(joints), np.full_like(joints, np.nan)
    tool = np.full((steps, 3), np.nan)
    for k in range(steps):
        action = np.asarray(policy.act(environment.aim(path.at(k + 1 + ahead))), dtype=np.float64)
        if action.shape != (1, environment.actions):
            raise InputError("tracking", f"the policy answers with shape {action.shape}", f"(1, {environment.actions})")
        seen, _, _ = environment.step(action)
        actions[k], joints[k], ee[k] = action[0], seen[0, parts.joints], seen[0, parts.ee]
        if isinstance(environment, DrivenEnvironment):
            tool[k], commands[k] = environment.tool[0], environment.commands[0]
    time, target = path.time[1:], path.points[1:]
    return TrackingResult(
        name or type(policy).__name__, path.name, lookahead, time, target, ee, joints, actions, tool, commands
    )


def track_environment(
    plant: Plant,
    forward: ForwardModel,
    path: Path,
    *,
    full: bool = False,
    reach: Reach | None = None,
    settings: Mapping[str, Any] | None = None,
) -> Environment:
    """One copy of a machine, with an episode as long as the path; ``settings`` (``full`` only) are those of
    :class:`sysid_rl.train.driven.DrivenEnvironment`."""
    task = Task(steps=len(path.points) + 1)
    return make_environment(plant, forward, full=full, task=task, reach=reach, **(dict(settings or {}) if full else {}))
