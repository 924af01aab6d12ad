"""``sysid gap --simulator``: a user's own file, and what may be wrong with it."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_line import run

from sysid.cli.gap import load_simulator, repaired_path
from sysid.errors import InputError, SettingsError

GOOD = """
import helper_of_the_crane

class Crane:
    def simulate(self, recording):
        return helper_of_the_crane.table(recording)

crane = Crane()
number = 3

class Licensed(Crane):
    def __init__(self):
        raise RuntimeError("no licence")
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    (tmp_path / "helper_of_the_crane.py").write_text("def table(recording):\n    return recording\n")
    path = tmp_path / "crane.py"
    path.write_text(GOOD)
    return path


def test_class_and_object(file: Path) -> None:
    for name in ("Crane", "crane"):
        assert load_simulator(f"{file}:{name}").simulate("said") == "said"  # type: ignore[arg-type, comparison-overlap]


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("{file}:Crain", "no 'Crain' in it; expected 'Crane'? (valid: Crane, Licensed, crane)"),
        ("{file}:number", "number has no method simulate; expected simulate(recording)"),
        ("{file}:Licensed", "RuntimeError: no licence; expected a file that runs"),
        ("{file}x.py:Crane", "no such file; expected a Python file"),
    ],
)
def test_what_is_no_simulator(file: Path, place: str, message: str) -> None:
    with pytest.raises(InputError) as error:
        load_simulator(place.format(file=file))
    assert message in str(error.value)


@pytest.mark.parametrize("place", ["crane", "os:path", "crane.py", "crane.py:", "crane.py:a b"])
def test_only_a_file_and_a_name(place: str) -> None:
    with pytest.raises(SettingsError, match=r"not a file and a name in it; expected FILE\.py:NAME"):
        load_simulator(place)


def test_broken_file(tmp_path: Path) -> None:
    (tmp_path / "broken.py").write_text("def simulate(:\n")
    with pytest.raises(InputError, match="SyntaxError"):
        load_simulator(f"{tmp_path / 'broken.py'}:Crane")


def test_a_repaired_model_needs_a_model(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert run("gap", "arm", "--simulator", "crane.py:Crane", "--out", tmp_path / "out.xml") == 2
    assert "--out without a MuJoCo model; expected --simulator mujoco:FILE.xml" in capsys.readouterr().err


def test_a_repaired_model_is_named_after_the_model() -> None:
    assert repaired_path(Path("robots/arm.xml")) == Path("robots/arm.repaired.xml")
