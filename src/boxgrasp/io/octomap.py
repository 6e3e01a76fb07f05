"""OctoMap files: .bt (two bits a cell) and .ot (log-odds), read and written.

Reading is our own and takes any bytes: octomap-python gives half a map for a truncated file, with
no error, and ends the process on a tree that is too deep. Writing goes through octomap-python.
"""

from __future__ import annotations

import array
import importlib
import math
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats
from boxgrasp.errors import CaptureError, MapError, MissingExtraError
from boxgrasp.geometry.transforms import invert
from boxgrasp.io.fields import bytes_of, field_of, flag_of, text_of
from boxgrasp.kernels import octree
from boxgrasp.kernels.rays import TREE_HALF
from boxgrasp.mapping.local_map import CLAMP_MAX, CLAMP_MIN, LocalMap, log_odds
from boxgrasp.mapping.octomap_leaves import MapCells

_HEADERS = {b"# Octomap OcTree file": False, b"# Octomap OcTree binary file": True}
_NODE_BYTES = {"OcTree": 5, "OcTreeStamped": 5, "ColorOcTree": 8}  # of a node of a .ot stream
_HEADER_LIMIT = 65536  # bytes
_MOST_BYTES = 1 << 30  # a file that memory holds several times
_FREE, _OCCUPIED = float(log_odds(CLAMP_MIN)), float(log_odds(CLAMP_MAX))  # as OctoMap reads a .bt
_RESOLUTIONS_M = (1e-4, 100.0)  # beyond them a header is damaged
_NO_CLAMP = 1e-12  # probability: log-odds are written as they are


def read_octomap(path: str | os.PathLike[str]) -> MapCells:
    """The leaves of an OctoMap file.

    Args:
        path: of a .bt or .ot file, told apart by their first line.

    Returns:
        The leaves, in the frame of the file.

    Raises:
        MapError: missing or unreadable file, no OctoMap file, truncated, or not a sound tree.
    """
    file = Path(path)
    try:
        if file.stat().st_size > _MOST_BYTES:
            raise MapError(f"{file}: {file.stat().st_size} bytes; valid: an OctoMap up to 1 GiB")
        data = file.read_bytes()
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or "not a path"
        raise MapError(f"{file}: cannot be read ({reason}); valid: a .bt or .ot file") from None
    return parse_octomap(data, str(file))


def parse_octomap(data: bytes, name: str = "octomap") -> MapCells:
    """The leaves of a whole .bt or .ot file in memory.

    Args:
        data: the file's bytes.
        name: of the file, in messages.

    Returns:
        The leaves, in the frame of the file.

    Raises:
        MapError: as `read_octomap`.
    """
    header = _read_header(data, name)
    body = data[header.end :] if header.nodes else b""
    cells, nodes = _leaves(body, header.binary, header.kind, header.resolution_m, name)
    if nodes != header.nodes:
        raise MapError(
            f"{name}: holds {nodes} nodes, its header says {header.nodes}; valid: the same"
        )
    return cells


@dataclass(frozen=True)
class _Header:
    """What stands before the nodes: their stream starts at `end`."""

    binary: bool
    kind: str
    resolution_m: float
    nodes: int
    end: int


def _read_header(data: bytes, name: str) -> _Header:
    first = data[:_HEADER_LIMIT].split(b"\n", 1)[0].strip()
    binary = _HEADERS.get(first)
    if binary is None:
        raise MapError(
            f"{name}: first line is {first[:40]!r}; valid: '# Octomap OcTree file' (.ot) or "
            "'# Octomap OcTree binary file' (.bt)"
        )
    at = 0
    fields: dict[str, str] = {}
    while True:
        end = data.find(b"\n", at, at + _HEADER_LIMIT)
        if end < 0:
            raise MapError(f"{name}: header ends without a line 'data'; valid: a whole file")
        words = data[at:end].decode("ascii", "replace").split()
        at = end + 1
        if words == ["data"]:
            break
        if len(words) == 2 and not words[0].startswith("#"):
            fields[words[0]] = words[1]
    try:
        resolution_m, nodes = float(fields["res"]), int(fields["size"])
    except (KeyError, ValueError):
        raise MapError(
            f"{name}: header has res {fields.get('res')!r} and size {fields.get('size')!r}; "
            "valid: a resolution in meters and a number of nodes"
        ) from None
    return _Header(binary, fields.get("id", "OcTree"), resolution_m, nodes, at)


def parse_octomap_body(
    body: bytes, resolution_m: float, *, binary: bool, kind: str = "OcTree", name: str = "octomap"
) -> MapCells:
    """The leaves of a tree without a header, as a ROS message carries it.

    Args:
        body: the stream of nodes.
        resolution_m: edge of the smallest cell, m.
        binary: whether it holds two bits a child, as a .bt.
        kind: class of the tree, as its header's `id`.
        name: of the message, in messages.

    Returns:
        The leaves, in the frame of the message.

    Raises:
        MapError: truncated, or not a sound tree.
    """
    return _leaves(body, binary, kind, resolution_m, name)[0]


def octomap_cells(message: Any) -> MapCells:
    """The leaves of an octomap_msgs/Octomap.

    Args:
        message: any object with its fields; `data` is a buffer, or a list or tuple of int8.

    Returns:
        The leaves, in the message's frame.

    Raises:
        MapError: a field missing or of another type, truncated, or not a sound tree.
    """
    try:
        kind, binary = text_of(message, "id"), flag_of(message, "binary")
        resolution_m, data = field_of(message, "resolution"), field_of(message, "data")
        if isinstance(data, (list, tuple)):
            body = array.array("b", data).tobytes()  # as rospy has int8
        else:
            body = bytes_of(message).tobytes()
    except (CaptureError, TypeError, OverflowError) as error:
        raise MapError(f"octomap {str(error):.200}; valid: an octomap_msgs/Octomap") from None
    if not isinstance(resolution_m, (float, np.floating)):
        raise MapError(f"octomap has resolution {resolution_m!r:.40}; valid: meters")
    return parse_octomap_body(body, float(resolution_m), binary=binary, kind=kind)


def _leaves(
    body: bytes, binary: bool, kind: str, resolution_m: float, name: str
) -> tuple[MapCells, int]:
    """The leaves of a stream of nodes, and how many nodes it holds."""
    if kind not in _NODE_BYTES:
        raise MapError(f"{name}: tree is a {kind[:40]!r}; valid: {', '.join(_NODE_BYTES)}")
    least_m, most_m = _RESOLUTIONS_M
    if not (math.isfinite(resolution_m) and least_m <= resolution_m <= most_m):
        raise MapError(f"{name}: resolution is {resolution_m} m; valid: {least_m} to {most_m:g}")
    leaves, nodes = _empty_leaves(0), 0
    if body:
        record = 2 if binary else _NODE_BYTES[kind]
        data = np.frombuffer(body, dtype=np.uint8)
        floats = np.zeros(0, dtype=np.float32)
        if not binary:
            whole = data[: len(data) // record * record].reshape(-1, record)
            floats = np.ascontiguousarray(whole[:, :4]).view("<f4").reshape(-1).astype(np.float32)
        for fill in (False, True):
            count, nodes, at = octree.unpack(
                data, floats, binary, record, _FREE, _OCCUPIED, fill, *leaves
            )
            if count < 0:
                raise MapError(
                    f"{name}: tree {_fault(count, nodes)} (byte {at}); valid: a whole OctoMap tree"
                )
            if not fill:
                leaves = _empty_leaves(count)
    keys, depths, values = leaves
    spans = np.int64(1) << (octree.DEPTH - depths.astype(np.int64))
    return MapCells(resolution_m, keys - np.int32(TREE_HALF), spans, values), nodes


def _empty_leaves(
    count: int,
) -> tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.float32]]:
    """Keys (count, 3), depths and log-odds of leaves, to be filled."""
    return (
        np.zeros((count, 3), dtype=np.int32),
        np.zeros(count, dtype=np.uint8),
        np.zeros(count, dtype=np.float32),
    )


def _fault(count: int, nodes: int) -> str:
    return {
        octree.TRUNCATED: f"ends within node {nodes}",
        octree.TOO_DEEP: f"goes deeper than {octree.DEPTH} levels",
        octree.BAD_VALUE: f"holds log-odds that are not finite in node {nodes}",
    }[count]


def cells_of(source: Any) -> MapCells:
    """The leaves of whatever holds an OctoMap.

    Args:
        source: a path, the bytes of a file, an octomap-python tree, or `MapCells`.

    Returns:
        The leaves.

    Raises:
        MapError: as `read_octomap`, or something else was given.
    """
    if isinstance(source, MapCells):
        return source
    if isinstance(source, (str, os.PathLike)):
        return read_octomap(source)
    if isinstance(source, (bytes, bytearray)):
        return parse_octomap(bytes(source))
    if callable(getattr(source, "writeBinary", None)) and callable(getattr(source, "write", None)):
        return parse_octomap(source.write(), type(source).__name__)
    raise MapError(
        f"octomap is a {type(source).__name__}; valid: a path, bytes, an octomap-python tree"
    )


def write_octomap(path: str | os.PathLike[str], local_map: LocalMap) -> None:
    """Write a local map in the base frame: .ot keeps log-odds, .bt only free and occupied.

    An OctoMap's cells lie on multiples of the resolution and its axes are the base frame's. Where
    the map's cells do too, they are written as they are. Elsewhere the map is resampled: each cell
    of the file takes the value of the local cell in which its center lies. In a .bt cells with p of
    0.5 and more are occupied, as OctoMap does.

    Args:
        path: of the file, .bt or .ot.
        local_map: what is written.

    Raises:
        MapError: another suffix, a path that cannot be written, a map outside OctoMap's range.
        MissingExtraError: octomap-python is not installed.
    """
    file = Path(path)
    if file.suffix not in (".bt", ".ot"):
        raise MapError(f"{file}: suffix is {file.suffix!r}; valid: .bt or .ot")
    tree = _tree(local_map)
    data = tree.writeBinary() if file.suffix == ".bt" else tree.write()
    try:
        file.write_bytes(data)
    except OSError as error:
        raise MapError(f"{file}: cannot be written ({error.strerror})") from None


def _tree(local_map: LocalMap) -> Any:
    try:
        octomap: Any = importlib.import_module("octomap")
    except ImportError:
        raise MissingExtraError(
            "writing OctoMap files needs octomap-python; install boxgrasp[io]"
        ) from None
    centers, values = _resampled(local_map)
    tree = octomap.OcTree(local_map.resolution_m)
    # Values are written as they are, so the tree's own clamping must not touch them.
    tree.setClampingThresMin(_NO_CLAMP)
    tree.setClampingThresMax(1 - _NO_CLAMP)
    for value in np.unique(values):
        tree.updateNodes(centers[values == value], float(value), True)
    tree.updateInnerOccupancy()
    return tree


def _resampled(local_map: LocalMap) -> tuple[Floats, NDArray[np.float32]]:
    """(K, 3) centers of an OctoMap's cells, base frame, m, and (K,) log-odds of those known."""
    s, T = local_map.resolution_m, local_map.T_base_map
    corners = local_map.lowest + np.array(list(np.ndindex(2, 2, 2))) * local_map.shape * s
    corners = corners @ T[:3, :3].T + T[:3, 3]
    low = np.floor(corners.min(axis=0) / s).astype(np.int64) - 1
    high = np.ceil(corners.max(axis=0) / s).astype(np.int64) + 1
    if low.min() < -TREE_HALF or high.max() > TREE_HALF:
        raise MapError(f"local map lies {np.abs(corners).max():.0f} m away; valid: within OctoMap")
    index = np.moveaxis(np.indices(tuple(high - low)), 0, -1).reshape(-1, 3) + low
    centers = (index + 0.5) * s
    T_map_base = invert(T)
    cells, inside = local_map.keys(centers @ T_map_base[:3, :3].T + T_map_base[:3, 3])
    at = cells[inside].T
    kept = local_map.known[at[0], at[1], at[2]]
    return centers[inside][kept], local_map.log_odds[at[0], at[1], at[2]][kept]
