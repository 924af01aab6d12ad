"""Policies as versions: from a recipe to the registry and the command line, and what others do with them."""

from __future__ import annotations

import json
import sqlite3
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from crane_model import crane_plant
from training_case import recipe, trainer

from sysid.cli.app import app
from sysid.errors import InputError, SettingsError, StoreError
from sysid.model_versions import ModelVersions
from sysid.networks import FittedChain, StructuredForward, fit_chain, to_files
from sysid.networks.policy import PolicyNetwork, policy_from_files, policy_to_files
from sysid.plant import compile_plant
from sysid.registry.policy import load_policy
from sysid.versions import export_onnx
from sysid.workspace import Workspace, open_workspace
from sysid_rl.train.policy import CandidateSearchPolicy
from sysid_rl.train.reach import joint_limits, tips
from sysid_rl.train.recipe import load_training, parse_training
from sysid_rl.train.training import policy_of, train_policy

RECIPES = Path(__file__).parents[2] / "rl" / "autolog"
JOINTS = ("slew.joint", "boom.joint", "stick.joint", "telescope.joint")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """One with a plant and a forward model of the crane."""
    place = open_workspace(tmp_path_factory.mktemp("policies"))
    plant = crane_plant()
    low, high = joint_limits(plant)
    poses = np.random.default_rng(0).uniform(low, high, (300, 4))
    chain = fit_chain(poses, tips(compile_plant(plant), poses), (True, True, True, False))
    assert isinstance(chain, FittedChain)
    forward = StructuredForward(
        joints=JOINTS, revolute=(True, True, True, False), structure=chain, urdf="", members=(), bound=0.0, low=low, high=high
    )
    place.models.register("crane", "plant", plant.to_files(), {"dataset": "crane@1"})
    kind, files = to_files(forward)
    place.models.register("crane-forward", kind, files, {"dataset": "crane@1"})
    return place


@pytest.fixture
def policy() -> PolicyNetwork:
    return policy_of(trainer(recipe()))


def test_it_acts_as_the_actor_did(policy: PolicyNetwork) -> None:
    each = trainer(recipe())
    seen = each.environment.reset()
    np.testing.assert_allclose(policy.act(seen), each.greedy(seen), atol=1e-6)
    assert policy.inputs == (*JOINTS, "ee.x", "ee.y", "ee.z", "target.x", "target.y", "target.z")
    assert policy.outputs == JOINTS


def test_a_policy_acts_without_torch(policy: PolicyNetwork, tmp_path: Path) -> None:
    for name, content in policy_to_files(policy, {}).items():
        (tmp_path / name).write_bytes(content)
    program = (
        "import sys; from pathlib import Path; import sysid_rl.train.policy\n"
        "from sysid.networks.policy import policy_from_files\n"
        f"files = {{path.name: path.read_bytes() for path in Path({str(tmp_path)!r}).iterdir()}}\n"
        "policy_from_files(files, 'here').act([[0.0] * 10])\n"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


def test_setpoints_stay_within_their_limits_whatever_is_seen(policy: PolicyNetwork) -> None:
    wild = 1e3 * np.random.default_rng(0).standard_normal((200, 10))
    found = policy.act(wild)
    assert (found >= policy.low).all()
    assert (found <= policy.high).all()
    with pytest.raises(InputError, match=r"network input: shape \(1, 9\); expected \(n, 10\)"):
        policy.act(np.zeros((1, 9)))


def test_files_there_and_back(policy: PolicyNetwork) -> None:
    files = policy_to_files(policy, {"episodes": [], "evaluations": []})
    again = policy_from_files(files, "crane@1")
    seen = np.random.default_rng(0).standard_normal((50, 10))
    np.testing.assert_array_equal(again.act(seen), policy.act(seen))
    assert files == policy_to_files(again, {"episodes": [], "evaluations": []})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "forward"}, "forward of schema 1; expected a policy"),
        ({"layers": 5}, "not a policy"),
        ({"inputs": ["a"]}, "10 inputs and 4 outputs; expected 1 and 4 as named"),
        (None, "no file network.json"),
    ],
)
def test_what_is_no_policy_is_refused(policy: PolicyNetwork, change: dict[str, Any] | None, message: str) -> None:
    files = policy_to_files(policy, {})
    if change is None:
        del files["network.json"]
    else:
        files["network.json"] = json.dumps({**json.loads(files["network.json"]), **change}).encode()
    with pytest.raises(StoreError, match=message):
        policy_from_files(files, "crane@1")


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_onnx_parity(policy: PolicyNetwork, precision: str, tmp_path: Path) -> None:
    pytest.importorskip("onnx", reason="the extra onnx is not installed")
    runtime = pytest.importorskip("onnxruntime", reason="the extra onnx is not installed")
    (entry,) = export_onnx(policy, tmp_path / "out", {}, precision)  # type: ignore[arg-type]
    assert (entry.file, entry.inputs, entry.outputs) == ("policy.onnx", policy.inputs, policy.outputs)
    session = runtime.InferenceSession((tmp_path / "out" / entry.file).read_bytes(), providers=["CPUExecutionProvider"])
    dtype = np.float32 if precision == "float32" else np.float64
    seen = np.random.default_rng(1).uniform(-1.0, 1.0, (20, 10)).astype(dtype)
    (said,) = session.run(None, {"inputs": seen})
    np.testing.assert_allclose(said, policy.act(seen.astype(float)), atol=1e-5 if precision == "float32" else 1e-12)


def test_candidates_at_run_time_come_nearer() -> None:
    each = trainer(recipe())
    policy, seen = policy_of(each), each.environment.reset()
    searching = CandidateSearchPolicy(policy, each.environment.forward, candidates=60, sigma=0.3)
    wanted = each.environment.targets(seen)
    away = [np.linalg.norm(each.environment.forward.predict(one.act(seen)) - wanted, axis=1) for one in (searching, policy)]
    assert (away[0] <= away[1] + 1e-12).all()
    assert away[0].mean() < 0.9 * away[1].mean()
    assert (searching.act(seen) <= policy.high).all()


def test_from_a_recipe_to_a_version_and_never_twice(workspace: Workspace, tmp_path: Path) -> None:
    settings = recipe(name="once")
    done = train_policy(workspace.models, settings, tmp_path)
    assert (done.version.reference, done.version.kind) == ("once@1", "policy")
    assert not any(tmp_path.iterdir())
    lineage = done.version.lineage
    assert (lineage["plant"], lineage["forward"]) == ("crane@1", "crane-forward@1")
    assert parse_training(json.loads(json.dumps(lineage["recipe"])), "lineage") == settings
    again = train_policy(workspace.models, settings, tmp_path)
    assert again.version.reference == "once@1"
    assert again.updates_per_second is None
    other = train_policy(workspace.models, replace(settings, seed=1), tmp_path)
    assert other.version.reference == "once@2"
    policy = load_policy(workspace.models.load("once@1"))
    assert policy.outputs == JOINTS
    curves = json.loads(workspace.models.load("once@1").files["curves.json"])
    assert len(curves["episodes"]) == 15
    with pytest.raises(StoreError, match=r"model crane@1: is of kind 'plant'; expected a policy"):
        load_policy(workspace.models.load("crane@1"))


def test_card_lineage_and_export(workspace: Workspace, tmp_path: Path) -> None:
    pytest.importorskip("onnxruntime", reason="the extra onnx is not installed")
    train_policy(workspace.models, recipe(name="shown"), tmp_path / "work")
    versions = ModelVersions(workspace)
    text = versions.card("shown@1").markdown()
    assert "explored with the best of 3 candidates" in text
    assert "| made from | crane@1 | plant |" in text
    assert 'policy("shown@1")' in text
    assert {parent.reference for parent in versions.lineage("shown@1").parents} == {"crane@1", "crane-forward@1"}
    folder, files = versions.export("shown@1", tmp_path / "onnx")
    assert [entry.file for entry in files] == ["policy.onnx"]
    assert (folder / "policy.onnx").exists()


def test_a_policy_is_promoted_when_it_is_no_worse_than_the_one_in_use(workspace: Workspace) -> None:
    versions, files = ModelVersions(workspace), policy_to_files(policy_of(trainer(recipe())), {})
    for number, off in enumerate((0.010, 0.012, 0.008)):
        figures = {f"hold_rmse_{axis}": off for axis in "xyz"}
        workspace.models.register("rated", "policy", files, {"plant": "crane@1", "seed": number}, figures)
    workspace.models.register("rated", "policy", files, {"plant": "crane@1", "seed": 9}, {})
    assert versions.promote("rated@1").promoted
    refused = versions.promote("rated@2")
    assert not refused.promoted
    assert refused.checks[0].text == "error 20.78\u202fmm, rated@1 17.32\u202fmm"
    assert versions.promote("rated@3").promoted
    assert not versions.promote("rated@4").promoted
    assert workspace.models.find("rated").reference == "rated@3"


def test_the_command_line(workspace: Workspace, tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    path.write_text(
        'name = "cli"\nplant = "crane"\nforward = "crane-forward"\nevaluations = 2\n[setting]\ncopies = 4\n'
        "task = {steps = 10}\n"
        "[networks]\nactor = [8]\ncritic = [8]\n[learning]\nepisodes = 8\nbatch = 8\nstart = 8\n"
    )
    database = tmp_path / "mlflow.db"
    options = ["--workspace", str(workspace.folder), "train", str(path), "--seed", "5", "--json", str(tmp_path / "out.json")]
    result = CliRunner().invoke(app, [*options, "--mlflow", f"sqlite:///{database}"], catch_exceptions=False)
    assert result.exit_code == 0
    assert "cli@1" in result.output
    (found,) = json.loads((tmp_path / "out.json").read_text())["policies"]
    assert (found["policy"], found["seed"]) == ("cli@1", 5)
    lines = [json.loads(line) for line in (workspace.folder / "curves" / "cli-seed5.jsonl").read_text().splitlines()]
    assert [line["kind"] for line in lines].count("evaluation") == 2
    with sqlite3.connect(database) as connection:
        keys = {key for (key,) in connection.execute("select distinct key from metrics")}
    assert {"episode.return", "evaluation.hold_rmse_x"} <= keys


def test_candidates_at_run_time_have_a_row_of_their_own(workspace: Workspace, tmp_path: Path) -> None:
    train_policy(workspace.models, recipe(name="asked"), tmp_path / "training")
    words = ["--workspace", str(workspace.folder), "track", "asked", "--path", "circle"]
    words += ["--candidates", "50", "--scatter", "0.3"]
    words += ["--json", str(tmp_path / "out.json"), "--out", str(tmp_path / "run")]
    for more in ([], ["--full"]):
        assert CliRunner().invoke(app, [*words, *more], catch_exceptions=False).exit_code == 0
        own, searched = json.loads((tmp_path / "out.json").read_text("utf-8"))["rows"]
        assert (own["policy"], searched["policy"]) == ("asked@1", "asked@1 and 50 candidates")
        assert searched["distance_mm"]["rms"] < own["distance_mm"]["rms"]
    with pytest.raises(SettingsError, match=r"--candidates: with ik; expected a policy version"):
        CliRunner().invoke(app, [*words[:2], "track", "ik", "--candidates", "3"], catch_exceptions=False)


def test_a_workspace_that_is_not_there(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["--workspace", str(tmp_path / "none"), "train", str(RECIPES / "quick.toml")])
    assert isinstance(result.exception, SettingsError)
    assert "no such folder" in str(result.exception)


def test_the_recipes_are_the_papers() -> None:
    feedback, plain, quick = (load_training(RECIPES / f"{name}.toml") for name in ("feedback", "plain", "quick"))
    for each in (feedback, plain):
        learning = each.learning
        assert (learning.episodes, each.setting.task.steps, learning.buffer, learning.batch) == (1500, 1000, 1_000_000, 1024)
        assert (learning.discount, learning.tau, learning.actor_rate, learning.critic_rate) == (0.99, 1e-3, 1e-3, 1e-3)
        assert (each.exploration.sigma, each.setting.copies, each.total_steps) == (0.1, 1, 1_500_000)
    assert plain == replace(feedback, name=plain.name, exploration=replace(feedback.exploration, candidates=1))
    assert quick.exploration.candidates == feedback.exploration.candidates
    names = {"name": feedback.name, "plant": feedback.plant, "forward": feedback.forward}
    assert parse_training(names, "defaults") == feedback


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"learning": {"epsodes": 3}}, r"unknown key 'learning.epsodes'; expected 'episodes'\?"),
        ({"learning": {"discount": 1.5}}, r"learning.discount: 1.5; expected 0 to 1"),
        ({"learning": {"batch": 50, "buffer": 40}}, r"learning.batch: 50; expected 1 to 40"),
        ({"learning": {"actor_rate": 0.0}}, r"learning.actor_rate: 0; expected above zero"),
        ({"exploration": {"sigma_end": 0.2}}, r"exploration.sigma_end: 0.2; expected 0 to 0.1"),
        ({"setting": {"curriculum": 1.5}}, r"setting.curriculum: 1.5; expected 0 to 1"),
        ({"networks": {"actor": []}}, r"networks.actor: 0; expected above zero"),
        ({"setting": {"feedback": "plant"}}, r"setting.feedback: 'plant' without full; expected the full path"),
        ({"setting": {"repeat": 5}}, r"setting.repeat: 5 where joints follow at once; expected the full path"),
    ],
)
def test_impossible_recipes_say_why(values: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        parse_training({"name": "a", "plant": "b", "forward": "c", **values}, "r.toml")


def test_tensorboard_is_told(tmp_path: Path) -> None:
    pytest.importorskip("tensorboard", reason="the extra tensorboard is not installed")
    import warnings

    from sysid_rl.train.observers import TensorBoard

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the packages that it brings
        observer, settings = TensorBoard(tmp_path), recipe()
        with observer.opened(Path("small-seed0-abc"), trainer(settings)):
            observer.record("evaluation", 40, {"hold_max": 0.5})
        from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

        events = EventAccumulator(str(tmp_path / "small-seed0-abc"))
        events.Reload()
    (entry,) = events.Scalars("evaluation/hold_max")
    assert (entry.step, entry.value) == (40, 0.5)
