"""The first motion of a machine: what it finds of wiring, signs, scales and zeros, how slowly, and its record."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from runner_case import DT, MIDDLE, PLANT, Case, Quick, case, true_crane

from sysid.errors import SettingsError
from sysid.machine import KnownEffect
from sysid.plant import Plant
from sysid_rl.control import tune
from sysid_rl.run import faults as f
from sysid_rl.run.chain import ControlChain
from sysid_rl.run.command_filter import CommandFilter
from sysid_rl.run.commissioning import keep_record, record_path, require_commissioned
from sysid_rl.run.faults import Fault, Injection
from sysid_rl.run.limits import Limits
from sysid_rl.run.modes.commission import DIRECTIONS, Commission, CommissionSettings, StrokeResult
from sysid_rl.run.modes.hold import Hold
from sysid_rl.run.recipe import parse_runner
from sysid_rl.run.valves import axis_valves

VALVES = axis_valves(tune(PLANT), DT)
LINKAGES = [PLANT.linkages[axis.name] if axis.drives == "cylinder" else None for axis in PLANT.machine.axes]
DRIVEN = tuple(axis.driven for axis in PLANT.machine.axes)
STANDS = {
    axis.driven: float(q if linkage is None else linkage.displacement(np.array([q]))[0])
    for axis, linkage, q in zip(PLANT.machine.axes, LINKAGES, MIDDLE, strict=True)
}
AXES = PLANT.machine.axis_names
REVERSED = "the wrong direction|moves against its command"
TIMES = "times as fast as its plant|moves nothing"


def commissioned(
    *faults: Fault, true: Plant = PLANT, settings: CommissionSettings | None = None, start: Any = MIDDLE, seed: int = 0
) -> tuple[Case, Commission]:
    """A commissioning of a crane with faults in its line from the beginning."""
    chosen = CommissionSettings(reference=STANDS) if settings is None else settings

    def mode(limits: Limits, chain: ControlChain) -> Commission:
        return Commission(PLANT.machine, CommandFilter(limits, VALVES, LINKAGES, chain.tip, DT), chosen)

    made = case(mode, true=true, start=start, seed=seed, settle_s=0.5, plan=[Injection(fault, 0.0) for fault in faults])
    made.loop.warm_up(MIDDLE)
    task = made.loop.mode
    assert isinstance(task, Commission)
    made.loop.run(task.watch)
    return made, task


def slow(made: Case) -> tuple[float, float]:
    """Greatest speed of the boom tip [m/s], and how far it went from where it began [m]."""
    ends = np.array(made.machine.ends)
    over = round(0.05 / DT)
    return float(np.linalg.norm(ends[over:] - ends[:-over], axis=1).max() / 0.05), float(
        np.linalg.norm(ends - ends[0], axis=1).max()
    )


def off(seed: int, most: float = 0.08) -> Plant:
    """A crane with other gains, play, and dead-bands other than the plant's by up to ``most``."""
    rng = np.random.default_rng(seed)
    plant = true_crane(seed)
    for axis, valve in zip(AXES, VALVES, strict=True):
        bands = {name: max(0.0, getattr(valve, name) + float(rng.uniform(-most, most))) for name in ("positive", "negative")}
        plant = plant.with_effect(KnownEffect("valve_deadband", axis, bands))
    return plant


@pytest.mark.slow
@pytest.mark.parametrize(
    "true", [PLANT, true_crane(1), off(2), off(3)], ids=["as planned", "other gains", "dead-bands", "more"]
)
def test_a_machine_that_is_wired_right_passes(true: Plant) -> None:
    made, task = commissioned(true=true)
    assert made.loop.outcome.ended == "done", made.loop.outcome.why
    assert task.passed
    assert len(task.strokes) == 24
    speed, far = slow(made)
    assert speed <= 0.05
    assert far <= 0.02


def _named(fault: Fault, said: str, name: str, *, slow: bool = False) -> Any:
    return pytest.param(fault, said, id=name, marks=[pytest.mark.slow] if slow else [])


SWAPPED = (
    "swapped|moves nothing|moves the reading|is off: by reference|its cylinder gives|though its valve is neutral"
    "|though no command moves it"
)
FAULTS = [
    _named(f.ValvesSwapped(0, 1), SWAPPED, "valves of slew and boom"),
    *[
        _named(f.ValvesSwapped(a, b), SWAPPED, f"valves {a} {b}", slow=True)
        for a, b in ((0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
    ],
    _named(f.Swapped(DRIVEN[1], DRIVEN[2]), SWAPPED, "sensors of boom and stick"),
    *[
        _named(f.Swapped(DRIVEN[a], DRIVEN[b]), SWAPPED, f"sensors {a} {b}", slow=True)
        for a, b in ((0, 1), (0, 2), (0, 3), (2, 3))
    ],
    *[_named(f.Scaled(DRIVEN[a], -1.0, STANDS[DRIVEN[a]]), REVERSED, f"sensor {a} turned", slow=a > 0) for a in range(4)],
    *[_named(f.ValveTurned(a), REVERSED, f"valve {a} turned", slow=a > 0) for a in range(4)],
    *[_named(f.Scaled(DRIVEN[a], 2.0, STANDS[DRIVEN[a]]), TIMES, f"sensor {a} x 2", slow=a > 0) for a in range(4)],
    *[_named(f.Scaled(DRIVEN[a], 0.1, STANDS[DRIVEN[a]]), TIMES, f"sensor {a} / 10", slow=a > 0) for a in range(4)],
    *[_named(f.Jumped(DRIVEN[a], 0.02), "zero of .* is off|its cylinder gives", f"zero {a}", slow=a < 3) for a in range(4)],
]


@pytest.mark.parametrize(("fault", "said"), FAULTS)
def test_what_is_wrong_from_the_beginning_is_found_slowly(fault: Fault, said: str) -> None:
    made, task = commissioned(fault)
    assert not task.passed
    assert re.search(said, made.loop.outcome.why)
    assert made.loop.outcome.ended != "done"
    speed, far = slow(made)
    assert speed <= 0.05
    assert far <= 0.02


def test_a_zero_that_nothing_shows_is_said() -> None:
    made, task = commissioned(settings=CommissionSettings(reference={"boom.cylinder": STANDS["boom.cylinder"]}))
    assert "no reference for the zero of slew.joint" in made.loop.outcome.why
    assert slow(made)[1] < 1e-3
    assert not task.passed


def test_a_machine_without_room_is_not_moved() -> None:
    start = MIDDLE.copy()
    start[3] = 0.012
    reference = STANDS | {"telescope.joint": 0.012}
    made, _ = commissioned(settings=CommissionSettings(reference=reference), start=start)
    assert "telescope has no space for a stroke" in made.loop.outcome.why
    assert slow(made)[1] < 1e-3


def test_without_its_turns_it_moves_nothing() -> None:
    def mode(limits: Limits, chain: ControlChain) -> Commission:
        command_filter = CommandFilter(limits, VALVES, LINKAGES, chain.tip, DT)
        return Commission(PLANT.machine, command_filter, CommissionSettings(reference=STANDS))

    made = case(mode)
    made.loop.warm_up(MIDDLE)
    made.loop.run()
    assert "it did not receive the cycles" in made.loop.outcome.why


RECIPE: dict[str, Any] = {
    "schema": 1, "name": "a", "machine": "machine.toml", "mode": "hold",
    "versions": {"plant": "crane", "forward": "crane-forward"},
    "transport": {"kind": "can", "database": "machine.dbc"},
}  # fmt: skip


def assembly(folder: Path, plant: str = "p1", **change: Any) -> Any:
    """What a record needs of one."""
    return SimpleNamespace(
        recipe=parse_runner(RECIPE | change, "test"), folder=folder, machine_file=folder / "machine.toml",
        machine=PLANT.machine, loaded=SimpleNamespace(versions=(SimpleNamespace(digest=plant),)),
    )  # fmt: skip


@pytest.fixture
def kept(tmp_path: Path) -> Path:
    """A recipe whose machine was commissioned."""
    (tmp_path / "machine.toml").write_text("name")
    (tmp_path / "machine.dbc").write_bytes(b"dbc")
    limits = case(lambda limits, chain: Hold(DT)).limits
    command_filter = CommandFilter(limits, VALVES, LINKAGES, Quick(PLANT).predict, DT)
    task = Commission(PLANT.machine, command_filter, CommissionSettings())
    stroke = StrokeResult("slew", 1, 0.2, {"slew": 0.01}, 0.01, True, 1.0, 0.0, 0.0, "")
    task.strokes = [stroke] * (len(DIRECTIONS) * len(AXES))
    assert task.passed
    keep_record(assembly(tmp_path), task, tmp_path / "runner.toml", "flight.mcap")
    return tmp_path / "runner.toml"


def test_a_machine_is_moved_after_its_commissioning(kept: Path) -> None:
    assert require_commissioned(assembly(kept.parent), kept) == "commissioned as it is"
    record = json.loads(record_path(kept).read_text("utf-8"))
    assert record["passed"] is True
    assert sorted(record["digests"]) == ["database", "machine", "plant", "recipe"]
    assert len(record["strokes"]) == 24
    assert sorted(path.name for path in kept.parent.iterdir()) == ["machine.dbc", "machine.toml", "runner.commissioned.json"]


def test_task_and_log_may_change(kept: Path) -> None:
    assert require_commissioned(assembly(kept.parent, mode="track", log={"folder": "x"}, loop={"seconds": 5.0}), kept)


@pytest.mark.parametrize(
    ("change", "said"),
    [({"plant": "p2"}, "plant"), ({"limits": {"margin": 0.1}}, "recipe"), ({"checks": {"patience_s": 0.2}}, "recipe"),
     ({"transport": {"kind": "can", "database": "machine.dbc", "signals": {"a": "b"}}}, "recipe")],
)  # fmt: skip
def test_it_is_asked_for_again_when_something_changes(kept: Path, change: dict[str, Any], said: str) -> None:
    with pytest.raises(SettingsError, match=f"changed since it was commissioned: {said}.*--commission"):
        require_commissioned(assembly(kept.parent, **change), kept)


@pytest.mark.parametrize(("name", "said"), [("machine.dbc", "database"), ("machine.toml", "machine")])
def test_a_file_that_changes_asks_for_it_again(kept: Path, name: str, said: str) -> None:
    (kept.parent / name).write_bytes(b"other")
    with pytest.raises(SettingsError, match=f"changed since it was commissioned: {said}"):
        require_commissioned(assembly(kept.parent), kept)


@pytest.mark.parametrize("text", ["", "{}", "[]", "3", '{"digests": 3, "passed": true, "schema": 1}', "\x00"])
def test_a_record_that_is_none(kept: Path, text: str) -> None:
    record_path(kept).write_text(text, "utf-8")
    with pytest.raises(SettingsError, match="is no record of a commissioning"):
        require_commissioned(assembly(kept.parent), kept)


def test_a_commissioning_that_did_not_pass_is_none(kept: Path) -> None:
    record = json.loads(record_path(kept).read_text("utf-8"))
    record_path(kept).write_text(json.dumps(record | {"passed": False, "wrong": "boom goes the wrong way"}), "utf-8")
    with pytest.raises(SettingsError, match="did not pass: boom goes the wrong way"):
        require_commissioned(assembly(kept.parent), kept)


def test_it_may_be_waived_with_a_reason(kept: Path) -> None:
    record_path(kept).unlink()
    with pytest.raises(SettingsError, match="it was never commissioned"):
        require_commissioned(assembly(kept.parent), kept)
    reason = "the simulated test bench of the demo"
    said = require_commissioned(assembly(kept.parent, commission={"waived": reason}), kept)
    assert said == f"NOT commissioned (it was never commissioned): {reason}"
    with pytest.raises(SettingsError, match="one sentence with the reason"):
        require_commissioned(assembly(kept.parent, commission={"waived": "yes"}), kept)
