"""Actuator networks with history on a lift with play: what they learn, how they run, and what they refuse."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from lift_motion import LINKAGE, RATE, dataset, lift, play, with_roles
from numpy.typing import NDArray

from sysid.datasets.recording import Dataset
from sysid.errors import ExcitationError, InputError, SettingsError, StoreError
from sysid.networks import HistoryNetwork, fit_history, from_files, parse_recipe, to_files
from sysid.networks.history import recording_windows
from sysid.networks.history_correction import HistoryCorrection
from sysid.networks.split import RowRange
from sysid.plant import nominal_plant
from sysid.validate import validate_model
from sysid.validate.validation import STATIC

Array = NDArray[np.float64]

#: Full play between cylinder and joint [m]: a hundredth of the stroke.
WIDTH = 0.002
ACTUATOR = {
    "model": "history",
    "rows": ["motion"],
    "samples": 400,
    "hidden_of": {"boom": [24, 24]},
    "training": {"learning_rate": 5e-3, "epochs": 60},
    "history": {"units": 6, "epochs": 60, "interval": 0.1},
}
FULL = parse_recipe({"actuator": ACTUATOR}, "test")
QUICK = parse_recipe(
    {"actuator": ACTUATOR | {"history": {"units": 4, "epochs": 20, "check_every": 5, "interval": 0.1}}}, "test"
)
SHORT = parse_recipe({"actuator": ACTUATOR | {"history": {"units": 4, "epochs": 4, "check_every": 2}}}, "test")


@pytest.fixture(scope="module")
def data() -> Dataset:
    return dataset(WIDTH)


@pytest.fixture(scope="module")
def network(data: Dataset) -> HistoryNetwork:
    return fit_history(data, QUICK)["boom"]


def rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def test_the_correction_is_active_after_few_epochs(data: Dataset, network: HistoryNetwork) -> None:
    run = data.recording("run-3")
    cylinder, joint = run.values("boom.cylinder"), run.values("boom.joint")
    assert not network.to_joint.inactive
    assert rms(network.joint_along(cylinder, RATE) - joint) < 0.8 * rms(network.static.joint(cylinder) - joint)


@pytest.mark.slow
def test_it_models_the_backlash_that_a_static_map_averages(data: Dataset) -> None:
    network = fit_history(data, FULL)["boom"]
    run = data.recording("run-3")
    cylinder, joint = run.values("boom.cylinder"), run.values("boom.joint")
    static, history = network.static.joint(cylinder) - joint, network.joint_along(cylinder, RATE) - joint
    assert rms(history) < 0.5 * rms(static)
    still, along = network.static.displacement(joint) - cylinder, network.displacement_along(joint, RATE) - cylinder
    assert rms(along) < 0.8 * rms(still)
    trip = network.round_trip(cylinder, joint, RATE)
    assert trip.joint_rmse < 0.5 * WIDTH / np.ptp(cylinder) * np.ptp(joint)
    assert trip.cylinder_rmse < 0.5 * WIDTH


@pytest.mark.slow
def test_without_backlash_it_is_no_worse() -> None:
    free = dataset(0.0)
    network = fit_history(free, FULL)["boom"]
    run = free.recording("run-3")
    cylinder, joint = run.values("boom.cylinder"), run.values("boom.joint")
    assert rms(network.joint_along(cylinder, RATE) - joint) < 1.02 * rms(network.static.joint(cylinder) - joint)
    still = rms(network.static.displacement(joint) - cylinder)
    assert rms(network.displacement_along(joint, RATE) - cylinder) < 1.02 * still


def test_a_correction_is_a_bounded_lstm_with_play_operators() -> None:
    """Against torch's own cell, and plays computed here."""
    import torch

    memory = random_memory()
    values = 0.1 + 0.05 * np.sin(np.linspace(0.0, 12.0, 200))
    stride, _ = memory.timing(RATE)
    at = np.arange(0, len(values), stride)
    speed = np.diff(values[at], prepend=values[0]) * RATE / stride
    shares = [(values - play(values, width))[at] / width for width in memory.widths]
    inputs = np.clip((np.column_stack([values[at], speed, *shares]) - memory.weights["mean"]) * memory.weights["scale"], -4, 4)
    cell = torch.nn.LSTM(inputs.shape[1], memory.units, batch_first=True, dtype=torch.float64)
    with torch.no_grad():
        for name, value in (("weight_ih_l0", "W"), ("weight_hh_l0", "U"), ("bias_ih_l0", "b")):
            getattr(cell, name).copy_(torch.from_numpy(memory.weights[value]))
        cell.bias_hh_l0.zero_()
        hidden = cell(torch.from_numpy(inputs)[None])[0][0].numpy()
    expected = memory.bound * np.tanh(hidden @ memory.weights["w"] + memory.weights["w0"])
    added = memory.output(values, RATE)
    np.testing.assert_allclose(added[at], expected, atol=1e-12)
    np.testing.assert_array_equal(added, np.repeat(added[at], stride)[: len(values)])
    np.testing.assert_allclose(memory.inputs(values, stride, stride / RATE)[:, 2:], np.column_stack(shares), atol=1e-9)


def test_samples_one_by_one_are_the_same_run(data: Dataset, network: HistoryNetwork) -> None:
    cylinder = data.recording("run-3").values("boom.cylinder")[:300].copy()
    cylinder[120:130] = np.nan
    stream = network.joint_stream(RATE)
    np.testing.assert_allclose([stream.step(value) for value in cylinder], network.joint_along(cylinder, RATE), atol=1e-12)
    stream.reset()
    assert stream.step(cylinder[0]) == pytest.approx(network.joint_along(cylinder, RATE)[0], abs=1e-12)


def test_a_gap_is_a_new_beginning(network: HistoryNetwork) -> None:
    """What came before a gap changes nothing behind it, and inside it nothing is said."""
    after = np.linspace(0.05, 0.15, 80)
    whole = np.r_[np.linspace(0.19, 0.02, 60), np.nan, np.nan, after]
    said = network.joint_along(whole, RATE)
    np.testing.assert_allclose(said[62:], network.joint_along(after, RATE), atol=1e-12)
    assert np.isnan(said[60:62]).all()


def test_sequences_stay_inside_recordings_blocks_and_gaps(data: Dataset, network: HistoryNetwork) -> None:
    run = data.recording("run-0")
    cylinder, joint = run.values("boom.cylinder").copy(), run.values("boom.joint").copy()
    cylinder[500:503] = np.nan
    joint[700:900] = np.nan
    holed = replace(run, table=run.table.assign(**{"boom.cylinder": cylinder, "boom.joint": joint}))
    memory = network.to_joint
    found = recording_windows([RowRange(holed, 100, 1200)], ("boom.cylinder", "boom.joint"), network.static.joint, memory)
    stride, _ = memory.timing(RATE)
    assert [len(windows.residual) for windows in found] == [400 // stride, (1200 - 503) // stride]
    for windows, begin in zip(found, (100, 503), strict=True):
        assert np.isfinite(windows.inputs).all()
        np.testing.assert_array_equal(windows.inputs[:, 0], cylinder[begin : begin + len(windows.residual) * stride : stride])
        assert windows.inputs[0, 1:].tolist() == [0.0] * (1 + len(memory.widths)), "nothing is known before"
    assert int(np.isnan(found[1].residual).sum()) == pytest.approx(200 / stride, abs=1), "passed through, not learned from"


def test_the_seed_decides_and_held_out_rows_do_not(data: Dataset) -> None:
    run = data.recording("run-3")
    changed = replace(run, table=run.table.assign(**{"boom.joint": 0.3}))
    others = with_roles(tuple(changed if r.name == "run-3" else r for r in data.recordings))
    one, two = to_files(fit_history(data, SHORT)), to_files(fit_history(others, SHORT))
    assert one == two
    assert one[0] == "history"
    assert to_files(fit_history(data, replace(SHORT, seed=1))) != one


def test_files_bring_back_the_same_network(network: HistoryNetwork) -> None:
    kind, files = to_files({"boom": network})
    again = from_files(files, "lift-history@1")
    assert kind == "history"
    assert isinstance(again, dict)
    assert isinstance(again["boom"], HistoryNetwork)
    motion = np.linspace(0.02, 0.18, 100)
    np.testing.assert_array_equal(again["boom"].joint_along(motion, RATE), network.joint_along(motion, RATE))
    assert to_files(again) == (kind, files)
    wrong = replace(network, to_joint=replace(network.to_joint, widths=network.to_joint.widths[:-1]))
    with pytest.raises(StoreError, match=r"boom\.to_joint\.memory\.mean: shape \(5,\); expected finite numbers of \(4,\)"):
        from_files(to_files({"boom": wrong})[1], "lift-history@1")


def test_a_plant_takes_the_static_part_and_refuses_the_whole(network: HistoryNetwork) -> None:
    with pytest.raises(SettingsError, match=r"network with history.*expected a static map. Hand over its `static` part"):
        nominal_plant(lift(), {"boom": network})  # type: ignore[dict-item]
    plant = nominal_plant(lift(), {"boom": network.static})
    np.testing.assert_allclose(plant.linkages["boom"].joint(np.array([0.1])), LINKAGE.joint(np.array([0.1])), atol=0.01)


def test_what_it_cannot_learn_from_or_run_at_is_refused(data: Dataset, network: HistoryNetwork) -> None:
    with pytest.raises(InputError, match=r"samples at 5 Hz; expected at least 10 Hz"):
        network.joint_along(np.zeros(3), 5.0)
    holes = np.arange(2000) % 12 == 0
    torn = tuple(
        replace(r, table=r.table.assign(**{"boom.cylinder": np.where(holes, np.nan, r.values("boom.cylinder"))}))
        for r in data.recordings
    )
    with pytest.raises(ExcitationError, match=r"axis 'boom' with history: no motion without gaps"):
        fit_history(with_roles(torn), SHORT)
    with pytest.raises(SettingsError, match=r"actuator.history: plays = \[2.0\]; expected shares of the range"):
        parse_recipe({"actuator": {"history": {"plays": [2.0]}}}, "test")
    with pytest.raises(SettingsError, match=r"actuator.history: interval = 0"):
        parse_recipe({"actuator": {"history": {"interval": 0}}}, "test")


def test_the_report_stands_beside_the_static_network_and_the_noise(data: Dataset, network: HistoryNetwork) -> None:
    report = validate_model({"boom": network}, data, recipe=QUICK, name="lift-history@1")
    assert report.kind == "history"
    assert [(entry.output, entry.rows) for entry in report.outputs] == [("boom.joint", "motion"), ("boom.cylinder", "motion")]
    joint = report.output("boom.joint")
    run = data.recording("run-3")
    cylinder, truth = run.values("boom.cylinder"), run.values("boom.joint")
    assert joint.metrics.rmse == pytest.approx(rms(network.joint_along(cylinder, RATE) - truth))
    assert joint.baselines[STATIC].rmse == pytest.approx(rms(network.static.joint(cylinder) - truth))
    assert joint.noise_floor is not None
    assert joint.noise_floor == pytest.approx(2.5e-4, rel=0.5)
    assert any(profile.variable == "direction of boom.cylinder" for profile in joint.profiles)
    assert report.round_trips["boom"].cylinder_rmse < WIDTH


def random_memory(units: int = 3, widths: tuple[float, ...] = (0.002, 0.01)) -> HistoryCorrection:
    rng = np.random.default_rng(3)
    F = 2 + len(widths)
    shapes = {
        "mean": (F,),
        "scale": (F,),
        "W": (4 * units, F),
        "U": (4 * units, units),
        "b": (4 * units,),
        "w": (units,),
        "w0": (1,),
    }
    weights = {name: rng.normal(0.0, 0.7, shape) for name, shape in shapes.items()}
    weights["mean"] = np.array([0.1, *[0.0] * (F - 1)])
    weights["scale"] = np.array([20.0, 10.0, *[2.0] * len(widths)])
    return HistoryCorrection(0.1, 0.02, np.array(widths), weights)
