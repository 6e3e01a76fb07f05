"""What a gripper pose holds of a target, by exact surfaces, hidden sides included.

Independent of the check `holds`, which counts what is seen between the fingers: here lines along
the opening are cast against the solids, and where they run through matter says what the fingers
meet as they close.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, readonly
from boxgrasp.geometry.transforms import invert
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.kernels.raycast import raycast
from boxgrasp.simulate.camera import SolidsSeen, half_size
from boxgrasp.simulate.primitives import Solids

TIP_M = 0.015  # the fingers' last stretch: their pads
MIDDLE_M = 0.010  # of a pad from the hand's mid-plane
GIVE_M = 0.003  # of a pad: it touches what lies no deeper behind its first touch
LEAST_M2 = 0.5e-4  # of a pad on the target; one end of a pencil has as much

_PAD_CELL_M = 0.001  # between the lines through a pad
_FINGER_CELL_M = 0.002  # between those through the fingers
_TOUCH_M = 1e-6  # of matter in a finger: less is contact
_PAST_M = 1e-9  # a line goes on behind the surface that it met


@dataclass(frozen=True, eq=False)
class HoldTruth:
    """What M gripper poses hold of a target; areas as seen along the finger opening.

    Attributes:
        contact_m2: (M, 2) of the pads, in the middle, that the target touches as the fingers close:
            the finger at negative y, then the other; m2.
        middle_m2: (M,) of the pads, in the middle, that have the target between them, m2.
        between_m2: (M,) the same over the hand's whole thickness, m2.
        inside_m2: (M,) of the open fingers, over their whole length, that stand in the target, m2.
    """

    contact_m2: Floats
    middle_m2: Floats
    between_m2: Floats
    inside_m2: Floats

    @property
    def on_air(self) -> NDArray[np.bool_]:
        """(M,) bool: the fingertips close on nothing of it."""
        return self.between_m2 < LEAST_M2

    @property
    def touching(self) -> NDArray[np.bool_]:
        """(M,) bool: an open finger stands in it."""
        return self.inside_m2 > 0.0

    @property
    def by_edge(self) -> NDArray[np.bool_]:
        """(M,) bool: it is between open fingers, but not in their middle."""
        return ~self.on_air & ~self.touching & (self.middle_m2 < LEAST_M2)

    @property
    def holds(self) -> NDArray[np.bool_]:
        """(M,) bool: it is between open fingers, in their middle."""
        return ~self.touching & (self.middle_m2 >= LEAST_M2)

    @property
    def glancing(self) -> NDArray[np.bool_]:
        """(M,) bool: held, but so that a pad touches a strip alone: on a slope, a cap, a corner."""
        return np.asarray(self.holds & (self.contact_m2.min(axis=1) < LEAST_M2))


def hold_truth(
    solids: Solids, T_base_gripper: Floats, *, gripper: Gripper | None = None
) -> HoldTruth:
    """What the fingers hold of a target when they close at any gripper poses.

    Args:
        solids: the target's own, base frame; none may be a plane. Hollow ones may be pinched by
            their wall: a finger that stands in the hollow is not in the target.
        T_base_gripper: (M, 4, 4) poses of the gripper's box.
        gripper: the hand; None for the default one.

    Returns:
        Areas, and what follows from them.
    """
    hand = Gripper() if gripper is None else gripper
    poses = np.asarray(T_base_gripper, dtype=np.float64).reshape(-1, 4, 4)
    found = [(*_tips(solids, T, hand), _inside(solids, T, hand)) for T in poses]
    areas = np.array(found, dtype=np.float64).reshape(-1, 5)
    contacts, rest = readonly(areas[:, :2]), readonly(areas[:, 2:].T)
    return HoldTruth(contacts, *rest)


def _tips(solids: Solids, T: Floats, hand: Gripper) -> tuple[float, float, float, float]:
    """Contact of the pad at negative y, of the other, and `middle_m2` and `between_m2`."""
    end, half = hand.length_m / 2, hand.fingers_open_m / 2
    off = [z for box in hand.finger for z in box.z_m] or [
        -hand.thickness_m / 2,
        hand.thickness_m / 2,
    ]
    at, cell_m2 = _grid((max(end - TIP_M, -end), end), (min(off), max(off)), _PAD_CELL_M)
    line, low, high = _matter(solids, T, at)
    between = (low < half) & (high > -half)
    line, low, high = line[between], low[between], high[between]
    middle = np.abs(at[:, 1]) <= MIDDLE_M
    filled = np.zeros(len(at), dtype=np.bool_)
    filled[line] = True
    cells = []
    for near in (low + half, half - high):  # how far a finger moves until it is there
        way = np.full(len(at), np.inf)
        np.minimum.at(way, line, near)
        own = way[middle & filled & (way >= -_TOUCH_M)]
        cells.append(np.count_nonzero(own <= own.min(initial=np.inf) + GIVE_M))
    areas = np.array([*cells, (middle & filled).sum(), filled.sum()]) * cell_m2
    return float(areas[0]), float(areas[1]), float(areas[2]), float(areas[3])


def _inside(solids: Solids, T: Floats, hand: Gripper) -> float:
    """Area of both open fingers that stand in the solids, m2."""
    back, closer_m = hand.length_m / 2, (hand.max_opening_m - hand.fingers_open_m) / 2
    boxes = [(box.x_m, box.y_m, box.z_m) for box in hand.finger]
    if not boxes:  # one box: all of it beyond the opening
        out, off = hand.width_m / 2 + closer_m, hand.thickness_m / 2
        boxes = [((0.0, 2 * back), (hand.max_opening_m / 2, out), (-off, off))]
    area_m2 = 0.0
    for x, y, z in boxes:
        at, cell_m2 = _grid((x[0] - back, x[1] - back), z, _FINGER_CELL_M)
        line, low, high = _matter(solids, T, at)
        inner, outer = y[0] - closer_m, y[1] - closer_m
        left = (high > -outer) & (low < -inner - _TOUCH_M)
        right = (low < outer) & (high > inner + _TOUCH_M)
        area_m2 += (len(np.unique(line[left])) + len(np.unique(line[right]))) * cell_m2
    return area_m2


def _grid(
    x_m: tuple[float, float], z_m: tuple[float, float], cell_m: float
) -> tuple[Floats, float]:
    """(N, 2) x and z of the middles of equal cells over a finger, and the area of one, m2."""
    counts = [max(round((stop - start) / cell_m), 1) for start, stop in (x_m, z_m)]
    x, z = (
        start + (np.arange(count) + 0.5) / count * (stop - start)
        for count, (start, stop) in zip(counts, (x_m, z_m), strict=True)
    )
    cell_m2 = (x_m[1] - x_m[0]) * (z_m[1] - z_m[0]) / (counts[0] * counts[1])
    return np.stack(np.meshgrid(x, z, indexing="ij"), axis=-1).reshape(-1, 2), cell_m2


def _matter(
    solids: Solids, T_base_hand: Floats, at: Floats
) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Where lines along the hand's y run through matter, solid by solid.

    Args:
        solids: P of them.
        T_base_hand: (4, 4).
        at: (N, 2) x and z of the lines, hand frame, m.

    Returns:
        (S,) line, (S,) lowest and (S,) highest y of each stretch, m.
    """
    T_solid_hand = np.array([invert(T) @ T_base_hand for T in solids.T_base_solid])
    T_solid_hand = T_solid_hand.reshape(-1, 4, 4)
    middles = np.array([invert(T)[:3, 3] for T in T_solid_hand]).reshape(-1, 3)
    halves = [half_size(kind, s) for kind, s in zip(solids.kinds, solids.sizes, strict=True)]
    reach = np.linalg.norm(np.array(halves).reshape(-1, 3), axis=1)
    away = np.linalg.norm(middles[:, None, [0, 2]] - at, axis=2)
    solid, line = np.nonzero(away <= reach[:, None])  # the others miss
    y = middles[solid, 1] - reach[solid] - _PAST_M  # before its solid
    poses = T_solid_hand[solid]
    starts = np.column_stack([at[line, 0], y, at[line, 1]])
    poses[:, :3, 3] += np.einsum("kij,kj->ki", poses[:, :3, :3], starts)
    poses[:, :3, :3] = poses[:, :3, [2, 0, 1]]  # a camera that looks along the hand's y
    rays = SolidsSeen(solids.kinds[solid], poses, solids.sizes[solid])
    going, gone = np.arange(len(line)), np.zeros(len(line))
    found: list[Floats] = [np.empty((3, 0))]
    while len(going):  # into matter and out of it again
        low = _onward(rays, going, gone[going])
        going, low = going[np.isfinite(low)], low[np.isfinite(low)]
        high = _onward(rays, going, low + _PAST_M)
        out = np.isfinite(high)
        going, low, high = going[out], low[out], high[out]
        gone[going] = high + _PAST_M
        found.append(np.stack([line[going], y[going] + low, y[going] + high]))
    lines, lows, highs = np.concatenate(found, axis=1)
    return lines.astype(np.int64), lows, highs


def _onward(rays: SolidsSeen, which: NDArray[np.int64], gone_m: Floats) -> Floats:
    """(K,) how far some rays have gone at the next surface of their solid, m; infinity for none."""
    kinds, rotations, origins, sizes = rays.arrays
    count = len(which)
    starts = origins[which] + gone_m[:, None] * rotations[which, :, 2]
    pixels = np.arange(count)
    own = np.column_stack([pixels, pixels + 1, 0 * pixels, 0 * pixels + 1])  # a solid a pixel
    parallel = np.array([np.inf, np.inf, 0.0, 0.0])  # of so long a focal length rays are parallel
    ahead, met = np.empty((1, count)), np.empty((1, count), dtype=np.int32)
    raycast(
        readonly(kinds[which]), rotations[which], starts, readonly(sizes[which]), own, parallel,
        0, 1, ahead, met,
    )  # fmt: skip
    return np.asarray(gone_m + ahead[0])
