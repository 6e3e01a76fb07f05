"""What one view cannot show but the scene holds: the bodies under seen surfaces, and unseen space.

A surface seen from above has a body under it: each obstacle point becomes a column reaching down
to the support plane, or to the first cell below it that was seen free (under a floating lamp).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points, readonly
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels._jit import jit
from boxgrasp.mapping.local_map import FREE, UNSEEN, LocalMap
from boxgrasp.perception.scene import Scene

_FAR_M = 1.0
_SLACK_M = 0.005
_GRAZING = 0.12  # slope of the view under which a top shows too little of itself
_THINNED = 8  # a guess needs no more
_DEEPER_M = 0.03
_DEEPEST_M = 0.25


@jit
def _fall(
    cells: NDArray[np.int64],
    inside: NDArray[np.bool_],
    state: NDArray[np.uint8],
    free: int,
) -> NDArray[np.int64]:
    """(N,) lowest layer that each point's column reaches, -1 for down to the plane."""
    layer = np.empty(cells.shape[0], dtype=np.int64)
    for i in range(cells.shape[0]):
        k = cells[i, 2]
        if not inside[i]:
            layer[i] = 1 << 30
            continue
        while k > 0 and state[cells[i, 0], cells[i, 1], k - 1] != free:
            k -= 1
        layer[i] = k if k > 0 else -1
    return layer


def deepened(
    scene: Scene, others: NDArray[np.bool_], box: Box, local_map: LocalMap
) -> NDArray[np.float32]:
    """(N, 4) columns behind what shows no top: taken to be as deep as it is wide there.

    A thing shows its depth by its top, but where the image border cuts it or the camera is not
    well above it. It reaches down as far as it was seen to, and only places that were not seen
    free count. others: (K,) the scene's points that are obstacles; columns as `columns_under`.
    """
    found = [np.empty((0, 4), dtype=np.float32)]
    eye = scene.eye_m
    if eye is None:
        return found[0]
    offset = scene.points - eye.astype(np.float32)
    topless = offset[:, 2] > -_GRAZING * np.hypot(offset[:, 0], offset[:, 1])
    topless[scene.at_border] = True
    topless &= others
    for cluster in np.unique(scene.clusters[topless]).tolist():
        points = scene.points[others & (scene.clusters == cluster)][::_THINNED]
        rim = scene.points[topless & (scene.clusters == cluster), :2]
        away = points[:, :2].mean(axis=0) - eye[:2].astype(np.float32)
        away /= max(float(np.linalg.norm(away)), 1e-6)
        across = rim @ np.array([-away[1], away[0]], dtype=np.float32)
        wide = min(float(np.ptp(across)), _DEEPEST_M)
        column = np.column_stack((points, points[:, 2]))
        column[:, 2] = points[:, 2].min()
        for step in np.arange(1, int(wide / _DEEPER_M) + 1):
            shift = np.append(away * np.float32(step * _DEEPER_M), np.zeros(2, np.float32))
            found.append(column + shift)
    columns = np.vstack(found)
    tops = columns[:, (0, 1, 3)]
    cells, inside = local_map.keys(transform(invert(local_map.T_base_map), tops))
    inside &= local_map.state[cells[:, 0], cells[:, 1], cells[:, 2]] != FREE
    own = np.abs(transform(invert(box.T_base_box), tops)) < box.dimensions_m / 2 + _SLACK_M
    return np.ascontiguousarray(columns[inside & ~own.all(axis=1)])


def columns_under(points: Points, local_map: LocalMap, plane: Plane) -> NDArray[np.float32]:
    """(N, 4) float32 base frame x, y, z low, z high: the hidden body under each obstacle point.

    Points outside the map keep no body: z low = z high.
    """
    T_map_base = invert(local_map.T_base_map)
    cells, inside = local_map.keys(transform(T_map_base, points))
    ground = np.minimum(points[:, 2], points[:, 2] - plane.heights(points))
    layer = _fall(cells, inside, local_map.state, FREE)
    floor = local_map.lowest[2] + layer * local_map.resolution_m + local_map.T_base_map[2, 3]
    low = np.where(layer == -1, ground, np.minimum(floor, points[:, 2]))
    low = np.where(inside, np.maximum(low, ground), points[:, 2])
    return readonly(np.column_stack((points[:, :2], low, points[:, 2])).astype(np.float32))


def unseen_cells(local_map: LocalMap, box: Box) -> Floats:
    """(K, 3) centers, base frame, of cells that may hold something unseen, but the target's own.

    Those are unseen down to the lowest layer: over a cell seen free nothing can stand.
    """
    grounded = np.logical_and.accumulate(local_map.state != FREE, axis=2)
    found = np.argwhere(grounded & (local_map.state == UNSEEN))
    centers = local_map.lowest + (found + 0.5) * local_map.resolution_m
    base = transform(local_map.T_base_map, centers)
    own = np.abs(transform(invert(box.T_base_box), base))
    reach = box.dimensions_m / 2 + local_map.resolution_m / 2
    return np.ascontiguousarray(base[np.any(own > reach, axis=1)])


def unexplained_cells(
    centers: Floats, sizes_m: Floats, scene: Scene, box: Box
) -> tuple[Floats, Floats]:
    """Occupied cells of a map (K, 3), (K,), base frame, that neither points nor target explain.

    Cells that touch the support plane, reach into the target's box or hold a seen point are left
    out, as are those too far from the box to matter.
    """
    near = np.all(np.abs(centers - box.T_base_box[:3, 3]) < _FAR_M, axis=1)
    heights = centers @ scene.plane.normal + scene.plane.offset_m
    own = np.abs(transform(invert(box.T_base_box), centers)) - box.dimensions_m / 2
    keep = near & (heights > sizes_m / 2) & np.any(own > sizes_m[:, None] / 2, axis=1)
    rows = np.flatnonzero(keep)
    for row in rows.tolist():
        reach = sizes_m[row] / 2 + _SLACK_M
        keep[row] = not np.any(np.all(np.abs(scene.points - centers[row]) < reach, axis=1))
    return readonly(centers[keep]), readonly(sizes_m[keep])
