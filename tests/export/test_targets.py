"""Effects × targets: every native, composed and plugin cell replays as the plant does; the page of them is current."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from test_drive_model import name_of, placed, probe_plant

from export_matrix import with_matrix
from sysid.datasets.recording import Recording
from sysid.effects import CATALOGUE, effect_named
from sysid.export.drive_data import WITHOUT_PART
from sysid.export.drive_module import load_module
from sysid.export.export import TARGETS, target_named
from sysid.export.mjcf_arm import FRICTION_BY_LOOP
from sysid.export.replay import ROUNDING, SHARE, Replay, replay
from sysid.export.target import Target
from sysid.machine import KnownEffect, machine_from_files
from sysid.plant import Plant, nominal_plant
from sysid.testing.probe import RATE_HZ, probe_recording

ROOT = Path(__file__).parents[2]
#: The probe's commands throw a hanging tool over its pivot, where its motion is chaotic: shares of them at which it swings by
#: less than 20°.
SWINGING = ("gripper_sway",)
CALM = {"slew": 0.3, "slide": 0.02, "wrist": 0.02}


def recording(calm: float = 0.0) -> Recording:
    """The inputs of the probe, or ``calm`` times the smaller ones."""
    source = probe_recording()
    if not calm:
        return source
    little = {f"{name}.command": calm * size * source.values(f"{name}.command") for name, size in CALM.items()}
    return replace(source, table=source.table.assign(**little))


def replayed(target: Target, plant: Plant, folder: Path, calm: float = 0.0) -> Replay:
    target.write(plant, plant.machine.rate_hz, folder)
    simulation = target.simulation(plant, folder)
    assert simulation is not None
    return replay(plant, simulation, [recording(calm)], {})


#: Targets whose simulator is not installed: their files are checked in tests of their own.
NOT_RUN = ("sdf",)
RUN = [target for target in TARGETS if target.name not in NOT_RUN]


def cells() -> list[object]:
    """Every cell at every place. Fast are those of the format's own elements, at the first place of each effect.

    The drive model, which computes all other cells and those of JSON, is compared with the plant in ``test_drive_model.py``.
    """
    found, known = [], set()
    for target in RUN:
        for item in placed():
            kind = target.support(effect_named(item.name)).kind
            if kind == "not_representable":
                continue
            fast = kind != "plugin" and target.name != "json" and (target.name, item.name) not in known
            known.add((target.name, item.name))
            marks = () if fast else (pytest.mark.slow,)
            found.append(pytest.param(target, item, id=f"{target.name}-{name_of(item)}", marks=marks))
    return found


@pytest.mark.parametrize(("target", "item"), cells())
def test_a_cell_replays_as_the_plant_does(target: Target, item: KnownEffect, tmp_path: Path) -> None:
    found = replayed(target, probe_plant(item), tmp_path, float(item.name in SWINGING))
    assert {row.signal for row in found.rows} >= {"slew.joint", "boom.cylinder", "boom.joint", "slide.joint", "ee.x", "tool.z"}
    assert [row for row in found.rows if not row.agrees] == []
    bounds = {row.signal: max(SHARE * row.motion, ROUNDING) for row in found.rows}
    assert {row.signal: row.allowed for row in found.rows} == pytest.approx(bounds)


@pytest.mark.parametrize(
    ("length", "damping_ratio", "calm"),
    [(0.1, 0.05, 1.0), (0.6, 0.1, 1.0), (1.0, 0.01, 1.0), (0.25, 0.02, 3.0), (0.25, 0.02, 4.0)],
)
def test_a_hanging_tool_below_a_turning_link(length: float, damping_ratio: float, calm: float, tmp_path: Path) -> None:
    """The boom turns the link of the tip, which a damped tool must not follow. The last two swing by 54° and 76°."""
    plant = probe_plant(KnownEffect("gripper_sway", "tool", {"length": length, "damping_ratio": damping_ratio}))
    found = replayed(target_named("mjcf"), plant, tmp_path, calm)
    assert [row for row in found.rows if not row.agrees] == []


@pytest.mark.parametrize("target", RUN, ids=lambda target: target.name)
def test_an_effect_that_is_not_representable_is_missed_by_the_replay(target: Target, tmp_path: Path) -> None:
    """The replay is what shows it: an export without the effect differs from the plant."""
    for name, place in (("valve_hysteresis", "slew"), ("pump_flow_limit", "machine"), ("gripper_sway", "tool")):
        effect = effect_named(name)
        if target.support(effect).kind == "not_representable":
            folder = tmp_path / name
            folder.mkdir()
            item = KnownEffect(name, place, dict(effect.example))
            assert not replayed(target, probe_plant(item), folder).agrees, name


def test_every_cell_has_a_reason() -> None:
    for target in TARGETS:
        for effect in CATALOGUE:
            assert len(target.support(effect).how) > 5, (target.name, effect.name)


def test_the_page_is_current() -> None:
    page = (ROOT / "docs" / "guide" / "export.md").read_text("utf-8")
    assert with_matrix(page) == page, "python pipelines/export_matrix.py docs/guide/export.md"


def test_what_no_part_computes_is_data_alone() -> None:
    by_plugin = {t.name: {e.name for e in CATALOGUE if t.support(e).kind == "plugin"} for t in TARGETS}
    of_arms = by_plugin["mjcf"] & set(WITHOUT_PART)  # the loop of an arm computes its forces
    assert of_arms == set(FRICTION_BY_LOOP)
    assert not (set().union(*by_plugin.values()) - of_arms) & set(WITHOUT_PART)
    assert not any(names & of_arms for target, names in by_plugin.items() if target != "mjcf")


def test_a_machine_without_a_urdf(tmp_path: Path) -> None:
    """Its axes are bodies side by side."""
    text = """schema = 1
name = "pair"
rate_hz = 100.0
[[axes]]
name = "turn"
actuation = "velocity"
drives = "joint"
gain = 0.5
joint_type = "revolute"
limits = [-0.3, 0.3]
[[axes]]
name = "push"
actuation = "force"
drives = "joint"
inertia = 2.0
joint_type = "prismatic"
limits = [-5.0, 5.0]
"""
    machine = machine_from_files({"machine.toml": text}, "pair")
    source = probe_recording()
    names = {"slew": "turn", "slide": "push"}
    table = source.table[["time"]].copy()
    for probe, name in names.items():
        for kind in ("command", "joint"):
            table[f"{name}.{kind}"] = source.values(f"{probe}.{kind}")
    for k, target in enumerate(TARGETS):
        folder = tmp_path / str(k)
        folder.mkdir()
        plant = nominal_plant(machine)
        target.write(plant, 100.0, folder)
        simulation = target.simulation(plant, folder)
        assert (simulation is None) == (target.name in NOT_RUN)
        if simulation is None:
            continue
        found = replay(plant, simulation, [Recording("run", table, RATE_HZ)], {})
        assert found.agrees, (target.name, found.rows)
        ends = [row for row in found.rows if row.signal == "turn.joint"]
        assert ends[0].motion > 0.1, "it reaches its end stops"


def test_a_machine_with_several_effects_is_composed(tmp_path: Path) -> None:
    """Delay, lag and gain in the actuator, dead-band before it, backlash as a second joint, the cylinder as a tendon."""
    effects = [
        KnownEffect("valve_deadband", "boom", {"positive": 0.05, "negative": 0.08}),
        KnownEffect("input_delay", "boom", {"delay": 0.042}),
        KnownEffect("first_order_lag", "boom", {"time_constant": 0.06}),
        KnownEffect("gain_error", "boom", {"ratio": 0.9}),
        KnownEffect("backlash", "boom", {"width": 0.018}, "drive"),
        KnownEffect("joint_offset", "boom", {"offset": 0.03}),
        KnownEffect("internal_leakage", "slew", {"rate": 0.004}),
        KnownEffect("backlash", "slew", {"width": 0.03}, "structure"),
        KnownEffect("gripper_sway", "tool", {"length": 0.25, "damping_ratio": 0.02}),
    ]
    plant = probe_plant(*effects)
    found = replayed(target_named("mjcf"), plant, tmp_path, calm=1.0)
    assert [row for row in found.rows if not row.agrees] == []
    about = json.loads((tmp_path / "robot.json").read_text("utf-8"))
    modes = {axis["axis"]: (axis["mode"], axis["reason"]) for axis in about["axes"]}
    assert modes["slew"] == ("native", "")
    assert modes["boom"] == ("command", "valve_deadband")
    text = (tmp_path / "robot.xml").read_text("utf-8")
    for part in ('delay="0.041999"', 'name="boom_cylinder"', 'name="boom_joint_backlash"', 'name="tool_swing"', "filterexact"):
        assert part in text


def test_the_control_callback_is_the_loop(tmp_path: Path) -> None:
    """Installed in MuJoCo, it may be called more than once a step."""
    import mujoco

    plant = probe_plant(KnownEffect("valve_deadband", "boom", {"positive": 0.05, "negative": 0.08}))
    target_named("mjcf").write(plant, RATE_HZ, tmp_path)
    robots = [load_module(tmp_path / "mujoco_robot.py") for _ in range(2)]
    loop, callback = (
        module.Robot(tmp_path / "robot.xml", load_module(tmp_path / "drive_model.py").load()) for module in robots
    )
    joints, rng = [0.1, 0.2, 0.0, 0.3], np.random.default_rng(0)
    loop.reset(joints)
    mujoco.set_mjcb_control(callback.control)
    try:
        callback.reset(joints)
        for _ in range(30):
            command = rng.uniform(-1.0, 1.0, 4)
            mujoco.set_mjcb_control(None)
            expected = loop.step(command)
            mujoco.set_mjcb_control(callback.control)
            callback.commands = command
            for _ in range(callback.substeps):
                mujoco.mj_forward(callback.model, callback.data)
                mujoco.mj_step(callback.model, callback.data)
        mujoco.mj_forward(callback.model, callback.data)
        found = callback.signals()
    finally:
        mujoco.set_mjcb_control(None)
    assert found["boom.cylinder"] == pytest.approx(expected["boom.cylinder"], abs=1e-9)
    assert found["slide.joint"] == pytest.approx(expected["slide.joint"], abs=1e-9)
