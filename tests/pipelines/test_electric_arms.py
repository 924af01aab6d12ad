"""Simulated electric machines: with nothing hidden the owner's model is exact, and what acts is what the truth states."""

from __future__ import annotations

import importlib
import json
import re
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from scipy import signal

from sysid.datasets import ingest
from sysid.datasets.recording import Recording
from sysid.machine import load_machine
from sysid.plant import free_run, nominal_plant

PIPELINES = str(Path(__file__).parents[2] / "pipelines")
MODULES = ("arm", "case", "flexible", "generate", "goals", "measured", "names", "page", "poses", "published", "rigid", "runner")
MODULES += ("score", "servo_arm", "servo_sag", "smooth_friction", "solve")
Array = npt.NDArray[np.float64]


@pytest.fixture(scope="module")
def arms() -> Iterator[dict[str, ModuleType]]:
    pytest.importorskip("mujoco")
    sys.path.insert(0, PIPELINES)
    yield {name: importlib.import_module(f"arms.{name}") for name in MODULES}
    sys.path.remove(PIPELINES)


def motion(table: pd.DataFrame, names: list[str]) -> tuple[Array, Array, Array, Array]:
    """Torque, angle, speed and acceleration (n, axes) by central differences."""
    step = float(table["time"][1])
    q = table[[f"{name}.joint" for name in names]].to_numpy()
    a = np.zeros_like(q)
    a[1:-1] = (q[2:] - 2.0 * q[1:-1] + q[:-2]) / step**2
    return table[[f"{name}.command" for name in names]].to_numpy(), q, np.gradient(q, step, axis=0), a


def low_passed(values: Array, rate: float, hz: float = 10.0) -> Array:
    """Filtered forward and backward, without the ends."""
    edge = int(2.0 * rate / hz)
    return np.asarray(signal.sosfiltfilt(signal.butter(4, hz, fs=rate, output="sos"), values, axis=0))[edge:-edge]


def rms(values: Array) -> Array:
    return np.asarray(np.sqrt(np.mean(values**2, axis=0)))


def test_the_frictionless_arm_obeys_the_owners_inverse_dynamics(arms: dict[str, ModuleType]) -> None:
    arm, draw = arms["arm"], np.random.default_rng(5)
    owner = arm.random_arm(draw, "anthropomorphic")
    effort = np.array([link.effort for link in owner.links])
    table = arm.record(owner, owner, arm.Friction(np.zeros(6), np.zeros(6)), draw, 500.0, 4.0)
    torque, q, v, a = motion(table, owner.names)
    left = low_passed(torque - arms["rigid"].inverse_dynamics(owner, q, v, a), 500.0)
    # The smallest noise of the row, under the same filter.
    assert np.all(rms(left) < 0.1 * 0.003 * effort * np.sqrt(2.0 * 10.0 / 500.0))


def test_the_friction_that_acts_on_a_moving_joint_is_the_hidden_one(arms: dict[str, ModuleType]) -> None:
    arm, draw = arms["arm"], np.random.default_rng(6)
    owner = arm.random_arm(draw, "ur")
    real = arm.with_masses(arm.replace(owner, payload=arm.random_payload(draw)), 1.0 + draw.uniform(-0.05, 0.05, 6))
    friction = arm.Friction(np.array([10.0, 12.0, 5.0, 2.0, 2.0, 2.0]), np.array([8.0, 0.0, 5.0, 2.0, 0.0, 2.0]))
    torque, q, v, a = motion(arm.record(owner, real, friction, draw, 500.0, 4.0), owner.names)
    left = torque - arms["rigid"].inverse_dynamics(real, q, v, a) - friction.viscous * v
    for k in range(6):
        moving = np.abs(v[:, k]) > 0.1
        moving[:50] = moving[-1:] = False  # the controller settles after the start
        assert np.allclose(left[moving, k], friction.coulomb[k] * np.sign(v[moving, k]), atol=0.05), owner.names[k]


@pytest.mark.parametrize("kind", ["sharp", "tanh", "arctan", "load"])
def test_a_force_axis_has_the_stated_friction(arms: dict[str, ModuleType], kind: str) -> None:
    friction = arms["smooth_friction"]
    axis = friction.random_axis(np.random.default_rng(7), kind)
    wanted = np.arange(5000) / 500.0
    q, v, a = 0.8 * np.sin(2.0 * wanted), 1.6 * np.cos(2.0 * wanted), -3.2 * np.sin(2.0 * wanted)
    torque, angle = friction.simulate(axis, q, v, a, 1.0 / 500.0)
    table = pd.DataFrame({"time": wanted, "axis1.command": torque, "axis1.joint": angle})
    force, q1, v1, a1 = (part[:, 0] for part in motion(table, ["axis1"]))
    # Each row's torque is held until the next: the second difference at a row has half of it and half of the one before.
    force = 0.5 * (force + np.r_[force[0], force[:-1]])
    left = force - friction.moving_inertia(axis) * a1 - axis.weight * np.sin(q1) - axis.viscous * v1
    load = axis.load * np.abs(axis.weight * np.sin(q1) + (friction.moving_inertia(axis) - friction.ROTOR) * a1)
    stated = {
        "sharp": axis.force * np.sign(v1),
        "tanh": axis.force * np.tanh(v1 / axis.speed),
        "arctan": axis.force * 2.0 / np.pi * np.arctan(v1 / axis.speed),
        "load": (axis.force + load) * np.sign(v1),
    }[kind]
    moving = np.abs(v1) > 0.1
    moving[[0, -1]] = False
    assert np.abs(left - stated)[moving].max() < 0.02 * axis.force


def test_a_frictionless_axis_leaves_nothing(arms: dict[str, ModuleType]) -> None:
    case = arms["smooth_friction"].make(2, friction=False)
    assert case.hidden == []
    torque, q, _, a = (part[:, 0] for part in motion(case.clean["motion-1"], ["axis1"]))
    axis = arms["smooth_friction"].random_axis(np.random.default_rng([2, 6]), "load")
    torque = 0.5 * (torque + np.r_[torque[0], torque[:-1]])
    left = low_passed(torque - arms["smooth_friction"].moving_inertia(axis) * a - axis.weight * np.sin(q), case.rate_hz)
    assert rms(left) < 0.1 * case.extra["torque_noise"]["axis1"] * np.sqrt(20.0 / case.rate_hz)


def test_a_rigid_drive_leaves_nothing_and_a_flexible_one_its_resonances(arms: dict[str, ModuleType]) -> None:
    flexible = arms["flexible"]
    case = flexible.make_force(1, flexible=False, friction=False)
    torque, _, _, a = (part[:, 0] for part in motion(case.clean["multisine-2"], ["drive"]))
    torque = 0.5 * (torque + np.r_[torque[0], torque[:-1]])
    left = low_passed(torque - case.axes[0].inertia * a, case.rate_hz, 40.0)
    assert rms(left) < 0.1 * case.extra["torque_noise"]["drive"] * np.sqrt(80.0 / case.rate_hz)
    drive = flexible.random_drive(np.random.default_rng(1))
    drive = flexible.Drive(drive.motor, drive.load, drive.stiffness, drive.damping, 0.0, 0.0)
    time = np.arange(20_000) / 1000.0
    torque, q = flexible.simulate_force(drive, flexible.chirp(time, 1.0, 80.0), 1e-3, 0.0, 0.0)
    gain = np.abs(np.fft.rfft(np.diff(q, 2))) / np.abs(np.fft.rfft(torque[1:-1]))
    frequency = np.fft.rfftfreq(len(q) - 2, 1e-3)
    band = (frequency > 3.0) & (frequency < 70.0)
    assert frequency[band][gain[band].argmin()] == pytest.approx(drive.antiresonance, abs=0.3)
    assert frequency[band][gain[band].argmax()] == pytest.approx(drive.resonance, abs=0.3)


def test_a_servo_is_behind_its_setpoint_by_load_times_compliance(arms: dict[str, ModuleType]) -> None:
    import mujoco

    servo, draw = arms["servo_sag"], np.random.default_rng(8)
    arm = servo.random_arm(draw, 4)
    compliance = np.radians(3.0) / np.maximum(servo.largest_load(arm, draw), 0.2)
    wanted = np.tile(draw.uniform(*arm.limits.T), (3000, 1))
    wanted[:500] += 0.1
    q = servo.simulate(arm, compliance, np.full(4, 0.02), np.full(4, 0.05), wanted)
    model, data = arms["rigid"].mujoco_model(arm)
    data.qpos[:] = q[-1]
    mujoco.mj_forward(model, data)
    assert np.allclose(wanted[-1] - q[-1], compliance * data.qfrc_bias, atol=1e-6)


@pytest.mark.slow
def test_a_servo_arm_with_nothing_hidden_moves_as_its_description(arms: dict[str, ModuleType], tmp_path: Path) -> None:
    for seed in (3, 6):
        case = arms["servo_arm"].make(seed, hides=False)
        plant = nominal_plant(load_machine(arms["case"].write_case(case, tmp_path / str(seed)) / "machine.toml"))
        for name, table in case.clean.items():
            found = free_run(plant, Recording(name, table, case.rate_hz))
            joints = [f"{axis}.joint" for axis in plant.machine.axis_names]
            assert rms((found[joints] - table[joints]).to_numpy()).max() < 1e-3


def test_what_a_servo_arm_hides_is_in_its_model(arms: dict[str, ModuleType]) -> None:
    servo = arms["servo_arm"]
    for seed in range(30):
        draw = np.random.default_rng(seed)
        arm = servo.random_arm(draw, 4)
        true, hidden = servo.hide(draw, arm)
        changed = {part: np.flatnonzero(getattr(true, part) != getattr(arm, part)) for part in arm.__dataclass_fields__}
        assert sum(map(len, changed.values())) == len(hidden)
        for each in hidden:
            parts = {"coulomb_friction": "friction", "force_limit": "limit", "input_delay": "late", "backlash": "backlash"}
            part = parts.get(each.name)
            part = part or servo.RATIOS[each.name][0]
            assert arm.names.index(each.target) in changed[part]


def test_poses_with_nothing_hidden_are_those_of_the_owners_kinematics(arms: dict[str, ModuleType], tmp_path: Path) -> None:
    case = arms["poses"].make(0, hides=False)
    site = arms["case"].write_case(case, tmp_path)
    kinematics = load_machine(site / "machine.toml").kinematics()
    table = case.clean["set-1"]
    tip = kinematics.tip_position(table[[f"{axis.name}.joint" for axis in case.axes]].to_numpy())
    assert np.abs(tip - table[["ee.x", "ee.y", "ee.z"]].to_numpy()).max() < 1e-9


@pytest.mark.slow
def test_every_row_is_read_and_hides_its_truth_from_the_site(arms: dict[str, ModuleType], tmp_path: Path) -> None:
    for folder in arms["generate"].generate(list(arms["generate"].ROWS), [3], tmp_path):
        truth = json.loads((folder / "truth.json").read_text("utf-8"))
        assert truth["hidden"]
        assert {path.name for path in (folder / "site").iterdir()} <= {"machine.toml", "arm.urdf", "recipe.toml", "logs"}
        dataset = ingest(folder / "site", tmp_path / "workspace")
        assert len(dataset.recordings) >= 3
        targets = {each["target"] for each in truth["hidden"]}
        assert targets <= {*dataset.machine.axis_names, "base", "tool"}


# ---- Scores -------------------------------------------------------------------------------------------------------------


def truth(*hidden: tuple[str, str, dict[str, float], bool], **extra: Any) -> dict[str, Any]:
    listed = [{"name": n, "target": t, "parameters": p, "due": due} for n, t, p, due in hidden]
    return {"row": "arm", "name": "arm-000", "hidden": listed, **extra}


def answer(*effects: tuple[str, str, dict[str, float]], **extra: Any) -> dict[str, Any]:
    gap = {"before": {}, "after": {"j1.command": 0.2}, "noise_floor": {"j1.command": 0.1}}
    listed = [{"name": n, "target": t, "parameters": p, "aliases": []} for n, t, p in effects]
    found = {"effects": listed, "verdict": "named", "gap": gap, "unnamed": [], "ambiguous": [], "next_experiment": []}
    return {"answer": found | extra, "seconds": 1.0, "wall_seconds": 1.0}


COULOMB = ("coulomb_friction", "j1", {"force": 8.0}, True)
MASS = ("link_inertia", "j2", {"ratio": 1.03}, False)


@pytest.mark.parametrize(
    ("hidden", "effects", "outcome"),
    [
        ([COULOMB, MASS], [("coulomb_friction", "j1", {"force": 8.4})], "right"),
        ([COULOMB, MASS], [("coulomb_friction", "j1", {"force": 8.4}), ("link_mass_error", "j4", {"ratio": 1.0})], "right"),
        ([COULOMB, MASS], [("link_mass_error", "j2", {"ratio": 1.0})], "incomplete"),
        ([COULOMB], [], "none"),
        ([COULOMB], [("coulomb_friction", "j2", {"force": 8.0})], "wrong"),
        ([COULOMB], [("coulomb_friction", "j1", {"force": 8.0}), ("viscous_friction", "j1", {"coefficient": 1.0})], "wrong"),
        ([COULOMB], [("payload", "tool", {"mass": 1.0})], "wrong"),
        ([("smooth_coulomb_friction", "j1", {"force": 8.0}, True)], [("coulomb_friction", "j1", {"force": 8.0})], "incomplete"),
        ([("smooth_coulomb_friction", "j1", {}, True)], [("viscous_friction", "j1", {"coefficient": 8.0})], "wrong"),
    ],
)
def test_outcomes(
    arms: dict[str, ModuleType],
    hidden: list[tuple[str, str, dict[str, float], bool]],
    effects: list[tuple[str, str, dict[str, float]]],
    outcome: str,
) -> None:
    assert arms["score"].score(truth(*hidden), answer(*effects)).outcome == outcome


def test_errors_and_ratios_are_relative_to_the_truth(arms: dict[str, ModuleType]) -> None:
    score = arms["score"]
    given = truth(COULOMB, torque_noise={"j1": 1.0}, joint_noise=0.0, inertia={"j1": 1.0}, rate_hz=500.0)
    found = score.score(given, answer(("coulomb_friction", "j1", {"positive": 8.0, "negative": 9.6})))
    assert found.errors == {"coulomb_friction(j1).force": pytest.approx(0.1)}
    assert found.stated == pytest.approx(2.0)
    # White noise of 1 N·m behind the same filter.
    noise = low_passed(np.random.default_rng(0).standard_normal(400_000), 500.0)
    assert found.ratio == pytest.approx(0.2 / rms(noise), rel=0.02)


def test_noise_shares_are_those_of_filtered_noise(arms: dict[str, ModuleType]) -> None:
    white = np.random.default_rng(1).standard_normal(400_000)
    position = signal.sosfiltfilt(signal.butter(4, 80.0, fs=1000.0, output="sos"), white)
    acceleration = np.gradient(np.gradient(position, 1e-3), 1e-3)
    force, moved = arms["score"].noise_shares(1000.0, 30.0, 80.0)
    assert force == pytest.approx(rms(low_passed(white, 1000.0, 30.0)), rel=0.02)
    # Central differences are a little short of the derivative.
    assert moved == pytest.approx(rms(low_passed(acceleration, 1000.0, 30.0)), rel=0.05)


def test_a_sagging_servo_without_masses_has_a_tie(arms: dict[str, ModuleType]) -> None:
    given = truth(("joint_compliance", "a", {"compliance": 1.0}, False), variant="plain", sagging=["a"])
    pair = [{"name": "joint_compliance", "target": "a"}, {"name": "sensor_bias", "target": "a.joint"}]
    assert arms["score"].score(given, answer(ambiguous=[pair])).tie
    assert not arms["score"].score(given, answer(ambiguous=[pair[1:]])).tie
    assert arms["score"].score(given, answer(("sensor_bias", "a.joint", {"bias": 0.1}))).outcome == "wrong"


def test_a_described_resonance_is_compared(arms: dict[str, ModuleType]) -> None:
    given = truth(("flexible_drive", "j1", {"antiresonance_hz": 10.0, "resonance_hz": 20.0}, True))
    found = arms["score"].score(given, answer(unnamed=[{"stage": "force", "target": "j1", "resonance_hz": 19.0}]))
    assert (found.outcome, found.resonance) == ("none", pytest.approx(0.05))


def test_refusals_and_crashes_are_told_apart(arms: dict[str, ModuleType]) -> None:
    found = [arms["score"].score(truth(COULOMB), {key: "why"}) for key in ("refused", "failure")]
    assert [(each.outcome, each.reason) for each in found] == [("refused", "why"), ("failure", "why")]


def test_every_hidden_name_has_an_entry_and_every_case_a_line(arms: dict[str, ModuleType]) -> None:
    cases = [
        arms["score"].score(truth(COULOMB), answer(("coulomb_friction", "j1", {"force": 8.0}))).to_json(),
        arms["score"].score(truth(COULOMB), {"refused": "too | short"}).to_json(),
    ]
    page = arms["page"].page_tables(run_of([0, 1], cases))
    assert "1 right, 1 refused" in page
    assert "too \\| short" in page
    beside = arms["page"].page_tables(run_of([7], cases[:1]), run_of([0], cases))
    assert "| before (seeds 0–0) |" in beside
    assert "| 1 right, 1 refused | 1 right | 1 |" in beside
    friction = arms["smooth_friction"]
    for kind in friction.KINDS:
        for hidden in friction.truth(friction.random_axis(np.random.default_rng(0), kind)):
            assert hidden.name in arms["names"].ACCEPTED


def test_a_goal_is_reached_by_all_cases_or_missed(arms: dict[str, ModuleType]) -> None:
    right = {**CASE, "errors": {"coulomb_friction(a).force": 0.02, "payload(tool).mass": 0.04}, "ratio": 1.1, "spread": 0.1}
    cases = [{**right, "row": "arm"} for _ in range(20)]
    drive = {**CASE, "row": "flexible", "variant": "force", "missed": [["viscous_friction", "drive"]], "outcome": "incomplete"}
    changes = [("EMPS, rigid [relative]", "1", "1", "same"), ("UR10, calibrated [mm]", "1", "2", "worse")]
    left = {f"UR10e, ur10e, {axis}.command [relative]": 0.05 for axis in ("shoulder_pan", "shoulder_lift", "elbow")}
    figures = {**left, "UR10e, loaded, mass of the payload [relative]": 0.031}
    named = [f"viscous_friction({axis})" for axis in ("shoulder_pan", "shoulder_lift", "elbow")]
    measured = {"figures": figures, "named": {"ur10e, ur10e": named, "ur10e, loaded": ["payload(tool)"]}}

    def row_of(text: str, **changed: Any) -> str:
        table = arms["goals"].goal_table(**{"cases": [*cases, drive], "measured": measured, "changes": changes} | changed)
        return next(line for line in table.splitlines() if line.startswith(f"| {text}"))

    assert row_of("six-axis arm").endswith("| 20 of 20 | reached |")
    assert row_of("six-axis arm", cases=cases[1:]).endswith("| 19 of 19 | **missed** |")
    assert row_of("— mass of the payload").endswith("| 20 of 20 payloads, at most 4.0 % | reached |")
    assert row_of("— force error", cases=[*cases, {**cases[0], "ratio": 1.3}]).endswith(
        "at most 1.30; 20 of 21 within | **missed** |"
    )
    assert row_of("flexible drive, force axis").endswith("| 1 of 1 | reached |")
    assert row_of("— its friction named too").endswith("| 0 of 1 | **missed** |")
    assert row_of("flexible drive, force axis", cases=[{**drive, "outcome": "none"}]).endswith("**missed** |")
    assert row_of("UR10e, measured").endswith("| 3 | reached |")
    assert row_of("— error of the payload").endswith("| 3.1 % | **missed** |")
    assert row_of("EMPS").endswith("reached |")
    assert row_of("UR10, measured").endswith("| 1 worse | **missed** |")
    assert row_of("all simulated machines", cases=[{**drive, "wrong": [["payload", "tool"]]}]).endswith(
        "| 1 of 1 | **missed** |"
    )


def test_the_page_has_the_goals_of_the_committed_results(arms: dict[str, ModuleType]) -> None:
    root = Path(PIPELINES).parent
    parts = [
        json.loads((root / f"reports/electric_arms/{name}.json").read_text("utf-8"))
        for name in ("result", "measured", "measured_before")
    ]
    changes = arms["measured"].compared(parts[2]["figures"], parts[1]["figures"])
    table = arms["goals"].goal_table(parts[0]["cases"], parts[1], changes)
    assert table in (root / "reports/electric_arms/README.md").read_text("utf-8")


@pytest.mark.slow
@pytest.mark.parametrize("seed", [10, 110])
def test_eleven_joints_that_bend_under_their_weight_get_the_right_names(
    arms: dict[str, ModuleType], tmp_path: Path, seed: int
) -> None:
    """Compliances move the tip by centimetres; the loads of the undeflected posture gave wrong names, or none."""
    site = arms["case"].write_case(arms["poses"].make(seed, eleven=True), tmp_path)
    arms["solve"].solve(site, tmp_path / "answer.json")
    found = arms["score"].score_case(tmp_path)
    assert (found.outcome, found.ratio) == ("right", pytest.approx(1.0, abs=0.1))


def test_figures_of_the_ur10e_are_read_from_its_result(arms: dict[str, ModuleType], tmp_path: Path) -> None:
    result = {"left": {"ur10e": {"elbow.command": 0.02}}, "published": {"payload": 2.0}, "payload": {"one": 2.1, "two": None}}
    (tmp_path / "ur10e").mkdir()
    (tmp_path / "ur10e" / "result.json").write_text(json.dumps(result), "utf-8")
    found = arms["measured"].figures(tmp_path, tmp_path)
    assert found == {
        "UR10e, ur10e, elbow.command [relative]": 0.02,
        "UR10e, one, mass of the payload [relative]": pytest.approx(0.05),
    }


def test_a_measured_machine_without_a_new_result_keeps_its_figures(arms: dict[str, ModuleType]) -> None:
    earlier = {"figures": {"EMPS, a": 1.0, "UR10, b": 2.0}, "named": {"emps, x": ["old(a)"]}}
    fresh = {"figures": {"EMPS, c": 3.0, "UR10e, d": 4.0}, "named": {"ur10e, y": ["payload(tool)"]}}
    found = arms["measured"].merged_machines(earlier, fresh)
    assert found["figures"] == {"UR10, b": 2.0, "EMPS, c": 3.0, "UR10e, d": 4.0}
    assert found["named"] == {"emps, x": ["old(a)"], "ur10e, y": ["payload(tool)"]}


# ---- Publishing ---------------------------------------------------------------------------------------------------------


def run_of(seeds: list[int], cases: list[dict[str, Any]], **about: Any) -> dict[str, Any]:
    """A result whose rows are those of its cases."""
    head = {"command": "x", "versions": {}, "machine": "m", "date": "2026-01-01"} | about
    own = {"seeds": seeds, "commits": ["0123456789ab"], **head}
    return {**head, "rows": {case["row"]: own for case in cases}, "cases": cases}


def cases_of(row: str, seeds: list[int]) -> list[dict[str, Any]]:
    return [{**CASE, "row": row, "case": f"{row}-{seed:03d}"} for seed in seeds]


CASE = {"variant": "", "outcome": "right", "wrong": [], "missed": [], "coarse": [], "errors": {}, "ratio": None, "spread": None}
CASE |= {"resonance": None, "tie": None, "planned": False, "wall_seconds": None, "reason": ""}


def test_a_row_that_is_published_leaves_the_others_as_they_were(arms: dict[str, ModuleType]) -> None:
    merged = arms["published"].merged
    earlier = run_of([120, 121], cases_of("arm", [120, 121]) + cases_of("poses", [120, 121]))
    fresh = run_of([120], cases_of("servo_sag", [120]) + cases_of("arm", [120]), command="y", date="2026-02-02")
    found = merged(earlier, fresh)
    assert [case["case"] for case in found["cases"]] == ["arm-120", "servo_sag-120", "poses-120", "poses-121"]
    assert found["rows"]["poses"] == earlier["rows"]["poses"]
    assert found["rows"]["arm"] == fresh["rows"]["arm"]
    assert (found["command"], found["date"]) == ("y", "2026-02-02")
    assert merged(None, fresh)["cases"] == fresh["cases"][1:] + fresh["cases"][:1]
    page = arms["page"].page_tables(found)
    assert "| `arm` | 120–120 | 1 | `0123456` | 2026-02-02 | `y` |" in page
    assert "| `poses` | 120–121 | 2 | `0123456` | 2026-01-01 | `x` |" in page


@pytest.mark.parametrize("seeds", [[120], list(range(100, 110)), list(range(121, 131)), list(range(120, 181))])
def test_seeds_that_are_not_the_published_ones_are_refused(arms: dict[str, ModuleType], seeds: list[int]) -> None:
    with pytest.raises(ValueError, match="expected --seeds 120:LAST, LAST from 129 to 179"):
        arms["published"].check_published(seeds, {})


def test_answers_of_code_that_no_commit_holds_are_not_published(arms: dict[str, ModuleType]) -> None:
    check, seeds = arms["published"].check_published, list(range(120, 130))
    check(seeds, {"arm": ["0123456789ab"]})
    for commits, text in ((["0123456789ab", "0123456789ab-dirty"], "commit 0123456789ab-dirty"), ([], "without a commit")):
        with pytest.raises(ValueError, match=text):
            check(seeds, {"arm": commits})


def test_an_answer_states_the_commit_of_its_code(arms: dict[str, ModuleType], tmp_path: Path) -> None:
    def git(*words: str) -> None:
        subprocess.run(["git", "-C", str(tmp_path), "-c", "user.name=a", "-c", "user.email=a@b", *words], check=True)

    commit_of = importlib.import_module("committed").commit_of
    assert commit_of(tmp_path) is None
    git("init", "--quiet")
    (tmp_path / "code.py").write_text("one\n", "utf-8")
    git("add", "code.py")
    git("commit", "--quiet", "--message", "one")
    commit = commit_of(tmp_path)
    assert re.fullmatch("[0-9a-f]{12}", commit)
    (tmp_path / "code.py").write_text("two\n", "utf-8")
    assert commit_of(tmp_path) == f"{commit}-dirty"
    for name, text in (("a", commit), ("b", None), ("c", commit)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "answer.json").write_text(json.dumps({"commit": text}), "utf-8")
    assert arms["runner"].commits_of([tmp_path / name for name in "abc"]) == [commit]


def test_wrong_rows_and_seeds_are_refused(arms: dict[str, ModuleType], pipeline: Callable[[str], ModuleType]) -> None:
    runner = pipeline("electric_arms")
    assert runner.seeds_of("3:5") == [3, 4, 5]
    with pytest.raises(ValueError, match="expected FIRST:LAST"):
        runner.seeds_of("3-5")
    with pytest.raises(ValueError, match="unknown row 'arms'"):
        runner.rows_of("arms")
