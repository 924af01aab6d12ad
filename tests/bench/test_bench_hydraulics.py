"""Hydraulic drives: oil flows down a pressure difference, loads slow, pumps share, oil rings, and pressures stay bounded."""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulated_bench import AXES, BenchRecipe, RecordingSettings
from simulated_bench.cylinder import drive_of, position_of
from simulated_bench.hydraulic_recipe import HydraulicSettings, OilSettings, SupplySettings
from simulated_bench.machine import Truth, run_machine
from simulated_bench.oil import orifice_flow, viscosity
from simulated_bench.recipe import GripperSettings, StrokeSettings
from simulated_bench.recipe_file import check_recipe
from simulated_bench.rigid_body import bodies_of, energy
from simulated_bench.seal import seal_step
from simulated_bench.spool import PLAY_OPERATORS, edges, spool_motion, with_hysteresis
from sysid.errors import SettingsError

Array = npt.NDArray[np.float64]

SIZES = {
    "slew": HydraulicSettings(area=2e-5, area_rod=2e-5),
    "boom": HydraulicSettings(area=4.91e-4, area_rod=3.14e-4),
    "stick": HydraulicSettings(area=4.91e-4, area_rod=3.14e-4),
    "telescope": HydraulicSettings(area=2.0e-4, area_rod=1.2e-4),
}


def hydraulic(recipe: BenchRecipe, *names: str, rod: float = 0.0, **features: float) -> BenchRecipe:
    """The crane with ideal hydraulic drives on ``names`` (without: all), no overlap, no delay, the gripper fixed at the tip."""
    axes = dict(recipe.axes)
    for name in names or AXES:
        valve = replace(axes[name].valve, delay=0.0, deadband_positive=0.0, deadband_negative=0.0, time_constant=0.0)
        settings = replace(SIZES[name], spool_frequency=30.0, **features)
        axes[name] = replace(axes[name], drive="hydraulic", hydraulics=settings, valve=valve, backlash=0.0)
    return replace(recipe, axes=axes, gripper=GripperSettings(rod, 0.04 if rod else 0.0))


def at_pose(recipe: BenchRecipe, **park: float) -> BenchRecipe:
    return replace(recipe, axes={name: replace(axis, park=park.get(name, axis.park)) for name, axis in recipe.axes.items()})


def pushed(recipe: BenchRecipe, *strokes: StrokeSettings, seconds: float = 4.0) -> Truth:
    recording = RecordingSettings("push", seed=1, seconds=seconds, program="script", strokes=strokes)
    return run_machine(recipe, recording, np.random.default_rng(0))


def unmoved(recipe: BenchRecipe, seconds: float = 4.0) -> Truth:
    return pushed(recipe, StrokeSettings("slew", seconds + 10.0, 1.0, 0.1), seconds=seconds)


def push_speed(truth: Truth, column: int, first: float, last: float) -> float:
    at = np.interp([first, last], truth.time, truth.drive[:, column])
    return float((at[1] - at[0]) / (last - first))


@given(st.floats(1e-10, 1e-7), st.floats(-2e7, 2e7), st.floats(1e3, 1e6))
def test_oil_flows_down_the_pressure_difference(conductance: float, drop: float, transition: float) -> None:
    flow = orifice_flow(conductance, drop, transition)
    assert flow * drop >= 0.0
    assert orifice_flow(conductance, -drop, transition) == -flow
    assert orifice_flow(conductance, 0.0, transition) == 0.0
    assert abs(flow) <= conductance * math.sqrt(abs(drop)) + 1e-30
    if abs(drop) > 1e3 * transition:
        assert abs(flow) == pytest.approx(conductance * math.sqrt(abs(drop)), rel=1e-3)


def test_cold_oil_is_thick_and_thins_as_it_warms() -> None:
    values = [viscosity(t, 10.0, 50.0, 100.0, 40.0, 0.035) for t in (0.0, 100.0, 1e6)]
    assert values == pytest.approx([math.exp(1.05), math.exp(0.035 * (40.0 * math.exp(-1.0) - 10.0)), math.exp(-0.35)])


def test_friction_of_the_spool_is_a_rate_independent_loop() -> None:
    swing = 0.3 * np.sin(np.linspace(0.0, 4.0 * np.pi, 4001))
    plays = np.zeros(PLAY_OPERATORS)
    felt = np.array([with_hysteresis(u, plays, 0.06) for u in swing])
    width = abs(np.interp(0.0, swing[3001:4001], felt[3001:4001]) + np.interp(0.0, -swing[2501:3501], -felt[2501:3501]))
    # Mean half width of plays evenly spaced up to 0.06 is 0.018.
    assert width == pytest.approx(2.0 * 0.5 * 0.06 * (PLAY_OPERATORS + 1) / (2 * PLAY_OPERATORS), rel=0.02)
    assert with_hysteresis(0.123, np.zeros(PLAY_OPERATORS), 0.0) == 0.123


def test_spool_is_of_second_order() -> None:
    position, speed, path = 0.0, 0.0, []
    for _ in range(20_000):
        position, speed = spool_motion(position, speed, 0.5, 0.0, 40.0, 0.3, math.inf, 1e-4)
        path.append(position)
    overshoot = max(path) / 0.5 - 1.0
    assert path[-1] == pytest.approx(0.5, abs=1e-6)
    assert overshoot == pytest.approx(math.exp(-math.pi * 0.3 / math.sqrt(1.0 - 0.09)), rel=0.02)


def test_edges_to_the_tank_may_open_later() -> None:
    assert edges(0.5, 0.1, 0.2, 0.05, math.inf) == pytest.approx((0.4, 0.35))
    assert edges(-0.5, 0.1, 0.2, 0.05, math.inf) == pytest.approx((-0.3, -0.25))
    assert edges(0.12, 0.1, 0.2, 0.05, math.inf) == pytest.approx((0.02, 0.0))
    assert edges(-0.2, 0.1, 0.2, 0.0, math.inf) == (0.0, 0.0)


def test_seal_sticks_then_slides_with_a_dip() -> None:
    stiffness, step = 100.0 / 2e-5, 1e-4
    bristle, force = 0.0, 0.0
    for _ in range(50):
        bristle, force = seal_step(bristle, 1e-4, 100.0, 150.0, 5e-3, 0.0, stiffness, step)
    assert force < 10.0, "elastic before it slides"
    sliding = []
    for speed in (1e-3, 5e-2):
        bristle = 0.0
        for _ in range(20_000):
            bristle, force = seal_step(bristle, speed, 100.0, 150.0, 5e-3, 0.0, stiffness, step)
        sliding.append(force)
    assert sliding == pytest.approx([100.0 + 50.0 * math.exp(-0.04), 100.0], rel=1e-3)


def test_settings_without_the_drive_change_nothing(recipe: BenchRecipe) -> None:
    recording = replace(recipe.recording("manual-01"), seconds=12.0)
    axes = {name: replace(axis, hydraulics=SIZES[name]) for name, axis in recipe.axes.items()}
    plain = run_machine(recipe, recording, np.random.default_rng(1))
    ready = run_machine(replace(recipe, axes=axes), recording, np.random.default_rng(1))
    assert (plain.joint == ready.joint).all()
    assert (plain.tool == ready.tool).all()
    assert not plain.pressure.any()


@pytest.mark.parametrize("name", AXES)
def test_unloaded_axis_moves_at_its_rated_speed(recipe: BenchRecipe, name: str) -> None:
    light = {"boom": 1e-3, "boom_inertia": 0.1, "stick": 1e-3, "stick_inertia": 0.1, "telescope": 0.2, "gripper": 1e-3}
    massless = replace(recipe.masses, **light, column_inertia=0.1)
    oil = OilSettings(transition=1.0)
    machine = replace(hydraulic(recipe, name), masses=massless, oil=oil)
    column = AXES.index(name)
    truth = pushed(machine, StrokeSettings(name, 0.5, 1.6, 0.5, 0.05))
    if truth.command[1000, column] < 0.0:
        pytest.fail("no room in the positive direction")
    gain = recipe.axis(name).valve.gain
    assert push_speed(truth, column, 1.2, 1.8) == pytest.approx(0.5 * gain, rel=0.02)


def test_load_slows_lifting_and_hastens_lowering(recipe: BenchRecipe) -> None:
    """At 80 bar and full reach: up by 0.80–0.89, down by 1.16–1.23."""
    machine = at_pose(hydraulic(recipe, "boom"), boom=0.05, stick=-0.12, telescope=0.245)
    weightless = replace(recipe.masses, boom=0.02, stick=0.01, telescope=0.005, gripper=0.01)
    speeds = {}
    for load, masses in (("loaded", recipe.masses), ("free", weightless)):
        for level in (0.6, -0.6):
            truth = pushed(replace(machine, masses=masses), StrokeSettings("boom", 0.5, 1.4, level, 0.05))
            speeds[load, level] = push_speed(truth, 1, 1.1, 1.7)
    up = speeds["loaded", 0.6] / speeds["free", 0.6]
    down = speeds["loaded", -0.6] / speeds["free", -0.6]
    assert 0.78 < up < 0.90
    assert 1.14 < down < 1.27


def test_oil_rings_under_the_booms(recipe: BenchRecipe) -> None:
    machine = at_pose(hydraulic(recipe, "boom"), boom=0.05, stick=-0.12, telescope=0.245)
    truth = pushed(machine, StrokeSettings("boom", 0.5, 0.6, 0.6, 0.01), seconds=3.0)
    after = truth.drive[(truth.time > 1.3) & (truth.time < 2.8), 1]
    wave = after - np.convolve(after, np.ones(301) / 301.0, "same")
    wave = wave[150:-150]
    crossings = np.flatnonzero((wave[:-1] < 0.0) & (wave[1:] >= 0.0))
    frequency = 1e3 * (len(crossings) - 1) / (crossings[-1] - crossings[0])
    assert 5.0 < frequency < 13.0
    assert np.ptp(wave[:200]) > np.ptp(wave[-200:]), "and dies out"


@pytest.mark.parametrize(("past", "slowest", "fastest"), [(0.0, 0.0, 2e-6), (1e-14, 1e-5, 2e-4)])
def test_leakage_lets_the_boom_down_slowly(recipe: BenchRecipe, past: float, slowest: float, fastest: float) -> None:
    machine = at_pose(hydraulic(recipe, "boom", spool_leakage=past), boom=0.3, stick=-0.3, telescope=0.2)
    truth = unmoved(machine, seconds=8.0)
    drift = -push_speed(truth, 1, 3.0, 7.5)
    assert slowest <= drift < fastest


def test_axes_share_what_the_pump_gives(recipe: BenchRecipe) -> None:
    supply = SupplySettings(flow_limit=2.0e-5)
    machine = replace(at_pose(hydraulic(recipe), stick=-1.0), supply=supply)
    boom = StrokeSettings("boom", 0.5, 1.6, 0.9, 0.05)
    others = (StrokeSettings("stick", 0.5, 1.6, -0.9, 0.05), StrokeSettings("telescope", 0.5, 1.6, 0.9, 0.05))
    alone, together = pushed(machine, boom), pushed(machine, boom, *others)
    rich = pushed(replace(machine, supply=SupplySettings()), boom, *others)
    assert push_speed(together, 1, 1.0, 1.9) < 0.8 * push_speed(alone, 1, 1.0, 1.9)
    assert push_speed(rich, 1, 1.0, 1.9) > 1.2 * push_speed(together, 1, 1.0, 1.9)
    moving = (together.time > 1.0) & (together.time < 1.9)
    taken = sum(
        max(push_speed(together, column, 1.0, 1.9), 0.0) * SIZES[name].area
        + max(-push_speed(together, column, 1.0, 1.9), 0.0) * SIZES[name].area_rod
        for column, name in enumerate(AXES)
    )
    assert taken == pytest.approx(supply.flow_limit, rel=0.1)
    assert together.pressure[moving, 8].max() < 80e5


def test_cold_oil_slows_the_machine(recipe: BenchRecipe) -> None:
    oil = OilSettings(transition=2e5, start=0.0, end=0.0)
    stroke = StrokeSettings("boom", 0.5, 1.4, 0.6, 0.05)
    machine = hydraulic(recipe, "boom")
    warm = push_speed(pushed(replace(machine, oil=replace(oil, start=40.0, end=40.0)), stroke), 1, 1.0, 1.7)
    cold = push_speed(pushed(replace(machine, oil=oil), stroke), 1, 1.0, 1.7)
    assert 0.7 < cold / warm < 0.95


def test_pressures_stay_bounded_and_energy_is_accounted_for(recipe: BenchRecipe) -> None:
    """What the pump put in lifts the booms and is lost at edges and seals: never more comes out."""
    machine = hydraulic(recipe, rod=0.22, coulomb=30.0, static=45.0, viscous=300.0, relief=160e5, leakage=1e-14)
    axes = {**machine.axes, "slew": replace(machine.axes["slew"], hydraulics=replace(SIZES["slew"], coulomb=1.0, bristle=1e-4))}
    machine = replace(machine, axes=axes)
    recording = RecordingSettings("drive", seed=5, seconds=40.0)
    truth = run_machine(machine, recording, np.random.default_rng(3))
    assert np.isfinite(truth.joint).all()
    assert truth.pressure[:, :8].min() >= 0.0
    assert truth.pressure[:, :8].max() <= 160e5
    bodies = bodies_of(machine.masses, machine.geometry.boom, machine.geometry.stick, 0.22)
    still = np.zeros(4)
    height = [energy(truth.joint[k], still, bodies)[1] for k in (0, -1)]
    moved = np.diff(truth.drive, axis=0)
    areas = np.array([[SIZES[name].area, SIZES[name].area_rod] for name in AXES])
    drawn = np.maximum(moved, 0.0) @ areas[:, 0] + np.maximum(-moved, 0.0) @ areas[:, 1]
    pumped = 80e5 * drawn.sum()
    rubbed = (np.abs(truth.friction[1:]) * np.abs(moved)).sum()
    assert height[1] - height[0] + rubbed < pumped
    assert rubbed > 1.0


def test_swinging_gripper_is_felt_by_the_drive(recipe: BenchRecipe) -> None:
    """Sideways the hanging mass pulls with its weight over the lean: the slewing pressures swing as the pendulum does."""
    machine = hydraulic(recipe, "slew", rod=0.22)
    truth = pushed(machine, StrokeSettings("slew", 0.5, 0.8, 0.9, 0.02), seconds=7.0)
    late = truth.time > 2.5
    difference = truth.pressure[late, 0] - truth.pressure[late, 1]
    spectrum = np.abs(np.fft.rfft((difference - difference.mean()) * np.hanning(late.sum())))
    frequency = np.fft.rfftfreq(late.sum(), 1e-3)
    below_ringing = frequency < 3.0
    peak = frequency[below_ringing][np.argmax(spectrum[below_ringing])]
    assert peak == pytest.approx(math.sqrt(9.81 / 0.22) / (2.0 * math.pi), rel=0.15)


def test_end_stops_hold_hydraulic_drives(recipe: BenchRecipe) -> None:
    machine = at_pose(hydraulic(recipe, "telescope"), telescope=0.24)
    machine = replace(machine, operator=replace(machine.operator, margin=0.0))
    truth = pushed(machine, StrokeSettings("telescope", 0.5, 0.25, 1.0, 0.05))
    drive = drive_of(machine.axis("telescope"))
    assert truth.drive[:, 3].max() <= drive.high
    assert position_of(truth.joint[-1, 3], drive) == pytest.approx(truth.drive[-1, 3])


def test_a_minute_takes_seconds(recipe: BenchRecipe) -> None:
    machine = hydraulic(recipe, rod=0.22, coulomb=30.0, static=45.0, hysteresis=0.03)
    recording = RecordingSettings("drive", seed=5, seconds=60.0)
    run_machine(machine, replace(recording, seconds=1.0), np.random.default_rng(3))
    begun = time.process_time()
    run_machine(machine, recording, np.random.default_rng(3))
    assert time.process_time() - begun < 5.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"drive": "hydraulic"}, r"axes\.boom\.drive: hydraulic without \[hydraulics\]; expected at least area"),
        ({"hydraulics": HydraulicSettings(0.0, 1e-4)}, r"axes\.boom\.hydraulics\.area: 0\.0; expected more than zero"),
        ({"hydraulics": HydraulicSettings(1e-4, 1e-4, leakage=-1.0)}, r"hydraulics\.leakage: -1\.0; expected zero or more"),
        ({"stiffness": 0.0}, r"axes\.boom\.stiffness: 0\.0; expected more than zero"),
        ({"flex_damping": 1.0}, r"axes\.boom\.flex_damping: 1\.0; expected a damping ratio"),
    ],
)
def test_circuit_that_cannot_be_is_refused(recipe: BenchRecipe, change: dict[str, object], message: str) -> None:
    wrong = replace(recipe, axes={**recipe.axes, "boom": replace(recipe.axis("boom"), **change)})
    with pytest.raises(SettingsError, match=message):
        check_recipe(wrong, "bench.toml")


def boom_speeds(recipe: BenchRecipe) -> tuple[float, float]:
    """Mean speeds of the boom's cylinder up and down, at half opening."""
    up = pushed(recipe, StrokeSettings("boom", 0.5, 2.0, 0.5, 0.05))
    down = pushed(recipe, StrokeSettings("boom", 0.5, 2.0, -0.5, 0.05))
    return push_speed(up, 1, 1.0, 2.0), -push_speed(down, 1, 1.0, 2.0)


def test_weight_that_springs_carry_slows_nothing(recipe: BenchRecipe) -> None:
    even = at_pose(hydraulic(recipe, "boom", retraction=recipe.axis("boom").valve.gain), boom=0.5)
    up, down = boom_speeds(even)
    assert up < 0.9 * down
    carried = replace(even, masses=replace(even.masses, balanced=1.0))
    up, down = boom_speeds(carried)
    assert up == pytest.approx(down, rel=0.02)
    assert up == pytest.approx(0.5 * recipe.axis("boom").valve.gain, rel=0.05)


def test_pump_below_its_rating_is_slower_by_the_root_of_the_pressure(recipe: BenchRecipe) -> None:
    light = hydraulic(recipe, "boom")
    light = replace(light, masses=replace(light.masses, balanced=1.0))
    worn = replace(light, supply=replace(light.supply, pressure=60e5, rated=80e5))
    assert boom_speeds(worn)[0] / boom_speeds(light)[0] == pytest.approx(math.sqrt(60.0 / 80.0), rel=0.02)


def test_pilot_oil_and_notches_act_on_hydraulic_drives_too(recipe: BenchRecipe) -> None:
    light = hydraulic(recipe, "boom")
    light = replace(light, masses=replace(light.masses, balanced=1.0))

    def with_valve(**features: float) -> BenchRecipe:
        boom = light.axes["boom"]
        return replace(light, axes={**light.axes, "boom": replace(boom, valve=replace(boom.valve, **features))})

    plain = boom_speeds(light)[0]
    assert boom_speeds(with_valve(notch=1.0))[0] == pytest.approx(0.5 * plain, rel=0.03)
    slow = pushed(with_valve(spool_speed=0.5), StrokeSettings("boom", 0.5, 2.0, 0.5, 0.05))
    early = push_speed(slow, 1, 0.5, 1.0)
    assert early < 0.6 * plain
    assert push_speed(slow, 1, 1.8, 2.3) == pytest.approx(plain, rel=0.02)
