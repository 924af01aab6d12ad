"""The compiled effects against slow integrations of their definitions."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import references
from scipy.interpolate import CubicSpline
from scipy.spatial.transform import Rotation
from weight import slopes

from sysid.datasets.recording import Recording
from sysid.effects import BY_NAME, CATALOGUE
from sysid.machine import KnownEffect, Machine, TriangleLinkage, machine_from_files
from sysid.plant import compile_plant, free_run, nominal_plant, swing
from sysid.plant.model import measured_point
from sysid.testing import EffectPlace, places_of, plant_run, probe_machine, probe_recording

Array = npt.NDArray[np.float64]
DT = 0.01
RECORDING = probe_recording(4.0, seed=3)


def measured_joints(recording: Recording, machine: Machine) -> Array:
    """All joints (n, A)."""
    return np.column_stack([recording.values(f"{name}.joint") for name in machine.axis_names])


def place(effect: str, target: str, side: str | None = None) -> EffectPlace:
    return next(p for p in places_of(BY_NAME[effect]) if p.target == target and p.side == side)


def run(effect: str, target: str, values: dict[str, float | list[float]], side: str | None = None) -> Array:
    return plant_run(BY_NAME[effect], place(effect, target, side))(values, RECORDING)


VELOCITY = [
    ("input_delay", {"delay": 0.0}),
    ("input_delay", {"delay": 0.05}),
    ("input_delay", {"delay": 0.0234}),
    ("first_order_lag", {"time_constant": 0.003}),
    ("first_order_lag", {"time_constant": 0.15}),
    ("valve_deadband", {"positive": 0.2, "negative": 0.11}),
    ("valve_hysteresis", {"width": 0.15}),
    ("gain_error", {"ratio": 1.37}),
    ("asymmetric_gain", {"ratio": 0.7}),
    ("gain_curve", {"exponent": 1.8}),
    ("flow_saturation", {"limit": 0.45}),
    ("command_rate_limit", {"rate": 2.5}),
    ("command_rate_limit", {"rate": 60.0}),
    ("internal_leakage", {"rate": 0.002}),
    ("stiction", {"breakaway": 0.3, "release": 0.12}),
    ("temperature_drift", {"fraction": -0.4, "time_constant": 5.0}),
    ("temperature_drift", {"fraction": 0.2, "time_constant": 60.0}),
    ("oil_compressibility", {"frequency": 4.0, "damping_ratio": 0.05}),
    ("oil_compressibility", {"frequency": 12.0, "damping_ratio": 0.3}),
]


@pytest.mark.parametrize(("effect", "values"), VELOCITY, ids=[f"{e}-{'-'.join(map(str, v.values()))}" for e, v in VELOCITY])
def test_velocity_axis(effect: str, values: dict[str, float]) -> None:
    command = RECORDING.values("slew.command")
    expected = references.velocity_axis(command, DT, 0.5, 0.0, **{effect: tuple(values.values())})
    out = run(effect, "slew", dict(values))[:, 0]
    # The reference resolves an edge of a ramp or a delay to a hundredth of a step.
    assert np.abs((out - out[0]) - expected).max() < 2e-4 * np.ptp(expected)


@pytest.mark.parametrize("delay", [0.03, 0.0234])
@pytest.mark.parametrize("overlaps", [(0.15, 0.07), (0.05, 0.2)])
def test_a_spool_that_sticks_at_its_centre(overlaps: tuple[float, float], delay: float) -> None:
    """It is freed by one command on both sides, although its overlaps differ; the lag decides when it rests again."""
    values: dict[str, dict[str, float]] = {
        "input_delay": {"delay": delay},
        "valve_deadband": dict(zip(("positive", "negative"), overlaps, strict=True)),
        "first_order_lag": {"time_constant": 0.03},
    }
    spool = {"spool_breakaway": 0.4, "spool_release": 0.05}
    command = RECORDING.values("slew.command")
    known = {name: tuple(each.values()) for name, each in values.items()}

    def moved(*more: KnownEffect) -> Array:
        plant = nominal_plant(probe_machine())
        for name, parameters in values.items():
            plant = plant.with_effect(KnownEffect(name, "slew", dict(parameters)))
        for item in more:
            plant = plant.with_effect(item)
        model = compile_plant(plant)
        begun = RECORDING.table.assign(**{"slew.joint": np.where(np.arange(400) < 1, 0.0, np.nan)})
        out = model.drive(model.theta[None], replace(RECORDING, table=begun), "slew")[0]
        return np.asarray(out - out[0])

    free = references.velocity_axis(command, DT, 0.5, 0.0, **known)
    expected = references.velocity_axis(command, DT, 0.5, 0.0, sticking_spool=tuple(spool.values()), **known)
    assert np.abs(expected - free).max() > 0.02 * np.ptp(free), "it sticks"
    assert np.abs(moved() - free).max() < 1e-3 * np.ptp(free)
    assert np.abs(moved(KnownEffect("stiction", "slew", dict(spool))) - expected).max() < 2e-3 * np.ptp(free)


@functools.cache
def loaded() -> tuple[Recording, Array]:
    """The recording with the boom's joint where its linkage has it, and the moment of a kilogram at the tip about the boom."""
    angle = boom_angle(RECORDING.values("boom.cylinder"))
    recording = replace(RECORDING, table=RECORDING.table.assign(**{"boom.joint": angle}))
    return recording, loads_of(recording, slice(None))[:, 1]


def loads_of(recording: Recording, rows: slice) -> Array:
    """Gravity loads of the probe (n, A) on some rows."""
    return loads_at(measured_joints(recording, probe_machine())[rows])


def loads_at(joints: Array) -> Array:
    """Gravity loads of the probe at joints (n, A), by the slope of its energy."""
    machine = probe_machine()
    names, urdf = [str(axis.joint) for axis in machine.axes], machine.files()["probe.urdf"]
    return np.array([slopes(urdf, dict(zip(names, map(float, row), strict=True)), "tip") for row in joints])


@pytest.mark.parametrize("coefficient", [0.02, -0.01, 0.3])
def test_flow_that_depends_on_the_load(coefficient: float) -> None:
    """The largest coefficient is so large that the boom cannot be lifted at all, and hardly held back when it is lowered."""
    recording, load = loaded()
    plant_out = plant_run(BY_NAME["load_dependent_flow"], place("load_dependent_flow", "boom"))
    out = plant_out({"coefficient": coefficient}, recording)[:, 0]
    command = recording.values("boom.command")
    plain = references.velocity_axis(command, DT, 0.008, 0.0, load, load_dependent_flow=(coefficient,))
    expected = np.clip(out[0] + plain, 0.0, 0.11)
    assert np.array_equal(expected, out[0] + plain), "clear of the end stops"
    assert np.abs(out - expected).max() < 1e-6 * np.ptp(expected)


@pytest.mark.parametrize("limit", [0.5, 1.1])
def test_a_pump_that_two_axes_share(limit: float) -> None:
    commands = np.column_stack([RECORDING.values("slew.command"), RECORDING.values("boom.command")])
    expected = references.fed_by_one_pump(commands, DT, (0.5, 0.008), limit)[:, 0]
    out = run("pump_flow_limit", "machine", {"limit": limit})[:, 0]
    assert 0.1 < np.mean(np.abs(commands).sum(axis=1) > limit) < 0.95, "it binds at times"
    assert np.abs((out - out[0]) - expected).max() < 1e-9 * np.ptp(expected)


def test_all_velocity_effects_together() -> None:
    """Order of the command stage. Blending a fraction of a step before a bend is exact to first order only."""
    values: dict[str, dict[str, float]] = {
        "input_delay": {"delay": 0.04},
        "valve_hysteresis": {"width": 0.04},
        "valve_deadband": {"positive": 0.1, "negative": 0.07},
        "gain_curve": {"exponent": 1.3},
        "flow_saturation": {"limit": 0.6},
        "command_rate_limit": {"rate": 6.0},
        "first_order_lag": {"time_constant": 0.06},
        "gain_error": {"ratio": 1.2},
        "asymmetric_gain": {"ratio": 0.8},
        "temperature_drift": {"fraction": 0.3, "time_constant": 5.0},
        "load_dependent_flow": {"coefficient": 0.02},
        "internal_leakage": {"rate": 1e-4},
        "stiction": {"breakaway": 0.1, "release": 0.05},
        "oil_compressibility": {"frequency": 6.0, "damping_ratio": 0.1},
    }
    recording, load = loaded()
    plant = nominal_plant(probe_machine())
    for name, parameters in values.items():
        plant = plant.with_effect(KnownEffect(name, "boom", dict(parameters)))
    model = compile_plant(plant)
    known = recording.table.assign(**{"boom.cylinder": np.where(np.arange(400) < 1, 0.055, np.nan)})
    out = model.drive(model.theta[None], replace(recording, table=known), "boom")[0]
    command = recording.values("boom.command")
    expected = references.velocity_axis(
        command, DT, 0.008, 0.0, load, **{name: tuple(p.values()) for name, p in values.items()}
    )
    assert np.abs((out - out[0]) - expected).max() < 1e-2 * np.ptp(expected)


@pytest.mark.parametrize(
    ("effect", "values", "keyword"),
    [
        ("input_delay", {"delay": 0.037}, "delay"),
        ("command_rate_limit", {"rate": 3.0}, "rate"),
        ("first_order_lag", {"time_constant": 0.08}, "lag"),
        ("second_order_lag", {"time_constant": 0.05, "damping_ratio": 0.3}, "second_order"),
        ("second_order_lag", {"time_constant": 0.08, "damping_ratio": 1.0}, "second_order"),
        ("second_order_lag", {"time_constant": 0.04, "damping_ratio": 2.0}, "second_order"),
    ],
)
def test_position_axis(effect: str, values: dict[str, float], keyword: str) -> None:
    command = RECORDING.values("wrist.command")
    given = tuple(values.values())
    expected = references.servo_axis(command, DT, **{keyword: given if len(given) > 1 else given[0]})
    out = run(effect, "wrist", dict(values))[:, 0]  # a sample is read before the command of its row acts
    assert np.abs(out[1:] - expected[:-1]).max() < 2e-3 * np.ptp(expected)


@pytest.mark.parametrize("rate", [20.0, 110.0, 400.0])
def test_a_lag_behind_a_fast_rate_limit(rate: float) -> None:
    """Steps of 0.2 to 0.9 rad: the ramps of the last two end within a sample, and delay the lag by less than one."""
    command = np.repeat([0.0, 0.9, 0.4, -0.5, -0.3], 40)
    recording = replace(RECORDING, table=RECORDING.table.iloc[: len(command)].assign(**{"wrist.command": command}))
    machine = replace(probe_machine(), effects=(KnownEffect("first_order_lag", "wrist", {"time_constant": 0.025}),))
    limited = nominal_plant(machine).with_effect(KnownEffect("command_rate_limit", "wrist", {"rate": rate}))
    out = free_run(compile_plant(limited), recording)["wrist.joint"].to_numpy()
    expected = references.servo_axis(command, DT, rate=rate, lag=0.025)
    without = references.servo_axis(command, DT, lag=0.025)
    # The reference takes the ramp at the end of a hundredth of a step.
    assert np.abs(out[1:] - expected[:-1])[1:].max() < 0.06 * np.abs(without - expected).max()


FORCE = [
    ("coulomb_friction", {"force": 1.5}, {"coulomb": (1.5, 1.5)}),
    ("coulomb_friction", {"positive": 1.0, "negative": 2.0}, {"coulomb": (1.0, 2.0)}),
    ("viscous_friction", {"coefficient": 3.0}, {"viscous": (3.0, 3.0)}),
    ("viscous_friction", {"positive": 2.0, "negative": 6.0}, {"viscous": (2.0, 6.0)}),
    ("inertia_error", {"ratio": 1.7}, {"mass": 3.4}),
    ("force_constant_error", {"ratio": 0.8}, {"constant": 0.8}),
    ("load_bias", {"force": -0.7}, {"load": -0.7}),
    (
        "stribeck_friction",
        {"static_force": 1.6, "coulomb_force": 0.9, "stribeck_velocity": 0.05},
        {"stribeck": (1.6, 0.9, 0.05)},
    ),
    ("smooth_coulomb_friction", {"force": 1.5, "width": 0.1}, {"coulomb": (1.5, 1.5), "slope": 0.1}),
]


@pytest.mark.parametrize(("effect", "values", "physics"), FORCE, ids=[f"{e}-{len(v)}" for e, v, _ in FORCE])
def test_force_axis(effect: str, values: dict[str, float], physics: dict[str, float | tuple[float, float]]) -> None:
    expected = references.force_axis(RECORDING.values("slide.command"), DT, **{"mass": 2.0, **physics})  # type: ignore[arg-type]
    out = run(effect, "slide", dict(values))[:, 0]
    # The plant steps at the sample rate, to first order in friction: about a hundredth of the travel after 4 s. Where friction
    # changes within a few steps it is more (tests/plant has the same at higher rates).
    room = 0.08 if effect in ("stribeck_friction", "smooth_coulomb_friction") else 0.02
    assert np.abs((out - out[0]) - expected).max() < room * np.ptp(expected)


@pytest.mark.parametrize("frequency", [2.0, 30.0])
@pytest.mark.parametrize("viscous", [0.0, 3.0])
def test_flexible_drive(frequency: float, viscous: float) -> None:
    """Exact for a held force, below the sample rate and near it; friction is held over a substep."""
    values = {"frequency": frequency, "damping_ratio": 0.1, "inertia_ratio": 1.5}
    expected = references.two_masses(RECORDING.values("slide.command"), DT, 2.0, viscous=viscous, **values)
    effects = [KnownEffect("flexible_drive", "slide", dict(values))]
    effects += [KnownEffect("viscous_friction", "slide", {"coefficient": viscous})] if viscous else []
    plant = nominal_plant(probe_machine())
    for item in effects:
        plant = plant.with_effect(item)
    resting = np.where(RECORDING.values("time") < 0.5, 0.0, np.nan)
    out = free_run(plant, replace(RECORDING, table=RECORDING.table.assign(**{"slide.joint": resting})))[
        "slide.joint"
    ].to_numpy()
    assert np.abs((out - out[0]) - expected).max() < (0.02 if viscous else 1e-3) * np.ptp(expected)


def test_stribeck_friction_sticks_and_slips_without_chattering() -> None:
    """Below break-away the slide rests exactly; once it moves it needs the smaller force, and stops dead under it."""
    count = 1200
    force = np.full(count, 0.95)
    force[:200], force[600:800], force[1000:] = 0.0, 1.2, -0.5
    recording = replace(
        RECORDING, table=pd.DataFrame({"time": np.arange(count) * DT, "slide.command": force, "slide.joint": 0.0})
    )
    friction = plant_run(BY_NAME["stribeck_friction"], place("stribeck_friction", "slide"))
    out = friction({"static_force": 1.0, "coulomb_force": 0.8, "stribeck_velocity": 0.02}, recording)[:, 0]
    speed = np.diff(out)
    assert (speed[:600] == 0.0).all(), "0.95 N does not break away"
    assert (np.diff(out[601:1001], 2) > 0).all(), "once it slides 0.95 N drive it on"
    stops = 1000 + int(np.argmax(speed[1000:] == 0.0))
    assert 1000 < stops < count - 50
    assert (speed[stops:] == 0.0).all(), "0.5 N does not pull it back, and it does not tremble"


@pytest.mark.parametrize("width", [0.01, 0.1])
def test_play_between_drive_and_sensor(width: float) -> None:
    drive = references.velocity_axis(RECORDING.values("slew.command"), DT, 0.5, 0.0)
    out = run("backlash", "slew", {"width": width}, "drive")[:, 0]
    begin = out[0]
    candidates = [references.play(drive + begin + side * width / 2, width, begin) for side in (-1.0, 0.0, 1.0)]
    assert min(np.abs(out - expected).max() for expected in candidates) < 1e-6


def test_play_behind_a_cylinder() -> None:
    angle = boom_angle(RECORDING.values("boom.cylinder"))
    out = run("backlash", "boom", {"width": 0.02}, "drive")[:, 0]
    # The plant tabulates the linkage.
    assert np.abs(out - references.play(angle, 0.02, angle[0])).max() < 2e-6


@pytest.mark.parametrize("axis", ["boom", "slide", "wrist"])
@pytest.mark.parametrize("side", ["drive", "structure"])
def test_a_soft_joint_sags_under_the_weight(axis: str, side: str) -> None:
    """In front of the sensor it is read, behind it only the tip shows it. The load is that of the deflected pose."""
    compliance, i = 2e-3, probe_machine().axis_names.index(axis)
    soft, rest = BY_NAME["joint_compliance"], place("joint_compliance", axis, side)
    recording, some = loaded()[0], slice(None, None, 9)
    if side == "structure":
        straight = measured_joints(recording, probe_machine())[some]
        joints = straight.copy()
        for _ in range(6):
            joints[:, i] = straight[:, i] - compliance * loads_at(joints)[:, i]
        kinematics = probe_machine().kinematics()
        assert kinematics is not None
        expected = kinematics.tip_position(joints)
        stiff, out = (plant_run(soft, rest)(values, recording)[some] for values in (None, {"compliance": compliance}))
        assert np.abs(stiff - expected).max() > 5e-4
        assert np.abs(out - expected).max() < 1e-8
        return
    if axis != "boom":  # of what is driven only the first samples are known, the rest of the weight rests on them
        signal = f"{axis}.joint"
        known = np.where(np.arange(len(recording)) < 20, recording.values(signal)[0], np.nan)
        held = np.full(len(recording), recording.values(signal)[0])
        load = loads_of(replace(recording, table=recording.table.assign(**{signal: held})), some)[:, i]
        recording = replace(recording, table=recording.table.assign(**{signal: known}))
    else:
        load = loads_of(recording, some)[:, i]
    straight, out = (plant_run(soft, rest)(values, recording)[some, 0] for values in (None, {"compliance": compliance}))
    sag = straight - out
    if axis == "slide":  # an integrator starts where its sensor reads what was measured
        sag, load = sag - sag[0], load - load[0]
    # The plant tabulates the linkage, which moves the load by the square of that.
    assert np.abs(sag - compliance * load).max() < 1e-6 * np.abs(compliance * load).max()


def joint_read(effect: str, target: str, values: dict[str, float]) -> Array:
    """What the boom's joint sensor says, (n,)."""
    spot = next(p for p in places_of(BY_NAME[effect]) if p.target == target and p.stage == "joint")
    return plant_run(BY_NAME[effect], spot)(values, RECORDING)[:, 0]


def boom_angle(cylinder: Array) -> Array:
    linkage = probe_machine().axis("boom").linkage
    assert linkage is not None
    return TriangleLinkage(linkage).joint(cylinder)


@pytest.mark.parametrize(
    ("effect", "values", "formula"),
    [
        ("sensor_bias", {"bias": 0.013}, lambda q: q + 0.013),
        ("sensor_scale", {"scale": 0.97}, lambda q: 0.97 * q),
        ("sensor_quantisation", {"step": 0.01}, lambda q: 0.01 * np.round(q / 0.01)),
    ],
)
def test_what_a_sensor_says(effect: str, values: dict[str, float], formula: Callable[[Array], Array]) -> None:
    said = joint_read(effect, "boom.joint", values)
    expected = formula(boom_angle(RECORDING.values("boom.cylinder")))
    close = np.abs(said - expected) < 2e-6
    if effect == "sensor_quantisation":  # next to the middle between two steps the tabulated linkage may fall on either side
        assert np.mean(close) > 0.99
        assert np.abs(said / 0.01 - np.round(said / 0.01)).max() < 1e-9
    else:
        assert close.all()


@pytest.mark.parametrize(("skew", "offset"), [(0.0, 0.037), (0.0, -0.2), (4000.0, 0.0), (-900.0, 0.0)])
def test_what_a_clock_does(skew: float, offset: float) -> None:
    """Interpolation between samples of a smooth motion is exact to the square of the step."""
    time = RECORDING.values("time")
    effect, values = ("clock_skew", {"skew": skew}) if skew else ("clock_offset", {"offset": offset})
    said = joint_read(effect, "capture", values)
    truth = CubicSpline(time, boom_angle(RECORDING.values("boom.cylinder")))
    expected = references.late(truth, time, skew, offset)
    outside = references.late(lambda t: (t < 0.0) | (t > time[-1]), time, skew, offset)
    assert np.isnan(said[outside.astype(bool)]).all()
    there = ~np.isnan(said)
    assert there.sum() > len(time) - abs(offset) / DT - 4
    there &= time > 0.8  # the motion starts at once at 0.5 s, which no spline follows
    assert np.abs(said - expected)[there].max() < 2e-4
    assert np.abs(truth(time) - expected)[there].max() > 2e-3, "the clock matters"


def test_sensors_and_clocks_are_undone_where_their_signal_is_an_input() -> None:
    """A stage believes what its input sensors mean: the joint follows the true cylinder, not the one that is read."""
    plant = nominal_plant(probe_machine(), streams={"draw_wire": ("boom.cylinder",)})
    true = RECORDING.values("boom.cylinder")
    time = RECORDING.values("time")
    scaled = KnownEffect("sensor_scale", "boom.cylinder", {"scale": 1.1})
    biased = KnownEffect("sensor_bias", "boom.cylinder", {"bias": 0.003})
    late = KnownEffect("clock_offset", "draw_wire", {"offset": 0.05})
    fast = KnownEffect("clock_skew", "draw_wire", {"skew": 2000.0})
    for effects in ((scaled, biased), (late, fast)):
        wrong = plant
        for effect in effects:
            wrong = wrong.with_effect(effect)
        said = 1.1 * true + 0.003
        if late in effects:
            said = references.late(CubicSpline(time, true), time, 2000.0, 0.05)
        recording = replace(RECORDING, table=RECORDING.table.assign(**{"boom.cylinder": said, "boom.joint": np.nan}))
        out = compile_plant(wrong).joint(wrong.vector()[None], recording, "boom")[0]
        there = ~np.isnan(out)
        assert there.mean() > 0.97
        assert np.abs(out - boom_angle(true))[there].max() < 2e-4
        assert np.abs(boom_angle(said) - boom_angle(true)).max() > 5e-3


def test_play_in_the_structure() -> None:
    joints = measured_joints(RECORDING, probe_machine()).copy()
    joints[:, 1] = references.play(joints[:, 1], 0.05, joints[0, 1])
    kinematics = probe_machine().kinematics()
    assert kinematics is not None
    out = run("backlash", "boom", {"width": 0.05}, "structure")
    assert np.abs(out - kinematics.tip_position(joints)).max() < 1e-12


@pytest.mark.parametrize("axis", ["slew", "boom", "slide", "wrist"])
def test_joint_offset_moves_the_joint(axis: str) -> None:
    joints = measured_joints(RECORDING, probe_machine()).copy()
    joints[:, probe_machine().axis_names.index(axis)] += 0.013
    kinematics = probe_machine().kinematics()
    assert kinematics is not None
    assert np.abs(run("joint_offset", axis, {"offset": 0.013}) - kinematics.tip_position(joints)).max() < 1e-12


#: Text of the URDF, and the same with the link 0.02 m longer.
LONGER = {
    "slew": ('xyz="0.05 0 0"', 'xyz="0.07 0 0"'),
    "boom": ('xyz="0.6 0 0"', 'xyz="0.62 0 0"'),
    "slide": ('xyz="0.3 0 0"', 'xyz="0.32 0 0"'),
    "wrist": (
        'xyz="0.2 0 0.02"',
        f'xyz="{0.2 * (1 + 0.02 / np.hypot(0.2, 0.02))} 0 {0.02 * (1 + 0.02 / np.hypot(0.2, 0.02))}"',
    ),
}


@pytest.mark.parametrize("axis", LONGER)
def test_link_length_is_that_of_a_longer_urdf(axis: str) -> None:
    files = probe_machine().files()
    before, after = LONGER[axis]
    assert files["probe.urdf"].count(before) == 1
    longer = machine_from_files({**files, "probe.urdf": files["probe.urdf"].replace(before, after)}, "longer").kinematics()
    assert longer is not None
    out = run("link_length_error", axis, {"error": 0.02})
    assert np.abs(out - longer.tip_position(measured_joints(RECORDING, probe_machine()))).max() < 1e-12


def test_base_misalignment_is_a_rigid_motion() -> None:
    translation, rotation = [0.1, -0.2, 0.05], [0.02, -0.3, 0.1]
    kinematics = probe_machine().kinematics()
    assert kinematics is not None
    tip = kinematics.tip_position(measured_joints(RECORDING, probe_machine()))
    out = run("base_misalignment", "base", {"translation": translation, "rotation": rotation})
    assert np.abs(out - (Rotation.from_rotvec(rotation).apply(tip) + translation)).max() < 1e-12


def test_tip_offset_is_that_of_a_point_on_the_last_moving_link() -> None:
    translation = np.array([0.04, -0.02, 0.03])
    machine = probe_machine()
    kinematics = machine.kinematics()
    assert kinematics is not None
    joints = measured_joints(RECORDING, machine)
    last = next(joint.child for joint in reversed(kinematics.chain) if joint.name in kinematics.drives)
    turned = kinematics.link_poses(joints)[last][:, :3, :3] @ translation
    out = run("tip_offset", "ee", {"translation": translation.tolist()})
    assert np.abs(out - (kinematics.tip_position(joints) + turned)).max() < 1e-12


@pytest.mark.parametrize(("rate_hz", "tolerance"), [(100.0, 0.02), (1000.0, 0.002)])
@pytest.mark.parametrize(("length", "damping"), [(0.22, 0.03), pytest.param(0.6, 0.1, marks=pytest.mark.slow)])
def test_sway_is_a_spherical_pendulum(length: float, damping: float, rate_hz: float, tolerance: float) -> None:
    """Swings by 0.4 of the length, in both directions, with the pivot moving up and down as well; first order in the step."""
    time = np.arange(round(8.0 * rate_hz)) / rate_hz
    moving = np.clip(time - 0.3, 0.0, 4.7)
    begin_and_end_at_rest = np.sin(np.pi * moving / 4.7) ** 2
    waves = np.column_stack([np.sin(4.6 * moving), np.sin(5.3 * moving), 0.5 * np.sin(4.0 * moving)])
    pivot = 0.15 * length * waves * begin_and_end_at_rest[:, None] + [0.0, 0.0, 1.0]
    unknown = np.full_like(pivot, np.nan)
    out = np.empty_like(pivot)
    swing.swing(np.array([length, damping]), 0, pivot, unknown, 1.0 / rate_hz, out)
    expected = references.pendulum(pivot, 1.0 / rate_hz, length, damping, longest_step=0.2)
    reach = np.abs(expected[:, :2] - pivot[:, :2]).max()
    assert 0.35 * length < reach < 0.5 * length
    assert np.abs(out - expected).max() < tolerance * reach


def test_sway_hangs_at_its_length_and_rings_at_its_frequency() -> None:
    """A push of the pivot, then rest: distance to the pivot stays the length; zero crossings come at √(g/L)."""
    time = np.arange(1500) * DT
    pivot = np.column_stack([np.where(time > 0.5, 0.01, 0.0), np.zeros(1500), np.ones(1500)])
    table = probe_recording(15.0).table.assign(**{f"ee.{c}": pivot[:, k] for k, c in enumerate("xyz")})
    recording = Recording("push", table, 100.0)
    run_sway = plant_run(BY_NAME["gripper_sway"], place("gripper_sway", "tool"))
    out = run_sway({"length": 0.25, "damping_ratio": 0.02}, recording)
    after = out[100:, 0] - 0.01
    assert np.allclose(np.linalg.norm(out - measured_point(recording, "ee"), axis=1), 0.25, atol=1e-9)
    crossings = np.flatnonzero(np.diff(np.sign(after)))
    period = 2.0 * DT * np.mean(np.diff(crossings))
    rate = np.sqrt(9.80665 / 0.25)
    assert period == pytest.approx(2 * np.pi / (rate * np.sqrt(1 - 0.02**2)), rel=5e-3)
    peaks = [np.abs(after[a:b]).max() for a, b in itertools.pairwise(crossings)]
    decrement = np.log(peaks[0] / peaks[-1]) / (len(peaks) - 1)
    assert decrement == pytest.approx(np.pi * 0.02 / np.sqrt(1 - 0.02**2), rel=0.05)


def test_a_tip_that_jumps_leaves_the_swing_finite() -> None:
    """Motion capture that takes another body for the tip for a moment (also by more than the length of the string)."""
    for jump in (0.05, 0.3, 3.0):
        ee = np.tile([0.0, 0.0, 1.0], (600, 1))
        ee[200:206, 0] += jump
        table = probe_recording(6.0).table.assign(**{f"ee.{c}": ee[:, k] for k, c in enumerate("xyz")})
        sway = plant_run(BY_NAME["gripper_sway"], place("gripper_sway", "tool"))
        out = sway({"length": 0.22, "damping_ratio": 0.05}, Recording("jump", table, 100.0))
        assert np.isfinite(out).all()
        assert np.abs(out[-50:] - ee[-50:]).max() <= 0.22 + 1e-9


def test_every_effect_has_a_reference() -> None:
    """A new effect brings its own."""
    compared = {name for name, *_ in (*VELOCITY, *FORCE)}
    compared |= {"backlash", "joint_offset", "link_length_error", "tip_offset", "base_misalignment", "gripper_sway"}
    compared |= {"load_dependent_flow", "pump_flow_limit", "joint_compliance", "second_order_lag", "flexible_drive"}
    compared |= {"sensor_bias", "sensor_scale", "sensor_quantisation", "clock_offset", "clock_skew"}
    compared |= {"payload", "link_mass_error", "inertial_error", "load_dependent_friction"}  # tests/plant/test_link_torque.py
    compared |= {"stiffness_error", "damping_error", "force_limit", "armature_error"}  # tests/plant/test_servo_arm.py
    assert compared == {effect.name for effect in CATALOGUE}
