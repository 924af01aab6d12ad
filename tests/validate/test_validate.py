"""Figures that can be checked by hand, errors found where they were put, spikes explained by what caused them."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import combinations

import numpy as np
import numpy.typing as npt
import pytest
from crane_data import HIGH, JOINT_NOISE, LINKAGES, LOW, crane, dataset, motion, replaced
from hypothesis import given
from hypothesis import strategies as st

from sysid.datasets.recording import Dataset, Recording
from sysid.errors import ExcitationError, InputError
from sysid.networks import ActuatorNetwork, ForwardNetwork, Mlp, Normalisation
from sysid.networks.split import RowRange, gather, segments
from sysid.validate import error_metrics, validate_actuator, validate_forward, validate_model
from sysid.validate.error_analysis import direction_profile, profile, speeds, spikes

Array = npt.NDArray[np.float64]
SIGNALS = ("boom.cylinder", "boom.joint")


def piecewise(xs: Array, ys: Array) -> Mlp:
    """A perceptron that interpolates (xs, ys) exactly: one ReLU a kink; what a perfectly trained network would be."""
    slopes = np.diff(ys) / np.diff(xs)
    kinks = np.r_[slopes[0], np.diff(slopes)]
    unit = Normalisation(np.zeros(1), np.ones(1))
    # The first unit is active everywhere in use, so that the map goes on in a straight line below xs[0].
    shift = np.r_[xs[0] - 1e3, xs[1:-1]]
    start = ys[0] - slopes[0] * (xs[0] - shift[0])
    return Mlp((np.ones((1, len(kinks))), kinks[:, None]), (-shift, np.array([start])), unit, unit)


def exact(axis: str, joint_error: float = 0.0) -> ActuatorNetwork:
    """The true linkage of the test crane as a network, its joint off by ``joint_error`` [rad]."""
    linkage = LINKAGES[axis]
    joints = np.linspace(-0.43, 1.4, 400)
    displacements = linkage.displacement(joints)
    return ActuatorNetwork(
        axis,
        to_joint=piecewise(displacements, joints + joint_error),
        to_cylinder=piecewise(joints, displacements),
        displacements=(float(displacements[0]), float(displacements[-1])),
        joints=(-0.43, 1.4),
    )


def whole(recording: Recording) -> list[RowRange]:
    return [RowRange(recording, 0, len(recording))]


@pytest.fixture(scope="module")
def data() -> Dataset:
    return dataset()


def test_figures_by_hand() -> None:
    truth = np.zeros(5)
    metrics = error_metrics(truth, np.array([1.0, -1.0, 3.0, 0.0, 2.0]), "m")
    assert (metrics.count, metrics.unit) == (5, "m")
    assert metrics.rmse == pytest.approx(np.sqrt(3.0))
    assert (metrics.max, metrics.p50, metrics.bias) == (3.0, 1.0, 1.0)
    assert metrics.p95 == pytest.approx(2.8)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=50), st.floats(-10.0, 10.0))
def test_figures_are_ordered_and_a_shift_is_a_bias(errors: list[float], shift: float) -> None:
    metrics = error_metrics(np.zeros(len(errors)), np.array(errors), "m")
    assert metrics.p50 <= metrics.p95 <= metrics.p99 <= metrics.max + 1e-9
    assert abs(metrics.bias) <= metrics.rmse + 1e-9 <= metrics.max + 2e-9
    moved = error_metrics(np.full(len(errors), -shift), np.array(errors), "m")
    assert moved.bias == pytest.approx(metrics.bias + shift, abs=1e-9)


@pytest.mark.parametrize(
    ("truth", "predicted", "message"),
    [
        (np.zeros(3), np.zeros(2), r"shapes \(3,\) and \(2,\)"),
        (np.zeros(0), np.zeros(0), r"n > 0"),
        (np.zeros(2), np.array([0.0, np.nan]), r"NaN or infinite"),
    ],
)
def test_nothing_to_compare_is_an_error(truth: Array, predicted: Array, message: str) -> None:
    with pytest.raises(InputError, match=message):
        error_metrics(truth, predicted, "m")


def test_a_true_map_scores_the_noise_floor(data: Dataset) -> None:
    report = validate_actuator({"boom": exact("boom")}, data, name="crane-actuator@1")
    assert [(entry.output, entry.rows) for entry in report.outputs] == [
        (output, rows) for rows in ("motion", "poses") for output in ("boom.joint", "boom.cylinder")
    ]
    joint, cylinder = report.outputs[:2]
    assert (joint.output, joint.inputs, joint.unit) == ("boom.joint", ("boom.cylinder",), "rad")
    assert (cylinder.output, cylinder.inputs, cylinder.unit) == ("boom.cylinder", ("boom.joint",), "m")
    assert report.output("boom.joint", "poses").metrics.count == 30
    for output in (joint, cylinder):
        assert output.recordings == ("run-3",)
        assert output.noise_floor is not None
        assert output.metrics.rmse == pytest.approx(output.noise_floor, rel=0.1)
        assert output.baselines["polynomial, degree 3"].rmse > 1.5 * output.metrics.rmse
        assert output.baselines["nearest neighbour"].rmse > 1.2 * output.metrics.rmse
        assert not output.spikes
    assert report.round_trips["boom"].cylinder_max < 1e-9
    assert report.metrics()["boom.joint.motion.rmse"] == joint.metrics.rmse


def test_an_error_is_found_and_only_on_held_out_rows(data: Dataset) -> None:
    biased = validate_actuator({"boom": exact("boom", 0.01)}, data).output("boom.joint")
    assert biased.metrics.bias == pytest.approx(0.01, rel=0.02)
    off = replace(
        data,
        recordings=tuple(
            replaced(r, "boom.joint", r.values("boom.joint") + 0.01) if r.name == "run-1" else r for r in data.recordings
        ),
    )
    assert abs(validate_actuator({"boom": exact("boom")}, off).output("boom.joint").metrics.bias) < 1e-3


def test_a_report_is_plain_json(data: Dataset) -> None:
    report = validate_model({"boom": exact("boom")}, data)
    values = json.loads(json.dumps(report.to_json(), allow_nan=False))
    assert values["outputs"][0]["metrics"]["unit"] == "rad"
    assert values["role"] == "held_out"


def test_no_rows_of_the_role_is_an_error(data: Dataset) -> None:
    blind = replace(data, recordings=tuple(replaced(r, "boom.joint", np.nan) for r in data.recordings), splits={"run-1": "fit"})
    with pytest.raises(ExcitationError, match=r"no motion recording to fit that measures boom.joint"):
        validate_actuator({"boom": exact("boom")}, blind)


# --- the forward network


def test_the_forward_network_is_evaluated_on_poses_and_on_motion(data: Dataset) -> None:
    kinematics = crane().kinematics()
    assert kinematics is not None
    home = kinematics.tip_position(0.5 * (LOW + HIGH)[None])[0]
    constant = Mlp(
        (np.zeros((4, 3)),),
        (np.zeros(3),),
        Normalisation(np.zeros(4), np.ones(4)),
        Normalisation(home, np.ones(3)),
    )
    joints = tuple(f"{axis}.joint" for axis in ("slew", "boom", "stick", "telescope"))
    network = ForwardNetwork(
        joints=joints, revolute=(True, True, True, False), features="joints", members=(constant,), low=LOW, high=HIGH
    )
    report = validate_forward(network, data)
    assert [(entry.output, entry.rows) for entry in report.outputs] == [
        (f"ee.{letter}", rows) for rows in ("poses", "motion") for letter in "xyz"
    ]
    poses = report.output("ee.x", "poses")
    rows = gather(segments(data, "held_out", (*joints, "ee.x"), "poses"), (*joints, "ee.x"))
    assert poses.metrics.rmse == pytest.approx(np.sqrt(np.mean((home[0] - rows.values[:, 4]) ** 2)))
    assert poses.metrics.count == 30
    assert poses.baselines["URDF kinematics"].rmse < 1e-3 < poses.baselines["nearest neighbour"].rmse
    assert {p.variable for p in poses.profiles} == {
        *joints,
        "load of boom.joint",
        "load of stick.joint",
        "load of telescope.joint",
    }
    assert {frozenset(item.over) for item in poses.maps} <= set(map(frozenset, combinations(joints, 2)))
    assert sum(map(sum, poses.maps[0].count)) == 30
    motion_profiles = {p.variable for p in report.output("ee.x", "motion").profiles}
    assert {"slew.joint", "speed of slew.joint", "direction of telescope.joint"} <= motion_profiles
    assert report.output("ee.z", "motion").recordings == ("run-3",)


# --- where the errors are


def test_a_profile_finds_the_position_of_an_error() -> None:
    position = np.linspace(0.0, 1.0, 1200, endpoint=False)
    errors = np.where(position >= 0.75, 2.0, 0.0)
    found = profile(errors, position, "boom.cylinder", "m", bins=4)
    assert found.rmse == (0.0, 0.0, 0.0, 2.0)
    assert found.bias[3] == found.p95[3] == 2.0
    assert sum(found.count) == 1200
    assert profile(errors, np.where(position < 0.5, np.nan, position), "x", "m", bins=4).count == (150, 150, 150, 150)


def test_a_direction_profile_separates_the_ways() -> None:
    speed = np.r_[-np.ones(10), np.zeros(5), np.ones(20)]
    found = direction_profile(np.where(speed < 0, -3.0, 1.0), speed, "direction of boom.cylinder", "m/s")
    assert found.count == (10, 5, 20)
    assert found.bias == (-3.0, 1.0, 1.0)


def test_speed_is_the_slope_and_unknown_beside_gaps(data: Dataset) -> None:
    recording = data.recording("run-3")
    ramp = 0.01 * recording.values("time")
    ramp[1000:1020] = np.nan
    changed = dataset((replaced(recording, "boom.cylinder", ramp),), {"run-3": "fit"})
    rows = gather(whole(changed.recording("run-3")), ("boom.cylinder",))
    speed = speeds(changed, rows, "boom.cylinder")
    known = np.isfinite(speed)
    np.testing.assert_allclose(speed[known], 0.01)
    # Five rows at either end, and five on either side of the gap.
    np.testing.assert_array_equal(rows.row[~known], [*range(5), *range(995, 1000), *range(1020, 1025), *range(1995, 2000)])


def spiky(at: float, change: dict[str, Array] | None = None) -> tuple[Dataset, Recording]:
    """A triangle wave at mid-stroke that turns every 4 s, with a spike in the joint at ``at`` [s]."""
    recording = motion("run", 20.0)
    time = recording.values("time")
    cylinder = 0.05 + 0.005 * (2.0 * np.abs((time / 8.0) % 1.0 - 0.5) * 2.0 - 1.0)
    recording = replaced(recording, "boom.cylinder", cylinder)
    joint = LINKAGES["boom"].joint(cylinder) + np.random.default_rng(0).normal(0, JOINT_NOISE, len(time))
    joint[np.abs(time - at) < 0.02] += 0.05
    recording = replaced(recording, "boom.joint", joint)
    for signal, values in (change or {}).items():
        recording = replaced(recording, signal, values)
    return dataset((recording,), {"run": "held_out"}), recording


@pytest.mark.parametrize(
    ("at", "stroke", "fitted", "gap", "cause"),
    [
        (6.0, (0.0, 0.12), (0.0, 0.12), None, "unexplained"),
        (8.1, (0.0, 0.12), (0.0, 0.12), None, "reversal of boom.cylinder"),
        (8.0, (0.0, 0.0551), (0.0, 0.12), None, "upper end of boom.cylinder"),
        (4.0, (0.0449, 0.12), (0.0, 0.12), None, "lower end of boom.cylinder"),
        (6.0, (0.0, 0.12), (0.0, 0.12), 6.2, "edge of a gap in boom.joint"),
        (0.1, (-1.0, 0.12), (0.0, 0.12), None, "end of the recording"),
        (8.0, (0.0, 0.12), (0.0, 0.052), None, "boom.cylinder above the fitted range"),
    ],
)
def test_a_spike_is_explained_by_what_is_nearest(
    at: float, stroke: tuple[float, float], fitted: tuple[float, float], gap: float | None, cause: str
) -> None:
    data, recording = spiky(at)
    if gap is not None:
        time, joint = recording.values("time"), recording.values("boom.joint")
        data, recording = spiky(at, {"boom.joint": np.where(np.abs(time - gap) < 0.1, np.nan, joint)})
    rows = gather(whole(recording), SIGNALS)
    errors = LINKAGES["boom"].joint(rows.values[:, 0]) - rows.values[:, 1]
    (spike,) = spikes(data, rows, errors, {"boom.cylinder": stroke}, {"boom.cylinder": fitted}, is_motion=True)
    assert spike.cause == cause
    assert spike.recording == "run"
    assert spike.time == pytest.approx(at, abs=0.03)
    assert spike.error == pytest.approx(-0.05, abs=0.003)
    assert spike.sigmas > 50


def test_noise_alone_has_no_spikes() -> None:
    data, recording = spiky(at=-10.0)
    rows = gather(whole(recording), SIGNALS)
    errors = LINKAGES["boom"].joint(rows.values[:, 0]) - rows.values[:, 1]
    assert spikes(data, rows, errors, {}, {}, is_motion=True) == ()
