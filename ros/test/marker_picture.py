"""Draw a MarkerArray as RViz would show it, from the message alone.

python ros/test/marker_picture.py CAPTURE OUT.png [--object N] [--pixel U V] [--ranker NAME]
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from visualization_msgs.msg import Marker

from boxgrasp.arrays import Floats
from boxgrasp.draw.shapes import corners
from boxgrasp.geometry.transforms import rotation_of

BACKGROUND = (48, 48, 48)  # RViz's own
SIZE = (1280, 960)
FINE = 2  # drawn at twice the size
FOCAL = 0.95  # of the image's width
# Corners as boxgrasp.draw.shapes orders them; a face each.
FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
LIGHT = np.array((-0.4, 0.3, 0.85))


@dataclass
class Camera:
    """Where the picture is taken from: z forward, x right, y down."""

    eye: Floats
    R: Floats

    @staticmethod
    def towards(target: Floats, eye: Floats) -> Camera:
        """A camera that looks at a place, upright."""
        z = (target - eye) / np.linalg.norm(target - eye)
        x = np.cross(z, (0.0, 0.0, 1.0))
        x = x / np.linalg.norm(x)
        return Camera(eye, np.array((x, np.cross(z, x), z)))

    def seen(self, points: Floats) -> Floats:
        """(n, 3) u, v in pixels, and depth."""
        local = (np.atleast_2d(points) - self.eye) @ self.R.T
        depth = np.maximum(local[:, 2], 0.02)
        focal, middle = FOCAL * SIZE[0] * FINE, np.array(SIZE) * FINE / 2
        return np.column_stack((local[:, :2] / depth[:, None] * focal + middle, local[:, 2]))


def picture(array: Any, camera: Camera | None = None) -> Image.Image:
    """The array as RViz shows it.

    Args:
        array: a MarkerArray.
        camera: None for one behind and over the target's box.

    Returns:
        An RGB image.
    """
    shown = _left_after(array)
    camera = camera or _camera(shown)
    image = Image.new("RGB", (SIZE[0] * FINE, SIZE[1] * FINE), BACKGROUND)
    draw = ImageDraw.Draw(image, "RGBA")
    pieces = [piece for marker in shown.values() for piece in _pieces(marker, camera)]
    for _, kind, places, color, size in sorted(pieces, key=lambda piece: -piece[0]):
        if kind == "area":
            draw.polygon([tuple(xy) for xy in places.tolist()], fill=color)
        elif kind == "line":
            draw.line([tuple(xy) for xy in places.tolist()], fill=color, width=max(1, round(size)))
        else:
            (x, y), r = places[0].tolist(), max(size / 2, 1.0)
            shape = draw.ellipse if kind == "ball" else draw.rectangle
            shape((x - r, y - r, x + r, y + r), fill=color)
    for marker in shown.values():
        if marker.type == Marker.TEXT_VIEW_FACING:
            _write(draw, marker, camera)
    return image.resize(SIZE, Image.Resampling.LANCZOS)


def _left_after(array: Any) -> dict[tuple[str, int], Any]:
    """The markers that stand once every one was obeyed in turn."""
    shown: dict[tuple[str, int], Any] = {}
    for marker in array.markers:
        if marker.action == Marker.DELETEALL:
            shown.clear()
        elif marker.action == Marker.DELETE:
            shown.pop((marker.ns, marker.id), None)
        else:
            shown[marker.ns, marker.id] = marker
    return shown


def _camera(shown: dict[tuple[str, int], Any]) -> Camera:
    """Behind and over the target's box, as far as its headline takes."""
    box, words = (shown.get((name, 0)) for name in ("target_box", "headline"))
    low = np.array((0.5, 0.0, 0.2)) if box is None else _xyz(box.pose.position)
    high = low if words is None else _xyz(words.pose.position)
    away = 0.55 + 0.9 * float(np.linalg.norm(high - low))
    target = low + 0.5 * (high - low)
    return Camera.towards(target, target + away * np.array((-0.72, -0.45, 0.42)))


def _pieces(marker: Any, camera: Camera) -> Iterator[tuple[float, str, Floats, Any, float]]:
    """Depth, kind, places in pixels, color and width in pixels of each thing to paint."""
    T, color = _matrix(marker.pose), _rgba(marker.color)
    points = np.array([_xyz(point) for point in marker.points]).reshape(-1, 3)
    points = points @ T[:3, :3].T + T[:3, 3]
    scale = _xyz(marker.scale)
    if marker.type == Marker.CUBE:
        places = corners(T, scale)
        for face in FACES:
            yield from _area(places[list(face)], color, camera)
    elif marker.type == Marker.TRIANGLE_LIST:
        for triangle in points.reshape(-1, 3, 3):
            yield from _area(triangle, color, camera)
    elif marker.type in (Marker.LINE_LIST, Marker.LINE_STRIP):
        pairs = zip(points[::2], points[1::2], strict=True)
        if marker.type == Marker.LINE_STRIP:
            pairs = zip(points[:-1], points[1:], strict=True)
        own = [_rgba(item) for item in marker.colors[::2]]
        for k, (a, b) in enumerate(pairs):
            yield from _line(a, b, own[k] if own else color, scale[0], camera)
    elif marker.type in (Marker.POINTS, Marker.SPHERE_LIST):
        kind = "dot" if marker.type == Marker.POINTS else "ball"
        for u, v, depth in camera.seen(points):
            if depth > 0.05:
                yield depth, kind, np.array([[u, v]]), color, scale[0] * _per_m(depth)
    elif marker.type == Marker.ARROW:
        yield from _arrow(points, scale, color, camera)


def _area(places: Floats, color: Any, camera: Camera) -> Iterator[Any]:
    seen = camera.seen(places)
    if (seen[:, 2] < 0.05).any():
        return
    normal = np.cross(places[1] - places[0], places[2] - places[0])
    length = float(np.linalg.norm(normal))
    shade = 0.7 + 0.3 * abs(float(normal @ LIGHT)) / max(length, 1e-12)
    r, g, b, a = color
    painted = (int(r * shade), int(g * shade), int(b * shade), a)
    yield float(seen[:, 2].mean()), "area", seen[:, :2], painted, 0.0


def _line(a: Floats, b: Floats, color: Any, width_m: float, camera: Camera) -> Iterator[Any]:
    parts = max(1, int(np.linalg.norm(b - a) / 0.05))  # short, so that depth sorts them
    for k in range(parts):
        ends = np.array((a + (b - a) * k / parts, a + (b - a) * (k + 1) / parts))
        seen = camera.seen(ends)
        depth = float(seen[:, 2].mean())
        if (seen[:, 2] > 0.05).all():
            yield depth - 0.002, "line", seen[:, :2], color, width_m * _per_m(depth)


def _arrow(points: Floats, scale: Floats, color: Any, camera: Camera) -> Iterator[Any]:
    tail, tip = points
    along = (tip - tail) / np.linalg.norm(tip - tail)
    neck = tip - along * scale[2]
    yield from _line(tail, neck, color, scale[0], camera)
    side = np.cross(along, camera.eye - tip)
    side = side / np.linalg.norm(side) * scale[1]  # RViz's head diameter, drawn flat
    yield from _area(np.array((neck + side / 2, tip, neck - side / 2)), color, camera)


def _write(draw: ImageDraw.ImageDraw, marker: Any, camera: Camera) -> None:
    u, v, depth = camera.seen(_xyz(marker.pose.position))[0]
    if depth < 0.05:
        return
    font = ImageFont.load_default(max(6, marker.scale.z * _per_m(depth)))
    draw.multiline_text(
        (u, v), marker.text, fill=_rgba(marker.color), font=font, anchor="mm", align="center",
        stroke_width=2, stroke_fill=(20, 20, 20, 160),
    )  # fmt: skip


def _per_m(depth: float) -> float:
    return FOCAL * SIZE[0] * FINE / depth


def _xyz(of: Any) -> Floats:
    return np.array((of.x, of.y, of.z))


def _rgba(of: Any) -> tuple[int, ...]:
    return tuple(round(255 * value) for value in (of.r, of.g, of.b, of.a))


def _matrix(pose: Any) -> Floats:
    q = pose.orientation
    T = np.eye(4)
    T[:3, :3] = rotation_of((q.x, q.y, q.z, q.w))
    T[:3, 3] = _xyz(pose.position)
    return T


def main(arguments: Iterable[str] | None = None) -> None:
    """Answer a capture and draw its markers."""
    from boxgrasp_ros.markers import marker_array
    from std_msgs.msg import Header

    from boxgrasp import GraspSelector, Target, load_capture

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("capture")
    parser.add_argument("out")
    parser.add_argument("--object", type=int)
    parser.add_argument("--pixel", type=int, nargs=2)
    parser.add_argument("--ranker", default="clearance")
    parser.add_argument("--cloud-frame", default="optical", choices=("optical", "base"))
    told = parser.parse_args(None if arguments is None else list(arguments))
    target = None
    if told.object is not None or told.pixel is not None:
        target = Target(pixel=told.pixel and tuple(told.pixel), object=told.object)
    selector = GraspSelector({"ranker": told.ranker})
    capture = load_capture(told.capture, cloud_frame=told.cloud_frame)
    analysis = selector.analyze(capture, target)
    picture(marker_array(analysis, selector.choose(analysis), Header(frame_id="base_link"))).save(
        told.out
    )


if __name__ == "__main__":
    main()
