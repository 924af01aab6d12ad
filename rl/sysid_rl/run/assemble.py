"""From a recipe to a loop that is ready to run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from sysid.errors import SettingsError, nearest
from sysid.gap.experiment import read_experiment
from sysid.machine import Machine, load_machine
from sysid.registry import Registry
from sysid_rl.control import lookahead_time, tune
from sysid_rl.control.input_shaper import InputShaper, input_shaper
from sysid_rl.control.pendulum import pendulum_of
from sysid_rl.run.chain import ControlChain, SignalPolicy
from sysid_rl.run.command_filter import CommandFilter, inwards, motion_ratios, outside
from sysid_rl.run.cycle import Recorder
from sysid_rl.run.domain import TrainingDomains
from sysid_rl.run.limits import Limits, limits_of
from sysid_rl.run.loop import Loop
from sysid_rl.run.modes.collect import Collect, SafeMoves
from sysid_rl.run.modes.commission import Commission
from sysid_rl.run.modes.hold import Hold, Shadow, Teleop
from sysid_rl.run.modes.mode import Mode
from sysid_rl.run.modes.replay import of_experiment, of_file
from sysid_rl.run.modes.track import TrackLive, TrackPath
from sysid_rl.run.operator import Operator
from sysid_rl.run.recipe import RunnerRecipe
from sysid_rl.run.state_estimator import StateEstimator
from sysid_rl.run.supervisor import Supervisor
from sysid_rl.run.transport import Transport
from sysid_rl.run.valves import AxisValve, axis_valves
from sysid_rl.run.versions import LoadedVersions, load
from sysid_rl.train.inverse_kinematics import InverseKinematics, chain_of_forward, chain_of_plant
from sysid_rl.train.reach import joint_limits
from sysid_rl.train.residual_policy import ResidualPolicy
from sysid_rl.train.tracking_task import TrackingTask, plan_tracking

Array = npt.NDArray[np.float64]

#: Motion of the end effector by which an axis answers before a path begins [m].
ASIDE = 0.06
#: The same as a share of a joint's range, at most.
MOST_ASIDE = 0.1


@dataclass(frozen=True)
class Assembly:
    """Everything of a run except its line, log and operator.

    Args:
        lookahead: of the policy [s].
        tracking: the path and its joints, if the mode tracks a path.
    """

    recipe: RunnerRecipe
    folder: Path
    machine_file: Path
    machine: Machine
    loaded: LoadedVersions
    inverse: InverseKinematics
    valves: tuple[AxisValve, ...]
    limits: Limits
    lookahead: float
    tracking: TrackingTask | None

    @property
    def dt(self) -> float:
        return 1.0 / self.machine.rate_hz

    @property
    def middle(self) -> Array:
        """Initial joints (A,) of a simulated machine: the start of the path, or the middle of the limits."""
        if self.tracking is not None:
            return np.clip(self.tracking.start, self.limits.low, self.limits.high)
        return np.asarray(0.5 * (self.limits.low + self.limits.high))

    @property
    def policy(self) -> SignalPolicy | None:
        """A new policy; None: inverse kinematics. The swing that an offset of inverse kinematics needs is that of the chain."""
        network = self.loaded.policy
        if network is None or network.residual is None:
            return network
        return ResidualPolicy(network, self.loaded.plant, self.inverse)

    @property
    def shaper(self) -> InputShaper | None:
        """Of the setpoints on the path, if the recipe has one."""
        kind = self.recipe.track.shaper
        if kind == "none":
            return None
        pendulum = pendulum_of(self.loaded.plant)
        return input_shaper(kind, pendulum.frequency, pendulum.damping_ratio)

    def aside(self, chain: ControlChain, joints: Array) -> Array:
        """Ways (A,) from ``joints`` (A,) that move the end effector by :data:`ASIDE`; 0 where they, or all, leave the fence."""
        low, high = self.limits.low, self.limits.high
        ways = np.minimum(ASIDE / motion_ratios(chain.tip, joints, low, high), MOST_ASIDE * (high - low))
        aside = inwards(joints, low, high) * ways
        ends = chain.tip(joints + np.concatenate([np.diag(aside), aside[None]]))
        left = outside(ends, self.limits.fence_low, self.limits.fence_high) > 0.0
        return np.where(left[:-1] | left[-1], 0.0, aside)

    def check_transport(self, transport: Transport) -> None:
        """Raise SettingsError unless a transport has the machine's axes, readings of what commands drive, known signals."""
        axes, known = self.machine.axis_names, self.machine.signals
        if transport.axes != axes:
            raise SettingsError("transport", f"axes {', '.join(transport.axes)}", ", ".join(axes))
        for axis in self.machine.axes:
            if axis.driven not in transport.signals:
                raise SettingsError("transport", f"no signal {axis.driven}", "a measurement of what every command drives")
        for signal in transport.signals:
            if signal not in known:
                raise SettingsError("transport", f"unknown signal {signal}", nearest(signal, known))

    def loop(self, transport: Transport, recorder: Recorder, operator: Operator) -> Loop:
        """A new loop, warmed up.

        Raises:
            SettingsError: the transport does not fit the machine.
        """
        self.check_transport(transport)
        axes, loaded, checks = self.machine.axis_names, self.loaded, self.recipe.checks
        chain = ControlChain(
            loaded.plant, loaded.forward, self.inverse, policy=self.policy, lookahead=self.lookahead, shaper=self.shaper
        )
        estimator = StateEstimator(loaded.plant, self.valves, self.dt, transport.signals, checks)
        inside = TrainingDomains(loaded.forward, loaded.actuators, axes) if checks.on("domain") else lambda estimate: ""
        supervisor = Supervisor(
            axes, self.limits, self.valves, estimator.linkages, chain.tip, self.dt, estimator.response,
            estimator.response_range, checks, inside,
        )  # fmt: skip
        mode = self.mode(self.recipe.mode, chain, supervisor.command_filter)
        loop = Loop(transport, chain, estimator, supervisor, mode, recorder, operator, self.recipe.loop)
        loop.warm_up(self.middle)
        return loop

    def mode(self, name: str, chain: ControlChain, command_filter: CommandFilter) -> Mode:
        """The task ``name`` of the recipe."""
        recipe, limits, dt = self.recipe, self.limits, self.dt
        if name == "track":
            track = recipe.track
            if track.live_port is not None:
                return TrackLive(track.live_port, track.live_speed, dt, track.live_s)
            assert self.tracking is not None
            start = chain.start(self.tracking.path.points[0], self.tracking.start, limits, recipe.checks.path.distance)
            return TrackPath(
                self.tracking.path, start, limits, dt,
                ahead=chain.ahead, ease_s=track.ease_s, laps=track.laps, shaper=self.shaper,
                settle_s=track.settle_s, aside=self.aside(chain, start) if recipe.checks.on("first_move") else None,
            )  # fmt: skip
        if name == "commission":
            return Commission(self.machine, command_filter, recipe.commission)
        if name == "hold":
            return Hold(dt, recipe.hold.seconds)
        if name == "collect":
            collect = recipe.collect
            return Collect(
                collect.poses, SafeMoves(command_filter), dt,
                settle_s=collect.settle_s, record_s=collect.record_s, seed=collect.seed,
            )  # fmt: skip
        if name == "experiment":
            experiment = read_experiment(self.folder / recipe.experiment.file, self.machine)
            return of_experiment(experiment, self.loaded.plant, limits, dt)
        if name == "replay":
            return of_file(self.folder / recipe.replay.file, self.machine, limits)
        return Shadow(self.mode(recipe.shadow.of, chain, command_filter)) if name == "shadow" else Teleop()


def assemble(recipe: RunnerRecipe, registry: Registry, path: Path) -> Assembly:
    """Load and check everything that the recipe in the file ``path`` names.

    Raises:
        SettingsError, StoreError, InputError: a part is missing, or parts do not fit.
    """
    folder = path.parent
    machine_file = (folder / recipe.machine).resolve()
    machine = load_machine(machine_file)
    loaded = load(registry, recipe, machine, path)
    parts = axis_valves(tune(loaded.plant), 1.0 / machine.rate_hz)
    limits = limits_of(loaded.plant, parts, recipe.limits, path)
    lookahead = recipe.versions.lookahead
    if lookahead is None:
        lookahead = 0.0
        if recipe.versions.policy == "ik-lookahead":
            lookahead = lookahead_time(loaded.plant)
    low, high = joint_limits(loaded.plant)
    tracking, inverse = None, InverseKinematics.of(chain_of_forward(loaded.forward) or chain_of_plant(loaded.plant), low, high)
    tracks = recipe.mode == "track" or (recipe.mode == "shadow" and recipe.shadow.of == "track")
    if tracks and recipe.track.live_port is None:
        given = recipe.track.path
        place = given if given in ("helix", "circle") else str(folder / given)
        tracking = plan_tracking(loaded.plant, loaded.forward, place, full=True, centre=recipe.track.centre)
        inverse = tracking.inverse
        _check_path(tracking, limits, path)
    return Assembly(recipe, folder, machine_file, machine, loaded, inverse, parts, limits, lookahead, tracking)


def _check_path(tracking: TrackingTask, limits: Limits, where: object) -> None:
    """Refuse a path that leaves the limits or the fence, or exceeds the speed of the valves."""
    names = tracking.plant.machine.axis_names
    for name, q, low, high in zip(names, tracking.joints.T, limits.low, limits.high, strict=True):
        if q.min() < low or q.max() > high:
            found = f"takes {name} to {q.min():.3f} … {q.max():.3f}"
            raise SettingsError(f"{where}: track.path {tracking.path.name}", found, f"within {low:.3f} … {high:.3f}")
    points = tracking.path.points
    left = np.maximum(limits.fence_low - points, points - limits.fence_high).max(axis=0)
    if (left > 0.0).any():
        letter = "xyz"[int(np.argmax(left))]
        found = f"is {1e3 * left.max():.0f} mm outside the fence in {letter}, margin included"
        raise SettingsError(f"{where}: track.path {tracking.path.name}", found, "a path inside limits.fence")
    for name, share in tracking.demand.items():
        if share > 0.95:
            found = f"needs {100.0 * share:.0f} % of the top speed of {name}"
            raise SettingsError(f"{where}: track.path {tracking.path.name}", found, "at most 95 %", "Slow it down.")
