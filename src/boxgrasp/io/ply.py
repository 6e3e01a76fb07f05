"""PLY clouds: the vertices' x, y, z and colors.

Read here with numpy: plyfile is GPL, and trimesh takes 5 GB for ten million points as text.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.errors import CaptureError
from boxgrasp.io.extent import header_lines, remaining_bytes, validate_cloud_size
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.validation import CloudFrame

_TYPES: Final = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_FORMATS: Final = {"ascii": "=", "binary_little_endian": "<", "binary_big_endian": ">"}
_COLORS: Final = (("red", "green", "blue"), ("r", "g", "b"))


@dataclass(frozen=True)
class _Element:
    """What stands in the header: `element NAME COUNT`, then its properties (name, type)."""

    name: str
    count: int
    properties: tuple[tuple[str, str], ...]
    has_list: bool


def load_ply(path: Path, cloud_frame: CloudFrame) -> Capture:
    """A capture of a PLY file's vertices; faces and all else are passed over.

    Args:
        path: of a .ply.
        cloud_frame: 'optical' or 'base', of the points.

    Returns:
        The capture.

    Raises:
        CaptureError: damaged, truncated, no x y z, or no usable cloud.
    """
    with path.open("rb") as stream:
        encoding, elements = _read_header(stream)
        before, vertex = _find_vertex(elements)
        names = [name for name, _ in vertex.properties]
        wanted = next((c for c in _COLORS if all(name in names for name in c)), ())
        columns: Mapping[str, NDArray[Any]] | NDArray[np.void]
        if encoding == "ascii":
            columns = _read_ascii(stream, before, vertex, ("x", "y", "z", *wanted))
        else:
            columns = _read_binary(stream, before, vertex, _FORMATS[encoding])
    with np.errstate(over="ignore"):
        xyz = np.stack([columns[axis] for axis in "xyz"], axis=1).astype(np.float32)
    colors = _colors([columns[name] for name in wanted], dict(vertex.properties))
    return Capture.from_cloud(xyz, cloud_frame=cloud_frame, colors=colors)


def _read_header(stream: IO[bytes]) -> tuple[str, list[_Element]]:
    lines = [line.split() for line in header_lines(stream, "end_header")]
    if lines[0] != ["ply"]:
        raise CaptureError("file does not start with 'ply'; valid: PLY 1.0")
    encoding, elements = "", list[_Element]()
    for words in lines[1:-1]:
        match words:
            case ["format", found, "1.0"] if found in _FORMATS:
                encoding = found
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count), (), False))
            case ["property", "list", _, _, _] if elements:
                last = elements[-1]
                elements[-1] = _Element(last.name, last.count, last.properties, True)
            case ["property", kind, name] if elements and kind in _TYPES:
                last = elements[-1]
                properties = (*last.properties, (name, _TYPES[kind]))
                elements[-1] = _Element(last.name, last.count, properties, last.has_list)
            case [] | ["comment" | "obj_info", *_]:
                pass
            case _:
                raise CaptureError(f"PLY header has {' '.join(words)!r:.60}; valid: PLY 1.0")
    if not encoding:
        raise CaptureError(f"PLY header has no format; valid: {', '.join(_FORMATS)}")
    return encoding, elements


def _find_vertex(elements: list[_Element]) -> tuple[list[_Element], _Element]:
    """The elements before the vertices, and the vertices."""
    place = next((i for i, element in enumerate(elements) if element.name == "vertex"), None)
    if place is None:
        raise CaptureError("PLY has no element vertex; valid: vertices with x y z")
    before, vertex = elements[:place], elements[place]
    if vertex.has_list or any(element.has_list for element in before):
        raise CaptureError("PLY has a list in or before its vertices; valid: vertices first")
    names = [name for name, _ in vertex.properties]
    if any(names.count(axis) != 1 for axis in "xyz") or len(set(names)) != len(names):
        raise CaptureError(f"PLY vertices have {' '.join(names)!r:.60}; valid: x y z, once each")
    kinds = dict(vertex.properties)
    if any(kinds[axis][0] != "f" for axis in "xyz"):
        raise CaptureError("PLY vertices are whole numbers; valid: float meters")
    return before, vertex


def _read_binary(
    stream: IO[bytes], before: list[_Element], vertex: _Element, order: str
) -> NDArray[np.void]:
    skipped = sum(e.count * sum(int(kind[1]) for _, kind in e.properties) for e in before)
    dtype = np.dtype([(name, order + kind) for name, kind in vertex.properties])
    there = remaining_bytes(stream) - skipped
    validate_cloud_size(vertex.count, vertex.count * dtype.itemsize, there)
    stream.seek(skipped, 1)
    return np.frombuffer(stream.read(vertex.count * dtype.itemsize), dtype)


def _read_ascii(
    stream: IO[bytes], before: list[_Element], vertex: _Element, wanted: tuple[str, ...]
) -> dict[str, NDArray[Any]]:
    names = [name for name, _ in vertex.properties]
    validate_cloud_size(vertex.count, 2 * len(names) * vertex.count - 1, remaining_bytes(stream))
    for element in before:
        if element.count > remaining_bytes(stream):
            raise CaptureError(f"PLY claims {element.count} of {element.name}; truncated")
        for _ in range(element.count):
            stream.readline()
    columns = [names.index(name) for name in wanted]
    # float32 holds coordinates and colors alike, in half the memory
    values = np.loadtxt(
        stream, np.float32, comments=None, usecols=columns, max_rows=vertex.count, ndmin=2
    )
    if len(values) != vertex.count:
        raise CaptureError(f"PLY has {len(values)} of the {vertex.count} vertices its header says")
    return dict(zip(wanted, values.T, strict=True))


def _colors(channels: list[NDArray[Any]], kinds: dict[str, str]) -> NDArray[np.uint8] | None:
    """(N, 3) uint8 of bytes, or of floats in 0 to 1; other types say too little, so None."""
    if not channels:
        return None
    kind = kinds.get("red", kinds.get("r", ""))
    stacked = np.stack(channels, axis=1)
    if kind in ("u1", "i1"):
        return (stacked.astype(np.int16) & 0xFF).astype(np.uint8)
    if kind in ("f4", "f8"):
        unit = np.nan_to_num(stacked.astype(np.float32)).clip(0.0, 1.0)
        return np.round(unit * 255).astype(np.uint8)
    return None
