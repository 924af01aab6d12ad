"""Cases whose truth is another simulator: it runs, its logs are read, and what is said to be hidden is all that is hidden."""

from __future__ import annotations

import importlib
import json
import math
import sys
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from sysid.datasets import ingest
from sysid.plant import free_run

PIPELINES = str(Path(__file__).parents[2] / "pipelines")
MODULES = ("cases", "description", "excitation", "kinds", "limits", "machines", "make", "mjcf", "owner", "record", "simulate")
FAMILIES = ("mujoco_crane", "mujoco_arm", "mujoco_slide", "bullet_arm", "bullet_lever")
#: A free run of the owner's plant is to be this close to a machine in which nothing is hidden [noise floors].
CLOSE = 1.5


@pytest.fixture(scope="module")
def foreign() -> Iterator[dict[str, ModuleType]]:
    """The modules of pipelines/hidden/foreign."""
    sys.path.insert(0, PIPELINES)
    try:
        yield {name: importlib.import_module(f"hidden.foreign.{name}") for name in MODULES}
    finally:
        sys.path.remove(PIPELINES)


@pytest.fixture
def short(foreign: dict[str, ModuleType], monkeypatch: pytest.MonkeyPatch) -> None:
    """Owners whose tests are half as long."""
    monkeypatch.setattr(foreign["owner"], "LENGTH", 30.0)


def needs(family: str) -> None:
    """Skip where the simulator is not installed."""
    module = "mujoco" if family.startswith("mujoco") else "pybullet"
    pytest.importorskip(module, reason=f"{module} is not installed")


# ---- The list -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 0xFFFFFFFF])
def test_full_tier_holds_what_was_asked_for(foreign: dict[str, ModuleType], seed: int) -> None:
    cases, by_key = foreign["cases"].cases_of("full", seed), foreign["kinds"].BY_KEY
    assert Counter(case.group for case in cases) == {"none": 60, "single": 80, "double": 24, "triple": 12, "unknown": 24}
    for case in cases:
        assert len(case.hidden) == {"none": 0, "single": 1, "double": 2, "triple": 3, "unknown": 1}[case.group]
        assert all(by_key[each.kind].family == case.family for each in case.hidden)
        assert all(case.variant in by_key[each.kind].variants for each in case.hidden)
        assert all(bool(by_key[each.kind].named) == (case.group != "unknown") for each in case.hidden)
    assert {case.hidden[0].factor for case in cases if case.group == "single"} == {3.0, 5.0, 10.0}
    assert {case.family for case in cases if case.group == "none"} == set(FAMILIES)
    assert {case.excitation for case in cases} == {"rich", "moving", "operator", "poor"}
    effects = Counter(by_key[case.hidden[0].kind].named[0][0] for case in cases if case.group == "single")
    assert set(effects) == {kind.named[0][0] for kind in foreign["kinds"].KNOWN}
    assert max(effects.values()) - min(effects.values()) <= 1
    other = foreign["cases"].cases_of("full", seed + 1)
    assert not any(one == two for one, two in zip(cases, other, strict=True))


@pytest.mark.parametrize("family", [name for name in FAMILIES if name.startswith("mujoco")])
def test_every_kind_is_a_model_that_the_simulator_takes(foreign: dict[str, ModuleType], family: str) -> None:
    needs(family)
    import mujoco

    kinds, overlaid = foreign["kinds"], importlib.import_module("hidden.limits").overlaid_lists
    for kind in (*kinds.KNOWN, *kinds.UNKNOWN):
        if kind.family != family:
            continue
        known = overlaid(foreign["machines"].known_tables(family, kind.variants[0]), kind.known)
        for magnitude in (max(0.1 * kind.most, kind.least), kind.most):
            real = overlaid(known, kind.change(known, magnitude, 1))
            model = mujoco.MjModel.from_xml_string(foreign["mjcf"].mjcf(real))
            assert model.nu == len(foreign["machines"].axes_of(real)) + ("asymmetric" in kind.label), kind.key
            assert real["sensors"] or foreign["mjcf"].mjcf(real) != foreign["mjcf"].mjcf(known), kind.key


# ---- Limits -------------------------------------------------------------------------------------------------------------


def test_limit_is_one_floor_further_off(foreign: dict[str, ModuleType]) -> None:
    kind = replace(foreign["kinds"].BY_KEY["mujoco_crane:backlash(slew)"], change=lambda t, m, d: {"size": m}, most=10.0)

    def scores(tables: dict[str, Any]) -> dict[str, float]:
        return {"slew.joint": math.hypot(1.5, 2.0 * tables["size"]), "ee.x": 4.0}

    found = foreign["limits"].limit_of(kind, 1, {"size": 0.0}, scores)
    assert found.magnitude == pytest.approx(1.0, rel=0.1), "1.5 floors without it, 2.5 with it"
    blind = foreign["limits"].limit_of(kind, 1, {"size": 0.0}, lambda tables: {"slew.joint": 2.0})
    assert math.isinf(blind.magnitude)
    ratio = replace(kind, named=(("gain_error", "slew"),), most=0.3)
    small = foreign["limits"].limit_of(ratio, 1, {"size": 0.0}, lambda t: {"slew.joint": math.hypot(1.0, 1e4 * t["size"])})
    assert small.magnitude == 0.01, "a gain that is off by less makes no difference"


# ---- Simulators ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "family", [pytest.param(f, marks=() if f in ("mujoco_crane", "bullet_lever") else pytest.mark.slow) for f in FAMILIES]
)
def test_logs_are_read(foreign: dict[str, ModuleType], family: str, tmp_path: Path) -> None:
    """Every machine simulates; its logs and description become a dataset, recordings that begin in motion among them."""
    needs(family)
    tables = foreign["machines"].known_tables(family, 1)
    takes = [
        foreign["excitation"].Take(f"take-{k + 1}", 5 + k, 8.0, program, lead, (0.2, 0.1))
        for k, (program, lead) in enumerate((("operator", 0.0), ("steps", 2.0), ("fourier", 3.0)))
    ]
    foreign["record"].write_logs(tables, takes, 1.0, 3, tmp_path / "logs")
    gains = {name: axis.get("gain", 1.0) for name, axis in tables.get("axes", {}).items()}
    for name, text in foreign["description"].files_of(tables, gains, (), 1.0).items():
        (tmp_path / "logs" / name).write_text(text, "utf-8")
    dataset = ingest(tmp_path / "logs", tmp_path / "workspace", machine=tmp_path / "logs" / "machine.toml")
    assert sorted(recording.name for recording in dataset.recordings) == ["take-1", "take-2", "take-3"]
    for axis in foreign["machines"].axes_of(tables):
        for recording in dataset.recordings:
            joint = recording.values(f"{axis}.joint")
            assert np.isfinite(joint).mean() > 0.98
            assert np.nanstd(joint) > 0.01
    moving = next(recording for recording in dataset.recordings if recording.name == "take-3")
    axis = foreign["machines"].axes_of(tables)[0]
    assert np.any(moving.values(f"{axis}.command")[:20] != moving.values(f"{axis}.command")[0]), "under way already"
    if family == "mujoco_crane":
        hangs = moving.values("ee.z") - moving.values("tool.z")
        assert 0.15 < np.nanmedian(hangs) < 0.21


@pytest.mark.parametrize(
    ("family", "variant"),
    [
        ("mujoco_arm", 0),
        pytest.param("mujoco_crane", 3, marks=pytest.mark.slow),
        pytest.param("mujoco_crane", 0, marks=pytest.mark.slow),
        pytest.param("bullet_arm", 1, marks=pytest.mark.slow),
    ],
)
def test_with_nothing_hidden_the_owners_plant_is_right(foreign: dict[str, ModuleType], family: str, variant: int) -> None:
    """The truth is a truth: free runs of what the owner fitted meet recordings that he has not seen."""
    needs(family)
    tables = foreign["machines"].known_tables(family, variant)
    owner, noise = foreign["owner"].owner_of(tables), foreign["machines"].noise_of(tables, 1.0)
    plant = owner.plant(tables)
    for seed, program in ((31, "operator"), (32, "fourier")):
        recording = foreign["owner"].recorded(tables, foreign["excitation"].Take("new", seed, 40.0, program))
        run = free_run(plant, recording)
        for axis in foreign["machines"].axes_of(tables):
            signal = f"{axis}.joint"
            off = math.sqrt(float(np.mean((run[signal] - recording.values(signal)) ** 2)))
            assert math.hypot(1.0, off / noise[signal]) < CLOSE, signal


@pytest.mark.parametrize("family", [pytest.param("mujoco_slide", marks=pytest.mark.slow), "bullet_lever"])
def test_with_nothing_hidden_the_force_is_right(foreign: dict[str, ModuleType], family: str) -> None:
    """And what it says of the force at measured motion."""
    needs(family)
    tables = foreign["machines"].known_tables(family, 1)
    owner = foreign["owner"].owner_of(tables)
    takes = [foreign["excitation"].Take("new", 41, 15.0, "operator"), foreign["excitation"].Take("next", 42, 15.0, "steps")]
    kind = next(kind for kind in foreign["kinds"].KNOWN if kind.family == family)
    (off,) = foreign["limits"].scores_of(kind, tables, owner, 1.0, takes)(tables).values()
    assert off < CLOSE


@pytest.mark.slow
@pytest.mark.usefixtures("short")
def test_site_holds_nothing_of_what_is_sealed(foreign: dict[str, ModuleType], tmp_path: Path) -> None:
    needs("mujoco_arm")
    cases = importlib.import_module("hidden.cases")
    hidden = (cases.Hidden("mujoco_arm:sensor_bias(elbow.joint)", 5.0, -1),)
    spec = cases.CaseSpec("one", "single", "mujoco_arm", 0, hidden, "poor", 1.0, 0.0, 11)
    sealed = foreign["make"].make_case(spec, tmp_path)
    assert json.loads((tmp_path / "sealed" / "one.json").read_text("utf-8")) == json.loads(json.dumps(sealed))
    (entry,), (effect,) = sealed["hidden"], sealed["effects"]
    assert entry["factor"] == pytest.approx(5.0)
    assert (effect["name"], effect["target"], effect["exact"]) == ("sensor_bias", "elbow.joint", True)
    # A constant d turns one floor of noise into √(1 + d²): one floor more at √3.
    assert entry["detection_limit"] == pytest.approx(math.sqrt(3.0) * 3e-4, rel=0.25)
    error = sealed["model_error"]
    assert error["before"]["elbow.joint"] == pytest.approx(-effect["parameters"]["bias"], rel=0.1)
    assert error["after"]["elbow.joint"] < 0.2 * error["before"]["elbow.joint"]
    site = tmp_path / "cases" / "one" / "site"
    files = sorted(path.relative_to(site).as_posix() for path in site.rglob("*") if path.is_file())
    assert files == ["arm.urdf", *(f"logs/take-{k}/machine.csv" for k in (1, 2, 3)), "machine.toml", "recipe.toml"]
    for name in ("machine.toml", "arm.urdf", "recipe.toml"):
        assert "bias" not in (site / name).read_text("utf-8")
