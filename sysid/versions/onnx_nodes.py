"""Nodes and constants of an ONNX graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt


class Nodes:
    """Nodes and constants in the order of their addition; values are referred to by name.

    Args:
        dtype: of all numbers.
    """

    def __init__(self, dtype: type[np.float32] | type[np.float64]) -> None:
        self.dtype = dtype
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def add(self, operator: str, *inputs: str, output: str = "", **attributes: Any) -> str:
        """One node; returns the name of its output."""
        from onnx import helper

        name = output or f"{operator.lower()}_{len(self.nodes)}"
        self.nodes.append(helper.make_node(operator, list(inputs), [name], name=f"node_{len(self.nodes)}", **attributes))
        return name

    def constant(self, values: npt.ArrayLike, whole: bool = False) -> str:
        """A constant of the graph's type, or of whole numbers."""
        from onnx import numpy_helper

        name = f"constant_{len(self.constants)}"
        array = np.asarray(values, dtype=np.int64 if whole else self.dtype)
        self.constants.append(numpy_helper.from_array(array, name))
        return name

    def columns(self, value: str, which: Sequence[int]) -> str:
        return self.add("Gather", value, self.constant(list(which), whole=True), axis=1)
