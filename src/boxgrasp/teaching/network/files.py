"""The network as an ONNX file with its record, and a file's weights to start from."""

from __future__ import annotations

import json
from typing import Any

import jax.numpy as jnp
import numpy as np

from boxgrasp.errors import MissingExtraError, ModelError
from boxgrasp.onnx.session import DIGEST_KEY, RECORD_KEY, digest
from boxgrasp.perception.segmentation.network import read_network
from boxgrasp.teaching.network.model import CHANNELS, INPUTS, OFFSETS, Layer, Parameters, layers

_OPSET, _IR = 18, 9  # read by every onnxruntime that the package allows
_TWICE = "twice"  # name of the factors by which a level is enlarged


def to_onnx(parameters: Parameters, record: dict[str, Any]) -> bytes:
    """The network as `perception.segmentation.network` reads it, for images of any size.

    Args:
        parameters: of `model.layers`.
        record: how it was made; written as JSON.

    Returns:
        The file's bytes.

    Raises:
        MissingExtraError: onnx is not installed.
    """
    graph = _Graph(parameters)
    x = graph.relu(graph.convolved("x"))
    kept = []
    for _ in CHANNELS:
        x = graph.block(x)
        kept.append(x)
    for beside in kept[-2::-1]:
        x = graph.block(graph.joined(x, beside))
    graph.convolved(x, "y")
    return graph.file(json.dumps(record, sort_keys=True, separators=(",", ":")))


def weights_of(data: bytes) -> Parameters:
    """The weights of a network's file, to go on from.

    Args:
        data: the file's bytes.

    Returns:
        Kernel and bias of each of `model.layers`.

    Raises:
        ModelError: damaged, or a network of another shape.
        MissingExtraError: onnx is not installed.
    """
    read_network(data)
    onnx = _library()
    model = onnx.load_from_string(data)
    numbers = {t.name: onnx.numpy_helper.to_array(t) for t in model.graph.initializer}
    used = [node.input for node in model.graph.node if node.op_type == "Conv"]
    plan = list(layers())
    found = [(numbers[i[1]].transpose(2, 3, 1, 0), numbers[i[2]]) for i in used]
    shapes = [(layer.edge, layer.edge, layer.inputs, layer.outputs) for layer in plan]
    if [kernel.shape for kernel, _ in found] != shapes:
        raise ModelError("the network has other layers than the one that is trained")
    return [(jnp.asarray(kernel), jnp.asarray(bias)) for kernel, bias in found]


class _Graph:
    """Nodes and weights of the ONNX graph, in the order of `model.layers`."""

    def __init__(self, parameters: Parameters) -> None:
        self._onnx = _library()
        self._layers = iter(zip(layers(), parameters, strict=True))
        self._nodes: list[Any] = []
        self._numbers: list[Any] = [self._tensor(np.array([1, 1, 2, 2], np.float32), _TWICE)]

    def convolved(self, x: str, output: str | None = None) -> str:
        """The next layer; its output's name."""
        layer, (kernel, bias) = next(self._layers)
        place = len(self._numbers)
        weights = np.asarray(kernel).transpose(3, 2, 0, 1)
        self._numbers.append(self._tensor(weights, f"w{place}"))
        self._numbers.append(self._tensor(np.asarray(bias), f"b{place}"))
        how = _attributes(layer)
        return self._add("Conv", x, f"w{place}", f"b{place}", output=output, **how)

    def relu(self, x: str) -> str:
        """Nothing below 0."""
        return self._add("Relu", x)

    def block(self, x: str) -> str:
        """Two layers."""
        return self.relu(self.convolved(self.relu(self.convolved(x))))

    def joined(self, below: str, beside: str) -> str:
        """A level enlarged, and the one of the same size beside it."""
        twice = self._add(
            "Resize", below, "", _TWICE,
            coordinate_transformation_mode="asymmetric", mode="nearest", nearest_mode="floor",
        )  # fmt: skip
        return self._add("Concat", twice, beside, axis=1)

    def file(self, record: str) -> bytes:
        """The whole file."""
        helper, kind = self._onnx.helper, self._onnx.TensorProto.FLOAT
        info = helper.make_tensor_value_info
        graph = helper.make_graph(
            self._nodes,
            "segmentation",
            [info("x", kind, [1, INPUTS, "height", "width"])],
            [info("y", kind, [1, 1 + len(OFFSETS), "rows", "columns"])],
            self._numbers,
        )
        opset = [helper.make_opsetid("", _OPSET)]
        model = helper.make_model(
            graph, ir_version=_IR, opset_imports=opset, producer_name="boxgrasp"
        )
        stored = model.graph.SerializeToString(deterministic=True)
        for key, value in ((RECORD_KEY, record), (DIGEST_KEY, digest(stored, record.encode()))):
            entry = model.metadata_props.add()
            entry.key, entry.value = key, value
        return bytes(model.SerializeToString(deterministic=True))

    def _tensor(self, array: Any, name: str) -> Any:
        whole = np.ascontiguousarray(array, dtype=np.float32)
        return self._onnx.numpy_helper.from_array(whole, name)

    def _add(self, operator: str, *inputs: str, output: str | None = None, **how: Any) -> str:
        name = output or f"v{len(self._nodes)}"
        self._nodes.append(self._onnx.helper.make_node(operator, inputs, [name], **how))
        return name


def _attributes(layer: Layer) -> dict[str, list[int]]:
    return {
        "kernel_shape": [layer.edge] * 2,
        "pads": [layer.pad] * 4,
        "strides": [layer.stride] * 2,
    }


def _library() -> Any:
    try:
        import onnx
        import onnx.helper
        import onnx.numpy_helper
    except ImportError:
        raise MissingExtraError(
            "training the network needs onnx; install with: pip install 'boxgrasp[network]'"
        ) from None
    return onnx
