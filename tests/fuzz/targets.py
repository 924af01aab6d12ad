"""What is fuzzed beside the readers of logs: files that a stranger can hand over with a workspace, and names.

A target takes bytes and lets nothing out but errors of ``sysid.errors``; what it takes for good is used as far as a list or a
check would use it. The seeds are what the project itself writes.
"""

from __future__ import annotations

import functools
import hashlib
import json
import shutil
import tempfile
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import whole_verbs

ROOT = Path(__file__).parents[2]
AUTOLOG = ROOT / "datasets" / "autolog"


@dataclass(frozen=True)
class Target:
    """``run(data)`` raises where something is wrong with the project; ``seeds()`` are inputs that are taken."""

    run: Callable[[bytes], None]
    seeds: Callable[[], tuple[bytes, ...]]


def _text(data: bytes) -> str:
    return data.decode("utf-8", errors="replace")


# -- workspaces -----------------------------------------------------------------------------------------------------


@functools.cache
def _workspace() -> Path:
    """A workspace with ``demo@1``; ``demo@2`` is the input."""
    from stored import small_dataset

    from sysid.datasets import Store
    from sysid.datasets.versions.manifest import PartRecord

    place = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None)) / "ws"
    Store(place).save(*small_dataset(1), PartRecord(1))
    return place


def _sealed(data: bytes) -> bytes:
    """The manifest with a seal that fits, where it is a table at all: a stranger can make one."""
    from sysid.datasets.versions.manifest import digest_of
    from sysid.parse import parse_json

    try:
        manifest = parse_json(data)
        manifest.pop("seal", None)
        return json.dumps({**manifest, "seal": digest_of(manifest)}).encode()
    except (ValueError, AttributeError, TypeError):
        return data


def workspace(data: bytes) -> None:
    """A manifest, with and without a seal that fits: listed, loaded, followed; nothing outside is touched."""
    from sysid.datasets import Store, lineage, vacuum
    from sysid.errors import SysidError

    place = _workspace()
    before = {path.name for path in place.parent.iterdir()}
    for content in (data, _sealed(data)):
        (place / "datasets/demo/versions/000002.json").write_bytes(content)
        store = Store(place)
        rows = {entry.reference: entry for entry in store.list()}
        assert not rows["demo@1"].damage, "one row breaks another"
        for work in (store.load, store.tables, functools.partial(lineage, store)):
            try:
                work("demo@2")
            except SysidError:
                assert rows["demo@2"].damage or work == store.load, f"{work} refuses what the list takes"
        vacuum(store, lambda *_: (), dry_run=True)
    assert {path.name for path in place.parent.iterdir()} == before, "something was written outside"


def _workspace_seeds() -> tuple[bytes, ...]:
    manifest = json.loads((_workspace() / "datasets/demo/versions/000001.json").read_text())
    split = {"version": 1, "digest": manifest["digest"], "by": "split"}
    return tuple(json.dumps({**manifest, "version": 2, "base": base}).encode() for base in (None, split))


def registry_row(data: bytes) -> None:
    """``manifest \\0 metrics \\0 decision``, with the digest that belongs to the manifest."""
    from sysid.errors import SysidError
    from sysid.registry.entries import version_of
    from sysid.registry.stored import DECISION, DIGEST, MANIFEST, METRICS, StoredModel, StoredVersion

    manifest, metrics, decision, *_ = [_text(part) for part in data.split(b"\0")] + ["", "", ""]
    tags = {MANIFEST: manifest, DIGEST: hashlib.sha256(manifest.encode()).hexdigest(), METRICS: metrics or "{}"}
    tags |= {f"{DECISION}.1": decision} if decision else {}
    row = StoredVersion(1, 0, "", tags)
    try:
        version = version_of(StoredModel("arm", (row,), {"champion": 1}), row)
    except SysidError:
        return
    json.dumps(version.to_json())
    assert all(isinstance(value, float) for value in version.metrics.values())


def _registry_seeds() -> tuple[bytes, ...]:
    from sysid.registry.promotion import Check, PromotionDecision

    manifest = json.dumps({"files": {"plant.json": "ab"}, "kind": "plant", "lineage": {"dataset": "demo@1"}})
    decision = PromotionDecision(True, "", (Check("names", "passed", "one"),), judged={"by": "gap"}).to_text()
    return (f'{manifest}\0{{"rmse": 1e-3}}\0{decision}'.encode(),)


# -- models ---------------------------------------------------------------------------------------------------------


@functools.cache
def _models() -> tuple[dict[str, bytes], dict[str, bytes]]:
    from crane_model import crane_plant
    from crane_store import learned

    from sysid.networks import to_files

    plant = crane_plant()
    return plant.to_files(), to_files(learned(plant))[1]


def plant(data: bytes) -> None:
    """The description of a plant, beside its tables."""
    from sysid.errors import SysidError
    from sysid.plant import plant_from_files

    try:
        plant_from_files({**_models()[0], "plant.json": data}, "input")
    except SysidError:
        return


def network(data: bytes) -> None:
    """The structure of a network, beside its weights."""
    from sysid.errors import SysidError
    from sysid.networks import from_files
    from sysid.networks.artifacts import STRUCTURE

    try:
        from_files({**_models()[1], STRUCTURE: data}, "input")
    except SysidError:
        return


def _structure() -> bytes:
    from sysid.networks.artifacts import STRUCTURE

    return _models()[1][STRUCTURE]


# -- descriptions ---------------------------------------------------------------------------------------------------


@functools.cache
def _autolog() -> tuple[str, str, str]:
    return tuple((AUTOLOG / name).read_text("utf-8") for name in ("machine.toml", "autolog.urdf", "recipe.toml"))  # type: ignore[return-value]


def _machine(toml: str, urdf: str, name: str = "autolog.urdf") -> None:
    from sysid.errors import SysidError
    from sysid.machine import machine_from_files
    from sysid.view.drawing import link_shapes

    try:
        machine = machine_from_files({"machine.toml": toml, name: urdf}, "input")
        kinematics = machine.kinematics()
    except SysidError:
        return
    assert 1e-3 <= machine.rate_hz <= 1e6
    for axis in machine.axes:
        assert 0.0 < axis.gain < 1e10
        assert axis.limits is None or axis.limits[0] < axis.limits[1]
    if kinematics is not None:
        poses = kinematics.link_poses([[0.0] * len(kinematics.actuated)])  # type: ignore[arg-type]
        assert all(abs(float(value)) < 1e12 for pose in poses.values() for value in pose.flat)
        try:
            link_shapes(urdf, kinematics)
        except SysidError:
            return


def machine(data: bytes) -> None:
    """``machine.toml``, beside the URDF that ships."""
    _machine(_text(data), _autolog()[1])


def urdf(data: bytes) -> None:
    """A URDF, beside the ``machine.toml`` that ships."""
    _machine(_autolog()[0], _text(data))


@functools.cache
def _robot() -> Path:
    """Where the input is: a folder with a part that it may include, and with a file beside it that it may not."""
    place = Path(tempfile.mkdtemp(dir="/dev/shm" if Path("/dev/shm").is_dir() else None)) / "robot"
    (place / "sub").mkdir(parents=True)
    (place.parent / "out.xml").write_text('<mujoco><worldbody><body name="outside"/></worldbody></mujoco>')
    (place / "sub/part.xml").write_text('<mujoco><worldbody><body name="part"/></worldbody></mujoco>')
    return place


#: What an attribute of a robot is replaced by.
_VALUES = ("0", "-1", "nan", "inf", "1e308", "1e-308", "", "0 0 0", "1 2 3", "x", "true", "2147483648", "1e-9 1 1 1 1 1 1")


def _edited(data: bytes) -> bytes:
    """A robot of the tests with attributes replaced and elements removed or doubled: its number, then three bytes an edit."""
    from xml.etree.ElementTree import fromstring, tostring

    files = _robots()
    root = fromstring(files[data[0] % len(files)].read_bytes())
    for place, key, value in zip(data[1::3], data[2::3], data[3::3], strict=False):
        parents = [element for element in root.iter() if len(element)]
        elements = [(parent, child) for parent in parents for child in parent]
        if not elements:
            break
        parent, element = elements[place % len(elements)]
        keys = list(element.attrib)
        if key % 8 == 0:
            parent.remove(element)
        elif key % 8 == 1:
            parent.append(element)
        elif keys:
            element.set(keys[key % len(keys)], _VALUES[value % len(_VALUES)])
    return tostring(root)


def mjcf(data: bytes) -> None:
    """An MJCF, or edits of one: the draft of its machine in a confined process, and here what that process has taken."""
    from sysid.confined import Limits, confined
    from sysid.datasets.robot_files import Choices, Drafted, drafted_files
    from sysid.errors import SysidError
    from sysid.machine.sources import mjcf_model
    from sysid.machine.sources.mjcf_files import joined_model

    path = _robot() / "input.xml"
    path.write_bytes(data if not data or data[:1] in b"<\n " else _edited(data))
    limits = Limits(2**30, 5.0)
    try:
        joined = joined_model(path)
        assert "outside" not in "".join(joined.texts.values())
        confined(lambda report: drafted_files(path, "input", Choices()), path, limits, (Drafted,))
    except SysidError as error:
        if "cannot be read (" in str(error):  # not an error of ours
            raise AssertionError(str(error)) from error
        return
    alone = mjcf_model.inside
    mjcf_model.inside = lambda: True
    try:
        drafted = drafted_files(path, "input", Choices())
    finally:
        mjcf_model.inside = alone
    _machine(drafted.files["machine.toml"], drafted.files["input.urdf"], "input.urdf")


def _robots() -> list[Path]:
    return [path for path in sorted((ROOT / "tests/helpers/robots").rglob("*.xml")) if path.stat().st_size < 16_000]


def _mjcf_seeds() -> tuple[bytes, ...]:
    names = ("sub/part.xml", "../out.xml", "input.xml")
    others = "".join(f'<include file="{name}"/>' for name in names)
    made = (
        f"<mujoco>{others}</mujoco>",
        '<mujoco><asset><model name="m" file="sub/part.xml"/><mesh file="../out.obj"/><texture type="2d" file="none.png"/>'
        '</asset><worldbody><attach model="m" body="part" prefix="m"/><replicate count="2"><geom size="1"/></replicate>'
        "</worldbody></mujoco>",
    )
    return (*(path.read_bytes() for path in _robots()), *map(str.encode, made), *(bytes([k, 9, 10, k]) for k in range(33, 50)))


def recipe(data: bytes) -> None:
    """An ingest recipe; the same text as a training and as a runner recipe, which have other keys."""
    from sysid.config import toml_values
    from sysid.datasets.recipe import check_against_machine, stored_recipe
    from sysid.errors import SysidError
    from sysid.machine import machine_from_files
    from sysid_rl.run.recipe import parse_runner
    from sysid_rl.train.recipe import parse_training

    text = _text(data)
    toml, robot, _ = _autolog()
    try:
        rules = stored_recipe(text, "input")
        check_against_machine(rules, machine_from_files({"machine.toml": toml, "autolog.urdf": robot}, "input"), "input")
    except SysidError:
        pass
    for parse in (parse_training, parse_runner):
        try:
            parse(toml_values(text, "input"), Path("input"))
        except SysidError:
            continue


def _recipe_seeds() -> tuple[bytes, ...]:
    files = sorted((ROOT / "datasets").glob("*/recipe.toml")) + sorted((ROOT / "rl").glob("*/*.toml"))
    return tuple(path.read_bytes() for path in files if path.stat().st_size < 16_000)


# -- names ----------------------------------------------------------------------------------------------------------


def names(data: bytes) -> None:
    """Whatever check takes a name, it is one part of a path, and a terminal shows it as it is."""
    from sysid.errors import SettingsError, StoreError
    from sysid.foreign import escaped_json, shown, visible
    from sysid.names import check_dataset_name, check_file_name, check_name
    from sysid.root import Root

    text = data.decode("utf-8", errors="surrogateescape")
    for check in (check_name, check_dataset_name, check_file_name):
        try:
            name = check(text, "input")
        except SettingsError:
            continue
        assert Path(name).name == name
        assert name not in (".", "..")
        assert visible(name) == name
        assert (Path("/root") / name).parent == Path("/root")
    for words in (visible(text), shown(text)):
        assert not any(unicodedata.category(letter)[0] == "C" or letter in "\u2028\u2029" for letter in words)
    assert json.loads(escaped_json(json.dumps(_text(data), ensure_ascii=False))) == _text(data)
    root = Root(_workspace())
    try:
        path = root.path(text)
    except StoreError:
        return
    assert path.resolve().is_relative_to(_workspace().resolve())


def _name_seeds() -> tuple[bytes, ...]:
    return (b"autolog", "Bagger-µ.1".encode(), b"../../x", b"a/b", b"\x1b[31m", "\u202e".encode(), b"datasets/demo/data")


TARGETS: dict[str, Target] = {
    "edges": Target(whole_verbs.edges, whole_verbs.edge_seeds),
    "export-names": Target(whole_verbs.exported_names, whole_verbs.name_seeds),
    "watch-state": Target(whole_verbs.watch_state, whole_verbs.watch_seeds),
    "arrivals": Target(whole_verbs.arrivals, whole_verbs.arrival_seeds),
    "gap-result": Target(whole_verbs.gap_result, whole_verbs.result_seeds),
    "current-folder": Target(whole_verbs.current_folder, whole_verbs.current_seeds),
    "workspace": Target(workspace, _workspace_seeds),
    "registry-row": Target(registry_row, _registry_seeds),
    "plant": Target(plant, lambda: (_models()[0]["plant.json"],)),
    "network": Target(network, lambda: (_structure(),)),
    "machine": Target(machine, lambda: (_autolog()[0].encode(),)),
    "urdf": Target(urdf, lambda: (_autolog()[1].encode(), *(p.read_bytes() for p in sorted(ROOT.glob("datasets/*/*.urdf"))))),
    "mjcf": Target(mjcf, _mjcf_seeds),
    "recipe": Target(recipe, _recipe_seeds),
    "names": Target(names, _name_seeds),
}


def forget() -> None:
    """Remove the folders of this process."""
    for made in (_workspace, _robot):
        if made.cache_info().currsize:
            shutil.rmtree(made().parent, ignore_errors=True)
            made.cache_clear()
    whole_verbs.forget()
