"""What stands on a support plane, and which pixels show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Bools, Floats, Points
from boxgrasp.errors import CodedWarning, SceneError
from boxgrasp.forks import cached_property
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import invert, transform
from boxgrasp.kernels.nearest import nearest
from boxgrasp.kernels.table_cells import hole_rim
from boxgrasp.perception.frame_doubts import FrameDoubt
from boxgrasp.perception.numbering import SceneObject
from boxgrasp.perception.segmentation.clusters import Clusters
from boxgrasp.perception.supports import Supports
from boxgrasp.perception.view import View, rows_of, scan_views
from boxgrasp.sensing.capture import Capture, Pixels
from boxgrasp.sensing.sensor_model import SensorModel

REACH_PX = 6  # from a target's outline to what is next: holes in the depth are narrower
TABLE, MISSING = -1, -2  # what a pixel shows where it shows no point of the scene

_BORDER_PX = 3  # from the image's rim: a thing that reaches as far goes on beyond


@dataclass(frozen=True, eq=False)
class TargetWindow:
    """The image round a target.

    Attributes:
        target_mask: (h, w) bool, the target's pixels.
        points_m: (h, w, 3) float32, what each pixel shows, base frame, m; NaN where it is missing.
        rows: slice of the image's rows, v.
        columns: slice of the image's columns, u.
        open_sides: whether the window ends with the image: left, right, top, bottom.
    """

    target_mask: NDArray[np.bool_]
    points_m: Points
    rows: slice
    columns: slice
    open_sides: tuple[bool, bool, bool, bool]


@dataclass(frozen=True, eq=False)
class ShownPoints:
    """Which point of the scene each of the first view's pixels shows, where it shows one.

    Attributes:
        pixels: (S,) int32, rising, as `View` has them.
        rows: (S,) int64, rows of the scene's points.
    """

    pixels: Pixels
    rows: NDArray[np.int64]


_SPACING_SAMPLE = 200  # points tell how far they lie apart


@dataclass(frozen=True, eq=False)
class Scene:
    """What stands over the support plane, base frame, m.

    Attributes:
        points: (K, 3) float32, voxel centroids over the plane, m.
        object_numbers: (K,) int64, 0 for what is no object.
        clusters: (K,) int64, which points belong together, objects or not.
        floor_mask: (K,) bool, points of hollow things' floors, as low as the table: no obstacles.
        objects: by their numbers, without pixels.
        plane: the support plane; once a target is known, that under it (`perception.standing`).
        supports: the support plane and the level surfaces beside it, table frame.
        frame: `given`, or `support` where the base frame is the plane's.
        T_base_camera: (4, 4), or None where the camera's place is unknown.
        T_base_table: (4, 4), z on the plane's normal, z = 0 on it.
        views: the points of every capture, the first one's before the further scans'.
        warnings: what the user should know of how it was found.
        sensor: what saw it, with the first capture's focal length.
        voxel_m: edge of the voxels, m.
        frame_doubt: what speaks against the frames that the first view was given in, or None.
    """

    points: Points
    object_numbers: NDArray[np.int64]
    clusters: Clusters
    floor_mask: Bools
    objects: tuple[SceneObject, ...]
    plane: Plane
    supports: Supports
    frame: str
    T_base_camera: Floats | None
    T_base_table: Floats
    views: tuple[View, ...]
    warnings: tuple[CodedWarning, ...]
    sensor: SensorModel
    voxel_m: float
    _shown: ShownPoints
    frame_doubt: FrameDoubt | None = None

    def point_area_m2(self, points: Points) -> float:
        """The seen surface that each of some points stands for.

        Args:
            points: (N, 3) float32 of the scene's, base frame, m.

        Returns:
            A voxel's face, m2, or the square of how far apart the points lie, where that is more.
        """
        return max(self.voxel_m, _spacing_m(points)) ** 2

    @property
    def shape(self) -> tuple[int, int] | None:
        """(H, W) of the first view, or None without an image."""
        return self.views[0].shape

    @property
    def flying_pixels(self) -> int:
        """How many pixels of all views lie between two surfaces and were left out."""
        return sum(view.flying for view in self.views)

    @property
    def T_base_source(self) -> Floats:
        """(4, 4) maps the first view's own frame into the base frame."""
        return self.views[0].T_base_source

    @property
    def camera_position_m(self) -> Floats | None:
        """(3,) camera position, base frame, m; None where it is unknown."""
        return None if self.T_base_camera is None else self.T_base_camera[:3, 3]

    @cached_property
    def at_border(self) -> NDArray[np.int64]:
        """(n,) int64 rows of the points that lie at the image border, rising."""
        if self.shape is None:
            return np.empty(0, dtype=np.int64)
        height, width = self.shape
        v, u = np.divmod(self._shown.pixels, width)
        far = (u >= width - _BORDER_PX) | (v >= height - _BORDER_PX)
        return np.asarray(np.unique(self._shown.rows[far | (np.minimum(u, v) < _BORDER_PX)]))

    def with_scans(self, scans: Sequence[Capture], sensor: SensorModel) -> Scene:
        """The same scene, with other further scans for the rays of the local map.

        Args:
            scans: each with its pose; they take the place of those that the scene has.
            sensor: what saw them, before a capture's own focal length is known.

        Returns:
            A scene that shares the arrays.

        Raises:
            SceneError: a scan does not say where its camera stood.
        """
        return replace(self, views=(self.views[0], *scan_views(scans, sensor)))

    def rows_at(self, pixels: NDArray[np.int64]) -> NDArray[np.int64]:
        """Which point each pixel shows.

        Args:
            pixels: (...,) int64, flat pixels v * W + u.

        Returns:
            (...,) int64 rows of the points, `TABLE` for table, background or an outlier, `MISSING`
            for no depth.
        """
        shown = rows_of(pixels, self._shown.pixels)
        seen = rows_of(pixels, self.views[0].pixels) >= 0
        rows = np.where(shown >= 0, self._shown.rows[shown], TABLE)
        return np.where(seen, rows, MISSING)

    def hole_rim(self, pixel: int) -> NDArray[np.int64]:
        """What the pixels round a hole in the depth show.

        Args:
            pixel: flat pixel v * W + u, of one that is missing.

        Returns:
            (n,) int64 object numbers, 0 for no object, each pixel once; none where the hole ends
            with the image.
        """
        height, width = self.shape or (0, 0)
        numbers = np.full(height * width, MISSING, dtype=np.int64)
        numbers[self.views[0].pixels] = 0
        numbers[self._shown.pixels] = self.object_numbers[self._shown.rows]
        return hole_rim(numbers.reshape(height, width), *divmod(pixel, width), MISSING)

    def height_at(self, pixel: int) -> float:
        """How high lies what a pixel shows over the surface that it stands over.

        Args:
            pixel: flat pixel v * W + u, of one that is not missing.

        Returns:
            The height, m.
        """
        view = self.views[0]
        row = np.searchsorted(view.pixels, pixel)
        point = transform(view.T_base_source, view.points[row : row + 1])
        return float(self.supports.heights(transform(invert(self.T_base_table), point))[0])

    def points_under(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Which points lie mostly under a mask.

        Args:
            mask: (H, W) bool, or (N,) beside the points of an unorganized cloud.

        Returns:
            (K,) bool.
        """
        inside = mask.reshape(-1)[self._shown.pixels]
        count = len(self.points)
        votes = np.bincount(self._shown.rows, inside, minlength=count)
        return np.asarray(2 * votes > np.bincount(self._shown.rows, minlength=count))

    def measured_under(self, mask: NDArray[np.bool_]) -> tuple[int, float]:
        """What a mask covers of the pixels with depth.

        Args:
            mask: (H, W) bool, or (N,) beside the points of an unorganized cloud.

        Returns:
            How many of them, and which share of those that show table or background.
        """
        flat = mask.reshape(-1)
        measured = int(np.count_nonzero(flat[self.views[0].pixels]))
        background = len(self.views[0].pixels) - len(self._shown.pixels)
        covered = measured - int(np.count_nonzero(flat[self._shown.pixels]))
        return measured, covered / max(background, 1)

    def pixels_between(self, first: int, second: int) -> tuple[NDArray[np.int64], Floats]:
        """The pixels on a straight line in the image between those that show two points.

        Args:
            first: row of a point.
            second: row of another one.

        Returns:
            (n,) int64 flat pixels v * W + u, without the two ends, and (n,) where each lies on the
            way, from 0 to 1; none where there is no image or the first view does not show both.
        """
        ends = [self._shown.pixels[self._shown.rows == row][:1] for row in (first, second)]
        if self.shape is None or not all(len(end) for end in ends):
            return np.empty(0, dtype=np.int64), np.empty(0)
        v, u = np.divmod(np.concatenate(ends).astype(np.int64), self.shape[1])
        steps = max(int(abs(v[1] - v[0])), int(abs(u[1] - u[0])), 1)
        along = np.arange(1, steps) / steps
        at = [np.rint(k[0] + (k[1] - k[0]) * along).astype(np.int64) for k in (v, u)]
        return at[0] * self.shape[1] + at[1], along

    def target_window(self, target_mask: NDArray[np.bool_], margin_px: int) -> TargetWindow | None:
        """The image round a target.

        Args:
            target_mask: (K,) bool, the target's points.
            margin_px: how far the window reaches past the target's pixels.

        Returns:
            The window, or None where there is no image or it shows none of the target's points.
        """
        pixels = self._shown.pixels[target_mask[self._shown.rows]]
        if self.shape is None or len(pixels) == 0:
            return None
        height, width = self.shape
        v, u = np.divmod(pixels, width)
        v0, v1 = max(int(v.min()) - margin_px, 0), min(int(v.max()) + margin_px + 1, height)
        u0, u1 = max(int(u.min()) - margin_px, 0), min(int(u.max()) + margin_px + 1, width)
        mask = np.zeros((v1 - v0, u1 - u0), dtype=bool)
        mask[v - v0, u - u0] = True
        rows, columns = slice(v0, v1), slice(u0, u1)
        points = transform(self.T_base_source, self._image_points(rows, columns))
        sides = (u0 == 0, u1 == width, v0 == 0, v1 == height)
        return TargetWindow(mask, points, rows, columns, sides)

    def _image_points(self, rows: slice, columns: slice) -> Points:
        """(h, w, 3) points of a window of the image, source frame, NaN where missing."""
        view, (_, width) = self.views[0], self.shape or (0, 0)
        height, across = rows.stop - rows.start, columns.stop - columns.start
        points = np.full((height, across, 3), np.nan, dtype=np.float32)
        # Points are in pixel order, so each image row is a slice of them.
        starts = np.arange(rows.start, rows.stop, dtype=np.int32) * width + columns.start
        starts = starts.astype(np.int32)
        firsts = np.searchsorted(view.pixels, starts).tolist()
        lasts = np.searchsorted(view.pixels, starts + np.int32(across)).tolist()
        for row, (start, first, last) in enumerate(zip(starts, firsts, lasts, strict=True)):
            points[row, view.pixels[first:last] - start] = view.points[first:last]
        return points

    def object_image(self) -> NDArray[np.int32]:
        """The number of the object that each pixel shows.

        Returns:
            (H, W) int32, 0 for none.

        Raises:
            SceneError: the view has no image.
        """
        if self.shape is None:
            raise SceneError("an unorganized cloud has no pixels; valid: a view with an image")
        image = np.zeros(self.shape[0] * self.shape[1], dtype=np.int32)
        image[self._shown.pixels] = self.object_numbers[self._shown.rows]
        return image.reshape(self.shape)

    def objects_with_pixels(self) -> tuple[SceneObject, ...]:
        """The objects, each with the one of its own pixels that is nearest to their mean.

        Returns:
            The objects by their numbers; as they are where there is no image.
        """
        if self.shape is None:
            return self.objects
        pixels = self._shown.pixels.astype(np.int64)
        numbers = self.object_numbers[self._shown.rows]
        v, u = np.divmod(pixels, self.shape[1])
        count = np.maximum(np.bincount(numbers, minlength=len(self.objects) + 1), 1)
        mean_u = np.bincount(numbers, u, minlength=len(self.objects) + 1) / count
        mean_v = np.bincount(numbers, v, minlength=len(self.objects) + 1) / count
        off = (u - mean_u[numbers]) ** 2 + (v - mean_v[numbers]) ** 2
        order = np.lexsort((pixels, off, numbers))
        first = np.searchsorted(numbers[order], np.arange(1, len(self.objects) + 1))
        found = []
        for item, k in zip(self.objects, first.tolist(), strict=True):
            shown = k < len(order) and numbers[order[k]] == item.number
            pixel = (int(u[order[k]]), int(v[order[k]])) if shown else None
            found.append(replace(item, pixel=pixel))
        return tuple(found)


def _spacing_m(points: Points) -> float:
    """How far points lie apart, m: the median of some of them; 0 for a few."""
    some = slice(None, None, max(2, len(points) // _SPACING_SAMPLE))
    others = np.delete(points, some, axis=0)
    if len(others) == 0:
        return 0.0
    asked = np.ascontiguousarray(points[some])
    off = asked - others[nearest(asked, np.ascontiguousarray(others))]
    return float(np.median(np.linalg.norm(off, axis=1)))
