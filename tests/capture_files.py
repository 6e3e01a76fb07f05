"""Small captures in every format, written here byte by byte so that no reader tests itself."""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

HEIGHT, WIDTH = 24, 32


@dataclass(frozen=True)
class View:
    """A tilted plane with a step in it, seen from 0.8 m; some pixels missing."""

    depth: np.ndarray
    intrinsics: np.ndarray
    T_base_camera: np.ndarray
    rgb: np.ndarray
    mask: np.ndarray
    target_pixel: tuple[int, int]

    @property
    def points(self) -> np.ndarray:
        """(H, W, 3) float32, NaN where missing."""
        fx, fy, cx, cy = self.intrinsics[[0, 1, 0, 1], [0, 1, 2, 2]]
        v, u = np.mgrid[:HEIGHT, :WIDTH]
        rays = np.stack([(u - cx) / fx, (v - cy) / fy, np.ones_like(u)], axis=-1)
        points = (rays * self.depth[..., None].astype(float)).astype(np.float32)
        points[self.depth == 0] = np.nan
        return points


def view() -> View:
    rng = np.random.default_rng(3)
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    millimeters = 800 + 4 * v + u + rng.integers(0, 3, v.shape)
    millimeters[8:14, 10:18] -= 60
    millimeters[rng.random(v.shape) < 0.1] = 0
    mask = np.zeros((HEIGHT, WIDTH), bool)
    mask[8:14, 10:18] = True
    T = np.array(
        [[0, -0.6, 0.8, 0.1], [-1, 0, 0, 0], [0, -0.8, -0.6, 1.3], [0, 0, 0, 1]], dtype=float
    )
    K = np.array([[30.5, 0, 15.25], [0, 31.0, 11.5], [0, 0, 1]])
    rgb = rng.integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    return View((millimeters / 1000).astype(np.float32), K, T, rgb, mask, (13, 10))


def write_npz(path: Path, seen: View, **changes: Any) -> Path:
    arrays: dict[str, Any] = {
        "depth": seen.depth,
        "intrinsics": seen.intrinsics,
        "T_base_camera": seen.T_base_camera,
        "rgb": seen.rgb,
        "mask": seen.mask,
        "target_pixel": np.array(seen.target_pixel),
        **changes,
    }
    np.savez_compressed(path, **{k: v for k, v in arrays.items() if v is not None})
    return path


def write_folder(folder: Path, seen: View, *, scale: float | None = None) -> Path:
    folder.mkdir(parents=True)
    raw = np.round(seen.depth.astype(float) / (scale or 0.001)).astype(np.uint16)
    Image.fromarray(raw).save(folder / "depth.png")
    Image.fromarray(seen.rgb).save(folder / "color.png")
    Image.fromarray(seen.mask.astype(np.uint8) * 255).save(folder / "mask.png")
    (fx, _, cx), (_, fy, cy) = seen.intrinsics[:2].tolist()
    camera = {"fx": fx, "fy": fy, "cx": cx, "cy": cy, "width": WIDTH, "height": HEIGHT}
    (folder / "intrinsics.json").write_text(json.dumps(camera))
    told: dict[str, Any] = {
        "T_base_camera": seen.T_base_camera.tolist(),
        "target_pixel": list(seen.target_pixel),
    }
    if scale is not None:
        told["depth_scale"] = scale
    (folder / "capture.json").write_text(json.dumps(told))
    return folder


def pcd_bytes(
    points: np.ndarray,
    encoding: str,
    *,
    rgb: np.ndarray | None = None,
    rgb_type: str = "F",
    viewpoint: str = "0 0 0 1 0 0 0",
    organized: bool = False,
) -> bytes:
    """A PCD 0.7 of (H, W, 3) or (N, 3) points, with colors packed as PCL does."""
    height, width = points.shape[:2] if organized else (1, points.size // 3)
    xyz = points.reshape(-1, 3).astype("<f4")
    names, kinds, columns = "x y z", "F F F", list(xyz.T)
    if rgb is not None:
        c = rgb.reshape(-1, 3).astype("<u4")
        packed = ((c[:, 0] << 16) | (c[:, 1] << 8) | c[:, 2]).astype("<u4")
        columns.append(packed.view("<f4") if rgb_type == "F" else packed)
        names, kinds = names + " rgb", kinds + " " + rgb_type
    ones = " ".join("1" for _ in columns)
    fours = " ".join("4" for _ in columns)
    header = (
        f"# .PCD v0.7 - Point Cloud Data file format\nVERSION 0.7\nFIELDS {names}\nSIZE {fours}\n"
        f"TYPE {kinds}\nCOUNT {ones}\nWIDTH {width}\nHEIGHT {height}\nVIEWPOINT {viewpoint}\n"
        f"POINTS {len(xyz)}\nDATA {encoding}\n"
    ).encode()
    if encoding == "ascii":
        rows = [" ".join(repr(x.item()) for x in row) for row in zip(*columns, strict=True)]
        return header + ("\n".join(rows) + "\n").encode()
    if encoding == "binary":
        rows = [b"".join(x.tobytes() for x in row) for row in zip(*columns, strict=True)]
        return header + b"".join(rows)
    plain = b"".join(np.ascontiguousarray(column).tobytes() for column in columns)
    packed_bytes = lzf_literals(plain)
    return header + struct.pack("<II", len(packed_bytes), len(plain)) + packed_bytes


def lzf_literals(plain: bytes) -> bytes:
    """LZF with literal runs, and a back reference for a run of zeros, as its format says."""
    out = bytearray()
    i = 0
    while i < len(plain):
        run = 0
        while i > 0 and run < 8 and plain[i - 1 : i + run + 1] == bytes(run + 2):
            run += 1
        if run >= 3:  # length - 2 in three bits, distance - 1 = 0 in thirteen
            out += bytes([(run - 2) << 5, 0])
            i += run
            continue
        piece = plain[i : i + 32]
        zeros = piece.find(bytes(5))
        if zeros >= 0:
            piece = piece[: zeros + 1]
        out += bytes([len(piece) - 1]) + piece
        i += len(piece)
    return bytes(out)


def ply_bytes(points: np.ndarray, encoding: str, *, rgb: np.ndarray | None = None) -> bytes:
    """A PLY 1.0 of (N, 3) points with a normal each, a face after them, an element before."""
    order = {"ascii": "<", "binary_little_endian": "<", "binary_big_endian": ">"}[encoding]
    lines = ["ply", f"format {encoding} 1.0", "comment made for a test", "element stamp 2"]
    lines += ["property int seconds", f"element vertex {len(points)}"]
    lines += [f"property float {axis}" for axis in "xyz"] + ["property double nx"]
    if rgb is not None:
        lines += [f"property uchar {name}" for name in ("red", "green", "blue")]
    lines += ["element face 1", "property list uchar int vertex_indices", "end_header", ""]
    header = "\n".join(lines).encode()
    xyz = points.astype(np.float32)
    if encoding == "ascii":
        body = ["7", "8"]
        for i, point in enumerate(xyz):
            color = [] if rgb is None else [str(c) for c in rgb[i].tolist()]
            body.append(" ".join([*(repr(float(x)) for x in point), "0.5", *color]))
        return header + ("\n".join([*body, "3 0 1 2", ""])).encode()
    body_bytes = struct.pack(order + "2i", 7, 8)
    for i, point in enumerate(xyz):
        body_bytes += struct.pack(order + "3fd", *point.tolist(), 0.5)
        if rgb is not None:
            body_bytes += bytes(rgb[i].tolist())
    return header + body_bytes + struct.pack(order + "B3i", 3, 0, 1, 2)
