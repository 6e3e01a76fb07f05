"""What one view cannot show but the scene holds: the bodies under seen surfaces, and unseen space.

A surface seen from above has a body under it: each obstacle point becomes a column reaching down
to the support plane, or to the first cell below it that was seen free (under a floating lamp).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Array, Floats, Points, readonly
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels.columns import lowest_layers
from boxgrasp.mapping.local_map import FREE, UNSEEN, LocalMap
from boxgrasp.perception.scene import Scene

_FAR_M = 1.0  # m from the box along an axis: beyond any hand
_TOUCHING_M = 0.002  # m, from the target's box, whose sides are known no better: the target's
_SLACK_M = 0.005  # m, what points and boxes are off
_GRAZING = 0.12  # slope of the view under which a top shows too little of itself
_THINNED = 8  # a guess needs no more
_DEEPER_M = 0.03  # m between columns, a cell of the local map
_DEEPEST_M = 0.25  # m, of a guess


@dataclass(frozen=True, eq=False)
class MapObstacles:
    """Occupied cells of a map file, base frame.

    Attributes:
        centers_m: (K, 3) float64, m.
        edges_m: (K,) float64, m.
    """

    centers_m: Floats
    edges_m: Floats

    def __len__(self) -> int:
        return len(self.edges_m)


NO_MAP_OBSTACLES = MapObstacles(readonly(np.empty((0, 3))), readonly(np.empty(0)))


def deepened(
    scene: Scene, obstacle_mask: NDArray[np.bool_], box: Box, local_map: LocalMap
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Columns behind what shows no top: taken to be as deep as it is wide there.

    A thing shows its depth by its top, but where the image border cuts it or the camera is not
    well above it. It reaches down as far as it was seen to, and only places that were not seen
    free count.

    Args:
        scene: its K points.
        obstacle_mask: (K,) bool, which of them are obstacles.
        box: the target's, whose own space does not count.
        local_map: what was seen free.

    Returns:
        (N, 4) float32 columns as `columns_under`, and (N,) int64 number of each one's object.
    """
    columns: list[Array] = [np.empty((0, 4), dtype=np.float32)]
    objects: list[Array] = [np.empty(0, dtype=np.int64)]
    camera = scene.camera_position_m
    if camera is None:
        return columns[0], objects[0]
    offset = scene.points - camera.astype(np.float32)
    topless = offset[:, 2] > -_GRAZING * np.hypot(offset[:, 0], offset[:, 1])
    topless[scene.at_border] = True
    topless &= obstacle_mask
    for cluster in np.unique(scene.clusters[topless]).tolist():
        rows = np.flatnonzero(obstacle_mask & (scene.clusters == cluster))[::_THINNED]
        points = scene.points[rows]
        rim = scene.points[topless & (scene.clusters == cluster), :2]
        away = points[:, :2].mean(axis=0) - camera[:2].astype(np.float32)
        away /= max(float(np.linalg.norm(away)), 1e-6)
        across = rim @ np.array([-away[1], away[0]], dtype=np.float32)
        wide = min(float(np.ptp(across)), _DEEPEST_M)
        column = np.column_stack((points, points[:, 2]))
        column[:, 2] = points[:, 2].min()
        for step in np.arange(1, int(wide / _DEEPER_M) + 1):
            shift = np.append(away * np.float32(step * _DEEPER_M), np.zeros(2, np.float32))
            columns.append(column + shift)
            objects.append(scene.object_numbers[rows])
    found = np.vstack(columns)
    tops = found[:, (0, 1, 3)]
    cells, inside = local_map.keys(transform(invert(local_map.T_base_map), tops))
    inside &= local_map.state[cells[:, 0], cells[:, 1], cells[:, 2]] != FREE
    in_box = np.abs(transform(invert(box.T_base_box), tops)) < box.dimensions_m / 2 + _SLACK_M
    kept = inside & ~in_box.all(axis=1)
    return np.ascontiguousarray(found[kept]), np.concatenate(objects)[kept]


def columns_under(points: Points, local_map: LocalMap, plane: Plane) -> NDArray[np.float32]:
    """The hidden body under each obstacle point.

    Args:
        points: (N, 3) float32, base frame, m.
        local_map: what was seen free.
        plane: the support plane.

    Returns:
        (N, 4) float32, base frame, m: x, y, lowest z, highest z. Points outside the map keep no
        body: both z are equal.
    """
    T_map_base = invert(local_map.T_base_map)
    cells, inside = local_map.keys(transform(T_map_base, points))
    ground = np.minimum(points[:, 2], points[:, 2] - plane.heights(points))
    layer = lowest_layers(cells, inside, local_map.state, FREE)
    floor = local_map.lowest[2] + layer * local_map.resolution_m + local_map.T_base_map[2, 3]
    low = np.where(layer == -1, ground, np.minimum(floor, points[:, 2]))
    low = np.where(inside, np.maximum(low, ground), points[:, 2])
    return readonly(np.column_stack((points[:, :2], low, points[:, 2])).astype(np.float32))


def unseen_cells(local_map: LocalMap, box: Box) -> Floats:
    """Cells that may hold something unseen, but the target's own.

    Those are unseen down to the lowest layer: over a cell seen free nothing can stand.

    Args:
        local_map: the cells.
        box: the target's.

    Returns:
        (U, 3) float64 centers, base frame, m.
    """
    grounded = np.logical_and.accumulate(local_map.state != FREE, axis=2)
    found = np.argwhere(grounded & (local_map.state == UNSEEN))
    centers = local_map.lowest + (found + 0.5) * local_map.resolution_m
    base = transform(local_map.T_base_map, centers)
    off = np.abs(transform(invert(box.T_base_box), base))
    reach = box.dimensions_m / 2 + local_map.resolution_m / 2 + _TOUCHING_M
    return np.ascontiguousarray(base[np.any(off > reach, axis=1)])


def unexplained_cells(occupied: MapObstacles, scene: Scene, box: Box) -> MapObstacles:
    """Occupied cells of a map file that neither points nor target explain.

    Cells that touch the support plane, reach into the target's box or hold a seen point are left
    out, as are those too far from the box to matter.

    Args:
        occupied: all of the file's.
        scene: the points that were seen.
        box: the target's.

    Returns:
        Those that are left, in their order.
    """
    centers, edges = occupied.centers_m, occupied.edges_m
    near = np.all(np.abs(centers - box.T_base_box[:3, 3]) < _FAR_M, axis=1)
    heights = centers @ scene.plane.normal + scene.plane.offset_m
    beyond = np.abs(transform(invert(box.T_base_box), centers)) - box.dimensions_m / 2
    keep = near & (heights > edges / 2) & np.any(beyond > edges[:, None] / 2, axis=1)
    rows = np.flatnonzero(keep)
    for row in rows.tolist():
        reach = edges[row] / 2 + _SLACK_M
        keep[row] = not np.any(np.all(np.abs(scene.points - centers[row]) < reach, axis=1))
    return MapObstacles(readonly(centers[keep]), readonly(edges[keep]))
