"""OctoMap files: .bt (two bits a cell) and .ot (log-odds), read and written.

Reading is our own and takes any bytes: octomap-python gives half a map for a truncated file, with
no error, and ends the process on a tree that is too deep. Writing goes through octomap-python.
"""

from __future__ import annotations

import importlib
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from boxgrasp.arrays import Floats
from boxgrasp.errors import MapError, MissingExtraError
from boxgrasp.geometry.transforms import invert
from boxgrasp.kernels import octree
from boxgrasp.kernels.rays import TREE_HALF
from boxgrasp.mapping.local_map import LocalMap, MappingConfig, log_odds
from boxgrasp.mapping.octomap_leaves import MapCells, map_from_octomap

_HEADERS = {b"# Octomap OcTree file": False, b"# Octomap OcTree binary file": True}
_NODE_BYTES = {"OcTree": 5, "OcTreeStamped": 5, "ColorOcTree": 8}  # of a node of a .ot stream
_HEADER_LIMIT = 65536
_MOST_BYTES = 1 << 30
_FREE, _OCCUPIED = float(log_odds(0.1192)), float(log_odds(0.971))  # what OctoMap reads from a .bt


def read_octomap(path: str | os.PathLike[str]) -> MapCells:
    """The leaves of a .bt or .ot file, told apart by their first line.

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

    Raises:
        MapError: as `read_octomap`.
    """
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
    kind = fields.get("id", "OcTree")
    try:
        resolution, size = float(fields["res"]), int(fields["size"])
    except (KeyError, ValueError):
        raise MapError(
            f"{name}: header has res {fields.get('res')!r} and size {fields.get('size')!r}; "
            "valid: a resolution in meters and a number of nodes"
        ) from None
    cells, nodes = _leaves(data[at:] if size else b"", binary, kind, resolution, name)
    if nodes != size:
        raise MapError(f"{name}: holds {nodes} nodes, its header says {size}; valid: the same")
    return cells


def parse_octomap_body(
    body: bytes, resolution_m: float, *, binary: bool, kind: str = "OcTree", name: str = "octomap"
) -> MapCells:
    """The leaves of a tree without a header, as a ROS message carries it.

    Raises:
        MapError: truncated, or not a sound tree.
    """
    return _leaves(body, binary, kind, resolution_m, name)[0]


def _leaves(
    body: bytes, binary: bool, kind: str, resolution: float, name: str
) -> tuple[MapCells, int]:
    if kind not in _NODE_BYTES:
        raise MapError(f"{name}: tree is a {kind[:40]!r}; valid: {', '.join(_NODE_BYTES)}")
    if not (math.isfinite(resolution) and 1e-4 <= resolution <= 100.0):
        raise MapError(f"{name}: resolution is {resolution} m; valid: 0.0001 to 100")
    keys = np.zeros((0, 3), dtype=np.int32)
    depths = np.zeros(0, dtype=np.uint8)
    values = np.zeros(0, dtype=np.float32)
    nodes = 0
    if body:
        record = 2 if binary else _NODE_BYTES[kind]
        data = np.frombuffer(body, dtype=np.uint8)
        floats = np.zeros(0, dtype=np.float32)
        if not binary:
            whole = data[: len(data) // record * record].reshape(-1, record)
            floats = np.ascontiguousarray(whole[:, :4]).view("<f4").reshape(-1).astype(np.float32)
        for fill in (False, True):
            count, nodes, at = octree.unpack(
                data, floats, binary, record, _FREE, _OCCUPIED, fill, keys, depths, values
            )
            if count < 0:
                found = {
                    octree.TRUNCATED: f"ends within node {nodes}",
                    octree.TOO_DEEP: f"goes deeper than {octree.DEPTH} levels",
                    octree.BAD_VALUE: f"holds log-odds that are not finite in node {nodes}",
                }[count]
                raise MapError(f"{name}: tree {found} (byte {at}); valid: a whole OctoMap tree")
            if not fill:
                keys = np.zeros((count, 3), dtype=np.int32)
                depths = np.zeros(count, dtype=np.uint8)
                values = np.zeros(count, dtype=np.float32)
    spans = np.int64(1) << (octree.DEPTH - depths.astype(np.int64))
    return MapCells(resolution, keys - np.int32(TREE_HALF), spans, values), nodes


def cells_of(source: Any) -> MapCells:
    """The leaves of a path, of a file in memory, of an octomap-python tree, or of `MapCells`.

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


def local_map_from_octomap(
    source: Any, T_base_map: ArrayLike, config: MappingConfig | None = None
) -> LocalMap:
    """A local map that samples an OctoMap (see `cells_of`), in the base frame, at cell centers.

    Raises:
        MapError: as `cells_of`.
    """
    return map_from_octomap(cells_of(source), T_base_map, config)


def occupied_cells(source: Any, above: float = 0.66) -> tuple[Floats, Floats]:
    """(K, 3) centers, base frame, and (K,) edges of the occupied leaves of an OctoMap, meters.

    Raises:
        MapError: as `cells_of`.
    """
    return cells_of(source).occupied(above)


def write_octomap(path: str | os.PathLike[str], local_map: LocalMap) -> None:
    """Write a local map in the base frame: .ot keeps log-odds, .bt only free and occupied.

    An OctoMap's cells lie on multiples of the resolution and its axes are the base frame's. Where
    the map's cells do too, they are written as they are. Elsewhere the map is resampled: each cell
    of the file takes the value of the local cell in which its center lies. In a .bt cells with p
    of 0.5 and more are occupied, as OctoMap does.

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
    s = local_map.resolution_m
    T = local_map.T_base_map
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
    values = local_map.log_odds[at[0], at[1], at[2]][kept]
    centers = centers[inside][kept]
    tree = octomap.OcTree(s)
    # Values are written as they are, so the tree's own clamping must not touch them.
    tree.setClampingThresMin(1e-12)
    tree.setClampingThresMax(1 - 1e-12)
    for value in np.unique(values):
        tree.updateNodes(centers[values == value], float(value), True)
    tree.updateInnerOccupancy()
    return tree
