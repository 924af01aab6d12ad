"""The forward network: joint values → end-effector position, learned from static poses.

Source: the paper's forward network (256-128 hidden units, ReLU, Adam, 500 random poses). With ``features = "sincos"`` a
revolute joint enters as sine and cosine, so the model is periodic in the angle; with ``"products"`` their products enter as
well, in which the tip of any open chain is linear (:mod:`sysid.networks.chain`).
"""

from __future__ import annotations

import functools
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset, Role
from sysid.errors import ExcitationError, InputError
from sysid.networks.chain import product_names, products
from sysid.networks.member import Checkpoints, EnsembleMember, LearningCurve
from sysid.networks.mlp import Mlp
from sysid.networks.recipe import Features, NetworkRecipe
from sysid.networks.split import SignalRows, gather, segments, thin
from sysid.networks.training import train
from sysid.networks.uncertainty import Mask, NetworkUncertainty, required
from sysid.progress import Progress
from sysid.signals import axis_signal, point_signals

Array = npt.NDArray[np.float64]

#: Least number of poses to fit.
MIN_POSES = 30
#: A machine is at rest where no joint is faster than this share of its 99th percentile of speed, for at least this time [s].
STILL_SPEED = 0.02
STILL_S = 0.2


@dataclass(frozen=True, kw_only=True)
class ForwardModel(ABC):
    """A fitted model of joint values → end effector in the base frame.

    Args:
        joints: signals of the inputs, in kinematic order.
        revolute: which of them are angles.
        members: networks whose outputs are averaged.
        low, high: range of each joint in the rows it was fitted on, (n_axes,) [rad or m].
        learning_curves: of the members.
        uncertainty: intervals and training domain; None for a version of an earlier release.
    """

    joints: tuple[str, ...]
    revolute: tuple[bool, ...]
    members: tuple[Mlp, ...]
    low: Array
    high: Array
    learning_curves: tuple[LearningCurve, ...] = ()
    uncertainty: NetworkUncertainty | None = None

    @abstractmethod
    def predict(self, q: npt.ArrayLike) -> Array:
        """End-effector positions (n, 3) [m] at joint values ``q`` (n, n_axes) [rad or m].

        Raises:
            InputError: another number of joints.
        """

    @abstractmethod
    def spread(self, q: npt.ArrayLike) -> Array:
        """Standard deviation of the prediction, (n, 3) [m]."""

    def predict_interval(self, q: npt.ArrayLike, level: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper bounds, (n, 3) [m] each, that contain a measured end effector with probability ``level`` or more
        where :meth:`inside` is true.

        Raises:
            InputError: a level that the calibration rows do not support, or a version without intervals.
        """
        reach = required(self.uncertainty, "forward model").intervals.reach(self.spread(q), level)
        middle = self.predict(q)
        return middle - reach, middle + reach

    def inside(self, q: npt.ArrayLike) -> Mask:
        """Whether joint values (n, n_axes) lie in the training domain, (n,)."""
        return required(self.uncertainty, "forward model").domain.inside(self._checked(q))

    def _checked(self, q: npt.ArrayLike) -> Array:
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        if values.shape[1] != len(self.joints):
            expected = f"{len(self.joints)}: {', '.join(self.joints)}"
            raise InputError("forward model", f"{values.shape[1]} joint values", expected)
        return values


@dataclass(frozen=True, kw_only=True)
class ForwardNetwork(ForwardModel):
    """Perceptrons alone; ``features``: how the joint values enter them."""

    features: Features

    def predict(self, q: npt.ArrayLike) -> Array:
        each = self._every(q)
        return np.asarray(each[0] if len(each) == 1 else each.mean(axis=0))

    def spread(self, q: npt.ArrayLike) -> Array:
        """Standard deviation between the members, (n, 3) [m]; zero for a single one."""
        return np.asarray(self._every(q).std(axis=0))

    def _every(self, q: npt.ArrayLike) -> Array:
        inputs = to_features(self._checked(q), self.revolute, self.features)
        return np.array([member.predict(inputs) for member in self.members])


def fit_forward_network(
    dataset: Dataset, recipe: NetworkRecipe, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> ForwardNetwork:
    """Fit the forward network on the dataset's ``poses`` recordings; without any, on the still phases of its motion.

    Raises:
        ExcitationError: a joint or the end effector was not measured, too few poses, a joint that did not move.
        SettingsError: training diverges.
    """
    fit, select = training_rows(dataset, recipe)
    joints = forward_joints(dataset)
    count = len(joints)
    revolute = tuple(is_angle(dataset, signal) for signal in joints)
    features = recipe.forward.features
    rows, others = ((to_features(r.values[:, :count], revolute, features), r.values[:, count:]) for r in (fit, select))
    names = [f"forward {number}" for number in range(1, recipe.forward.members + 1)]
    members = forward_members(
        names if len(names) > 1 else ["forward"], rows, others, feature_names(joints, revolute, features), recipe
    )
    trained = train(members, recipe.forward.hidden, recipe.forward.training, recipe.seed, progress, checkpoints)
    return ForwardNetwork(
        joints=joints,
        revolute=revolute,
        features=features,
        members=tuple(result.mlp for result in trained),
        low=fit.values[:, :count].min(axis=0),
        high=fit.values[:, :count].max(axis=0),
        learning_curves=tuple(result.curve for result in trained),
    )


def forward_members(
    names: Sequence[str],
    fit: tuple[Array, Array],
    select: tuple[Array, Array],
    input_names: tuple[str, ...],
    recipe: NetworkRecipe,
) -> list[EnsembleMember]:
    """Networks with these names on the same rows of inputs (n, d) and outputs (n, 3)."""
    return [
        EnsembleMember(name, *fit, *select, input_names, point_signals("ee"), rectifier=recipe.forward.rectifier)
        for name in names
    ]


def training_rows(
    dataset: Dataset, recipe: NetworkRecipe, least: int = MIN_POSES, markers: tuple[str, ...] = ()
) -> tuple[SignalRows, SignalRows]:
    """Fit rows and select rows of a forward model, at most as many as the recipe says.

    Args:
        least: number of poses to fit.
        markers: points beside the end effector whose columns follow its.

    Raises:
        ExcitationError: too few of either, or a joint or the end effector that was not measured.
    """
    fit, select = forward_rows(dataset, "fit", markers), forward_rows(dataset, "select", markers)
    for rows, role, need in ((fit, "to fit", least), (select, "for early stopping", least // 10)):
        if len(rows) < need:
            raise ExcitationError(
                f"dataset {dataset.reference}",
                f"{len(rows)} static poses {role}",
                f"at least {need}",
                "Record the calibration routine: several hundred random poses, each held still.",
            )
    share = min(1.0, recipe.forward.poses / (len(fit) + len(select)))
    fit, select = thin(fit, max(least, round(share * len(fit)))), thin(select, max(1, round(share * len(select))))
    return fit, select


def forward_joints(dataset: Dataset) -> tuple[str, ...]:
    """The joint signals in kinematic order."""
    return tuple(axis_signal(axis, "joint") for axis in dataset.machine.axis_names)


def forward_rows(dataset: Dataset, role: Role, markers: tuple[str, ...] = ()) -> SignalRows:
    """Static poses of ``role``: columns are the joints, then ``ee.x ee.y ee.z``, then the markers' coordinates.

    Raises:
        ExcitationError: no recording to fit has all of them.
    """
    points = [signal for point in ("ee", *markers) for signal in point_signals(point)]
    signals = (*forward_joints(dataset), *points)
    if dataset.of_kind("poses"):
        return gather(segments(dataset, role, signals, "poses"), signals)
    return _still_phases(gather(segments(dataset, role, signals), signals), len(dataset.machine.axes))


def is_angle(dataset: Dataset, signal: str) -> bool:
    """Whether a joint signal is in rad: by the URDF, else by the unit it was recorded in."""
    unit = dataset.machine.expected_unit(signal) or dataset.units.get(signal, "rad")
    return unit == "rad"


def to_features(q: Array, revolute: tuple[bool, ...], features: Features) -> Array:
    """Joint values (n, n_axes) as the network's inputs (n, d)."""
    if features == "joints":
        return q
    if features == "products":
        return products(q, revolute)
    angles, others = _columns(revolute)
    turned = q.take(angles, axis=1)
    return np.concatenate([np.sin(turned), np.cos(turned), q.take(others, axis=1)], axis=1)


@functools.lru_cache(maxsize=64)
def _columns(revolute: tuple[bool, ...]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    return np.flatnonzero(revolute), np.flatnonzero(~np.array(revolute, dtype=bool))


def feature_names(joints: tuple[str, ...], revolute: tuple[bool, ...], features: Features) -> tuple[str, ...]:
    """What the columns of :func:`to_features` are, for messages."""
    if features == "joints":
        return joints
    if features == "products":
        return product_names(joints, revolute)
    angles = [joint for joint, angle in zip(joints, revolute, strict=True) if angle]
    others = [joint for joint, angle in zip(joints, revolute, strict=True) if not angle]
    return (*(f"sin({joint})" for joint in angles), *(f"cos({joint})" for joint in angles), *others)


def _still_phases(rows: SignalRows, joints: int) -> SignalRows:
    """The mean row of every sequence of consecutive rows in which no joint moves."""
    if len(rows) < 2:
        return rows
    step = np.diff(rows.time)
    joined = (rows.recording[1:] == rows.recording[:-1]) & (np.diff(rows.row) == 1)
    speed = np.abs(np.diff(rows.values[:, :joints], axis=0)) / np.where(joined, step, np.inf)[:, None]
    # Single differences are dominated by sensor noise: use the mean speed over the least duration of a still phase.
    typical = float(np.median(step[joined])) if joined.any() else 1.0
    width = max(1, round(STILL_S / typical))
    smooth = np.abs(rows.values[width:, :joints] - rows.values[:-width, :joints]) / (width * typical)
    whole = (rows.recording[width:] == rows.recording[:-width]) & (rows.row[width:] - rows.row[:-width] == width)
    limit = STILL_SPEED * np.percentile(speed, 99, axis=0)
    quiet = whole & np.all(smooth <= limit, axis=1)
    still = np.zeros(len(rows), dtype=bool)
    for offset in range(width + 1):
        still[offset : offset + len(quiet)] |= quiet
    starts = np.flatnonzero(still & ~np.r_[False, still[:-1] & joined])
    phases = np.searchsorted(starts, np.arange(len(rows)), side="right") - 1
    picked, means = [], []
    for number in range(len(starts)):
        members = np.flatnonzero(still & (phases == number))
        picked.append(members[len(members) // 2])
        means.append(rows.values[members].mean(axis=0))
    taken = rows.take(np.array(picked, dtype=np.int64))
    return SignalRows(rows.signals, np.array(means).reshape(-1, rows.values.shape[1]), taken.recording, taken.row, taken.time)
