"""A depth camera: how its depth scatters, how far its pixels lie apart, where it throws shadows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Annotated, Final, Literal

import numpy as np
from msgspec import Meta

from boxgrasp.arrays import Points

# Spacings of the pixels; measured on sides of cast boxes that are seen as outlines.
EDGE_NOISE: Final = np.float32(0.4)

# Taken for the range where the camera's place is unknown.
UNKNOWN_RANGE_M: Final = np.float32(1.05)

SensorName = Literal["xtion", "realsense", "tof"]


@dataclass(frozen=True)
class SensorModel:
    """One kind of depth camera; the defaults are an Xtion's.

    The standard deviation of depth at range r is floor + growth (r - least_at)^2, m.

    Attributes:
        noise_floor_m: least standard deviation, m.
        noise_growth_per_m: what it grows by with the square of the range from there, 1/m.
        noise_least_at_m: range at which it is least, m.
        noise_by_focal: whether the growth holds for images of `focal_px` alone, and goes with
            1 / focal length: so it is where a share of a pixel is what cannot be told.
        focal_px: focal length of its finest images, px; a capture's own goes first where it is
            shorter. A longer one is of an image enlarged to a color camera's: it tells no more.
        baseline_m: between its two eyes, or eye and projector, m: what only one of them sees has
            no depth; 0 for none.
    """

    noise_floor_m: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.0012
    noise_growth_per_m: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.0019
    noise_least_at_m: Annotated[float, Meta(ge=0.0, le=10.0)] = 0.4
    noise_by_focal: bool = False
    focal_px: Annotated[float, Meta(ge=10.0, le=20_000.0)] = 525.0
    baseline_m: Annotated[float, Meta(ge=0.0, le=1.0)] = 0.075

    def seen_with(self, focal_px: float | None) -> SensorModel:
        """The camera that took a capture.

        Args:
            focal_px: of its image, or None where it is unknown, as for a cloud.

        Returns:
            The same with the focal length at which the capture shows what was measured.
        """
        if focal_px is None or focal_px >= self.focal_px:
            return self
        growth = self.noise_growth_per_m
        if self.noise_by_focal:
            growth *= self.focal_px / focal_px
        return replace(self, focal_px=focal_px, noise_growth_per_m=growth)

    @property
    def noise(self) -> tuple[float, float, float]:
        """Floor, growth and range of the least noise, m, 1/m, m, as kernels take them."""
        return self.noise_floor_m, self.noise_growth_per_m, self.noise_least_at_m

    def axial_noise_m(self, ranges_m: Points) -> Points:
        """Standard deviation of the camera's depth.

        Args:
            ranges_m: (...) float32, distance from the camera, m.

        Returns:
            (...) float32, m.
        """
        off = ranges_m - np.float32(self.noise_least_at_m)
        noise_m = self.noise_floor_m + self.noise_growth_per_m * off**2
        return np.asarray(noise_m, dtype=np.float32)

    def pixel_spacing_m(self, ranges_m: Points) -> Points:
        """How far apart neighboring pixels fall on a surface that faces the camera.

        Args:
            ranges_m: (...) float32, distance from the camera, m.

        Returns:
            (...) float32, m.
        """
        return np.asarray(ranges_m / np.float32(self.focal_px), dtype=np.float32)

    def edge_noise_m(self, ranges_m: Points) -> Points:
        """Standard deviation of where a surface is seen to end, which is past its last pixel.

        Args:
            ranges_m: (...) float32, distance from the camera, m.

        Returns:
            (...) float32, m.
        """
        return EDGE_NOISE * self.pixel_spacing_m(ranges_m)


# Noise: Nguyen, Izadi and Lovell, 3DIMPVT 2012: 1.2 mm + 1.9 mm (z - 0.4 m)^2. Baseline:
# Khoshelham and Oude Elberink, Sensors 12, 2012 (Kinect; the Xtion has the same sensor).
XTION: Final = SensorModel()
# Of the two sensors below the form is their sources'; the coefficients have not been checked
# against recordings of such cameras.
# Noise z^2 subpixel / (focal length x baseline), with subpixel 0.08, focal length 640 px (1280
# pixels over 90 degrees) and baseline 50 mm, a D435's: Intel, Tuning depth cameras for best
# performance, revision 2.0.
REALSENSE: Final = SensorModel(
    noise_floor_m=0.0,
    noise_growth_per_m=0.08 / (640.0 * 0.050),
    noise_least_at_m=0.0,
    noise_by_focal=True,
    focal_px=640.0,
    baseline_m=0.050,
)
# A Kinect v2's, facing a surface: 1.5 - 0.5 z + 0.3 z^2 mm, z in meters, here as a square of the
# distance from its least: Fankhauser et al., ICAR 2015. The focal length is an Azure Kinect's
# (640 x 576). One eye, one clock: no baseline.
TOF: Final = SensorModel(
    noise_floor_m=0.00129,
    noise_growth_per_m=0.0003,
    noise_least_at_m=0.83,
    focal_px=504.0,
    baseline_m=0.0,
)
SENSORS: Final[Mapping[str, SensorModel]] = MappingProxyType(
    {"xtion": XTION, "realsense": REALSENSE, "tof": TOF}
)
