"""What is true of a simulated scene: candidates of the true box, clearances, widths, approaches.

Independent of the code that it judges: it shares only the conventions of docs/conventions.md.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import SceneError
from boxgrasp.geometry.hand_distance import CAP_M
from boxgrasp.geometry.transforms import make_transform, rotation_z
from boxgrasp.grasps.candidates import LINES
from boxgrasp.grasps.checks import ChecksConfig
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.simulate.distance import boxes_to_solids
from boxgrasp.simulate.primitives import Box, Cylinder, Plane, Primitive
from boxgrasp.simulate.scenes import TableScene

_BACK_M = ChecksConfig.pregrasp_distance_m


@dataclass(frozen=True, eq=False)
class TrueCandidates:
    """The M candidates of the true box, in the order of their labels.

    Attributes:
        label: (M,) int64.
        face: (M,) int64, 1 to 5.
        line: (M,) int64, 1 to l.
        T_base_gripper: (M, 4, 4) float64, m.
        width_m: (M,) float64, the true box's size between the fingers, m.
    """

    label: NDArray[np.int64]
    face: NDArray[np.int64]
    line: NDArray[np.int64]
    T_base_gripper: Floats
    width_m: Floats


@dataclass(frozen=True, eq=False)
class CandidateTruth:
    """Exact numbers of M gripper poses, hidden sides included; each (M,), m.

    Attributes:
        clearance_m: gripper's boxes to the nearest obstacle, 0 inside and where one stands between
            the fingers.
        plane_clearance_m: signed height of its lowest corner over the table.
        approach_clearance_m: clearance of the box swept back to the pregrasp.
        width_m: the target's true extent along the finger opening.
        off_center_m: the middle of that extent from the gripper's middle.
        fits: bool, width_m is no more than the opening.
    """

    clearance_m: Floats
    plane_clearance_m: Floats
    approach_clearance_m: Floats
    width_m: Floats
    off_center_m: Floats
    fits: NDArray[np.bool_]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """(M,) bool: fits, stays off the table and touches nothing on the way."""
        return self.fits & (self.plane_clearance_m > 0) & (self.approach_clearance_m > 0)

    @property
    def best_m(self) -> float:
        """Largest clearance of the valid poses, 0 where none is."""
        return float(np.max(self.clearance_m[self.valid], initial=0.0))


def box_clearance(
    T_base_gripper: Floats, dimensions_m: Floats, primitives: Sequence[Primitive]
) -> Floats:
    """Exact distance of gripper boxes from the nearest primitive.

    Args:
        T_base_gripper: (M, 4, 4) poses of the boxes' centers.
        dimensions_m: (3,) full lengths of a box, m.
        primitives: what is there, base frame.

    Returns:
        (M,) float64, m, 0 inside; infinity where there is no primitive.
    """
    boxes = np.asarray(T_base_gripper, dtype=np.float64).reshape(-1, 4, 4)
    out = boxes_to_solids(boxes, dimensions_m, [p for p in primitives if not isinstance(p, Plane)])
    low, high = _heights(boxes, dimensions_m)
    for plane in (p for p in primitives if isinstance(p, Plane)):
        out = np.minimum(
            out, np.maximum(np.maximum(low - plane.height_m, plane.height_m - high), 0)
        )
    return out


def true_box(scene: TableScene, *, mode: str = "yaw") -> tuple[Floats, Floats]:
    """The target's true box.

    Args:
        scene: any.
        mode: `aligned`, along the base's axes (thesis section 2-2), or `yaw`, turned with a box by
            (-45, 45] degrees; whatever holds a cylinder stays unturned.

    Returns:
        T_base_box (4, 4) at its center, and dimensions_m (3,) along its x, y, z.

    Raises:
        SceneError: another mode.
    """
    if mode not in ("aligned", "yaw"):
        raise SceneError(f"box mode is {mode!r}; valid: aligned, yaw")
    yaw = 0.0
    if mode == "yaw" and all(isinstance(solid, Box) for solid in scene.target):
        first = scene.target[0].T_base_solid
        yaw = float(np.arctan2(first[1, 0], first[0, 0]))
        yaw -= np.ceil(yaw / (np.pi / 2) - 0.5) * (np.pi / 2)
    R = rotation_z(yaw)
    ranges = np.array([[_extent(scene.target, axis) for axis in R.T]])[0]
    return (
        readonly(make_transform(R, R @ ranges.mean(axis=1))),
        readonly(ranges[:, 1] - ranges[:, 0]),
    )


def true_candidates(
    scene: TableScene, *, lines: int = LINES, gripper: Gripper | None = None, mode: str = "yaw"
) -> TrueCandidates:
    """The 5 l candidates of the target's true box (faces, lines: docs/conventions.md).

    Args:
        scene: any.
        lines: l, lines a face.
        gripper: the hand; None for the default one.
        mode: as `true_box` takes it.

    Returns:
        Poses and widths, in the order of their labels.

    Raises:
        SceneError: another mode.
    """
    hand = Gripper() if gripper is None else gripper
    T_base_box, size = true_box(scene, mode=mode)
    x, y, z = T_base_box[:3, :3].T
    middle = T_base_box[:3, 3]
    strips = (np.arange(lines) + 0.5) / lines - 0.5
    # Outward normal, finger opening, direction in which the lines follow each other, their span.
    faces = (
        (y, x, z, size[1], size[2], size[0]),
        (-x, y, z, size[0], size[2], size[1]),
        (-y, -x, z, size[1], size[2], size[0]),
        (z, y, x, size[2], size[0], size[1]),
        (z, x, y, size[2], size[1], size[0]),
    )
    poses, widths = [], []
    for normal, opening, step, depth, span, width in faces:
        for strip in strips:
            R = np.column_stack([-normal, opening, np.cross(-normal, opening)])
            out = normal * (depth / 2 + hand.standoff_m)
            poses.append(make_transform(R, middle + out + step * (strip * span)))
            widths.append(width)
    face = np.repeat(np.arange(1, 6), lines)
    line = np.tile(np.arange(1, lines + 1), 5)
    return TrueCandidates(
        readonly((face - 1) * lines + line),
        readonly(face),
        readonly(line),
        readonly(np.array(poses)),
        readonly(np.array(widths)),
    )


def candidate_truth(
    scene: TableScene, T_base_gripper: Floats, *, gripper: Gripper | None = None
) -> CandidateTruth:
    """Exact truth of any gripper poses in a scene.

    Args:
        scene: any.
        T_base_gripper: (M, 4, 4) poses of the gripper's box.
        gripper: the hand; None for the default one.

    Returns:
        Distances capped at 0.50 m, widths, and whether they fit.
    """
    hand = Gripper() if gripper is None else gripper
    poses = np.asarray(T_base_gripper, dtype=np.float64).reshape(-1, 4, 4)
    obstacles = scene.obstacles
    clearance, approach, low = np.full((3, len(poses)), np.inf)
    for at_m, dims in _parts(hand):
        part = _moved(poses, at_m)
        swept = _moved(poses, at_m - np.array((_BACK_M / 2, 0.0, 0.0)))
        longer = dims + (_BACK_M, 0.0, 0.0)
        clearance = np.minimum(clearance, box_clearance(part, dims, obstacles))
        approach = np.minimum(approach, box_clearance(swept, longer, obstacles))
        low = np.minimum(low, _heights(part, dims)[0])
    if hand.palm:
        at_m, dims = _gap(hand)
        within = box_clearance(_moved(poses, at_m), dims, obstacles)
        clearance = np.where(within <= 0.0, 0.0, clearance)
    extents = np.array([_extent(scene.target, T[:3, 1]) for T in poses]).reshape(-1, 2)
    width = extents[:, 1] - extents[:, 0]
    middle = np.einsum("mi,mi->m", poses[:, :3, 1], poses[:, :3, 3])
    return CandidateTruth(
        clearance_m=readonly(np.minimum(clearance, CAP_M)),
        plane_clearance_m=readonly(low - scene.table_height_m),
        approach_clearance_m=readonly(np.minimum(approach, CAP_M)),
        width_m=readonly(width),
        off_center_m=readonly(extents.mean(axis=1) - middle),
        fits=readonly(width <= hand.fingers_open_m + 1e-9),
    )


def _parts(hand: Gripper) -> list[tuple[Floats, Floats]]:
    """Middle in the gripper's frame and sizes of each box of a hand, m."""
    if not hand.palm:
        return [(np.zeros(3), np.array([hand.length_m, hand.width_m, hand.thickness_m]))]
    closer_m = (hand.max_opening_m - hand.fingers_open_m) / 2
    found = []
    for box, side in [(b, 0) for b in hand.palm] + [(b, s) for s in (1, -1) for b in hand.finger]:
        ends = np.array([box.x_m, box.y_m, box.z_m])
        middle, size = ends.mean(axis=1), ends[:, 1] - ends[:, 0]
        middle[0] -= hand.length_m / 2
        if side:
            middle[1] = side * (middle[1] - closer_m)
        found.append((middle, size))
    return found


def _gap(hand: Gripper) -> tuple[Floats, Floats]:
    """The same of the space between the fingers, back to the palm."""
    tip, off = hand.length_m / 2, np.array([box.z_m for box in hand.finger])
    front = tip - hand.finger_length_m
    middle = np.array([(front + tip) / 2, 0.0, (off.min() + off.max()) / 2])
    return middle, np.array([tip - front, hand.fingers_open_m, off.max() - off.min()])


def _moved(poses: Floats, by_m: Floats) -> Floats:
    moved = poses.copy()
    moved[:, :3, 3] += poses[:, :3, :3] @ by_m
    return moved


def _heights(boxes: Floats, dimensions_m: Floats) -> tuple[Floats, Floats]:
    """(M,) m, lowest and highest z of oriented boxes."""
    reach = np.abs(boxes[:, 2, :3]) @ (np.asarray(dimensions_m, dtype=np.float64) / 2)
    return boxes[:, 2, 3] - reach, boxes[:, 2, 3] + reach


def _extent(solids: Sequence[Box | Cylinder], direction: Floats) -> tuple[float, float]:
    """Lowest and highest coordinate of the solids along a unit direction, m."""
    low, high = np.inf, -np.inf
    for solid in solids:
        local = solid.T_base_solid[:3, :3].T @ direction
        half = solid.half_size
        if isinstance(solid, Box):
            reach = float(np.abs(local) @ half)
        else:
            reach = half[0] * float(np.hypot(local[0], local[1])) + half[2] * abs(float(local[2]))
        center = float(direction @ solid.T_base_solid[:3, 3])
        low, high = min(low, center - reach), max(high, center + reach)
    return low, high
