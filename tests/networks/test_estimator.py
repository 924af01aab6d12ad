"""scikit-learn's tools take the networks as they take its own, and all folds at once give what one after the other gives."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.model_selection import GridSearchCV, GroupKFold, KFold
from sklearn.model_selection import cross_validate as one_by_one
from sklearn.utils.estimator_checks import parametrize_with_checks

from sysid.errors import ExcitationError, SettingsError
from sysid.networks import EnsembleMember, train
from sysid.networks.estimator import NetworkRegressor, cross_validate, fit_together


def quick(**more: Any) -> NetworkRegressor:
    settings: dict[str, Any] = {"hidden": (16,), "epochs": 20, "learning_rate": 1e-2, "batch": 32, "threads": 1}
    return NetworkRegressor(**(settings | more))


def rows(count: int = 200) -> tuple[np.ndarray, np.ndarray]:
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (count, 2))
    return x, 1e3 + 5.0 * np.column_stack([np.sin(2 * x[:, 0]) + x[:, 1], x[:, 0] * x[:, 1]])


@parametrize_with_checks([quick()])
def test_it_keeps_scikit_learns_conventions(estimator: Any, check: Any) -> None:
    check(estimator)


def test_it_learns_and_says_how_sure_it_is() -> None:
    x, y = rows(400)
    model = quick(epochs=100, members=3, hidden=(24, 24)).fit(x[:300], y[:300])
    assert model.score(x[300:], y[300:]) > 0.98
    assert model.predict(x[300:]).shape == model.spread(x[300:]).shape == (100, 2)
    assert (model.spread(10.0 * x[300:]).mean(axis=0) > 3.0 * model.spread(x[300:]).mean(axis=0)).all()
    assert [curve.rows for curve in model.learning_curves_] == [(270, 30)] * 3
    flat = quick().fit(x, y[:, 0])
    assert flat.predict(x).shape == (400,)


@pytest.mark.parametrize("groups", [None, np.repeat(np.arange(10), 20)])
def test_all_folds_at_once_give_the_scores_of_one_after_the_other(groups: np.ndarray | None) -> None:
    x, y = rows()
    cv = KFold(3, shuffle=True, random_state=1) if groups is None else GroupKFold(3)
    estimator = quick(members=2)
    at_once = cross_validate(estimator, x, y, cv=cv, groups=groups)
    assert isinstance(at_once, dict)
    if groups is None:
        theirs = one_by_one(clone(estimator), x, y, cv=cv)["test_score"]
    else:
        folds = cv.split(x, y, groups)
        theirs = [clone(estimator).fit(x[fit], y[fit], groups[fit]).score(x[held], y[held]) for fit, held in folds]
    np.testing.assert_array_equal(at_once["test_score"], theirs)
    assert [len(held) for held in at_once["indices"]["test"]] == [len(held) for _, held in cv.split(x, y, groups)]
    assert not hasattr(estimator, "networks_")


def test_several_learning_rates_and_layers_are_trained_at_once() -> None:
    x, y = rows()
    several = [quick(), quick(learning_rate=1e-4), quick(hidden=(8, 8)), quick(epochs=5)]
    found = cross_validate(several, x, y, cv=2, scoring="neg_mean_squared_error")
    assert isinstance(found, list)
    scores = [one["test_score"].mean() for one in found]
    assert scores[0] > scores[1]
    assert [one["estimator"][0].hidden for one in found] == [(16,), (16,), (8, 8), (16,)]
    searched = GridSearchCV(quick(), {"learning_rate": [1e-2, 1e-4]}, cv=2, scoring="neg_mean_squared_error").fit(x, y)
    assert searched.best_params_ == {"learning_rate": 1e-2}
    np.testing.assert_allclose(searched.cv_results_["mean_test_score"], scores[:2], rtol=1e-12)


def test_groups_are_not_split_between_fit_and_early_stopping_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    x, y = rows()
    trained: list[EnsembleMember] = []

    def recorded(members: Sequence[EnsembleMember], *others: Any) -> Any:
        trained.extend(members)
        return train(members, *others)

    monkeypatch.setattr("sysid.networks.estimator.train", recorded)
    groups = np.repeat(np.arange(10), 20)
    quick(validation_fraction=0.3, epochs=1).fit(x, y, groups)
    (member,) = trained
    index = {tuple(row): group for row, group in zip(x, groups, strict=True)}
    fit, stop = ({index[tuple(row)] for row in part} for part in (member.inputs, member.validation_inputs))
    assert len(stop) == 3
    assert not fit & stop


def test_what_cannot_be_learned_is_refused() -> None:
    x, y = rows()
    with pytest.raises(ExcitationError, match=r"column 1 is constant"):
        quick().fit(x * [1.0, 0.0], y)
    with pytest.raises(SettingsError, match=r"training: epochs = 0"):
        fit_together([(quick(epochs=0), x, y, None)])
    with pytest.raises(SettingsError, match=r"estimator: members = 0; expected a positive number"):
        quick(members=0).fit(x, y)
    with pytest.raises(ValueError, match="NaN"):
        quick().fit(np.where(x > 0.9, np.nan, x), y)
