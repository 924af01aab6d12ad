"""CalibratedParameter kinematics: slopes, intervals, what no pose can tell apart, and the bounded network for the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from crane_data import HIGH, JOINT_NOISE, LOW, POINT_NOISE, crane, dataset, replaced
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import ExcitationError, InputError, SettingsError, StoreError
from sysid.machine import Machine
from sysid.networks import (
    Calibration,
    FittedChain,
    Geometry,
    StructuredForward,
    calibrate,
    fit_chain,
    fit_forward,
    from_files,
    parse_recipe,
    to_files,
)
from sysid.networks.structured import bounded

Array = npt.NDArray[np.float64]
ANGLES = (True, True, True, False)
RECIPE = parse_recipe({"forward": {"model": "structured", "residual": False}}, "test")
JOINTS, TIP = np.full(4, JOINT_NOISE), np.full(3, POINT_NOISE)


def geometry() -> Geometry:
    kinematics = crane().kinematics()
    assert kinematics is not None
    return Geometry(kinematics)


def taken(count: int, seed: int) -> Array:
    return np.random.default_rng(seed).uniform(LOW, HIGH, (count, 4))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10**6), size=st.floats(0.0, 3.0))
def test_slopes_are_those_of_the_tip(seed: int, size: float) -> None:
    model, q = geometry(), taken(5, seed)
    values = size * model.priors * np.random.default_rng(seed).standard_normal(len(model.priors))
    loads, step = model.loads(q, values), 1e-6

    def points(at: Array, changed: Array) -> Array:
        return model.points_at(at, changed, loads)

    rows = step * np.diag(model.priors)
    expected = np.stack([(points(q, values + r) - points(q, values - r)) / (2 * step) for r in rows], axis=3)
    np.testing.assert_allclose(model.point_slopes(q, values, loads) * model.priors, expected, atol=2e-6)
    expected = np.stack([(points(q + r, values) - points(q - r, values)) / (2 * step) for r in step * np.eye(4)], axis=3)
    np.testing.assert_allclose(model.joint_slopes(q, values, loads), expected, atol=2e-8)


def test_nothing_changed_is_the_urdf() -> None:
    model, q = geometry(), taken(50, 1)
    np.testing.assert_allclose(model.tip(q, np.zeros(len(model.priors))), model.kinematics.tip_position(q), atol=1e-14)


def test_intervals_hold_the_geometry_and_errors_have_the_stated_size() -> None:
    model, held, errors = geometry(), [], []
    for seed in range(12):
        rng = np.random.default_rng(seed)
        truth = 0.4 * model.priors * rng.standard_normal(len(model.priors)) * ~model.optional
        q = taken(60, seed)
        tip = model.tip(q, truth) + POINT_NOISE * rng.standard_normal((60, 3))
        found = calibrate(model, q + JOINT_NOISE * rng.standard_normal(q.shape), tip, JOINTS, TIP)
        true = dict(zip((parameter.key for parameter in model.parameters), truth, strict=True))
        held += [p.interval95[0] <= true[p.parameter.key] <= p.interval95[1] for p in found.parameters if p.identified]
        unseen = taken(100, 1000 + seed)
        errors.append((found.predict(unseen) - model.tip(unseen, truth)) / found.spread(unseen))
    assert 0.9 <= np.mean(held) <= 0.99
    assert 0.8 < np.sqrt(np.mean(np.square(errors))) < 1.25


def test_fifty_poses_are_enough_for_a_millimetre() -> None:
    model, rng = geometry(), np.random.default_rng(0)
    truth = 0.4 * model.priors * rng.standard_normal(len(model.priors)) * ~model.optional
    q, unseen = taken(50, 0), taken(1000, 1)
    tip = model.tip(q, truth) + POINT_NOISE * rng.standard_normal((50, 3))
    found = calibrate(model, q, tip, np.full(4, np.nan), TIP)
    assert np.abs(found.predict(unseen) - model.tip(unseen, truth)).max() < 1e-3
    assert found.noise == pytest.approx(POINT_NOISE, rel=0.25)


def test_mistaken_poses_hardly_count() -> None:
    model, rng, q = geometry(), np.random.default_rng(3), taken(80, 3)
    tip = model.kinematics.tip_position(q) + POINT_NOISE * rng.standard_normal((80, 3))
    tip[::16] += 0.2
    found = calibrate(model, q, tip, JOINTS, TIP)
    unseen = taken(200, 4)
    assert np.abs(found.predict(unseen) - model.kinematics.tip_position(unseen)).max() < 3e-3


def test_what_no_pose_tells_apart_is_named() -> None:
    """Boom and stick turn about parallel axes, slew and base share one: only sums of these matter."""
    model, q = geometry(), taken(200, 5)
    found = calibrate(model, q, model.kinematics.tip_position(q), JOINTS, TIP)
    groups = [{key for key, _ in combination} for combination in found.non_identifiable]
    assert {"slew_joint.z", "boom_joint.z"} in groups
    assert {"telescope_joint.offset", "tip.x"} in groups
    for combination in found.non_identifiable:  # the tip stays where it is when such a combination is added
        values = np.zeros(len(model.priors))
        for key, weight in combination:
            values[[p.key for p in model.parameters].index(key)] = 0.01 * weight
        moved = model.tip(q, values) - model.kinematics.tip_position(q)
        assert np.abs(moved).max() < 0.05 * 0.01 * max(abs(weight) for _, weight in combination)
    unknown = {p.parameter.key for p in found.parameters if not p.identified}
    assert {"slew_joint.z", "boom_joint.z", "tip.x"} <= unknown
    assert "slew_joint.x" not in unknown


def test_too_few_poses_are_refused() -> None:
    model, q = geometry(), taken(9, 0)
    with pytest.raises(ExcitationError, match="calibration: 9 poses; expected at least 10"):
        calibrate(model, q, model.kinematics.tip_position(q), JOINTS, TIP)


@pytest.fixture(scope="module")
def data() -> Dataset:
    return dataset()


def test_a_recipe_may_ask_for_the_structured_model(data: Dataset) -> None:
    model = fit_forward(data, RECIPE)
    assert isinstance(model, StructuredForward)
    assert model.members == ()
    q = taken(200, 7)
    kinematics = crane().kinematics()
    assert kinematics is not None
    assert np.abs(model.predict(q) - kinematics.tip_position(q)).max() < 1e-3
    with pytest.raises(InputError, match=r"3 joint values; expected 4: slew\.joint"):
        model.predict(q[:, :3])


def test_files_bring_back_the_same_model(data: Dataset) -> None:
    model = fit_forward(data, RECIPE)
    kind, files = to_files(model)
    again = from_files(files, "crane-forward@1")
    assert kind == "forward"
    assert isinstance(again, StructuredForward)
    q = taken(20, 8)
    np.testing.assert_array_equal(again.predict(q), model.predict(q))
    np.testing.assert_array_equal(again.spread(q), model.spread(q))
    assert isinstance(again.structure, Calibration)
    assert isinstance(model.structure, Calibration)
    assert again.structure.non_identifiable == model.structure.non_identifiable
    assert to_files(again) == (kind, files)
    other = files["network.json"].replace(b'"telescope_joint.scale"', b'"wrist_joint.scale"')
    with pytest.raises(StoreError, match="parameters of its URDF"):
        from_files({**files, "network.json": other}, "crane-forward@1")


@pytest.mark.slow
def test_a_marker_of_the_recipe_is_placed_on_its_link(data: Dataset) -> None:
    machine = replace(data.machine, markers={"elbow": "stick"})
    kinematics = machine.kinematics()
    assert kinematics is not None
    place = np.array([0.05, 0.02, -0.03, 1.0])

    def seen(recording: Recording) -> Recording:
        q = np.column_stack([recording.values(f"{axis}.joint") for axis in ("slew", "boom", "stick", "telescope")])
        points = (kinematics.link_poses(q)["stick"] @ place)[:, :3]
        for number, letter in enumerate("xyz"):
            recording = replaced(recording, f"elbow.{letter}", points[:, number])
        return recording

    recordings = tuple(seen(r) if r.kind == "poses" else r for r in data.recordings)
    model = fit_forward(replace(data, machine=machine, recordings=recordings), RECIPE)
    assert isinstance(model, StructuredForward)
    assert isinstance(model.structure, Calibration)
    found = {each.parameter.key: each for each in model.structure.parameters}
    for letter, value in zip("xy", place, strict=False):
        assert found[f"elbow.{letter}"].value == pytest.approx(value, abs=4.0 * found[f"elbow.{letter}"].deviation)
    again = from_files(to_files(model)[1], "crane-forward@1")
    assert isinstance(again, StructuredForward)
    assert isinstance(again.structure, Calibration)
    assert again.structure.geometry.markers == {"elbow": "stick"}
    assert again.structure.models == model.structure.models


def bent(data: Dataset, size: float) -> Dataset:
    """The same poses with a tip that sags with reach, as a stick under load does."""

    def sag(recording: object) -> Array:
        q = np.column_stack([recording.values(f"{axis}.joint") for axis in ("slew", "boom", "stick", "telescope")])  # type: ignore[attr-defined]
        return size * (np.cos(q[:, 1]) + np.cos(q[:, 1] + q[:, 2]) ** 3)

    return replace(
        data,
        recordings=tuple(replaced(r, "ee.z", r.values("ee.z") - sag(r)) if r.kind == "poses" else r for r in data.recordings),
    )


def test_a_network_carries_what_no_geometry_explains_and_only_that(data: Dataset) -> None:
    training = {"epochs": 40, "batch": 64, "learning_rate": 1e-2}
    asked = parse_recipe({"forward": {"model": "structured", "training": training}}, "test")
    straight, sagging = fit_forward(data, asked), fit_forward(bent(data, 0.02), asked)
    assert isinstance(straight, StructuredForward)
    assert isinstance(sagging, StructuredForward)
    assert straight.members == ()
    assert len(sagging.members) == 1
    plain = replace(sagging, members=())
    q = taken(500, 9)
    kinematics = crane().kinematics()
    assert kinematics is not None
    truth = kinematics.tip_position(q)
    truth[:, 2] -= 0.02 * (np.cos(q[:, 1]) + np.cos(q[:, 1] + q[:, 2]) ** 3)
    error, without = (np.sqrt(np.mean((model.predict(q) - truth) ** 2)) for model in (sagging, plain))
    assert error < 0.6 * without
    assert np.abs(sagging.predict(10.0 * q) - plain.predict(10.0 * q)).max() <= sagging.bound


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1.0))
def test_a_bound_is_one(value: float, bound: float) -> None:
    assert abs(bounded(np.array([value]), bound)[0]) <= bound


def test_without_a_urdf_there_is_nothing_to_calibrate(data: Dataset) -> None:
    bare: Machine = replace(data.machine, urdf_text=None)
    with pytest.raises(SettingsError, match=r"recipe: forward\.model = 'structured': machine 'crane' has no URDF"):
        fit_forward(replace(data, machine=bare), RECIPE)


# ---- Without a URDF -----------------------------------------------------------------------------------------------------


def test_any_open_chain_is_linear_in_products_of_its_joints() -> None:
    """Whatever the geometry, as long as angles are angles: with exact poses nothing is left but rounding."""
    model = geometry()
    rng = np.random.default_rng(2)
    values = model.priors * rng.standard_normal(len(model.priors))
    values[model.optional] = 0.0  # scales and compliances make other functions of the joints
    q, unseen = taken(200, 1), taken(200, 2)
    chain = fit_chain(q, model.tip(q, values), ANGLES)
    np.testing.assert_allclose(chain.predict(unseen), model.tip(unseen, values), atol=1e-5)


def test_a_chain_says_how_sure_it_is() -> None:
    model, rng, errors = geometry(), np.random.default_rng(4), []
    for seed in range(10):
        q, unseen = taken(150, seed), taken(300, 100 + seed)
        chain = fit_chain(q, model.kinematics.tip_position(q) + POINT_NOISE * rng.standard_normal((150, 3)), ANGLES)
        assert chain.noise == pytest.approx(POINT_NOISE, rel=0.3)
        errors.append((chain.predict(unseen) - model.kinematics.tip_position(unseen)) / chain.spread(unseen))
    assert 0.85 < np.sqrt(np.mean(np.square(errors))) < 1.15


def test_a_chain_needs_more_poses_than_products() -> None:
    model, q = geometry(), taken(72, 0)
    with pytest.raises(ExcitationError, match="72 poses for 53 products of joints; expected at least 73"):
        fit_chain(q, model.kinematics.tip_position(q), ANGLES)
    with pytest.raises(SettingsError, match="7 joints make 2186 products; expected at most 400"):
        fit_chain(np.zeros((3000, 7)), np.zeros((3000, 3)), (True,) * 7)


def test_a_recipe_may_ask_for_the_chain_of_a_machine_without_a_urdf(data: Dataset) -> None:
    bare = replace(data, machine=replace(data.machine, urdf_text=None))
    recipe = parse_recipe({"forward": {"model": "chain", "residual": False}}, "test")
    model = fit_forward(bare, recipe)
    assert isinstance(model, StructuredForward)
    assert isinstance(model.structure, FittedChain)
    q = taken(300, 7)
    kinematics = crane().kinematics()
    assert kinematics is not None
    assert np.sqrt(np.mean((model.predict(q) - kinematics.tip_position(q)) ** 2)) < 1e-3
    again = from_files(to_files(model)[1], "crane-forward@1")
    assert isinstance(again, StructuredForward)
    np.testing.assert_array_equal(again.predict(q), model.predict(q))
    np.testing.assert_array_equal(again.spread(q), model.spread(q))
