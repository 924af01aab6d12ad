"""A course: a machine, a path it can follow, where it begins, and the baselines that every policy is measured against."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path as File
from typing import Protocol

import numpy as np
import numpy.typing as npt

from sysid.control import AxisTuning, CylinderController, response_time, tune
from sysid.errors import SettingsError, nearest
from sysid.networks.forward import ForwardModel
from sysid.plant import Plant
from sysid.rl.inverse_kinematics import InverseKinematics, KinematicChain, chain_of_forward, chain_of_plant
from sysid.rl.paths import CLIMB, TURNS, Path, centre_for, check_reach, circle, floor_of, helix, read_path
from sysid.rl.reach import Reach, reach_of
from sysid.rl.task import check_pair
from sysid.rl.tracking import InversePolicy, Policy, TrackingResult, track, track_environment

Array = npt.NDArray[np.float64]

#: What may be followed with: inverse kinematics, and the same with a target ahead by the machine's dead time.
BASELINES = ("ik", "ik-lookahead")
PATHS = ("helix", "circle")


class NamedPolicy(Protocol):
    """A policy that says what its observations are; those of the paper's setting begin every other one."""

    @property
    def inputs(self) -> tuple[str, ...]: ...

    def act(self, observations: Array) -> Array: ...


@dataclass(frozen=True)
class TrackingTask:
    """What :func:`lay_out` gives.

    Args:
        inverse: on calibrated kinematics; ``kinematics`` says whose.
        joints: along the path by inverse kinematics, (n, A); the machine stands at the first ones before the first step.
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
        """Axis → the most that the path asks of it, as a share of its top speed; above one it cannot follow."""
        drive = CylinderController(self.plant, self.tuning).drive(self.joints)
        speeds = np.abs(np.diff(drive, axis=0)).max(axis=0) * self.path.rate_hz
        axes = zip(self.plant.machine.axis_names, speeds, tune(self.plant), strict=True)
        return {name: float(speed / item.fastest) for name, speed, item in axes if not item.servo}

    @property
    def dead_time(self) -> float:
        """Delay and lag of the slowest axis in whole steps [s]: how far ahead a policy has to look."""
        rate = self.path.rate_hz
        return math.ceil(response_time(self.plant) * rate - 1e-9) / rate

    def run(self, name: str, policy: Policy, lookahead: float = 0.0) -> TrackingResult:
        """Follow the path with ``policy``, which is shown targets ``lookahead`` seconds ahead.

        The controller is told of it where it feeds speeds forward; another one would only wait until a setpoint is due.

        Raises:
            SettingsError: looking ahead in the paper's setting, where there is nothing to make up for.
        """
        if lookahead and not self.full:
            found = f"a look-ahead of {lookahead:g} s where joints follow at once"
            raise SettingsError(f"tracking with {name}", found, "none, or the full path (--full)")
        told = any(item.feed for item in self.tuning)
        settings = {"tuning": self.tuning, "preview": lookahead if told else 0.0}
        place = track_environment(self.plant, self.forward, self.path, full=self.full, reach=self.reach, settings=settings)
        return track(place, policy, self.path, self.start, lookahead=lookahead, name=name)

    def baseline(self, name: str) -> TrackingResult:
        """Follow the path with one of :data:`BASELINES`.

        Raises:
            SettingsError: there is no such baseline.
        """
        if name not in BASELINES:
            raise SettingsError("baseline", repr(name), nearest(name, BASELINES))
        return self.run(name, InversePolicy(self.inverse), self.dead_time if name == "ik-lookahead" else 0.0)


class TruncatedObservationPolicy:
    """A policy of fewer numbers in an environment that shows more: it sees the first ones, which are the same everywhere."""

    def __init__(self, policy: NamedPolicy) -> None:
        self.policy = policy

    def act(self, observations: Array) -> Array:
        return self.policy.act(np.ascontiguousarray(observations[:, : len(self.policy.inputs)]))


def lay_out(
    plant: Plant,
    forward: ForwardModel,
    path: str,
    *,
    full: bool = False,
    centre: npt.ArrayLike | None = None,
    tuning: tuple[AxisTuning, ...] | None = None,
) -> TrackingTask:
    """A course for a plant and a forward model that fit each other.

    Args:
        path: ``helix``, ``circle`` or a CSV file with t, x, y, z.
        centre: of helix or circle (3,) [m]; else where the joints keep farthest from their limits.

    Raises:
        SettingsError: the versions do not fit, or the path fits nowhere.
        InputError: a file that is no path, or one with points out of reach.
    """
    check_pair(plant, forward)
    reach = reach_of(plant, forward)
    chain: KinematicChain | None = chain_of_forward(forward)
    kinematics = "forward model" if chain is not None else "plant"
    inverse = InverseKinematics.of(chain or chain_of_plant(plant), reach.low, reach.high)
    rate = plant.machine.rate_hz
    if path in PATHS:
        if centre is None:
            centre = centre_for(inverse, reach.ee_low, reach.ee_high, floor=floor_of(plant.machine), height=CLIMB * TURNS)
        found = (helix if path == "helix" else circle)(centre, rate)
    else:
        if centre is not None:
            raise SettingsError("--centre", f"given with {path}", "helix or circle: a file has its place")
        if not File(path).suffix and not File(path).exists():
            raise SettingsError("--path", repr(path), f"{nearest(path, PATHS)}, or a CSV file with the columns t,x,y,z")
        found = read_path(File(path), rate)
    joints = check_reach(found, inverse)
    return TrackingTask(plant, forward, reach, inverse, kinematics, found, joints, full, tuning or tune(plant))
