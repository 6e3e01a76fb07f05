"""Whether the frames that a view was given in fit what it shows.

A pose that is wrong rarely leaves a table level. What costs time is tried only where no level
plane is found, or a tilted or a small one.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, Points
from boxgrasp.errors import CodedWarning, FrameCode, FramesError, PoseReading, SceneError
from boxgrasp.forks import cached_property
from boxgrasp.geometry.plane import Plane
from boxgrasp.geometry.transforms import T_LINK_OPTICAL, invert, make_transform
from boxgrasp.perception.support_plane import find_support_plane
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.sensor_model import SensorModel

# Found on cast tables, and on real captures with poses of known error.
_SAMPLE = 5_000  # points tell the share on a plane as well as all
_TILTED_RAD = np.deg2rad(5.0)  # a soft-tired base and a rough calibration are off by up to 3
_REFUSED_RAD = np.deg2rad(12.0)  # as the search for level planes has it: a fit may turn past it
_ON_M = 0.015  # m from a plane: its own points, noise included
_FEW_SHARE = 0.35  # of all points, below which a level plane is held against the largest in view
_MORE = 1.2  # times its points that a tilted plane must hold to be the table instead
_READ_SHARE = 0.2  # of all points, on a plane that only another reading of the pose makes level
_FACES_UP = np.sin(np.deg2rad(15.0))  # in the image: a wall faces the camera or down

# A cloud with z up, read as optical, shows things behind an opaque plane, or aside of any view.
_CLOUD_SAMPLE = 20_000
_IN_Z_SHARE = 0.1  # of the points at one z, from which it may be a table's height
_LEVEL_M = 0.01  # m from the plane, the table's own
_CROWD_M = 0.04  # m from it, of which a table's own are the most:
_CROWD_SHARE = 0.65  # 0.78 and more of real tables, 0.61 and less of cuts through slanted ones
_OVER_M = (0.02, 0.30)  # m over the plane, where things on it are looked for
_THROUGH_SHARE = 0.004  # of the plane's points that are seen through it
_MIXED_SHARE = 0.01  # the same, where noise at steps may show as much on either side:
_MIXED_GAIN = 2.0  # of what is seen behind the plane and before it
_ASIDE = np.tan(np.deg2rad(70.0))  # of the angle to the axis: the widest depth cameras see to 60
_ASIDE_SHARE = 0.5  # of the points
_ROW = 1 << 32  # between the numbers of cells beside each other along x
_CELL_M = 0.025  # m, cells in which the plane was seen

_WORDS: Final = MappingProxyType(
    {
        "inverse": "its inverse would make it level (is it T_camera_base?)",
        "camera_link": "as that of camera_link (x forward, y left, z up) it would make it level",
        "opengl": "as that of a camera with y up and z backward it would make it level",
    }
)
_NO_FIT: Final = "neither its inverse nor the axes of camera_link would make it level"
_VALID: Final = "valid: the pose of the optical frame (z forward, x right, y down), z of base up"
_BASE_CLOUD: Final = (
    "the cloud reads as one in a base frame with z up: taken as optical, it shows things behind "
    "an opaque plane or aside of any camera's view; try --cloud-frame base (cloud_frame='base' "
    "in Python)"
)


@dataclass(frozen=True)
class FrameDoubt:
    """Why the frames of a view are doubted.

    Attributes:
        code: what does not fit.
        tilt_rad: of the plane in view against the pose's vertical, rad; None where no pose is
            doubted.
        fits: readings of the pose under which that plane would be level.
    """

    code: FrameCode
    tilt_rad: float | None = None
    fits: tuple[PoseReading, ...] = ()

    @property
    def message(self) -> str:
        """In one sentence."""
        if self.tilt_rad is None:
            return _BASE_CLOUD
        seen = {
            "no_level_plane": "no level support plane found: the plane that is seen",
            "support_plane_tilted": "the support plane",
            "larger_plane_tilted": "a larger plane than the level one that was taken",
        }[self.code]
        fits = " or ".join(_WORDS[name] for name in self.fits) or _NO_FIT
        return (
            f"{seen} is tilted by {np.rad2deg(self.tilt_rad):.1f} degrees against T_base_camera; "
            f"suspect T_base_camera: {fits}; {_VALID}"
        )

    def warning(self) -> CodedWarning:
        """As an answer warns of it.

        Returns:
            The warning.
        """
        return CodedWarning(self.code, self.message)

    def error(self, before: str = "") -> FramesError:
        """As the view is refused for it.

        Args:
            before: what is said before it.

        Returns:
            The error.
        """
        return FramesError(self.code, f"{before}{self.message}", self.tilt_rad, self.fits)


@dataclass(frozen=True, eq=False)
class FrameCheck:
    """A view whose frames may be wrong.

    Attributes:
        capture: the view.
        points: (N, 3) float32 its points, source frame, m.
        max_range_m: how far from the camera objects are looked for, m.
        sensor: whose noise the points have.
    """

    capture: Capture
    points: Points
    max_range_m: float
    sensor: SensorModel

    def without_plane(self) -> FrameDoubt | None:
        """Why no support plane was found, where the frames are to blame.

        Returns:
            The doubt, or None where they are not.
        """
        if self._reads_as_base:
            return FrameDoubt("cloud_in_base_frame")
        seen = self._seen_plane or self._read_plane()
        return None if seen is None else self._tilted("no_level_plane", seen)

    def without_objects(self) -> FrameDoubt | None:
        """Why nothing stands on a plane that nothing else speaks against, if by its frame.

        Returns:
            The doubt, or None.
        """
        return FrameDoubt("cloud_in_base_frame") if self._reads_as_base else None

    def with_plane(self, plane: Plane) -> FrameDoubt | None:
        """What speaks against the frames though a support plane was found.

        Args:
            plane: the support plane, source frame.

        Returns:
            The doubt, or None.

        Raises:
            FramesError: the plane is tilted more than a support plane may be.
        """
        if self._crowds_in_z and self._reads_as_base:
            return FrameDoubt("cloud_in_base_frame")
        tilted = self._tilted("support_plane_tilted", plane)
        if tilted is not None:
            if tilted.tilt_rad is not None and tilted.tilt_rad > _REFUSED_RAD:
                raise FrameDoubt("no_level_plane", tilted.tilt_rad, tilted.fits).error()
            return tilted
        if self._up is None or self._share_on(plane) >= _FEW_SHARE:
            return None
        seen = self._seen_plane
        if seen is None or seen.normal[1] > -_FACES_UP:
            return None
        more = self._share_on(seen) >= _MORE * self._share_on(plane)
        return self._tilted("larger_plane_tilted", seen) if more else None

    @property
    def _up(self) -> Floats | None:
        """(3,) against gravity in the optical frame, as the pose has it."""
        T = self.capture.T_base_camera
        return None if T is None or self.capture.cloud_frame != "optical" else T[2, :3]

    @cached_property
    def _seen_plane(self) -> Plane | None:
        """The support plane that the view shows whatever the pose says; None for none."""
        if self._up is None:
            return None
        try:
            return self._plane(None)
        except SceneError:
            return None

    def _read_plane(self) -> Plane | None:
        """A plane of some size that another reading of the pose makes level; None for none.

        For views whose table does not face up in the image, as that of a camera laid on its side.
        """
        T = self.capture.T_base_camera
        if self._up is None or T is None:
            return None
        for read in pose_readings(T).values():
            try:
                plane = self._plane(read[2, :3])
            except SceneError:
                continue
            if self._share_on(plane) >= _READ_SHARE:
                return plane
        return None

    def _plane(self, up: Floats | None) -> Plane:
        return find_support_plane(self.points, up, np.zeros(3), self.max_range_m, self.sensor)

    def _tilted(self, code: FrameCode, plane: Plane) -> FrameDoubt | None:
        up, T = self._up, self.capture.T_base_camera
        if up is None or T is None:
            return None
        tilt_rad = _angle_rad(plane.normal, up)
        if tilt_rad <= _TILTED_RAD:
            return None
        fits = [
            name for name, read in pose_readings(T).items()
            if _angle_rad(plane.normal, read[2, :3]) <= _TILTED_RAD
        ]  # fmt: skip
        return FrameDoubt(code, tilt_rad, tuple(fits))

    def _share_on(self, plane: Plane) -> float:
        some = self.points[:: max(1, len(self.points) // _SAMPLE)]
        return float(np.mean(np.abs(plane.heights(some)) < _ON_M))

    @property
    def _is_optical_cloud(self) -> bool:
        return self.capture.points is not None and self.capture.cloud_frame == "optical"

    @property
    def _crowds_in_z(self) -> bool:
        """Whether one z holds so much of a cloud that it may be a table's height."""
        if not self._is_optical_cloud or len(self.points) == 0:
            return False
        z = np.sort(self.points[:: max(1, len(self.points) // _SAMPLE), 2])
        held = np.searchsorted(z, z + np.float32(2 * _LEVEL_M)) - np.arange(len(z))
        return bool(held.max() >= _IN_Z_SHARE * len(z))

    @cached_property
    def _reads_as_base(self) -> bool:
        """Whether a cloud taken as optical shows a table with z up and what no camera sees."""
        if not self._is_optical_cloud:
            return False
        up = np.array([0.0, 0.0, 1.0])
        try:
            plane = find_support_plane(self.points, up, None, self.max_range_m, self.sensor)
        except SceneError:
            return False
        if plane.offset_m >= 0 or _angle_rad(plane.normal, up) > _TILTED_RAD:
            return False
        some = self.points[:: max(1, len(self.points) // _CLOUD_SAMPLE)].astype(np.float64)
        heights = some @ plane.normal + plane.offset_m
        if np.mean(np.hypot(some[:, 0], some[:, 1]) > _ASIDE * some[:, 2]) > _ASIDE_SHARE:
            return True
        on = np.abs(heights) < _LEVEL_M
        if np.count_nonzero(on) < _CROWD_SHARE * np.count_nonzero(np.abs(heights) < _CROWD_M):
            return False
        seen = _inner(np.unique(_cells(some[on])))
        low_m, high_m = _OVER_M
        over = some[(heights > low_m) & (heights < high_m)]
        under = some[(heights < -low_m) & (heights > -high_m)]
        through = _crossing(over, plane, seen)
        clear = through > _MIXED_GAIN * _crossing(under, plane, seen)
        least = _THROUGH_SHARE if clear else _MIXED_SHARE
        return bool(through > least * np.count_nonzero(on))


def pose_readings(T_base_camera: Floats) -> dict[PoseReading, Floats]:
    """What a pose would be if it were meant otherwise.

    Args:
        T_base_camera: (4, 4) as it was given.

    Returns:
        (4, 4) T_base_camera of the optical frame, by what was given in its place: `inverse`
        (T_camera_base), `camera_link` (x forward, y left, z up), `opengl` (y up, z backward).
    """
    flipped = make_transform(np.diag((1.0, -1.0, -1.0)), np.zeros(3))
    return {
        "inverse": invert(T_base_camera),
        "camera_link": T_base_camera @ T_LINK_OPTICAL,
        "opengl": T_base_camera @ flipped,
    }


def _angle_rad(one: Floats, other: Floats) -> float:
    """Between two unit vectors."""
    return float(np.arctan2(np.linalg.norm(np.cross(one, other)), one @ other))


def _cells(points: Floats) -> NDArray[np.int64]:
    """(N,) the cell of the plan that each point lies in."""
    at = np.floor(points[:, :2] / _CELL_M).astype(np.int64)
    return np.asarray(at[:, 0] * _ROW + at[:, 1])


def _inner(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of some cells, rising, amid others: past the edge of a plane one sees by right."""
    beside = [np.isin(cells + by, cells) for by in (-_ROW, _ROW, -1, 1)]
    return np.asarray(cells[np.logical_and.reduce(beside)])


def _crossing(points: Floats, plane: Plane, seen: NDArray[np.int64]) -> int:
    """How many lines from the origin to a point meet a plane where it was seen."""
    met = points * (-plane.offset_m / (points @ plane.normal))[:, None]
    return int(np.count_nonzero(np.isin(_cells(met), seen)))
