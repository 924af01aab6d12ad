"""The engine by scikit-learn's conventions: an estimator for its tools, and a cross-validation that trains all folds at once.

``cross_validate`` of scikit-learn fits one fold after the other; :func:`cross_validate` here puts all folds and members into
one training and returns the same scores, since a member's result does not depend on what it is trained beside.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any, Literal, Self

import numpy as np
import numpy.typing as npt
from sklearn.base import BaseEstimator, RegressorMixin, clone
from sklearn.metrics import check_scoring
from sklearn.model_selection import GroupShuffleSplit, ShuffleSplit, check_cv
from sklearn.utils.validation import check_is_fitted, validate_data

from sysid.errors import SettingsError
from sysid.networks.member import EnsembleMember, LearningCurve, TrainingSettings
from sysid.networks.mlp import Mlp, Rectifier
from sysid.networks.training import train

Array = npt.NDArray[np.float64]


class NetworkRegressor(RegressorMixin, BaseEstimator):  # type: ignore[misc]
    """The mean of ``members`` perceptrons with normalisation inside and early stopping.

    Args:
        hidden: units of the hidden layers.
        members: networks with different initial weights and orders of rows.
        learning_rate, batch, epochs, patience, check_every, schedule, threads, device: as in :class:`TrainingSettings`.
        validation_fraction: share of the rows that stop the training; whole groups where ``fit`` is given ``groups``.
        random_state: seed of the split, the weights and the orders.
        rectifier: between the layers, ``relu`` or ``smooth``.

    Attributes:
        networks_: one :class:`Mlp` a member. ``courses_``: how the training of each went.
    """

    def __init__(
        self,
        hidden: Sequence[int] = (64, 64),
        *,
        members: int = 1,
        learning_rate: float = 1e-3,
        batch: int = 64,
        epochs: int = 500,
        patience: int = 100,
        check_every: int = 5,
        schedule: Literal["constant", "cosine"] = "cosine",
        validation_fraction: float = 0.1,
        random_state: int = 0,
        threads: int = 0,
        device: Literal["auto", "cpu", "cuda"] = "auto",
        rectifier: Rectifier = "relu",
    ) -> None:
        self.hidden = hidden
        self.members = members
        self.learning_rate = learning_rate
        self.batch = batch
        self.epochs = epochs
        self.patience = patience
        self.check_every = check_every
        self.schedule = schedule
        self.validation_fraction = validation_fraction
        self.random_state = random_state
        self.threads = threads
        self.device = device
        self.rectifier = rectifier

    def fit(self, X: npt.ArrayLike, y: npt.ArrayLike, groups: npt.ArrayLike | None = None) -> Self:
        """Learn ``y`` (n,) or (n, d_out) from ``X`` (n, d_in), both in SI units.

        Args:
            groups: (n,), e.g. recordings: none of them is split between rows that teach and rows that stop.

        Raises:
            ValueError: rows that scikit-learn's estimators do not take either (NaN, no rows, unequal lengths).
            SysidError: what :func:`sysid.networks.train` refuses: a constant column, a setting, a training that diverges.
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
        return TrainingSettings(
            learning_rate=self.learning_rate,
            batch=self.batch,
            epochs=self.epochs,
            patience=self.patience,
            check_every=self.check_every,
            schedule=self.schedule,
            threads=self.threads,
            device=self.device,
        )

    def _members(self, X: npt.ArrayLike, y: npt.ArrayLike, groups: npt.ArrayLike | None) -> list[EnsembleMember]:
        """The rows of each member, checked by scikit-learn's own rules."""
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

    def _take(self, networks: tuple[Mlp, ...], courses: tuple[LearningCurve, ...]) -> None:
        self.networks_, self.courses_ = networks, courses


#: An estimator, the rows it learns, and their groups.
Task = tuple[NetworkRegressor, npt.ArrayLike, npt.ArrayLike, npt.ArrayLike | None]


def fit_together(tasks: Sequence[Task]) -> None:
    """Fit every estimator on its rows, those of equal settings in one training; learning rates and layers may differ.

    The result of each is that of its own ``fit``.
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
            estimator._take(tuple(one.mlp for one in results), tuple(one.course for one in results))


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
        groups, cv, scoring: as there; ``groups`` also go to ``fit``.

    Returns:
        ``test_score`` (k,), ``estimator`` (k fitted ones), ``indices`` and ``fit_time`` (of all of it) by name; a list of
        these for a list of estimators.
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
