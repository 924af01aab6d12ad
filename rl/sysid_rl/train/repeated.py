"""Work that is repeated on the same tensors: on a GPU, one launch of a CUDA graph instead of one for each kernel.

An update of small networks has about a hundred kernels of a few microseconds each, less than a launch costs the CPU. Source:
PyTorch documentation, *CUDA graphs*.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import torch

#: Calls before the capture: libraries initialise themselves, and buffers are allocated.
WARM_UP = 3


class Repeated:
    """A function without arguments and results that works on the same tensors in each call.

    Args:
        work: neither waits for the device nor reads values from it.
        device: on CUDA, calls after the first few replay a graph of it; elsewhere ``work`` is called.
    """

    def __init__(self, work: Callable[[], None], device: torch.device) -> None:
        self._work, self._device = work, device
        self._calls = 0
        self._graph: torch.cuda.CUDAGraph | None = None

    def __call__(self) -> None:
        if self._device.type != "cuda":
            self._work()
            return
        if self._graph is None and self._calls == WARM_UP:
            self._capture()
        if self._graph is not None:
            self._graph.replay()
        else:
            self._work()
        self._calls += 1

    def _capture(self) -> None:
        import torch

        torch.cuda.synchronize(self._device)
        graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(graph):  # records the work and does not execute it
            self._work()
        self._graph = graph
