"""Models that are worth comparing: screening, forward steps, drops and swaps, on a stage that is a regression."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from regression_stage import candidate, likelihood, rows_of

from sysid.gap.candidates import Candidate
from sysid.gap.proposals import MAX_DISTANCE, MAX_EFFECTS, Proposals, screened

F, G, TWIN = candidate(0), candidate(1), candidate(2)


def proposals(theta: tuple[float, float, float], *offered: Candidate, seed: int = 0) -> Proposals:
    return Proposals(likelihood(rows_of(theta, seed=seed)), offered or (F, G))


def names(*candidates: Candidate) -> frozenset[str]:
    return frozenset(c.label for c in candidates)


def test_the_screened_gain_is_what_a_fit_gains() -> None:
    """The stage is linear in its parameters, so that the score test says exactly what the cost falls by."""
    search = proposals((0.6, -0.3, 0.0))
    table = search.likelihood
    empty = search.fit(())
    cost = table.costs(empty.theta[None], table.linear.alone)[0]
    for promise in screened(table, empty, (F, G)):
        theta = empty.theta.copy()
        theta[promise.candidate.unknowns[0].places[0]] = promise.start[0]
        assert cost - table.costs(theta[None], table.linear.alone)[0] == pytest.approx(promise.gain, rel=1e-3)
        fitted = search.fit([promise.candidate], promise.start[None])
        assert promise.start == pytest.approx(fitted.values, abs=0.01)


def test_the_screening_knows_what_a_model_explains_already() -> None:
    search = proposals((0.6, -0.3, 0.0), F, G, TWIN)
    model = search.fit([F], np.array([[0.5]]))
    gains = {p.candidate.label: p.gain for p in search.promises(model)}
    assert set(gains) == {G.label, TWIN.label}
    assert gains[G.label] > 100.0
    assert gains[TWIN.label] < 5.0, "nearly the same function as the one that is there"
    assert search.promises(model)[0].candidate is G


def test_forward_steps_find_what_is_there_and_nothing_else() -> None:
    search = proposals((0.6, -0.3, 0.0), F, G, TWIN)
    found = search.forward(search.fit(()))
    assert found.labels == names(F, G)
    assert found.values_of(F) == pytest.approx([0.6], abs=0.05)
    assert found.values_of(G) == pytest.approx([-0.3], abs=0.05)
    assert search.best is found


def test_forward_steps_end_at_nothing_where_nothing_is_there() -> None:
    for seed in range(3):
        search = proposals((0.0, 0.0, 0.0), F, G, TWIN, seed=seed)
        assert search.forward(search.fit(())).candidates == ()
        assert all(len(f.candidates) <= MAX_EFFECTS for f in search.fits.values())


def test_a_wrong_first_step_is_swapped() -> None:
    search = proposals((0.6, -0.3, 0.0), F, G, TWIN)
    search.fit([TWIN, G], np.array([[0.5, -0.3]]))
    search.around()
    assert search.best.labels == names(F, G)
    assert names(G) in search.fits, "each effect of the best is dropped"


def test_models_near_the_best_are_compared_and_the_one_without_effects_always() -> None:
    search = proposals((0.6, -0.3, 0.0), F, G, TWIN)
    search.forward(search.fit(()))
    search.around()
    found = search.near()
    assert found[0] is search.best
    assert [f.evidence for f in found[:-1]] == sorted((f.evidence for f in found[:-1]), reverse=True)
    assert found[-1].candidates == ()
    assert all(f.evidence > found[0].evidence - MAX_DISTANCE for f in found[:-1])


def test_a_smaller_model_starts_where_the_larger_one_ended() -> None:
    search = proposals((0.6, -0.3, 0.0))
    both = search.fit([G, F], np.array([[-0.2, 0.5]]))  # in another order than that of the labels
    assert both.values_of(G) == pytest.approx([-0.3], abs=0.05)
    smaller = search.without(both, G)
    assert smaller.labels == names(F)
    assert smaller is search.fits[names(F)]
    assert search.without(both, G) is smaller, "fitted once"


def test_a_better_start_replaces_a_fit_and_a_worse_one_does_not() -> None:
    search = proposals((0.6, 0.0, 0.0))
    first = search.fit([F], np.array([[0.55]]))
    again = search.fit([F], np.array([[-4.0]]))
    assert again.evidence >= first.evidence
    assert search.fits[names(F)] is again


def two_forms() -> tuple[Candidate, Candidate]:
    """An effect with one parameter, and in a richer form with a second one."""
    second = replace(F.form, parameters=(replace(F.form.parameters[0], name="other"), *F.form.parameters))
    effect = replace(F.effect, forms=(F.form, second))
    rich = replace(F, effect=effect, form=second, unknowns=(F.unknowns[0], G.unknowns[0]), starts=((-1.0, -1.0), (1.0, 1.0)))
    return replace(F, effect=effect), rich


def test_a_richer_form_is_offered_where_its_simpler_one_is_there() -> None:
    """And not beside it: an effect is in a model in one form."""
    simple, rich = two_forms()
    search = proposals((0.6, -0.3, 0.0), simple, rich)
    empty = search.fit(())
    assert [p.candidate for p in search.promises(empty)] == [simple]
    one = search.fit([simple], np.array([[0.5]]))
    assert [p.candidate for p in search.promises(one)] == [rich]
    assert search.forward(empty).labels == names(rich)


def test_a_simpler_form_is_compared_with_a_richer_one_that_is_not_needed() -> None:
    simple, rich = two_forms()
    search = proposals((0.6, 0.0, 0.0), simple, rich)
    search.fit([rich], np.array([[0.5, 0.0]]))
    search.around()
    assert search.best.labels == names(simple)
    assert search.best.values == pytest.approx([0.6], abs=0.05)
