"""The columns of the discrepancy at every kind of stage, and that they hold the tangents of smooth effects."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from plant_data import dataset_of, loaded_arm, nominal, slide

from sysid.gap.likelihood.discrepancy import Discrepancy, discrepancy_of
from sysid.gap.likelihood.discrepancy.shapes import bumps, delayed, low_pass, slow_cosines
from sysid.gap.likelihood.rows import StageRows, averaged
from sysid.gap.problem import problems_of, split_of
from sysid.machine import KnownEffect
from sysid.plant import compile_plant

#: Stage and target → groups that its discrepancy has at least.
GROUPS = {
    "velocity axis": ("command", "boom", {"command", "position", "rate", "past", "time", "other axes", "reading", "direction"}),
    "servo": ("command", "wrist", {"speed", "acceleration", "direction", "past", "position", "time"}),
    "force axis": ("force", "slide", {"speed", "position", "acceleration", "distance since a reversal", "time"}),
    "joint": ("joint", "boom", {"position", "direction", "speed", "time"}),
    "tip": ("end_effector", "ee", {"position", "direction", "speed", "time", "frame"}),
    "tool": ("tool", "tool", {"position", "speed", "acceleration", "time"}),
}


@cache
def made(stage: str, target: str, weight: bool = False) -> tuple[StageRows, Discrepancy]:
    """Rows and discrepancy of a stage of the plant that made the data."""
    plant = nominal(machine=slide() if target == "slide" else loaded_arm() if weight else None)
    dataset = dataset_of(plant, 8.0, seed=3)
    model = compile_plant(plant)
    (problem,) = (p for p in problems_of(model, dataset) if (p.stage, p.target) == (stage, target))
    recordings = [averaged(r, problem.kind) for r in split_of(dataset).seen]
    rows = StageRows(problem, recordings, plant.vector(), np.full(len(problem.signals), 1e-4))
    return rows, discrepancy_of(model, rows, plant.vector(), 0.005)


@pytest.mark.parametrize("kind", GROUPS)
def test_columns_are_finite_and_each_belongs_to_a_group(kind: str) -> None:
    stage, target, groups = GROUPS[kind]
    rows, found = made(stage, target)
    assert found.columns.shape == (rows.count, len(found.group))
    assert found.timing.shape == (rows.count,)
    assert np.isfinite(found.columns).all()
    assert np.isfinite(found.timing).all()
    assert groups <= set(found.groups)
    assert set(found.group) == set(range(len(found.groups)))
    assert len(found.group) < 0.5 * rows.count
    sizes = np.abs(found.columns).max(axis=0)
    assert (sizes > 0.0).mean() > 0.9, "columns that are zero everywhere say nothing"


@pytest.mark.parametrize(("stage", "target"), [("command", "boom"), ("joint", "boom"), ("end_effector", "ee")])
def test_there_is_a_group_of_the_load_where_it_varies(stage: str, target: str) -> None:
    _, found = made(stage, target, weight=True)
    load = found.columns[:, found.group == found.groups.index("load")]
    assert np.abs(load).max() > 0.0
    assert np.isfinite(load).all()


def test_an_upright_axis_has_no_load() -> None:
    assert "load" not in made("command", "slew", weight=True)[1].groups


@pytest.mark.parametrize(
    ("stage", "effect"),
    [
        ("command", KnownEffect("gain_error", "boom", {"ratio": 1.01})),
        ("command", KnownEffect("asymmetric_gain", "boom", {"ratio": 1.01})),
        ("command", KnownEffect("gain_curve", "boom", {"exponent": 1.01})),
        ("command", KnownEffect("valve_deadband", "boom", {"positive": 0.002, "negative": 0.003})),
        ("joint", KnownEffect("sensor_bias", "boom.joint", {"bias": 1e-4})),
        ("joint", KnownEffect("sensor_scale", "boom.cylinder", {"scale": 1.001})),
        ("end_effector", KnownEffect("joint_offset", "boom", {"offset": 1e-4})),
        ("end_effector", KnownEffect("base_misalignment", "base", {"translation": [1e-4, 0, 2e-4], "rotation": [0, 0, 1e-4]})),
    ],
    ids=lambda value: value.name if isinstance(value, KnownEffect) else value,
)
def test_a_small_smooth_effect_lies_in_the_span_of_the_columns(stage: str, effect: KnownEffect) -> None:
    """Else a wrong effect repairs what the columns lack, and is named for it."""
    rows, found = made(stage, "ee" if stage == "end_effector" else "boom")
    moved = nominal(effect).vector()
    change = np.subtract(*rows.residuals(np.array([rows.theta, moved])))
    change -= np.concatenate([np.full(s.rows.stop - s.rows.start, change[s.rows].mean()) for s in rows.series])
    columns = found.columns.copy()
    for s in rows.series:
        columns[s.rows] -= columns[s.rows].mean(axis=0)
    if stage != "command":  # an integrator alone forgets the level of a run
        columns = found.columns
        change = np.subtract(*rows.residuals(np.array([rows.theta, moved])))
    left = change - columns @ np.linalg.lstsq(columns, change, rcond=1e-10)[0]
    assert float(left @ left) < 0.02 * float(change @ change)


def test_timing_is_half_a_sample_of_the_output_s_speed() -> None:
    rows, found = made("command", "boom")
    s = rows.series[0]
    assert found.timing[s.rows] == pytest.approx(0.005 * np.gradient(s.measured, s.time))


def test_bumps_vanish_at_rest_and_cover_the_commands() -> None:
    u = np.linspace(-1.0, 1.0, 201)
    table = bumps(u)
    assert table[100] == pytest.approx(np.zeros(14))
    assert table[np.abs(u) > 0.04].max(axis=1).min() > 0.5


def test_a_delay_shifts_and_a_lag_follows() -> None:
    x = np.concatenate([np.zeros(50), np.ones(150)])
    assert delayed(x, 0.105, 0.01)[[59, 60, 61]] == pytest.approx([0.0, 0.5, 1.0])
    lagged = low_pass(x, 0.1, 0.01)
    assert lagged[:50] == pytest.approx(np.zeros(50))
    assert lagged[59] == pytest.approx(1.0 - np.exp(-1.0))
    assert low_pass(x, 0.0, 0.01) is x


def test_slow_cosines_span_a_recording() -> None:
    table = slow_cosines(np.arange(0.0, 60.1, 0.1))
    assert table.shape == (601, 4)
    assert table[[0, -1], 0] == pytest.approx([1.0, -1.0])
    assert table[-1, 3] == pytest.approx(1.0), "a slope a minute"
