"""The rays that a scene's views tell of: camera positions and the points where they end."""

from __future__ import annotations

from collections.abc import Sequence

from boxgrasp.arrays import Points
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.mapping.ray_insertion import Scan
from boxgrasp.perception.view import View

_DENSE_PX = 150_000  # of such an image every second row and column still crosses every cell


def view_rays(views: Sequence[View], stride: int | None) -> list[Scan]:
    """Points and camera position of every view, the whole cloud, table included.

    Args:
        views: as a scene has them.
        stride: as `MappingConfig.stride`.

    Returns:
        A scan a view, (N, 3) float32 points and a (3,) position or None, m, all in the first
        view's own frame.
    """
    T_source_base = invert(views[0].T_base_source)
    rays: list[Scan] = []
    for view in views:
        points = _ray_points(view, stride)
        if view is not views[0]:
            points = transform(T_source_base @ view.T_base_source, points)
        T = view.T_base_camera
        rays.append((points, None if T is None else transform(T_source_base, T[None, :3, 3])[0]))
    return rays


def _ray_points(view: View, stride: int | None) -> Points:
    if stride is not None:
        return view.points[::stride]
    dense = view.shape is not None and view.shape[0] * view.shape[1] > _DENSE_PX
    return view.thinned(2 if dense else 1)
