"""Names of a machine in the files of every target, and its texts in generated source code."""

from __future__ import annotations

import ast
import functools
import json
import unicodedata
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
import pytest
from defusedxml.ElementTree import parse
from examples import examples
from hypothesis import given, settings
from hypothesis import strategies as st
from test_every_target import RATE, chain, exported, joint, link, plant_of, sdf_agrees, two_axes
from test_mjcf_arm import PAYLOAD, two_links

from sysid.export.drive_module import load_module
from sysid.export.export import TARGETS, target_named
from sysid.export.names import Names, identifier, same_file, scoped, word
from sysid.export.target import Target
from sysid.export.urdf import xml_text
from sysid.machine import KnownEffect, machine_from_files
from sysid.machine.urdf_tree import urdf_tree
from sysid.names import check_file_name
from sysid.plant import Plant
from sysid.quoting import code

pytestmark = pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning")
#: Targets that have no part for a swinging tool and for effects of the geometry.
TABLES = ("lut", "simulink")
#: Names as a URDF may have them: printable, those of elements at most 200 characters.
PRINTABLE = st.text(st.characters(exclude_categories=("C", "Z"), include_characters=" "), min_size=1, max_size=40)
FORMS: dict[str, tuple[Any, ...]] = {
    "mujoco": (["world"], str, str, 1000),
    "usd": ([], identifier, str, 1000),
    "sdf": (["world"], scoped, str, 1000),
    "mat": ([], word, str, 12),
    "file": ([], str, same_file, 20),
}


#: Names that are reserved, numbered, equal in a form or fold, or empty.
NEARBY = ("world", "world_1", "__x__", "a::b", "a-b", "a_b", "1", "Ä", "A\u0308", "ä", "", " ", "__", "a_1", "a")


@settings(max_examples=200, deadline=None)
@given(st.sampled_from(list(FORMS)), st.lists(st.one_of(PRINTABLE, st.sampled_from(NEARBY)), unique=True))
def test_a_namespace_gives_each_name_once(kind: str, names: list[str]) -> None:
    taken, form, fold, longest = FORMS[kind]
    found = Names(taken, form, fold, longest).each(names)
    assert list(found) == names
    folded = [fold(name) for name in found.values()]
    assert len({*folded, *taken}) == len(folded) + len(taken)
    for name, written in found.items():
        assert written
        assert form(written) == written
        assert len(written.encode()) <= longest
        possible = form(name) == name != "" and name not in taken and len(name.encode()) <= longest
        if possible and [fold(other) for other in names].count(fold(name)) == 1:
            assert written == name, "what can be kept is kept"


def test_forms() -> None:
    assert [identifier(name) for name in ("a-b", "1", "_x", "größe", "")] == ["a_b", "a_1", "a__x", "gr__e", ""]
    assert [scoped(name) for name in ("a::b", ":::", "__x__", " a ", "____", "_x_")] == ["a_b", "_", "x", "a", "", "_x_"]
    assert same_file("STRASSE") == same_file("straße")
    assert same_file("Ä") == same_file(unicodedata.normalize("NFD", "ä"))


#: Links and joints whose names targets reserve, use themselves or cannot hold.
LINKS = ("world", "a::b", "measured_frame", "q\"<&'>", "a-b", "a_b", "__x__", "ee", "tool_gimbal")
JOINTS = ("j", "j_drive", "world", "ee_joint", "base_joint", "1", "measured_frame_joint", "tool_gimbal")
AXES = ("Boom", "boom", "a-b", "a_b", "x" * 64, "ö" * 64, "x" * 63 + "y", "-")


def hostile(*effects: KnownEffect) -> Plant:
    """A chain of eight axes; its tip is a link ``ee``, its tool one called as a part of MuJoCo's pendulum."""
    parts = [link(name).replace(f'"{name}"', quoteattr(name)) for name in LINKS]
    for k, name in enumerate(JOINTS):
        ends = LINKS[k], LINKS[k + 1] if k < 7 else "tip_carrier"
        part = joint(name, "revolute", ("PARENT", "CHILD"), "0.1 0 0.05", ("0 0 1", "0 1 0")[k % 2])
        parts.append(part.replace('"PARENT"', quoteattr(ends[0])).replace('"CHILD"', quoteattr(ends[1])))
    parts += [link("tip_carrier"), joint("grip", "fixed", ("tip_carrier", "tool_gimbal"))]
    axes = [
        {"name": name, "joint": moved, "actuation": "velocity" if k < 4 else "position"} | ({"gain": 0.5} if k < 4 else {})
        for k, (name, moved) in enumerate(zip(AXES, JOINTS, strict=True))
    ]
    return plant_of(
        axes, "".join(parts), effects, 'it\'s """ \' {machine} %s <b> *) --> ` ö', tip="tip_carrier", tool="tool_gimbal"
    )


BACKLASH = KnownEffect("backlash", "Boom", {"width": 0.02}, "drive")
VARIANTS: dict[str, tuple[KnownEffect, ...]] = {
    "hanging": (BACKLASH, KnownEffect("gripper_sway", "tool", {"length": 1.0, "damping_ratio": 0.3})),
    "displaced": (
        KnownEffect("base_misalignment", "base", {"translation": [0.1, 0.0, -0.1], "rotation": [0.02, 0.0, 0.1]}),
        KnownEffect("joint_offset", "a-b", {"offset": 0.1}),
        KnownEffect("link_length_error", "a_b", {"error": 0.05}),
    ),
}


@pytest.mark.parametrize("target", TARGETS, ids=lambda target: target.name)
@pytest.mark.parametrize("variant", ["displaced", pytest.param("hanging", marks=pytest.mark.slow)])
def test_hostile_names_in_every_target(variant: str, target: Target, tmp_path: Path) -> None:
    plant = hostile(*VARIANTS[variant])
    made = exported(plant, target, tmp_path, force=target.name in TABLES)
    names = target.names(plant)
    for group in (names.links, names.joints, names.axes):
        assert len(set(group.values())) == len(group)
    page, stored = ((made.folder / name).read_text("utf-8") for name in ("README.md", "replay.json"))
    assert json.loads(stored)["renamed"] == [vars(part) for part in names.changed]
    for part in names.changed:
        assert f"- {part.kind} {code(part.name)}: {code(part.written)}\n" in page
    assert ("## Names" in page) == bool(names.changed)
    if target.name == "sdf":
        sdf_agrees(plant, tmp_path)
    elif target.name not in TABLES:
        assert made.replay is not None
        assert made.replay.agrees


def test_names_of_mujoco(tmp_path: Path) -> None:
    """Additions give way to the machine; the table says what they are called."""
    import mujoco

    plant = hostile(*VARIANTS["hanging"])
    target_named("mjcf").write(plant, RATE, tmp_path)
    model: Any = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    bodies, joints = (
        {getattr(model, kind)(k).name for k in range(n)} for kind, n in (("body", model.nbody), ("joint", model.njnt))
    )
    assert {*LINKS[1:], "world_1", "tool_gimbal_1"} <= bodies
    assert {*JOINTS, "j_drive_1", "tool_gimbal_1"} <= joints
    about = json.loads((tmp_path / "robot.json").read_text("utf-8"))
    assert about["axes"][0]["drive_joint"] == "j_drive_1"
    assert about["gimbal"] == "tool_gimbal_1"


def test_names_of_sdformat(tmp_path: Path) -> None:
    """No two siblings share a name, and none is reserved (SDFormat 1.11, unique names and reserved names)."""
    target_named("sdf").write(hostile(), RATE, tmp_path)
    model = parse(tmp_path / "model.sdf").getroot().find("model")
    assert model is not None
    names = [str(part.get("name")) for part in model]
    assert len(set(names)) == len(names)
    for name in [*names, str(model.get("name"))]:
        assert name != "world"
        assert "::" not in name
        assert not (name.startswith("__") and name.endswith("__"))
    places = {place.get("relative_to") for place in model.iter("pose")} - {None}
    assert places <= set(names)
    assert {end.text for end in model.iter("parent")} <= {*names, "world"}


def test_names_of_usd(tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Sdf, Usd

    target_named("newton").write(hostile(), RATE, tmp_path)
    stage = Usd.Stage.Open(str(tmp_path / "machine.usda"))
    counts = {group: len(stage.GetPrimAtPath(f"/Machine/{group}").GetChildren()) for group in ("links", "joints")}
    assert counts == {"links": len(LINKS) + 1, "joints": len(JOINTS) + 2}
    assert all(Sdf.Path.IsValidIdentifier(prim.GetName()) for prim in stage.Traverse())


def test_names_of_tables(tmp_path: Path) -> None:
    """Files whose names differ without their case; fields of a struct."""
    from scipy.io import loadmat

    plant = hostile()
    files = target_named("lut").write(plant, RATE, tmp_path)
    assert len({same_file(name) for name in files}) == len(files)
    target_named("simulink").write(plant, RATE, tmp_path)
    stored = loadmat(tmp_path / "machine.mat", simplify_cells=True)["machine"]
    assert tuple(stored["axes"]) == AXES
    assert [stored[f"axis_{name}"]["name"] for name in target_named("simulink").names(plant).axes.values()] == list(AXES)


@pytest.mark.parametrize("variant", VARIANTS)
def test_names_of_fmi(variant: str, tmp_path: Path) -> None:
    """Names that are no identifiers are those of the flat convention."""
    from fmpy import read_model_description
    from fmpy.validation import validate_fmu

    target_named("fmu").write(hostile(*VARIANTS[variant]), RATE, tmp_path)
    assert validate_fmu(str(tmp_path / "Machine.fmu")) == []
    description = read_model_description(tmp_path / "Machine.fmu")
    assert description.variableNamingConvention == "flat"
    assert {f"{name}.command" for name in AXES} <= {variable.name for variable in description.modelVariables}
    assert {"ee.x", "tool.z"} <= {unknown.variable.name for unknown in description.initialUnknowns}


def test_references_follow_a_renamed_part() -> None:
    """Elements of ROS and Gazebo name joints and links; a root called ``world`` is another name below the measured frame."""
    more = (
        '<transmission name="t"><joint name="lift_joint"/></transmission><ros2_control name="c"><joint name="lift_joint"/>'
        '</ros2_control><gazebo reference="world"/><gazebo reference="lift_joint"/>'
    )
    urdf = (chain("world") + more).replace("lift_joint", "lift-joint")
    axes = two_axes("position")
    axes[1]["joint"] = "lift-joint"
    plant, target = plant_of(axes, urdf), target_named("isaaclab")
    from sysid.export.urdf import urdf_of

    root = urdf_tree(xml_text(urdf_of(plant, target.names(plant))))
    assert [part.get("name") for path in ("transmission/joint", "ros2_control/joint") for part in root.findall(path)] == [
        "lift_joint"
    ] * 2
    assert [part.get("reference") for part in root.findall("gazebo")] == ["world_1", "lift_joint"]


def test_a_payload_beside_a_link_of_that_name(tmp_path: Path) -> None:
    pytest.importorskip("pinocchio")
    import mujoco

    plant = two_links(PAYLOAD)
    files = {name: text.replace('"upper"', '"payload"') for name, text in plant.machine.files().items()}
    plant = Plant(machine_from_files(files, "arm"), plant.linkages, plant.effects, plant.streams)
    target = target_named("mjcf")
    target.write(plant, RATE, tmp_path)
    model: Any = mujoco.MjModel.from_xml_path(str(tmp_path / "robot.xml"))
    assert model.body("payload_1").mass == pytest.approx(1.3)
    assert [vars(part) for part in target.names(plant).changed] == [
        {"kind": "addition", "name": "payload", "written": "payload_1"}
    ]


@settings(max_examples=examples(32), deadline=None)
@given(PRINTABLE.filter(lambda name: "/" not in name and "\\" not in name and name not in (".", "..")))
def test_the_name_of_a_machine_is_data(name: str) -> None:
    """The parser of each language reads the files, and finds the name whole; source code does not depend on it."""
    check_file_name(name, "name")
    sources = written_sources(name)
    assert sources == written_sources("m")
    for file, source in sources.items():
        assert not file.endswith(".py") or ast.parse(source).body


@functools.cache
def written_sources(name: str) -> dict[str, str]:
    """Source code of the exports of a machine; names in all other files are checked."""
    import mujoco

    plant = plant_of(two_axes("velocity", gain=0.5), chain(), (), name)
    with TemporaryDirectory() as text:
        folder = Path(text)
        for target in ("json", "mjcf", "sdf", "simulink"):
            target_named(target).write(plant, RATE, folder)
        assert load_module(folder / "drive_model.py").load().names == ["base_turn", "lift"]
        assert json.loads((folder / "drive_model.json").read_text("utf-8"))["machine"] == name
        root = parse(folder / "model.sdf").getroot().find("model")
        assert root is not None
        assert root.get("name") == target_named("sdf").names(plant).machine[1]
        assert mujoco.MjSpec.from_file(str(folder / "robot.xml")).modelname == name
        return {path.name: path.read_text("utf-8") for path in folder.iterdir() if path.suffix in (".py", ".m")}


@settings(max_examples=examples(24), deadline=None)
@given(st.lists(PRINTABLE, min_size=4, max_size=4, unique=True), st.lists(PRINTABLE, min_size=3, max_size=3, unique=True))
def test_names_of_parts_are_read_again(links: list[str], joints: list[str]) -> None:
    """By MuJoCo, and by a parser of XML."""
    own = ("base", "upper", "fore", "tip"), ("base_turn_joint", "lift_joint", "end")
    urdf = chain()
    for old, new in [*zip(own[0], links, strict=True), *zip(own[1], joints, strict=True)]:
        tag = "link" if old in own[0] else "name"
        for key in {"name", tag}:
            urdf = urdf.replace(f'{key}="{old}"', f"{key}={quoteattr(new)}") if old in own[1] or key == "link" else urdf
        urdf = urdf.replace(f'<link name="{old}">', f"<link name={quoteattr(new)}>") if old in own[0] else urdf
    axes = two_axes("position")
    axes[0]["joint"], axes[1]["joint"] = joints[:2]
    plant = plant_of(axes, urdf, tip=links[3])
    for target in ("mjcf", "urdf", "sdf"):
        with TemporaryDirectory() as text:
            made = exported(plant, target_named(target), Path(text))
            if target == "sdf":
                sdf_agrees(plant, Path(text))
            else:
                assert made.replay is not None
                assert made.replay.agrees


def test_a_name_in_the_page() -> None:
    assert code("a") == "`a`"
    assert code("a``b`") == "``` a``b` ```"
    assert code(" ") == "`   `"


def test_rounding_is_that_of_the_format() -> None:
    """A bound for a signal that does not move: far below a millimetre, and only for formats of 32 bits."""
    from sysid.export.replay import ROUNDING, roundings

    plant = plant_of(two_axes("position"), chain())
    assert set(roundings(plant, 0.0).values()) == {ROUNDING}
    bound = roundings(plant, target_named("newton").resolution)["ee.z"]
    reach = sum(np.linalg.norm(step) for step in ([0.0, 0.0, 0.3], [0.4, 0.0, 0.05], [0.3, 0.1, 0.0]))
    assert bound == pytest.approx(2.5 * 2.0**-23 * reach * 8)
    assert bound < 1e-5
