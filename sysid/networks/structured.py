"""Structured forward models: what is known of the machine first, and a small bounded network for the rest.

A network of joints → end effector has to learn what geometry says already. With a URDF poses only correct it, some thirty
numbers (:mod:`sysid.networks.calibration`); without one they weigh the products that any open chain is made of
(:mod:`sysid.networks.chain`). What no geometry explains, links that bend under load, is left to perceptrons behind a bound,
``bound·tanh(f(sin q, cos q)/bound)``, kept only where they predict poses better that they have not seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset
from sysid.errors import InputError, SettingsError
from sysid.networks.calibration import Calibration, calibrate
from sysid.networks.chain import FittedChain, fit_chain
from sysid.networks.checkpoint import Checkpoints
from sysid.networks.forward import feature_names, forward_joints, is_angle, taught_rows, to_features
from sysid.networks.geometry import Geometry
from sysid.networks.member import EnsembleMember, LearningCurve
from sysid.networks.mlp import Mlp
from sysid.networks.recipe import NetworkRecipe
from sysid.networks.training import train
from sysid.networks.uncertainty import Mask, NetworkUncertainty, known
from sysid.progress import Progress
from sysid.signals import point_signals

Array = npt.NDArray[np.float64]

#: The network may correct by so many times what the geometry leaves (its root mean square).
REACH = 4.0
#: It stays only where it lowers the error on poses that it has not seen to this share.
MIN_GAIN = 0.95


@dataclass(frozen=True)
class StructuredForward:
    """Joint values → end effector in the base frame.

    Args:
        joints: signals of the inputs, in kinematic order.
        revolute: which of them are angles.
        structure: the geometry calibrated from a URDF, or the products of a chain.
        urdf: text of what was calibrated; empty for a chain.
        members: perceptrons of the rest, averaged; none where they were not worth it.
        bound: the most that they correct [m].
        low, high: range of each joint in the rows it was fitted on, (n_axes,) [rad or m].
        courses: how their training went.
        trust: intervals, and where the data were; None for a version that does not know them.
    """

    joints: tuple[str, ...]
    revolute: tuple[bool, ...]
    structure: Calibration | FittedChain
    urdf: str
    members: tuple[Mlp, ...]
    bound: float
    low: Array
    high: Array
    courses: tuple[LearningCurve, ...] = ()
    trust: NetworkUncertainty | None = None

    def predict(self, q: npt.ArrayLike) -> Array:
        """End-effector positions (n, 3) [m] at joint values ``q`` (n, n_axes) [rad or m].

        Raises:
            InputError: another number of joints.
        """
        values = self._checked(q)
        rest = self._rest(values)
        return np.asarray(self.structure.predict(values) + (rest[0] if len(rest) == 1 else rest.mean(axis=0)))

    def spread(self, q: npt.ArrayLike) -> Array:
        """Standard deviation of the prediction by what the poses leave open, (n, 3) [m]."""
        values = self._checked(q)
        return np.asarray(np.hypot(self.structure.spread(values), self._rest(values).std(axis=0)))

    def predict_interval(self, q: npt.ArrayLike, level: float = 0.95) -> tuple[Array, Array]:
        """Lower and upper ends, (n, 3) [m] each, between which a measured end effector lies at least as often as ``level``
        wherever :meth:`inside` holds.

        Raises:
            InputError: a level that the rows it was evaluated on cannot tell, or a version that does not know its intervals.
        """
        middle, reach = self.predict(q), known(self.trust, "forward model").intervals.reach(self.spread(q), level)
        return middle - reach, middle + reach

    def inside(self, q: npt.ArrayLike) -> Mask:
        """Whether joint values (n, n_axes) lie where the data were, (n,)."""
        return known(self.trust, "forward model").domain.inside(self._checked(q))

    def _rest(self, q: Array) -> Array:
        if not self.members:
            return np.zeros((1, len(q), 3))
        inputs = to_features(q, self.revolute, "sincos")
        return np.array([bounded(member.predict(inputs), self.bound) for member in self.members])

    def _checked(self, q: npt.ArrayLike) -> Array:
        values = np.atleast_2d(np.asarray(q, dtype=np.float64))
        if values.shape[1] != len(self.joints):
            raise InputError(
                "forward model", f"{values.shape[1]} joint values", f"{len(self.joints)}: {', '.join(self.joints)}"
            )
        return values


def fit_structured(
    dataset: Dataset, recipe: NetworkRecipe, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> StructuredForward:
    """Calibrate the machine's URDF (or weigh the products of its chain) on static poses, and teach a network what is left.

    Raises:
        ExcitationError: too few poses, or a joint or the end effector that was not measured.
        SettingsError: the machine has no URDF to calibrate, or training diverges.
    """
    fit, select = taught_rows(dataset, recipe)
    joints = forward_joints(dataset)
    count = len(joints)
    revolute = tuple(is_angle(dataset, signal) for signal in joints)
    q, tip = fit.values[:, :count], fit.values[:, count:]
    q_unseen, tip_unseen = select.values[:, :count], select.values[:, count:]
    structure = fit_chain(q, tip, revolute) if recipe.forward.model == "chain" else _calibrated(dataset, q, tip)
    left, unseen = tip - structure.predict(q), tip_unseen - structure.predict(q_unseen)
    members, courses, bound = _rest(recipe, (q, left), (q_unseen, unseen), revolute, joints, progress, checkpoints)
    return StructuredForward(
        joints=joints,
        revolute=revolute,
        structure=structure,
        urdf=(dataset.machine.urdf_text or "") if isinstance(structure, Calibration) else "",
        members=members,
        bound=bound,
        low=q.min(axis=0),
        high=q.max(axis=0),
        courses=courses,
    )


def _calibrated(dataset: Dataset, q: Array, tip: Array) -> Calibration:
    machine = dataset.machine
    kinematics = machine.kinematics()
    if kinematics is None:
        found = f"machine {machine.name!r} has no URDF"
        expected = "urdf = … and tip = … in machine.toml, or model = 'chain'"
        raise SettingsError("recipe: forward.model = 'structured'", found, expected)
    joint_noise, tip_noise = (
        np.array([machine.noise.get(signal, np.nan) for signal in signals], dtype=np.float64)
        for signals in (forward_joints(dataset), point_signals("ee"))
    )
    return calibrate(Geometry(kinematics), q, tip, joint_noise, tip_noise)


def _rest(
    recipe: NetworkRecipe,
    fit: tuple[Array, Array],
    select: tuple[Array, Array],
    revolute: tuple[bool, ...],
    joints: tuple[str, ...],
    progress: Progress | None,
    checkpoints: Checkpoints | None,
) -> tuple[tuple[Mlp, ...], tuple[LearningCurve, ...], float]:
    """Perceptrons of what the geometry leaves, their courses and bound; nothing where they are of no use."""
    (q, left), (q_unseen, unseen) = fit, select
    bound = REACH * float(np.sqrt(np.mean(left**2)))
    if not recipe.forward.residual or bound <= 0.0:
        return (), (), 0.0
    members = [
        EnsembleMember(
            name=f"forward residual {number}",
            inputs=to_features(q, revolute, "sincos"),
            outputs=_unbounded(left, bound),
            validation_inputs=to_features(q_unseen, revolute, "sincos"),
            validation_outputs=_unbounded(unseen, bound),
            input_names=feature_names(joints, revolute, "sincos"),
            output_names=point_signals("ee"),
            rectifier=recipe.forward.rectifier,
        )
        for number in range(1, recipe.forward.members + 1)
    ]
    trained = train(members, recipe.forward.residual_hidden, recipe.forward.training, recipe.seed, progress, checkpoints)
    inputs = to_features(q_unseen, revolute, "sincos")
    said = np.mean([bounded(result.mlp.predict(inputs), bound) for result in trained], axis=0)
    if np.sqrt(np.mean((unseen - said) ** 2)) > MIN_GAIN * np.sqrt(np.mean(unseen**2)):
        return (), (), 0.0
    return tuple(result.mlp for result in trained), tuple(result.course for result in trained), bound


def bounded(values: Array, bound: float) -> Array:
    """``values`` drawn in so that none exceeds ``bound``."""
    return np.asarray(bound * np.tanh(values / bound))


def _unbounded(values: Array, bound: float) -> Array:
    """What :func:`bounded` makes these of; what lies at or beyond the bound counts as nearly there."""
    return np.asarray(bound * np.arctanh(np.clip(values / bound, -0.95, 0.95)))
