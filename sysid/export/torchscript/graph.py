"""Expressions of a batch: what the kernels of the plant compute, recorded operation by operation.

A value is a number, or a :class:`Node` that stands for one number of each machine. Operations with numbers alone are carried
out, neutral ones (``x + 0``, ``1 · x``, ``x`` chosen either way) vanish, and equal ones are one node.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

#: What both sides of an unused branch divide by, and take the root of.
SAFE = 1.0


@dataclass(frozen=True, eq=False)
class Node:
    """One operation.

    Args:
        op: ``input`` (with its group and place), or the name of an operation of :data:`NUMBERS` or of :mod:`.source`.
        args: nodes and numbers.
        value: where it follows from the parameters alone, its value at those of the plant.
        unset: it may be NaN, the state of a part that has not begun.
    """

    op: str
    args: tuple[Any, ...]
    value: float | None = None
    unset: bool = False


Value = Any  # float | bool | Node: the kernels are typed by what they are called with

#: Operation → the same with numbers.
NUMBERS: dict[str, Callable[..., Any]] = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "pow": lambda a, b: a**b,
    "neg": lambda a: -a,
    "abs": abs,
    "min": min,
    "max": max,
    "sqrt": math.sqrt,
    "exp": math.exp,
    "sin": math.sin,
    "cos": math.cos,
    "tanh": math.tanh,
    "floor": math.floor,
    "copysign": math.copysign,
    "isnan": math.isnan,
    "gt": lambda a, b: a > b,
    "ge": lambda a, b: a >= b,
    "lt": lambda a, b: a < b,
    "le": lambda a, b: a <= b,
    "eq": lambda a, b: a == b,
    "ne": lambda a, b: a != b,
    "not": lambda a: not a,
    "and": lambda a, b: a and b,
    "or": lambda a, b: a or b,
    "where": lambda c, a, b: a if c else b,
}


class Graph:
    """The nodes of one recording, each of them once."""

    def __init__(self) -> None:
        self._known: dict[tuple[Any, ...], Node] = {}

    def input(self, group: str, place: int, value: float | None = None, unset: bool = False) -> Node:
        """A column of an input: ``value`` of a parameter, ``unset`` of a state that may not have begun."""
        return self._node("input", (group, place), value, unset)

    def __call__(self, op: str, *args: Value) -> Value:
        """The result of an operation."""
        if not any(isinstance(arg, Node) for arg in args):
            return NUMBERS[op](*args)
        neutral = self._neutral(op, args)
        if neutral is not None:
            return neutral
        value: float | None = None
        if all(not isinstance(arg, Node) or arg.value is not None for arg in args) and op in NUMBERS:
            try:
                value = NUMBERS[op](*(arg.value if isinstance(arg, Node) else arg for arg in args))
            except (ArithmeticError, ValueError):  # in a branch that is not used at these parameters
                value = math.nan
        logical = op in ("isnan", "gt", "ge", "lt", "le", "eq", "ne", "not", "and", "or")
        unset = not logical and any(is_unset(arg) for arg in args)
        return self._node(op, args, value, unset)

    def parts(self, op: str, count: int, *args: Value) -> tuple[Node, ...]:
        """The results of an operation that has several."""
        node = self._node(op, args, None)
        return tuple(self._node("item", (node, k), None) for k in range(count))

    def known(self, x: Value) -> Value:
        """The same value, which is not NaN here."""
        return self._node("known", (x,), x.value) if is_unset(x) else x

    def _node(self, op: str, args: tuple[Any, ...], value: float | None, unset: bool = False) -> Node:
        key = op, unset, *(id(arg) if isinstance(arg, Node) else (type(arg), repr(arg)) for arg in args)
        return self._known.setdefault(key, Node(op, args, value, unset))

    def _neutral(self, op: str, args: tuple[Any, ...]) -> Value | None:
        """The result where one operand is neutral or decides it; None where the operation is needed."""
        a, b = args[0], args[-1]
        match op:
            case "add" if _is(a, 0.0) or _is(b, 0.0):
                return b if _is(a, 0.0) else a
            case "sub" if _is(b, 0.0) or _is(a, 0.0):
                return a if _is(b, 0.0) else self("neg", b)
            case "mul" if _is(a, 0.0) or _is(b, 0.0):
                return 0.0
            case "mul" if _is(a, 1.0) or _is(b, 1.0):
                return b if _is(a, 1.0) else a
            case "mul" if _is(a, -1.0) or _is(b, -1.0):
                return self("neg", b if _is(a, -1.0) else a)
            case "div" if _is(a, 0.0) or _is(b, 1.0):
                return 0.0 if _is(a, 0.0) else a
            case "pow" if _is(b, 2.0):
                return self("mul", a, a)
            case "neg" if a.op == "neg":
                return a.args[0]
            case "not" if a.op == "not":
                return a.args[0]
            case "min" | "max" if a is b or _is(a, math.inf if op == "min" else -math.inf):
                return b
            case "min" | "max" if _is(b, math.inf if op == "min" else -math.inf):
                return a
            case "isnan" if not a.unset:
                return False
            case "and" | "or" if isinstance(a, bool) or isinstance(b, bool):
                number, node = (a, b) if isinstance(a, bool) else (b, a)
                return node if number == (op == "and") else number
            case "eq" if is_shortcut(*args):
                return False
            case "lt" | "gt" if _is(b, -math.inf if op == "lt" else math.inf):
                return False
            case "where":
                return self._chosen(*args)
        return None

    def _chosen(self, condition: Value, a: Value, b: Value) -> Value | None:
        if not isinstance(condition, Node):
            return a if condition else b
        if _bare(a) is _bare(b) or (not isinstance(a, Node) and not isinstance(b, Node) and repr(a) == repr(b)):
            return _bare(a)
        return self("where", condition.args[0], b, a) if condition.op == "not" else None


def _is(x: Value, number: float) -> bool:
    return not isinstance(x, Node) and x == number


def is_unset(x: Value) -> bool:
    """Whether a value may be NaN."""
    return x.unset if isinstance(x, Node) else x != x


def _bare(x: Value) -> Value:
    """Without the mark that it is not NaN."""
    return x.args[0] if isinstance(x, Node) and x.op == "known" else x


def is_shortcut(a: Value, b: Value) -> bool:
    """Whether to compare these is the shortcut of an effect that is absent, which it is not here.

    The equations behind it hold for all values, and only they have derivatives at the parameter of the shortcut.
    """
    return isinstance(a, Node) and a.op == "input" and a.value is not None and not isinstance(b, Node) and a.value != b
