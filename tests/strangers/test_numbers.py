"""Numbers that no machine has: refused where they stand, with what was expected; never an answer, never a traceback."""

from __future__ import annotations

import re

import pytest

from sysid.datasets.recipe import stored_recipe
from sysid.errors import SettingsError
from sysid.machine import Machine, machine_from_files
from sysid_rl.train.recipe import parse_training

MACHINE = """schema = 1
name = "arm"
rate_hz = 100.0
urdf = "arm.urdf"
tip = "hand"
[[axes]]
name = "boom"
joint = "boom_joint"
actuation = "velocity"
drives = "cylinder"
gain = 0.05
stroke = [0.0, 0.1]
linkage = {kind = "triangle", a = 0.12, b = 0.4, offset = 1.1, retracted = 0.3}
[noise]
"boom.joint" = 1e-4
[[effects]]
name = "first_order_lag"
target = "boom"
parameters = { time_constant = 0.06 }
"""
URDF = """<robot name="arm"><link name="base"/>
<link name="hand"><inertial><origin xyz="0 0 0"/><mass value="2.0"/><inertia ixx="1" iyy="1" izz="1"/></inertial>
<visual><geometry><box size="1 1 1"/></geometry></visual></link>
<joint name="boom_joint" type="revolute"><parent link="base"/><child link="hand"/><origin xyz="0 0 1" rpy="0 0 0"/>
<axis xyz="0 1 0"/><limit lower="-0.5" upper="0.5" effort="10" velocity="1"/></joint></robot>
"""
HUGE = "1" * 400


def machine(text: str = MACHINE, urdf: str = URDF) -> Machine:
    found = machine_from_files({"machine.toml": text, "arm.urdf": urdf}, "here")
    found.kinematics()
    return found


def test_what_is_right_is_taken() -> None:
    assert machine().axis("boom").limits == (-0.5, 0.5)


@pytest.mark.parametrize("key", ["rate_hz", "gain", "a", "b", "retracted", "offset", "time_constant", '"boom.joint"'])
@pytest.mark.parametrize("value", ["nan", "inf", "-inf", HUGE, "1e300", "'text'"])
def test_no_number_of_a_machine_may_be_anything(key: str, value: str) -> None:
    if key == "time_constant" and value == "1e300":
        return  # the effect's own bounds are those of its form
    text, count = re.subn(rf"{key} = [0-9.e-]+", f"{key} = {value}", MACHINE, count=1)
    assert count == 1
    with pytest.raises(SettingsError, match="here"):
        machine(text)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("rate_hz = 100.0", "rate_hz = -1.0", "rate_hz = -1.0; expected a number greater than"),
        ("gain = 0.05", "gain = -0.05", "gain = -0.05; expected a number greater than"),
        ("gain = 0.05", "gain = 0.0", "gain = 0.0; expected a number greater than"),
        ("gain = 0.05", "gain = 0.05\ninertia = -1.0", "inertia = -1.0; expected a number greater than"),
        ("gain = 0.05", "gain = 0.05\nlimits = [1.0, -1.0]", "limits = [1.0, -1.0]; expected lower end below upper end"),
        ("stroke = [0.0, 0.1]", "stroke = [0.1, 0.1]", "stroke = [0.1, 0.1]; expected lower end below upper end"),
        ("stroke = [0.0, 0.1]", "stroke = [0.0, nan]", "expected a finite number"),
        ('"boom.joint" = 1e-4', '"boom.joint" = -1e-4', "expected a number greater than or equal to 0"),
        ("a = 0.12", "a = -0.12", "expected a number greater than"),
        ('name = "boom"', 'name = "b\\u001b[31m"', r"axis 'b\x1b[31m': a name that no signal can have"),
        ('name = "arm"', 'name = "../arm"', "name: '../arm'; expected the name of one file"),
    ],
)
def test_signs_orders_and_names_of_a_machine(before: str, after: str, message: str) -> None:
    assert before in MACHINE
    with pytest.raises(SettingsError, match=re.escape(message)):
        machine(MACHINE.replace(before, after, 1))


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ('mass value="2.0"', 'mass value="nan"', "finite number"),
        ('mass value="2.0"', 'mass value="heavy"', "a valid number"),
        ('mass value="2.0"', 'mass value="-2"', "greater than or equal to 0"),
        ('mass value="2.0"', f'mass value="{HUGE}"', "expected"),
        ('ixx="1"', 'ixx="minus"', "a valid number"),
        ('lower="-0.5"', 'lower="nan"', "finite number"),
        ('lower="-0.5"', 'lower="inf"', "the lever angle runs from -inf"),
        ('lower="-0.5"', 'lower="0.6"', "[0.6, 0.5]; expected the lower end below the upper end"),
        ('effort="10"', 'effort="-10"', "greater than or equal to 0"),
        ('xyz="0 0 1"', 'xyz="0 0 nan"', "finite number"),
        ('xyz="0 1 0"', 'xyz="0 one 0"', "a valid number"),
        ('link name="hand"', 'link name="ha\tnd"', "control character"),
        ("</robot>", '<link name="base"/></robot>', "two links are named 'base'"),
        ("</robot>", "<a>" * 5000 + "</a>" * 5000 + "</robot>", "nested deeper than 64 levels"),
    ],
)
def test_a_urdf_that_is_wrong_somewhere(before: str, after: str, message: str) -> None:
    assert before in URDF
    after = after.replace("\t", "&#9;")
    with pytest.raises(SettingsError, match=re.escape(message)) as refused:
        machine(urdf=URDF.replace(before, after, 1))
    assert str(refused.value).startswith(("urdf", "here: axis 'boom': linkage"))
    assert len(str(refused.value)) < 1000


RECIPE = """schema = 1
[splits]
guard_s = 1.0
[still]
seconds = 0.4
tolerance = 2e-3
[[streams]]
files = "a.csv"
max_gap_s = 0.1
[streams.signals]
"boom.joint" = {field = "x", zero = 1.0, span = 2.0, scale = 3.0, offset = 4.0}
[streams.frame]
translation = [1.0, 2.0, 3.0]
"""


@pytest.mark.parametrize("value", ["nan", "inf", HUGE, "-1e300"])
@pytest.mark.parametrize("key", ["guard_s", "seconds", "tolerance", "max_gap_s", "zero", "span", "scale", "offset"])
def test_no_number_of_a_recipe_may_be_anything(key: str, value: str) -> None:
    stored_recipe(RECIPE, "here")
    text, count = re.subn(rf"\b{key} = [0-9.e-]+", f"{key} = {value}", RECIPE, count=1)
    assert count == 1
    with pytest.raises(SettingsError, match="here"):
        stored_recipe(text, "here")


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 2000 + "]" * 2000,
        "a = " + "{b = " * 300 + "1" + "}" * 300,
        ".".join(["a"] * 100_000) + " = 1",
        ".".join(['"a b"'] * 1000) + " = 1",
        "schema = " + "1" * 10_000,
        "schema = 1\nname = '''\u202e'''\nx = 1",
        "schema = 1\nname = '../x'\n[recordings.files]\n'../../x' = 'a.csv'",
    ],
    ids=[
        "deep lists",
        "deep tables",
        "dotted key",
        "quoted dotted key",
        "long integer",
        "unknown key",
        "a name that is a path",
    ],
)
def test_toml_that_is_too_much_is_refused_at_once(text: str) -> None:
    with pytest.raises(SettingsError, match="here") as refused:
        stored_recipe(text, "here")
    assert len(str(refused.value)) < 1000


def test_the_name_of_a_policy_is_no_path() -> None:
    with pytest.raises(SettingsError, match=r"name: '\.\./\.\./x'; expected letters"):
        parse_training({"name": "../../x", "plant": "a", "forward": "b"}, "recipe.toml")
