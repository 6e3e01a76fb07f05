"""Grasps on labeled captures, judged by geometry of their own: what is between the fingers.

Nothing here comes from the package but the answer and the hand's sizes: the table is fitted to the
pixels labeled as table, the target is its labeled pixels, and a candidate is counted as there is
one on the smallest rectangle round them (thesis section 2-4).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from boxgrasp import Capture
from boxgrasp.grasps.gripper import Gripper

TABLE = 1  # in labels.png
FIRST_OBJECT = 2
VOXEL_M = 0.003  # points are counted in cubes of this edge
TIP_M = 0.015  # the fingers' last stretch, which must hold something
MIDDLE_M = 0.01  # from the hand's mid-plane
LEAST_HELD = 10
MOST_OUTSIDE = 8  # points beyond the fingers, from which they touch the target
CLEAR_M = 0.015  # of a good grasp
ANSWERABLE_M = 0.025
NARROWER_M = 0.005
LINES = 3
_SHIFT_PX = 3

Floats = NDArray[Any]


@dataclass(frozen=True)
class Judged:
    """One grasp on one labeled target."""

    held: int
    central: int
    outside: int
    clear_m: float
    over_table_m: float

    @property
    def on_air(self) -> bool:
        """Whether the fingers close on nothing."""
        return self.held < LEAST_HELD

    @property
    def by_an_edge(self) -> bool:
        """Whether they hold something, but not in their middle."""
        return not self.on_air and self.central < LEAST_HELD

    @property
    def touching(self) -> bool:
        """Whether fingers or palm meet the target, something else or the table."""
        return self.outside >= MOST_OUTSIDE or self.clear_m <= 0.0 or self.over_table_m <= 0.0

    @property
    def holds(self) -> bool:
        """Whether the target is between the fingers, in their middle, and nowhere else."""
        return self.central >= LEAST_HELD and self.outside < MOST_OUTSIDE

    @property
    def good(self) -> bool:
        """Whether it holds, clear of other things and off the table."""
        return self.holds and self.clear_m >= CLEAR_M and self.over_table_m > 0.0


@dataclass(frozen=True, eq=False)
class Labeled:
    """A capture with its true labels, in the camera's frame, m."""

    places: Floats  # (H, W, 3)
    labels: NDArray[np.int64]
    measured: NDArray[np.bool_]
    up: Floats  # (3,) the table's normal
    offset_m: float  # height = up . p + offset

    @staticmethod
    def of(capture: Capture, labels: NDArray[np.int64]) -> Labeled:
        """The capture's points, and the table through the pixels labeled so."""
        places, measured = _places(capture)
        return Labeled(places, labels, measured, *_plane(places[(labels == TABLE) & measured]))

    @staticmethod
    def over(capture: Capture, labels: NDArray[np.int64], up: Floats, offset_m: float) -> Labeled:
        """The capture's points over a table whose place is known."""
        places, measured = _places(capture)
        return Labeled(places, labels, measured, up, offset_m)

    def points(self, number: int) -> Floats:
        """(N, 3) an object's points, one a voxel."""
        return _thinned(self.places[(self.labels == number) & self.measured])

    def others(self, number: int) -> Floats:
        """(N, 3) the points of all other objects, one a voxel."""
        other = (self.labels >= FIRST_OBJECT) & (self.labels != number)
        return _thinned(self.places[other & self.measured])

    def judge(self, number: int, T_camera_hand: Floats, gripper: Gripper) -> Judged:
        """One grasp of an object."""
        return self._judge(self.points(number), self.others(number), T_camera_hand, gripper)

    def _judge(self, own: Floats, others: Floats, T: Floats, gripper: Gripper) -> Judged:
        half = np.array((gripper.length_m, gripper.width_m, gripper.thickness_m)) / 2
        x, y, z = ((own - T[:3, 3]) @ T[:3, :3]).T
        inside = (np.abs(x) <= half[0]) & (np.abs(z) <= half[2])
        between = np.abs(y) <= gripper.max_opening_m / 2
        tips = inside & between & (x >= half[0] - TIP_M)
        away = np.abs((others - T[:3, 3]) @ T[:3, :3]) - half
        gaps = np.linalg.norm(np.maximum(away, 0.0), axis=1)
        corners = np.array(np.meshgrid(*([-1, 1],) * 3)).reshape(3, -1).T * half
        over = (corners @ T[:3, :3].T + T[:3, 3]) @ self.up + self.offset_m
        return Judged(
            held=int(np.count_nonzero(tips)),
            central=int(np.count_nonzero(tips & (np.abs(z) <= MIDDLE_M))),
            outside=int(np.count_nonzero(inside & ~between & (np.abs(y) <= half[1]))),
            clear_m=float(gaps.min(initial=0.5)),
            over_table_m=float(over.min()),
        )

    def answerable(self, number: int, gripper: Gripper) -> bool:
        """Whether some candidate on the true points' own box is clear, narrow enough and holds."""
        own, others = self.points(number), self.others(number)
        for T, width_m in self._candidates(own, gripper):
            if width_m > gripper.max_opening_m - NARROWER_M:
                continue
            found = self._judge(own, others, T, gripper)
            if found.holds and found.clear_m >= ANSWERABLE_M and found.over_table_m > 0.0:
                return True
        return False

    def _candidates(self, own: Floats, gripper: Gripper) -> Iterator[tuple[Floats, float]]:
        """The poses on five faces of the smallest box round points, and the widths held there."""
        R = self._table_axes()
        local = own @ R  # x away from the camera, z up; the table at z = -offset
        angles = np.deg2rad(np.arange(-45.0, 45.0, 0.5))
        along = np.outer(local[:, 0], np.cos(angles)) + np.outer(local[:, 1], np.sin(angles))
        across = np.outer(local[:, 1], np.cos(angles)) - np.outer(local[:, 0], np.sin(angles))
        best = int(np.argmin(np.ptp(along, axis=0) * np.ptp(across, axis=0)))
        c, s = np.cos(angles[best]), np.sin(angles[best])
        axes = R @ np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
        turned = own @ axes
        low, high = turned.min(axis=0), turned.max(axis=0)
        low[2] = -self.offset_m
        size, middle = high - low, (low + high) / 2
        forward, left, up = np.eye(3)
        faces = ((-left, forward), (forward, left), (left, -forward), (-up, left), (-up, forward))
        for k, (approach, opening) in enumerate(faces):
            step = (2, 2, 2, 0, 1)[k]
            turn = np.column_stack((approach, opening, np.cross(approach, opening)))
            width_m = float(size @ np.abs(opening))
            back = float(size @ np.abs(approach)) / 2 + gripper.length_m / 2
            for line in range(LINES):
                place = middle - approach * (back - gripper.insertion_depth_m)
                place[step] += size[step] * ((line + 0.5) / LINES - 0.5)
                T = np.eye(4)
                T[:3, :3], T[:3, 3] = axes @ turn, axes @ place
                yield T, width_m

    def _table_axes(self) -> Floats:
        """(3, 3) columns: level away from the camera, level to its left, up."""
        ahead = np.array((0.0, 0.0, 1.0)) - self.up[2] * self.up
        if np.linalg.norm(ahead) < 1e-6:
            ahead = np.array((0.0, -1.0, 0.0))
        ahead /= np.linalg.norm(ahead)
        return np.column_stack((ahead, np.cross(self.up, ahead), self.up))


def _places(capture: Capture) -> tuple[Floats, NDArray[np.bool_]]:
    """(H, W, 3) points of a capture, camera frame, m, and (H, W) which were measured."""
    assert capture.depth is not None and capture.intrinsics is not None
    depth, K = np.asarray(capture.depth, dtype=np.float64), capture.intrinsics
    v, u = np.indices(depth.shape)
    rays = np.stack((u, v, np.ones_like(u)), axis=-1) @ np.linalg.inv(K).T
    return rays * depth[..., None], depth > 0


def _plane(points: Floats) -> tuple[Floats, float]:
    """Normal towards the camera and offset of a plane, by least squares with outliers trimmed."""
    kept = points
    for _ in range(8):
        middle = kept.mean(axis=0)
        normal = np.linalg.eigh((kept - middle).T @ (kept - middle))[1][:, 0]
        normal = normal if normal @ middle < 0 else -normal
        off = np.abs((points - middle) @ normal)
        kept = points[off <= max(2.5 * np.median(off), 0.002)]
    return normal, float(-normal @ middle)


def _thinned(points: Floats) -> Floats:
    """(N, 3) the middle of the points in each voxel."""
    if len(points) == 0:
        return points
    cells = np.floor(points / VOXEL_M).astype(np.int64)
    _, which, counts = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    sums = np.zeros((len(counts), 3))
    np.add.at(sums, which.reshape(-1), points)
    return np.asarray(sums / counts[:, None])


def middle_pixel(mask: NDArray[np.bool_]) -> tuple[int, int]:
    """The pixel (u, v) that lies deepest in a mask: where a person would click."""
    depth = ndimage.distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1]
    v, u = np.unravel_index(int(np.argmax(depth)), mask.shape)
    return int(u), int(v)


def ragged(mask: NDArray[np.bool_]) -> dict[str, NDArray[np.bool_]]:
    """A mask grown, shrunk and shifted by 3 px."""
    round_ = np.hypot(*np.mgrid[-_SHIFT_PX : _SHIFT_PX + 1, -_SHIFT_PX : _SHIFT_PX + 1])
    disc = round_ <= _SHIFT_PX + 0.5
    return {
        "grown": ndimage.binary_dilation(mask, disc),
        "shrunk": ndimage.binary_erosion(mask, disc),
        "shifted": ndimage.shift(mask.astype(np.uint8), (_SHIFT_PX, _SHIFT_PX), order=0) > 0,
    }


__all__ = ["FIRST_OBJECT", "Judged", "Labeled", "middle_pixel", "ragged"]
