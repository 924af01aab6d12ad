"""The hanging tool follows helix and circle, and comes to rest at targets: runs of one controller and their figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from sysid.machine import KnownEffect
from sysid.plant import Plant, compile_plant
from sysid_rl.control.coordinated_motion import motion_limits
from sysid_rl.control.input_shaper import ShaperKind, input_shaper
from sysid_rl.control.pendulum import Pendulum, pendulum_of
from sysid_rl.control.swing_damper import SwingDamper
from sysid_rl.train.environment import Policy
from sysid_rl.train.inverse_kinematics import chain_of_plant
from sysid_rl.train.paths import Path, eased
from sysid_rl.train.planned import CoordinatedPolicy, DampedPolicy, ShapedPolicy
from sysid_rl.train.reach import tips
from sysid_rl.train.residual_policy import ResidualPolicy
from sysid_rl.train.tool_figures import ToolFigures, tool_figures
from sysid_rl.train.tracking import InversePolicy, TrackingResult, track, track_environment
from sysid_rl.train.tracking_task import TrackingTask

Array = npt.NDArray[np.float64]

#: Moves, their seed, their duration [s], and the sector of the slew in which they lie [rad].
MOVES, SEED, MOVE_S, SECTOR = 20, 0, 10.0, 0.8
#: Rest after a path [s], and speed ramps at its ends [s]; 0: the path moves at full speed from its first sample.
REST_S, EASES = 6.0, (0.0, 1.0)
#: Damping ratio that feedback adds; the bound by this machine's shortest lag, 36 ms, is 0.12 (sysid_rl.control.swing_damper).
DAMPING = 0.1
#: Greatest distance of a tool from its rest at the beginning, if it swings [m], and the seed of the places where it does.
START_SWING, SWING_SEED = 0.1, 1
#: Length of a pendulum that is not the identified one, as a share of that, and the number of moves with it.
LENGTHS, FEWER_MOVES = (0.8, 1.2), 10


@dataclass(frozen=True)
class Controller:
    """One row of the tables.

    Args:
        policies: each makes the policy of a run; several for a policy that was trained with several seeds.
        lookahead: of the observed target on a path [s].
        preview: of the cylinder controller [s].
        path: from the path that the tool is to follow, raised to the tip, to the targets that the policy observes.
    """

    name: str
    policies: tuple[Callable[[], Policy], ...]
    lookahead: float = 0.0
    preview: float = 0.0
    path: Callable[[Path], Path] = lambda path: path


def on_paths(task: TrackingTask) -> list[Controller]:
    """Inverse kinematics on a path that is known in advance: as it is, shaped, and by inversion of the pendulum."""
    pendulum, late = pendulum_of(task.plant), task.dead_time

    def shaped(kind: ShaperKind) -> Controller:
        shaper = input_shaper(kind, pendulum.frequency, pendulum.damping_ratio)
        ahead = round((late + shaper.delay) * task.path.rate_hz) / task.path.rate_hz
        return Controller(
            f"ik-lookahead, {kind.upper()} shaper",
            (lambda: ShapedPolicy(InversePolicy(task.inverse), shaper, task.path.rate_hz, len(task.start)),),
            ahead,
            late,
        )

    def inverted(path: Path) -> Path:
        return replace(path, points=pendulum.tip_path(path.points - [0.0, 0.0, pendulum.length], path.rate_hz))

    return [
        Controller("ik", (lambda: InversePolicy(task.inverse),)),
        Controller("ik-lookahead", (lambda: InversePolicy(task.inverse),), late, late),
        shaped("zv"),
        shaped("zvd"),
        Controller("ik-lookahead, inverse pendulum", (lambda: InversePolicy(task.inverse),), late, late, inverted),
    ]


def at_targets(task: TrackingTask) -> list[Controller]:
    """Inverse kinematics for targets that jump: at once, by a coordinated motion, and the same shaped."""
    pendulum, late = pendulum_of(task.plant), task.dead_time
    limits = motion_limits(task.plant, task.tuning)

    def moving(least_time: bool = False) -> Policy:
        return CoordinatedPolicy(task.plant, task.inverse, limits, least_time)

    def shaping(kind: ShaperKind, least_time: bool = False) -> Policy:
        shaper = input_shaper(kind, pendulum.frequency, pendulum.damping_ratio)
        return ShapedPolicy(moving(least_time), shaper, task.path.rate_hz, len(task.start))

    return [
        Controller("ik", (lambda: InversePolicy(task.inverse),)),
        Controller("ik, coordinated motion", (moving,), 0.0, late),
        Controller("ik, coordinated motion, ZV shaper", (lambda: shaping("zv"),), 0.0, late),
        Controller("ik, coordinated motion, ZVD shaper", (lambda: shaping("zvd"),), 0.0, late),
        Controller("least time, coordinated motion, ZV shaper", (lambda: shaping("zv", True),), 0.0, late),
        Controller("ik, coordinated motion, ZV shaper, damping", (lambda: damped(task, shaping("zv")),), 0.0, late),
    ]


def damped(task: TrackingTask, policy: Policy) -> Policy:
    """With feedback of the measured swing."""
    damper = SwingDamper(pendulum_of(task.plant), DAMPING, task.dead_time)
    return DampedPolicy(policy, task.inverse, chain_of_plant(task.plant), damper)


def in_place(task: TrackingTask) -> list[Controller]:
    """For a tool that swings above its target already."""
    return [
        Controller("ik", (lambda: InversePolicy(task.inverse),)),
        Controller("ik, damping", (lambda: damped(task, InversePolicy(task.inverse)),)),
    ]


def trained(task: TrackingTask, networks: Sequence[Any], measured: bool = True, name: str = "trained policy") -> Controller:
    """Trained residual policies, one for each seed; the swing is measured, or estimated from the motion of the tip."""

    def deployed(network: Any) -> Callable[[], Policy]:
        return lambda: ResidualPolicy(network, task.plant, task.inverse, measured)

    return Controller(name if measured else f"{name}, swing estimated", tuple(deployed(network) for network in networks))


def moves(task: TrackingTask, count: int = MOVES, seed: int = SEED) -> list[tuple[Array, Array]]:
    """Joints at the start (A,) and target (3,) of random moves in the sector and the training range of the forward model."""
    low, high = task.reach.trained_low.copy(), task.reach.trained_high.copy()
    low[0], high[0] = max(low[0], -SECTOR), min(high[0], SECTOR)
    joints = np.random.default_rng(seed).uniform(low, high, (count, 2, len(low)))
    ends = tips(compile_plant(task.plant), joints[:, 1])
    return [(begin, end) for begin, end in zip(joints[:, 0], ends, strict=True)]


def run(
    task: TrackingTask, plant: Plant, controller: Controller, path: Path, start: Array, **settings: Any
) -> list[TrackingResult]:
    """One run of each policy; ``plant`` is the machine, which may differ from the one that the controller knows."""
    shown, found = controller.path(path), []
    settings = {"tuning": task.tuning, "preview": controller.preview, **settings}
    for policy in controller.policies:
        environment = track_environment(plant, task.forward, shown, full=True, reach=task.reach, settings=settings)
        result = track(environment, policy(), shown, start, lookahead=controller.lookahead, name=controller.name)
        found.append(replace(result, target=path.points[1:]))
    return found


def path_rows(task: TrackingTask, controller: Controller, base: Path, ease_s: float) -> list[dict[str, Any]]:
    """Figures on a path that comes to rest, of each policy."""
    points = eased(base, ease_s)
    rest = np.repeat(points[-1:], round(REST_S * base.rate_hz), axis=0)
    path = replace(base, points=np.concatenate([points, rest]))
    start, _ = task.inverse.solve(controller.path(path).points[:1], task.joints[:1])
    pendulum = pendulum_of(task.plant)
    return [
        {"controller": controller.name, "path": base.name, "ease_s": ease_s, **_figures(tool_figures(found, pendulum))}
        for found in run(task, task.plant, controller, path, start[0])
    ]


def move_rows(
    task: TrackingTask, controllers: Sequence[Controller], each: Sequence[tuple[Array, Array]], length: float = 1.0
) -> list[dict[str, Any]]:
    """Figures over all moves of a machine whose pendulum has ``length`` times that of the identified one."""
    pendulum = pendulum_of(task.plant)
    true = Pendulum(length * pendulum.length, pendulum.damping_ratio)
    parameters = {"length": true.length, "damping_ratio": true.damping_ratio}
    plant = task.plant.with_effect(KnownEffect("gripper_sway", "tool", parameters))
    rows = []
    for controller in controllers:
        found = [result for start, target in each for result in run(task, plant, controller, _at(task, target), start)]
        figures = [_figures(tool_figures(result, true)) for result in found]
        rows.append({"controller": controller.name, "length": length, "moves": figures})
    return rows


def swing_rows(
    task: TrackingTask, controllers: Sequence[Controller], each: Sequence[tuple[Array, Array]]
) -> list[dict[str, Any]]:
    """Figures of a tool that swings at the beginning, above the target at which the machine rests."""
    rows = []
    for controller in controllers:
        figures = []
        for seed, (start, _) in enumerate(each):
            path = _at(task, tips(compile_plant(task.plant), start[None])[0])
            settings = {"start_swing": START_SWING, "seed": seed}
            found = run(task, task.plant, controller, path, start, **settings)
            figures += [_figures(tool_figures(result, pendulum_of(task.plant))) for result in found]
        rows.append({"controller": controller.name, "moves": figures})
    return rows


def _at(task: TrackingTask, target: Array) -> Path:
    """A target (3,) that rests."""
    rate = task.path.rate_hz
    return Path("target", rate, np.repeat(target[None], round(MOVE_S * rate) + 1, axis=0))


def _figures(found: ToolFigures) -> dict[str, Any]:
    """In millimetres and seconds; None: never, or not defined."""

    def known(value: float) -> float | None:
        return round(value, 4) if math.isfinite(value) else None

    return {
        "rmse_mm": [known(1e3 * value) for value in found.rmse],
        "max_mm": [known(1e3 * value) for value in found.worst],
        "arrival_s": known(found.arrival),
        "settling_s": known(found.settling),
        "swing_mm": known(1e3 * found.swing),
    }
