"""Pipelines are files, not a package: tests load them from where they lie."""

from __future__ import annotations

import importlib.util
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

PIPELINES = Path(__file__).parents[2] / "pipelines"


@pytest.fixture(scope="session")
def pipeline() -> Callable[[str], ModuleType]:
    """``pipeline("first_look")`` is the module in ``pipelines/first_look.py``."""

    def load(name: str) -> ModuleType:
        spec = importlib.util.spec_from_file_location(name, PIPELINES / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module  # dataclasses look their module up there
        spec.loader.exec_module(module)
        return module

    return load
