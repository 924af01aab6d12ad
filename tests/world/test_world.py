"""The PyBullet world against the compiled plant, its contacts and pictures, and its manners as a guest in the process."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
from palletiser import JOINTS, urdf
from plant_data import loaded_arm, nominal

from sysid.datasets.recording import Recording
from sysid.errors import SettingsError
from sysid.machine import KnownEffect, Linkage, TriangleLinkage, load_machine, machine_from_files
from sysid.plant import Plant, compile_plant, free_run, nominal_plant
from sysid.testing.probe import probe_machine, probe_recording
from sysid.world import Log, World
from sysid.world.bodies import build_bodies

pytest.importorskip("pybullet", reason="PyBullet has no build for this Python")

Array = npt.NDArray[np.float64]
MACHINE = Path(__file__).parents[2] / "datasets/autolog/machine.toml"
#: Linkages that reach over the crane's joint ranges; its own are networks.
LINKAGES = {
    "boom": TriangleLinkage(Linkage("triangle", a=0.12, b=0.20, offset=0.9, retracted=0.15, sense=1)),
    "stick": TriangleLinkage(Linkage("triangle", a=0.10, b=0.25, offset=-0.25, retracted=0.16, sense=-1)),
}
SWAY = KnownEffect("gripper_sway", "tool", {"length": 0.25, "damping_ratio": 0.04})
START = np.array([0.2, 0.6, -1.2, 0.1])
#: Deep enough that nothing touches the ground.
FREE = -3.0


def crane(*effects: KnownEffect) -> Plant:
    plant = nominal_plant(load_machine(MACHINE), LINKAGES)
    for effect in effects:
        plant = plant.with_effect(effect)
    return plant


def driven(plant: Plant, seconds: float = 8.0, seed: int = 0) -> Recording:
    """Slow waves with steps on every axis after half a second of rest; the first sample says where it starts."""
    rng = np.random.default_rng(seed)
    count = round(seconds * 100.0)
    time = np.arange(count) / 100.0
    table: dict[str, Array] = {"time": time}
    begin = np.where(time < 0.005, 1.0, np.nan)
    for name, value, frequency in zip(plant.machine.axis_names, START, (0.13, 0.21, 0.17, 0.3), strict=True):
        steps = rng.uniform(-0.3, 0.3, count // 80 + 1).repeat(80)[:count]
        table[f"{name}.command"] = np.where(time < 0.5, 0.0, 0.6 * np.sin(2 * np.pi * frequency * time) + steps)
        axis = plant.machine.axis(name)
        cylinder = axis.drives == "cylinder"
        at = plant.linkages[name].displacement(np.array([value]))[0] if cylinder else value
        table[axis.driven] = at * begin
    return Recording("waves", pd.DataFrame(table), 100.0)


def worst(one: pd.DataFrame, other: pd.DataFrame, names: list[str]) -> float:
    return float((one[names] - other[names]).abs().to_numpy().max())


POINTS = ["ee.x", "ee.y", "ee.z"]
TOOL = ["tool.x", "tool.y", "tool.z"]


@pytest.mark.parametrize(
    "effect",
    [
        KnownEffect("valve_deadband", "boom", {"positive": 0.1, "negative": 0.05}),
        KnownEffect("backlash", "slew", {"width": 0.01}, "structure"),
        KnownEffect("backlash", "slew", {"width": 0.01}, "drive"),
        KnownEffect("joint_offset", "stick", {"offset": 0.02}),
        KnownEffect("link_length_error", "boom", {"error": 0.01}),
        KnownEffect("link_length_error", "stick", {"error": -0.01}),
        KnownEffect("base_misalignment", "base", {"translation": [0.01, -0.02, 0.03], "rotation": [0.02, -0.03, 0.05]}),
    ],
    ids=lambda effect: f"{effect.name}-{effect.target}-{effect.side or ''}".rstrip("-"),
)
def test_bodies_stand_where_the_compiled_plant_says(effect: KnownEffect) -> None:
    plant = crane(effect)
    source = driven(plant)
    run = free_run(plant, source)
    with World(plant, ground=FREE) as world:
        found = world.rollout(source)
    assert list(found.columns) == list(run.columns)
    assert len(found) == len(source)
    joints = [f"{name}.joint" for name in plant.machine.axis_names]
    assert worst(found, run, [*joints, "boom.cylinder", "stick.cylinder"]) < 1e-9
    assert worst(found, run, POINTS) < 1e-6
    assert float(np.ptp(run["ee.x"])) > 0.05
    # What the effect does to the tip is more than the two differ by.
    plain = free_run(crane(), source)
    assert worst(run, plain, POINTS) > 1e-3


def test_a_tip_offset_moves_a_tip_that_is_fixed_to_the_last_link() -> None:
    from pose_sets import Arm

    arm, shift = Arm(), [0.02, -0.01, 0.03]
    plant = nominal_plant(arm.machine(1e-4)).with_effect(KnownEffect("tip_offset", "ee", {"translation": shift}))
    files = {**plant.machine.files(), "arm.urdf": build_bodies(plant).urdf}
    moved = machine_from_files(files, "moved").kinematics()
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (5, 6))
    assert moved is not None
    joints = {f"{name}.joint": q[:, k] for k, name in enumerate(arm.names)}
    table = pd.DataFrame({"time": np.arange(5.0), **joints, **dict.fromkeys(("ee.x", "ee.y", "ee.z"), 0.0)})
    model = compile_plant(plant)
    expected = model.tip(model.theta[None], Recording("poses", table, 1.0, kind="poses"))[0]
    np.testing.assert_allclose(moved.tip_position(q), expected, atol=1e-12)
    with pytest.raises(SettingsError, match="tip_offset of tip, which a joint moves"):
        build_bodies(crane(KnownEffect("tip_offset", "ee", {"translation": shift})))


def test_the_world_predicts_the_speeds_that_are_measured() -> None:
    plant = crane(KnownEffect("sensor_scale", "slew.speed", {"scale": 1.1}))
    source = driven(plant)
    source = replace(source, table=source.table.assign(**{"slew.speed": 0.0, "boom.speed": 0.0}))
    run = free_run(plant, source)
    with World(plant, ground=FREE) as world:
        found = world.rollout(source)
    assert list(found.columns) == list(run.columns)
    assert worst(found, run, ["slew.speed", "boom.speed"]) < 1e-6
    assert float(np.ptp(run["slew.speed"])) > 0.05


def test_the_tool_swings_as_identified() -> None:
    plant = crane(SWAY)
    source = driven(plant)
    run = free_run(plant, source)
    swing = float((run["tool.x"] - run["ee.x"]).abs().max())
    assert swing > 0.01
    with World(plant, ground=FREE, gripper="point") as world:
        point = world.rollout(source)
    with World(plant, ground=FREE) as world:
        rigid = world.rollout(source)
    assert worst(point, run, TOOL) < 2e-3
    assert worst(point, run, TOOL) < worst(rigid, run, TOOL) < 0.5 * swing
    distance = np.linalg.norm(rigid[TOOL].to_numpy() - rigid[POINTS].to_numpy(), axis=1)
    np.testing.assert_allclose(distance, 0.25, atol=1e-6)


def test_a_free_swing_has_the_period_and_the_damping_of_the_equation() -> None:
    length, ratio = 0.25, 0.05
    plant = crane(replace(SWAY, parameters={"length": length, "damping_ratio": ratio}))
    with World(plant, ground=FREE, gripper="point", substeps=8) as world:
        world.reset(START)
        for _ in range(30):
            world.step([0.0, 0.0, 0.0, 0.8])
        swing = []
        for _ in range(400):
            state = world.step(np.zeros(4))
            swing.append(np.linalg.norm(state.tool[:2] - state.ee[:2]))
    values = np.array(swing[50:])
    peaks = 1 + np.flatnonzero((values[1:-1] > values[:-2]) & (values[1:-1] >= values[2:]))
    rate = np.sqrt(9.80665 / length)
    assert np.diff(peaks).mean() / 100.0 == pytest.approx(np.pi / rate, rel=0.02)
    decay = np.polyfit(peaks / 100.0, np.log(values[peaks]), 1)[0]
    assert -decay == pytest.approx(ratio * rate, rel=0.05)


def test_a_tool_without_joints_of_its_own_gets_two() -> None:
    """The probe's tool is fixed to its tip; servo, valve and force axes together."""
    plant = nominal_plant(probe_machine()).with_effect(SWAY)
    bodies = build_bodies(plant, "point")
    assert bodies.hanging is not None
    assert [joint.name for joint in bodies.hanging.joints] == ["sway_pitch", "sway_roll"]
    source = probe_recording(4.0)
    start = source.table.iloc[:20]
    table = source.table[["time", *(name for name in source.signals if name.endswith(".command"))]].copy()
    for axis in plant.machine.axes:
        table[axis.driven] = start[axis.driven]
    time = source.values("time")
    table["wrist.command"] = 0.3 - 0.3 * np.cos(1.5 * time)
    table["slide.command"] = 0.3 * np.sin(3.0 * time)
    source = replace(source, table=table)
    run = free_run(plant, source)
    with World(plant, ground=FREE, gripper="point") as world:
        found = world.rollout(source)
    assert worst(found, run, ["slew.joint", "boom.joint", "slide.joint", "wrist.joint"]) < 1e-9
    assert worst(found, run, POINTS) < 1e-6
    swing = float((run["tool.x"] - run["ee.x"]).abs().max())
    assert worst(found, run, TOOL) < 0.25 * swing


def test_a_sway_without_a_link_in_the_description_gets_one() -> None:
    """The plant alone knows that a tool swings there: machine.toml names none, and its URDF has nothing below the tip."""
    linked = probe_machine()
    assert linked.urdf_text is not None
    urdf = "\n".join(line for line in linked.urdf_text.splitlines() if 'link name="tool"' not in line and "hang" not in line)
    bare = nominal_plant(replace(linked, tool=None, urdf_text=urdf))
    assert build_bodies(bare, "point").hanging is None
    runs = []
    for plant in (bare.with_effect(SWAY), nominal_plant(linked).with_effect(SWAY)):
        with World(plant, ground=FREE, gripper="point") as world:
            runs.append(world.rollout(probe_recording(2.0)))
    assert worst(runs[0], runs[1], [*POINTS, *TOOL]) < 1e-6
    assert float((runs[0]["tool.x"] - runs[0]["ee.x"]).abs().max()) > 1e-3


def test_without_sway_nothing_hangs_and_the_tool_is_the_tip() -> None:
    with World(crane()) as world:
        state = world.reset(START)
        np.testing.assert_array_equal(state.tool, state.ee)
        assert "gripper" not in build_bodies(world.plant).urdf


def test_dynamic_drives_are_as_strong_as_the_urdf_says() -> None:
    plant = crane(SWAY)
    source = driven(plant, 4.0)
    run = free_run(plant, source)
    joints = [f"{name}.joint" for name in plant.machine.axis_names]
    with World(plant, ground=FREE, mode="dynamic") as world:
        assert worst(world.rollout(source), run, joints) < 1e-4
    weak = replace(plant.machine, urdf_text=(plant.machine.urdf_text or "").replace('effort="120"', 'effort="12"'))
    with World(replace(plant, machine=weak), ground=FREE, mode="dynamic") as world:
        assert world.reset(START).joints[1] == pytest.approx(START[1], abs=1e-5)
        for _ in range(50):
            state = world.step(np.zeros(4))
    assert state.joints[1] < START[1] - 0.1, "12 N·m do not hold the boom"


def test_the_gripper_meets_the_ground_and_pushes_a_log() -> None:
    plant = crane(SWAY)
    with World(plant, ground=-0.06, logs=(Log((0.9, 0.0, -0.03)),)) as world:
        world.reset([0.4, 0.85, -1.2, 0.1])
        assert world.contacts() == 0
        heights, touched = [], 0
        for _ in range(500):
            state = world.step([0.0, -0.6, 0.0, 0.0])
            heights.append(state.tool[2])
            touched = max(touched, world.contacts())
            if state.ee[2] < 0.22:
                break
        assert touched > 0
        assert min(heights) > -0.06, "the gripper does not fall through the ground"
        before = world.log_positions()
        for _ in range(300):
            world.step([-0.8, 0.0, 0.0, 0.0])
        assert np.linalg.norm(world.log_positions()[0] - before[0]) > 0.01
        moved = world.log_positions()
        world.reset(START)
        np.testing.assert_allclose(world.log_positions(), [[0.9, 0.0, -0.03]])
        assert not np.allclose(moved, world.log_positions())


def test_the_same_start_gives_the_same_run_and_worlds_do_not_meet() -> None:
    plant = crane(SWAY)
    logs = (Log((0.8, 0.1, 0.0)),)
    with World(plant, logs=logs) as one, World(crane(replace(SWAY, parameters={"length": 0.5, "damping_ratio": 0.1}))) as other:
        runs = []
        for _ in range(2):
            one.reset(START), other.reset(START)
            states = []
            for k in range(60):
                command = 0.8 * np.sin(0.1 * k) * np.ones(4)
                state = one.step(command)
                other.step(-command)
                states.append(np.concatenate([state.joints, state.ee, state.tool, one.log_positions()[0]]))
            runs.append(np.array(states))
    np.testing.assert_array_equal(*runs)


def test_a_gap_in_the_commands_is_left_out_and_the_run_restarts() -> None:
    plant = crane(SWAY)
    source = driven(plant, 4.0)
    table = source.table.copy()
    table.loc[150:199, "slew.command"] = np.nan
    source = replace(source, table=table)
    run = free_run(plant, source)
    with World(plant, ground=FREE) as world:
        found = world.rollout(source)
    missing = found["ee.x"].isna().to_numpy()
    assert missing[165:200].all()
    assert not missing[:150].any()
    assert not missing[200:].any()
    assert abs(found["slew.joint"][200] - run["slew.joint"][200]) < 1e-9


def test_pictures_show_the_machine_and_its_motion() -> None:
    with World(crane(SWAY), ground=-0.06) as world:
        world.reset(START)
        first = world.picture(160, 120)
        assert first.shape == (120, 160, 3)
        assert first.dtype == np.uint8
        orange = (first[..., 0].astype(int) - first[..., 2] > 80).mean()
        assert 0.005 < orange < 0.3
        np.testing.assert_array_equal(first, world.picture(160, 120))
        for _ in range(100):
            world.step([1.0, 0.0, 0.0, 0.0])
        assert (world.picture(160, 120) != first).any(axis=2).mean() > 0.005


def clients() -> int:
    import pybullet

    return sum(bool(pybullet.isConnected(k)) for k in range(64))


@pytest.fixture
def no_leak() -> Iterator[None]:
    before = clients()
    yield
    assert clients() == before


@pytest.mark.usefixtures("no_leak")
def test_clients_and_temporary_files_are_released(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    plant = crane()
    with World(plant) as world:
        assert len(list(tmp_path.iterdir())) == 1
    assert world.closed
    assert list(tmp_path.iterdir()) == []
    world.close()
    with pytest.raises(SettingsError, match=r"is closed; expected an open world\. Make a new one\."):
        world.step(np.zeros(4))
    forgotten = World(plant)
    del forgotten
    with pytest.raises(ZeroDivisionError), World(plant):
        _ = 1 / 0


def test_mistakes_say_what_was_expected(monkeypatch: pytest.MonkeyPatch) -> None:
    plant = crane()
    with pytest.raises(SettingsError, match=r"mode = 'kinematc'; expected 'kinematic'\?"):
        World(plant, mode="kinematc")  # type: ignore[arg-type]
    with pytest.raises(SettingsError, match="substeps = 0; expected at least 1"):
        World(plant, substeps=0)
    with pytest.raises(SettingsError, match=r"axis boom has no linkage; expected geometry in machine\.toml or a fitted"):
        World(nominal_plant(load_machine(MACHINE)))
    slide = machine_from_files(
        {
            "machine.toml": "schema = 1\nname = 'slide'\nrate_hz = 100.0\n[[axes]]\nname = 'slide'\n"
            "actuation = 'velocity'\ndrives = 'joint'\n"
        },
        "slide",
    )
    with pytest.raises(
        SettingsError, match=r"machine slide has no URDF; expected urdf and tip in machine\.toml\. The compiled"
    ):
        World(nominal_plant(slide))
    with World(plant) as world:
        with pytest.raises(SettingsError, match="was never reset"):
            world.step(np.zeros(4))
        with pytest.raises(SettingsError, match=r"recording waves: 50\.0 Hz; expected 100\.0 Hz, as the world"):
            world.rollout(replace(driven(plant, 1.0), rate_hz=50.0))
    monkeypatch.delenv("DISPLAY", raising=False)
    if sys.platform == "linux":
        with pytest.raises(SettingsError, match="no display for a window; expected DISPLAY"):
            World(plant, window=True)


def test_a_mass_without_inertia_gets_one() -> None:
    plant = nominal(machine=loaded_arm())
    with World(plant) as world:
        world.reset(np.zeros(len(plant.machine.axes)))
        assert np.isfinite(world.step(np.zeros(len(plant.machine.axes))).joints).all()


def test_a_missing_pybullet_is_explained(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(SettingsError, match=r"pybullet is not installed \(Python 3\.\d+\); expected pybullet .*Python 3\.11"):
        World(crane())


def test_a_passive_joint_follows_its_master() -> None:
    axes = "".join(
        f'[[axes]]\nname = "{name}"\njoint = "{name}"\nactuation = "position"\ndrives = "joint"\n' for name in JOINTS
    )
    head = 'schema = 1\nname = "palletiser"\nrate_hz = 100.0\nurdf = "arm.urdf"\ntip = "wrist_link"\n'
    machine = machine_from_files({"machine.toml": head + axes, "arm.urdf": urdf()}, "palletiser")
    kinematics = machine.kinematics()
    assert kinematics is not None
    with World(nominal_plant(machine, {})) as world:
        state = world.reset(np.zeros(4))
        for command in np.linspace(0.0, 0.6, 20):
            state = world.step(np.full(4, command))
        np.testing.assert_allclose(state.ee, kinematics.tip_position(state.joints[None])[0], atol=1e-6)
        assert state.joints[1] > 0.3
