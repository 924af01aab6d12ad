"""The calibration evaluates rightly: cases are what their list says, truth stays apart, figures are counted well."""

from __future__ import annotations

import importlib
import json
import math
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from sysid.effects import CATALOGUE

PIPELINES = str(Path(__file__).parents[2] / "pipelines")
MODULES = ("cases", "evaluate", "kinds", "limits", "machines", "make", "page", "runner", "score", "seed")
#: Of the lists in these tests; every other one has the same balance.
SEED = 11


@pytest.fixture(scope="module")
def hidden() -> Iterator[dict[str, ModuleType]]:
    """The modules of pipelines/hidden, found as the pipeline finds them."""
    sys.path.insert(0, PIPELINES)
    try:
        yield {name: importlib.import_module(f"hidden.{name}") for name in MODULES}
    finally:
        sys.path.remove(PIPELINES)


@pytest.fixture(scope="module")
def pipeline() -> ModuleType:
    """pipelines/hidden_effects.py itself."""
    sys.path.insert(0, PIPELINES)
    try:
        return importlib.import_module("hidden_effects")
    finally:
        sys.path.remove(PIPELINES)


# ---- The list -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, SEED, 0xFFFFFFFF])
def test_full_tier_holds_what_was_asked_for(hidden: dict[str, ModuleType], seed: int) -> None:
    cases = hidden["cases"].cases_of("full", seed)
    assert len({case.name for case in cases}) == len(cases)
    groups = Counter(case.group for case in cases)
    assert groups["none"] >= 300
    assert groups["single"] >= 200
    assert (groups["double"], groups["triple"], groups["unknown"]) == (60, 40, 40)
    by_key = hidden["kinds"].BY_KEY
    due: Counter[str] = Counter()
    for case in cases:
        assert len(case.hidden) == {"none": 0, "single": 1, "double": 2, "triple": 3, "unknown": 1}[case.group]
        assert all(by_key[each.kind].family == case.family for each in case.hidden)
        assert all(case.variant in by_key[each.kind].variants for each in case.hidden)
        if case.group == "single" and case.hidden[0].factor >= 3.0:
            due[by_key[case.hidden[0].kind].named[0][0]] += 1
    # Offset and skew of a clock are found at ingest: they are no gap any more. pipelines/electric_arms.py has the others.
    elsewhere = {effect.name for effect in CATALOGUE if effect.of_links or effect.described_only}
    elsewhere |= {"clock_offset", "clock_skew", "smooth_coulomb_friction", "flexible_drive", "second_order_lag"}
    # tests/gap/test_force_constant.py and test_servo_controllers.py: the bench's drives have the force that is commanded.
    elsewhere |= {"force_constant_error", *(effect.name for effect in CATALOGUE if effect.actuations == ("servo",))}
    assert set(due) == {effect.name for effect in CATALOGUE} - elsewhere
    assert min(due.values()) >= 5
    for group in ("none", "single"):
        some = [case for case in cases if case.group == group]
        assert {case.excitation for case in some} >= {"rich", "poor", "flight"}
        assert {case.disturbance for case in some} == {0.0, 0.001, 0.003, 0.01}
        assert {case.family for case in some} == {"valve_crane", "hydraulic_crane", "servo_arm", "slide"}


def test_tiers_share_their_cases_and_are_the_same_every_time(hidden: dict[str, ModuleType]) -> None:
    cases = hidden["cases"]
    full = {case.name: case for case in cases.cases_of("full", SEED)}
    assert all(full[case.name] == case for tier in ("smoke", "quick") for case in cases.cases_of(tier, SEED))
    assert len(cases.cases_of("smoke", SEED)) <= 12
    assert cases.CaseSpec.from_json(json.loads(json.dumps(full["triple-003"].to_json()))) == full["triple-003"]
    assert [case.group for case in cases.cases_of("quick", SEED, "double")] == ["double"] * 6


def test_another_seed_is_another_list_of_the_same_balance(hidden: dict[str, ModuleType]) -> None:
    """Nobody can tell the next seed's cases from this one's; the counts of the groups and of the effects stay."""
    cases, by_key = hidden["cases"], hidden["kinds"].BY_KEY
    lists = [cases.cases_of("full", seed) for seed in (SEED, SEED + 1)]
    assert [case.name for case in lists[0]] == [case.name for case in lists[1]]
    assert not any(one == other for one, other in zip(*lists, strict=True))
    assert sum(one.hidden == other.hidden for one, other in zip(*lists, strict=True) if one.hidden) < 36, "of 360"
    counts = [
        sorted(Counter(by_key[each.hidden[0].kind].named[0][0] for each in found if each.group == "single").values())
        for found in lists
    ]
    assert counts[0] == counts[1]


def test_seed_is_that_of_a_clean_commit_or_a_number(hidden: dict[str, ModuleType], tmp_path: Path) -> None:
    seed = hidden["seed"]

    def git(*arguments: str) -> str:
        who = ("-c", "user.name=a", "-c", "user.email=a@b.c", "-c", "commit.gpgsign=false")
        return subprocess.run(["git", "-C", tmp_path, *who, *arguments], check=True, capture_output=True, text=True).stdout

    git("init", "-q")
    (tmp_path / "search.py").write_text("a = 1\n")
    git("add", ".")
    git("commit", "-q", "-m", "one")
    head = git("rev-parse", "HEAD").strip()
    found = seed.seed_of("commit", tmp_path)
    assert (found.value, found.commit, found.published) == (int(head[:8], 16), head, True)
    result = tmp_path / "reports" / "hidden_effects" / "result.json"
    result.parent.mkdir(parents=True)
    result.write_text('{"seed": 5}')
    assert seed.seed_of("commit", tmp_path) == found, "result files are no change"
    (tmp_path / "search.py").write_text("a = 2\n")
    with pytest.raises(ValueError, match=r"differs from its commit in search\.py"):
        seed.seed_of("commit", tmp_path)
    given = seed.seed_of("5", tmp_path)
    assert (given.value, given.published) == (5, False)
    with pytest.raises(ValueError, match="'five' is no seed"):
        seed.seed_of("five", tmp_path)
    git("commit", "-q", "-a", "-m", "two")
    with pytest.raises(ValueError, match=f"HEAD is not {head}"):
        seed.check_unchanged(found, tmp_path)
    seed.check_same_seed(given, result)
    with pytest.raises(ValueError, match=f"seed 5; expected {found.value}"):
        seed.check_same_seed(found, result)
    seed.check_same_seed(found, tmp_path / "none.json")


def test_every_kind_changes_its_machine_and_is_a_machine(hidden: dict[str, ModuleType]) -> None:
    machines, overlaid = hidden["machines"], hidden["limits"].overlaid_lists
    for kind in (*hidden["kinds"].KNOWN, *hidden["kinds"].UNKNOWN):
        known = overlaid(machines.visible_tables(kind.family, kind.variants[0]), kind.known)
        visible = machines.recorded(known, kind.excitation, 1.0, 0.0, 5)
        owner = hidden["limits"].parsed(visible, "owner")
        for magnitude in (0.1 * kind.most, kind.most):
            assert hidden["limits"].parsed(overlaid(visible, kind.change(visible, magnitude, 1)), kind.key) != owner


# ---- Limits and files ---------------------------------------------------------------------------------------------------


def test_limit_is_where_an_effect_adds_as_much_as_there_is(hidden: dict[str, ModuleType]) -> None:
    kind = replace(hidden["kinds"].BY_KEY["servo_arm:backlash(shoulder)"], change=lambda t, m, d: {"size": m}, most=10.0)

    def error(tables: dict[str, Any]) -> tuple[float, float]:
        return math.hypot(3.0, 2.0 * tables["size"]), 4.0

    limit = hidden["limits"].limit_of(kind, 1, {"size": 0.0}, error)
    assert limit.without == pytest.approx(5.0)
    assert limit.magnitude == pytest.approx(2.5, rel=0.05)
    blind = hidden["limits"].limit_of(kind, 1, {"size": 0.0}, lambda tables: (3.0, 4.0))
    assert math.isinf(blind.magnitude)


def test_tables_are_overlaid_inside_lists_too(hidden: dict[str, ModuleType]) -> None:
    overlaid = hidden["limits"].overlaid_lists
    below = {"axes": [{"a": 1, "b": 2}, {"a": 3}], "sensors": [{"signal": "x"}], "rest": {"c": [1]}}
    above = {"axes": {1: {"a": 4}}, "sensors": [{"signal": "y"}], "rest": {"c": [2]}}
    assert overlaid(below, above) == {
        "axes": [{"a": 1, "b": 2}, {"a": 4}], "sensors": [{"signal": "x"}, {"signal": "y"}], "rest": {"c": [2]},
    }  # fmt: skip


def test_two_errors_of_one_sensor_are_both_in_the_machine(hidden: dict[str, ModuleType]) -> None:
    kinds, machines, overlaid = hidden["kinds"].BY_KEY, hidden["machines"], hidden["limits"].overlaid_lists
    real = machines.recorded(machines.visible_tables("valve_crane", 0), "rich", 1.0, 0.0, 5)
    for effect in ("sensor_quantisation", "sensor_scale", "sensor_bias"):
        kind = kinds[f"valve_crane:{effect}(boom.cylinder)"]
        real = overlaid(real, kind.change(real, 0.1 * kind.most, 1))
    sensor = hidden["limits"].parsed(real, "crane").sensor("boom.cylinder")
    assert sensor.quantum > 0.0
    assert sensor.scale != 1.0
    assert sensor.bias != 0.0


def test_site_holds_nothing_of_what_is_sealed(hidden: dict[str, ModuleType], tmp_path: Path) -> None:
    """A servo arm with play: three times as large as what just shows, described nowhere but in the sealed file."""
    cases = hidden["cases"]
    kind = cases.Hidden("servo_arm:backlash(elbow)", 3.0, 1)
    spec = cases.CaseSpec("one", "single", "servo_arm", 2, (kind,), "poor", 1.0, 0.0, 11)
    sealed = hidden["make"].make_case(spec, tmp_path)
    assert json.loads((tmp_path / "sealed" / "one.json").read_text("utf-8")) == json.loads(json.dumps(sealed))
    assert sealed["hidden"][0]["factor"] == pytest.approx(3.0)
    (effect,) = sealed["effects"]
    assert (effect["name"], effect["target"]) == ("backlash", "elbow")
    assert effect["parameters"]["width"] == pytest.approx(3.0 * sealed["hidden"][0]["detection_limit"])
    # Play about as wide as the noise's spread shows about as much as the noise.
    assert 1e-4 < sealed["hidden"][0]["detection_limit"] < 6e-4
    site = tmp_path / "cases" / "one" / "site"
    files = sorted(path.relative_to(site).as_posix() for path in site.rglob("*") if path.is_file())
    assert files == [
        "arm.urdf",
        "logs/take-1/log.csv",
        "logs/take-2/log.csv",
        "logs/take-3/log.csv",
        "machine.toml",
        "recipe.toml",
    ]
    for name in ("machine.toml", "arm.urdf", "recipe.toml"):
        assert "backlash" not in (site / name).read_text("utf-8")
    assert 'name = "first_order_lag"' in (site / "machine.toml").read_text("utf-8")


def test_case_with_an_answer_is_not_run_again_and_a_crash_is_an_answer(
    hidden: dict[str, ModuleType], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runner, specs = hidden["runner"], hidden["cases"].cases_of("smoke", SEED)[:2]
    calls: list[str] = []

    def process(task: Callable[..., None], arguments: list[object], limit: float) -> str | None:
        calls.append(task.__name__)
        if task.__name__ == "solve":
            assert "sealed" not in "".join(str(argument) for argument in arguments)
            return "took more than 180 s"
        return None

    monkeypatch.setattr(runner, "run_process", process)
    told: list[str] = []
    runner.run_all(specs, tmp_path, 1, False, told.append)
    assert calls == ["make_case", "solve"] * 2
    assert json.loads(runner.Place(tmp_path).answer(specs[0]).read_text("utf-8")) == {
        "failure": "not answered: took more than 180 s"
    }
    runner.run_all(specs, tmp_path, 1, False, told.append)
    assert len(calls) == 4
    assert len(told) == 2


def test_step_that_fails_or_takes_too_long_says_so(hidden: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hidden["runner"], "PATIENCE", 600.0)
    run = hidden["runner"].run_process
    assert run(json.loads, ["[1]"], 10.0) is None
    assert run(json.loads, ["[1"], 10.0).startswith("json.decoder.JSONDecodeError: ")
    assert run(math.factorial, [30_000_000], 1.0) == "took more than 1 s"


# ---- Evaluating ------------------------------------------------------------------------------------------------------------


def sealed_case(hidden: dict[str, ModuleType], group: str, *names: tuple[str, str], factor: float = 5.0) -> dict[str, Any]:
    spec = replace(hidden["cases"].case(group, 0, SEED), hidden=())
    entries = [
        {"effects": [{"name": n, "target": t}], "factor": factor, "judged": True, "kind": f"valve_crane:{n}({t})"}
        for n, t in names
    ]
    effects = [{"name": n, "target": t, "parameters": {"width": 0.02}, "exact": t == "slew"} for n, t in names]
    return {"spec": spec.to_json(), "hidden": entries, "effects": effects}


def answer(*effects: dict[str, Any], verdict: str = "named", after: float = 0.2) -> dict[str, Any]:
    gap = {"before": {"a": 1.0, "b": 0.11}, "after": {"a": after, "b": 0.5}, "noise_floor": {"a": 0.1, "b": 0.1}}
    return {"seconds": 9.0, "answer": {"effects": list(effects), "verdict": verdict, "unnamed": [], "gap": gap}}


def effect(name: str, target: str, width: float = 0.021, **more: Any) -> dict[str, Any]:
    return {"name": name, "target": target, "parameters": {"width": width}, "interval95": {"width": [0.019, 0.022]}, **more}


def test_right_wrong_missed_and_aliases(hidden: dict[str, ModuleType]) -> None:
    evaluate = hidden["evaluate"].evaluate
    sealed = sealed_case(hidden, "single", ("backlash", "slew"))
    right = evaluate(sealed, answer(effect("backlash", "slew")))
    assert right.exact
    assert right.errors == {"backlash(slew).width": pytest.approx(0.05)}
    assert right.covered == {"backlash(slew).width": True}
    assert right.closed == pytest.approx(0.8 / 0.9), "the signal at its floor does not count"
    elsewhere = evaluate(sealed, answer(effect("backlash", "boom")))
    assert (elsewhere.wrong, elsewhere.missed) == ((("backlash", "boom"),), (("backlash", "slew"),))
    both = evaluate(sealed, answer(effect("backlash", "slew"), effect("stiction", "slew")))
    assert both.wrong == (("stiction", "slew"),)
    assert not both.exact
    alias = evaluate(sealed, answer(effect("joint_offset", "slew", aliases=[{"name": "backlash", "target": "slew"}])))
    assert alias.exact
    silent = evaluate(sealed, answer(verdict="ambiguous"))
    assert (silent.wrong, silent.missed, silent.closed) == ((), (("backlash", "slew"),), None)


def test_what_its_own_name_does_not_explain_is_told(hidden: dict[str, ModuleType]) -> None:
    """Of 0.0003 that the owner's plant leaves anyway, 0.0009 with the effect, and 0.0006 with its name put in."""
    error = {"nothing_hidden": {"a": 3e-4, "b": 0.0}, "before": {"a": 9e-4, "b": 1e-4}, "after": {"a": 6e-4, "b": 0.0}}
    sealed = {**sealed_case(hidden, "single", ("backlash", "slew")), "model_error": error}
    told = hidden["evaluate"].evaluate(sealed, answer())
    assert told.explained == pytest.approx(1.0 - 27.0 / 72.0)
    exact = hidden["evaluate"].evaluate({**sealed, "model_error": {}}, answer())
    assert exact.explained == 1.0
    values = hidden["score"].scored(
        [told, exact, hidden["evaluate"].evaluate({**sealed, "model_error": {**error, "after": error["before"]}}, answer())]
    )["rates"]["single_described_right"]
    assert values["cases"] == 2


def test_rates_over_cases(hidden: dict[str, ModuleType]) -> None:
    evaluate, scored = hidden["evaluate"].evaluate, hidden["score"].scored
    single, none = sealed_case(hidden, "single", ("backlash", "slew")), sealed_case(hidden, "none")
    below = sealed_case(hidden, "single", ("backlash", "slew"), factor=1.0)
    two = sealed_case(hidden, "double", ("backlash", "slew"), ("backlash", "boom"))
    unknown = sealed_case(hidden, "unknown")
    cases = [
        evaluate(single, answer(effect("backlash", "slew"))),
        evaluate(single, answer(verdict="ambiguous")),
        evaluate(single, {"failure": "not answered"}),
        evaluate(below, answer(verdict="no_gap")),
        evaluate(none, answer(effect("stiction", "boom"))),
        evaluate(none, answer(verdict="no_gap")),
        evaluate(two, answer(effect("backlash", "slew"), effect("backlash", "boom", 0.03))),
        evaluate(unknown, answer(verdict="unnamed")),
    ]
    found = scored(cases)
    values = {key: (rate["hits"], rate["cases"]) for key, rate in found["rates"].items()}
    assert values["single_right"] == (1, 3), "a crash is a miss"
    assert values["single_abstained"] == (2, 3)
    assert values["single_below_limit_wrong"] == (0, 1)
    assert values["false_naming_none"] == (1, 2)
    assert values["wrong_name"] == (1, 7), "who gives no answer gives no wrong one, nor a right one"
    assert values["double_exact"] == (1, 1)
    assert values["unknown_not_misnamed"] == (1, 1)
    assert values["interval_coverage"] == (3, 3)
    assert values["interval_coverage_alike"] == (2, 2), "of the boom the truth is a fit"
    assert values["interval_coverage_unlike"] == (1, 1)
    assert values["closed"] == (0, 2), "0.8 of 0.9"
    assert values["failure"] == (1, 8)
    assert found["parameter_error"]["count"] == 3
    assert found["confusion"] == {
        "backlash": {"ambiguous": 1, "backlash": 1, "no answer": 1, "no_gap": 1},
        "nothing": {"no_gap": 1, "stiction": 1},
        "unknown": {"unnamed": 1},
    }


def test_why_effects_have_no_name_is_counted(hidden: dict[str, ModuleType]) -> None:
    sealed, found = sealed_case(hidden, "single", ("backlash", "slew")), answer(verdict="unnamed")
    late = "something else explains it"
    found["answer"]["near_misses"] = [
        {"name": "backlash", "target": "slew", "lacks": late},
        {"name": "backlash", "target": "boom", "lacks": late},
        {"name": "stiction", "target": "slew", "lacks": "it may be absent"},
    ]
    case = hidden["evaluate"].evaluate(sealed, found)
    again = hidden["evaluate"].CaseResult.from_json(json.loads(json.dumps(case.to_json())))
    assert again == case
    older = {key: value for key, value in case.to_json().items() if key != "refused"}
    assert hidden["evaluate"].CaseResult.from_json(older).refused == ()
    counted = hidden["score"].scored([case, again])["refusals"]
    assert counted == {"it may be absent": {"hidden": 0, "other": 2}, late: {"hidden": 2, "other": 2}}


def test_wilson_interval(hidden: dict[str, ModuleType]) -> None:
    wilson = hidden["score"].wilson
    assert wilson(0, 300) == pytest.approx([0.0, 0.01264], abs=1e-4)
    assert wilson(97, 100) == pytest.approx([0.9155, 0.9897], abs=1e-3)
    assert wilson(0, 0) == [0.0, 1.0]


def test_page_replaces_only_what_it_generated(hidden: dict[str, ModuleType], pipeline: ModuleType, tmp_path: Path) -> None:
    sealed = sealed_case(hidden, "single", ("backlash", "slew"))
    evaluated = [hidden["evaluate"].evaluate(sealed, answer(effect("stiction", "slew")))]
    seed = hidden["seed"].seed_of_commit("0000000bcd" + 30 * "0")
    result = json.loads(json.dumps(pipeline.result_of("quick", seed, evaluated, 60, "make hidden-effects"), allow_nan=False))
    assert result["rates"]["wrong_name"]["value"] == 1.0
    agreed = "commit tier cases rates parameter_error closed_min seconds confusion command seed versions machine date"
    assert set(agreed.split()) <= set(result)
    assert (result["seed"], result["commit"][:8]) == (11, "0000000b")
    rates = "false_naming_none single_right wrong_name double_exact triple_exact unknown_not_misnamed"
    assert all({"value", "wilson95"} <= set(result["rates"][key]) for key in rates.split())
    assert {"median", "p90"} <= set(result["parameter_error"])
    assert {"median", "max"} <= set(result["seconds"])
    text = hidden["page"].page_tables(result)
    assert "| any case: a wrong name | ≤ 2 % | 100.0 % |" in text
    assert "| backlash | stiction 1 |" in text
    assert "seed 11 (commit 0000000b)" in text


def test_a_committed_result_is_gone_on_from(hidden: dict[str, ModuleType], pipeline: ModuleType, tmp_path: Path) -> None:
    """What was evaluated comes back as it was; a case that is another one by now does not."""
    evaluate = hidden["evaluate"].evaluate
    specs = [hidden["cases"].case(group, 0, SEED) for group in ("none", "single")]
    sealed = [{"spec": spec.to_json(), "hidden": [], "effects": []} for spec in specs]
    evaluated = [evaluate(sealed[0], answer()), evaluate(sealed[1], {"failure": "took more than 180 s"})]
    path = tmp_path / "result.json"
    path.write_text(
        json.dumps(pipeline.result_of("full", hidden["seed"].Seed(SEED), evaluated, 660, "a command"), allow_nan=False), "utf-8"
    )
    found = pipeline.evaluated_in(path, specs)
    assert list(found) == [spec.name for spec in specs]
    assert found["none-000"] == evaluated[0]
    assert found["single-000"].failure == "took more than 180 s"
    assert math.isnan(found["single-000"].seconds)
    changed = [replace(specs[0], seed=1), specs[1]]
    assert list(pipeline.evaluated_in(path, changed)) == ["single-000"]
    assert pipeline.evaluated_in(tmp_path / "none.json", specs) == {}
    assert [case.failure for case in pipeline.evaluated(specs, tmp_path, found)] == [None, "took more than 180 s"]


def test_an_answer_without_its_truth_is_not_judged(hidden: dict[str, ModuleType], pipeline: ModuleType, tmp_path: Path) -> None:
    """Without the truth every name would be a wrong one; a case that could not be made has none, and failed."""
    spec = hidden["cases"].cases_of("smoke", SEED)[0]
    (tmp_path / "answers").mkdir()
    answer = tmp_path / "answers" / f"{spec.name}.json"
    answer.write_text(json.dumps({"failure": "not made: no such machine"}))
    (evaluated,) = pipeline.evaluated([spec], tmp_path, {})
    assert evaluated.failure == "not made: no such machine"
    answer.write_text(json.dumps({"answer": {"effects": []}, "seconds": 1.0}))
    with pytest.raises(FileNotFoundError, match=f"{spec.name} has an answer, but no truth"):
        pipeline.evaluated([spec], tmp_path, {})


def test_crane_stages_are_silent_where_nothing_is_hidden(hidden: dict[str, ModuleType]) -> None:
    """Without its effect the residual of every stage but the command's is rounding; with it, it is what geometry says."""
    machines, limits, kinds = hidden["machines"], hidden["limits"], hidden["kinds"].BY_KEY
    tables = machines.visible_tables("valve_crane", 0)
    visible = {**machines.recorded(tables, "poor", 1.0, 0.0, 3)}
    visible["recordings"] = [{**visible["recordings"][0], "seconds": 15.0}]
    plain = hidden["limits"]
    nominal = importlib.import_module("simulated_bench.nominal").CommandChain(np.zeros((4, 18)), np.ones(4))
    shown = {
        "joint_offset(boom)": (1e-3, None),
        "sensor_bias(boom.cylinder)": (1e-4, None),
        "base_misalignment(base)": (1e-3, None),
        "gripper_sway(tool)": (0.2, 0.2),
        "link_length_error(boom)": (2e-3, 2e-3),
    }
    for label, (magnitude, size) in shown.items():
        kind = kinds[f"valve_crane:{label}"]
        error = limits.error_of(kind, visible, nominal)
        silent, noise = error(visible)
        assert silent < 1e-6, label
        assert noise > 0.0
        heard, _ = error(plain.overlaid_lists(visible, kind.change(visible, magnitude, 1)))
        assert heard > 1e-4, label
        assert size is None or heard == pytest.approx(size, rel=0.05), label
