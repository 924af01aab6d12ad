"""The corpus of robot models: remedies are followed to the letter, claims are checked, differences are seen."""

from __future__ import annotations

import importlib
import importlib.util
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PIPELINES = str(ROOT / "pipelines")
MODULES = ("check", "corpus", "limited", "mirror", "nominal", "outside", "page", "peers", "reading", "remedy", "steps")

ARM = """<robot name="two"><link name="base"/>{links}
<joint name="pan" type="revolute"><parent link="base"/><child link="turret"/><origin xyz="0 0 0.1"/><axis xyz="0 0 1"/>
<limit lower="-2" upper="2" effort="9" velocity="1"/></joint>
<joint name="lift" type="{kind}"><parent link="turret"/><child link="arm"/><origin xyz="0 0.1 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" effort="9" velocity="1"/></joint></robot>
"""
LINK = (
    '<link name="{}"><inertial><origin xyz="0.1 0 0"/><mass value="{}"/>'
    '<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
)
SERVO = """<mujoco model="servo"><compiler angle="radian"/><worldbody><body name="upper" pos="0 0 0.5">
<joint name="shoulder" axis="0 -1 0" range="-1.5 1.5" damping="0.2" armature="0.03" stiffness="{spring}"/>
<geom type="capsule" fromto="0 0 0 0.3 0 0" size="0.02" mass="{mass}"/></body></worldbody>
<actuator><position name="shoulder" joint="shoulder" kp="80" kv="4" ctrlrange="-1.5 1.5"/></actuator></mujoco>
"""


@pytest.fixture(scope="module")
def robots() -> Iterator[SimpleNamespace]:
    """The parts of the pipeline, and the pipeline as ``main``: tests/helpers has another module named ``robots``."""
    sys.path.insert(0, PIPELINES)
    parts = {name: importlib.import_module(f"robots_corpus.{name}") for name in MODULES}
    spec = importlib.util.spec_from_file_location("robots_pipeline", Path(PIPELINES) / "read_robots.py")
    assert spec is not None
    assert spec.loader is not None
    main = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(main)
    yield SimpleNamespace(**parts, main=main)
    sys.path.remove(PIPELINES)


@pytest.fixture
def made(robots: SimpleNamespace, tmp_path: Path) -> Callable[..., Any]:
    """``made(text, "a.urdf")`` is a model in a package of its own."""

    def make(text: str, name: str) -> Any:
        path = tmp_path / "package" / "models" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, "utf-8")
        return robots.corpus.Robot("package", f"models/{name}", tmp_path / "package")

    return make


def arm(kind: str = "revolute", mass: float = 1.0) -> str:
    return ARM.format(links=LINK.format("turret", 1) + LINK.format("arm", mass), kind=kind)


@pytest.mark.parametrize(
    ("message", "options"),
    [
        ("a.urdf: 2 chains; expected one. Choose its end effector, such as --tip FL_foot.", ("--tip", "FL_foot")),
        ("a: b; expected c. Add --base 'my torso' --tip link_1.0_tip. More.", ("--base", "my torso", "--tip", "link_1.0_tip")),
        ("a: b; expected c. Add --tip x --kind servo. --kind is servo for positions.", ("--tip", "x", "--kind", "servo")),
        ("a: b; expected c. Add --kind servo (positions) or --kind force (torques), for all.", ("--kind", "servo")),
        ("a: b; expected c. Add --tip x. --base holds torso still.", ("--tip", "x")),
        ("a: b; expected c. Add --tip '--kind'.", ("--tip", "--kind")),
        ("a: --tip left is unknown; expected one of right. Add it.", ()),
        ("a: b; expected c, or choose an end effector in front of it with --tip.", ()),
        ("a: b; expected c. Add --assets DIR.", ()),
        ("a: b; expected c. Remove the joint.", ()),
    ],
)
def test_options_of_a_remedy(robots: SimpleNamespace, message: str, options: tuple[str, ...]) -> None:
    assert robots.remedy.options_of(message) == options


MOTORS = '<mujoco><actuator><motor name="a" joint="j"/><motor name="b" joint="j"/><motor joint="j"/></actuator></mujoco>'
FREE = (
    '<mujoco><worldbody><body name="torso"><freejoint name="root"/><body><joint name="hip"/></body></body></worldbody>'
    '<keyframe><key qpos="0 0 1 1 0 0 0 0.5" qvel="1 2 3 4 5 6 7"/></keyframe></mujoco>'
)


@pytest.mark.parametrize(
    ("message", "before", "gone", "there"),
    [
        ("x; expected y. Remove b and actuator_2 from <actuator>.", MOTORS, ['"b"', '<motor joint="j"'], ['"a"']),
        ("x; expected y. Remove from <actuator> all but the one of the controller, such as b.", MOTORS, ['"b"'], ['"a"']),
        ("a.xml: actuator 'a' of joint 'j': muscle; expected y. Remove it from <actuator>, and.", MOTORS, ['"a"'], ['"b"']),
        (
            "Remove the joint and its values in keyframes: torso is fixed to the world then.",
            FREE,
            ["freejoint"],
            ['qpos="0.5"', 'qvel="7"', '"hip"'],
        ),
        (
            "urdf: joint 'lift': limit: 0; expected y. Change its type to continuous.",
            arm(),
            ['"lift" type="revolute"'],
            ["continuous"],
        ),
        (
            "urdf: joints 'pan' and 'lift': limit: 0, 0; expected y. Change their type to continuous, or state both.",
            arm(),
            ['type="revolute"'],
            ['"pan" type="continuous"', '"lift" type="continuous"'],
        ),
        ("urdf: joint 'pan': limit; expected y. Swap lower and upper.", arm(), ['lower="-2"'], ['lower="2"', 'upper="-2"']),
        (
            "<origin>: rpy='0, 1 2': a comma; expected y. Write rpy=\"0 1 2\".",
            '<robot><origin rpy="0, 1 2"/></robot>',
            ["0,"],
            ["0 1 2"],
        ),
        (
            "x; expected y. Write the numbers without commas.",
            '<robot name="a, b"><o rpy="0,1, 2"/></robot>',
            ["0,"],
            ["a, b", "0 1  2"],
        ),
        (
            'Remove <flag gravity="disable">, if',
            '<mujoco><option><flag gravity="disable"/></option></mujoco>',
            ["flag"],
            ["option"],
        ),
        ("Remove gravcomp from its bodies.", '<mujoco><body name="a" gravcomp="1"/></mujoco>', ["gravcomp"], ['name="a"']),
        (
            'Write <option gravity="0 0 -9.81">, in',
            '<mujoco><option gravity="0 0 0" timestep="1"/></mujoco>',
            ['"0 0 0"'],
            ["-9.81", "timestep"],
        ),
        ('Write <option gravity="0 0 -9.81">, in', "<mujoco><worldbody/></mujoco>", [], ['option gravity="0 0 -9.81"']),
        ('x; expected y. Add <link name="tool"/>.', arm(), [], ['<link name="tool"']),
        ('Add <motor joint="j"/> to <actuator>.', "<mujoco><actuator/></mujoco>", [], ['<actuator><motor joint="j"']),
    ],
)  # fmt: skip
def test_edits(
    robots: SimpleNamespace, made: Callable[..., Any], tmp_path: Path, message: str, before: str, gone: list[str],
    there: list[str],
) -> None:  # fmt: skip
    robot = made(before, "a.xml")
    mirror = robots.mirror.Mirror(robot.root, tmp_path / "mirror")
    followed = robots.remedy.edit_of(message, robot.file, mirror)
    assert followed.endswith("(a.xml)")
    assert followed.removesuffix(" (a.xml)") in message
    after = (tmp_path / "mirror" / robot.file).read_text("utf-8")
    assert [text for text in gone if text in after] == []
    assert [text for text in there if text not in after] == []
    assert all(text in before for text in gone), "the example does not have what has to go"
    assert robot.path.read_text("utf-8") == before, "the original was edited"
    assert not robots.remedy.edit_of("x; expected y. Replace it.", robot.file, mirror)


def test_an_edit_in_an_included_file(robots: SimpleNamespace, made: Callable[..., Any], tmp_path: Path) -> None:
    made(MOTORS, "parts/motors.xml")
    robot = made('<mujoco><include file="parts/motors.xml"/></mujoco>', "a.xml")
    mirror = robots.mirror.Mirror(robot.root, tmp_path / "mirror")
    assert "motors.xml" in robots.remedy.edit_of("Remove b from <actuator>.", robot.file, mirror)
    assert '"b"' not in (tmp_path / "mirror/models/parts/motors.xml").read_text("utf-8")


def test_options_beside_an_edit_count_where_the_message_says_so(
    robots: SimpleNamespace, made: Callable[..., Any], tmp_path: Path
) -> None:  # fmt: skip
    robot = made(arm(), "a.urdf")
    mirror = robots.mirror.Mirror(robot.root, tmp_path / "mirror")
    start = "urdf: joint 'lift': limit; expected y. Change its type to "
    options, edit = robots.remedy.follow(f"{start}continuous. Then add --tip arm.", robot.file, mirror)
    assert (options, bool(edit)) == (("--tip", "arm"), True)
    options, edit = robots.remedy.follow(f"{start}prismatic, or use --kind servo.", robot.file, mirror)
    assert (options, bool(edit)) == ((), True)


def test_a_model_is_read_after_its_remedy(robots: SimpleNamespace, made: Callable[..., Any], tmp_path: Path) -> None:
    """A URDF does not say how its joints are commanded; the message does what the pipeline then does."""
    row = robots.reading.read(made(arm(), "arm.urdf"), tmp_path / "work")
    assert (row["status"], row["read"], row["broke"]) == ("refused", True, "")
    assert [step["followed"] for step in row["steps"]] == ["--kind servo"]
    assert "--kind" in row["steps"][0]["message"]
    assert str(tmp_path) not in json.dumps(row)
    assert 0.0 < row["seconds"] < robots.reading.LIMITS.cpu


def test_a_model_without_a_joint_is_outside(robots: SimpleNamespace, made: Callable[..., Any], tmp_path: Path) -> None:
    row = robots.reading.read(made(arm("fixed").replace("revolute", "fixed"), "arm.urdf"), tmp_path / "work")
    assert (row["status"], row["read"], row["outside"]) == ("outside", False, "no joint to drive")


def test_a_claim_of_a_refusal_counts_only_with_its_fact(robots: SimpleNamespace, made: Callable[..., Any]) -> None:
    message = "a.xml: no driven joint; expected a robot"
    facts = robots.outside.facts_of(made(SERVO.format(spring=0, mass=1), "servo.xml").path)
    assert (facts["joints"], facts["actuators"], facts["loops"]) == (1, 1, 0)
    assert robots.outside.outside(message, facts) is None
    assert robots.outside.outside(message, facts | {"actuators": 0}) == "no actuator"
    assert robots.outside.outside("a.xml: no such option", facts | {"joints": 0}) is None
    broken = robots.outside.facts_of(made("<mujoco><worldbody><body/><geom/></worldbody></mujoco>", "broken.xml").path)
    assert robots.outside.outside("a.xml: Error; expected an MJCF that MuJoCo compiles", broken) == "MuJoCo does not compile it"
    other = robots.outside.facts_of(made("<!-- <robot> --><config/>", "config.xml").path)
    assert robots.outside.outside("root element 'config'; expected <robot>", other).startswith("not a robot")


@pytest.mark.parametrize(
    ("code", "limits", "broke"),
    [
        ("print(1)", (5, 10.0, None), ""),
        ("raise KeyError('x')", (5, 10.0, None), "traceback: KeyError: 'x'"),
        ("while True: pass", (1, 10.0, None), "limit of time reached"),
        ("import time; time.sleep(60)", (5, 0.5, None), "limit of time reached"),
        ("x = bytearray(300 << 20)", (5, 10.0, 200 << 20), "traceback: MemoryError"),
    ],
)
def test_limits(robots: SimpleNamespace, code: str, limits: tuple[int, float, int | None], broke: str) -> None:
    done = robots.limited.run([sys.executable, "-c", code], robots.limited.Limits(*limits))
    assert done.broke == broke
    assert (done.code == 0) == (broke == "")
    assert done.wall < 5.0
    assert 1.0 < done.memory < 200.0


def test_an_error_of_the_program_is_not_one_of_the_file(robots: SimpleNamespace) -> None:
    done = robots.limited.Done(2, "", 0.1, 0.1, 1.0)
    text = "sysid: a.urdf: cannot be read (ImportError: cannot import name 'x'); expected a robot. The file is damaged."
    assert robots.reading.internal(replace(done, text=text)).startswith("cannot be read (ImportError")
    assert robots.reading.internal(replace(done, text="sysid: a.urdf: cannot be read (ParseError: line 3); expected")) == ""


@pytest.mark.slow
@pytest.mark.parametrize("name", ["arm.urdf", "servo.xml"])
def test_a_machine_is_compared_with_an_independent_reader(
    robots: SimpleNamespace, made: Callable[..., Any], tmp_path: Path, name: str
) -> None:
    """The model that the machine comes from is equal; one with another mass has other torques at the same tip."""
    same, other = (arm(), arm(mass=1.5)) if name == "arm.urdf" else (SERVO.format(spring=0, mass=m) for m in (1.0, 1.5))
    robot = made(same, name)
    assert robots.reading.read(robot, tmp_path / "work")["read"]
    machine = robots.steps.machine_file(tmp_path / "work")
    found = robots.check.check(machine, robot.path)
    assert all(found[key] <= most for key, most in robots.steps.SAME.items()), found
    found = robots.check.check(machine, made(other, name).path)
    assert found["tip_m"] <= robots.steps.SAME["tip_m"]
    assert found["torque"] > 0.1
    assert found["mass_matrix"] > 0.02


def test_what_a_model_has_beyond_the_machine_needs_a_note(
    robots: SimpleNamespace, made: Callable[..., Any], tmp_path: Path
) -> None:
    text = SERVO.format(spring=5, mass=1).replace("<worldbody>", '<option gravity="0 -3.7 0"/><worldbody>')
    robot = made(text, "servo.xml")
    row = robots.reading.read(robot, tmp_path / "work")
    assert row["read"], row["reason"]
    found = robots.steps.check(robot, row, tmp_path / "work")
    assert found["differs"] == ["gravity [0.0, -3.7, 0.0] m/s²", "spring"]
    assert robots.peers.unnoted(found["differs"], []) == found["differs"]
    assert robots.peers.unnoted(found["differs"], ["spring of shoulder"]) == found["differs"][:1]


@pytest.mark.slow
def test_the_nominal_log_stays_within_the_limits(robots: SimpleNamespace, made: Callable[..., Any], tmp_path: Path) -> None:
    robot = made(SERVO.format(spring=0, mass=1), "servo.xml")
    assert robots.reading.read(robot, tmp_path / "work")["read"]
    machine = robots.check.load_machine(robots.steps.machine_file(tmp_path / "work"))
    model = robots.nominal.compile_plant(robots.nominal.nominal_plant(machine))
    tables = [robots.nominal.recording(model, number) for number in range(2)]
    for table in tables:
        assert list(table) == ["time", "shoulder.command", "shoulder.joint"]
        assert len(table) == round(robots.nominal.SECONDS * machine.rate_hz)
        assert table["shoulder.joint"].abs().max() < 1.5
        assert table["shoulder.joint"].max() - table["shoulder.joint"].min() > 0.2
        assert abs(table["shoulder.joint"][0] - table["shoulder.command"][0]) < 0.02, "it rests where its weight lets it rest"
        still = table[table["time"] < robots.nominal.REST]["shoulder.joint"]
        assert still.max() - still.min() < 10.0 * robots.nominal.NOISE
    assert (tables[0]["shoulder.command"] - tables[1]["shoulder.command"]).abs().max() > 0.1


def row(status: str, **more: Any) -> dict[str, Any]:
    base = {"package": "p", "file": "a/b/c.urdf", "status": status, "reason": "", "read": status == "read", "broke": ""}
    return base | {"steps": [], "options": {}, "model": "", "notes": [], "seconds": 0.5, "memory_mib": 100.0} | more


def test_rows_and_their_counts(robots: SimpleNamespace) -> None:
    step = {"message": "c.urdf: x; expected y. Add --kind servo.", "followed": "--kind servo"}
    checked = {"axes": 2, "peer": "Pinocchio", "differs": [], "tip_m": 1e-12, "torque": 2e-3, "mass_matrix": 0.0}
    exports = {"mjcf": {"outcome": "agrees"}, "lut": {"outcome": "refused", "reason": "a|b; expected <c>"}}
    log = {"verdict": "no_gap", "above": 1.1, "seconds": 2.0}
    rows = robots.page.published(
        [
            row("read", check=checked | {"wrong": ["torque 0.002"], "seconds": 1.0}, log=log),
            row("refused", read=True, steps=[step], export={"targets": exports, "seconds": 3.0}),
            row("refused", reason="c.urdf: nothing helps", broke="traceback: KeyError"),
            row("outside", reason="c.urdf: a loop", outside="closed loop"),
        ]
    )  # fmt: skip
    assert {"package", "file", "status", "reason", "checked", "exports"} <= set(rows[0])
    assert rows[0]["checked"] == {"tip_m": 1e-12, "torque": 2e-3, "mass_matrix": 0.0}
    assert rows[1]["reason"] == step["message"]
    assert rows[3]["reason"] == "closed loop: c.urdf: a loop"
    result = {"models": rows, "packages": {"p": "1.0, MIT"}, "command": "x", "date": "d", "commit": "c", "machine": "m"}
    table = robots.page.table(result)
    for line in (
        "| read | 1 |",
        "| refused, read after its remedy | 1 |",
        "| – after 1 remedy | 1 |",
        "| refused, not read | 1 |",
        "| outside: closed loop | 1 |",
        "| largest difference: torque | 0.002 |",
        "| different without a note | 1 |",
        "| log or exports not tried in this run | 2 |",
        "| traceback, crash, or a limit reached | 1 |",
    ):
        assert line in table
    further = [row("outside", reason="z", outside="no actuator"), row("refused", reason="e.urdf: no way"), row("read")]
    page = robots.page.page(result | {"others": robots.page.swept(further)})
    assert "| p | 1 | 0 | 1 | 1 |" in page
    assert "| p: b/c.urdf | e.urdf: no way |" in page
    assert "| mjcf | 1 | 0 | 0 | 0 |" in page
    assert "| lut | 0 | 0 | 1 | 0 |" in page
    assert "a\\|b; expected &lt;c>" in page
    assert "**torque 0.002**" in page
    assert "| no actuator | 1 |" in page
    for line in page.splitlines():
        assert not line.startswith("| p: ") or line.replace("\\|", "").count("|") in (3, 10)


def test_steps_are_repeated_only_when_asked_for(
    robots: SimpleNamespace, made: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls = list[str]()

    def noted(name: str, result: dict[str, Any]) -> Callable[..., dict[str, Any]]:
        def step(*_: object) -> dict[str, Any]:
            calls.append(name)
            return dict(result)

        return step

    after = {"check": noted("check", {"seconds": 1.0}), "log": noted("log", {"broke": "x", "seconds": 1.0})}
    monkeypatch.setattr(robots.main, "read", noted("init", row("read")))
    monkeypatch.setattr(robots.main, "AFTER", after | {"export": noted("export", {})})
    robot = made(arm(), "a.urdf")
    for again in (False, False, True):
        found = robots.main.run_robot(robot, robots.main.STEPS, tmp_path / "work", again)
    assert calls == ["init", "check", "log"] * 2, "nothing is exported without a log"
    assert json.loads((tmp_path / "work" / robot.key / "row.json").read_text("utf-8")) == found
    assert robots.main.steps_of("log,init") == ["init", "log"]
    with pytest.raises(ValueError, match="no step 'logs'; expected some of init, check, log, export"):
        robots.main.steps_of("logs")


def test_the_list_and_the_models_beside_it(robots: SimpleNamespace, made: Callable[..., Any], tmp_path: Path) -> None:
    listed = robots.corpus.packages()
    found = robots.corpus.listed(listed, {package.name: tmp_path for package in listed})
    assert len(found) > 100
    assert len({robot.key for robot in found}) == len(found), "two models have one folder"
    assert all(package.version[0].isdigit() and package.licence for package in listed)
    assert all(robot.file.endswith((".urdf", ".xml")) and not robot.file.startswith("/") for robot in found)
    made("<?xml version='1.0'?>\n<!-- a <config> -->\n<mujoco/>", "scene.xml")
    made("<config/>", "config.xml")
    made("<robot/>", "arm.urdf")
    package = robots.corpus.Package("package", "1", "MIT", ("models/arm.urdf",))
    others = robots.corpus.others([package], {"package": tmp_path / "package"})
    assert [robot.file for robot in others] == ["models/scene.xml"]


#: Models of the slow test, by package; those in FURTHER are simulated and exported too.
SUBSET = {
    "dm_control": ("suite/hopper", "suite/finger", "suite/lqr", "suite/swimmer", "third_order", "jaco_arm"),
    "genesis_world": ("xml/ant", "four_bar", "panda_free_base", "panda_nohand", "shadow_hand", "cf2x", "kuka_iiwa"),
    "gymnasium_robotics": ("adroit_hammer", "fetch/reach", "assets/pusher", "kitchen_env"),
    "armar": ("armar6",),
    "airo_models": ("",),
    "mjlab": ("yam", "go1"),
}
FURTHER = ("kuka_iiwa", "suite/hopper", "ur5e")


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_robots_of_others(robots: SimpleNamespace, tmp_path: Path) -> None:
    """Read, or refused with a remedy that works, or outside as another reader confirms; equal to MuJoCo or Pinocchio."""
    wanted = [package for package in robots.corpus.packages() if package.name in SUBSET]
    try:
        roots = robots.corpus.fetch(wanted, ROOT / "workspace" / "robots")
    except RuntimeError as error:
        pytest.skip(str(error))
    listed = robots.corpus.listed(wanted, roots)
    chosen = [robot for robot in listed if any(text in robot.file for text in SUBSET[robot.package])]
    assert len(chosen) >= len(SUBSET)
    rows = robots.main.run_all(chosen, ("init", "check"), tmp_path, 2, False)
    further = [robot for robot in chosen if any(text in robot.file for text in FURTHER)]
    assert len(further) == len(FURTHER)
    for after in robots.main.run_all(further, robots.main.STEPS, tmp_path, 2, False):
        rows[next(k for k, found in enumerate(rows) if found["file"] == after["file"])] = after
    found = robots.page.published(rows)
    assert {row["file"]: row["broke"] for row in found if row["broke"]} == {}
    assert {row["file"]: row["reason"] for row in found if row["status"] != "outside" and not row["read"]} == {}
    assert {row["file"]: row["wrong"] for row in found if row["wrong"]} == {}
    assert sum(bool(row["checked"]) for row in found) >= len(found) // 2
    assert max(row["memory_mib"] for row in found) < 1000.0
    simulated = [row for row in found if row["localised"]]
    assert len(simulated) == len(FURTHER)
    assert {row["file"]: row["localised"] for row in simulated if row["localised"]["above"] > 1.5} == {}
    failed = {f"{row['file']} {name}": text for row in simulated for name, text in row["exports"].items() if "failed" in text}
    assert failed == {}
    assert all("agrees" in row["exports"].values() for row in simulated)
