"""Pipelines are files, not a package: tests load them from where they lie."""

from __future__ import annotations

import importlib.util
import json
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def pipeline() -> Iterator[Callable[[str], ModuleType]]:
    """``pipeline("first_look")`` is the module in ``pipelines/first_look.py``; it finds its neighbours as in a run."""

    def load(name: str) -> ModuleType:
        spec = importlib.util.spec_from_file_location(name, ROOT / "pipelines" / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # dataclasses look their module up there
        spec.loader.exec_module(module)
        return module

    sys.path.insert(0, str(ROOT / "pipelines"))
    yield load
    sys.path.remove(str(ROOT / "pipelines"))


@pytest.fixture(scope="module")
def result_on_measured(
    pipeline: Callable[[str], ModuleType], tmp_path_factory: pytest.TempPathFactory
) -> Callable[..., dict[str, Any]]:
    """``result_on_measured("emps")`` runs that pipeline on the measured files in the folder of that name, or of another one.

    Skips where they are absent.
    """

    def run(name: str, folder: str = "") -> dict[str, Any]:
        raw = ROOT / "../shared/data" / (folder or name)
        if not raw.is_dir():
            pytest.skip(f"the measured data (../shared/data/{folder or name}) are not here")
        path: Path = pipeline(name).main(raw, tmp_path_factory.mktemp(name))
        result: dict[str, Any] = json.loads(path.read_text("utf-8"))
        return result

    return run
