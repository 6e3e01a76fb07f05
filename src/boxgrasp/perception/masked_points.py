"""The points under a mask as detectors give it: ragged, of two things, of all but the thing.

A mask overrides the segmentation. Where it covers two things, the image between them says whether
they are apart: a gap that is seen through joins nothing, what stands before it may hide that they
are one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Bools, readonly
from boxgrasp.errors import CodedWarning, TargetError
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels.cells import euclidean_clusters
from boxgrasp.kernels.nearest import nearest
from boxgrasp.kernels.table_cells import dilated
from boxgrasp.perception.hollow_things import SAME_TOP_M, top
from boxgrasp.perception.scene import TABLE, Scene

Rows = NDArray[np.int64]


@dataclass(frozen=True)
class MaskParams:
    """What a mask of one thing may look like.

    Measured with the true masks of 45 labeled real captures (112 of 400 pixels and more) and of 56
    ugly tables (benchmarks/ugly_scenes.py --grasps: 253 of 1500 and more), and with masks
    made of them: two together, inverted, and without their lower 30 to 60 %.

    Attributes:
        join_m: up to which parts under a mask are one piece, m.
        part_share: of the largest part's points, from which a second one is told: the bleed of a
            mask is less.
        apart_m: from which two parts do not touch, m: three voxels.
        through_px: pixels seen through the gap between two parts, from which they are two things. A
            right mask has up to 2.
        hidden_share: of the pixels between two parts that show neither, those that something nearer
            may take up; with more of them the parts may be one thing behind it.
        background_share: of the pixels that show table or background, those that a mask may cover.
            A right mask covers up to 1 % on real captures, an inverted one 99 %. Its share of the
            image says less: a near thing may fill most of it.
        inverted_share: of an object's points that an inverted mask leaves out at least.
        piece_share: of the main part's points that another piece of the same object has at least:
            less is a speck.
        middle_share: of a thing's half lengths in plan, up to which its middle reaches.
        deep_share: of a hollow thing's height, up to which its middle is filled. Bowls and mugs
            have 0.02 to 0.24, solid things seen aslant 0.39 and more.
        covered_share: of a hollow thing's points that a mask of its inside holds at least.
        across_share: of a hollow thing's breadth across the view that such a mask spans at least: a
            mask of what lies in the thing does not.
        ragged_share: of the image's width, by which a mask's outline may be off: 4 px of 640. Of
            masks shrunk by 3 px of 640 80 % are answered, 46 % without it.
        rim_m: from a mask's points, where what it leaves out may be the target's too, m. Of masks
            shrunk by 3 px 98 % of what is answerable is answered on the captures; with 8 mm 91 %.
    """

    join_m: float = 0.03
    part_share: float = 0.25
    apart_m: float = 0.01
    through_px: int = 3
    hidden_share: float = 0.2
    background_share: float = 0.5
    inverted_share: float = 0.8
    piece_share: float = 0.02
    middle_share: float = 0.3
    deep_share: float = 0.3
    covered_share: float = 0.35
    across_share: float = 0.8
    ragged_share: float = 4 / 640
    rim_m: float = 0.016


@dataclass(frozen=True, eq=False)
class MaskedPoints:
    """What a mask means.

    Attributes:
        target_mask: (K,) bool, which of the scene's points are the target's.
        rim_mask: (K,) bool, those that may be the target's or of what touches it.
        warnings: what the user should know of the mask.
    """

    target_mask: Bools
    rim_mask: Bools
    warnings: tuple[CodedWarning, ...]


def masked_points(scene: Scene, mask: Bools, params: MaskParams = MaskParams()) -> MaskedPoints:
    """The points of the thing under a mask.

    They are those mostly under it. Of pieces that lie apart the largest counts, so that bleed falls
    off, with those of the same object that are not seen to be apart. A hollow thing is completed
    where the mask lost a wall before its inside.

    Args:
        scene: its K points, and which pixels show them.
        mask: (H, W) bool, or (N,) beside the points of an unorganized cloud.
        params: what is told.

    Returns:
        The points, the rim of a ragged mask, and warnings.

    Raises:
        TargetError: the mask shows no depth, nothing over the support plane, most of the table and
            background, or two things with free space seen between them.
    """
    masked = _Masked(scene, mask, scene.points_under(mask), params)
    masked.validate_cover()
    parts = _Parts.of(scene, masked.under, params)
    warnings = masked.told(parts)
    target = np.zeros(len(masked.under), dtype=np.bool_)
    target[parts.rows[parts.piece == parts.piece_of[0]]] = True
    if parts.number_of[0] > 0:
        target[masked.joined(parts)] = True
        whole = scene.object_numbers == parts.number_of[0]
        if _is_hollow_but_a_wall(scene, whole, target, params):
            target |= whole
    return MaskedPoints(readonly(target), readonly(_rim(scene, mask, target, params)), warnings)


def _rim(scene: Scene, mask: Bools, target: Bools, params: MaskParams) -> Bools:
    """(K,) points of the target's own clusters beside it, in space or in the image."""
    near: Bools = np.zeros(len(target), dtype=np.bool_)
    if mask.ndim == 2:
        rings = max(1, round(params.ragged_share * mask.shape[1]))
        near = scene.points_under(dilated(mask, rings))
    rows = np.flatnonzero(np.isin(scene.clusters, scene.clusters[target]) & ~target)
    own = np.ascontiguousarray(scene.points[target])
    others = np.ascontiguousarray(scene.points[rows])
    away_m = np.linalg.norm(others - own[nearest(others, own)], axis=1)
    rim = np.zeros(len(target), dtype=np.bool_)
    rim[rows] = near[rows] | (away_m <= params.rim_m)
    return rim


@dataclass(frozen=True, eq=False)
class _Parts:
    """Points under a mask by piece and object: the main part first, the largest of its piece.

    Attributes:
        rows: (n,) rows of the scene's points under the mask.
        piece: (n,) which points hang together.
        part: (n,) which part each belongs to.
        count: (P,) points of each part.
        piece_of: (P,) each part's piece.
        number_of: (P,) each part's object number, 0 for no object.
    """

    rows: Rows
    piece: Rows
    part: Rows
    count: Rows
    piece_of: Rows
    number_of: Rows

    @classmethod
    def of(cls, scene: Scene, under: Bools, params: MaskParams) -> _Parts:
        """The parts of some points; the largest piece has the main one."""
        rows = np.flatnonzero(under)
        piece = euclidean_clusters(np.ascontiguousarray(scene.points[rows]), params.join_m)
        names = len(scene.objects) + 1
        keys = piece * names + scene.object_numbers[rows]
        found, part, count = np.unique(keys, return_inverse=True, return_counts=True)
        order = np.lexsort((-count, found // names != np.bincount(piece).argmax()))
        found, place = found[order], np.argsort(order)
        return cls(rows, piece, place[part], count[order], found // names, found % names)

    def rows_of(self, part: int) -> Rows:
        """Rows of one part's points."""
        return np.asarray(self.rows[self.part == part])


@dataclass(frozen=True)
class _Gap:
    """What lies between two parts.

    Attributes:
        width_m: between their nearest points, m.
        through_px: pixels between these that show what is behind the gap.
        hiding_px: those that show what is before it.
    """

    width_m: float
    through_px: int
    hiding_px: int

    def is_hidden(self, params: MaskParams) -> bool:
        """Whether something before the gap may hide that the parts are one thing."""
        return self.hiding_px > params.hidden_share * (self.through_px + self.hiding_px)

    def is_free(self, params: MaskParams) -> bool:
        """Whether the parts are seen to be apart."""
        seen = self.through_px >= params.through_px and not self.is_hidden(params)
        return seen and self.width_m >= params.apart_m


@dataclass(frozen=True, eq=False)
class _Masked:
    """A scene under a mask.

    Attributes:
        scene: its K points.
        mask: as it was given.
        under: (K,) bool, the points mostly under it.
        params: what is told.
    """

    scene: Scene
    mask: Bools
    under: Bools
    params: MaskParams

    def validate_cover(self) -> None:
        """Refuse a mask of nothing, and one of the background."""
        measured, background = self.scene.measured_under(self.mask)
        if measured == 0:
            raise TargetError("mask covers no pixel with depth; valid: True on an object")
        if background > self.params.background_share:
            out = self._left_out()
            why = f": all but object {out[0]}, so it looks inverted" if len(out) == 1 else ""
            raise TargetError(
                f"mask covers {self.mask.mean():.0%} of the image and {background:.0%} of the "
                f"table and background{why}; valid: True on the target's pixels alone"
            )
        if not self.under.any():
            raise TargetError(
                "mask covers nothing above the support plane; valid: True on an object"
            )

    def _left_out(self) -> list[int]:
        """The numbers of the objects that are mostly not under the mask."""
        numbers = self.scene.object_numbers
        of = np.bincount(numbers, minlength=len(self.scene.objects) + 1)
        left = np.bincount(numbers[~self.under], minlength=len(of))
        inverted = 1 + np.flatnonzero(left[1:] >= self.params.inverted_share * of[1:])
        return [int(number) for number in inverted]

    def told(self, parts: _Parts) -> tuple[CodedWarning, ...]:
        """What to warn of where there are two parts; refused where they are seen to be apart."""
        second = int(np.argmax(np.append(0, parts.count[1:])))
        if second == 0 or parts.count[second] < self.params.part_share * parts.count[0]:
            return ()
        gap = self._gap(parts.rows_of(0), parts.rows_of(second))
        numbers = parts.number_of[[0, second]].tolist()
        known = " and ".join(f"object {number}" for number in dict.fromkeys(numbers) if number)
        if gap.is_free(self.params):
            raise TargetError(
                f"mask covers two things {gap.width_m * 100:.0f} cm apart"
                f"{f' ({known})' if known else ''}; valid: True on one thing"
            )
        apart = gap.width_m >= self.params.apart_m
        if numbers[0] == numbers[1] or 0 in numbers or (apart and gap.is_hidden(self.params)):
            return ()
        how = f"{gap.width_m * 100:.0f} cm apart" if apart else "which touch"
        one = parts.piece_of[0] == parts.piece_of[second]
        what = "both are the target" if one else f"object {numbers[0]} is the target"
        return (CodedWarning("mask_over_two", f"the mask covers {known}, {how}: {what}"),)

    def joined(self, parts: _Parts) -> Rows:
        """Rows of other pieces of the main part's object that are not seen to be apart from it."""
        same = (parts.number_of == parts.number_of[0]) & (parts.piece_of != parts.piece_of[0])
        same &= parts.count >= self.params.piece_share * parts.count[0]
        main = parts.rows_of(0)
        others = [parts.rows_of(part) for part in np.flatnonzero(same).tolist()]
        kept = [rows for rows in others if not self._gap(main, rows).is_free(self.params)]
        return np.concatenate([main, *kept])

    def _gap(self, first: Rows, second: Rows) -> _Gap:
        """What lies between some of the scene's points and others."""
        scene = self.scene
        a, b = (np.ascontiguousarray(scene.points[rows]) for rows in (first, second))
        to = nearest(a, b)
        widths_m = np.linalg.norm(a - b[to], axis=1)
        k = int(np.argmin(widths_m))
        pixels, along = scene.pixels_between(int(first[k]), int(second[to[k]]))
        shown = scene.rows_at(pixels)
        behind = (shown == TABLE) & ~self.mask.reshape(-1)[pixels]
        other = (shown >= 0) & ~self.under[np.maximum(shown, 0)]
        camera = scene.camera_position_m
        if camera is not None:
            ranges_m = np.linalg.norm(scene.points[np.maximum(shown, 0)] - camera, axis=1)
            ends_m = np.linalg.norm(np.stack((a[k], b[to[k]])) - camera, axis=1)
            # In an image the inverse of depth changes evenly along a straight line.
            farther = ranges_m >= 1 / ((1 - along) / ends_m[0] + along / ends_m[1])
            behind |= other & farther
        before = other & ~behind
        return _Gap(
            float(widths_m[k]), int(np.count_nonzero(behind)), int(np.count_nonzero(before))
        )


def _is_hollow_but_a_wall(scene: Scene, whole: Bools, held: Bools, params: MaskParams) -> bool:
    """Whether an object is a hollow thing, and points held of it lack no more than a near wall."""
    own = held[whole]
    camera = scene.camera_position_m
    if own.all() or own.mean() < params.covered_share or camera is None:
        return False
    T_table_base = invert(scene.T_base_table)
    points = transform(T_table_base, scene.points[whole])
    points[:, 2] = scene.supports.heights(points)
    if top(points) - top(points[own]) > SAME_TOP_M:
        return False
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    middle = (low + high) / 2
    ahead = middle - transform(T_table_base, camera[None])[0, :2]
    across = points[:, :2] @ np.array((-ahead[1], ahead[0]))
    if np.ptp(across[own]) < params.across_share * np.ptp(across):
        return False
    amid = np.all(np.abs(points[:, :2] - middle) <= params.middle_share * (high - low) / 2, axis=1)
    return bool(amid.any() and np.median(points[amid, 2]) <= params.deep_share * top(points))
