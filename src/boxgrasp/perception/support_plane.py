"""The support plane: the level plane that carries the objects, not the largest one in view."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.errors import SceneError
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import invert, make_transform, transform
from boxgrasp.kernels.plane import plane_sums, plane_votes
from boxgrasp.sensing.sensor_model import axial_noise_m

_SAMPLE = 1500
_PROPOSALS = 120
_CANDIDATES = 4
_TRIES = 6
_ALIKE = np.cos(np.deg2rad(15.0))
_COARSE_M = 0.015
_FINE_M = 0.008
_CARRIED_M = (0.015, 0.30)
_CELL_M = 0.05
_UNDER_SHARE = 0.6
_FAIR_SHARE = 0.3
_FEWEST_CARRIED = 4
_LEAST_PATCH_M2 = 0.05
_TILT_GIVEN = np.cos(np.deg2rad(12.0))
_TILT_CAMERA = np.sin(np.deg2rad(10.0))
_TILT_UPRIGHT = np.sin(np.deg2rad(15.0))


def find_support_plane(
    points: Points, up: Floats | None, eye: Floats | None, max_range_m: float
) -> Plane:
    """RANSAC over local proposals, the carrier among the candidates, a refit (appendix A).

    points: (N, 3) float32 in the camera frame, or in any frame where `up` is known.
    up: (3,) unit vector against gravity in the points' frame; None for a camera frame of
    unknown tilt, where planes that face downwards in the image are left out.
    eye: (3,) camera position there, or None; max_range_m: how far from it objects are looked for.

    Raises:
        SceneError: no plane of a plausible tilt holds enough points.
    """
    sample = np.array(points[:: max(1, len(points) // _SAMPLE)])
    proposals = _proposals(sample, up)
    votes = plane_votes(sample, proposals, _COARSE_M)
    candidates: list[tuple[int, Floats]] = []
    tries = 0
    while len(candidates) < _CANDIDATES and len(proposals):
        best = int(np.argmax(votes))
        if votes[best] < max(30, 0.02 * len(sample)) or tries == _TRIES:
            break
        tries += 1
        plane = _refit(sample, proposals[best], (_COARSE_M, _FINE_M))
        if plane is None or not _plausible(plane[None], up)[0]:
            plane = proposals[best]
        elif _opaque(plane, sample) and not any(
            _alike(found[None], plane, sample)[0] for _, found in candidates
        ):
            candidates.append((int(votes[best]), plane))
        rest = ~_alike(proposals, plane, sample)
        rest[best] = False
        proposals, votes = proposals[rest], votes[rest]
    if not candidates:
        raise SceneError(
            "no support plane found; valid: a view with a level surface under the objects"
        )
    if up is None:  # a level plane faces up in the image unless the camera looks straight down
        upright = [found for found in candidates if found[1][1] < -_TILT_UPRIGHT]
        candidates = upright or candidates
    noise_m = np.zeros(len(sample), dtype=np.float32)
    within = np.ones(len(sample), dtype=bool)
    if eye is not None:
        ranges = np.linalg.norm(sample - eye.astype(np.float32), axis=1)
        noise_m, within = axial_noise_m(ranges), ranges <= max_range_m
    carried = [_carried(sample, within, noise_m, plane) for _, plane in candidates]
    chosen = _choose(candidates, carried)
    dense = np.array(points[:: max(1, len(points) // 20_000)])
    if eye is not None:  # a second table behind may be level with this one, but not quite
        off = dense - eye.astype(np.float32)
        near = np.einsum("ij,ij->i", off, off) <= max_range_m**2
        dense = dense[near] if np.count_nonzero(near) > 1000 else dense
    plane = _refit(dense, chosen, (_COARSE_M, _FINE_M, _FINE_M))
    if plane is None:
        plane = chosen
    if not _opaque(plane, dense):
        raise SceneError(
            "no support plane found: points lie under the best one as on it; valid: a view with a "
            "level surface under the objects"
        )
    return Plane(readonly(plane[:3].copy()), float(plane[3]))


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
    """Whether points stop at the plane: just under it there are far fewer than on it."""
    heights = _plane(plane).heights(sample)
    on = np.count_nonzero(np.abs(heights) < _FINE_M)
    under = np.count_nonzero((heights <= -_FINE_M) & (heights > -3 * _FINE_M))
    return bool(under < _UNDER_SHARE * on)


def support_frame(plane: Plane, optical: bool) -> Floats:
    """T_source_table: z = normal, z = 0 on the plane, origin below the source's origin.

    x is the optical axis laid on the plane (docs/conventions.md); for a
    source that is no camera, or one looking straight down, the next axis that can be laid.
    """
    axes = ((0.0, 0.0, 1.0), (0.0, -1.0, 0.0)) if optical else ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
    laid = [np.array(axis) - plane.normal * (plane.normal @ np.array(axis)) for axis in axes]
    x = laid[0] if np.linalg.norm(laid[0]) > 0.05 else laid[1]
    x = x / np.linalg.norm(x)
    rotation = np.column_stack((x, np.cross(plane.normal, x), plane.normal))
    return make_transform(rotation, -plane.normal * plane.offset_m)


def _proposals(sample: Points, up: Floats | None) -> Floats:
    """(H, 4) planes through triples of near points, and level ones where up is known."""
    rng = np.random.default_rng(0)
    count = len(sample)
    if count < 3:
        return np.empty((0, 4))
    first = rng.integers(count, size=_PROPOSALS)
    others = rng.integers(count, size=(_PROPOSALS, 30))
    centers = sample[first].astype(np.float64)
    offsets = sample[others].astype(np.float64) - centers[:, None]
    gap = np.linalg.norm(offsets, axis=2)
    near = (gap > 0.03) & (gap < 0.30)
    rows = np.arange(_PROPOSALS)
    second = np.argmax(near, axis=1)
    near[rows, second] = False
    third = np.argmax(near, axis=1)
    normals = np.cross(offsets[rows, second], offsets[rows, third])
    length = np.linalg.norm(normals, axis=1)
    good = near[rows, third] & (length > 1e-6)
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
    return np.ascontiguousarray(planes[_plausible(planes, up)])


def _plausible(planes: Floats, up: Floats | None) -> NDArray[np.bool_]:
    if up is None:
        return np.asarray(planes[:, 1] <= _TILT_CAMERA)
    return np.asarray(planes[:, :3] @ up >= _TILT_GIVEN)


def _refit(points: Points, plane: Floats, tolerances_m: tuple[float, ...]) -> Floats | None:
    """Least squares through the points near the plane, repeated; None where too few are near."""
    anchor = -plane[:3] * plane[3]
    for tolerance_m in tolerances_m:
        sums = plane_sums(points, plane, anchor, tolerance_m)
        count = sums[0]
        if count < 10:
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
    lowest = _CARRIED_M[0] + 4 * noise_m
    over = local[within & (local[:, 2] > lowest) & (local[:, 2] < _CARRIED_M[1])]
    return int(np.count_nonzero(_over_patch(on, over)))


def patch_over(points: Points, T_source_table: Floats, above: Points) -> NDArray[np.bool_]:
    """(K,) whether points `above` (table frame) stand over the part of the plane that was seen.

    points: (N, 3) of the view in the source frame.
    """
    local = transform(invert(T_source_table), points[:: max(1, len(points) // 4_000)])
    return _over_patch(local[np.abs(local[:, 2]) < _COARSE_M], above, margin=3)


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
    if np.any(shape > 2000):
        return inside
    patch = np.zeros(shape, dtype=bool)
    patch[tuple((cells - lowest).T)] = True
    filled = _spans(patch)
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


def _spans(patch: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Cells with plane on both sides in their row and in their column: hidden spots filled."""
    rows = np.logical_or.accumulate(patch, 0) & np.logical_or.accumulate(patch[::-1], 0)[::-1]
    columns = (
        np.logical_or.accumulate(patch, 1) & np.logical_or.accumulate(patch[:, ::-1], 1)[:, ::-1]
    )
    return np.asarray(patch | (rows & columns))


def _choose(candidates: list[tuple[int, Floats]], carried: list[int]) -> Floats:
    """The plane that carries most, of those with a fair share of points; else the highest.

    A slanted plane through the objects has few points; a table hides the floor under it.
    """
    most = max(votes for votes, _ in candidates)
    fair = [k for k, (votes, _) in enumerate(candidates) if votes >= _FAIR_SHARE * most]
    clear = [k for k in fair if carried[k] >= _FEWEST_CARRIED]
    if clear:
        return candidates[max(clear, key=lambda k: (carried[k], -k))][1]
    broad = [k for k in fair if carried[k] >= 0] or fair
    return candidates[min(broad, key=lambda k: (float(candidates[k][1][3]), k))][1]
