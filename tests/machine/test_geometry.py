"""Kinematics against SciPy's rotations, linkages both ways, units and settings at the edge."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plant_data import URDF as FILES_URDF
from plant_data import arm
from scipy.spatial.transform import Rotation

from sysid.config import STRICT, load_settings, parse_settings
from sysid.errors import InputError, SettingsError, SysidError, nearest
from sysid.machine import Kinematics, Linkage, TabulatedLinkage, TriangleLinkage, tabulate
from sysid.machine.kinematics import rotation_about
from sysid.machine.urdf_tree import urdf_tree
from sysid.units import si_factor, split_header

# -- kinematics -----------------------------------------------------------------------------------------------------


@given(st.floats(-2.6, 2.6), st.floats(-0.43, 1.4), st.floats(-2.0, 2.0))
def test_tip_by_hand(slew: float, boom: float, wrist: float) -> None:
    """A planar arm on a turning column, written with sines and cosines."""
    reach = 0.05 + 0.6 * math.cos(boom) + 0.25 * math.cos(boom + wrist)
    height = 0.3 + 0.6 * math.sin(boom) + 0.25 * math.sin(boom + wrist)
    kinematics = arm().kinematics()
    assert kinematics is not None
    expected = [reach * math.cos(slew), reach * math.sin(slew), height]
    assert np.allclose(kinematics.tip_position(np.array([[slew, boom, wrist]]))[0], expected, atol=1e-12)


@given(st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda v: np.linalg.norm(v) > 0.1), st.floats(-7, 7))
def test_rotation_about_an_axis(axis: tuple[float, ...], angle: float) -> None:
    unit = np.array(axis) / np.linalg.norm(axis)
    assert np.allclose(rotation_about(unit, np.array([angle]))[0], Rotation.from_rotvec(angle * unit).as_matrix(), atol=1e-12)


@given(st.tuples(*[st.floats(-3, 3)] * 3))
def test_roll_pitch_yaw_of_a_urdf(rpy: tuple[float, ...]) -> None:
    text = FILES_URDF.replace('<origin xyz="0.6 0 0"/>', f'<origin xyz="0.6 0 0" rpy="{rpy[0]} {rpy[1]} {rpy[2]}"/>')
    kinematics = Kinematics.from_urdf(text, ("slew_joint", "boom_joint", "wrist_joint"), "tip")
    pose = kinematics.link_poses(np.zeros((1, 3)))["hand"][0]
    assert np.allclose(pose[:3, :3], Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-9)


@pytest.mark.parametrize(
    ("before", "after", "message"),
    [
        ("<robot", "<!DOCTYPE x [<!ENTITY a 'b'>]><robot", "not readable as XML"),
        ("</robot>", "", "not readable as XML"),
        ('<robot name="arm">', '<machine name="arm">', "not readable as XML"),
        (
            'type="fixed"',
            'type="floating"',
            "urdf: joint 'tip_joint': a floating joint, which moves the tip; expected revolute, continuous, prismatic or fixed",
        ),
        ('<child link="column"/>', "", "joint 'slew_joint': no <child link=…>"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 0 0"/>', "joint 'slew_joint': axis of length zero"),
        ('<axis xyz="0 0 1"/>', '<axis xyz="0 1"/>', "<axis>: xyz='0 1': 2 numbers; expected three numbers"),
        ('<child link="column"/>', '<child link="base"/>', "link 'base' is its own ancestor; expected a tree"),
    ],
)
def test_broken_urdf(before: str, after: str, message: str) -> None:
    text = FILES_URDF.replace(before, after, 1)
    with pytest.raises(SettingsError, match=re.escape(message)):
        Kinematics.from_urdf(text, ("slew_joint", "boom_joint", "wrist_joint"), "tip")


def test_the_ground_need_not_be_described() -> None:
    text = FILES_URDF.replace(
        "</robot>", '<joint name="weld" type="fixed"><parent link="world"/><child link="base"/></joint></robot>'
    )
    joints = ("slew_joint", "boom_joint", "wrist_joint")
    at = np.array([[0.3, -0.2, 0.1]])
    placed, free = (Kinematics.from_urdf(each, joints, "tip").link_poses(at)["hand"] for each in (text, FILES_URDF))
    np.testing.assert_allclose(placed, free)
    assert [link.get("name") for link in urdf_tree(text).findall("link")].count("world") == 1
    with pytest.raises(SettingsError, match="parent link 'ground', which is not described"):
        urdf_tree(text.replace('"world"', '"ground"'))


def test_a_joint_that_no_axis_names() -> None:
    with pytest.raises(SettingsError, match="joint 'wrist_joint' moves the tip but no axis names it"):
        Kinematics.from_urdf(FILES_URDF, ("slew_joint", "boom_joint"), "tip")


# -- linkages -------------------------------------------------------------------------------------------------------

TRIANGLES = [Linkage("triangle", 0.12, 0.20, 0.9, 0.15, 1), Linkage("triangle", 0.10, 0.25, -0.25, 0.16, -1)]


@pytest.mark.parametrize("geometry", TRIANGLES)
@given(share=st.floats(0.0, 1.0))
def test_triangle_there_and_back(geometry: Linkage, share: float) -> None:
    linkage = TriangleLinkage(geometry)
    angle = geometry.sense * (0.3 + 2.4 * share) - geometry.offset
    again = linkage.joint(linkage.displacement(np.array([angle])))[0]
    assert again == pytest.approx(angle, abs=1e-7)


def test_triangle_of_three_four_five() -> None:
    """Levers of 0.3 and 0.4 m at a right angle are 0.5 m apart."""
    linkage = TriangleLinkage(Linkage("triangle", 0.3, 0.4, 0.0, 0.2, 1))
    assert linkage.displacement(np.array([math.pi / 2]))[0] == pytest.approx(0.3)
    assert linkage.joint(np.array([0.3]))[0] == pytest.approx(math.pi / 2)
    assert np.isfinite(linkage.joint(np.array([-1.0, 9.0]))).all(), "beyond the triangle it saturates"


@pytest.mark.parametrize("geometry", TRIANGLES)
def test_table_there_and_back(geometry: Linkage) -> None:
    table = tabulate(TriangleLinkage(geometry), (0.0, 0.12))
    displacements = np.linspace(0.0, 0.12, 333)
    assert np.allclose(table.joint(displacements), TriangleLinkage(geometry).joint(displacements), atol=2e-6)
    assert np.allclose(table.displacement(table.joint(displacements)), displacements, atol=1e-9)


def test_a_table_goes_on_along_its_ends() -> None:
    table = TabulatedLinkage(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 3.0]))
    assert table.joint(np.array([-1.0, 3.0])).tolist() == [-1.0, 5.0]


class Wavy:
    """A fitted map that is not monotonic everywhere."""

    def joint(self, displacement: np.ndarray) -> np.ndarray:
        return displacement + 0.05 * np.sin(60 * displacement)

    def displacement(self, joint: np.ndarray) -> np.ndarray:
        raise NotImplementedError


def test_a_map_that_turns_back_becomes_monotonic() -> None:
    assert (np.diff(tabulate(Wavy(), (0.0, 1.0)).joints) > 0).all()


# -- units, settings, errors ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("unit", "factor", "si"),
    [("mm", 1e-3, "m"), ("deg", math.pi / 180, "rad"), ("°", math.pi / 180, "rad"), ("%", 0.01, "1"), ("", 1.0, "1"),
     ("kN", 1e3, "N"), ("N·m", 1.0, "N·m"), ("ms", 1e-3, "s"), ("inch", 0.0254, "m")],
)  # fmt: skip
def test_units(unit: str, factor: float, si: str) -> None:
    assert si_factor(unit) == (pytest.approx(factor), si)


def test_unknown_unit() -> None:
    with pytest.raises(InputError, match=r"log\.csv: unknown unit 'furlogs'"):
        si_factor("furlogs", "log.csv")


@pytest.mark.parametrize(
    ("header", "parts"),
    [
        ("boom.cylinder [mm]", ("boom.cylinder", "mm")),
        (" time ", ("time", None)),
        ("a[b]", ("a", "b")),
        ("x []", ("x", "")),
        ("x [a] [b]", ("x [a] [b]", None)),
    ],
)
def test_headers(header: str, parts: tuple[str, str | None]) -> None:
    assert split_header(header) == parts


@dataclass(frozen=True)
class Inner:
    __pydantic_config__ = STRICT
    size: float = 1.0


@dataclass(frozen=True)
class Outer:
    __pydantic_config__ = STRICT
    name: str
    parts: tuple[Inner, ...] = ()
    named: dict[str, Inner] = field(default_factory=dict)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({}, "here: key 'name' is missing"),
        ({"name": "a", "prats": []}, "here: unknown key 'prats'; expected 'parts'?"),
        ({"name": "a", "parts": [{"sise": 1}]}, "unknown key 'parts[0].sise'; expected 'size'?"),
        ({"name": "a", "parts": [{"size": "big"}]}, "parts[0].size = 'big'"),
        ({"name": "a", "named": {"x": {"sise": 1}}}, "sise'; expected 'size'?"),
    ],
)
def test_settings(values: dict[str, object], message: str) -> None:
    with pytest.raises(SettingsError, match=re.escape(message)):
        parse_settings(values, Outer, "here")


def test_settings_files(tmp_path: Path) -> None:
    path = tmp_path / "a.toml"
    with pytest.raises(SettingsError, match="no such file"):
        load_settings(path, Outer)
    with pytest.raises(SettingsError, match="is a folder"):
        load_settings(tmp_path, Outer)
    path.write_bytes(b"name = '\xff'")
    with pytest.raises(SettingsError, match="not UTF-8"):
        load_settings(path, Outer)
    path.write_text("name = ")
    with pytest.raises(SettingsError, match="not valid TOML"):
        load_settings(path, Outer)
    path.write_text("name = 'a'\n[[parts]]\nsize = 2\n")
    assert load_settings(path, Outer) == Outer("a", (Inner(2.0),))


def test_errors_say_where_what_and_what_to_do() -> None:
    error = SysidError("file.toml", "gain is missing", "a number", "Add it.")
    assert str(error) == "file.toml: gain is missing; expected a number. Add it."
    assert str(SysidError("x", "y")) == "x: y"
    assert nearest("boon", ["stick", "boom"]) == "'boom'? (valid: boom, stick)"
    assert nearest("zzz", ["boom"]) == "one of: boom"
    assert nearest("a", []) == "one of: none"
