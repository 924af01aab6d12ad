"""Every block of commands and of Python in the documentation is run by a test, or is listed here with the reason why not."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import crane_data
import numpy as np
import page_walk
import pytest
from crane_model import crane_plant
from crane_store import crane_registry
from fleet_logs import one_lift
from sample_crane import sample_dataset
from stored import small_dataset
from test_pages import PAGES as FOLLOWED
from verbs import poses

from sysid.datasets import append, ingest
from sysid.datasets.versions.manifest import PartRecord
from sysid.networks import NetworkRecipe, fit_forward, parse_recipe
from sysid.workspace import Workspace
from sysid_rl.control import CylinderController

ROOT = Path(__file__).parents[2]
BLOCK = re.compile(r"^ *```(sh|python)([^\n]*)\n(.*?)^ *```$", re.MULTILINE | re.DOTALL)
TEXTS = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md"), *(ROOT / "datasets").glob("**/README.md"), ROOT / "rl/README.md"]
#: Page and language → the test that runs all its blocks of it; the pages of ``test_pages.py`` are followed word by word.
ELSEWHERE = {
    ("README.md", "python"): "tests/pipelines/test_first_look.py",
    ("docs/guide/cluster.md", "sh"): "tests/cli/test_cluster_page.py",
    ("docs/guide/own-effect.md", "python"): "tests/effects/test_own_effect.py",
    ("docs/guide/own-logs.md", "python"): "tests/datasets/test_in_memory.py",
    ("docs/guide/own-simulator.md", "python"): "tests/gap/adapters/test_own_simulator.py",
    ("docs/guide/wrong-data.md", "sh"): "tests/cli/test_wrong_data.py",
}
#: First line of a block that no test runs as it stands → why.
LEFT_OUT = {
    "make demo ": "makes an environment from the package index; tests/cli/test_demo.py runs the demo",
    "pip install sysid-toolkit ": "installs from the package index; tests/cli/test_wheel.py installs the wheel",
    "echo 'eval ": "changes the shell of its user",
    "sysid run collect.toml ": "moves a machine for 70 minutes; tests/runner runs this mode on the simulated test bench",
    "sysid run RUNNER.toml --commission": "moves a machine behind a bus; tests/runner commissions the simulated test bench",
    "sysid train rl/autolog/quick.toml": "trains for minutes on versions of `make demo`; the Python of its page trains here",
}


def blocks() -> list[tuple[str, str, str]]:
    """Page, language and text of each block."""
    found = []
    for page in sorted(TEXTS):
        name = str(page.relative_to(ROOT))
        found += [(name, match[1], match[3]) for match in BLOCK.finditer(page.read_text("utf-8")) if "file=" not in match[2]]
    return found


def blocks_of(page: str, language: str) -> list[str]:
    return [text for name, kind, text in blocks() if (name, kind) == (page, language)]


# What the blocks of a page start from, and the names that its Python uses.


def machines(folder: Path, names: dict[str, int]) -> None:
    """A dataset of each name in ``folder/workspace``, with so many recordings ``manual-01`` … of a lift."""
    for name, count in names.items():
        logs = lift(folder / "sources" / name, count)
        ingest(logs, folder / "workspace", name=name)


def lift(folder: Path, count: int) -> Path:
    """Logs of a lift, with a description that they are ingested with; its axis is called boom."""
    one_lift(folder, count)
    for k in range(count):
        (folder / f"run-{k}").rename(folder / f"manual-0{k + 1}")
    return folder


def nothing(folder: Path) -> dict[str, Any]:
    return {}


def versions(folder: Path) -> dict[str, Any]:
    """Two versions of a dataset, and logs that they do not hold yet."""
    machines(folder, {"autolog": 5})
    logs = lift(folder / "logs", 7)
    append([logs / "manual-06"], folder / "workspace", "autolog")
    return {}


def quality(folder: Path) -> dict[str, Any]:
    machines(folder, {"excavator": 4})
    return {}


def fleet(folder: Path) -> dict[str, Any]:
    machines(folder, {f"crane-0{k}": 4 for k in (1, 2, 3, 4)})
    flights = lift(folder / "new", 7)
    (folder / "flights").mkdir()
    (flights / "manual-07").rename(folder / "flights" / "manual-07")
    return {}


def unnamed(folder: Path) -> dict[str, Any]:
    machines(folder, {"my-crane": 4})
    return {}


def own_crane(folder: Path) -> dict[str, Any]:
    lift(folder / "my-crane/datasets/my-crane", 4)
    return {}


def models(folder: Path) -> dict[str, Any]:
    """Three versions of a forward network, logs that are newer, and the page's policy of promotion."""
    poses(folder / "workspace")
    place = Workspace(folder / "workspace")
    stored = place.dataset("crane")
    for name in ("autolog", "newer-logs"):
        place.datasets.save(replace(stored, name=name, version=0), small_dataset(1)[1], PartRecord(1))
    data = place.dataset("autolog")
    for hidden in (4, 5, 6):
        place.add_network(data, fit_forward(data, tiny_recipe(hidden)), tiny_recipe(hidden))
    (folder / "policy.toml").write_text('schema = 1\n[forward.limits]\n"ee.*" = {max = "100 m"}\n')
    return {}


def tiny_recipe(hidden: int) -> NetworkRecipe:
    """Of a forward network of a few weights."""
    training = {"epochs": 4, "batch": 16, "check_every": 2}
    return parse_recipe({"forward": {"hidden": [hidden], "training": training}}, "tiny")


def networks(folder: Path) -> dict[str, Any]:
    inputs = np.random.default_rng(0).uniform(-1.0, 1.0, (60, 2))
    return {
        "dataset": sample_dataset(20.0),
        "workspace": folder / "workspace",
        "X": inputs,
        "y": np.sin(inputs),
        "groups": np.repeat(np.arange(6), 10),
        "model": fit_forward(crane_data.dataset((crane_data.poses(count=300),), {}), tiny_recipe(4)),
        "q": np.array([[0.0, 0.5, -1.0, 0.1]]),
    }


def training(folder: Path) -> dict[str, Any]:
    crane_registry(folder / "workspace")
    path = folder / "small.toml"
    path.write_text(
        'name = "small"\nplant = "crane"\nforward = "crane-forward"\nevaluations = 1\n'
        "[setting]\ncopies = 4\ntask = {steps = 15}\n[networks]\nactor = [12, 8]\ncritic = [10]\n"
        "[learning]\nepisodes = 8\nstart = 32\nbatch = 16\nbuffer = 80\n"
    )
    plant, rest = crane_plant(), [0.0, 0.5, -1.0, 0.1]
    measured = CylinderController(plant).drive(rest)
    return {"path": path, "plant": plant, "observations": np.zeros((1, 10)), "measured": measured, "setpoints": rest}


#: Page → what its blocks start from, and languages of the blocks that are run here.
HERE: dict[str, tuple[Callable[[Path], dict[str, Any]], str]] = {
    "docs/actuators.md": (nothing, "sh"),
    "docs/guide/commands.md": (nothing, "python"),
    "docs/guide/fleet.md": (fleet, "sh"),
    "docs/guide/models.md": (models, "sh"),
    "docs/guide/python.md": (own_crane, "python"),
    "docs/guide/quality.md": (quality, "sh"),
    "docs/guide/training.md": (training, "python"),
    "docs/guide/unnamed.md": (unnamed, "sh"),
    "docs/guide/versions.md": (versions, "sh python"),
    "docs/guide/workspace-pages.md": (quality, "sh"),
    "docs/networks.md": (networks, "python"),
}


def is_run(page: str, language: str, text: str) -> bool:
    followed = page in FOLLOWED and language == "sh"
    here = page in HERE and language in HERE[page][1].split()
    return followed or here or (page, language) in ELSEWHERE


def test_every_block_is_run_or_left_out_for_a_reason() -> None:
    used = set()
    for page, language, text in blocks():
        reasons = {line for line in LEFT_OUT if text.startswith(line)}
        used |= reasons
        assert is_run(page, language, text) != bool(reasons), f"{page}: {text.splitlines()[0]}"
    assert used == LEFT_OUT.keys(), "a reason without its block"
    for (page, language), test in ELSEWHERE.items():
        assert blocks_of(page, language), f"{page} has no {language}"
        assert re.search(rf'{Path(page).name}"|"{page}|README', (ROOT / test).read_text("utf-8")), f"{test} reads {page}"


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("page", HERE)
def test_the_blocks_of_a_page_run(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In their order; first those of the shell, each command of which has to succeed."""
    prepare, languages = HERE[page]
    names = prepare(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("SYSID_WORKSPACE", str(tmp_path / "workspace"))
    for text in blocks_of(page, "sh") if "sh" in languages else ():
        page_walk.run(text, tmp_path, None)
    for text in blocks_of(page, "python") if "python" in languages else ():
        exec(compile(text, page, "exec"), names)
