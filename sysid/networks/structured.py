"""Structured forward models: a geometric model of the machine, and a small bounded network for its residual.

With a URDF its geometry is calibrated (:mod:`sysid.networks.calibration`); without one the coefficients of the products that
describe any open chain are fitted (:mod:`sysid.networks.chain`). Effects without a geometric model, such as links that bend
under load, are fitted by perceptrons, ``bound·tanh(f(sin q, cos q)/bound)``, which are kept only if they lower the error on the
select poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from sysid.datasets.recording import Dataset
from sysid.errors import SettingsError
from sysid.networks import calibration
from sysid.networks.calibration import Calibration, calibrate
from sysid.networks.chain import FittedChain, fit_chain
from sysid.networks.forward import (
    MIN_POSES,
    ForwardModel,
    ForwardNetwork,
    feature_names,
    fit_forward_network,
    forward_joints,
    forward_members,
    is_angle,
    to_features,
    training_rows,
)
from sysid.networks.geometry import Geometry
from sysid.networks.member import Checkpoints, LearningCurve
from sysid.networks.mlp import Mlp
from sysid.networks.recipe import NetworkRecipe
from sysid.networks.training import train
from sysid.networks.uncertainty import NetworkUncertainty
from sysid.progress import Progress
from sysid.signals import point_signals

Array = npt.NDArray[np.float64]

#: Bound of the residual network, in RMS residuals of the geometry.
BOUND_FACTOR = 4.0
#: The residual network is kept only if it lowers the RMSE on the select poses to this share or less.
MAX_ERROR_SHARE = 0.95


@dataclass(frozen=True, kw_only=True)
class StructuredForward(ForwardModel):
    """A geometric model, and networks of its residual; none where they do not help.

    Args:
        structure: the calibrated geometry of a URDF, or the products of a chain.
        urdf: text of the calibrated URDF; empty for a chain.
        bound: largest output of the residual networks [m].
    """

    structure: Calibration | FittedChain
    urdf: str
    bound: float

    def predict(self, q: npt.ArrayLike) -> Array:
        values = self._checked(q)
        residuals = self._residuals(values)
        return np.asarray(self.structure.predict(values) + (residuals[0] if len(residuals) == 1 else residuals.mean(axis=0)))

    def spread(self, q: npt.ArrayLike) -> Array:
        """Standard deviation of the prediction from the parameter covariance and the ensemble, (n, 3) [m]."""
        values = self._checked(q)
        return np.asarray(np.hypot(self.structure.spread(values), self._residuals(values).std(axis=0)))

    def _residuals(self, q: Array) -> Array:
        if not self.members:
            return np.zeros((1, len(q), 3))
        inputs = to_features(q, self.revolute, "sincos")
        return np.array([bounded(member.predict(inputs), self.bound) for member in self.members])


def fit_structured(
    dataset: Dataset, recipe: NetworkRecipe, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> StructuredForward:
    """Calibrate the machine's URDF (or fit the products of its chain) on static poses, then a network on the residual.

    Raises:
        ExcitationError: too few poses, or a joint or the end effector that was not measured.
        SettingsError: the machine has no URDF to calibrate, or training diverges.
    """
    calibrates = recipe.forward.model == "structured"
    fit, select = training_rows(dataset, recipe, _least_poses(recipe), markers_of(dataset) if calibrates else ())
    joints = forward_joints(dataset)
    count = len(joints)
    revolute = tuple(is_angle(dataset, signal) for signal in joints)
    q, tip = fit.values[:, :count], fit.values[:, count : count + 3]
    q_select, tip_select = select.values[:, :count], select.values[:, count : count + 3]
    structure = _calibrated(dataset, q, fit.values[:, count:]) if calibrates else fit_chain(q, tip, revolute)
    residual, select_residual = tip - structure.predict(q), tip_select - structure.predict(q_select)
    members, learning_curves, bound = _residual_networks(
        recipe, (q, residual), (q_select, select_residual), revolute, joints, progress, checkpoints
    )
    return StructuredForward(
        joints=joints,
        revolute=revolute,
        structure=structure,
        urdf=(dataset.machine.urdf_text or "") if isinstance(structure, Calibration) else "",
        members=members,
        bound=bound,
        low=q.min(axis=0),
        high=q.max(axis=0),
        learning_curves=learning_curves,
    )


def _least_poses(recipe: NetworkRecipe) -> int:
    """A calibration needs fewer poses than a network or the products of a chain."""
    return calibration.MIN_POSES if recipe.forward.model == "structured" else MIN_POSES


def _calibrated(dataset: Dataset, q: Array, points: Array) -> Calibration:
    machine = dataset.machine
    kinematics = machine.kinematics()
    if kinematics is None:
        found = f"machine {machine.name!r} has no URDF"
        expected = "urdf = … and tip = … in machine.toml, or model = 'chain'"
        raise SettingsError("recipe: forward.model = 'structured'", found, expected)
    markers = markers_of(dataset)
    joint_noise, point_noise = (
        np.array([machine.noise.get(signal, np.nan) for signal in signals], dtype=np.float64)
        for signals in (forward_joints(dataset), [s for point in ("ee", *markers) for s in point_signals(point)])
    )
    geometry = Geometry(kinematics, {name: machine.markers[name] for name in markers})
    points = points.reshape(len(q), -1, 3)
    return calibrate(geometry, q, points, joint_noise, point_noise.reshape(-1, 3), compare=True)


def markers_of(dataset: Dataset) -> tuple[str, ...]:
    """Markers of the machine that the recordings of poses measure."""
    measured = {signal for recording in dataset.of_kind("poses") for signal in recording.signals}
    return tuple(name for name in dataset.machine.markers if set(point_signals(name)) <= measured)


def _residual_networks(
    recipe: NetworkRecipe,
    fit: tuple[Array, Array],
    select: tuple[Array, Array],
    revolute: tuple[bool, ...],
    joints: tuple[str, ...],
    progress: Progress | None,
    checkpoints: Checkpoints | None,
) -> tuple[tuple[Mlp, ...], tuple[LearningCurve, ...], float]:
    """Residual networks with their learning curves and bound; empty where they do not help."""
    (q, residual), (q_select, select_residual) = fit, select
    bound = BOUND_FACTOR * float(np.sqrt(np.mean(residual**2)))
    if not recipe.forward.residual or bound <= 0.0:
        return (), (), 0.0
    rows, inputs = to_features(q, revolute, "sincos"), to_features(q_select, revolute, "sincos")
    members = forward_members(
        [f"forward residual {number}" for number in range(1, recipe.forward.members + 1)],
        (rows, _unbounded(residual, bound)),
        (inputs, _unbounded(select_residual, bound)),
        feature_names(joints, revolute, "sincos"),
        recipe,
    )
    trained = train(members, recipe.forward.residual_hidden, recipe.forward.training, recipe.seed, progress, checkpoints)
    predicted = np.mean([bounded(result.mlp.predict(inputs), bound) for result in trained], axis=0)
    if np.sqrt(np.mean((select_residual - predicted) ** 2)) > MAX_ERROR_SHARE * np.sqrt(np.mean(select_residual**2)):
        return (), (), 0.0
    return tuple(result.mlp for result in trained), tuple(result.curve for result in trained), bound


def bounded(values: Array, bound: float) -> Array:
    """``values`` compressed smoothly into ±``bound``."""
    return np.asarray(bound * np.tanh(values / bound))


def _unbounded(values: Array, bound: float) -> Array:
    """Inverse of :func:`bounded`; values beyond 95 % of the bound are clipped to it."""
    return np.asarray(bound * np.arctanh(np.clip(values / bound, -0.95, 0.95)))


def fit_forward(
    dataset: Dataset, recipe: NetworkRecipe, progress: Progress | None = None, checkpoints: Checkpoints | None = None
) -> ForwardNetwork | StructuredForward:
    """:func:`fit_forward_network` or :func:`fit_structured`, by ``recipe.forward.model``, with intervals and training domain.

    Raises:
        ExcitationError, SettingsError: as those.
    """
    learn = fit_forward_network if recipe.forward.model == "network" else fit_structured
    model = learn(dataset, recipe, progress, checkpoints)
    fit, select = training_rows(dataset, recipe, _least_poses(recipe))
    count = len(model.joints)
    q = select.values[:, :count]
    errors = select.values[:, count:] - model.predict(q)
    return replace(model, uncertainty=NetworkUncertainty.of(fit.values[:, :count], errors, model.spread(q)))
