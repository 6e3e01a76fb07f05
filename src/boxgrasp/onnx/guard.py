"""What an ONNX file holds, told from its bytes before any library is let near it.

Only plain arithmetic on numbers inside the file passes: the operators that the caller names. No
file beside it is opened, no custom operator, function, loop or branch is accepted.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass

from boxgrasp.errors import ModelError

# Field numbers of onnx.proto that may occur, message by message.
_MODEL = {"ir_version": 1, "opset": 8, "producer": 2, "producer_version": 3, "metadata": 14}
_GRAPH = 7
_NODE, _INITIALIZER = 1, 5
_GRAPH_FIELDS = frozenset((_NODE, 2, _INITIALIZER, 11, 12))
_OP_TYPE, _DOMAIN, _ATTRIBUTE = 4, 7, 5
_NODE_FIELDS = frozenset((1, 2, 3, _OP_TYPE, _ATTRIBUTE))
_ATTRIBUTE_FIELDS = frozenset((1, 3, 4, 8, 20))  # name, one integer, text, integers, type
_TENSOR_FIELDS = frozenset((1, 2, 8, 9))  # dims, type, name, raw bytes
_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5


@dataclass(frozen=True)
class OnnxFile:
    """The parts of an ONNX file that a record stands in.

    Attributes:
        metadata: the file's own key and value pairs.
        graph: its graph as it is stored.
    """

    metadata: dict[str, bytes]
    graph: bytes


def parse(data: bytes) -> OnnxFile:
    """Take an ONNX file apart.

    Args:
        data: its bytes.

    Returns:
        Metadata and graph.

    Raises:
        ModelError: not an ONNX file.
    """
    metadata: dict[str, bytes] = {}
    graphs = []
    for number, value in _fields(data):
        if number == _GRAPH and isinstance(value, bytes):
            graphs.append(value)
        elif number == _MODEL["metadata"] and isinstance(value, bytes):
            pair = dict(_fields(value))
            key, text = pair.get(1), pair.get(2)
            if not isinstance(key, bytes) or not isinstance(text, bytes):
                raise ModelError("not an ONNX file")
            metadata[key.decode("utf-8", "replace")] = text
    if len(graphs) != 1:
        raise ModelError("not an ONNX file")
    return OnnxFile(metadata, graphs[0])


def validate_plain(data: bytes, operators: Collection[str]) -> None:
    """Refuse whatever is more than arithmetic on numbers that are in the file.

    Args:
        data: the bytes of an ONNX file.
        operators: names of the standard set that it may hold.

    Raises:
        ModelError: external data, foreign operators, functions, branches, anything unknown.
    """
    allowed = {*_MODEL.values(), _GRAPH}
    for number, value in _fields(data):
        if number not in allowed:
            raise ModelError(f"the model holds ONNX field {number}; valid: a graph and its record")
        if number == _MODEL["opset"] and any(
            key == 1 and name not in (b"", b"ai.onnx") for key, name in _fields(_inner(value))
        ):
            raise ModelError("the model needs custom operators; valid: the standard ones")
        if number == _GRAPH:
            _validate_graph(_inner(value), operators)


def _validate_graph(graph: bytes, operators: Collection[str]) -> None:
    for number, value in _fields(graph):
        if number not in _GRAPH_FIELDS:
            raise ModelError(f"the model's graph holds ONNX field {number}; valid: nodes, numbers")
        if number == _NODE:
            _validate_node(_inner(value), operators)
        elif number == _INITIALIZER:
            if any(key not in _TENSOR_FIELDS for key, _ in _fields(_inner(value))):
                raise ModelError("the model keeps numbers outside of it; valid: all in one file")


def _validate_node(node: bytes, operators: Collection[str]) -> None:
    for key, value in _fields(node):
        if key == _OP_TYPE:
            name = _inner(value).decode("utf-8", "replace")
            if name not in operators:
                raise ModelError(f"the model holds the operator {name!r}; valid: plain arithmetic")
        elif key == _ATTRIBUTE:
            if any(field not in _ATTRIBUTE_FIELDS for field, _ in _fields(_inner(value))):
                raise ModelError("the model holds a graph in a node; valid: plain arithmetic")
        elif key == _DOMAIN or key not in _NODE_FIELDS:
            raise ModelError("the model needs custom operators; valid: the standard ones")


def _inner(value: int | bytes) -> bytes:
    if not isinstance(value, bytes):
        raise ModelError("not an ONNX file")
    return value


def _fields(data: bytes) -> Iterator[tuple[int, int | bytes]]:
    """(field number, value) of one protobuf message."""
    at = 0
    while at < len(data):
        tag, at = _varint(data, at)
        number, kind = tag >> 3, tag & 7
        value: int | bytes
        if kind == _VARINT:
            value, at = _varint(data, at)
        elif kind in (_FIXED64, _FIXED32):
            size = 8 if kind == _FIXED64 else 4
            value, at = data[at : at + size], at + size
        elif kind == _BYTES:
            size, at = _varint(data, at)
            value, at = data[at : at + size], at + size
        else:
            raise ModelError("not an ONNX file")
        if at > len(data) or number == 0:
            raise ModelError("not an ONNX file, or cut short")
        yield number, value


def _varint(data: bytes, at: int) -> tuple[int, int]:
    value = 0
    for shift in range(0, 70, 7):
        if at >= len(data):
            raise ModelError("not an ONNX file, or cut short")
        byte = data[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
    raise ModelError("not an ONNX file")
