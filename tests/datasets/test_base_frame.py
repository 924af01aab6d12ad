"""The capture frame from a survey: markers at known places, or one axis that turns; what is degenerate is said."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from sysid.cli.app import run_verb
from sysid.datasets.frames.base_frame import frame_of, from_markers, from_turn
from sysid.datasets.frames.rigid import frame_pose, inverse
from sysid.datasets.frames.survey import axis_line
from sysid.datasets.plan import offset_notes
from sysid.datasets.recipe import FramePose, PointMap, Reference, StreamMap, load_recipe
from sysid.errors import InputError, SettingsError
from sysid.machine import Machine, load_machine

Array = npt.NDArray[np.float64]
AUTOLOG = Path(__file__).parents[2] / "datasets/autolog"
PLACES = {"a": (0.4, 0.3, 0.0), "b": (-0.4, 0.3, 0.05), "c": (-0.4, -0.3, 0.0), "d": (0.4, -0.3, 0.4), "e": (0.0, 0.5, 0.2)}


def random_pose(rng: np.random.Generator) -> Array:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.random(random_state=rng).as_matrix()
    pose[:3, 3] = rng.uniform(-3, 3, 3)
    return pose


def seen(base: Array, pose: Array, noise: float, rng: np.random.Generator) -> Array:
    """Points of the base frame as a capture system at ``pose`` sees them."""
    return np.asarray((base - pose[:3, 3]) @ pose[:3, :3] + noise * rng.normal(size=base.shape))


@settings(deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(3, 5))
def test_markers_give_the_frame_back_whatever_it_is(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    pose = random_pose(rng)
    names = list(PLACES)[:count]
    known = {name: PLACES[name] for name in names}
    places = seen(np.array(list(known.values())), pose, 0.0, rng)
    proposal = from_markers(dict(zip(names, places, strict=True)), known, "here")
    np.testing.assert_allclose(frame_pose(proposal.frame), pose, atol=1e-9)
    assert proposal.rms_m < 1e-12
    assert proposal.open == ()


@given(yaw=st.floats(-3.1, 3.1), up=st.booleans())
def test_a_frame_that_looks_straight_up_or_down_has_angles_as_well(yaw: float, up: bool) -> None:
    pose = frame_pose(FramePose((1.0, 2.0, 3.0), (0.0, math.pi / 2 if up else -math.pi / 2, yaw)))
    np.testing.assert_allclose(frame_pose(frame_of(pose)), pose, atol=1e-9)


def test_the_interval_of_markers_covers_as_often_as_it_says() -> None:
    rng = np.random.default_rng(1)
    base = np.array(list(PLACES.values()))
    hits = []
    for _ in range(400):
        pose = random_pose(rng)
        proposal = from_markers(dict(zip(PLACES, seen(base, pose, 1e-3, rng), strict=True)), PLACES, "here")
        found = frame_pose(proposal.frame)
        turned = Rotation.from_matrix(pose[:3, :3] @ found[:3, :3].T).as_rotvec()
        hits.append([*(np.abs(found[:3, 3] - pose[:3, 3]) < proposal.translation95), *(np.abs(turned) < proposal.rotation95)])
    assert 0.93 < np.mean(hits) < 0.97


def test_what_markers_cannot_determine_is_refused() -> None:
    places = {name: np.array(place) for name, place in PLACES.items()}
    two = dict(list(PLACES.items())[:2])
    with pytest.raises(InputError, match="here: 2 static markers; expected three that are not collinear"):
        from_markers(places, two, "here")
    line = {name: (0.1 * number, 0.2 * number, 0.0) for number, name in enumerate("abcd")}
    with pytest.raises(InputError, match=r"the surveyed markers are collinear.*The rotation about that line is not determined"):
        from_markers(places, line, "here")
    with pytest.raises(InputError, match=r"distances 1000 times the surveyed ones; expected metres on both sides"):
        from_markers({name: 1e3 * place for name, place in places.items()}, PLACES, "here")
    with pytest.raises(
        InputError, match=r"the markers fit mirrored only \(\d+\.\d mm as they are\); expected a right-handed frame"
    ):
        from_markers({name: place * [1.0, 1.0, -1.0] for name, place in places.items()}, PLACES, "here")


def test_what_looks_wrong_with_markers_is_noted() -> None:
    places = {name: np.array(place) for name, place in PLACES.items()}
    flat = {name: (x, y, 0.0) for name, (x, y, _) in PLACES.items()}
    (note,) = from_markers({name: np.array(place) for name, place in flat.items()}, flat, "here").notes
    assert note == "the markers are coplanar: a mirrored capture frame would not be detected"
    (note,) = from_markers({name: 1.02 * place for name, place in places.items()}, PLACES, "here").notes
    assert note.startswith("distances are 1.0200 times the surveyed ones")
    (note,) = from_markers({**places, "a": places["b"], "b": places["a"]}, PLACES, "here").notes
    assert "'a' and 'b' look exchanged; without that the residual is 0.00 mm instead of" in note
    (note,) = from_markers({**places, "c": places["c"] + [0.0, 0.02, 0.01]}, PLACES, "here").notes
    assert "'c' does not fit the others: moved, confused, or wrongly surveyed" in note


def turning(rng: np.random.Generator, pose: Array, sweep: Array, noise: float = 3e-4) -> dict[str, Array]:
    """Two points on a part that turns about the vertical through (0.1, 0.2)."""
    tracks = {}
    for name in ("p", "q"):
        radius, height, start = rng.uniform(0.2, 1.2), rng.uniform(0.0, 1.0), rng.uniform(0.0, 6.0)
        turn = sweep + start
        circle = np.column_stack([0.1 + radius * np.cos(turn), 0.2 + radius * np.sin(turn), np.full(len(turn), height)])
        tracks[name] = seen(circle, pose, noise, rng)
    return tracks


@settings(max_examples=25, deadline=None)
@example(seed=340, span=2.0)  # a square below zero by rounding
@given(seed=st.integers(0, 10_000), span=st.floats(0.8, 3.0))
def test_a_turn_gives_the_axis_and_leaves_yaw_and_height_open(seed: int, span: float) -> None:
    rng = np.random.default_rng(seed)
    pose = random_pose(rng)
    sweep = np.concatenate([np.linspace(0.0, span, 500), np.linspace(span, -0.2, 500)])
    proposal = from_turn(turning(rng, pose, sweep), (0.1, 0.2, 0.0), (0.0, 0.0, 1.0), "slew", "here")
    change = frame_pose(proposal.frame) @ inverse(pose)
    axis, on_axis = change[:3, :3] @ [0.0, 0.0, 1.0], change[:3, :3] @ [0.1, 0.2, 0.0] + change[:3, 3]
    assert math.acos(min(axis[2], 1.0)) < 2e-3
    np.testing.assert_allclose(on_axis[:2], [0.1, 0.2], atol=2e-3)
    assert [math.isfinite(value) for value in (*proposal.translation95, *proposal.rotation95)] == [True, True, False] * 2
    assert max(proposal.rotation95[:2]) < 3e-3
    assert "yaw" in proposal.open[0]
    assert "height" in proposal.open[1]
    opposite = from_turn(turning(rng, pose, -sweep), (0.1, 0.2, 0.0), (0.0, 0.0, 1.0), "slew", "here")
    assert (frame_pose(opposite.frame) @ inverse(pose))[2, 2] < -0.99  # sense = -1 is what the recipe has to say then


def test_what_a_turn_cannot_determine_is_refused() -> None:
    rng = np.random.default_rng(0)
    pose = random_pose(rng)
    axis = ((0.1, 0.2, 0.0), (0.0, 0.0, 1.0), "slew", "here")
    with pytest.raises(
        InputError, match=r"'slew' turned by 1[12]°; expected 30° at least; Record a longer turn|turned by 1[12]°"
    ):
        from_turn(turning(rng, pose, np.linspace(0.0, 0.2, 500)), *axis)
    with pytest.raises(InputError, match=r"no point moves by more than \d\.\d mm; expected a turn of 'slew'"):
        from_turn(turning(rng, pose, np.zeros(500)), *axis)
    with pytest.raises(InputError, match="no point that is visible in 24 frames"):
        from_turn({"p": np.full((500, 3), np.nan)}, *axis)
    other = turning(rng, pose, np.linspace(0.0, 2.0, 500))
    other["p"] += np.outer(np.sin(np.linspace(0.0, 20.0, 500)), [0.1, 0.2, 0.1])
    with pytest.raises(InputError, match=r"depart from circles by \d+\.\d mm.*Record a survey in which no other axis moves"):
        from_turn(other, *axis)


def test_random_poses_of_an_arm_are_no_turn_of_one_axis(shared_data: Path) -> None:
    """A calibration of a TIAGo arm: 34 postures of all joints; the fourth marker repeats the third."""
    rows = np.loadtxt(shared_data / "tiago_mocap/qualysis_base_hand_calibration.csv", delimiter=",", skiprows=1)
    markers = {f"m{k + 1}": rows[:, 3 * k : 3 * k + 3] for k in range(4)}
    np.testing.assert_array_equal(markers["m3"], markers["m4"])
    with pytest.raises(InputError, match=r"depart from circles by 1\d\d\.\d mm .*: 'arm_1' alone moves"):
        from_turn(markers, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), "arm_1", "here")
    # From one posture to another the three markers of the hand fit as a rigid body: a survey of three.
    known = {name: tuple(markers[name][0]) for name in ("m1", "m2", "m3")}
    proposal = from_markers({name: markers[name][5] for name in known}, known, "here")
    assert proposal.rms_m < 1e-6
    with pytest.raises(InputError, match="2 static markers"):
        from_markers({name: markers[name][5] for name in ("m1", "m2")}, dict(list(known.items())[:2]), "here")


@pytest.fixture
def survey(tmp_path: Path) -> Path:
    """The first recording of the crane: its column turns with the slewing axis alone."""
    for name in ("recipe.toml", "machine.toml", "autolog.urdf"):
        shutil.copy(AUTOLOG / name, tmp_path)
    (tmp_path / "logs").mkdir()
    shutil.copytree(AUTOLOG / "logs/manual-01", tmp_path / "logs/manual-01")
    return tmp_path


def proposed(folder: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and everything that was said."""
    with pytest.raises(SystemExit) as stopped:
        run_verb(["ingest", "--propose-frame", str(folder), "--json", str(folder / "frame.json")])
    said = capsys.readouterr()
    code = stopped.value.code
    return (code if isinstance(code, int) else 0), said.out + " ".join(said.err.split())


def surveyed_places(known: dict[str, list[float]]) -> str:
    return "[streams.survey.markers]\n" + "".join(f"{name} = {at}\n" for name, at in known.items())


def add(folder: Path, text: str) -> None:
    recipe = AUTOLOG / "recipe.toml"
    (folder / "recipe.toml").write_text(f"{recipe.read_text('utf-8')}\n[streams.survey]\n{text}\n", "utf-8")


def test_the_axis_of_the_crane_is_found_where_the_recipe_has_it(survey: Path, capsys: pytest.CaptureFixture[str]) -> None:
    add(survey, 'recording = "manual-01"\naxis = "slew"\nturning = ["column_body"]\nsense = -1')
    code, said = proposed(survey, capsys)
    assert code == 0, said
    assert "To use it, copy these lines to the recipe:\n\n[streams.frame]\ntranslation = [" in said
    assert "open: the rotation about the axis of 'slew' (yaw)" in said
    (item,) = json.loads((survey / "frame.json").read_text())["frames"]
    assert item["moved_m"] < 3e-4
    assert item["turned_rad"] < 5e-4
    assert item["translation95"][2] is None
    assert not (survey / "workspace").exists()
    add(survey, 'axis = "slew"\nturning = ["boom_body"]')
    code, said = proposed(survey, capsys)
    assert code != 0
    assert "'slew' alone moves" in said


def test_surveyed_bodies_of_the_crane_give_the_recipe_s_frame_back(survey: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The bodies stand still in the reference pose: their places in the base frame serve as the survey."""
    from sysid.datasets.channels import read_streams
    from sysid.datasets.frames.rigid import body_poses

    (mapping,) = [stream for stream in load_recipe(survey / "recipe.toml").streams if stream.bodies]
    known = {}
    for body in read_streams(survey / "logs/manual-01/mocap.csv", mapping):
        if body.name in mapping.bodies:
            known[body.name] = np.nanmedian(body_poses(body, mapping.frame)[12:72, :3, 3], axis=0).round(4).tolist()
    add(survey, "seconds = [0.2, 1.2]\n" + surveyed_places(known))
    code, said = proposed(survey, capsys)
    assert code == 0, said
    (item,) = json.loads((survey / "frame.json").read_text())["frames"]
    assert item["moved_m"] < 1e-3
    assert item["turned_rad"] < 1e-3
    add(survey, surveyed_places(known))
    code, said = proposed(survey, capsys)
    assert "mm during the survey; expected a marker at rest" in said


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('axis = "slew"', "axis 'slew' without points that it turns; expected both `axis` and `turning`"),
        ('turning = ["column_body"]', "points that turn without an axis"),
        ("", "neither markers nor an axis; expected `markers` with known positions"),
        ('axis = "slow"\nturning = ["column_body"]', "'slow'"),
        ('axis = "boom"\nturning = ["boom_body"]', "'boom' is moved by other axes; expected the first one, 'slew'"),
        ('axis = "slew"\nturning = ["colum_body"]', "no rigid body or marker 'colum_body'; expected 'column_body'?"),
        ('recording = "nowhere"\naxis = "slew"\nturning = ["column_body"]', "no file 'mocap.csv' in a recording 'nowhere'"),
    ],
)
def test_mistakes_in_a_survey_are_named(survey: Path, capsys: pytest.CaptureFixture[str], text: str, message: str) -> None:
    add(survey, text)
    code, said = proposed(survey, capsys)
    assert code != 0
    assert message in said


def test_a_recipe_without_a_survey_says_what_to_write(survey: Path, capsys: pytest.CaptureFixture[str]) -> None:
    code, said = proposed(survey, capsys)
    assert code != 0
    assert "no survey; expected [streams.survey]" in said


@pytest.fixture(scope="module")
def crane() -> Machine:
    return load_machine(AUTOLOG / "machine.toml")


@given(at=st.tuples(*[st.floats(-0.3, 0.3)] * 3))
def test_an_offset_along_the_last_link_is_said_to_hide_its_length(crane: Machine, at: tuple[float, float, float]) -> None:
    assume(math.hypot(*at) > 1e-3)
    reference = Reference((0.0, 1.0), {"slew": 0.3, "boom": 0.5, "stick": -1.2, "telescope": 0.05})
    mapping = StreamMap("mocap.csv", bodies={"tip": "tip"}, points={"ee": PointMap("tip", at)}, reference=reference)
    mount = {("run", "mocap.csv"): {"tip": frame_pose(FramePose((0.0, 0.0, 0.1), (0.0, 0.0, math.pi / 2)))}}
    notes = offset_notes([mapping], mount, crane)
    along = at[1]  # the body's y axis lies along the stick, which points along x of the tip
    assert bool(notes) == (abs(along) > 0.9 * math.hypot(*at))
    if notes:
        assert f"reaches {-1e3 * along:+.1f} mm along the last link" in notes[0]
        assert "link_length_error of stick" in notes[0]


def test_a_prismatic_axis_cannot_be_surveyed_by_turning(crane: Machine) -> None:
    with pytest.raises(SettingsError, match="is moved by other axes"):
        axis_line(crane, "telescope")
    point, direction = axis_line(crane, "slew")
    np.testing.assert_allclose([*point, *direction], [0, 0, 0, 0, 0, 1], atol=1e-12)
