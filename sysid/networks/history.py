"""Actuator networks with history: static maps of both directions, each with a recurrent correction for backlash and hysteresis.

The static part (:mod:`sysid.networks.actuator`) is the linkage of a plant. A bounded recurrent correction
(:mod:`sysid.networks.history_correction`) is fitted to its residual along the recorded motion. If it does not lower the loss on
the select recordings, it is inactive and the network is its static part.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.chunked import stretches
from sysid.datasets.recording import Dataset, Role
from sysid.errors import ExcitationError
from sysid.networks.actuator import DIRECTIONS, ActuatorNetwork, RoundTripError, fit_actuator
from sysid.networks.history_correction import HistoryCorrection
from sysid.networks.member import Checkpoints
from sysid.networks.recipe import NetworkRecipe
from sysid.networks.recurrent import RecordingWindow, RecurrentSettings, interval_means, train_recurrent
from sysid.networks.split import RowRange, segments
from sysid.progress import Progress, part, silent
from sysid.signals import axis_signal

Array = npt.NDArray[np.float64]

#: Bound of a correction, in RMS residuals of the static map.
BOUND_SIGMAS = 3.0
#: A correction is kept if it lowers the loss on the select recordings below this share.
MAX_LOSS_RATIO = 0.85
#: Least number of updates in a sequence without gaps.
MIN_UPDATES = 8
#: Updates per training sequence, and before it to initialise the state; play operators hold what lies further back.
SEQUENCE, WARM_UP = 60, 20
ROLES: tuple[Role, ...] = ("fit", "select")


@dataclass(frozen=True)
class HistoryNetwork:
    """Both directions of one axis along a motion; only ``static`` is a :class:`sysid.machine.CylinderJointMap`.

    Args:
        static: static maps of both directions.
        to_joint, to_cylinder: corrections that are added to them.
    """

    static: ActuatorNetwork
    to_joint: HistoryCorrection
    to_cylinder: HistoryCorrection

    @property
    def axis(self) -> str:
        return self.static.axis

    def joint_along(self, displacement: Array, rate_hz: float) -> Array:
        """Displacement [m] along a motion (n,) at ``rate_hz`` → joint [rad] (n,). NaN gives NaN and resets the state."""
        return self.static.joint(displacement) + self.to_joint.output(displacement, rate_hz)

    def displacement_along(self, joint: Array, rate_hz: float) -> Array:
        """Joint [rad] along a motion (n,) at ``rate_hz`` → displacement [m] (n,)."""
        return self.static.displacement(joint) + self.to_cylinder.output(joint, rate_hz)

    def joint_stream(self, rate_hz: float) -> HistoryStream:
        """Displacement → joint, sample by sample."""
        return HistoryStream(self.static.joint, self.to_joint, rate_hz)

    def round_trip(self, displacement: Array, joint: Array, rate_hz: float) -> RoundTripError:
        """Whether the directions, which are fitted separately, invert each other along a recorded motion, (n,) each.

        Raises:
            ExcitationError: no row with both values.
        """
        there = np.isfinite(displacement) & np.isfinite(joint)
        if not there.any():
            raise ExcitationError(f"round trip of {self.axis}", "no row with cylinder and joint", "at least one")
        joints = (self.joint_along(self.displacement_along(joint, rate_hz), rate_hz) - joint)[there]
        cylinders = (self.displacement_along(self.joint_along(displacement, rate_hz), rate_hz) - displacement)[there]
        return RoundTripError.of(joints, cylinders)


class HistoryStream:
    """One direction, sample by sample with :meth:`step`, without torch."""

    def __init__(self, static: Callable[[Array], Array], correction: HistoryCorrection, rate_hz: float) -> None:
        self._static, self._correction, self._timing = static, correction, correction.timing(rate_hz)
        self.reset()

    def reset(self) -> None:
        """Reset the state."""
        self._state = self._correction.state()

    def step(self, value: float) -> float:
        """The next sample of the input [SI] → the output [SI]; NaN gives NaN and resets the state."""
        return float(self._static(np.array([value]))[0]) + self._correction.step(self._state, value, self._timing)


def fit_history(
    dataset: Dataset, recipe: NetworkRecipe, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> dict[str, HistoryNetwork]:
    """The static networks as :func:`sysid.networks.fit_actuator` fits them, then a correction for each direction.

    Corrections are fitted along the motion of the ``fit`` recordings; the ``select`` recordings decide early stopping. Gaps in
    the input and ends of recordings and blocks reset the state; samples without the output have no loss.

    Args:
        checkpoints: of the static networks; the corrections have none.

    Returns:
        Axis → network, in kinematic order.

    Raises:
        ExcitationError: as ``fit_actuator``; or no motion without gaps is long enough.
        SettingsError: as ``fit_actuator``.
    """
    static = fit_actuator(dataset, recipe, part(progress or silent, 0.0, 0.3), checkpoints)
    found = {}
    for number, (axis, network) in enumerate(static.items()):
        corrections = {}
        for k, direction in enumerate(DIRECTIONS):
            done = 0.3 + 0.7 * (2 * number + k) / (2 * len(static))
            own = part(progress or silent, done, done + 0.35 / len(static))
            corrections[direction] = _correction(dataset, network, direction, recipe, own)
        found[axis] = HistoryNetwork(network, **corrections)
    return found


def _correction(
    dataset: Dataset, static: ActuatorNetwork, direction: str, recipe: NetworkRecipe, progress: Progress
) -> HistoryCorrection:
    """Train the correction of one direction on the residual of its static map."""
    settings = recipe.actuator.history
    forward = direction == "to_joint"
    source, target = (axis_signal(static.axis, quantity) for quantity in (("cylinder", "joint")[:: 1 if forward else -1]))
    predict = static.joint if forward else static.displacement
    low, high = static.displacements if forward else static.joints
    widths = np.array(settings.plays) * (high - low)
    rate = dataset.machine.rate_hz
    empty = HistoryCorrection(max(1, round(settings.interval * rate)) / rate, 1.0, widths, {})
    signals = (source, target)
    fit, select = (recording_windows(segments(dataset, role, signals), signals, predict, empty) for role in ROLES)
    residual = np.concatenate([windows.residual for windows in fit]) if fit else np.empty(0)
    spread = float(np.sqrt(np.nanmean(residual**2))) if np.isfinite(residual).any() else 0.0
    if not (spread > 0.0 and select):
        found = "no motion without gaps that is long enough to fit and to select on"
        raise ExcitationError(
            f"dataset {dataset.reference}: axis {static.axis!r} with history", found, f"{MIN_UPDATES} updates"
        )
    bound = BOUND_SIGMAS * spread
    own = RecurrentSettings(
        units=settings.units,
        learning_rate=settings.learning_rate,
        epochs=settings.epochs,
        check_every=settings.check_every,
        patience=max(1, settings.patience // settings.check_every),
        piece=SEQUENCE,
        warm=WARM_UP,
    )
    title = f"{static.axis} {direction} with history"
    trained = train_recurrent(
        fit, select, bound, empty.interval, False, own, recipe.seed, lambda done, _: progress(done, title)
    )
    weights = dict(trained.weights)
    if not trained.loss < MAX_LOSS_RATIO:
        weights |= {"w": np.zeros_like(weights["w"]), "w0": np.zeros(1)}
    return replace(empty, bound=bound, weights=weights, loss=trained.loss, epochs=trained.epochs)


def recording_windows(
    parts: Sequence[RowRange], signals: Sequence[str], predict: Callable[[Array], Array], correction: HistoryCorrection
) -> list[RecordingWindow]:
    """Sequences without a gap in the input: inputs of the correction, and mean residual until the next update."""
    found = []
    for segment in parts:
        stride, interval = correction.timing(segment.recording.rate_hz)
        values, truth = (segment.recording.values(signal)[segment.start : segment.stop] for signal in signals)
        for begin, end in zip(*stretches(np.isfinite(values)), strict=True):
            count = (end - begin) // stride
            if count < MIN_UPDATES:
                continue
            here = np.ascontiguousarray(values[begin : begin + count * stride])
            residual = truth[begin : begin + count * stride] - predict(here)
            inputs = correction.inputs(here, stride, interval)
            found.append(RecordingWindow(inputs, interval_means(residual, stride), np.ones(count)))
    return found


def static_maps(networks: Mapping[str, ActuatorNetwork | HistoryNetwork]) -> dict[str, ActuatorNetwork]:
    """The static map of every axis, for the linkages of a plant."""
    return {axis: item.static if isinstance(item, HistoryNetwork) else item for axis, item in networks.items()}
