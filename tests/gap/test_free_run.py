"""Sets of effects by what they leave of the free run, on a stage that is a regression."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from regression_stage import NOISE, SIGNAL, Array, candidate, problem, recordings, rows_of

from sysid.effects import effect_named
from sysid.gap.candidates import Candidate, Unknown
from sysid.gap.comparison import pays
from sysid.gap.free_run import LeastSquares, free_run_of
from sysid.gap.likelihood.discrepancy import timing_alone
from sysid.gap.likelihood.rows import StageRows
from sysid.gap.likelihood.stage import ModelFit, fit_model

F, G, TWIN = candidate(0), candidate(1), candidate(2)
ALL = [c.label for c in (F, G, TWIN)]


def fitted(theta: tuple[float, float, float], *offered: Candidate) -> LeastSquares:
    rows = rows_of(theta, seed=0)
    return free_run_of(rows, timing_alone(rows, 0.0), offered or (F, G, TWIN))


def with_value(free: LeastSquares, effect: Candidate, value: float) -> ModelFit:
    """The model of one effect with a value that is not the best."""
    return fit_model(free.proposals.likelihood, [effect], np.array([[value]]), rounds=0)


def test_every_candidate_is_tried_alone_and_the_best_together() -> None:
    sets = fitted((0.6, -0.3, 0.0)).sets(ALL)
    assert next(f.labels for f in sets if len(f.candidates) == 1) == {F.label}
    assert {f.labels for f in sets if len(f.candidates) < 2} == {frozenset(), *(frozenset({c.label}) for c in (F, G, TWIN))}
    (best, *others) = (f for f in sets if len(f.candidates) == 2)
    assert best.labels == {F.label, G.label}
    assert best.left == pytest.approx(1.0, abs=0.1)
    assert best.values == pytest.approx([0.6, -0.3], abs=0.03)
    assert all(f.left >= best.left for f in others)
    assert max(len(f.candidates) for f in sets) == 2, "nothing is left to explain"


def test_nothing_is_added_where_nothing_is_left() -> None:
    assert all(len(f.candidates) < 2 for f in fitted((0.0, 0.0, 0.0)).sets(ALL))


def test_what_is_not_excited_competes_all_the_same() -> None:
    twins = fitted((0.6, 0.0, 0.0), F, TWIN)
    assert {f.labels for f in twins.smallest([TWIN.label])} == {frozenset({F.label}), frozenset({TWIN.label})}
    both = fitted((0.6, -0.3, 0.0), F, G)
    assert [f.labels for f in both.smallest([F.label])] == [{F.label, G.label}]


def test_what_is_left_is_that_of_the_better_values() -> None:
    free = fitted((0.6, 0.0, 0.0))
    far = with_value(free, F, 0.1)
    assert far.left > 3.0
    assert free.left(far) == pytest.approx(1.0, abs=0.1)
    assert free.nearest(far).values == pytest.approx([0.6], abs=0.03)


def test_least_squares_that_stopped_elsewhere_are_fitted_again_from_better_values() -> None:
    """A limit that no command reaches has no slope; the likelihood may have found the limit."""
    free = fitted((0.6, 0.0, 0.0))
    best = free.least_squares(with_value(free, F, 0.5))
    free.proposals.fits[best.labels] = with_value(free, F, 0.1)
    assert free.least_squares(best).values == pytest.approx(best.values, abs=1e-3)
    assert free.proposals.fits[best.labels].left == pytest.approx(best.left, rel=1e-3)


def test_a_set_is_extended_by_the_effect_that_leaves_least() -> None:
    free = fitted((0.6, -0.3, 0.0))
    one = next(f for f in free.sets(ALL) if f.labels == {F.label})
    extended = free.extended(one)
    assert extended is not None
    assert extended.labels == {F.label, G.label}
    assert free.extended(extended) is None, "nothing is left"


def test_one_set_leaves_more_than_another_by_standard_errors_of_the_blocks() -> None:
    free = fitted((0.6, -0.3, 0.0))
    none, one, both = (
        free.proposals.fit(()),
        free.proposals.warm([F], free.sets(ALL)[1]),
        free.proposals.warm([F, G], free.sets(ALL)[1]),
    )
    assert free.excess(none, both) > 4.0
    assert free.excess(both, none) == pytest.approx(-free.excess(none, both))
    assert free.excess(one, one) == 0.0
    assert free.change(both, G) == pytest.approx(np.sqrt(one.left**2 - both.left**2))


def test_the_error_of_neighbouring_blocks_counts_together() -> None:
    """The same difference in every fourth block is seen better than in a run of them, which may be one accident."""
    free = fitted((0.0, 0.0, 0.0))
    blocks = free.proposals.likelihood.rows.blocks
    spread, together = np.zeros(blocks), np.zeros(blocks)
    spread[::4], together[:4] = 1.0, 1.0
    assert spread.sum() == together.sum()
    assert free.standard_errors(spread) > 1.3 * free.standard_errors(together)


def test_an_effect_pays_where_it_acts() -> None:
    """F is zero in half of the recordings, where the formulas lack something else: what remains there is not its price."""
    found = []
    for k, take in enumerate(recordings((0.6, 0.0, 0.0))):
        table, acts = take.table.copy(), k < 2
        lacking = 0.2 * np.sin(0.11 * table["time"])
        table["clock"] = table["clock"] if acts else 0.0
        table[SIGNAL] = (table[SIGNAL] if acts else NOISE * np.random.default_rng(k).standard_normal(len(table))) + lacking
        found.append(replace(take, table=table))
    rows = StageRows(problem(), found, np.zeros(3), np.array([NOISE]))
    free = free_run_of(rows, timing_alone(rows, 0.0), (F, G, TWIN))
    one, nothing = free.proposals.fit((F,)), free.proposals.fit(())
    assert not pays(nothing.left, free.left(one))
    assert pays(nothing.left, free.left_where_acting(one))
    assert free.left_where_acting(nothing) == pytest.approx(free.left(nothing))


#: Three effects, and three that stand for two of them each.
SIX = ("sensor_bias", "sensor_scale", "joint_offset", "gain_error", "input_delay", "gain_curve")
MIXED = ((0, 1), (1, 2), (2, 0))


def six(time: Array) -> Array:
    """Sines f₀ to f₂, and (f₀ + f₁)/2 with a little of another sine, and so on, (n, 6)."""
    plain = np.sin(np.outer(time, [0.9, 1.7, 2.6]))
    mixed = [0.5 * (plain[:, i] + plain[:, k]) + 0.4 * np.sin((3.4 + 0.7 * i) * time) for i, k in MIXED]
    return np.column_stack([plain, *mixed])


def test_three_effects_are_found_behind_pairs_that_stand_for_them() -> None:
    """No two of the three are among the best pairs, each of which has one of the three and the mixture of the others."""
    stage = replace(problem(), predict=lambda thetas, recording: (six(recording.values("clock")) @ thetas.T).T[:, :, None])
    rows = StageRows(stage, recordings([1.0, 1.0, 1.0, 0.0, 0.0, 0.0], functions=six), np.zeros(6), np.array([NOISE]))
    effects = [effect_named(name) for name in SIX]
    offered = [
        Candidate(effect, effect.forms[0], SIGNAL, None, (Unknown("value", (k,), (-5.0, 5.0), 0.0, 0.01),), ((-1.0,), (1.0,)))
        for k, effect in enumerate(effects)
    ]
    sets = free_run_of(rows, timing_alone(rows, 0.0), offered).sets([c.label for c in offered])
    pairs = [f for f in sets if len(f.candidates) == 2]
    assert all(len({c.effect.name for c in f.candidates} & set(SIX[:3])) == 1 for f in pairs[:3])
    best = next(f for f in sets if len(f.candidates) == 3)
    assert {c.effect.name for c in best.candidates} == set(SIX[:3])
    assert best.left == pytest.approx(1.0, abs=0.1)
