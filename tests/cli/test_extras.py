"""What is said where a package of an extra is missing."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from sysid.cli import app
from sysid.extras import EXTRAS, installed, versions_of


def missing(name: str) -> Callable[..., int]:
    def main(**_: object) -> int:
        raise ModuleNotFoundError(f"No module named {name!r}", name=name)

    return main


@pytest.mark.parametrize(("module", "extra"), [("torch", "networks"), ("rerun.blueprint", "view"), ("pybullet", "world")])
def test_a_missing_package_is_answered_by_its_extra(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], module: str, extra: str
) -> None:
    monkeypatch.setattr(app.app, "main", missing(module))
    assert app.run_command([]) == 2
    error = capsys.readouterr().err
    assert f"this needs the package {module}, which is not installed." in error
    assert f"pip install 'sysid-toolkit[{extra}]' installs it." in error


def test_a_module_of_no_extra_is_a_bug(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(app.app, "main", missing("numpy"))
    with pytest.raises(ModuleNotFoundError):
        app.run_command([])


def test_versions_of_missing_packages_are_stated() -> None:
    found = versions_of(["numpy", "a-package-that-nobody-has"])
    assert found["a-package-that-nobody-has"] == "not installed"
    assert found["numpy"][0].isdigit()
    assert not installed("a_package_that_nobody_has")
    assert all(name.isidentifier() for name in EXTRAS)


#: Takes every name of ``import sysid``, and a report of what is not there, where no package of an extra can be imported.
CORE = """
import sys
from sysid.extras import EXTRAS

class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in EXTRAS:
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Absent())
import sysid
from sysid.extras import extra_of

for name in sysid.__all__:
    try:
        getattr(sysid, name)
    except ModuleNotFoundError as error:
        print(name, extra_of(error))
try:
    sysid.report("nothing", workspace=sys.argv[1])
except sysid.StoreError as error:
    print(type(error).__name__)
"""


def test_the_core_alone_has_the_front(tmp_path: Path) -> None:
    done = subprocess.run([sys.executable, "-c", CORE, str(tmp_path)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.split() == ["StoreError"]
