"""Kernels of the plant as plain Python source, for files that are shipped: the functions behind the compiled code.

A kernel comes with all that it calls. Decorators go, and so do modules: a function has the name of its module before its own,
a constant is a number. Arrays are lists (of lists) of floats. No text of a file is in it.
"""

from __future__ import annotations

import ast
import inspect
import math
import textwrap
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import ModuleType
from typing import Any

import numpy as np

from sysid.errors import SettingsError

#: Functions of NumPy → those of the standard library with numbers.
_MATH: Mapping[Any, str] = {np.isnan: "isnan", np.floor: "floor"}


def kernel_name(kernel: Any) -> str:
    """The name of a kernel in the source."""
    return f"{kernel.__module__.rpartition('.')[2]}_{kernel.__name__.lstrip('_')}"


@contextmanager
def following(kernel: Any, expected: str) -> Iterator[None]:
    """Follow the source of a kernel.

    Raises:
        SettingsError: it contains what cannot be exported, as an effect of one's own may; ``expected``: what it may contain.
    """
    try:
        yield
    except NotImplementedError as error:
        where = f"export of {kernel.__module__}.{kernel.__name__}"
        raise SettingsError(where, str(error), expected, "Write the function with these, or leave its effect out.") from error


def definition_of(kernel: Any) -> ast.FunctionDef:
    """The parsed source of a kernel, or of a function that is not compiled."""
    definition = ast.parse(textwrap.dedent(inspect.getsource(getattr(kernel, "py_func", kernel)))).body[0]
    assert isinstance(definition, ast.FunctionDef)
    return definition


def kernel_source(kernels: Iterable[Any]) -> str:
    """The source of kernels and of those that they call, each before its callers; it needs ``math``.

    Raises:
        SettingsError: a kernel contains what plain Python with numbers and lists has not.
    """
    texts: dict[str, str] = {}
    for kernel in kernels:
        _add(kernel, texts)
    return "\n\n\n".join(texts.values())


def _add(kernel: Any, texts: dict[str, str]) -> None:
    name = kernel_name(kernel)
    if name in texts:
        return
    function, definition = kernel.py_func, definition_of(kernel)
    plain = _Plain(function.__globals__, definition)
    with following(function, "numbers, lists and functions of math, NumPy's isnan and floor"):
        definition = plain.visit(definition)
    definition.name, definition.decorator_list = name, []
    for called in plain.called:
        _add(called, texts)
    texts[name] = ast.unparse(ast.fix_missing_locations(definition))


class _Plain(ast.NodeTransformer):
    """Replaces what a kernel takes from its module; ``called``: the kernels among it."""

    def __init__(self, names: Mapping[str, Any], definition: ast.FunctionDef) -> None:
        self.names, self.called = names, list[Any]()
        self.local = {node.arg for node in ast.walk(definition) if isinstance(node, ast.arg)}
        self.local |= {n.id for n in ast.walk(definition) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}

    def visit_Name(self, node: ast.Name) -> ast.expr:
        if node.id in self.local or node.id not in self.names:
            return node
        return self.plain(self.names[node.id], node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        owner = self.owner(node.value)
        if owner is None:
            if node.attr == "shape":
                raise NotImplementedError("the shape of an array")
            return node
        return self.plain(getattr(owner, node.attr), node)

    def visit_Subscript(self, node: ast.Subscript) -> ast.expr:
        if ast.unparse(node.value).endswith(".shape"):  # of a table: points in a row
            table = ast.unparse(node.value).removesuffix(".shape")
            return ast.parse(f"len({table}[0])", mode="eval").body
        value: ast.expr = self.visit(node.value)
        places = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        for k, place in enumerate(places):
            value = ast.Subscript(value, self.visit(place), node.ctx if k == len(places) - 1 else ast.Load())
        return value

    def owner(self, node: ast.expr) -> Any:
        """Module or table of constants that an expression names, None for a variable."""
        match node:
            case ast.Name(id=name) if name not in self.local:
                return self.names.get(name)
            case ast.Attribute(value=value, attr=name):
                owner = self.owner(value)
                return None if owner is None else getattr(owner, name)
        return None

    def plain(self, found: Any, node: ast.expr) -> ast.expr:
        if hasattr(found, "py_func"):
            self.called.append(found)
            return ast.Name(kernel_name(found), ast.Load())
        if found in _MATH or getattr(math, getattr(found, "__name__", ""), None) is found:
            return ast.parse(f"math.{_MATH.get(found) or found.__name__}", mode="eval").body
        if isinstance(found, (int, float)):
            return ast.parse("math.nan" if found != found else repr(found), mode="eval").body
        if isinstance(found, ModuleType) or not isinstance(node, ast.Name):
            raise NotImplementedError(ast.unparse(node))
        return node
