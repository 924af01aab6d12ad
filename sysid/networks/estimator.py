"""Networks as a scikit-learn estimator, and a cross-validation that trains all folds at once.

:func:`cross_validate` trains all folds and members together and returns the same scores as that of scikit-learn, since a
member's result does not depend on the other members.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import KW_ONLY, dataclass, fields
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.metrics import check_scoring
from sklearn.model_selection import GroupShuffleSplit, ShuffleSplit, check_cv
from sklearn.utils.validation import check_is_fitted, validate_data

from sysid.errors import SettingsError
from sysid.networks.member import EnsembleMember, TrainingSettings
from sysid.networks.mlp import Rectifier
from sysid.networks.training import train

Array = npt.NDArray[np.float64]


@dataclass(eq=False, repr=False)
class NetworkRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """The mean of ``members`` perceptrons with normalisation inside and early stopping.

    Args:
        hidden: units of the hidden layers.
        members: networks with different initial weights and shuffle orders.
        learning_rate, batch, epochs, patience, check_every, schedule, threads, device: as in :class:`TrainingSettings`.
        validation_fraction: share of the rows for early stopping; whole groups where ``fit`` gets ``groups``.
        random_state: seed of the split, the weights and the shuffle orders.
        rectifier: between the layers, ``relu`` or ``smooth``.

    Attributes:
        networks_: one :class:`Mlp` per member; ``learning_curves_``: one :class:`LearningCurve` per member.
    """

    hidden: Sequence[int] = (64, 64)
    _: KW_ONLY
    members: int = 1
    learning_rate: float = 1e-3
    batch: int = 64
    epochs: int = 500
    patience: int = 100
    check_every: int = 5
    schedule: Literal["constant", "cosine"] = "cosine"
    validation_fraction: float = 0.1
    random_state: int = 0
    threads: int = 0
    device: Literal["auto", "cpu", "cuda"] = "auto"
    rectifier: Rectifier = "relu"

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike, groups: npt.ArrayLike | None = None) -> Self:
        """Fit ``y`` (n,) or (n, d_out) to ``X`` (n, d_in), both in SI units.

        Args:
            groups: (n,), e.g. recordings: no group is split between fit and early-stopping rows.

        Raises:
            ValueError: rows that no scikit-learn estimator accepts (NaN, no rows, unequal lengths).
            SysidError: as :func:`sysid.networks.train`: a constant column, an invalid setting, divergence.
        """
        fit_together([(self, X, y, groups)])
        return self

    def predict(self, X: npt.ArrayLike) -> Array:
        """(n, d_in) → (n,) or (n, d_out), as ``y`` was."""
        each = self._every(X)
        return np.asarray(each.mean(axis=0))

    def spread(self, X: npt.ArrayLike) -> Array:
        """Standard deviation between the members, shaped as :meth:`predict`; zero for a single one."""
        return np.asarray(self._every(X).std(axis=0))

    def _every(self, X: npt.ArrayLike) -> Array:
        check_is_fitted(self)
        values = validate_data(self, X, reset=False, dtype=np.float64)
        each = np.stack([network.predict(values) for network in self.networks_])
        return each[:, :, 0] if self._flat else each

    def __sklearn_tags__(self) -> Any:
        tags = super().__sklearn_tags__()
        tags.target_tags.multi_output = True
        return tags

    def _settings(self) -> TrainingSettings:
        return TrainingSettings(**{field.name: getattr(self, field.name) for field in fields(TrainingSettings)})

    def _members(self, X: npt.ArrayLike, y: npt.ArrayLike, groups: npt.ArrayLike | None) -> list[EnsembleMember]:
        """The rows of each member, checked by scikit-learn's rules."""
        if self.members < 1:
            raise SettingsError("estimator", f"members = {self.members}", "a positive number")
        inputs, outputs = validate_data(self, X, y, dtype=np.float64, multi_output=True, y_numeric=True, ensure_min_samples=2)
        outputs = np.asarray(outputs, dtype=np.float64)
        self._flat = outputs.ndim == 1
        outputs = outputs.reshape(len(inputs), -1)
        kind = ShuffleSplit if groups is None else GroupShuffleSplit
        split = kind(1, test_size=self.validation_fraction, random_state=self.random_state)
        fit, held = next(split.split(inputs, groups=groups))
        names = getattr(self, "feature_names_in_", [f"column {k}" for k in range(inputs.shape[1])])
        return [
            EnsembleMember(
                name=f"member {number}",
                inputs=inputs[fit],
                outputs=outputs[fit],
                validation_inputs=inputs[held],
                validation_outputs=outputs[held],
                input_names=tuple(map(str, names)),
                output_names=tuple(f"output {k}" for k in range(outputs.shape[1])),
                hidden=tuple(self.hidden),
                learning_rate=self.learning_rate,
                rectifier=self.rectifier,
            )
            for number in range(self.members)
        ]


#: An estimator, its rows X and y, and their groups.
Task = tuple[NetworkRegressor, npt.ArrayLike, npt.ArrayLike, npt.ArrayLike | None]


def fit_together(tasks: Sequence[Task]) -> None:
    """Fit every estimator on its rows, those with equal settings together; learning rates and layers may differ.

    Each result is that of the estimator's own ``fit``.
    """
    alike: dict[tuple[Any, ...], list[tuple[NetworkRegressor, list[EnsembleMember]]]] = {}
    for estimator, X, y, groups in tasks:
        members = estimator._members(X, y, groups)
        settings = {key: value for key, value in vars(estimator._settings()).items() if key != "learning_rate"}
        alike.setdefault((estimator.random_state, *settings.values()), []).append((estimator, members))
    for group in alike.values():
        first = group[0][0]
        whole = [member for _, members in group for member in members]
        trained = iter(train(whole, tuple(first.hidden), first._settings(), first.random_state))
        for estimator, members in group:
            results = [next(trained) for _ in members]
            estimator.networks_ = tuple(one.mlp for one in results)
            estimator.learning_curves_ = tuple(one.curve for one in results)


def cross_validate(
    estimators: NetworkRegressor | Sequence[NetworkRegressor],
    X: npt.ArrayLike,
    y: npt.ArrayLike,
    *,
    groups: npt.ArrayLike | None = None,
    cv: Any = None,
    scoring: Any = None,
) -> list[dict[str, Any]] | dict[str, Any]:
    """``sklearn.model_selection.cross_validate``, with all folds, members and ``estimators`` trained at once.

    Args:
        estimators: one, or several, e.g. with other learning rates; they are cloned.
        groups, cv, scoring: as in scikit-learn; ``groups`` are also passed to ``fit``.

    Returns:
        ``test_score`` (k,), ``estimator`` (k fitted ones), ``indices`` and ``fit_time`` (total) by name; a list of these for
        several estimators.
    """
    several = [estimators] if isinstance(estimators, NetworkRegressor) else list(estimators)
    inputs, outputs = np.asarray(X), np.asarray(y)
    labels = None if groups is None else np.asarray(groups)
    folds = list(check_cv(cv).split(inputs, outputs, labels))
    tasks: list[Task] = [
        (clone(one), inputs[fit], outputs[fit], None if labels is None else labels[fit]) for one in several for fit, _ in folds
    ]
    begin = time.perf_counter()
    fit_together(tasks)
    seconds = time.perf_counter() - begin
    found = []
    for number, one in enumerate(several):
        fitted = [task[0] for task in tasks[number * len(folds) : (number + 1) * len(folds)]]
        score = check_scoring(one, scoring)
        scores = [score(model, inputs[held], outputs[held]) for model, (_, held) in zip(fitted, folds, strict=True)]
        indices = {"train": [fit for fit, _ in folds], "test": [held for _, held in folds]}
        found.append({"test_score": np.array(scores), "estimator": fitted, "indices": indices, "fit_time": seconds})
    return found[0] if isinstance(estimators, NetworkRegressor) else found
