"""Pages that show commands are followed word by word: guides, and the page of each machine in ``datasets/``."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import page_walk
import pandas as pd
import pytest
from page_walk import Step, departures, prepare, walk

from sysid.logs.inspection import inspect_file

ROOT = Path(__file__).parents[2]
EXCAVATOR = "docs/guide/own-logs.md"
#: Page → folder of ``../shared/data`` that its ``$LOGS`` means; None: it needs nothing but the repository.
PAGES = {
    EXCAVATOR: "rc_excavator",
    "docs/guide/servo.md": "sage_so101",
    "docs/guide/poses.md": "tiago_mocap",
    "docs/guide/electric-arm.md": None,
    "docs/guide/mujoco.md": None,
    "docs/guide/export.md": None,
    "datasets/autolog/README.md": None,
    "datasets/cascaded_tanks/README.md": "cascaded_tanks",
    "datasets/double_pendulum/README.md": "double_pendulum",
    "datasets/emps/README.md": "emps",
    "datasets/hydraulic_actuator/README.md": "hyd_actuator",
    "datasets/rc_excavator/README.md": "rc_excavator",
    "datasets/servo_backlash/README.md": "servo_backlash",
    "datasets/so101/README.md": "sage_so101",
    "datasets/tiago/README.md": "tiago_mocap",
    "datasets/ur10/README.md": "tiago_mocap",
    "datasets/ur10e/README.md": "ur10e_arm",
    "datasets/xl330/README.md": "bam_xl330",
}
#: Pages that are short, which show how commands are followed; that the commands of all exist: tests/contract.
FAST = ("docs/guide/electric-arm.md", "docs/guide/export.md")


def steps(name: str, folder: Path, request: pytest.FixtureRequest, slow: bool) -> Iterator[Step]:
    """Follow a page; its output blocks are compared on the way. Skips where its logs are absent."""
    logs = None if PAGES[name] is None else request.getfixturevalue("shared_data") / PAGES[name]
    if logs is not None and not logs.is_dir():
        pytest.skip(f"the measured data (../shared/data/{PAGES[name]}) are not here")
    prepare(ROOT / name, folder)
    for step in walk(ROOT / name, folder, logs, slow):
        if step.block.kind == "console":
            assert departures(step.block.text, step.output) == [], f"renew: python tests/helpers/page_walk.py {name} LOGS"
        yield step


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=() if name in FAST else pytest.mark.slow) for name in PAGES if name != EXCAVATOR],
)
def test_a_page_works_word_by_word(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    """Its quick commands. Long ones are marked on the page and run below."""
    assert [step.block for step in steps(name, tmp_path, request, slow=False) if step.block.kind == "sh"]


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("name", [name for name in PAGES if "```sh slow" in (ROOT / name).read_text("utf-8")])
def test_a_page_works_word_by_word_with_its_long_commands(name: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    assert any(step.block.is_slow for step in steps(name, tmp_path, request, slow=True))


def test_every_machine_has_a_page_that_is_followed() -> None:
    pages = {path.parent.name for path in ROOT.glob("datasets/*/machine.toml")}
    assert {f"datasets/{name}/README.md" for name in pages} <= set(PAGES)
    listed = (ROOT / "datasets/README.md").read_text("utf-8")
    assert [name for name in pages if f"]({name}/README.md)" not in listed] == []


@pytest.mark.slow
def test_the_excavator_page_works_word_by_word_and_what_it_says_of_its_logs_is_true(
    tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    folder = tmp_path / "excavator/datasets/excavator"
    for step in steps(EXCAVATOR, tmp_path, request, slow=False):
        if "--draft" in step.block.text:
            draft = (folder / "recipe.toml").read_text("utf-8")
    for axis, low, high in (("Boom", "4.939", "10.01"), ("Stick", "4.929", "8.861"), ("Bucket", "5.198", "10.03")):
        values = f'field = "{axis} Cmd", zero = <neutral>, span = <from neutral to full>'
        assert f'# "{axis.lower()}.command" = {{ {values} }}   # {low} … {high}' in draft
    # How the logs pause, where the joystick stands at rest, what full is.
    logs = [inspect_file(path).streams[0] for path in sorted((folder / "logs").iterdir())]
    assert len(logs) == 10
    assert all(0.1 < log.clocks[0].longest_gap_s < 1.1 for log in logs)
    first = pd.read_csv(folder / "logs/manual_ol_1006_1648.csv", nrows=5)
    recipe = (folder / "recipe.toml").read_text("utf-8")
    for axis, zero, span in re.findall(r'field = "(\w+) Cmd", zero = ([\d.]+), span = ([\d.]+)', recipe):
        np.testing.assert_allclose(first[f"{axis} Cmd"], float(zero), atol=1e-3)
        duty = next(field for field in logs[0].fields if field.name == f"{axis} Cmd")
        reach = max(duty.high - float(zero), float(zero) - duty.low)
        assert float(span) == pytest.approx(reach, rel=0.02)
    listed = json.loads(page_walk.run("sysid datasets excavator --json - 2>/dev/null", tmp_path, None))
    roles = {recording["name"]: recording["role"] for recording in listed["recordings"]}
    assert sum(role == "held_out" for name, role in roles.items() if name.startswith("steps_")) == 9
    assert {role for name, role in roles.items() if name.startswith("manual")} == {"fit", "select", "held_out"}


def test_the_servo_page_has_the_recipe_that_ships(datasets_folder: Path) -> None:
    blocks = [block for block in page_walk.blocks((ROOT / "docs/guide/servo.md").read_text("utf-8")) if block.kind == "toml"]
    for block, file in zip(blocks, ("machine.toml", "recipe.toml"), strict=True):
        shipped = (datasets_folder / "so101" / file).read_text("utf-8")
        own = {line for line in _lines(block.text) if "splits" not in line and not re.match("fit|select|held_out|logs", line)}
        assert own - _lines(shipped) == {'name = "arm"'}


def _lines(text: str) -> set[str]:
    return {line.partition("#")[0].strip() for line in text.splitlines() if line.partition("#")[0].strip()}


# How a walk compares and writes, on a page of its own.
PAGE = """\
Some words.
```sh
mkdir made && echo 'width   1.12 mm' && echo 'gain 7'
```
```console
 width 1.13 mm
…
 gain  7
```
```toml file=made/some.toml
first = 1
second = 2
```
```toml file=made/some.toml after="first = 1"
third = 3
```
```sh slow
touch late
```
```console
 never shown
```
```python
raise SystemExit("not followed")
```
"""


def test_a_walk_runs_writes_and_compares(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(PAGE, "utf-8")
    done = list(walk(page, tmp_path, slow=False))
    assert [step.block.kind for step in done] == ["sh", "console", "toml", "toml"]
    assert departures(done[1].block.text, done[1].output) == []
    assert (tmp_path / "made/some.toml").read_text("utf-8") == "first = 1\nthird = 3\n"
    assert not (tmp_path / "late").exists()


@pytest.mark.parametrize(
    ("shown", "printed", "same"),
    [
        ("lag 69.4 ms", "  lag   69.9 ms ", True),
        ("lag 69.4 ms", "lag 79.4 ms", False),
        ("bias −0.2", "bias -0.21", True),
        ("bias −0.2", "bias 0.2", False),
        ("count 0", "count 1", True),  # a unit of the last digit
        ("count 0", "count 3", False),
        ("boom lag", "stick lag", False),
        ("a 1\nb 2", "b 2\na 1", False),  # another order
    ],
)
def test_lines_of_output_are_the_same(shown: str, printed: str, same: bool) -> None:
    assert (departures(shown, printed) == []) is same


def test_output_is_renewed_line_by_line() -> None:
    printed = " effect  value\n ──────\n lag   70.0 ms\n delay  9 ms\n"
    assert page_walk.renewed(" lag  50.1 ms\n…\n", printed) == " lag   70.0 ms\n…\n"


def test_a_failing_command_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="No such file"):
        page_walk.run("ls absent", tmp_path, None)
