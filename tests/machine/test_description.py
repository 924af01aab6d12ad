"""machine.toml: what it accepts, and what it says about a mistake."""

from __future__ import annotations

import re
from pathlib import Path

import crane_data
import pytest
from plant_data import arm, slide

from sysid.errors import SettingsError
from sysid.machine import Machine, load_machine, machine_from_files

FILES = arm().files()


def changed(before: str, after: str) -> Machine:
    assert FILES["machine.toml"].count(before) >= 1, before
    return machine_from_files({**FILES, "machine.toml": FILES["machine.toml"].replace(before, after, 1)}, "machine.toml")


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("gain = 0.436", "gian = 0.436", "unknown key 'axes[0].gian'; expected 'gain'?"),
        ("rate_hz = 100.0", "rate_hz = 0.0", "rate_hz = 0.0; expected a number greater than or equal to 0.001"),
        ("rate_hz = 100.0", 'rate_hz = "fast"', "rate_hz = 'fast'"),
        ("schema = 1", "schema = 2", "schema = 2"),
        ('name = "boom"', 'name = "slew"', "axis 'slew': name is taken"),
        ('name = "boom"', 'name = "tool"', "axis 'tool': name is taken"),
        ("stroke = [0.0, 0.12]\n", "", "axis 'boom': no stroke; expected stroke = [lo, hi] [m]"),
        ("stroke = [0.0, 0.12]", "stroke = [0.12, 0.0]", "stroke = [0.12, 0.0]; expected lower end below upper end"),
        ('joint = "boom_joint"\n', "", "axis 'boom': no joint"),
        ('joint = "boom_joint"', 'joint = "bom_joint"', "unknown joint 'bom_joint'; expected 'boom_joint'?"),
        ('tip = "tip"\n', "", "a urdf but no tip"),
        ('tip = "tip"', 'tip = "tpi"', "urdf: tip: unknown link 'tpi'; expected 'tip'?"),
        ('tool = "grip"', 'tool = "gripper"', "urdf: tool: unknown link 'gripper'; expected 'grip'?"),
        ('"slew.joint" = 2e-4', '"slew.jont" = 2e-4', "noise: unknown signal 'slew.jont'; expected 'slew.joint'?"),
        ('actuation = "velocity"', 'actuation = "speed"', "axes[0].actuation = 'speed'"),
        ('kind = "triangle"', 'kind = "square"', "axes[1].linkage.kind = 'square'"),
        ("offset = 0.9", "offset = 2.5", "the lever angle runs from"),
        ("schema = 1", 'schema = 1\ntext = "x"', "unknown key 'text'"),
    ],
)
def test_mistakes_say_where_and_what_is_valid(before: str, after: str, message: str) -> None:
    with pytest.raises(SettingsError, match=re.escape(message)):
        changed(before, after)


def test_a_force_axis_needs_its_inertia() -> None:
    text = slide().files()["machine.toml"].replace("inertia = 20.0\n", "")
    with pytest.raises(SettingsError, match=r"axis 'slide': no inertia; expected inertia \[kg or kg·m²\]"):
        machine_from_files({"machine.toml": text}, "machine.toml")


def test_a_machine_without_axes() -> None:
    with pytest.raises(SettingsError, match="no axes"):
        machine_from_files({"machine.toml": 'schema = 1\nname = "x"\nrate_hz = 10.0\naxes = []\n'}, "machine.toml")


def test_an_unknown_axis_suggests_the_nearest() -> None:
    with pytest.raises(SettingsError, match=r"machine arm: unknown axis 'boon'; expected 'boom'\?"):
        arm().axis("boon")


def test_files_on_disk(tmp_path: Path) -> None:
    for name, text in FILES.items():
        (tmp_path / name).write_text(text, "utf-8")
    assert load_machine(tmp_path / "machine.toml") == arm()
    (tmp_path / "arm.urdf").unlink()
    with pytest.raises(SettingsError, match=r"urdf: no such file 'arm\.urdf'"):
        load_machine(tmp_path / "machine.toml")


def test_a_urdf_outside_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "machine.toml").write_text(FILES["machine.toml"].replace('"arm.urdf"', '"../arm.urdf"'), "utf-8")
    with pytest.raises(SettingsError, match=r"path '\.\./arm\.urdf' leaves the folder"):
        load_machine(tmp_path / "machine.toml")


def test_limits_come_from_the_urdf_unless_given() -> None:
    assert arm().axis("slew").limits == (-2.6, 2.6)
    assert changed("gain = 0.436", "gain = 0.436\nlimits = [-1.0, 1.0]").axis("slew").limits == (-1.0, 1.0)
    assert arm().axis("boom").range == (0.0, 0.12), "what the command drives is the cylinder"


@pytest.mark.parametrize(
    ("signal", "unit"),
    [
        ("slew.command", "1"),
        ("slew.joint", "rad"),
        ("boom.cylinder", "m"),
        ("wrist.command", "rad"),
        ("ee.x", "m"),
        ("tool.z", "m"),
    ],
)
def test_units_that_a_log_must_have(signal: str, unit: str) -> None:
    assert arm().expected_unit(signal) == unit


def test_a_joint_without_a_urdf_may_be_either() -> None:
    assert slide().expected_unit("slide.joint") is None
    assert slide().expected_unit("slide.command") is None


def test_a_misspelt_key_is_named_before_the_key_that_it_leaves_missing() -> None:
    with pytest.raises(SettingsError, match=r"unknown key 'axes\[0\]\.actuaton'; expected 'actuation'\?"):
        changed('actuation = "velocity"', 'actuaton = "velocity"')


def test_markers_are_signals_on_links_of_the_chain() -> None:
    files = {
        "machine.toml": crane_data.MACHINE.replace("[noise]", '[markers]\nelbow = "stick"\n[noise]'),
        "crane.urdf": crane_data.URDF,
    }
    machine = machine_from_files(files, "crane")
    assert machine.signals[-3:] == ("elbow.x", "elbow.y", "elbow.z")
    assert machine.expected_unit("elbow.y") == "m"


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ('elbow = "stik"', r"crane: markers: 'elbow': link 'stik', which is not between base and tip; .*stick"),
        ('boom = "stick"', "crane: markers: 'boom': a name that no marker can have"),
        ('"a.b" = "stick"', r"crane: markers: 'a\.b': a name that no marker can have"),
    ],
)
def test_a_wrong_marker_is_refused(entry: str, message: str) -> None:
    files = {
        "machine.toml": crane_data.MACHINE.replace("[noise]", f"[markers]\n{entry}\n[noise]"),
        "crane.urdf": crane_data.URDF,
    }
    with pytest.raises(SettingsError, match=message):
        machine_from_files(files, "crane")
