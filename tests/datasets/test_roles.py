"""Roles by the motion of every axis: what moves, what a role lacks, which assignment is used."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from axis_motion import RATE, machine, recording, table
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid.datasets import Dataset, Recording, ingest
from sysid.datasets.checks.roles import (
    NEEDED,
    ROLES,
    RoleNeeds,
    check_needs,
    lacks_of,
    levels,
    role_amounts,
    role_lacks,
    unmet_need,
)
from sysid.datasets.quality.motion import by_axis, motion_table
from sysid.datasets.quality.use import turning_points, turning_rows
from sysid.datasets.recipe import Splits
from sysid.datasets.split_suggestion import recipe_splits, suggest_split
from sysid.datasets.splits import split
from sysid.effects import CATALOGUE
from sysid.errors import ExcitationError
from sysid.machine import Machine

AXES = ("boom", "stick")
ALL = {"fit", "select", "held_out"}


@pytest.fixture(scope="module")
def lift(tmp_path_factory: pytest.TempPathFactory) -> Machine:
    return machine(AXES, tmp_path_factory.mktemp("lift"))


def lacking(parts: tuple[Recording, ...], roles: dict[str, str], about: Machine) -> set[tuple[str, str, str]]:
    """(axis, role, kind) of everything that a role lacks."""
    found = motion_table(parts, about)
    lacks = lacks_of(role_amounts(found, roles), found.axes, about)  # type: ignore[arg-type]
    return {(axis, role, lack.kind) for lack in lacks for axis in lack.axes for role in lack.roles}


def test_motion_is_counted_by_direction(lift: Machine) -> None:
    found = motion_table([recording("a", 20.0, AXES, ("boom",)), recording("b", 20.0, AXES, AXES)], lift)
    motion = by_axis(found.of(["a"]), found.axes)
    boom, stick = motion["boom"], motion["stick"]
    assert boom.forward_s == pytest.approx(8.0, abs=0.8), "four of ten seconds up, twice"
    assert boom.backward_s == pytest.approx(8.0, abs=0.8)
    assert (boom.small_forward_s, boom.large_forward_s) == pytest.approx((4.0, 4.0), abs=0.3)
    assert boom.reversals == 15, "seven in each period, and one between them"
    assert (stick.forward_s, stick.backward_s, stick.reversals) == (0.0, 0.0, 0.0), "noise is no motion"
    whole, parts = found.recordings["b"].amounts(), [found.recordings["b"].amounts(k, k + 250) for k in range(0, 1000, 250)]
    np.testing.assert_allclose(np.sum(parts, axis=0), whole)


def test_a_servo_that_is_pushed_does_not_move(tmp_path: Path) -> None:
    text = 'schema = 1\nname = "arm"\nrate_hz = 50.0\n' + "".join(
        f'[[axes]]\nname = "{axis}"\nactuation = "position"\ndrives = "joint"\n' for axis in ("driven", "pushed")
    )
    (tmp_path / "machine.toml").write_text(text)
    from sysid.machine import load_machine

    at = np.arange(1000) / RATE
    moving, sag = np.sin(at), 0.01 * np.sin(at)
    columns = {"time": at, "driven.command": moving, "driven.joint": moving, "pushed.command": 0.0 * at + 1.0}
    found = motion_table(
        [Recording("a", pd.DataFrame({**columns, "pushed.joint": 1.0 + sag}), RATE)], load_machine(tmp_path / "machine.toml")
    )
    motion = by_axis(found.of(["a"]), found.axes)
    assert motion["driven"].forward_s > 8.0
    assert motion["pushed"].forward_s == 0.0


def test_a_mass_that_swings_without_a_force_moves(tmp_path: Path) -> None:
    text = (
        'schema = 1\nname = "m"\nrate_hz = 50.0\n[[axes]]\nname = "arm"\nactuation = "force"\ndrives = "joint"\ninertia = 1.0\n'
    )
    (tmp_path / "machine.toml").write_text(text)
    from sysid.machine import load_machine

    at = np.arange(1000) / RATE
    pushed = np.where(at < 1.0, np.sin(2.0 * np.pi * at), 0.0)
    swing = Recording("a", pd.DataFrame({"time": at, "arm.command": pushed, "arm.joint": np.sin(at)}), RATE)
    found = motion_table([swing], load_machine(tmp_path / "machine.toml"))
    motion = by_axis(found.of(["a"]), found.axes)["arm"]
    assert motion.forward_s > 8.0
    assert motion.backward_s > 8.0


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60), st.floats(0.01, 1.0))
def test_reversals_are_those_of_the_quality_table(values: list[float], least: float) -> None:
    signal = np.cumsum(values)
    assert len(turning_rows(signal, least)) == turning_points(signal, least)


def test_an_axis_that_moves_in_some_recordings_only_moves_in_every_role(lift: Machine) -> None:
    """The order would give: fit a b c, selection d e, test f, and the stick no test at all."""
    runs = [recording(name, 30.0, AXES, AXES if name in "abc" else ("boom",), k) for k, name in enumerate("abcdef")]
    parts, by_order = split(runs, Splits(), "test")
    assert ("stick", "held_out", "motion") in lacking(parts, by_order, lift)
    parts, roles = split(runs, Splits(), "test", lift)
    assert [part.name for part in parts] == list("abcdef"), "no recording is cut"
    assert lacking(parts, roles, lift) == set()
    assert sorted(roles.values()) == sorted(by_order.values()), "about the same shares"


def test_one_recording_an_axis_is_cut(lift: Machine) -> None:
    axes = ("boom", "stick")
    runs = [
        recording("boom", 60.0, axes, ("boom",)),
        recording("stick", 60.0, axes, ("stick",)),
        recording("rest", 20.0, axes, ()),
    ]
    parts, roles = split(runs, Splits(), "test", lift)
    assert {name.partition("#")[0] for name in roles if "#" in name} >= {"boom", "stick"}
    assert lacking(parts, roles, lift) == set()


def test_an_axis_of_one_short_recording_is_at_least_fitted(lift: Machine) -> None:
    runs = [recording(name, 12.0, AXES, AXES if name == "c" else ("boom",), k) for k, name in enumerate("abc")]
    parts, roles = split(runs, Splits(), "test", lift)
    assert roles["c"] == "fit"
    dataset = Dataset.of(lift, parts, roles)
    (lack,) = role_lacks(dataset)
    assert lack.text == (
        "stick does not move in the selection and test recordings: an effect of stick cannot be compared or validated"
    )
    assert lack.record.startswith("Record stick moving over the range, 3 s or more in each direction, with 8 reversals, in two")
    assert not suggest_split(dataset).better


def test_without_a_shortage_the_order_stays(lift: Machine) -> None:
    runs = [recording(f"r{k}", 30.0, AXES, AXES, k) for k in range(6)]
    assert split(runs, Splits(), "test", lift)[1] == split(runs, Splits(), "test")[1]


def test_an_axis_that_never_moves_changes_nothing(lift: Machine) -> None:
    runs = [recording(f"r{k}", 30.0, AXES, ("boom",), k) for k in range(4)]
    parts, roles = split(runs, Splits(), "test", lift)
    assert roles == split(runs, Splits(), "test")[1]
    (lack,) = role_lacks(Dataset.of(lift, parts, roles))
    assert (lack.nowhere, lack.text) == (True, "stick moves in no recording: an effect of stick cannot be identified")


moving_sets = st.lists(st.sampled_from([(), ("boom",), ("stick",), AXES]), min_size=1, max_size=6)
lengths = st.sampled_from([5.0, 12.0, 20.0])


@settings(max_examples=40)
@given(moving_sets, st.data())
def test_properties_of_every_assignment(lift: Machine, sets: list[tuple[str, ...]], data: st.DataObject) -> None:
    runs = [recording(f"r{k}", data.draw(lengths), AXES, moving, k) for k, moving in enumerate(sets)]
    held = data.draw(st.sampled_from([(), ("r0",)]))
    splits = Splits(held_out=held)
    parts, roles = split(runs, splits, "test", lift)
    assert set(roles) == {part.name for part in parts}, "every recording has one role"
    assert all(roles[name] == "held_out" for name in held), "roles of the recipe stay"
    assert split(runs, splits, "test", lift)[1] == roles, "the same again"
    free = [r for r in runs if r.name not in held]
    if len(free) >= len(ALL - set(held and ("held_out",))):
        assert set(roles.values()) == ALL, "no role is empty"
    for part in parts:  # never by sample: each part is a contiguous piece of one recording
        whole = next(r for r in runs if r.name == part.name.partition("#")[0])
        first = round((part.start_ns - whole.start_ns) * 1e-9 * RATE)
        np.testing.assert_array_equal(part.values("boom.joint"), whole.values("boom.joint")[first : first + len(part)])

    def quality(named: list[Recording]) -> tuple[float, ...]:
        """Number of lacks by size, of whole recordings and blocks."""
        own, given_roles = split(named, Splits(), "test", lift)
        found = motion_table(own, lift)
        amounts = role_amounts(found, given_roles)
        needs = RoleNeeds.of(ROLES, motion_table(named, lift).of([r.name for r in named]))
        steps = levels(needs.shortages(amounts).max(axis=-1))
        return tuple(int(np.sum(steps == level)) for level in (3,))

    order = data.draw(st.permutations(range(len(runs))))
    renamed = [replace(runs[k], name=f"x{place}") for place, k in enumerate(order)]
    if all(len(r) < 15.0 * RATE for r in runs):  # cuts are counted at their nominal places, and made at rest nearby
        assert quality(renamed) == quality(runs), "names and their order do not matter"


def test_a_thousand_recordings_take_about_a_second(lift: Machine) -> None:
    """In name order, those with the stick come first: the order would give the test none."""
    base = {moving: table(6.0, AXES, moving) for moving in (AXES, ("boom",))}
    runs = [
        Recording(f"r{k:04}", own.assign(**{"boom.joint": own["boom.joint"] + 1e-9 * k}), RATE)  # no two are copies
        for k, own in enumerate(base[AXES if k < 400 else ("boom",)] for k in range(1000))
    ]
    begin = time.perf_counter()
    parts, roles = split(runs, Splits(), "test", lift)
    took = time.perf_counter() - begin
    assert lacking(parts, roles, lift) == set()
    assert took < 10.0, "about one second on an idle processor"
    counts = {role: sum(r == role for r in roles.values()) for role in ALL}
    assert counts["fit"] == pytest.approx(500, abs=75)
    assert min(counts.values()) > 175


def test_roles_need_what_the_catalogue_needs() -> None:
    needs = {effect.name: (effect.need.count, effect.need.least) for effect in CATALOGUE}
    assert needs["asymmetric_gain"] == ("motion_both_ways", NEEDED[0])
    assert needs["backlash"] == ("reversals", NEEDED[2])
    assert needs["valve_deadband"] == ("small_commands", NEEDED[3])
    assert needs["flow_saturation"] == ("motion", 2.0 * NEEDED[5])


def test_a_suggestion_keeps_what_the_recipe_names(lift: Machine) -> None:
    runs = [recording(name, 30.0, AXES, AXES if name in "ab" else ("boom",), k) for k, name in enumerate("abcdef")]
    present = dict(zip("abcdef", ("fit", "fit", "fit", "select", "select", "held_out"), strict=True))
    dataset = Dataset.of(lift, runs, present)  # type: ignore[arg-type]
    free = suggest_split(dataset)
    assert {lack.kind for lack in free.present.lacks} == {"motion"}
    assert free.better
    bound = suggest_split(dataset, [recipe_splits('[splits]\nheld_out = ["f"]\n', "recipe")])
    assert bound.named == ("f",)
    assert bound.suggested.roles["f"] == "held_out"
    assert {bound.suggested.roles[name] for name in "ab"} == {"fit", "select"}, "the stick moves in both open roles"


def test_a_suggestion_may_cut_recordings(lift: Machine) -> None:
    runs = [
        recording("boom", 40.0, AXES, ("boom",)),
        recording("stick", 40.0, AXES, ("stick",)),
        recording("x", 40.0, AXES, ()),
    ]
    dataset = Dataset.of(lift, runs, {"boom": "fit", "stick": "select", "x": "held_out"})
    found = suggest_split(dataset)
    assert {"boom", "stick"} <= set(found.cut)
    assert found.command("ws") == "", "stored tables are not cut"
    assert found.suggested.motion["held_out"]["stick"].forward_s > 1.5
    parts, roles = split(runs, recipe_splits(found.recipe, "recipe"), "recipe", lift)
    assert lacking(parts, roles, lift) == set(), "the lines do what the suggestion says"


def test_repeats_of_test_recordings_are_stated(lift: Machine) -> None:
    runs = [recording(name, 20.0, AXES, AXES, k) for k, name in enumerate("abc")]
    found = suggest_split(Dataset.of(lift, runs, {"a": "fit", "b": "select", "c": "held_out"}))
    assert found.repeats == (("c", "a"),)


@pytest.mark.parametrize(
    ("seconds", "roles", "found"),
    [
        ((3.0,), ("fit",), "3.0 s for fit, 0.0 s for selection, 0.0 s for test"),
        ((3.0, 3.0, 3.0), ("fit", "select", "held_out"), "3.0 s for fit, 3.0 s for selection, 3.0 s for test"),
        ((60.0, 60.0), ("fit", "select"), "0.0 s for test"),
    ],
)
def test_too_short_roles_are_refused(lift: Machine, seconds: tuple[float, ...], roles: tuple[str, ...], found: str) -> None:
    runs = [recording(f"r{k}", length, AXES, AXES, k) for k, length in enumerate(seconds)]
    given = {run.name: role for run, role in zip(runs, roles, strict=True)}
    with pytest.raises(ExcitationError) as refused:
        check_needs(Dataset.of(lift, runs, given))  # type: ignore[arg-type]
    assert found in refused.value.found
    assert refused.value.expected == "4 s of recorded motion or more in each role (fit, selection and test)"
    if seconds[0] == 60.0:
        assert "leave [splits] out" in refused.value.remedy
    else:
        assert refused.value.remedy.startswith("Record 15 s or more in one recording")


def test_the_advice_works(lift: Machine) -> None:
    for runs in ([recording("one", 15.0, AXES, AXES)], [recording(f"r{k}", 4.0, AXES, AXES, k) for k in range(3)]):
        parts, roles = split(runs, Splits(), "test", lift)
        assert unmet_need(Dataset.of(lift, parts, roles)) is None


def test_a_role_without_a_stage_is_refused(lift: Machine) -> None:
    runs = [recording(name, 10.0, AXES, AXES) for name in "abc"]
    blind = replace(runs[2], table=runs[2].table.drop(columns=["boom.joint", "stick.joint"]))
    roles = {"a": "fit", "b": "select", "c": "held_out"}
    need = unmet_need(Dataset.of(lift, [*runs[:2], blind], roles))  # type: ignore[arg-type]
    assert need is not None
    assert need.found == "no stage that is measured at both its ends in the test recordings"
    none = [replace(run, table=run.table[["time", "boom.command"]]) for run in runs]
    need = unmet_need(Dataset.of(lift, none, roles))  # type: ignore[arg-type]
    assert need is not None
    assert need.found == "no stage that is measured at both its ends"


@pytest.mark.parametrize(
    ("folder", "recipe", "by_order"),
    [
        ("bam_xl330", "xl330", "ffffffssshhh"),
        ("sage_so101/multisine", "so101", "fsfsh"),
        ("rc_excavator", "rc_excavator", None),
    ],
)
def test_measured_machines_keep_their_roles(
    shared_data: Path, datasets_folder: Path, tmp_path: Path, folder: str, recipe: str, by_order: str | None
) -> None:
    dataset = ingest(shared_data / folder, tmp_path, recipe=datasets_folder / recipe / "recipe.toml")
    if by_order is not None:
        assert "".join(role[0] for role in dataset.splits.values()) == by_order
    assert [lack.text for lack in role_lacks(dataset)] == []


def test_the_recordings_of_an_arm_as_one_dataset(shared_data: Path, datasets_folder: Path, tmp_path: Path) -> None:
    """In order, the one with two moving joints would be the only selection recording."""
    arm = ingest(shared_data / "sage_so101", tmp_path, recipe=datasets_folder / "so101/recipe.toml")
    assert role_lacks(arm) == ()
    by_order = {"friction_gravity": "fit", "single_joint_elbow": "select", "step_response": "held_out"}
    assert {name: arm.splits[name] for name in by_order} == by_order
    assert {arm.splits[name] for name in arm.splits if name.startswith("multisine#")} == ALL


def test_the_local_search_finds_nearly_every_optimum(monkeypatch: pytest.MonkeyPatch) -> None:
    """With few recordings, where all assignments can be compared; random motion, in about half of the recordings of an axis."""
    from sysid.datasets import split_assignment as assign

    rng = np.random.default_rng(0)
    same = 0
    for _ in range(60):
        count, axes = int(rng.integers(3, 7)), int(rng.integers(1, 4))
        motion = rng.exponential(3.0, (count, axes, 7)) * (rng.random((count, axes, 1)) < 0.5)
        amounts, seconds = np.zeros((count, 3, 3, axes, 7)), np.zeros((count, 3, 3))
        for k in range(3):
            amounts[:, k, k], seconds[:, k, k] = motion, rng.uniform(5.0, 60.0, count)
        needs = RoleNeeds.of(ROLES, motion.sum(axis=0))
        problem = assign.Assignment(needs, amounts, seconds, np.ones((count, 3), dtype=bool), np.zeros(3, dtype=bool), 4.0)
        present = rng.integers(0, 3, count)
        keys = []
        for limit in (8_000, 0.5):
            monkeypatch.setattr(assign, "EXHAUSTIVE", limit)
            best = problem.best(present)
            keys.append(problem.key(best, best)[:2])
        assert keys[0] <= keys[1]
        same += keys[0] == keys[1]
    assert same >= 54
