"""A tracking task: a machine, a path that it can follow, the start, and the baselines of every policy."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path as File

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError, nearest
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid_rl.control import AxisTuning, CylinderController, lookahead_time, tune
from sysid_rl.train.environment import NamedPolicy, Policy
from sysid_rl.train.inverse_kinematics import InverseKinematics, chain_of_forward, chain_of_plant
from sysid_rl.train.paths import CLIMB, TURNS, Path, centre_for, check_reach, circle, helix, lowest_height, read_path
from sysid_rl.train.reach import Reach, reach_of
from sysid_rl.train.task import check_pair
from sysid_rl.train.tracking import InversePolicy, TrackingResult, track, track_environment

Array = npt.NDArray[np.float64]

#: Inverse kinematics, and the same with a target ahead by the machine's dead time.
BASELINES = ("ik", "ik-lookahead")
PATHS = ("helix", "circle")


@dataclass(frozen=True)
class TrackingTask:
    """See :func:`plan_tracking`.

    Args:
        inverse: on calibrated kinematics, those of ``kinematics``.
        joints: along the path by inverse kinematics, (n, A); the first row is the start.
        full: the full path (cylinder controller, valves, plant); else joints follow at once.
        tuning: of the cylinder controller (full path only).
    """

    plant: Plant
    forward: ForwardModel
    reach: Reach
    inverse: InverseKinematics
    kinematics: str
    path: Path
    joints: Array
    full: bool
    tuning: tuple[AxisTuning, ...]

    @property
    def start(self) -> Array:
        """Joints (A,) before the first step."""
        return np.asarray(self.joints[0])

    @property
    def demand(self) -> dict[str, float]:
        """Axis → greatest speed on the path as a share of its top speed; above one it cannot follow."""
        drive = CylinderController(self.plant, self.tuning).drive(self.joints)
        speeds = np.abs(np.diff(drive, axis=0)).max(axis=0) * self.path.rate_hz
        axes = zip(self.plant.machine.axis_names, speeds, tune(self.plant), strict=True)
        return {name: float(speed / item.fastest) for name, speed, item in axes if not item.servo}

    @property
    def dead_time(self) -> float:
        """Delay and lag of the slowest axis in whole steps [s]: the look-ahead of ``ik-lookahead``."""
        return lookahead_time(self.plant)

    def run(self, name: str, policy: Policy, lookahead: float = 0.0) -> TrackingResult:
        """Follow the path with ``policy``, which observes targets ``lookahead`` seconds ahead.

        A controller with speed feed-forward uses the look-ahead as its preview; another one would only delay the setpoint.

        Raises:
            SettingsError: a look-ahead in the paper's setting, which has no delay.
        """
        if lookahead and not self.full:
            found = f"a look-ahead of {lookahead:g} s where joints follow at once"
            raise SettingsError(f"tracking with {name}", found, "none, or the full path (--full)")
        feeds_forward = any(item.feed for item in self.tuning)
        settings = {"tuning": self.tuning, "preview": lookahead if feeds_forward else 0.0}
        one = track_environment(self.plant, self.forward, self.path, full=self.full, reach=self.reach, settings=settings)
        return track(one, policy, self.path, self.start, lookahead=lookahead, name=name)

    def baseline(self, name: str) -> TrackingResult:
        """Follow the path with one of :data:`BASELINES`.

        Raises:
            SettingsError: there is no such baseline.
        """
        if name not in BASELINES:
            raise SettingsError("baseline", repr(name), nearest(name, BASELINES))
        return self.run(name, InversePolicy(self.inverse), self.dead_time if name == "ik-lookahead" else 0.0)


class TruncatedObservationPolicy:
    """A policy of the paper's setting in an environment with longer observations: it gets their first columns, which agree."""

    def __init__(self, policy: NamedPolicy) -> None:
        self.policy = policy

    def act(self, observations: Array) -> Array:
        return self.policy.act(np.ascontiguousarray(observations[:, : len(self.policy.inputs)]))


def plan_tracking(
    plant: Plant,
    forward: ForwardModel,
    path: str,
    *,
    full: bool = False,
    centre: npt.ArrayLike | None = None,
    tuning: tuple[AxisTuning, ...] | None = None,
) -> TrackingTask:
    """The tracking task of a plant, a forward model and a path.

    Args:
        path: ``helix``, ``circle`` or a CSV file with t, x, y, z.
        centre: of helix or circle (3,) [m]; by default where the joints keep farthest from their limits.

    Raises:
        SettingsError: the versions do not fit, or the path fits nowhere.
        InputError: a file that is no path, or points out of reach.
    """
    check_pair(plant, forward)
    reach = reach_of(plant, forward)
    chain = chain_of_forward(forward)
    kinematics = "forward model" if chain is not None else "plant"
    inverse = InverseKinematics.of(chain or chain_of_plant(plant), reach.low, reach.high)
    rate = plant.machine.rate_hz
    if path in PATHS:
        if centre is None:
            centre = centre_for(inverse, reach.ee_low, reach.ee_high, floor=lowest_height(plant.machine), height=CLIMB * TURNS)
        found = (helix if path == "helix" else circle)(centre, rate)
    else:
        if centre is not None:
            raise SettingsError("--centre", f"given with {path}", "helix or circle: a file has its place")
        if not File(path).suffix and not File(path).exists():
            raise SettingsError("--path", repr(path), f"{nearest(path, PATHS)}, or a CSV file with the columns t,x,y,z")
        found = read_path(File(path), rate)
    joints = check_reach(found, inverse)
    return TrackingTask(plant, forward, reach, inverse, kinematics, found, joints, full, tuning or tune(plant))
