"""Builds ONNX graphs: nodes and constants in the order of calls."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from motionkit.errors import MotionkitError

if TYPE_CHECKING:
    from onnx import ModelProto, NodeProto, TensorProto

OPSET = 17


def _onnx() -> Any:
    try:
        import onnx
    except ImportError:
        raise MotionkitError("ONNX export needs the onnx package: pip install 'motionkit[onnx]'") from None
    return onnx


class Graph:
    """A graph of standard operators, in float32 unless stated otherwise."""

    def __init__(self) -> None:
        self.onnx = _onnx()
        self.nodes: list[NodeProto] = []
        self.constants: dict[str, TensorProto] = {}

    def constant(self, values: Any, dtype: Any = np.float32) -> str:
        """Add a constant and return its name; equal small constants are stored once."""
        array = np.array(values, dtype, order="C")
        for known, tensor in self.constants.items():
            if array.size < 64 and tensor.raw_data == array.tobytes() and tuple(tensor.dims) == array.shape:
                if tensor.data_type == self.onnx.helper.np_dtype_to_tensor_dtype(array.dtype):
                    return known
        name = f"c{len(self.constants)}"
        self.constants[name] = self.onnx.numpy_helper.from_array(array, name)
        return name

    def add(self, kind: str, *inputs: Any, out: str | None = None, **attributes: Any) -> str:
        """Add a node with one output and return its name. Arrays and numbers become constants."""
        return self._node(kind, inputs, [out or f"n{len(self.nodes)}"], attributes)[0]

    def split(self, value: str, sizes: list[int], axis: int) -> list[str]:
        """Split a value along an axis into pieces of these sizes; returns their names."""
        outs = [f"n{len(self.nodes)}_{i}" for i in range(len(sizes))]
        return self._node("Split", (value, self.constant(sizes, np.int64)), outs, {"axis": axis})

    def reshape(self, value: str, *shape: int, out: str | None = None) -> str:
        """Reshape a value; returns its name."""
        return self.add("Reshape", value, self.constant(shape, np.int64), out=out)

    def gather(self, value: Any, indices: Any, axis: int) -> str:
        """Gather these indices along an axis, where the result has the shape of the indices; returns its name."""
        at = indices if isinstance(indices, str) else self.constant(indices, np.int64)
        return self.add("Gather", value, at, axis=axis)

    def _node(self, kind: str, inputs: Any, outs: list[str], attributes: dict[str, Any]) -> list[str]:
        names = [i if isinstance(i, str) else self.constant(i) for i in inputs]
        self.nodes.append(self.onnx.helper.make_node(kind, names, outs, **attributes))
        return outs

    def model(
        self,
        inputs: dict[str, tuple[int, ...]],
        outputs: dict[str, tuple[int, ...]],
        version: str,
        properties: dict[str, str],
    ) -> ModelProto:
        """The checked model, with names and shapes of inputs and outputs."""
        helper, kinds = self.onnx.helper, self.onnx.TensorProto

        def described(shapes: dict[str, tuple[int, ...]]) -> list:
            return [helper.make_tensor_value_info(name, kinds.FLOAT, shape) for name, shape in shapes.items()]

        graph = helper.make_graph(
            self.nodes, "motionkit", described(inputs), described(outputs), list(self.constants.values())
        )
        proto = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="motionkit", ir_version=8
        )
        proto.producer_version = version
        helper.set_model_props(proto, properties)
        self.onnx.checker.check_model(proto)
        return proto
