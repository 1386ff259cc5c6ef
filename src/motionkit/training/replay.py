"""Runs a function of tensors with fixed shapes as a CUDA graph.

The network is small, so on a GPU most of a step is spent on launching two thousand kernels one by one. A graph launches
them at once. On a CPU the function is simply called.
"""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import Tensor, cuda

Work = Callable[..., tuple[Tensor, ...]]
WARM_UP = 3  # calls before the capture, so that libraries have chosen their kernels


class Replayed:
    """A function of tensors that a GPU replays as a graph; the next call overwrites its results.

    The function must launch the same kernels at every call, so it must not read values of tensors in Python. Gradients
    stay in the same memory, so it should set them to None at its beginning.

    Graphs that run at the same time need a stream of their own each, current at their first call: graphs captured on
    one stream share the memory in which cuBLAS adds up its products.

    Args:
        state: returns the tensors that the function changes, such as weights. Calls before the capture do not count:
            these tensors get their values back, and those that are made meanwhile become zero.
    """

    def __init__(self, work: Work, state: Callable[[], list[Tensor]] = list) -> None:
        self.work, self.state = work, state
        self._graph: cuda.CUDAGraph | None = None
        self._stream: cuda.Stream | None = None
        self._inputs: list[Tensor] = []
        self._outputs: tuple[Tensor, ...] = ()

    def __call__(self, *inputs: Tensor) -> tuple[Tensor, ...]:
        if not _has_graphs(inputs[0]):
            return self.work(*inputs)
        if self._graph is None or [x.shape for x in inputs] != [x.shape for x in self._inputs]:
            self._capture(inputs)
        assert self._graph is not None
        for static, fresh in zip(self._inputs, inputs, strict=True):
            static.copy_(fresh, non_blocking=True)
        self._graph.replay()
        return self._outputs

    def _capture(self, inputs: tuple[Tensor, ...]) -> None:
        device = inputs[0].device
        # The warm-up must not change the random state: a resumed run captures again and must draw the same numbers.
        random_state = cuda.get_rng_state(device)
        before = {id(x): x.detach().clone() for x in self.state()}
        self._inputs = [x.detach().clone() for x in inputs]
        current = cuda.current_stream(device)
        # The default stream cannot be captured.
        self._stream = cuda.Stream(device) if current == cuda.default_stream(device) else current
        self._stream.wait_stream(current)
        with cuda.stream(self._stream):
            for _ in range(WARM_UP):
                self.work(*self._inputs)
        current.wait_stream(self._stream)
        cuda.set_rng_state(random_state, device)
        with torch.no_grad():
            for x in self.state():
                x.copy_(before[id(x)]) if id(x) in before else x.zero_()
        self._graph = cuda.CUDAGraph()
        # Other threads may go on, such as the one that pins the memory of coming windows.
        with cuda.graph(self._graph, stream=self._stream, capture_error_mode="thread_local"):
            self._outputs = self.work(*self._inputs)


def _has_graphs(x: Tensor) -> bool:
    return x.device.type == "cuda"
