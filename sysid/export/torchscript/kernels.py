"""The kernels of the plant, carried out on expressions of a batch (:mod:`.graph`).

The source of a kernel is read and followed statement by statement. A branch that a number decides is taken; of one that differs
between machines both sides are followed, and every variable and every number of the state that they leave is chosen by machine.
"""

from __future__ import annotations

import ast
import builtins
import functools
import math
import operator
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from sysid.effects import CATALOGUE
from sysid.export.kernel_source import definition_of, following
from sysid.export.torchscript.graph import SAFE, Graph, Node, Value, is_shortcut

#: Operators and functions of a kernel → operations.
_OPERATORS: dict[type[ast.AST], str] = {
    ast.Add: "add", ast.Sub: "sub", ast.Mult: "mul", ast.Div: "div", ast.Pow: "pow", ast.USub: "neg", ast.Not: "not",
    ast.Gt: "gt", ast.GtE: "ge", ast.Lt: "lt", ast.LtE: "le", ast.Eq: "eq", ast.NotEq: "ne", ast.And: "and", ast.Or: "or",
    ast.BitOr: "or", ast.BitAnd: "and",
}  # fmt: skip
_FUNCTIONS: dict[Any, str] = {
    abs: "abs", min: "min", max: "max", math.sqrt: "sqrt", math.exp: "exp", math.sin: "sin", math.cos: "cos",
    math.tanh: "tanh", math.copysign: "copysign", math.floor: "floor", np.floor: "floor", np.isnan: "isnan",
}  # fmt: skip
#: Operators of whole numbers, which are the same for all machines.
_WHOLE: dict[type[ast.AST], Any] = {ast.FloorDiv: operator.floordiv, ast.BitAnd: operator.and_}
_EFFECTS = {f"sysid.effects.{effect.name}": effect for effect in CATALOGUE}


class Memory:
    """Numbers that a kernel reads and writes: ``items``, with a ``width`` those of a table, row by row."""

    def __init__(self, items: Sequence[Value], width: int = 0) -> None:
        self.items, self.width = list(items), width

    def at(self, place: Any) -> int:
        return int(place[0] * self.width + place[1]) if isinstance(place, tuple) else int(place)


class Kernels:
    """Runs kernels on expressions.

    Args:
        special: kernel → what stands for it, called with these kernels and the arguments.
    """

    def __init__(self, graph: Graph, special: dict[Any, Callable[..., Any]]) -> None:
        self.graph, self.special = graph, special
        self.memories: list[Memory] = []
        self.path: Value = True

    def memory(self, items: Sequence[Value], width: int = 0) -> Memory:
        """Numbers that kernels write; all of them are made here."""
        self.memories.append(Memory(items, width))
        return self.memories[-1]

    def __call__(self, kernel: Any, *args: Any) -> Any:
        """What a kernel returns; its memories are written.

        Raises:
            SettingsError: it contains what the operations of a batch do not have.
        """
        if kernel in self.special:
            return self.special[kernel](self, *args)
        definition, names = _source(kernel)
        local = dict(zip((arg.arg for arg in definition.args.args), args, strict=True))
        before = [memory.items[:] for memory in self.memories] if _absent(kernel, definition, args) else None
        with following(
            getattr(kernel, "py_func", kernel), "arithmetic, choices, loops whose length is the same for all machines"
        ):
            found = _Body(self, names, local).run(definition.body)
        if before is not None and found is not args[0]:  # at its neutral values there is no effect, and no memory of it
            for memory, items in zip(self.memories, before, strict=True):
                memory.items = items
            return args[0]
        return found

    def safe(self, x: Value) -> Value:
        """``x`` where its branch is used: the derivative of what is not used must be finite too."""
        return self.graph("where", self.path, x, SAFE) if isinstance(self.path, Node) and isinstance(x, Node) else x

    def operation(self, op: str, *args: Value) -> Value:
        """The result of an operation on this path."""
        if op not in ("isnan", "and", "or", "not"):
            args = tuple(self.begun(arg) for arg in args)
        if op == "div" and not isinstance(args[1], Node) and args[1] == 0.0:
            return math.nan  # as the kernels: no error
        if op == "div":
            args = args[0], self.safe(args[1])
        if op in ("sqrt", "pow"):
            args = self.safe(args[0]), *args[1:]
        return self.graph(op, *args)

    def begun(self, x: Value) -> Value:
        """``x``, which has begun where its branch is used: the derivative with NaN would be NaN beyond that."""
        if not isinstance(self.path, Node):
            return x
        if isinstance(x, Node):
            return self.graph.known(x)
        return SAFE if x != x else x


@functools.cache
def _source(kernel: Any) -> tuple[ast.FunctionDef, dict[str, Any]]:
    """Definition of a kernel, and the names of its module."""
    return definition_of(kernel), getattr(kernel, "py_func", kernel).__globals__


def _absent(kernel: Any, definition: ast.FunctionDef, args: tuple[Any, ...]) -> bool:
    """Whether this is the step of an effect at its neutral values."""
    effect = _EFFECTS.get(kernel.__module__)
    if effect is None or definition.name != "step" or definition.args.args[1].arg != "p":
        return False
    values = args[1].items[args[2] : args[2] + len(effect.slots)]
    return all(not isinstance(x, Node) and x == slot.neutral for x, slot in zip(values, effect.slots, strict=True))


_END = object()


class _Body:
    """One call: its variables, and the statements that are followed."""

    def __init__(self, kernels: Kernels, names: dict[str, Any], local: dict[str, Any]) -> None:
        self.kernels, self.names, self.local, self.nested = kernels, names, local, 0

    def run(self, statements: list[ast.stmt]) -> Any:
        found = self.block(statements)
        return None if found is _END else found

    def block(self, statements: list[ast.stmt]) -> Any:
        """The value that is returned, or ``_END``; ``break`` and ``continue`` as their nodes."""
        for k, statement in enumerate(statements):
            match statement:
                case ast.Return(value=value):
                    return None if value is None else self.value(value)
                case ast.Break() | ast.Continue():
                    return statement
                case ast.If():
                    test = self.value(statement.test)
                    if isinstance(test, Node) and test.op == "ne" and is_shortcut(*test.args):
                        test = True
                    if isinstance(test, Node):
                        returns = any(isinstance(inner, ast.Return) for inner in ast.walk(statement))
                        rest = statements[k + 1 :] if returns else []
                        found = self.both(test, statement.body + rest, statement.orelse + rest)
                        if returns:
                            return found
                    else:
                        self.nested += 1
                        found = self.block(statement.body if test else statement.orelse)
                        self.nested -= 1
                    if found is not _END:
                        return found
                case ast.For():
                    self.nested += 1
                    for item in self.value(statement.iter):
                        self.assign(statement.target, item)
                        found = self.block(statement.body)
                        if isinstance(found, ast.Break):
                            break
                        if found is not _END and not isinstance(found, ast.Continue):
                            return found
                    self.nested -= 1
                case ast.Assign(targets=[target], value=value):
                    self.assign(target, self.value(value))
                case ast.AugAssign(target=target, op=op, value=value):
                    self.assign(target, self.operation(op, self.value(target), self.value(value)))
                case ast.Expr(value=value):
                    self.value(value)
                case _:
                    raise NotImplementedError(ast.unparse(statement))
        return _END

    def both(self, test: Node, body: list[ast.stmt], other: list[ast.stmt]) -> Any:
        """Follow both sides and choose by machine what they leave."""
        graph, kernels = self.kernels.graph, self.kernels
        path, local, nested, kept = kernels.path, self.local, self.nested, [memory.items for memory in kernels.memories]
        ends, variables, items = [], [], []
        for side, statements in ((test, body), (graph("not", test), other)):
            kernels.path = graph("and", path, side)
            self.local, self.nested = dict(local), nested
            for memory, values in zip(kernels.memories, kept, strict=True):
                memory.items = values[:]
            self.mark(side)
            ends.append(self.block(statements))
            variables.append(self.local)
            items.append([memory.items for memory in kernels.memories])
        kernels.path, self.nested = path, nested
        shared = [name for name in variables[0] if name in variables[1]]
        self.local = {name: self.chosen(test, variables[0][name], variables[1][name]) for name in shared}
        for memory, *sides in zip(kernels.memories, *items, strict=True):
            memory.items = [self.chosen(test, a, b) for a, b in zip(*sides, strict=True)]
        return self.chosen(test, *ends)

    def mark(self, side: Value) -> None:
        """Mark what this side of a branch knows not to be NaN."""
        graph = self.kernels.graph
        if isinstance(side, Node) and side.op == "not" and side.args[0].op in ("isnan", "or"):
            inner = side.args[0]
            if inner.op == "or":
                for part in inner.args:
                    self.mark(graph("not", part))
                return
            x = inner.args[0]
            for memory in self.kernels.memories:
                memory.items = [graph.known(item) if item is x else item for item in memory.items]
            self.local = {name: graph.known(item) if item is x else item for name, item in self.local.items()}

    def chosen(self, test: Node, a: Any, b: Any) -> Any:
        if a is b or ({a, b} == {None, _END} and not self.nested):
            return None if b is None else a
        if isinstance(a, tuple) and isinstance(b, tuple):
            return tuple(self.chosen(test, x, y) for x, y in zip(a, b, strict=True))
        if not isinstance(a, (Node, float, int)) or not isinstance(b, (Node, float, int)):
            raise NotImplementedError("a branch by machine that ends a kernel or a loop on one side alone")
        return self.kernels.graph("where", test, a, b)

    def assign(self, target: ast.expr, value: Any) -> None:
        match target:
            case ast.Name(id=name):
                self.local[name] = value
            case ast.Tuple(elts=parts):
                for part, item in zip(parts, value, strict=True):
                    self.assign(part, item)
            case ast.Subscript():
                memory = self.value(target.value)
                memory.items[memory.at(self.value(target.slice))] = value
            case _:
                raise NotImplementedError(ast.unparse(target))

    def operation(self, op: ast.AST, *args: Value) -> Value:
        if type(op) in _WHOLE and not isinstance(args[0], (bool, Node)):
            return _WHOLE[type(op)](*args)
        if type(op) not in _OPERATORS:
            raise NotImplementedError(f"the operator {type(op).__name__}")
        return self.kernels.operation(_OPERATORS[type(op)], *args)

    def value(self, expression: ast.expr) -> Any:
        match expression:
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name):
                if name in self.local:
                    return self.local[name]
                return self.names[name] if name in self.names else getattr(builtins, name)
            case ast.Attribute(value=owner, attr=name):
                return getattr(self.value(owner), name)
            case ast.Tuple(elts=parts):
                return tuple(self.value(part) for part in parts)
            case ast.Subscript(value=owner, slice=place):
                found, at = self.value(owner), self.value(place)
                return found.items[found.at(at)] if isinstance(found, Memory) else _number(found[at])
            case ast.UnaryOp(op=op, operand=operand):
                return self.operation(op, self.value(operand))
            case ast.BinOp(left=left, op=op, right=right):
                return self.operation(op, self.value(left), self.value(right))
            case ast.Compare(left=left, ops=ops, comparators=others):
                return self.compared(self.value(left), ops, others)
            case ast.BoolOp(op=op, values=parts):
                return self.logical(isinstance(op, ast.And), parts)
            case ast.IfExp(test=test, body=body, orelse=other):
                condition = self.value(test)
                if not isinstance(condition, Node):
                    return self.value(body if condition else other)
                return self.both(condition, [ast.Return(body)], [ast.Return(other)])
            case ast.Call(func=function, args=args):
                return self.called(self.value(function), [self.value(arg) for arg in args])
        raise NotImplementedError(ast.unparse(expression))

    def compared(self, left: Any, ops: list[ast.cmpop], others: list[ast.expr]) -> Any:
        if isinstance(ops[0], (ast.Is, ast.IsNot)):
            return (left is self.value(others[0])) == isinstance(ops[0], ast.Is)
        found: Value = True
        for op, other in zip(ops, others, strict=True):
            right = self.value(other)
            found = self.kernels.graph("and", found, self.operation(op, left, right))
            left = right
        return found

    def logical(self, every: bool, parts: list[ast.expr]) -> Any:
        found: Value = every
        for part in parts:
            found = self.kernels.graph("and" if every else "or", found, self.value(part))
            if not isinstance(found, Node) and bool(found) != every:
                break
        return found

    def called(self, function: Any, args: list[Any]) -> Any:
        if function is math.ceil:  # a number of sub-steps is that of the plant's own values
            number = args[0].value if isinstance(args[0], Node) else args[0]
            if number is None:
                raise NotImplementedError("a number of sub-steps that does not follow from the parameters alone")
            return math.ceil(number)
        if function is len:
            return len(args[0].items) if isinstance(args[0], Memory) else len(args[0])
        if function in (min, max):
            return functools.reduce(lambda a, b: self.kernels.operation(_FUNCTIONS[function], a, b), args)
        if function in _FUNCTIONS:
            return self.kernels.operation(_FUNCTIONS[function], *args)
        if hasattr(function, "py_func"):
            return self.kernels(function, *args)
        if any(isinstance(arg, Node) for arg in args):
            raise NotImplementedError(f"the function {function.__name__}")
        return function(*args)


def _number(x: Any) -> Any:
    return x.item() if isinstance(x, np.generic) else x
