"""``RUNNER.toml``: what ships is right, what is wrong is refused, nothing is switched off by accident."""

from __future__ import annotations

import hashlib
import json
import tomllib
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from crane_model import AUTOLOG, crane, crane_plant
from crane_store import learned

from sysid.cli.app import app, run_command
from sysid.errors import SettingsError, StorageError
from sysid.networks import to_files
from sysid.networks.mlp import Mlp, Normalisation
from sysid.networks.policy import PolicyNetwork, policy_to_files
from sysid.networks.uncertainty import NetworkUncertainty
from sysid.registry import Registry
from sysid.workspace import open_workspace
from sysid_rl.run.checks.settings import BOUNDS, CHECKS, MILDEST, CheckSettings
from sysid_rl.run.flight_log import FlightLog
from sysid_rl.run.recipe import load_runner, parse_runner
from sysid_rl.train.reach import joint_limits

SHIPPED = Path(__file__).parents[2] / "rl" / "autolog" / "runner.toml"


def values(**changes: Any) -> dict[str, Any]:
    base = {
        "schema": 1, "name": "crane", "machine": "machine.toml", "mode": "hold",
        "versions": {"plant": "crane", "forward": "crane-forward"}, "transport": {"kind": "simulated"},
    }  # fmt: skip
    return base | changes


def test_the_shipped_recipe_is_read_and_says_the_defaults() -> None:
    recipe = load_runner(SHIPPED)
    plain = parse_runner({**tomllib.loads(SHIPPED.read_text("utf-8")), "checks": {}, "loop": {}}, "plain")
    assert recipe.checks == plain.checks
    assert recipe.loop == plain.loop
    assert not recipe.versions.unpromoted
    assert set(MILDEST) == set(CHECKS)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"mode": "trak"}, r"mode: 'trak'; expected 'track'\?"),
        ({"speed": 3}, "unknown key 'speed'"),
        ({"transport": {}}, "transport: no kind"),
        ({"checks": {"emergency": {"reaction": "clamp"}}}, r"checks.emergency.reaction: 'clamp'; expected 'fault'"),
        ({"checks": {"dead_man": {"reaction": "hold"}}}, r"checks.dead_man.reaction: 'hold'; expected 'stop' or 'fault'"),
        ({"checks": {"stale": {"reaction": "off"}}}, "checks.stale.reaction = 'off'"),
        ({"checks": {"stale": {"after_s": float("inf")}}}, "checks.stale.after_s = inf; expected a finite number"),
        ({"checks": {"stale": {"after_s": 1e6}}}, "checks.stale.after_s: 1e.06; expected above 0, at most 0.1: the"),
        ({"checks": {"expired": {"gap_s": 0.2}}}, "checks.expired.gap_s: 0.2; .*a later command would open them again"),
        ({"checks": {"expired": {"reaction": "stop"}}}, r"checks.expired.reaction: 'stop'; expected 'fault'"),
        ({"checks": {"patience_s": 60.0}}, "checks.patience_s: 60 s; expected above 0, at most 1 s"),
        ({"checks": {"without": {"stale": "it is always late here, we know"}}}, "checks.without.stale: cannot be disabled"),
        ({"checks": {"without": {"domain": "no"}}}, "the reason 'no'; expected one sentence with the reason"),
        ({"checks": {"without": {"contradicion": "nothing to compare it with"}}}, r"'contradiction'\?"),
        ({"loop": {"rest_s": 0.0}}, "loop.rest_s: 0; expected 0.1 to 60"),
        ({"mode": "replay"}, "replay.file: is missing"),
    ],
)
def test_what_is_wrong_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        parse_runner(values(**changes), "runner.toml")


def test_every_threshold_has_a_bound_with_its_reason() -> None:
    thresholds = {f"{name}.{item.name}" for name in CHECKS for item in fields(getattr(CheckSettings(), name))}
    assert {key for key in thresholds if not key.endswith(".reaction")} == set(BOUNDS)
    for key, bounds in BOUNDS.items():
        check, _, name = key.partition(".")
        if bounds.zero:
            assert getattr(getattr(CheckSettings(), check), name) == 0.0
        for value in (1e6, 1.01 * bounds.most, float("nan"), *(() if bounds.zero else (0.0,)), -1.0):
            given: Any = round(value) if name in ("turns", "late_turns") and value == value else value
            if given == bounds.most:
                continue
            with pytest.raises(SettingsError, match=rf"checks.{key}"):
                parse_runner(values(checks={check: {name: given}}), "runner.toml")
        with pytest.raises(SettingsError) as caught:
            parse_runner(values(checks={check: {name: 1_000_000}}), "runner.toml")
        assert bounds.why in str(caught.value)


def test_one_message_for_two_axes_is_refused_when_the_recipe_is_read() -> None:
    transport = {"kind": "can", "valves": {"slew": "VALVE_0", "boom": "VALVE_1", "stick": "VALVE_1"}}
    with pytest.raises(SettingsError, match=r"transport.valves.stick: 'VALVE_1', which is that of boom; expected one message"):
        parse_runner(values(transport=transport), "runner.toml")
    transport = {"kind": "can", "signals": {"boom.cylinder": "WIRES.boom", "stick.cylinder": "WIRES.boom"}}
    with pytest.raises(SettingsError, match=r"transport.signals.stick.cylinder: 'WIRES.boom', which is that of boom.cylinder"):
        parse_runner(values(transport=transport), "runner.toml")


@pytest.fixture(scope="module")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A workspace with the crane's plant, promoted, and a forward model that is not; machine.toml beside."""
    from dataclasses import replace

    folder = tmp_path_factory.mktemp("runner")
    registry: Registry = open_workspace(folder / "ws").models
    plant = crane_plant()
    version = registry.register("crane", "plant", plant.to_files(), {"dataset": "crane@1", "machine": "crane"})
    registry.promote(version.reference)
    low, high = joint_limits(plant)
    joints = np.random.default_rng(1).uniform(low, high, (1500, 4))
    model = learned(plant)
    errors = 1e-4 * np.random.default_rng(2).standard_normal((1500, 3))
    kind, files = to_files(replace(model, uncertainty=NetworkUncertainty.of(joints, errors, np.zeros(errors.shape))))
    registry.register("crane-forward", kind, files, {"dataset": "crane@1"})
    machine = crane()
    (folder / "machine.toml").write_text(machine.text, "utf-8")
    (folder / "autolog.urdf").write_text((AUTOLOG / "autolog.urdf").read_text("utf-8"), "utf-8")
    return folder


def write(folder: Path, text: str, **changes: str) -> Path:
    lines = {"mode": '"hold"', "unpromoted": '["crane-forward@1"]', "kind": '"simulated"'} | changes
    path = folder / "runner.toml"
    path.write_text(
        f"""schema = 1
name = "crane"
machine = "machine.toml"
mode = {lines["mode"]}
[versions]
plant = "crane"
forward = "crane-forward"
unpromoted = {lines["unpromoted"]}
[transport]
kind = {lines["kind"]}
{text}
""",
        "utf-8",
    )
    return path


def invoke(folder: Path, path: Path, *more: str) -> Any:
    return CliRunner().invoke(app, ["--workspace", str(folder / "ws"), "run", str(path), *more])


def test_a_run_of_the_command_and_its_record(workspace: Path) -> None:
    path = write(workspace, "[hold]\nseconds = 0.5\n[loop]\npriority = 0\nlock_memory = false\n")
    dry = invoke(workspace, path, "--dry-run")
    assert dry.exit_code == 0, dry.output
    assert "nothing was opened or sent" in dry.output
    done = invoke(workspace, path, "--log", str(workspace / "flights"), "--json", str(workspace / "run.json"))
    assert done.exit_code == 0, done.output
    result = json.loads((workspace / "run.json").read_text("utf-8"))
    assert (result["ended"], result["state"], result["lost_cycles"]) == ("done", "ready", 0)
    assert set(result["versions"]) == {"crane@1", "crane-forward@1"}
    assert Path(result["log"]).stat().st_size > 10_000
    assert "NOT promoted, accepted by the recipe" in done.output
    log = Path(result["log"])
    record = json.loads((workspace / "ws/flights" / f"{log.parent.name}.json").read_text("utf-8"))
    assert {key: record[key] for key in result.keys() - {"dry_run", "log"}} == {
        key: value for key, value in result.items() if key not in ("dry_run", "log")
    }, "pages of the workspace show the figures of --json"
    assert record["sha256"] == hashlib.sha256(log.read_bytes()).hexdigest()
    assert [event["text"] for event in record["events"] if event["kind"] == "state"][-1] == "ready"


def test_a_workspace_that_cannot_be_written_does_not_stop_a_run(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sysid_rl.run.run_record.FOLDER", "../outside")
    path = write(workspace, "[hold]\nseconds = 0.5\n[loop]\npriority = 0\nlock_memory = false\n")
    done = invoke(workspace, path, "--log", str(workspace / "flights"))
    assert done.exit_code == 0, done.output
    assert "ended: done" in done.output
    assert "the run is not listed in the workspace" in done.output


def test_a_log_that_cannot_be_ended_is_told_after_how_the_run_ended(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    close = FlightLog.close

    def full(log: FlightLog) -> None:
        close(log)
        raise StorageError(str(log.path), "disk full", "room on the disk", "")

    monkeypatch.setattr(FlightLog, "close", full)
    path = write(workspace, "[hold]\nseconds = 0.5\n[loop]\npriority = 0\nlock_memory = false\n")
    done = invoke(workspace, path, "--log", str(workspace / "full"), "--json", str(workspace / "full.json"))
    assert isinstance(done.exception, StorageError)
    assert "ended: done; state ready" in done.output
    assert json.loads((workspace / "full.json").read_text("utf-8"))["ended"] == "done"


def test_a_shaper_needs_a_plant_with_a_hanging_tool(workspace: Path) -> None:
    centre = "centre = [0.85, 0.0, 0.3]"
    path = write(workspace, f'[track]\npath = "circle"\n{centre}\nshaper = "zv"\n', mode='"track"')
    error = invoke(workspace, path, "--dry-run").exception
    assert isinstance(error, SettingsError)
    assert "no gripper_sway: the frequency of the tool is not known" in str(error)


def test_a_policy_that_offsets_inverse_kinematics_needs_a_plant_with_a_hanging_tool(workspace: Path) -> None:
    same = Normalisation(np.zeros(10), np.ones(10))
    mlp = Mlp((np.zeros((10, 4)),), (np.zeros(4),), same, Normalisation(np.zeros(4), np.ones(4)))
    setting = {"share": 0.05, "full_swing": 0.05, "repeat": 10.0}
    names = tuple("abcdefghij")
    network = PolicyNetwork(names, names[:4], mlp, -np.ones(4), np.ones(4), full=True, residual=setting)
    lineage = {"plant": "crane@1", "forward": "crane-forward@1"}
    open_workspace(workspace / "ws").models.register("crane-tool", "policy", policy_to_files(network, {}), lineage)
    path = write(workspace, "")
    text = path.read_text("utf-8").replace("unpromoted = [", 'policy = "crane-tool"\nunpromoted = ["crane-tool@1", ')
    path.write_text(text, "utf-8")
    error = invoke(workspace, path, "--dry-run").exception
    assert isinstance(error, SettingsError)
    assert "no gripper_sway" in error.found


def test_versions_have_to_be_promoted_or_named_and_of_this_machine(workspace: Path) -> None:
    for more in ((), ("--dry-run",)):
        error = invoke(workspace, write(workspace, "", unpromoted="[]", kind='"slcan"'), *more).exception
        assert isinstance(error, SettingsError)
        assert "never promoted: crane-forward@1" in str(error)
        assert 'unpromoted = ["crane-forward@1"]' in str(error)
    error = invoke(workspace, write(workspace, "", unpromoted='["crane-forward@1", "crane@7"]')).exception
    assert "'crane@7' does not run" in str(error)
    text = (workspace / "machine.toml").read_text("utf-8")
    try:
        (workspace / "machine.toml").write_text(text.replace("gain = 0.436", "gain = 0.5"), "utf-8")
        error = invoke(workspace, write(workspace, "")).exception
    finally:
        (workspace / "machine.toml").write_text(text, "utf-8")
    assert "was made for another machine: gain of slew is 0.436; expected 0.5" in str(error)


def test_the_simulation_runs_what_was_never_promoted_and_says_that_a_machine_would_not(workspace: Path) -> None:
    done = invoke(workspace, write(workspace, "[hold]\nseconds = 0.1\n", unpromoted="[]"), "--dry-run")
    assert done.exit_code == 0, done.output
    assert "NOT promoted, a machine would refuse it" in done.output


BUS = """channel = "/dev/no-such-adapter"
database = "machine.dbc"
[transport.signals]
"slew.joint" = "SLEW_SENSOR.slew"
"boom.cylinder" = "DRAW_WIRES.boom"
"stick.cylinder" = "DRAW_WIRES.stick"
"telescope.joint" = "DRAW_WIRES.telescope"
{more}
[transport.valves]
slew = "AUX_VALVE_0_COMMAND"
boom = "AUX_VALVE_1_COMMAND"
stick = "AUX_VALVE_2_COMMAND"
telescope = "AUX_VALVE_3_COMMAND"
[hold]
seconds = 0.1
"""


@pytest.mark.parametrize(
    ("old", "new", "more", "message"),
    [
        ("", "", "", ""),
        (
            " SG_ echo",
            " SG_ extra",
            "",
            "MACHINE_STATUS has no echo: commands that arrive late are detected by the motion only",
        ),
        ("SG_ time", "SG_ clock", "", "stamp answers the machine's time, but MACHINE_STATUS has no time"),
        ("", "", '"bom.joint" = "INCLINOMETERS.boom"', "unknown signal bom.joint; expected 'boom.joint'"),
    ],
)
def test_a_dry_run_checks_the_bus_of_a_machine_without_opening_it(
    workspace: Path, old: str, new: str, more: str, message: str
) -> None:
    database = SHIPPED.with_name("machine.dbc").read_text("utf-8")
    (workspace / "machine.dbc").write_text(database.replace(old, new) if old else database, "utf-8")
    done = invoke(workspace, write(workspace, BUS.format(more=more), kind='"slcan"'), "--dry-run")
    assert message in " ".join((done.output + str(done.exception or "")).split())
    if "no echo" not in message and message:
        assert isinstance(done.exception, SettingsError)
    else:
        assert done.exit_code == 0, done.output


def test_a_machine_that_can_hurt_somebody_is_not_run_unattended(workspace: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from sysid_rl.run import transports

    build = transports.connect
    monkeypatch.setattr(transports, "connect", lambda a, r: transports.OpenTransport(build(a, r).transport, simulated=False))
    error = invoke(workspace, write(workspace, ""), "--unattended").exception
    assert "a real machine; expected an operator" in str(error)


def test_a_path_that_leaves_the_fence_is_refused_before_anything_is_opened(workspace: Path) -> None:
    path = write(workspace, "[track]\ncentre = [0.85, 0.0, 0.3]\n[limits.fence]\ny = [-0.1, 0.1]\n", mode='"track"')
    error = invoke(workspace, path).exception
    assert "outside the fence in y, margin included; expected a path inside limits.fence" in str(error)


def test_a_run_that_ends_in_a_fault_says_so_by_its_exit_status(workspace: Path) -> None:
    loop = "[loop]\npriority = 0\nlock_memory = false\n"
    path = write(workspace, f"[collect]\nposes = 1\n[checks.path]\ndistance = 1e-5\n{loop}", mode='"collect"')
    arguments = ["--workspace", str(workspace / "ws"), "run", str(path), "--log", str(workspace / "faults")]
    assert run_command(arguments) == 1
    assert run_command([*arguments[:-2], "--dry-run"]) == 0
