"""An MJCF from elsewhere: nothing outside of its folder is opened, what it asks for is bounded, and errors are sentences."""

from __future__ import annotations

import os
import re
import resource
import shlex
import signal
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest
from command_line import run
from hypothesis import given, settings
from hypothesis import strategies as st

from sysid.errors import InputError
from sysid.machine.sources import mjcf_model
from sysid.machine.sources.mjcf_files import MAX_ATTACHED, MAX_DEPTH, joined_model
from sysid.machine.sources.mjcf_model import DESCRIPTION_LIMITS, load_mjcf, load_spec, read_mjcf

#: A tetrahedron of side 1.
MESH = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
#: A robot with one axis, whose masses are stated.
ARM = """<mujoco>
<compiler meshdir="{meshdir}"/>
<asset><mesh name="link" file="link.obj"/></asset>
<worldbody><body name="arm"><joint name="a" axis="0 1 0" limited="true" range="-1 1"/>
<inertial pos="0.1 0 0" mass="2" diaginertia="0.01 0.02 0.03"/>
<geom type="mesh" mesh="link" {geom}/><site name="tip" pos="1 0 0"/></body></worldbody>
<actuator><position joint="a" kp="100"/></actuator></mujoco>
"""
EMPTY = "<mujoco><worldbody/></mujoco>"
SECRET = "<secret><marker/></secret>"


def written(folder: Path, text: str | bytes, name: str = "robot.xml") -> Path:
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def refusal(path: Path, read: Callable[[Path], object] = load_mjcf) -> InputError:
    with pytest.raises(InputError) as caught:
        read(path)
    error = caught.value
    assert error.expected
    assert "Traceback" not in str(error)
    assert "marker" not in str(error)
    return error


# -- files ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """A folder for a model, beside files that it must not open."""
    written(tmp_path, SECRET, "secret.xml")
    written(tmp_path, SECRET, "robot-secret/secret.xml")  # its name begins with that of the model's folder
    folder = tmp_path / "robot"
    folder.mkdir()
    os.mkfifo(folder / "pipe")
    (folder / "link.xml").symlink_to(tmp_path / "secret.xml")
    (folder / "linked").symlink_to(tmp_path)
    (folder / "sub").mkdir()
    return folder


OUTSIDE = "is outside of the folder of the model"


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("pipe", "'pipe' is a named pipe"),
        ("sub", "'sub' is a folder"),
        ("/dev/zero", OUTSIDE),
        ("../secret.xml", OUTSIDE),
        ("../robot-secret/secret.xml", OUTSIDE),
        ("sub/../../secret.xml", OUTSIDE),
        ("link.xml", OUTSIDE),
        ("linked/secret.xml", OUTSIDE),
        ("none.xml", "no file 'none.xml'"),
        ("x" * 5000, "no file 'xxx"),
        ("a\u202eb", "no file 'a\\u202eb'"),
        ("robot.xml", "'robot.xml' is included twice"),
        ("sub/../robot.xml", "is included twice"),
    ],
)
def test_what_an_include_opens(place: Path, name: str, found: str) -> None:
    error = refusal(written(place, f'<mujoco>\n<include file="{name}"/></mujoco>'))
    assert error.found.startswith(found) or error.found.endswith(found)
    assert error.where == f"{place}/robot.xml, line 2: <include>"
    assert error.remedy
    if found == OUTSIDE:
        assert error.expected == f"a file below {place}"


@pytest.mark.parametrize(
    "element",
    [
        '<asset><model name="m" file="{}"/></asset><worldbody/>',
        '<worldbody><flexcomp name="f" type="mesh" dim="2" file="{}"/></worldbody>',
        '<asset><mesh name="m" file="{}"/></asset><worldbody><body><joint/><geom type="mesh" mesh="m"/></body></worldbody>',
        '<compiler meshdir=".."/><asset><mesh name="m" file="../robot/{}"/></asset>'
        '<worldbody><body><geom type="mesh" mesh="m"/></body></worldbody>',
        '<asset><hfield name="h" size="1 1 1 1" file="{}"/></asset><worldbody><geom type="hfield" hfield="h"/></worldbody>',
    ],
)
@pytest.mark.parametrize("name", ["pipe", "../secret.xml", "none"])
def test_what_other_elements_open(place: Path, element: str, name: str) -> None:
    error = refusal(written(place, f"<mujoco>{element.format(name)}</mujoco>"))
    assert error.where.startswith(f"{place}/robot.xml, line 1: <")
    assert error.remedy


def test_textures_and_skins_that_are_not_opened_are_left_out(place: Path) -> None:
    sides = " ".join(f'file{side}="../secret.xml"' for side in ("right", "left", "up", "down", "front", "back"))
    assets = (
        f'<texture name="sky" type="skybox" {sides}/><texture name="wood" type="2d" file="pipe"/>'
        '<material name="wood" texture="wood"/><skin name="skin" file="/dev/zero"/>'
    )
    path = written(place, f"<mujoco><asset>{assets}</asset><worldbody><geom size='1' material='wood'/></worldbody></mujoco>")
    assert load_mjcf(path).ntex == 2
    notes = read_mjcf(path).left_out
    assert any("texture" in note and "sky" in note and "wood" in note for note in notes)
    assert any("skin" in note for note in notes)


def test_includes_and_assets_below_the_folder_are_found_as_mujoco_finds_them(tmp_path: Path) -> None:
    for name in ("meshes/a.obj", "parts/b.obj", "parts/deep/c.obj", "other/d.obj", "other/meshes/e.obj"):
        written(tmp_path, MESH, name)
    written(tmp_path, '<x><asset><mesh name="c" file="c.obj"/></asset></x>', "parts/deep/more.xml")
    written(tmp_path, '<x><include file="deep/more.xml"/><asset><mesh file="b.obj"/></asset></x>', "parts/part.xml")
    inner = '<mesh name="d" file="../d.obj"/><mesh name="e" file="e.obj"/>'
    bodies = (
        '<worldbody><body name="n"><geom type="mesh" mesh="d" name="g&quot;"/><geom type="mesh" mesh="e"/></body></worldbody>'
    )
    written(tmp_path, f'<mujoco model="n"><compiler meshdir="meshes"/><asset>{inner}</asset>{bodies}</mujoco>', "other/n.xml")
    path = written(
        tmp_path,
        '<mujoco><compiler meshdir="meshes" angle="radian"/><include file="parts/part.xml"/>'
        '<asset><mesh name="a" file="a.obj"/><model name="n" file="other/n.xml"/></asset>'
        '<worldbody><body name="x"><geom type="mesh" mesh="a"/><geom type="mesh" mesh="b" pos="1 0 0"/>'
        '<geom type="mesh" mesh="c" pos="0 2 0"/><attach model="n" body="n" prefix="n_"/></body></worldbody></mujoco>',
    )
    model, wanted = load_mjcf(path), mujoco.MjModel.from_xml_path(str(path))
    assert model.nmesh == wanted.nmesh == 5
    for key in ("body_mass", "body_inertia", "body_ipos", "geom_pos"):
        np.testing.assert_array_equal(getattr(model, key), getattr(wanted, key))
    assert model.geom('n_g"').id == wanted.geom('n_g"').id
    names = [mesh.file for mesh in load_spec(path).meshes]
    assert names[:3] == ["parts/deep/c.obj", "parts/b.obj", "meshes/a.obj"]


def test_a_stripped_path_and_a_linked_folder(tmp_path: Path) -> None:
    real = tmp_path / "real"
    written(real / "model", MESH, "meshes/link.obj")
    text = ARM.format(meshdir='meshes" strippath="true', geom="").replace("link.obj", "C:\\far\\away\\link.obj")
    written(real / "model", text)
    (tmp_path / "short").symlink_to(real / "model")
    assert load_mjcf(tmp_path / "short/robot.xml").nmesh == 1
    assert joined_model(tmp_path / "short/robot.xml").missing == ()


def test_models_that_attach_themselves_or_too_many(tmp_path: Path) -> None:
    own = '<mujoco><asset><model name="m" file="robot.xml"/></asset><worldbody/></mujoco>'
    assert "attaches itself" in refusal(written(tmp_path, own)).found
    for k in range(MAX_ATTACHED + 2):
        written(tmp_path, own.replace("robot.xml", f"m{k + 1}.xml"), f"m{k}.xml")
    assert f"more than {MAX_ATTACHED} deep" in refusal(tmp_path / "m0.xml").found
    for k in range(MAX_DEPTH + 2):
        written(tmp_path, f'<mujoco><include file="i{k + 1}.xml"/></mujoco>', f"i{k}.xml")
    assert f"deeper than {MAX_DEPTH} levels" in refusal(tmp_path / "i0.xml").found


def test_the_remedy_works_as_it_is_written(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """The folder of a mesh on which a mass depends is beside that of the model, and has a blank in its name."""
    written(tmp_path, MESH, "the meshes/link.obj")
    text = re.sub("<inertial .*/>", "", ARM.format(meshdir="../the meshes", geom='density="10"'))
    path = written(tmp_path / "robot", text)
    command = ["init", str(tmp_path / "mine"), "--name", "mine", "--from", str(path)]
    assert run(*command) == 2
    said = capfd.readouterr().err
    assert "'link.obj' is outside of the folder of the model, and the mass of body 'arm' comes from it" in said
    option = re.search(r"with (--assets .*)\.", said)
    assert option is not None
    assert run(*command, *shlex.split(option[1])) == 0


@pytest.mark.parametrize("where", ["../meshes", "nowhere", "/dev"])
def test_a_mesh_without_effect_on_masses_is_not_needed(tmp_path: Path, where: str) -> None:
    written(tmp_path, MESH, "meshes/link.obj")
    whole = read_mjcf(written(tmp_path, ARM.format(meshdir="meshes", geom="")))
    assert whole.left_out == ()
    assert whole.model.mesh_vertnum[0] == 4
    path = written(tmp_path / "robot", ARM.format(meshdir=where, geom=""))
    found = read_mjcf(path)
    (note,) = found.left_out
    assert "mesh" in note
    assert "link" in note
    for key in ("body_mass", "body_inertia", "body_ipos", "body_iquat", "dof_M0"):
        np.testing.assert_array_equal(getattr(found.model, key), getattr(whole.model, key))
    assert "a shape that collides" in refusal(path).found
    harmless = written(tmp_path / "robot", ARM.format(meshdir=where, geom='contype="0" conaffinity="0"'))
    assert load_mjcf(harmless).body_mass[1] == 2.0


@pytest.mark.parametrize(
    ("compiler", "geom", "inertial", "needed"),
    [
        ("", "", True, False),
        ("", "", False, True),
        ('inertiafromgeom="true"', "", True, True),
        ('inertiafromgeom="false"', "", True, False),
        ("", 'mass="0"', False, False),
        ("", 'density="0"', False, False),
        ("", 'mass="0.1"', False, True),
        ('inertiagrouprange="0 1"', 'group="2"', False, False),
        ('inertiagrouprange="0 2"', 'group="2"', False, True),
        ("", 'class="shown"', False, False),
    ],
)
def test_when_a_mass_depends_on_a_mesh(tmp_path: Path, compiler: str, geom: str, inertial: bool, needed: bool) -> None:
    """Masses with the mesh agree with those without it, or the mesh is needed."""
    text = ARM.format(meshdir="", geom=geom).replace("<compiler", f"<compiler {compiler}")
    text = text.replace("<asset>", '<default><default class="shown"><geom mass="0"/></default></default><asset>')
    text = text if inertial else re.sub("<inertial .*/>", '<geom size="0.1"/>', text)
    without, beside = written(tmp_path, text), tmp_path / "link.obj"
    if needed:
        assert ", or an <inertial> in that body" in refusal(without, read_mjcf).expected
        return
    left = read_mjcf(without).model
    beside.write_text(MESH)
    np.testing.assert_array_equal(left.body_mass, load_mjcf(without).body_mass)
    np.testing.assert_array_equal(left.body_inertia, load_mjcf(without).body_inertia)


@pytest.mark.parametrize("armature", ["-1", "inf", "nan"])
def test_an_impossible_inertia(tmp_path: Path, armature: str) -> None:
    path = written(tmp_path, ARM.format(meshdir="", geom="").replace("<joint ", f'<joint armature="{armature}" '))
    error = refusal(path, read_mjcf)
    assert error.where == f"{path}: joint 'a'"
    assert error.found.endswith("at the reference pose")


def test_contacts_that_are_switched_on_elsewhere(tmp_path: Path) -> None:
    apart = 'name="g" contype="0" conaffinity="0"'
    other = '<geom name="floor" size="1"/>'
    for geom, more, refused in (
        (apart, "", False),
        (apart, '<contact><pair geom1="g" geom2="floor"/></contact>', True),
        (apart + ' fluidshape="ellipsoid"', "", True),
        ('name="g"', '<option><flag contact="disable"/></option>', False),
    ):
        text = ARM.format(meshdir="", geom=geom).replace("<worldbody>", f"{more}<worldbody>{other}")
        path = written(tmp_path, text)
        assert read_mjcf(path).left_out
        if refused:
            assert "a shape that collides" in refusal(path).found
        else:
            assert load_mjcf(path).nmesh == 1


# -- sizes ------------------------------------------------------------------------------------------------------------


BODY = '<body><joint/><geom size="1"/></body>'
HUGE = {
    "replicate": f'<mujoco><worldbody><replicate count="1000000000">{BODY}</replicate></worldbody></mujoco>',
    "bodies": f"<mujoco><worldbody>{BODY * 100_000}</worldbody></mujoco>",
    "keyframes": '<mujoco><size nkey="200000000"/><worldbody/></mujoco>',
    "height field": '<mujoco><asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset><worldbody/></mujoco>',
    "memory": '<mujoco><size memory="900G"/><worldbody/></mujoco>',
    "texture": '<mujoco><asset><texture name="t" type="2d" builtin="flat" width="90000" height="90000"/></asset>'
    "<worldbody/></mujoco>",
    "user data": '<mujoco><size nuserdata="2000000000"/><worldbody/></mujoco>',
    "flexible body": '<mujoco><worldbody><flexcomp name="f" type="grid" count="90000 90000 1" dim="2" spacing="1 1 1"/>'
    "</worldbody></mujoco>",
}


#: Of the fast tier: one that takes memory, one that takes time, one that MuJoCo refuses.
BOUNDED = ("memory", "replicate", "texture")


@pytest.mark.parametrize("name", [pytest.param(name, marks=() if name in BOUNDED else pytest.mark.slow) for name in HUGE])
def test_what_a_model_asks_for_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    assert DESCRIPTION_LIMITS.memory <= 2**30
    assert DESCRIPTION_LIMITS.seconds <= 20.0
    monkeypatch.setattr(mjcf_model, "DESCRIPTION_LIMITS", replace(DESCRIPTION_LIMITS, seconds=2.0))
    path = written(tmp_path, HUGE[name])
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    error = refusal(path)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    assert after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime < 8.0  # 2 s, until the kernel acts on it
    assert error.where == str(path)
    assert error.remedy.startswith(("The file is damaged or malicious", "Check the sizes and counts"))
    assert "a log" not in str(error)


def test_deep_nesting(tmp_path: Path) -> None:
    def nested(depth: int) -> str:
        inertial = '<inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
        return f"<mujoco><worldbody>{f'<body>{inertial}' * depth}{'</body>' * depth}</worldbody></mujoco>"

    assert load_mjcf(written(tmp_path, nested(MAX_DEPTH - 3))).nbody == MAX_DEPTH - 2
    for depth in (MAX_DEPTH, 450, 100_000):
        error = refusal(written(tmp_path, nested(depth)))
        assert error.found == f"nested deeper than {MAX_DEPTH} levels"


def test_a_file_that_changes_is_compiled_apart_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, '<mujoco><include file="part.xml"/></mujoco>')
    written(tmp_path, EMPTY, "part.xml")
    apart = []
    monkeypatch.setattr(mjcf_model, "confined", lambda work, *args: [apart.append(args[0]), work(lambda share: None)][1])
    for _ in range(3):
        load_mjcf(path)
        load_spec(path)
    assert apart == [path]
    written(tmp_path, EMPTY.replace("<worldbody/>", "<worldbody><body/></worldbody>"), "part.xml")
    assert load_mjcf(path).nbody == 2
    assert apart == [path, path]


# -- texts ------------------------------------------------------------------------------------------------------------

LAUGHS = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 12))
TEXTS = {
    "empty": (b"", "the file is empty"),
    "blank": (b" \n", "the file is empty"),
    "binary": (bytes(range(256)), "not text in utf-8"),
    "zeros": (b"\0" * 100, "not readable as XML"),
    "latin-1": ("<mujoco model='Müller'/>".encode("latin-1"), "not text in utf-8"),
    "other encoding": (f'<?xml version="1.0" encoding="utf-7"?>{EMPTY}'.encode() + b"+", "encoding 'utf-7'"),
    "URDF": (b'<robot name="a"><link name="b"/></robot>', "a URDF"),
    "other root": ("<aä/>".encode(), "root element 'aä'"),
    "other case": (b"<Mujoco><worldbody/></Mujoco>", "root element 'Mujoco'"),
    "two roots": (EMPTY.encode() * 2, "not readable as XML"),
    "open": (b"<mujoco>", "not readable as XML"),
    "document type": (f'<!DOCTYPE a [<!ENTITY x "y">]>{EMPTY}'.encode(), "a document type"),
    "laughs": (f'<!DOCTYPE a [<!ENTITY a0 "ha">{LAUGHS}]><mujoco model="&a11;"/>'.encode(), "a document type"),
    "file entity": (b'<!DOCTYPE a [<!ENTITY x SYSTEM "/etc/passwd">]><mujoco>&x;</mujoco>', "a document type"),
    "entity": (b'<mujoco model="&x;"/>', "not readable as XML (undefined entity"),
    "null": (b'<mujoco model="&#0;"/>', "not readable as XML"),
    "prefix": (b'<mujoco xmlns:x="x"><x:include file="pipe"/></mujoco>', "no file 'pipe'"),
}


@pytest.mark.parametrize("name", TEXTS)
def test_texts_that_are_no_model(tmp_path: Path, name: str) -> None:
    content, found = TEXTS[name]
    path = written(tmp_path, content)
    for read in (read_mjcf, load_mjcf, load_spec):
        error = refusal(path, read)
        assert error.found.startswith(found)
        assert error.where.startswith(str(path))


def test_places_that_are_no_file(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path, found in (
        (tmp_path / "none.xml", "no such file"),
        (tmp_path, "is a folder"),
        (tmp_path / "pipe", "no regular file"),
        (Path("/dev/zero"), "no regular file"),
        (tmp_path / "a\0b", "embedded null byte"),
        (tmp_path / ("x" * 300), "file name too long"),
    ):
        assert refusal(path).found == found


def test_an_error_names_the_file_and_line_of_the_user(tmp_path: Path) -> None:
    written(tmp_path, "<x>\n\n<option\ntimestep='1'/>\n<option wrong='1'/></x>", "part.xml")
    found = refusal(written(tmp_path, '<mujoco>\n<!-- a\nb -->\n<include file="part.xml"/></mujoco>')).found
    assert found.endswith("'option', line 5 of part.xml")
    found = refusal(written(tmp_path, "<mujoco>\n<!-- a\nb -->\n<size\n\n/>\n<wrong/></mujoco>")).found
    assert found.endswith("'wrong', line 7")


@pytest.mark.parametrize(
    ("error", "found"),
    [
        (RuntimeError("Caught an unknown exception!"), "MuJoCo fails on it (Caught an unknown exception!)"),
        (mujoco.FatalError("Could not allocate memory"), "MuJoCo fails on it (Could not allocate memory)"),
        (MemoryError(), "takes more than 1024 MiB to read"),
        (UnicodeDecodeError("utf-8", b"\xff", 0, 1, "bad"), "'utf-8' codec can't decode byte 0xff"),
        (ValueError("\x1b[31m" + "x" * 9999), "\\x1b[31mxxx"),
    ],
)
def test_errors_of_the_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, found: str) -> None:
    def fail(joined: object, spec: object) -> None:
        mjcf_model._of_mujoco(joined_model(path), lambda: (_ for _ in ()).throw(error))

    path = written(tmp_path, EMPTY)
    monkeypatch.setattr(mjcf_model, "_compile", fail)
    said = refusal(path)
    assert said.found.startswith(found)
    assert len(str(said)) < 1000


def test_a_crash_of_the_library(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mjcf_model, "_compile", lambda joined, spec: os.kill(os.getpid(), signal.SIGSEGV))
    assert refusal(written(tmp_path, EMPTY)).found == f"the reader crashed (signal {int(signal.SIGSEGV)})"


# -- any nesting ------------------------------------------------------------------------------------------------------


def test_an_allowed_folder_is_opened(place: Path) -> None:
    written(place.parent, '<mujoco><worldbody><body name="marker"/></worldbody></mujoco>', "out.xml")
    attached = (
        '<asset><model name="m" file="../out.xml"/></asset><worldbody><attach model="m" body="marker" prefix="m_"/></worldbody>'
    )
    for text in ('<include file="linked/out.xml"/>', attached):
        path = written(place, f"<mujoco>{text}</mujoco>")
        assert "marker" in read_mjcf(path, (place.parent,)).model.body(1).name
        assert refusal(path).remedy.endswith(f"or allow its folder with --assets {place.parent}.")


NAMES = ("a.xml", "b.xml", "sub/a.xml", "../out.xml", "../robot/b.xml", "sub/../../out.xml", "link/out.xml", "sub/up/out.xml")
STEPS = st.sampled_from(NAMES)


@settings(max_examples=150, deadline=None)
@given(
    files=st.dictionaries(st.sampled_from(["a.xml", "b.xml", "sub/a.xml", "sub/b.xml"]), st.lists(STEPS, max_size=3)),
    main=st.lists(STEPS, min_size=1, max_size=3),
    kind=st.sampled_from(["include", "model"]),
    allowed=st.booleans(),
)
def test_no_nesting_leaves_the_folder(files: dict[str, list[str]], main: list[str], kind: str, allowed: bool) -> None:
    """A body with the name of the mark is in the model only where its folder is allowed."""
    with tempfile.TemporaryDirectory() as name, pytest.MonkeyPatch.context() as patch:
        patch.setattr(mjcf_model, "inside", lambda: True)  # without a process each
        folder = Path(name).resolve()
        robot = folder / "robot"
        (robot / "sub").mkdir(parents=True)
        (robot / "link").symlink_to("..")
        (robot / "sub/up").symlink_to(folder)
        written(folder, '<mujoco><worldbody><body name="marker"/></worldbody></mujoco>', "out.xml")

        def text(names: list[str]) -> str:
            if kind == "include":
                inner = "".join(f'<include file="{other}"/>' for other in names)
            else:
                models = "".join(f'<model name="m{k}" file="{other}"/>' for k, other in enumerate(names))
                bodies = "".join(f'<attach model="m{k}" prefix="m{k}_"/>' for k in range(len(names)))
                inner = f"<asset>{models}</asset><worldbody><body>{bodies}</body></worldbody>"
            return f"<mujoco>{inner}<worldbody><body/></worldbody></mujoco>"

        for file, names in files.items():
            written(robot, text(names), file)
        path = written(robot, text(main))
        try:
            model = read_mjcf(path, (folder,) if allowed else ()).model
        except InputError:
            refusal(path, lambda path: read_mjcf(path, (folder,) if allowed else ()))
            return
        names = [str(model.body(k).name) for k in range(model.nbody)]
        assert allowed or not any("marker" in own for own in names)
        opened = joined_model(path, (folder,)).files
        assert allowed or all(os.path.realpath(file).startswith(f"{robot}/") for file in opened)
