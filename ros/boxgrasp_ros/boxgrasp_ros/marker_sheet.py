"""A MarkerArray in the making: RViz refuses scales of 0, empty lists and turns that are none."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from boxgrasp.arrays import Array, Floats
from boxgrasp.draw.palette import RGB, WHITE
from boxgrasp.draw.shapes import EDGES, corners
from boxgrasp_ros.replies import point_message, pose_message

TEXT_M = 0.02  # height of letters

_DRAWN_M, _LEFT_OUT_M = 0.010, 0.008  # of dashes


class MarkerSheet:
    """Collects markers; the first one clears what was there before."""

    def __init__(self, header: Header) -> None:
        """Start with the marker that deletes all others.

        Args:
            header: stamp of the view, and the frame of every place.
        """
        self._header = header
        self._markers = [Marker(header=header, action=Marker.DELETEALL)]

    def array(self) -> MarkerArray:
        """The message.

        Returns:
            Every marker so far.
        """
        return MarkerArray(markers=self._markers)

    def box(
        self, key: tuple[str, int], T: Floats, size_m: Floats, color: RGB, alpha: float
    ) -> None:
        """Add a solid box.

        Args:
            key: namespace and number.
            T: (4, 4) at its center, m.
            size_m: (3,) along its axes.
            color: of it.
            alpha: above 0 to 1 for opaque.
        """
        x, y, z = (float(value) for value in size_m)
        self._add(key, Marker.CUBE, (x, y, z), color, alpha).pose = pose_message(T)

    def edges(
        self, key: tuple[str, int], T: Floats, size_m: Floats, look: tuple[RGB, float, float]
    ) -> None:
        """Add a box's edges.

        Args:
            key: namespace and number.
            T: (4, 4) at its center, m.
            size_m: (3,) along its axes.
            look: color, alpha and width, m.
        """
        places = corners(T, size_m)
        self.lines(key, [places[list(pair)] for pair in EDGES], look)

    def lines(
        self,
        key: tuple[str, int],
        strokes: Sequence[Floats],
        look: tuple[RGB, float, float],
        colors: Sequence[RGB] = (),
    ) -> None:
        """Add strokes; nothing where there are none.

        Args:
            key: namespace and number.
            strokes: (2, 3) ends of each, m.
            look: color, alpha and width, m.
            colors: of each stroke, where they differ.
        """
        if not strokes:
            return
        color, alpha, width_m = look
        marker = self._add(key, Marker.LINE_LIST, (width_m, 0.0, 0.0), color, alpha)
        marker.points = points_of(np.concatenate(strokes))
        marker.colors = [_color(own, alpha) for own in colors for _ in range(2)]

    def outline(self, key: tuple[str, int], rim: Floats, look: tuple[RGB, float, float]) -> None:
        """Add a closed line.

        Args:
            key: namespace and number.
            rim: (n, 3) its corners, m, n at least 2.
            look: color, alpha and width, m.
        """
        color, alpha, width_m = look
        marker = self._add(key, Marker.LINE_STRIP, (width_m, 0.0, 0.0), color, alpha)
        marker.points = points_of(np.vstack((rim, rim[:1])))

    def polygon(self, key: tuple[str, int], rim: Floats, color: RGB, alpha: float) -> None:
        """Add a filled convex polygon.

        Args:
            key: namespace and number.
            rim: (n, 3) its corners in order, m, n at least 3.
            color: of it.
            alpha: above 0 to 1 for opaque.
        """
        marker = self._add(key, Marker.TRIANGLE_LIST, (1.0, 1.0, 1.0), color, alpha)
        fan = [rim[[0, k, k + 1]] for k in range(1, len(rim) - 1)]
        marker.points = points_of(np.concatenate(fan))

    def dots(
        self, key: tuple[str, int], places: Array, color: RGB, size_m: float, *, alpha: float = 1.0
    ) -> None:
        """Add square dots that turn to the viewer; nothing where there are none.

        Args:
            key: namespace and number.
            places: (n, 3), m.
            color: of all.
            size_m: of each.
            alpha: above 0 to 1 for opaque.
        """
        if len(places):
            marker = self._add(key, Marker.POINTS, (size_m, size_m, 0.0), color, alpha)
            marker.points = points_of(places)

    def balls(
        self, key: tuple[str, int], places: Array, color: RGB, size_m: float, *, alpha: float = 1.0
    ) -> None:
        """Add balls; nothing where there are none.

        Args:
            key: namespace and number.
            places: (n, 3) their centers, m.
            color: of all.
            size_m: diameter of each.
            alpha: above 0 to 1 for opaque.
        """
        if len(places):
            marker = self._add(key, Marker.SPHERE_LIST, (size_m,) * 3, color, alpha)
            marker.points = points_of(places)

    def arrow(
        self, key: tuple[str, int], ends: Floats, color: RGB, width_m: float, *, alpha: float = 1.0
    ) -> None:
        """Add an arrow.

        Args:
            key: namespace and number.
            ends: (2, 3) its tail and its tip, m, apart.
            color: of it.
            width_m: of its shaft; the head is twice as wide and three times as long.
            alpha: above 0 to 1 for opaque.
        """
        scale = (width_m, 2 * width_m, 3 * width_m)
        self._add(key, Marker.ARROW, scale, color, alpha).points = points_of(ends)

    def text(
        self,
        key: tuple[str, int],
        words: str,
        place: Floats | Sequence[float],
        color: RGB = WHITE,
        height_m: float = TEXT_M,
    ) -> None:
        """Add a text that faces the viewer.

        Args:
            key: namespace and number.
            words: not empty.
            place: (3,) of its middle, m.
            color: of it.
            height_m: of a capital letter.
        """
        marker = self._add(key, Marker.TEXT_VIEW_FACING, (0.0, 0.0, height_m), color, 1.0)
        marker.text = words
        marker.pose.position = point_message(place)

    def _add(
        self,
        key: tuple[str, int],
        kind: int,
        scale: tuple[float, ...],
        color: RGB,
        alpha: float,
    ) -> Any:
        name, number = key
        x, y, z = scale
        marker = Marker(
            header=self._header,
            ns=name,
            id=number,
            type=kind,
            action=Marker.ADD,
            scale=Vector3(x=x, y=y, z=z),
            color=_color(color, alpha),
        )
        self._markers.append(marker)
        return marker


def points_of(places: Array) -> list[Point]:
    """Places as points.

    Args:
        places: (n, 3), m.

    Returns:
        One each.
    """
    return [Point(x=x, y=y, z=z) for x, y, z in places.tolist()]


def dashed(stroke: Floats) -> list[Floats]:
    """The pieces of a dashed stroke.

    Args:
        stroke: (2, 3) its ends, m.

    Returns:
        (2, 3) ends of each.
    """
    length = float(np.linalg.norm(stroke[1] - stroke[0]))
    starts = np.arange(0.0, length, _DRAWN_M + _LEFT_OUT_M)
    shares = np.column_stack((starts, np.minimum(starts + _DRAWN_M, length))) / max(length, 1e-9)
    return [stroke[0] + share[:, None] * (stroke[1] - stroke[0]) for share in shares]


def _color(color: RGB, alpha: float) -> ColorRGBA:
    r, g, b = (value / 255 for value in color)
    return ColorRGBA(r=r, g=g, b=b, a=alpha)
