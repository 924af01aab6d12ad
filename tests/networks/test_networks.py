"""Actuator and forward networks on a crane whose linkages and kinematics are known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from crane_data import HIGH, LINKAGES, LOW, crane, dataset, motion, poses, replaced
from hypothesis import given
from hypothesis import strategies as st

from sysid.datasets import ingest
from sysid.datasets.recording import Dataset
from sysid.errors import ExcitationError, InputError, SettingsError, StoreError
from sysid.machine import CylinderJointMap, tabulate
from sysid.networks import (
    ActuatorNetwork,
    ForwardNetwork,
    NetworkRecipe,
    fit_actuator,
    fit_forward_network,
    from_files,
    load_recipe,
    parse_recipe,
    to_files,
)
from sysid.networks.actuator import actuator_rows
from sysid.networks.forward import feature_names, forward_rows
from sysid.networks.recipe import PAPER_ACTUATOR_TRAINING
from sysid.networks.split import gather, segments, stratified_sample
from sysid.validate import validate_model

QUICK = parse_recipe(
    {
        "actuator": {"hidden_of": {"boom": [32, 32], "stick": [32, 32]}, "training": {"learning_rate": 3e-3, "epochs": 60}},
        "forward": {"hidden": [64, 32], "training": {"epochs": 60}},
    },
    "test",
)


@pytest.fixture(scope="module")
def data() -> Dataset:
    return dataset()


@pytest.fixture(scope="module")
def actuators(data: Dataset) -> dict[str, ActuatorNetwork]:
    return fit_actuator(data, QUICK)


@pytest.fixture(scope="module")
def forward(data: Dataset) -> ForwardNetwork:
    return fit_forward_network(data, QUICK)


def test_actuator_networks_learn_both_linkages_both_ways(actuators: dict[str, ActuatorNetwork]) -> None:
    assert list(actuators) == ["boom", "stick"]
    for axis, network in actuators.items():
        linkage: CylinderJointMap = LINKAGES[axis]
        low, high = network.displacements
        inner = np.linspace(low + 0.1 * (high - low), high - 0.1 * (high - low), 200)
        angle_range = np.ptp(linkage.joint(inner))
        assert np.abs(network.joint(inner) - linkage.joint(inner)).max() < 0.02 * angle_range
        joints = linkage.joint(inner)
        assert np.abs(network.displacement(joints) - inner).max() < 0.02 * (high - low)
        assert network.round_trip().cylinder_rmse < 0.02 * (high - low)


def test_an_actuator_network_is_a_linkage(actuators: dict[str, ActuatorNetwork]) -> None:
    mapping: CylinderJointMap = actuators["boom"]
    assert mapping.joint(np.zeros((2, 3)) + 0.05).shape == (2, 3)
    table = tabulate(mapping, (0.02, 0.08))
    np.testing.assert_allclose(table.displacement(table.joint(np.array([0.03, 0.05]))), [0.03, 0.05], atol=1e-6)


def test_the_forward_network_learns_the_kinematics(forward: ForwardNetwork, data: Dataset) -> None:
    q = np.random.default_rng(5).uniform(LOW, HIGH, (200, 4))
    kinematics = crane().kinematics()
    assert kinematics is not None
    truth = kinematics.tip_position(q)
    error = forward.predict(q) - truth
    assert np.sqrt((error**2).mean()) < 0.15 * truth.std()
    assert forward.joints == ("slew.joint", "boom.joint", "stick.joint", "telescope.joint")
    assert forward.revolute == (True, True, True, False)
    assert not forward.spread(q).any()
    with pytest.raises(InputError, match=r"3 joint values; expected 4: slew.joint"):
        forward.predict(q[:, :3])


def test_sine_and_cosine_inputs_and_several_members(data: Dataset) -> None:
    recipe = parse_recipe({"forward": {"features": "sincos", "members": 2, "training": {"epochs": 20}}}, "test")
    network = fit_forward_network(data, recipe)
    q = np.random.default_rng(6).uniform(LOW, HIGH, (20, 4))
    turned = q + np.array([2 * np.pi, -2 * np.pi, 0.0, 0.0])
    np.testing.assert_allclose(network.predict(q), network.predict(turned), atol=1e-9)
    assert len(network.members) == 2
    assert network.spread(q).min() > 0.0
    np.testing.assert_allclose(
        network.predict(q), 0.5 * sum(replace(network, members=(m,)).predict(q) for m in network.members)
    )


def test_products_of_sines_and_cosines_and_smooth_rectifiers(data: Dataset) -> None:
    """What the tip is made of goes in, and the network has no corners: more accurate from the same poses, in less training."""
    training = {"epochs": 60, "batch": 32}
    plain, better = (
        fit_forward_network(data, parse_recipe({"forward": {**own, "training": training}}, "test"))
        for own in ({}, {"features": "products", "rectifier": "smooth"})
    )
    kinematics = crane().kinematics()
    assert kinematics is not None
    q = np.random.default_rng(5).uniform(LOW, HIGH, (500, 4))
    errors = [float(np.sqrt(np.mean((model.predict(q) - kinematics.tip_position(q)) ** 2))) for model in (plain, better)]
    assert errors[1] < 0.6 * errors[0]
    again = from_files(to_files(better)[1], "crane-forward@1")
    assert isinstance(again, ForwardNetwork)
    assert again.members[0].rectifier == "smooth"
    np.testing.assert_array_equal(again.predict(q), better.predict(q))
    assert feature_names(("a", "b"), (True, False), "products") == ("b", "sin(a)", "sin(a)·b", "cos(a)", "cos(a)·b")
    _, files = to_files(better)
    other = files["network.json"].replace(b'"smooth"', b'"smoth"')
    with pytest.raises(StoreError, match=r"crane-forward@1: rectifier 'smoth'; .*smooth"):
        from_files({**files, "network.json": other}, "crane-forward@1")


def test_only_fit_and_select_rows_matter(data: Dataset, actuators: dict[str, ActuatorNetwork], forward: ForwardNetwork) -> None:
    """A held-out recording that says something else changes not one bit of what is learned."""
    changed = replace(
        data,
        recordings=tuple(
            replaced(r, "boom.joint", 0.0)
            if r.name == "run-3"
            else replaced(r, "ee.x", np.r_[r.values("ee.x")[:-30], np.zeros(30)])
            if r.kind == "poses"
            else r
            for r in data.recordings
        ),
    )
    assert to_files(fit_actuator(changed, QUICK)) == to_files(actuators)
    assert to_files(fit_forward_network(changed, QUICK)) == to_files(forward)


def test_the_seed_decides(data: Dataset, actuators: dict[str, ActuatorNetwork]) -> None:
    assert to_files(fit_actuator(data, replace(QUICK, seed=1))) != to_files(actuators)


def test_files_bring_back_the_same_network(actuators: dict[str, ActuatorNetwork], forward: ForwardNetwork) -> None:
    displacement = np.linspace(0.0, 0.1, 50)
    kind, files = to_files(actuators)
    loaded = from_files(files, "crane-actuator@1")
    assert kind == "actuator"
    assert isinstance(loaded, dict)
    np.testing.assert_array_equal(loaded["stick"].joint(displacement), actuators["stick"].joint(displacement))
    assert loaded["boom"].learning_curves["to_joint"].to_json() == actuators["boom"].learning_curves["to_joint"].to_json()
    kind, files = to_files(forward)
    again = from_files(files, "crane-forward@1")
    assert kind == "forward"
    assert isinstance(again, ForwardNetwork)
    q = np.random.default_rng(0).uniform(LOW, HIGH, (10, 4))
    np.testing.assert_array_equal(again.predict(q), forward.predict(q))
    assert to_files(again) == to_files(forward)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"network.json": None}, r"m@1: no file network.json"),
        ({"weights.safetensors": b"\x00" * 7}, r"m@1: not a network \(SafetensorError"),
        ({"network.json": b"{"}, r"m@1: not a network \(JSONDecodeError"),
        ({"network.json": b'{"schema": 1, "kind": "forward"}'}, r"not a network \(KeyError: 'members'"),
        ({"network.json": b'{"schema": 9, "kind": "forward"}'}, r"schema 9; expected schema 1"),
    ],
)
def test_damaged_files_are_refused(forward: ForwardNetwork, change: dict[str, bytes | None], message: str) -> None:
    files = {**to_files(forward)[1], **change}
    with pytest.raises(StoreError, match=message):
        from_files({name: content for name, content in files.items() if content is not None}, "m@1")


def test_layers_that_do_not_fit_are_refused(forward: ForwardNetwork) -> None:
    mlp = forward.members[0]
    broken = replace(mlp, weights=(mlp.weights[0], mlp.weights[0], mlp.weights[2]))
    with pytest.raises(StoreError, match=r"member.0: layer 1 of shape \(4, 64\); expected \(64, …\)"):
        from_files(to_files(replace(forward, members=(broken,)))[1], "m@1")


# --- rows


def test_rows_come_from_the_recordings_of_a_role(data: Dataset) -> None:
    both_fit, both_select = actuator_rows(data, "boom", NetworkRecipe())
    assert set(both_fit.recording) == {"run-1", "poses"}
    assert set(both_select.recording) == {"run-2", "poses"}
    poses_rows = {role: rows.row[rows.recording == "poses"] for role, rows in (("fit", both_fit), ("select", both_select))}
    assert poses_rows["fit"].max() < 240 <= poses_rows["select"].min()
    assert poses_rows["select"].max() < 270
    fit, select = actuator_rows(data, "boom", parse_recipe({"actuator": {"rows": ["motion"]}}, "test"))
    assert set(fit.recording) == {"run-1"}
    assert set(select.recording) == {"run-2"}
    assert len(fit) == len(both_fit) == 1500
    assert np.isfinite(fit.values).all()
    # The operator dwells near the turning points; the sample must not.
    counts, _ = np.histogram(fit.values[:, 0], bins=10)
    every = gather(segments(data, "fit", fit.signals), fit.signals)
    all_counts, _ = np.histogram(every.values[:, 0], bins=10)
    assert counts.max() / counts.min() < 0.7 * all_counts.max() / all_counts.min()


def test_blocks_stand_in_for_missing_roles() -> None:
    single = dataset((motion("only", 30.0),), {"only": "fit"})
    signals = ("boom.cylinder", "boom.joint")
    rows = {role: gather(segments(single, role, signals), signals) for role in ("fit", "select", "held_out")}
    assert rows["fit"].time.max() + 1.0 <= rows["select"].time.min() + 0.02
    assert rows["select"].time.max() + 1.0 <= rows["held_out"].time.min() + 0.02
    assert rows["held_out"].time.max() == pytest.approx(29.99)
    poses_rows = {role: forward_rows(dataset(), role) for role in ("fit", "select", "held_out")}
    assert [len(rows) for rows in poses_rows.values()] == [240, 30, 30]
    assert poses_rows["fit"].row.max() < poses_rows["select"].row.min() < poses_rows["held_out"].row.min()


@given(
    values=st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=300), count=st.integers(1, 300), seed=st.integers(0, 2**32 - 1)
)
def test_a_spread_sample_has_distinct_rows_of_the_asked_number(values: list[float], count: int, seed: int) -> None:
    chosen = stratified_sample(np.array(values), count, np.random.default_rng(seed))
    assert len(chosen) == min(count, len(values))
    assert len(set(chosen.tolist())) == len(chosen)
    assert (np.diff(chosen) > 0).all()


def test_a_spread_sample_takes_all_rare_rows() -> None:
    values = np.r_[np.zeros(1000), np.linspace(0.1, 1.0, 50)]
    chosen = stratified_sample(values, 200, np.random.default_rng(0))
    assert set(range(1000, 1050)) <= set(chosen.tolist())


def test_still_phases_stand_in_for_poses() -> None:
    """Without a calibration routine, each pause of the operator is one pose: its mean, and no row of the motion between."""
    rng = np.random.default_rng(0)
    targets = rng.uniform(LOW, HIGH, (120, 4))
    share = np.clip(np.arange(120 * 100) % 100 / 50.0, 0, 1)[:, None]  # half a second of motion, half a second still
    before, after = np.repeat(targets, 100, axis=0), np.repeat(np.roll(targets, -1, axis=0), 100, axis=0)
    q = before + share * (after - before)
    kinematics = crane().kinematics()
    assert kinematics is not None
    recording = motion("pauses", 120.0)
    for number, axis in enumerate(("slew", "boom", "stick", "telescope")):
        recording = replaced(recording, f"{axis}.joint", q[:, number] + rng.normal(0, 1e-5, len(q)))
    tip = kinematics.tip_position(q) + rng.normal(0, 3e-4, (len(q), 3))
    for number, letter in enumerate("xyz"):
        recording = replaced(recording, f"ee.{letter}", tip[:, number])
    rows = forward_rows(dataset((recording,), {"pauses": "fit"}), "fit")
    distance = np.abs(rows.values[:, None, :4] - targets[None]).max(axis=2).min(axis=1)
    assert 75 <= len(rows) <= 90
    assert distance.max() < 0.05
    assert np.median(distance) < 1e-3


def without(data: Dataset, *signals: str) -> Dataset:
    return replace(
        data, recordings=tuple(replace(r, table=r.table.drop(columns=list(signals), errors="ignore")) for r in data.recordings)
    )


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (lambda d: without(d, "boom.joint", "stick.joint"), r"crane@1: no axis with both <axis>.cylinder and <axis>.joint"),
        (lambda d: replace(d, splits={"run-3": "held_out"}), r"no motion recording to fit that measures boom.cylinder"),
        (
            lambda d: dataset((replaced(motion("run-1", 20.0), "boom.cylinder", 0.05), *d.recordings[1:3]), dict(d.splits)),
            r"network boom to_joint: boom.cylinder is constant \(0.05\)",
        ),
        (
            lambda d: dataset((motion("run-1", 0.5), *d.recordings[1:]), dict(d.splits)),
            r"axis 'boom': \d+ fit rows with both cylinder and joint; expected at least 100",
        ),
    ],
)
def test_unusable_data_for_an_actuator_are_refused(data: Dataset, broken, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ExcitationError, match=message):
        fit_actuator(broken(data), QUICK)


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (lambda d: dataset((poses(count=20),), {}), r"16 static poses to fit; expected at least 30. Record the calibration"),
        (lambda d: without(d, "ee.y"), r"no poses recording to fit that measures ee.y; expected at least one with all of"),
        (lambda d: dataset((replaced(poses(), "slew.joint", 0.3),), {}), r"network forward: slew.joint is constant"),
    ],
)
def test_unusable_data_for_the_forward_network_are_refused(data: Dataset, broken, message: str) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(ExcitationError, match=message):
        fit_forward_network(broken(data), QUICK)


# --- recipe


def test_the_default_recipe_is_that_of_the_paper_but_for_its_schedule() -> None:
    recipe = load_recipe()
    assert recipe.actuator.layers("boom") == (256, 128, 128)
    assert recipe.actuator.layers("stick") == (128, 128)
    assert PAPER_ACTUATOR_TRAINING.learning_rate == 1e-4
    assert recipe.actuator.training.epochs * 5 <= PAPER_ACTUATOR_TRAINING.epochs
    assert recipe.actuator.samples == 1500
    assert recipe.forward.hidden == (256, 128)
    assert recipe.forward.poses == 500
    assert recipe.forward.features == "joints"
    assert recipe.forward.members == 1
    assert parse_recipe(recipe.to_json(), "again") == recipe


@pytest.mark.slow
def test_the_default_schedule_reaches_the_errors_of_the_paper_s(tmp_path: Path, datasets_folder: Path) -> None:
    dataset, default = ingest(datasets_folder / "autolog", tmp_path), load_recipe()
    paper = replace(default, actuator=replace(default.actuator, training=PAPER_ACTUATOR_TRAINING))
    ours, theirs = (validate_model(fit_actuator(dataset, recipe), dataset).metrics() for recipe in (default, paper))
    ratios = [ours[key] / theirs[key] for key in ours if key.endswith("motion.rmse")]
    assert len(ratios) == 4
    assert max(ratios) < 1.05


def test_a_recipe_overrides_single_keys(tmp_path: Path) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text("schema = 1\n[actuator.training]\nepochs = 7\n[actuator.hidden_of]\nbucket = [8]\n")
    recipe = load_recipe(path)
    assert recipe.actuator.training == replace(NetworkRecipe().actuator.training, epochs=7)
    assert recipe.actuator.layers("bucket") == (8,)
    assert recipe.actuator.layers("boom") == (256, 128, 128)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[forward]\nfeature = 'sincos'", r"unknown key 'forward.feature'; expected 'features'\?"),
        (
            "[forward]\nfeatures = 'cosine'",
            r"forward.features = 'cosine'; expected 'joints', 'sincos' or 'products'",
        ),
        ("[actuator.training]\nepochs = 0", r"actuator.training: epochs = 0; expected a positive number"),
        ("[actuator]\nrows = ['poses']", r"actuator.rows: \['poses'\]; expected motion, with or without poses"),
        ("[actuator]\nsamples = 0", r"actuator.samples: 0; expected a positive number"),
        ("seed = -1", r"seed: -1"),
    ],
)
def test_mistakes_in_a_recipe_are_explained(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "recipe.toml"
    path.write_text(text)
    with pytest.raises(SettingsError, match=message):
        load_recipe(path)


def test_an_axis_that_does_not_exist_is_explained(data: Dataset) -> None:
    with pytest.raises(SettingsError, match=r"unknown axis 'bom'; expected 'boom'\?"):
        fit_actuator(data, parse_recipe({"actuator": {"hidden_of": {"bom": [8]}}}, "test"))
