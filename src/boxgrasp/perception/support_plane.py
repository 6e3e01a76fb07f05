"""The support plane: the level plane that carries the objects, not the largest one in view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.errors import SceneError
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import invert, make_transform, transform
from boxgrasp.kernels.levels import on_and_under, patch_moments
from boxgrasp.kernels.plane import plane_sums, plane_votes
from boxgrasp.sensing.sensor_model import XTION, SensorModel

# Found on cast scenes and on the real captures that the tests read.
_SAMPLE = 1500  # points tell the planes as well as all
_DENSE = 20_000  # points for the last fit
_ENOUGH = 1000  # of them
_PROPOSALS = 240  # triples of points drawn: with 120 a small desk was missed in 4 of 24 samples
_DRAWN = 30  # points from which the other two of a triple are taken
_TRIPLE_M = (0.03, 0.30)  # m from the first point to the others: less is noise, more another thing
_LEAST_AREA_M2 = 1e-6  # m2 that a triple spans
_MOST_PLANES = 4  # to choose from
_TRIES = 6  # best proposals looked at
_LEAST_VOTES = (30, 0.02)  # points of the sample that a plane holds, and the share of them
_FEWEST_FITTED = 10  # points for a least-squares fit
_ALIKE = np.cos(np.deg2rad(15.0))  # of the angle up to which two planes may be the same
_COARSE_M = 0.015  # m, what a plane through three noisy points may be off
_FINE_M = 0.008  # m, what points on a fitted plane may be off
_STRADDLED_M = 0.03  # m from a plane: as far apart are two tables that it may lie between
_PATCHED = 7_000  # points tell the slopes as well as all
_SLOPE_CELL_M = 0.08  # m, patches of the surface whose slopes are taken
_LEAST_PATCH = 8  # points of such a patch
_FEWEST_PATCHES = 12  # for their median
_ONE_LEVEL_M = 0.005  # m, within which the patches of one table lie
_TURN_GAIN = 1.1  # patches that must lie so, turned, for each that does as it is
_CARRIED_M = (0.015, 0.30)  # m over the plane, where things on it are looked for
_CARRIED_NOISE = 4  # standard deviations of the depth that the lower of them is raised by
_CELL_M = 0.05  # m, cells in which a plane's patch was seen
_MOST_CELLS = 2000  # along an axis: a plane seen over 100 m is damaged data
_RIM_CELLS = 3  # beyond the seen patch, for what stands on the hidden rim
_PATCH_SAMPLE = 4_000  # points tell the patch
_UNDER_SHARE = 0.6  # of the points on a plane, from which points under it say that it is none
_FAIR_SHARE = 0.3  # of the largest plane's points that another one must hold
_DESK_SHARE = 0.05  # that a desk over such a plane must hold
_DESK_M = 0.3  # m, its height over it at least
_DESK_LEVEL = np.cos(np.deg2rad(8.0))  # of the angle between the two at most
_FEWEST_CARRIED = 4  # points of the sample: fewer are noise
_LEAST_PATCH_M2 = 0.05  # m2, of a table
_TILT_GIVEN = np.cos(np.deg2rad(12.0))  # of the angle to `up`
_TILT_CAMERA = np.sin(np.deg2rad(25.0))  # how far a plane may face down in the image
_TILT_UPRIGHT = np.sin(np.deg2rad(15.0))  # how far it must face up in it, unless none does
_UPRIGHT_SHARE = 0.1  # of the largest plane's points that one must hold that faces up
_LAID = 0.05  # of an axis' length, laid on the plane, from which it tells a direction


def find_support_plane(
    points: Points,
    up: Floats | None,
    camera_position_m: Floats | None,
    max_range_m: float,
    sensor: SensorModel = XTION,
) -> Plane:
    """RANSAC over local proposals, the one that carries the objects, a refit (appendix A).

    Args:
        points: (N, 3) float32, m, in the camera frame, or in any frame where `up` is known.
        up: (3,) unit vector against gravity in the points' frame; None for a camera frame of
            unknown tilt, where planes that face downwards in the image are left out.
        camera_position_m: (3,) in the points' frame, m, or None where it is unknown.
        max_range_m: how far from the camera objects are looked for, m.
        sensor: whose noise the points have.

    Returns:
        The plane, in the points' frame.

    Raises:
        SceneError: no plane of a plausible tilt holds enough points.
    """
    sample = np.array(points[:: max(1, len(points) // _SAMPLE)])
    # 1. The planes that hold most points of a sample.
    planes = _planes_in(sample, _Side(up, camera_position_m))
    if not planes:
        raise SceneError(
            "no support plane found; valid: a view with a level surface under the objects"
        )
    # 2. The one of them that carries most.
    chosen = _choose(planes, _all_carried(sample, planes, camera_position_m, max_range_m, sensor))
    # 3. The same plane through many points near the objects, and through one level alone.
    dense = _dense(points, camera_position_m, max_range_m)
    plane = fitted_plane(dense, chosen, (_COARSE_M,))
    if plane is not None:
        plane = fitted_plane(dense, _on_one_level(dense, plane), (_FINE_M, _FINE_M))
    if plane is None:
        plane = chosen
    if not _opaque(plane, dense):
        raise SceneError(
            "no support plane found: points lie under the best one as on it; valid: a view with a "
            "level surface under the objects"
        )
    return Plane(readonly(plane[:3].copy()), float(plane[3]))


@dataclass(frozen=True, eq=False)
class _Side:
    """From where a plane must be seen from above, as far as that is known; (3,), source frame."""

    up: Floats | None
    camera_position_m: Floats | None

    def plausible(self, planes: Floats) -> NDArray[np.bool_]:
        """(H,) which planes (H, 4) may be a table's, by their tilt and the camera's side."""
        if self.up is None:
            return np.asarray(planes[:, 1] <= _TILT_CAMERA)
        level = planes[:, :3] @ self.up >= _TILT_GIVEN
        if self.camera_position_m is not None:  # a surface seen from below carries nothing
            level &= planes[:, :3] @ self.camera_position_m + planes[:, 3] > 0
        return np.asarray(level)


def _planes_in(sample: Points, side: _Side) -> list[tuple[int, Floats]]:
    """Points held and (4,) n, d of planes that are not alike, by the proposals' votes."""
    proposals, left = _proposals(sample, side), sample
    votes = plane_votes(left, proposals, _COARSE_M)
    least = max(_LEAST_VOTES[0], _LEAST_VOTES[1] * len(sample))
    found: list[tuple[int, Floats]] = []
    for _ in range(_TRIES):
        best = int(np.argmax(votes)) if len(votes) else 0
        if len(votes) == 0 or votes[best] < least or len(found) == _MOST_PLANES:
            break
        plane = fitted_plane(left, proposals[best], (_COARSE_M, _FINE_M))
        if plane is None or not side.plausible(plane[None])[0] or not _opaque(plane, sample):
            rest = ~_alike(proposals, proposals[best] if plane is None else plane, sample)
            rest[best] = False
            proposals, votes = proposals[rest], votes[rest]
            continue
        if not any(_alike(other[None], plane, sample)[0] for _, other in found):
            found.append((int(plane_votes(sample, plane[None], _COARSE_M)[0]), plane))
        # What a plane holds votes for no other one: a small desk has less than a floor's rest.
        left = left[np.abs(_plane(plane).heights(left)) >= _COARSE_M]
        votes = plane_votes(left, proposals, _COARSE_M)
    return _upright(found) if side.up is None else found


def _upright(found: list[tuple[int, Floats]]) -> list[tuple[int, Floats]]:
    """Those that face up in the image where one of some size does, as a level plane does unless
    the camera looks straight down.
    """
    most = max((votes for votes, _ in found), default=0)
    upright = [item for item in found if item[1][1] < -_TILT_UPRIGHT]
    return upright if any(votes >= _UPRIGHT_SHARE * most for votes, _ in upright) else found


def _all_carried(
    sample: Points,
    planes: list[tuple[int, Floats]],
    camera_position_m: Floats | None,
    max_range_m: float,
    sensor: SensorModel,
) -> list[int]:
    """What each plane carries of the sample's points in reach of the camera."""
    noise_m: NDArray[np.float32] = np.zeros(len(sample), dtype=np.float32)
    within = np.ones(len(sample), dtype=bool)
    if camera_position_m is not None:
        ranges = np.linalg.norm(sample - camera_position_m.astype(np.float32), axis=1)
        noise_m, within = sensor.axial_noise_m(ranges), ranges <= max_range_m
    return [_carried(sample, within, noise_m, plane) for _, plane in planes]


def _dense(points: Points, camera_position_m: Floats | None, max_range_m: float) -> Points:
    """Many points, where there are enough those in reach of the camera."""
    dense = np.array(points[:: max(1, len(points) // _DENSE)])
    if camera_position_m is None:
        return dense
    # A second table behind may be level with this one, but not quite.
    off = dense - camera_position_m.astype(np.float32)
    near = np.einsum("ij,ij->i", off, off) <= max_range_m**2
    return dense[near] if np.count_nonzero(near) > _ENOUGH else dense


def _on_one_level(dense: Points, plane: Floats) -> Floats:
    """The plane, or, where more patches share a height so, turned as small patches of it are.

    Two tables that differ by 2 cm lie near one plane that is tilted by 2 degrees; their patches
    do not tilt so.
    """
    T_source_table = support_frame(_plane(plane), optical=True)
    some = np.ascontiguousarray(dense[:: max(1, len(dense) // _PATCHED)])
    patches = _flat_patches(
        patch_moments(some, invert(T_source_table), _STRADDLED_M, _SLOPE_CELL_M)
    )
    if len(patches) < _FEWEST_PATCHES:
        return plane
    slope = np.median(patches[:, 3:], axis=0)
    as_it_is, _ = _shared_height(patches[:, 2])
    turned, height_m = _shared_height(patches[:, 2] - patches[:, :2] @ slope)
    if turned < _TURN_GAIN * as_it_is:
        return plane
    normal = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1.0 + slope @ slope)
    moved = _plane(np.append(normal, -normal[2] * height_m)).moved(T_source_table)
    return np.append(moved.normal, moved.offset_m)


def _shared_height(heights: Floats) -> tuple[int, float]:
    """How many heights lie at the two levels that hold most, and the mean at the first, m."""
    count, means = 0, []
    for _ in range(2):
        heights = np.sort(heights)
        held = np.searchsorted(heights, heights + _ONE_LEVEL_M) - np.arange(len(heights))
        first = int(np.argmax(held))
        last = first + int(held[first])
        count += last - first
        means.append(float(heights[first:last].mean()))
        heights = np.concatenate((heights[:first], heights[last:]))
        if len(heights) == 0:
            break
    return count, means[0]


def _flat_patches(moments: Floats) -> Floats:
    """(P, 5) x, y, height and slopes along x and y of the flatter half of the cells, m.

    moments: (C, 10), as `patch_moments` gives them.
    """
    spread = moments[:, 4] * moments[:, 7] - moments[:, 5] ** 2
    full = (moments[:, 0] >= _LEAST_PATCH) & (spread > (_SLOPE_CELL_M / 8) ** 4)
    _, x, y, z, xx, xy, xz, yy, yz, zz = moments[full].T
    slope_x, slope_y = (yy * xz - xy * yz) / spread[full], (xx * yz - xy * xz) / spread[full]
    rough = zz - slope_x * xz - slope_y * yz
    flat = rough <= np.median(rough) if len(rough) else full[full]
    return np.column_stack((x, y, z, slope_x, slope_y))[flat]


def _plane(values: Floats) -> Plane:
    """A row n, d of the proposals as a plane."""
    return Plane(values[:3], float(values[3]))


def _alike(planes: Floats, plane: Floats, sample: Points) -> NDArray[np.bool_]:
    """(H,) which planes are nearly this one: alike in tilt, and near it where it has points."""
    heights = _plane(plane).heights(sample)
    on = sample[np.abs(heights) < _COARSE_M]
    middle = np.median(on, axis=0) if len(on) else -plane[:3] * plane[3]
    off = np.abs(planes[:, :3] @ middle + planes[:, 3])
    return np.asarray((planes[:, :3] @ plane[:3] > _ALIKE) & (off < 2 * _COARSE_M))


def _opaque(plane: Floats, sample: Points) -> bool:
    """Whether points stop at the plane: where it was seen, there are far fewer just under it.

    Points of a lower table beside it do not count.
    """
    on, under = on_and_under(sample, plane, _FINE_M, 3 * _FINE_M, _CELL_M)
    return bool(under < _UNDER_SHARE * on)


def support_frame(plane: Plane, optical: bool) -> Floats:
    """The table's frame: z = normal, z = 0 on the plane, origin below the source's origin.

    x is the optical axis laid on the plane (docs/conventions.md); for a source that is no camera,
    or one looking straight down, the next axis that can be laid.

    Args:
        plane: in the source frame.
        optical: whether that is a camera's.

    Returns:
        (4, 4) T_source_table.
    """
    axes = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0)) if optical else ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    laid = [np.array(axis) - plane.normal * (plane.normal @ np.array(axis)) for axis in axes]
    x = laid[0] if np.linalg.norm(laid[0]) > _LAID else laid[1]
    x = x / np.linalg.norm(x)
    rotation = np.column_stack((x, np.cross(plane.normal, x), plane.normal))
    return make_transform(rotation, -plane.normal * plane.offset_m)


def _proposals(sample: Points, side: _Side) -> Floats:
    """(H, 4) planes through triples of near points, and level ones where up is known."""
    up = side.up
    rng = np.random.default_rng(0)
    count = len(sample)
    if count < 3:
        return np.empty((0, 4))
    first = rng.integers(count, size=_PROPOSALS)
    others = rng.integers(count, size=(_PROPOSALS, _DRAWN))
    centers = sample[first].astype(np.float64)
    offsets = sample[others].astype(np.float64) - centers[:, None]
    gap = np.linalg.norm(offsets, axis=2)
    near = (gap > _TRIPLE_M[0]) & (gap < _TRIPLE_M[1])
    rows = np.arange(_PROPOSALS)
    second = np.argmax(near, axis=1)
    near[rows, second] = False
    third = np.argmax(near, axis=1)
    normals = np.cross(offsets[rows, second], offsets[rows, third])
    length = np.linalg.norm(normals, axis=1)
    good = near[rows, third] & (length > _LEAST_AREA_M2)
    normals = normals[good] / length[good, None]
    through = centers[good]
    if up is not None:
        level = centers[: _PROPOSALS // 2]
        normals = np.vstack((normals, np.tile(up, (len(level), 1))))
        through = np.vstack((through, level))
    planes = np.column_stack((normals, -np.sum(normals * through, axis=1)))
    # Towards the viewer where tilt is unknown, else upwards.
    flip = planes[:, 3] < 0 if up is None else planes[:, :3] @ up < 0
    planes[flip] *= -1
    return np.ascontiguousarray(planes[side.plausible(planes)])


def fitted_plane(points: Points, plane: Floats, tolerances_m: tuple[float, ...]) -> Floats | None:
    """Least squares through the points near a plane, repeated.

    Args:
        points: (N, 3) float32, m.
        plane: (4,) unit normal n and d of n . p + d = 0, m.
        tolerances_m: of each turn, from the plane of the turn before, m.

    Returns:
        (4,) float64, facing as `plane` does; None where too few points are near.
    """
    anchor = -plane[:3] * plane[3]
    for tolerance_m in tolerances_m:
        sums = plane_sums(points, plane, anchor, tolerance_m)
        count = sums[0]
        if count < _FEWEST_FITTED:
            return None
        mean = sums[1:4] / count
        xx, xy, xz, yy, yz, zz = sums[4:] / count
        products = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        normal = np.linalg.eigh(products - np.outer(mean, mean))[1][:, 0]
        if normal @ plane[:3] < 0:
            normal = -normal
        plane = np.append(normal, -normal @ (anchor + mean))
    return plane


def _carried(sample: Points, within: NDArray[np.bool_], noise_m: Points, plane: Floats) -> int:
    """How many points in reach stand over the plane's own seen patch, up to 30 cm high.

    Below 0 for a patch too small to be a table.
    """
    T_source_table = support_frame(_plane(plane), optical=True)
    local = transform(invert(T_source_table), sample)
    on = local[np.abs(local[:, 2]) < _FINE_M]
    cells = np.floor(on[:, :2] / _CELL_M).astype(np.int64)
    if len(np.unique(cells[:, 0] * (1 << 32) + cells[:, 1])) * _CELL_M**2 < _LEAST_PATCH_M2:
        return -1
    lowest = _CARRIED_M[0] + _CARRIED_NOISE * noise_m
    over = local[within & (local[:, 2] > lowest) & (local[:, 2] < _CARRIED_M[1])]
    return int(np.count_nonzero(_over_patch(on, over)))


def patch_over(points: Points, T_source_table: Floats, above: Points) -> NDArray[np.bool_]:
    """Whether points stand over the part of the plane that was seen.

    Args:
        points: (N, 3) float32 of the view, source frame, m.
        T_source_table: (4, 4).
        above: (K, 3) float32, the points in question, table frame, m.

    Returns:
        (K,) bool.
    """
    local = transform(invert(T_source_table), points[:: max(1, len(points) // _PATCH_SAMPLE)])
    return _over_patch(local[np.abs(local[:, 2]) < _COARSE_M], above, margin=_RIM_CELLS)


def _over_patch(on: Points, above: Points, margin: int = 0) -> NDArray[np.bool_]:
    """Whether each point lies over 5 cm cells that hold plane points, or over their span.

    margin: how many cells beyond it still count, for what stands on the hidden rim.
    """
    inside = np.zeros(len(above), dtype=bool)
    if len(on) == 0 or len(above) == 0:
        return inside
    cells = np.floor(on[:, :2] / _CELL_M).astype(np.int64)
    lowest = cells.min(axis=0) - 1 - margin
    shape = cells.max(axis=0) - lowest + 2 + margin
    if np.any(shape > _MOST_CELLS):
        return inside
    patch = np.zeros(shape, dtype=bool)
    patch[tuple((cells - lowest).T)] = True
    filled = spans(patch)
    for _ in range(margin):
        grown = filled.copy()
        for axis in (0, 1):
            for by in (1, -1):  # the border is empty, so nothing rolls over
                grown |= np.roll(filled, by, axis)
        filled = grown
    at = np.floor(above[:, :2] / _CELL_M).astype(np.int64) - lowest
    inside = np.all((at >= 0) & (at < shape), axis=1)
    inside[inside] = filled[tuple(at[inside].T)]
    return np.asarray(inside)


def spans(patch: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells with plane on both sides in their row and in their column: hidden spots filled.

    Args:
        patch: (R, C) bool, cells in which the plane was seen.

    Returns:
        (R, C) bool.
    """
    rows = np.logical_or.accumulate(patch, 0) & np.logical_or.accumulate(patch[::-1], 0)[::-1]
    columns = (
        np.logical_or.accumulate(patch, 1) & np.logical_or.accumulate(patch[:, ::-1], 1)[:, ::-1]
    )
    return np.asarray(patch | (rows & columns))


def _choose(planes: list[tuple[int, Floats]], carried: list[int]) -> Floats:
    """The plane that carries most, of those with a fair share of points; else the highest.

    A slanted plane through the objects has few points, a small desk over a floor too; a table
    hides the floor under it.
    """
    most = max(votes for votes, _ in planes)
    fair = [k for k, (votes, _) in enumerate(planes) if votes >= _FAIR_SHARE * most]
    fair += [
        k for k, (votes, plane) in enumerate(planes)
        if _DESK_SHARE * most <= votes < _FAIR_SHARE * most
        and any(_is_desk(plane, planes[other][1]) for other in fair)
    ]  # fmt: skip
    clear = [k for k in fair if carried[k] >= _FEWEST_CARRIED]
    if clear:
        return planes[max(clear, key=lambda k: (carried[k], -k))][1]
    broad = [k for k in fair if carried[k] >= 0] or fair
    return planes[min(broad, key=lambda k: (float(planes[k][1][3]), k))][1]


def _is_desk(plane: Floats, floor: Floats) -> bool:
    """Whether a plane lies level with another one and well over it; d falls with the height."""
    return bool(plane[:3] @ floor[:3] >= _DESK_LEVEL and floor[3] - plane[3] >= _DESK_M)
