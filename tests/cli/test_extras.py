"""What is said where a package of an extra is missing."""

from __future__ import annotations

from collections.abc import Callable

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
