"""Packages whose modules are imported when a name of them is used (PEP 562, as in SPEC 1 of Scientific Python)."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable, Mapping, Sequence
from types import ModuleType
from typing import Any


def lazy_names(package: str, modules: Mapping[str, Sequence[str]]) -> Callable[[str], Any]:
    """``__getattr__`` of ``package``: imports the module of a name at its first use.

    Args:
        modules: module below ``package`` → the names that it defines. A module of the same name as one of them would hide it.
    """
    places = {name: module for module, names in modules.items() for name in names}

    def get(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module {package!r} has no attribute {name!r}", name=name, obj=sys.modules[package])
        value = getattr(importlib.import_module(f"{package}.{places[name]}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return get


def functions_beside_packages(package: str, functions: Mapping[str, str]) -> None:
    """Make sub-packages callable: they are called as the function of the same name.

    Without this, importing ``sysid.export`` would hide the function ``sysid.export`` of the package ``sysid``.

    Args:
        functions: name of a sub-package and of the function → the module that defines the function.
    """

    class CallablePackage(ModuleType):
        def __call__(self, *args: Any, **kwargs: Any) -> Any:
            return function_of(self.__name__.rpartition(".")[2])(*args, **kwargs)

    class Package(ModuleType):
        def __setattr__(self, name: str, value: object) -> None:
            if name in functions:
                if not isinstance(value, ModuleType):
                    return
                value.__class__ = CallablePackage  # at the import of the sub-package
            super().__setattr__(name, value)

    def function_of(name: str) -> Any:
        return getattr(importlib.import_module(f"{package}.{functions[name]}"), name)

    sys.modules[package].__class__ = Package
