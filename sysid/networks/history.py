"""Actuator networks with history: the static maps of both directions, and on each a memory of how the machine got there.

The paper's future work: backlash and hysteresis between cylinder and joint make the joint depend on where the cylinder came
from. The static part (:mod:`sysid.networks.actuator`) stays what it is, and is what a plant takes as its linkage; a bounded
recurrent correction (:mod:`sysid.networks.memory`) learns what it leaves over along the recorded motion. It is kept only where
it helps on recordings that it did not learn from: else it is silent, and the network is its static part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Role
from sysid.errors import ExcitationError
from sysid.networks.actuator import DIRECTIONS, ActuatorNetwork, RoundTripError, fit_actuator
from sysid.networks.checkpoint import Checkpoints
from sysid.networks.memory import Memory
from sysid.networks.recipe import HistoryRecipe, NetworkRecipe
from sysid.networks.recurrent import RecordingWindow, RecurrentSettings, train_recurrent
from sysid.networks.split import RowRange, segments
from sysid.progress import Progress, part, silent
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: A correction reaches this many standard deviations of what the static map leaves.
BOUND = 3.0
#: It is kept where the loss on the recordings to select falls below this share.
HELPS = 0.85
#: Looks in a stretch without gaps that are worth learning from.
MIN_WINDOWS = 8
#: Looks in a piece that is trained at once, and before it to warm up: plays remember what lies further back.
PIECE, WARM = 60, 20
ROLES: tuple[Role, ...] = ("fit", "select")


@dataclass(frozen=True)
class HistoryNetwork:
    """Both directions of one axis, along a motion; no :class:`sysid.machine.CylinderJointMap`, but ``static`` is one.

    Args:
        static: both directions without history.
        to_joint, to_cylinder: what is added along the way.
    """

    static: ActuatorNetwork
    to_joint: Memory
    to_cylinder: Memory

    @property
    def axis(self) -> str:
        return self.static.axis

    def joint_along(self, displacement: Array, rate_hz: float) -> Array:
        """Displacement [m] along a motion (n,) at ``rate_hz`` → joint [rad] (n,). NaN stays NaN and is a new beginning."""
        return self.static.joint(displacement) + self.to_joint.added(displacement, rate_hz)

    def displacement_along(self, joint: Array, rate_hz: float) -> Array:
        """Joint [rad] along a motion (n,) at ``rate_hz`` → displacement [m] (n,)."""
        return self.static.displacement(joint) + self.to_cylinder.added(joint, rate_hz)

    def joint_stream(self, rate_hz: float) -> HistoryStream:
        """Displacement → joint, sample by sample."""
        return HistoryStream(self.static.joint, self.to_joint, rate_hz)

    def displacement_stream(self, rate_hz: float) -> HistoryStream:
        """Joint → displacement, sample by sample."""
        return HistoryStream(self.static.displacement, self.to_cylinder, rate_hz)

    def round_trip(self, displacement: Array, joint: Array, rate_hz: float) -> RoundTripError:
        """Whether the directions, which were learned apart, undo each other along a recorded motion, (n,) each.

        Raises:
            ExcitationError: nothing of it was measured.
        """
        there = np.isfinite(displacement) & np.isfinite(joint)
        if not there.any():
            raise ExcitationError(f"round trip of {self.axis}", "no row with cylinder and joint", "at least one")
        joints = (self.joint_along(self.displacement_along(joint, rate_hz), rate_hz) - joint)[there]
        cylinders = (self.displacement_along(self.joint_along(displacement, rate_hz), rate_hz) - displacement)[there]
        return RoundTripError(
            joint_rmse=float(np.sqrt(np.mean(joints**2))),
            joint_max=float(np.abs(joints).max()),
            cylinder_rmse=float(np.sqrt(np.mean(cylinders**2))),
            cylinder_max=float(np.abs(cylinders).max()),
        )


class HistoryStream:
    """One direction in motion: a :meth:`step` a sample, no torch."""

    def __init__(self, static: Callable[[Array], Array], memory: Memory, rate_hz: float) -> None:
        self._static, self._memory = static, memory.stream(rate_hz)

    def reset(self) -> None:
        """Forget, as if nothing had come before."""
        self._memory.reset()

    def step(self, value: float) -> float:
        """The next sample of the input [SI] → the output [SI]; NaN gives NaN and forgets."""
        return float(self._static(np.array([value]))[0]) + self._memory.step(value)


def fit_history(
    dataset: Dataset, recipe: NetworkRecipe, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> dict[str, HistoryNetwork]:
    """The static networks as :func:`sysid.networks.fit_actuator` fits them, then a memory for each direction.

    Memories learn along the motion of the ``fit`` recordings and stop on the ``select`` ones. A gap in the input, an end of a
    recording or of a block begins anew; samples without the output are passed through and not learned from.

    Args:
        checkpoints: of the static networks; a memory is trained at a go.

    Returns:
        Axis → network, in kinematic order.

    Raises:
        ExcitationError: as ``fit_actuator``; or no stretch of motion without gaps is long enough.
        SettingsError: as ``fit_actuator``.
    """
    static = fit_actuator(dataset, recipe, part(progress or silent, 0.0, 0.3), checkpoints)
    found = {}
    for number, (axis, network) in enumerate(static.items()):
        memories = {}
        for turn, direction in enumerate(DIRECTIONS):
            done = 0.3 + 0.7 * (2 * number + turn) / (2 * len(static))
            tell = _titled(part(progress or silent, done, done + 0.35 / len(static)), f"{axis} {direction} with history")
            memories[direction] = _memory(dataset, network, direction, recipe, tell)
        found[axis] = HistoryNetwork(network, **memories)
    return found


def _titled(progress: Progress, title: str) -> Progress:
    """The same progress under a title of its own."""
    return lambda done, _: progress(done, title)


def _memory(dataset: Dataset, static: ActuatorNetwork, direction: str, recipe: NetworkRecipe, progress: Progress) -> Memory:
    """Train the memory of one direction on what its static map leaves over."""
    settings = recipe.actuator.history
    forward = direction == "to_joint"
    source, target = (axis_signal(static.axis, quantity) for quantity in (("cylinder", "joint")[:: 1 if forward else -1]))
    predict = static.joint if forward else static.displacement
    low, high = static.displacements if forward else static.joints
    widths = np.array(settings.plays) * (high - low)
    rate = dataset.machine.rate_hz
    empty = Memory(max(1, round(settings.interval * rate)) / rate, 1.0, widths, {})
    signals = (source, target)
    fit, select = (_windows(segments(dataset, role, signals), signals, predict, empty) for role in ROLES)
    left = np.concatenate([windows.left for windows in fit]) if fit else np.empty(0)
    spread = float(np.sqrt(np.nanmean(left**2))) if np.isfinite(left).any() else 0.0
    if not (spread > 0.0 and select):
        found = "no stretch of motion without gaps that is long enough to learn from and to select on"
        raise ExcitationError(f"dataset {dataset.reference}: axis {static.axis!r} with history", found, f"{MIN_WINDOWS} looks")
    bound = BOUND * spread
    trained = train_recurrent(fit, select, bound, empty.interval, False, settings_of(settings), recipe.seed, progress)
    weights = dict(trained.weights)
    if not trained.loss < HELPS:
        weights |= {"w": np.zeros_like(weights["w"]), "w0": np.zeros(1)}
    return replace(empty, bound=bound, weights=weights, loss=trained.loss, epochs=trained.epochs)


def settings_of(recipe: HistoryRecipe) -> RecurrentSettings:
    return RecurrentSettings(
        units=recipe.units,
        learning_rate=recipe.learning_rate,
        epochs=recipe.epochs,
        check_every=recipe.check_every,
        patience=max(1, recipe.patience // recipe.check_every),
        piece=PIECE,
        warm=WARM,
    )


def _windows(
    parts: Sequence[RowRange], signals: Sequence[str], predict: Callable[[Array], Array], memory: Memory
) -> list[RecordingWindow]:
    """Stretches without a gap in the input: what the memory sees, and what the static map leaves until the next look."""
    found = []
    for segment in parts:
        rate, stride = segment.recording.rate_hz, memory.stride(segment.recording.rate_hz)
        values, truth = (segment.recording.values(signal)[segment.start : segment.stop] for signal in signals)
        for begin, end in stretches(np.isfinite(values)):
            count = (end - begin) // stride
            if count < MIN_WINDOWS:
                continue
            here = np.ascontiguousarray(values[begin : begin + count * stride])
            left = (truth[begin : begin + count * stride] - predict(here)).reshape(count, stride)
            found.append(RecordingWindow(memory.inputs(here, stride, stride / rate), _mean(left), np.ones(count)))
    return found


def stretches(there: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Begin and end (excluded) of every run of True."""
    edges = np.flatnonzero(np.diff(np.r_[False, there, False].astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def _mean(blocks: Array) -> Array:
    """Means of the rows over what is there; NaN where nothing is."""
    there = np.isfinite(blocks)
    total = np.where(there, blocks, 0.0).sum(axis=1) / np.maximum(there.sum(axis=1), 1)
    return np.where(there.any(axis=1), total, np.nan)


def statics(networks: Mapping[str, ActuatorNetwork | HistoryNetwork]) -> dict[str, ActuatorNetwork]:
    """The static maps by axis, which a plant takes as its linkages."""
    return {axis: item.static if isinstance(item, HistoryNetwork) else item for axis, item in networks.items()}
