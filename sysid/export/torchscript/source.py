"""Expressions of a batch → TorchScript: a function is a list of operations on columns (N,), without a loop or a branch.

No text of a file is in it: columns, tables and results have numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from sysid.export.torchscript.graph import SAFE, Node, Value

_INFIX = {
    "add": "+", "sub": "-", "mul": "*", "div": "/", "pow": "**", "gt": ">", "ge": ">=", "lt": "<", "le": "<=", "eq": "==",
    "ne": "!=", "and": "&", "or": "|",
}  # fmt: skip
_PREFIX = {"neg": "-", "not": "~"}
_LIMITS = {"min": ("torch.minimum", "max"), "max": ("torch.maximum", "min")}


@dataclass(frozen=True)
class Function:
    """A function of the module.

    Args:
        inputs: names of its arguments (N, k) each; a node ``input`` names one of them and its column.
        results: the columns of each tensor that it returns; a column may be a block of its own, of the width in ``blocks``.
    """

    name: str
    inputs: tuple[str, ...]
    results: tuple[Sequence[Value], ...]


def source(function: Function, columns: Mapping[str, Mapping[int, int]], blocks: Mapping[int, tuple[int, int]]) -> str:
    """The text of a method.

    Args:
        columns: input → place of a node → its column, where that is another one.
        blocks: place of a block of the input ``state`` → its first column and the one behind its last.
    """
    writer = _Writer(columns, blocks)
    lines = [f"{name}_ = {name}.unbind(1)" for name in function.inputs]
    lines.append("one = torch.ones_like(theta[:, 0])")
    lines += writer.lines(node for result in function.results for node in result if isinstance(node, Node))
    returned = [writer.joined(result) for result in function.results]
    kinds = ", ".join(["Tensor"] * len(returned))
    head = ", ".join(f"{name}: Tensor" for name in function.inputs)
    answer = f"Tuple[{kinds}]" if len(returned) > 1 else "Tensor"
    body = "\n    ".join([*lines, f"return {', '.join(returned)}"])
    return f"def {function.name}(self, {head}) -> {answer}:\n    {body}\n"


class _Writer:
    """Names of the nodes of one function."""

    def __init__(self, columns: Mapping[str, Mapping[int, int]], blocks: Mapping[int, tuple[int, int]]) -> None:
        self.columns, self.blocks = columns, blocks
        self.names: dict[Node, str] = {}

    def lines(self, wanted: Iterable[Node]) -> list[str]:
        """An assignment for each operation, in an order in which they can be carried out."""
        found: list[str] = []
        stack = list(reversed(list(wanted)))
        while stack:
            node = stack[-1]
            open_args = [arg for arg in node.args if isinstance(arg, Node) and arg not in self.names]
            if node in self.names or not open_args:
                stack.pop()
                if node not in self.names:
                    text = self.text(node)
                    self.names[node] = text if node.op == "input" else f"x{len(found)}"
                    found += [] if node.op == "input" else [f"x{len(found)} = {text}"]
            else:
                stack += open_args
        return found

    def text(self, node: Node) -> str:
        op, args = node.op, node.args
        if op == "input":
            group, place = args
            if group == "state" and place in self.blocks:
                first, last = self.blocks[place]
                return f"state[:, {first}:{last}]"
            return f"{group}_[{self.columns.get(group, {}).get(place, place)}]"
        if op == "known":
            x = self.names[args[0]]
            return f"torch.where(torch.isnan({x}), {SAFE}, {x})"
        if op in _INFIX:
            return f"{self.of(args[0])} {_INFIX[op]} {self.of(args[1])}"
        if op in _PREFIX:
            return f"{_PREFIX[op]}{self.of(args[0])}"
        if op in _LIMITS:
            both, clamp = _LIMITS[op]
            node_, limit = args if isinstance(args[0], Node) else args[::-1]
            return f"{both}({self.of(node_)}, {self.of(limit)})" if isinstance(limit, Node) else (
                f"torch.clamp({self.of(node_)}, {clamp}={self.of(limit)})"
            )  # fmt: skip
        if op == "where":
            numbers = not isinstance(args[1], Node) and not isinstance(args[2], Node)
            return f"torch.where({self.of(args[0])}, {(self.column if numbers else self.of)(args[1])}, {self.of(args[2])})"
        if op == "copysign":
            return f"torch.copysign({self.column(args[0])}, {self.of(args[1])})"
        if op == "item":
            return f"{self.of(args[0])}[{args[1]}]"
        if op in ("looked_up", "displaced"):
            x, table, *rest = args
            return f"{op}({self.of(x)}, self.table{table}, {', '.join(map(self.of, rest))})"
        if op == "filled":
            return f"{self.of(args[0])} * one[:, None].repeat(1, {args[1]})"
        if op == "delayed":
            return f"delayed({', '.join(map(self.of, args))})"
        return f"torch.{op}({', '.join(map(self.of, args))})"

    def of(self, x: Value) -> str:
        if isinstance(x, Node):
            return self.names[x]
        if isinstance(x, bool):
            return repr(x)
        return repr(float(x)) if math.isfinite(x) else f"float('{float(x)}')"

    def column(self, x: Value) -> str:
        return self.names[x] if isinstance(x, Node) else f"{self.of(x)} * one"

    def joined(self, result: Sequence[Value]) -> str:
        """Columns, and behind them blocks of columns, as one tensor."""
        blocks = [x for x in result if self.is_block(x)]
        columns = ", ".join(self.column(x) for x in result if not self.is_block(x))
        found = f"torch.stack([{columns}], dim=1)"
        return f"torch.cat([{', '.join([found, *map(self.of, blocks)])}], dim=1)" if blocks else found

    def is_block(self, x: Value) -> bool:
        if not isinstance(x, Node) or x.op not in ("item", "input", "filled"):
            return False
        if x.op == "filled":
            return True
        return x.args == (x.args[0], 3) if x.op == "item" else x.args[0] == "state" and x.args[1] in self.blocks


def looked_up(x: Tensor, table: Tensor, low: float, step: float) -> Tensor:
    """Linear interpolation in an even table (points,), extended along its end slopes: :func:`sysid.plant.chain.look_up`."""
    t = (x - low) / step
    k = torch.clamp(torch.floor(t), 0.0, float(table.shape[0] - 2))
    left = table[k.to(torch.int64)]
    return left + (t - k) * (table[k.to(torch.int64) + 1] - left)


def displaced(y: Tensor, table: Tensor, low: float, step: float) -> Tensor:
    """The inverse, inside the table."""
    rising = torch.sign(table[-1] - table[0])
    rows = (rising * table).contiguous()
    k = torch.clamp(torch.searchsorted(rows, (rising * y).contiguous(), right=True) - 1, 0, table.shape[0] - 2)
    share = (rising * y - rows[k]) / (rows[k + 1] - rows[k])
    return low + step * (k + torch.clamp(share, 0.0, 1.0))


def delayed(u: Tensor, delay: Tensor, past: Tensor, dt: float, new: bool) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """The two inputs that act in a step, the later first, the share in which the earlier one acts, and the inputs (N, k).

    :func:`sysid.effects.input_delay.ends` with the newest input first. ``new``: the past may be NaN: held for a long time.
    """
    samples = torch.clamp(delay / dt, 0.0, float(past.shape[1] - 1))
    whole = torch.clamp(torch.floor(samples), max=float(past.shape[1] - 2))
    if new:
        past = torch.where(torch.isnan(past), u[:, None], past)
    past = torch.cat([u[:, None], past[:, :-1]], dim=1)
    index = whole.to(torch.int64)[:, None]
    return past.gather(1, index)[:, 0], past.gather(1, index + 1)[:, 0], samples - whole, past


_jit: Any = torch.jit


def module(texts: Sequence[str], tables: Mapping[int, Tensor]) -> Any:
    """A script with these methods and the buffers ``table0`` …."""

    class Functions(_jit.ScriptModule):  # type: ignore[misc]
        """A type of its own, whose methods are those of one plant."""

        def __init__(self) -> None:
            super().__init__()
            for k, table in tables.items():
                self.register_buffer(f"table{k}", table)
            for text in texts:
                self.define(text)

    return Functions()
