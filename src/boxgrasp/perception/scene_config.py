"""How objects are found: the settings of section `scene`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, ClassVar

from msgspec import Meta

from boxgrasp.errors import ConfigError
from boxgrasp.perception.segmentation import SEGMENTATIONS
from boxgrasp.sensing.sensor_model import SENSORS, SensorModel, SensorName

Meters = Annotated[float, Meta(gt=0.0, le=20.0)]
Corner = tuple[float, float, float]


@dataclass(frozen=True)
class SceneConfig:
    """How objects are found; the numbers of the thesis's appendix A unless said otherwise.

    Attributes:
        min_range_m: pass-through, Euclidean distance of an object from the camera, m.
        max_range_m: likewise, m. Things beyond are obstacles, but no objects.
        voxel_m: edge of the voxels that points are downsampled to, m.
        cluster_tolerance_m: points nearer than this are one object, m.
        segmentation: `network` tells things apart in the depth image; `split` parts them in the
            cloud, at gaps and steps; `euclidean` is the thesis's.
        network: path of a network that `boxgrasp train segmentation` wrote, None for the one that
            ships.
        min_height_m: height over the plane under which a point is the table's, m.
        sensor: what saw the scene, `xtion`, `realsense` or `tof`, or numbers of your own; ours.
        noise_gain: how many times the camera's axial noise is added to `min_height_m`; ours.
        max_height_m: height over the plane up to which points count, m.
        outlier_nb_neighbors: nearest neighbors whose mean distance tells an outlier.
        outlier_std_ratio: standard deviations over the mean from which a point is an outlier.
        min_cluster_size: least points of an object.
        workspace_m: two opposite corners in the base frame, m; outside are no objects.

    Raises:
        ConfigError: no segmentation has that name.
    """

    min_range_m: Annotated[float, Meta(ge=0.0, le=20.0)] = 0.4
    max_range_m: Meters = 1.6
    voxel_m: Annotated[float, Meta(ge=0.001, le=0.02)] = 0.003
    cluster_tolerance_m: Annotated[float, Meta(ge=0.004, le=0.2)] = 0.015
    segmentation: str = "network"
    network: str | None = None
    sensor: SensorName | SensorModel = "xtion"
    min_height_m: Annotated[float, Meta(ge=0.0, le=0.1)] = 0.003
    noise_gain: Annotated[float, Meta(ge=0.0, le=20.0)] = 2.5
    max_height_m: Meters = 1.0
    outlier_nb_neighbors: Annotated[int, Meta(ge=1, le=100)] = 5
    outlier_std_ratio: Annotated[float, Meta(gt=0.0, le=20.0)] = 2.0
    min_cluster_size: Annotated[int, Meta(ge=1)] = 20
    workspace_m: tuple[Corner, Corner] | None = None

    RENAMED: ClassVar[dict[str, str]] = {
        "near_m": "min_range_m",
        "far_m": "max_range_m",
        "lowest_m": "min_height_m",
        "highest_m": "max_height_m",
        "cluster_m": "cluster_tolerance_m",
        "least_points": "min_cluster_size",
        "outlier_neighbours": "outlier_nb_neighbors",
        "outlier_sigma": "outlier_std_ratio",
    }

    def __post_init__(self) -> None:
        if self.segmentation not in SEGMENTATIONS:
            raise ConfigError(
                f"scene.segmentation is {self.segmentation!r}; valid: {', '.join(SEGMENTATIONS)}"
            )

    @property
    def sensor_model(self) -> SensorModel:
        """The sensor's numbers, before a capture's own focal length is known."""
        return SENSORS[self.sensor] if isinstance(self.sensor, str) else self.sensor
