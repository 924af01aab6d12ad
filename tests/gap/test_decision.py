"""The decision rule on models made by hand."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from compared_models import decided
from plant_data import arm, nominal, slide

from sysid.gap import thresholds
from sysid.gap.candidates import Candidate, candidates_at
from sysid.gap.comparison import difference, pays, simpler, survives
from sysid.gap.decision import FreeRun
from sysid.gap.likelihood.stage import ModelFit
from sysid.gap.reasons import Reason
from sysid.gap.thresholds import BLOCK_NATS

Array = npt.NDArray[np.float64]
PLANT = nominal(machine=arm())
SLIDE = nominal(machine=slide())
OFFERED = {
    c.label: c
    for c in (
        *candidates_at(PLANT, PLANT.vector(), "command", ("boom", "machine")),
        *candidates_at(SLIDE, SLIDE.vector(), "force", ("slide",)),
    )
}
BAND, LAG, DELAY, GAIN, CURVE = (
    OFFERED[f"{name}(boom)"] for name in ("valve_deadband", "first_order_lag", "input_delay", "gain_error", "gain_curve")
)
(PLAY,) = candidates_at(PLANT, PLANT.vector(), "joint", ("boom",))[:1]
BLOCKS = 20
#: An output that a unit of any parameter moves by so many noise floors.
RESPONSE = 1000.0


def model(
    *candidates: Candidate,
    worse: float | Array = 0.0,
    away: float = 0.1,
    deviation: float = 0.001,
    left: float = 1.0,
    evidence: float | None = None,
) -> ModelFit:
    """A model that predicts each block by ``worse`` nats worse than the best, with all values ``away`` from nominal."""
    unknowns = tuple(u for c in candidates for u in c.unknowns)
    k = len(unknowns)
    blocks = -np.broadcast_to(np.asarray(worse, dtype=float), (BLOCKS,))
    return ModelFit(
        candidates, unknowns, np.array([u.nominal + away for u in unknowns]), PLANT.vector(), deviation**2 * np.eye(k),
        np.zeros(k), float(blocks.sum()) - 0.01 * k if evidence is None else evidence, blocks, 1.0, np.full(k, RESPONSE), left,
    )  # fmt: skip


NOTHING = model(worse=4.0, left=10.0)
ALL = tuple(OFFERED)


def test_an_effect_without_which_nothing_predicts_as_well_is_named() -> None:
    found = decided([NOTHING, model(BAND), model(LAG, worse=3.0, left=3.0), model(BAND, LAG)], ALL)
    assert found.named == (BAND,)
    assert found.model.candidates == (BAND,)
    assert found.tied == ()
    assert found.acceptable == (found.model,)


def test_what_a_larger_survivor_holds_besides_is_a_near_miss() -> None:
    found = decided([NOTHING, model(BAND), model(BAND, LAG)], ALL)
    (near,) = found.near_misses
    assert near.candidate is LAG
    assert near.lacks == Reason.REPLACED
    assert near.values == pytest.approx([u.nominal + 0.1 for u in LAG.unknowns])


def test_nothing_is_named_where_nothing_is_left_to_explain() -> None:
    """However certain an effect is: what moves an output that is within a tenth of its noise floor does not matter."""
    found = decided([model(worse=4.0, left=1.1), model(BAND), model(LAG, worse=0.02)], ALL)
    assert found.named == ()
    assert found.tied == ()
    assert {n.candidate.label for n in found.near_misses} == {BAND.label, LAG.label}


def test_the_model_without_effects_alone_is_a_decision() -> None:
    found = decided([model()], ALL)
    assert (found.named, found.tied, found.near_misses) == ((), (), ())


def test_a_value_inside_the_region_of_practical_equivalence_is_no_name() -> None:
    half = float(np.sqrt(thresholds.TENTH**2 - 1.0)) / RESPONSE
    for away, named in ((0.9 * half, False), (1.2 * half, True)):
        found = decided([NOTHING, model(DELAY, away=away, deviation=0.01 * half)], ALL)
        assert (found.named == (DELAY,)) == named
        if not named:
            assert found.near_misses[0].lacks is Reason.UNCERTAIN


def test_no_effect_is_named_with_a_value_at_a_bound() -> None:
    """Each parameter of the catalogue, at each end of its range; where it is absent, or as the plant has it, it is no bound."""
    tried = 0
    for candidate in OFFERED.values():
        inside = np.array(candidate.starts[0]) + 1e-3
        for k, (unknown, absent) in enumerate(zip(candidate.unknowns, candidate.absent, strict=True)):
            for end in unknown.bounds:
                values = inside.copy()
                values[k] = end
                made = replace(model(candidate), values=values)
                found = decided([NOTHING, made], ALL)
                if end in (unknown.nominal, absent):
                    assert not any(near.lacks == Reason.AT_BOUND for near in found.near_misses)
                    continue
                tried += 1
                assert (found.named, found.tied) == ((), ()), f"{candidate.label}: {unknown.key} = {end}"
                assert [near.lacks for near in found.near_misses] == [Reason.AT_BOUND]
                values[k] = end - 0.01 * np.sign(end) * max(abs(end), 1e-3)
                clear = decided([NOTHING, replace(made, values=values)], ALL)
                assert not any(near.lacks == Reason.AT_BOUND for near in clear.near_misses)
    assert tried > 40


def test_an_interval_that_reaches_into_the_region_is_no_name() -> None:
    half = float(np.sqrt(thresholds.TENTH**2 - 1.0)) / RESPONSE
    sure, unsure = (decided([NOTHING, model(DELAY, away=3.0 * half, deviation=d * half)], ALL) for d in (0.9, 1.1))
    assert sure.named == (DELAY,)
    assert unsure.named == ()


def test_a_lag_that_exchanges_with_a_dead_time_takes_no_name_from_the_sag_of_a_servo() -> None:
    """A dead time and a lag fit fast errors; beside the sag alone neither reduces the error, which is worth its price."""
    remains = {
        (): 15.9,
        (BAND,): 2.9,
        (LAG,): 15.9,
        (DELAY,): 19.1,
        (BAND, LAG): 3.0,
        (BAND, DELAY): 11.2,
        (LAG, DELAY): 16.3,
        (BAND, LAG, DELAY): 4.5,
    }
    fits = {frozenset(c.label for c in some): model(*some, left=left, worse=0.1 * left) for some, left in remains.items()}

    def without(fit: ModelFit, candidate: Candidate) -> ModelFit:
        return fits[fit.labels - {candidate.label}]

    nothing, whole = fits[frozenset()], fits[frozenset({BAND.label, LAG.label, DELAY.label})]
    best = model(*whole.candidates, left=whole.left)
    found = decided([nothing, best], ALL, integrates=False, smaller=without, fewest=lambda fit: [fit])
    assert found.named == (BAND,)
    assert {near.candidate for near in found.near_misses} == {LAG, DELAY}


@pytest.mark.parametrize(("left", "needed", "taken"), [(1.5, 50.0, True), (2.4, 50.0, False), (1.5, 0.0, False)])
def test_what_the_discrepancy_replaces_in_the_likelihood_is_in_the_plant(left: float, needed: float, taken: bool) -> None:
    """More than a tenth less than 2.6 beside wrong formulas, by less than its price: adjusted without a name."""
    alone, both = model(BAND, left=2.6), model(BAND, LAG, left=left)
    fits = {f.labels: f for f in (NOTHING, alone, both, model(LAG, worse=4.0, left=9.0))}

    def without(fit: ModelFit, candidate: Candidate) -> ModelFit:
        return fits[fit.labels - {candidate.label}]

    found = decided(list(fits.values()), ALL, discrepancy_gain=lambda _: needed, integrates=False, smaller=without)
    assert found.model is (both if taken else alone)
    assert found.named == (BAND,)
    (near,) = found.near_misses
    assert (near.candidate, near.lacks) == (LAG, Reason.LITTLE if taken else Reason.REPLACED)


def test_the_region_grows_with_what_is_left_and_with_what_is_open_otherwise() -> None:
    half = float(np.sqrt(thresholds.TENTH**2 - 1.0)) / RESPONSE
    chosen = model(DELAY, away=2.0 * half, deviation=0.01 * half)
    assert decided([NOTHING, chosen], ALL).named == (DELAY,)
    left = ModelFit(**{**vars(chosen), "left": 3.0})
    assert decided([NOTHING, left], ALL).named == ()
    assert decided([NOTHING, chosen], ALL, {DELAY.key: 3.0 * half}).named == ()


def test_one_parameter_outside_the_region_is_enough() -> None:
    chosen = model(BAND)
    values = np.array([u.nominal for u in chosen.unknowns])
    values[-1] += 0.1
    assert decided([NOTHING, ModelFit(**{**vars(chosen), "values": values})], ALL).named == (BAND,)


# -- how many effects explain the output -----------------------------------------------------------------------------------


@pytest.mark.parametrize(("without", "named"), [(3.8, False), (4.1, True)])
def test_an_effect_has_to_divide_what_is_left_by_its_price(without: float, named: bool) -> None:
    """The variance above the noise floor by five: 4² − 1 = 5·(2² − 1)."""
    found = decided([model(worse=4.0, left=without), model(DELAY, away=0.5, left=2.0)], ALL)
    assert (found.named == (DELAY,)) == named
    if not named:
        assert found.near_misses[0].lacks == Reason.LITTLE


def test_effects_that_repair_what_the_first_one_leaves_have_no_name() -> None:
    """One takes 30 floors to 5; with three more, each of which takes a little, it is 2.5."""
    models = [model(worse=9.0, left=30.0), model(BAND, worse=4.0, left=5.0), model(BAND, LAG, worse=2.0, left=4.0)]
    found = decided([*models, model(BAND, LAG, DELAY, GAIN, left=2.5)], ALL)
    assert found.named == (BAND,)
    assert found.model.candidates == (BAND, LAG, DELAY, GAIN), "their values go into the plant all the same"
    assert {n.lacks for n in found.near_misses} == {Reason.LITTLE}


def test_two_effects_that_help_together_alone_are_both_named() -> None:
    one = [model(BAND, worse=3.0, left=18.0), model(GAIN, worse=3.0, left=19.0)]
    assert set(decided([model(worse=4.0, left=20.0), *one, model(BAND, GAIN)], ALL).named) == {BAND, GAIN}


def test_what_is_further_off_than_without_any_effect_explains_nothing() -> None:
    assert decided([model(worse=4.0, left=15.0), model(DELAY, away=0.5, left=20.0)], ALL).named == ()


@pytest.mark.parametrize(("least", "named"), [(2.1, (DELAY,)), (2.6, (DELAY,)), (2.7, (DELAY, LAG))])
def test_each_name_moves_the_output_by_what_remains_beside_the_others(least: float, named: tuple[Candidate, ...]) -> None:
    """The likeliest dead time alone is off by an error of timing, which the plant has not: it seems to leave 9 floors.

    Both leave 2, a variance of 3 above the floor: without the lag it has to be 6.
    """

    class Nearest(FreeRun):
        def left(self, model: ModelFit) -> float:
            return least if model.labels == {DELAY.label} else model.left

    alone, both = model(DELAY, worse=4.0, left=9.0), model(DELAY, LAG, left=2.0)
    models = [model(worse=4.0, left=30.0), alone, model(LAG, worse=4.0, left=20.0), both]
    assert decided(models, ALL, integrates=False, free=Nearest()).named == named


def test_where_errors_add_up_the_values_are_those_that_leave_least_of_the_output() -> None:
    """The likeliest ones may fit fast errors of a wrong formula."""
    models = [model(worse=9.0, left=30.0), model(BAND, away=0.5, left=20.0), model(LAG, worse=9.0, left=28.0)]
    nearest = model(BAND, away=0.3, left=2.0)

    class Nearest(FreeRun):
        def least_squares(self, model: ModelFit) -> ModelFit:
            return nearest if model.labels == nearest.labels else model

        def left(self, model: ModelFit) -> float:
            return self.least_squares(model).left

    found = decided(models, ALL, free=Nearest())
    assert found.named == (BAND,)
    assert found.model.values == pytest.approx(nearest.values)
    assert (found.model.left, found.model.evidence) == (2.0, models[1].evidence)


def test_two_forms_of_an_effect_are_one_hypothesis() -> None:
    """Whichever of them the recordings do not distinguish, the effect is in both; the likelier one has the values."""
    spool, seals = OFFERED["stiction(boom) [spool_breakaway, spool_release]"], OFFERED["stiction(boom)"]
    models = [NOTHING, model(spool, evidence=-1.0), replace(model(seals, evidence=-2.0), values=np.array([0.0, 0.0]))]
    found = decided(models, ALL, discrepancy_gain=right)
    assert (found.named, found.tied) == ((spool,), ())
    assert len(found.acceptable) == 1


# -- what else explains it -------------------------------------------------------------------------------------------------


class Compared(FreeRun):
    """By how many standard errors one effect leaves more than another; what each moves."""

    def __init__(self, further: float = 0.0, moved: dict[Candidate, float] | None = None) -> None:
        self.standard_errors, self.moves = further, moved or {}

    def excess(self, model: ModelFit, other: ModelFit) -> float:
        return self.standard_errors * (len(model.labels & {LAG.label}) - len(other.labels & {LAG.label}))

    def change(self, model: ModelFit, candidate: Candidate) -> float:
        return self.moves[candidate]


@pytest.mark.parametrize(("standard_errors", "named"), [(1.9, False), (2.1, True)])
def test_one_set_is_preferred_if_it_leaves_significantly_less(standard_errors: float, named: bool) -> None:
    """Where formulas are wrong, nine nats for the other one do not count."""
    models = [NOTHING, model(DELAY, evidence=-9.0), model(LAG, evidence=0.0)]
    found = decided(models, ALL, free=Compared(standard_errors))
    assert (found.named == (DELAY,)) == named
    assert bool(found.tied) != named


@pytest.mark.parametrize(
    ("nats", "needed", "standard_errors", "named"),
    [
        (11.0, 50.0, 1.9, True),
        (9.0, 4.0, 1.9, False),
        (11.0, 60.0, 1.9, False),
        (-80.0, 4.0, 1.9, False),
        (80.0, 4.0, 2.1, False),
    ],
)
def test_of_two_sets_that_the_run_does_not_separate_the_likelier_one_is_meant(
    nats: float, needed: float, standard_errors: float, named: bool
) -> None:
    """If very strong evidence of more than one block is for it, at the values with which each leaves least of the output.

    Less than a fifth of what the formulas lack may be due to what they lack.
    """

    def own_evidence(fit: ModelFit) -> float:
        assert fit.left == 2.0, "its likeliest values, which leave three floors, do not count"
        return nats if fit.labels == {LAG.label} else 0.0

    class Nearest(Compared):
        def least_squares(self, model: ModelFit) -> ModelFit:
            return ModelFit(**{**vars(model), "left": 2.0}) if model.candidates else model

        def left(self, model: ModelFit) -> float:
            return self.least_squares(model).left

    models = [model(worse=9.0, left=30.0), model(DELAY, left=3.0), model(LAG, left=3.0)]
    found = decided(models, ALL, own_evidence=own_evidence, free=Nearest(standard_errors), discrepancy_gain=lambda fit: needed)
    assert (found.named == (LAG,)) == named


def test_a_difference_that_formulas_could_make_is_none() -> None:
    """One effect leaves 2 floors, another 3.9: variances within a factor of five."""
    models = [model(worse=9.0, left=30.0), model(DELAY, evidence=0.0, left=2.0), model(LAG, evidence=-1.0, left=3.9)]
    assert decided(models, ALL).tied == ((DELAY, LAG),)
    further_off = ModelFit(**{**vars(models[2]), "left": 4.1})
    assert decided([*models[:2], further_off], ALL).named == (DELAY,)


def test_what_fits_at_the_edge_of_the_plausible_is_no_alternative() -> None:
    edge = model(LAG)
    values = np.array([u.bounds[1] for u in edge.unknowns])
    found = decided([NOTHING, model(DELAY), ModelFit(**{**vars(edge), "values": values})], ALL)
    assert found.named == (DELAY,)


def test_effects_in_each_other_s_place_tie() -> None:
    found = decided([NOTHING, model(DELAY), model(LAG, worse=0.02, left=1.05)], ALL)
    assert found.named == ()
    assert found.tied == ((DELAY, LAG),)
    assert len(found.acceptable) == 2
    assert found.near_misses[0].lacks == Reason.REPLACED


def test_what_two_alternatives_share_is_named_beside_their_tie() -> None:
    models = [NOTHING, model(BAND, DELAY), model(BAND, LAG, worse=0.02, left=1.05), model(BAND, worse=2.0, left=5.0)]
    found = decided(models, ALL)
    assert found.named == (BAND,)
    assert found.tied == ((DELAY, LAG),)


@pytest.mark.parametrize(("moves", "named"), [(9.9, False), (10.1, True)])
def test_what_may_repair_the_formula_of_an_effect_that_it_looks_like_has_no_name(moves: float, named: bool) -> None:
    """The one that moves more is named; a band and a gain are not confused."""
    models = [model(worse=9.0, left=30.0), model(LAG, DELAY)]
    found = decided(models, ALL, free=Compared(moved={LAG: 10.0, DELAY: moves}))
    assert (DELAY in found.named) == named
    assert (LAG in found.named) != named
    assert found.near_misses[0].lacks == Reason.REPAIRS
    apart = decided([models[0], model(BAND, GAIN)], ALL, free=Compared(moved={BAND: 10.0, GAIN: moves}))
    assert set(apart.named) == {BAND, GAIN}


# -- where formulas are right, and where nothing adds up ---------------------------------------------------------------------


def right(model: ModelFit) -> float:
    """No discrepancy is needed."""
    return 0.0


def test_where_formulas_are_right_the_likelihood_decides() -> None:
    """A disturbance leaves 8 floors whatever is named; 60 nats are for one effect."""
    models = [model(worse=4.0, left=9.0), model(DELAY, left=8.0), model(LAG, worse=3.0, left=8.0)]
    assert decided(models, ALL, discrepancy_gain=right).named == (DELAY,)
    assert decided(models, ALL).named == (), "9 floors are not divided by the price"


def test_the_discrepancy_is_learned_beside_each_alone() -> None:
    """The model without the effect predicts every block as well; shared variances favour the one they were learned with."""
    without, whole = model(worse=0.001, evidence=-80.0, left=10.0), model(BAND, evidence=0.0)
    for own, named in ((-5.0, True), (-2.0, False)):
        found = decided(
            [without, whole], ALL, discrepancy_gain=right, own_evidence=lambda f, own=own: own if not f.candidates else 0.0
        )  # type: ignore[misc]
        assert (found.named == (BAND,)) == named, own


@pytest.mark.parametrize(("could", "named"), [(0.1, False), (0.02, True)])
def test_what_the_discrepancy_could_do_in_its_place_is_in_the_interval(could: float, named: bool) -> None:
    """Its value is 0.1 away from its absence, sure to 0.001 were there no discrepancy that does the same."""
    chosen = model(BAND)
    confounded = ModelFit(**{**vars(chosen), "confounded": np.full(len(chosen.unknowns), could)})
    found = decided([NOTHING, confounded], ALL, integrates=False)
    assert (found.named == (BAND,)) == named
    if not named:
        assert found.near_misses[0].lacks is Reason.UNCERTAIN


@pytest.mark.parametrize(("without", "named"), [(4.0, False), (4.4, True)])
def test_where_nothing_adds_up_effects_are_worth_the_price_of_one(without: float, named: bool) -> None:
    """They leave twice the floor, 2² − 1 above it; without them five times that is left, or less: 4² = 1 + 5·3."""
    nothing = model(worse=4.0, left=without - 0.05)
    found = decided([nothing, model(BAND, left=2.0)], ALL, integrates=False)
    assert (found.named == (BAND,)) == named
    if not named:
        assert found.near_misses[0].lacks == Reason.LITTLE


def test_without_what_is_certain_the_others_leave_more_than_a_tenth_more() -> None:
    """A play takes 11 floors down to 2; a scale and an offset of its sensors, to 1.8, repair the form of the play."""
    one, two = model(BAND, LAG, worse=0.02, evidence=-20.0, left=1.92), model(BAND, GAIN, worse=0.02, evidence=-20.0, left=1.95)
    rest = model(LAG, GAIN, worse=4.0, left=10.0)
    found = decided([model(worse=4.0, left=11.0), one, two, rest, model(BAND, LAG, GAIN, left=1.8)], ALL, integrates=False)
    assert found.named == (BAND,)
    assert {n.lacks for n in found.near_misses} == {Reason.LITTLE}


@pytest.mark.parametrize(("without", "named"), [(22.0, ()), (23.1, (LAG,))])
def test_the_set_that_is_preferred_is_worth_its_price_as_well(without: float, named: tuple[Candidate, ...]) -> None:
    """A dead time is worth it, and the lag is far likelier with ten floors left: 23² is five times 10²."""
    models = [model(worse=9.0, left=without), model(DELAY, left=6.0, evidence=0.0), model(LAG, left=10.3, evidence=90.0)]
    assert decided(models, ALL, discrepancy_gain=lambda fit: 100.0).named == named


@pytest.mark.parametrize(
    ("before", "after", "paid"), [(30.0, 13.3, True), (30.0, 13.6, False), (1.3, 1.1, True), (8.3, 5.8, False)]
)
def test_what_is_named_is_worth_its_price_on_held_out_recordings(before: float, after: float, paid: bool) -> None:
    """A fifth of the variance above the floor may stay; what is explained needs no price."""
    assert pays(before, after) == paid


def test_names_that_are_not_worth_their_price_become_near_misses() -> None:
    found = decided([NOTHING, model(BAND), model(BAND, LAG)], ALL).without_names({BAND.label: "something"})
    assert found.named == ()
    assert found.model.candidates == (BAND,)
    assert found.near_misses[0].lacks == "something"
    assert [n.candidate for n in found.near_misses].count(BAND) == 1


def test_what_the_recordings_do_not_excite_is_not_named() -> None:
    shown = tuple(label for label in ALL if label != BAND.label)
    alone = decided([NOTHING, model(BAND)], shown)
    assert alone.named == ()
    assert alone.model.candidates == (BAND,)
    assert alone.near_misses[0].lacks == Reason.NOT_EXCITED


def test_it_still_keeps_others_from_their_name() -> None:
    """A cause that the recordings cannot show well enough may be the reason: no name for what stands in its place."""
    shown = tuple(label for label in ALL if label != BAND.label)
    for better, worse in ((model(LAG), model(BAND, worse=0.02)), (model(BAND), model(LAG, worse=0.02))):
        found = decided([NOTHING, better, worse], shown)
        assert found.named == ()
        assert found.tied == ((LAG, BAND),), "the excited effect comes first, whichever model has more evidence"


def test_a_richer_form_is_no_other_effect() -> None:
    simple, rich = OFFERED["coulomb_friction(slide)"], OFFERED["coulomb_friction(slide) [positive, negative]"]
    found = decided([NOTHING, model(simple, worse=0.02), model(rich)], ALL)
    assert found.named == (simple,)
    assert found.near_misses == ()


def test_a_block_counts_for_a_few_nats_at_most() -> None:
    blocks = np.zeros(BLOCKS)
    blocks[4] = 1600.0
    total, error = difference(model(), model(worse=blocks))
    assert total == BLOCK_NATS
    assert error == pytest.approx(BLOCK_NATS * np.sqrt(1.0 - 1.0 / BLOCKS))
    assert survives(model(worse=blocks), model()), "one block alone proves nothing"
    assert not survives(model(worse=np.where(np.arange(BLOCKS) < 6, 1600.0, 0.0)), model()), "several that agree do"
    assert difference(model(worse=blocks), model()) == (-total, error)


def test_three_nats_are_no_difference_however_regular() -> None:
    assert survives(model(worse=2.9 / BLOCKS), model())
    assert not survives(model(worse=3.1 / BLOCKS), model())


def test_a_sum_has_to_exceed_two_standard_errors() -> None:
    swings = np.where(np.arange(BLOCKS) % 2 == 0, 2.0, -2.0)  # standard error 2·√20 = 8.9
    assert survives(model(worse=swings + 0.85), model())
    assert not survives(model(worse=swings + 0.95), model())


def test_a_loser_loses_by_its_evidence_as_well() -> None:
    """Of many models one predicts better by chance; evidence knows what its parameters cost."""
    worse = model(BAND, worse=3.0)
    assert not survives(worse, model(BAND, LAG))
    for lost, stays in ((2.9, True), (3.1, False)):
        likely = ModelFit(**{**vars(worse), "evidence": model(BAND, LAG).evidence - lost})
        assert survives(likely, model(BAND, LAG)) == stays


def test_a_model_is_simpler_than_one_that_holds_its_effects() -> None:
    assert simpler(NOTHING, model(BAND))
    assert simpler(model(BAND), model(LAG, BAND))
    assert not simpler(model(LAG, BAND), model(BAND))
    assert not simpler(model(BAND), model(BAND))
    assert not simpler(model(BAND), model(LAG))
    assert not simpler(model(BAND), model(LAG, GAIN))


def test_a_form_with_fewer_numbers_is_simpler() -> None:
    simple, rich = OFFERED["coulomb_friction(slide)"], OFFERED["coulomb_friction(slide) [positive, negative]"]
    assert simpler(model(simple), model(rich))
    assert not simpler(model(rich), model(simple))
    assert simpler(model(simple), model(rich, OFFERED["load_bias(slide)"]))


def test_what_an_effect_generalises_is_simpler() -> None:
    general = OFFERED["stribeck_friction(slide)"]
    special = OFFERED["coulomb_friction(slide)"]
    assert general.contains(special)
    assert simpler(model(special), model(general))


def test_the_rule_has_six_numbers_and_the_page_lists_them() -> None:
    page = (Path(__file__).parents[2] / "docs" / "decisions" / "decision-rule.md").read_text("utf-8")
    table = re.findall(r"^\| `(\w+)` \| ([\d.]+)\s*(%?)", page, re.MULTILINE)
    said = {name: float(value) / (100.0 if percent else 1.0) for name, value, percent in table}
    numbers = {
        name: value
        for name, value in vars(thresholds).items()
        if name.isupper() and isinstance(value, float) and name not in ("Z", "PRICE")
    }
    assert said == numbers
    assert len(numbers) == 6
    assert thresholds.PRICE == 1.0 + thresholds.STANDARD_ERRORS**2
    assert pytest.approx(1.959964, abs=1e-6) == thresholds.Z
