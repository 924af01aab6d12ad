"""Descriptions and recipes with a part missing, empty or of another kind: refused by a message, or read, by every reader."""

from __future__ import annotations

import contextlib
import copy
import functools
import json
import shutil
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, fromstring, tostring

import numpy as np
import pytest

from sysid.config import inside, toml_values
from sysid.datasets import ingest
from sysid.errors import SettingsError, SysidError
from sysid.export.export import target_named
from sysid.machine import machine_from_files
from sysid.machine.sources.urdf import urdf_draft
from sysid.machine.urdf_tree import urdf_tree
from sysid.names import check_pattern
from sysid.plant import nominal_plant
from sysid.view.drawing import STYLES, link_shapes, primitives
from sysid.world.bodies import build_bodies

MACHINE = """schema = 1
name = "arm"
rate_hz = 50.0
urdf = "arm.urdf"
tip = "hand"
tool = "hook"
left_out = ["a mesh"]
[markers]
elbow = "fore"
[[axes]]
name = "boom"
joint = "boom_joint"
joint_type = "revolute"
actuation = "velocity"
drives = "joint"
gain = 0.5
limits = [-1.0, 1.0]
[[axes]]
name = "stick"
joint = "stick_joint"
actuation = "velocity"
drives = "joint"
gain = 0.5
inertia = 1.0
[noise]
"boom.joint" = 1e-4
[[effects]]
name = "first_order_lag"
target = "boom"
parameters = { time_constant = 0.06 }
"""
URDF = """<robot name="arm">
<link name="base"><visual><origin xyz="0 0 0" rpy="0 0 0"/><geometry><sphere radius="0.1"/></geometry></visual></link>
<link name="fore"><inertial><origin xyz="0 0 0" rpy="0 0 0"/><mass value="2"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<visual><geometry><box size="1 1 1"/></geometry></visual>
<collision><geometry><cylinder radius="1" length="1"/></geometry></collision></link>
<link name="hand"><inertial><mass value="2"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
<visual><geometry><cylinder radius="1" length="1"/></geometry></visual>
<visual><geometry><capsule radius="1" length="1"/></geometry></visual>
<visual><geometry><mesh filename="package://a/b.stl" scale="1 1 1"/></geometry></visual></link>
<link name="hook"/>
<joint name="boom_joint" type="revolute"><parent link="base"/><child link="fore"/><origin xyz="0 0 1" rpy="0 0 0"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/><dynamics damping="0.1" friction="0.2"/></joint>
<joint name="stick_joint" type="prismatic"><parent link="fore"/><child link="hand"/><origin xyz="0 0 1"/>
<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort="10" velocity="1"/></joint>
<joint name="hook_joint" type="revolute"><parent link="hand"/><child link="hook"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1"/><mimic joint="boom_joint" multiplier="1" offset="0"/></joint>
<transmission name="t"><joint name="boom_joint"><hardwareInterface>VelocityJointInterface</hardwareInterface></joint>
</transmission>
<ros2_control name="x"><joint name="stick_joint"><command_interface name="velocity"/></joint></ros2_control>
<gazebo reference="hand"><material>grey</material></gazebo>
</robot>"""
#: Values of an attribute.
WORDS = ("", "x", "1 2", "nan nan nan", "-1", "²")
#: Values of a key of a TOML file.
VALUES: tuple[Any, ...] = ("", "a\0b", "x", -1, [])


#: Of an element and the one above it.
Change = Callable[[Element, Element], None]


def changed_urdfs() -> Iterator[str]:
    """Each element left out, emptied and repeated, and each attribute left out and changed."""
    root = fromstring(URDF)
    for number, element in enumerate(root.iter()):
        changes: list[Change] = [] if element is root else [_removed, _emptied, _repeated]
        for key in element.attrib:
            changes += [functools.partial(_set, key=key, word=word) for word in (None, *WORDS)]
        for change in changes:
            copied = copy.deepcopy(root)
            own = list(copied.iter())[number]
            change(next((above for above in copied.iter() if own in list(above)), copied), own)
            yield tostring(copied, encoding="unicode")


def _removed(above: Element, own: Element) -> None:
    above.remove(own)


def _repeated(above: Element, own: Element) -> None:
    above.append(copy.deepcopy(own))


def _emptied(_: Element, own: Element) -> None:
    own.clear()  # keeps its tag


def _set(_: Element, own: Element, key: str, word: str | None) -> None:
    own.attrib.pop(key)
    if word is not None:
        own.set(key, word)


@pytest.mark.slow
def test_a_urdf_with_any_part_missing_or_wrong_is_refused_or_read_by_every_reader(tmp_path: Path) -> None:
    read = set()
    for text in changed_urdfs():
        with contextlib.suppress(SysidError):
            urdf_draft(text, "arm.urdf")
        try:
            machine = machine_from_files({"machine.toml": MACHINE, "arm.urdf": text}, "here")
            kinematics = machine.kinematics()
        except SysidError:
            continue
        described = tostring(urdf_tree(text), encoding="unicode")
        if described in read:  # all readers start from this tree
            continue
        read.add(described)
        assert kinematics is not None
        for shapes in link_shapes(text, kinematics).values():
            for shape in shapes:
                primitives(shape, STYLES["measured"])
        plant = nominal_plant(machine)
        build_bodies(plant)
        for name in ("mjcf", "urdf", "sdf"):
            target = target_named(name)
            shutil.rmtree(tmp_path)
            tmp_path.mkdir()
            target.write(plant, 50.0, tmp_path)
            target.simulation(plant, tmp_path)
    assert len(read) > 50


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('<joint name="boom_joint" type', "<joint type", 'urdf: a <joint> without a name; expected <joint name="…">'),
        ('<link name="hook"/>', "<link/>", 'urdf: a <link> without a name; expected <link name="…">'),
        (
            '<parent link="base"/>',
            '<parent link="base"/><parent link="hook"/>',
            "2 elements <parent>; expected one parent and one",
        ),
        ('<child link="fore"/>', "", "no <child link=…>; expected one parent and one child"),
    ],
)
def test_what_makes_a_urdf_ambiguous_is_named(before: str, after: str, message: str) -> None:
    with pytest.raises(SettingsError) as refused:
        urdf_tree(URDF.replace(before, after, 1))
    assert message in str(refused.value)


def test_repeated_elements_are_listed_and_the_first_one_counts() -> None:
    text = URDF.replace(
        '<axis xyz="0 1 0"/><limit lower="-1" upper="1" effort',
        '<axis xyz="0 1 0"/><axis/><limit lower="-1" upper="1" effort',
        1,
    )
    assert "repeated <axis>, of which the first counts, in boom_joint" in urdf_draft(text, "arm.urdf").left_out
    joint = urdf_tree(text).find("joint")
    assert joint is not None
    assert [axis.get("xyz") for axis in joint.findall("axis")] == ["0 1 0"]


RECIPE = """schema = 1
name = "arm"
machine = "machine.toml"
logs = "logs"
hold_s = 0.5
[recordings]
motion = ["*"]
poses = ["x*"]
files = {first = "a.csv", second = "b.csv"}
[splits]
fit = []
select = []
held_out = []
guard_s = 0.1
held_out_last = {first = 0.3}
[still]
seconds = 0.4
tolerance = 2e-3
[[streams]]
files = "*.csv"
recordings = ["*"]
reader = "csv"
domain = "machine"
time = "t"
time_unit = "s"
delimiter = ","
decimal = "."
max_gap_s = 0.2
secondary = []
[streams.signals]
"boom.command" = {field = "cmd", unit = "1", zero = 0.0, span = 1.0, offset = 0.0, sign = 1, primary = true}
"boom.joint" = {field = "pos", unit = "rad", modulus = 0.0}
"""


def changed_settings(text: str) -> Iterator[str]:
    """Each key of a TOML text left out, and with other values."""
    values = tomllib.loads(text)
    for path in _places(values, ()):
        for value in (None, *VALUES):
            copied = copy.deepcopy(values)
            at: Any = copied
            for key in path[:-1]:
                at = at[key]
            if value is None:
                del at[path[-1]]
            else:
                at[path[-1]] = value
            yield "\n".join(f"{json.dumps(key)} = {_toml(value)}" for key, value in copied.items())


def _places(values: Any, path: tuple[Any, ...]) -> Iterator[tuple[Any, ...]]:
    inner = values.items() if isinstance(values, dict) else enumerate(values) if isinstance(values, list) else ()
    for key, value in inner:
        yield (*path, key)
        yield from _places(value, (*path, key))


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return f"{{{', '.join(f'{json.dumps(key)} = {_toml(inner)}' for key, inner in value.items())}}}"
    return f"[{', '.join(map(_toml, value))}]" if isinstance(value, list) else json.dumps(value)


@pytest.fixture
def machine_folder(tmp_path: Path) -> Path:
    """A machine with two logs of 20 s."""
    folder = tmp_path / "arm"
    (folder / "logs").mkdir(parents=True)
    time = np.arange(1000) / 50.0
    rows = np.column_stack([time, np.sin(time), 0.5 * (1.0 - np.cos(time))])
    for name in ("a.csv", "b.csv"):
        np.savetxt(folder / "logs" / name, rows, "%.5f", ",", header="t,cmd,pos", comments="")
    for name, text in (("machine.toml", MACHINE), ("recipe.toml", RECIPE), ("arm.urdf", URDF)):
        (folder / name).write_text(text)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("file", ["machine.toml", "recipe.toml"])
def test_any_key_missing_or_wrong_ends_in_a_version_or_a_message(file: str, machine_folder: Path) -> None:
    ingest(machine_folder, machine_folder.parent / "workspace")
    for text in changed_settings((machine_folder / file).read_text()):
        (machine_folder / file).write_text(text)
        try:
            ingest(machine_folder, machine_folder.parent / "workspace")
        except SysidError:
            continue
        except Exception as error:
            raise AssertionError(text) from error


def test_a_null_character_is_refused_in_every_toml_file() -> None:
    for text in (r'a = "x\u0000"', r'"a\u0000" = 1', r'a = [{b = ["\u0000"]}]'):
        with pytest.raises(SettingsError, match=r"f.toml: not valid TOML: a null character in '.*\\x00'"):
            toml_values(text, "f.toml")


@pytest.mark.parametrize("path", ["a\0b", "x" * 300, "circle/x"])
def test_a_path_that_the_system_does_not_have_is_refused(path: str, tmp_path: Path) -> None:
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    with pytest.raises(SettingsError, match=r"recipe\.toml: machine: path '.*\(.+\); expected a path inside its folder"):
        inside(tmp_path, path, "recipe.toml: machine")


@pytest.mark.parametrize("pattern", ["", ".", "/", "/x", "../x", "a**", "**/**", "**/a/**/b", "x" * 300])
def test_a_glob_that_finds_no_file_or_searches_without_end_is_refused(pattern: str) -> None:
    with pytest.raises(SettingsError, match="recipe: files"):
        check_pattern(pattern, "recipe: files")


def test_globs_of_the_recipes_are_taken() -> None:
    for pattern in ("*.csv", "**/*.csv", "run-[0-9]/log?.csv", "a b.csv"):
        assert check_pattern(pattern, "recipe: files") == pattern
