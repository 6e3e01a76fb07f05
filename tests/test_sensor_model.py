"""Each sensor's numbers against their sources, and a capture's own focal length in use."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from helpers import drawn
from scipy.spatial import cKDTree

from boxgrasp import Capture
from boxgrasp.config import config_hash, dump_config, load_config
from boxgrasp.errors import ConfigError
from boxgrasp.perception.find_scene import find_scene
from boxgrasp.perception.over_plane import inliers, points_over
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.perception.supports import ALONE
from boxgrasp.sensing.sensor_model import REALSENSE, SENSORS, TOF, XTION, SensorModel
from boxgrasp.simulate import cast
from boxgrasp.simulate.camera import intrinsics_matrix
from boxgrasp.strict import read_yaml

SPLIT = SceneConfig(segmentation="split")
RANGES_M = np.array([0.4, 0.7, 1.0, 1.6, 2.5], dtype=np.float32)
# Standard deviations as the sources give them, mm.
SOURCES_MM = {
    "xtion": 1.2 + 1.9 * (RANGES_M - 0.4) ** 2,  # Nguyen 2012
    "realsense": (1000 * RANGES_M) ** 2 * 0.08 / (640 * 50),  # Intel, a D435 at 1280 x 720
    "tof": 1.5 - 0.5 * RANGES_M + 0.3 * RANGES_M**2,  # Fankhauser 2015
}


@pytest.mark.parametrize("name", SOURCES_MM)
def test_noise_is_the_sources(name: str) -> None:
    found = SENSORS[name].axial_noise_m(RANGES_M)
    np.testing.assert_allclose(found * 1000, SOURCES_MM[name], atol=0.006, rtol=1e-5)


def test_every_preset_is_compared_with_a_source() -> None:
    assert set(SOURCES_MM) == set(SENSORS)


def test_noise_of_stereo_goes_with_the_captures_focal_length_and_of_others_does_not() -> None:
    doubled = REALSENSE.seen_with(REALSENSE.focal_px / 2).axial_noise_m(RANGES_M)
    np.testing.assert_allclose(doubled, 2 * REALSENSE.axial_noise_m(RANGES_M), rtol=1e-5)
    for sensor in (XTION, TOF):
        np.testing.assert_array_equal(
            sensor.seen_with(sensor.focal_px / 2).axial_noise_m(RANGES_M),
            sensor.axial_noise_m(RANGES_M),
        )
    assert REALSENSE.seen_with(None) is REALSENSE


@pytest.mark.parametrize("focal_px", [260.0, 300.0, 525.0])
def test_pixel_spacing_is_that_of_a_wall_seen_squarely(focal_px: float) -> None:
    intrinsics, shape = intrinsics_matrix(focal_px, (30, 40)), (30, 40)
    points, _ = Capture(np.full(shape, 0.9), intrinsics).valid_points()
    gaps = np.sort(cKDTree(points).query(points, 2)[0][:, 1])
    spacing = XTION.seen_with(focal_px).pixel_spacing_m(np.float32([0.9]))
    np.testing.assert_allclose(gaps, np.full(len(gaps), spacing[0]), rtol=1e-3)


def test_an_enlarged_image_tells_no_more() -> None:
    for sensor in SENSORS.values():
        assert sensor.seen_with(2 * sensor.focal_px) is sensor


def test_points_over_the_noise_of_each_sensor() -> None:
    """Against a loop over the points: height over the band, band by the sensor's formula."""
    rng = np.random.default_rng(3)
    points = rng.uniform((-0.5, -0.5, 0.0), (0.5, 0.5, 0.03), (500, 3)).astype(np.float32)
    camera, config = np.array([0.0, -0.8, 0.9]), SceneConfig()
    for sensor in (*SENSORS.values(), SensorModel(0.004, 0.0)):
        kept = []
        for k, point in enumerate(points.astype(np.float64)):
            away = np.sqrt(((point - camera) ** 2).sum()) - sensor.noise_least_at_m
            sigma = sensor.noise_floor_m + sensor.noise_growth_per_m * away**2
            if point[2] >= config.min_height_m + config.noise_gain * sigma:
                kept.append(k)
        _, rows = points_over(points, np.eye(4), camera, ALONE, sensor, config)
        assert rows.tolist() == kept


def test_trimming_knows_how_thinly_a_camera_samples() -> None:
    """A short lens: between a dense near patch and a thin far one, the far one is no outlier."""
    focal_px = 200.0
    near, far = (
        np.stack((*np.meshgrid(*2 * (np.arange(20) * z / focal_px,)), np.full((20, 20), z)), -1)
        for z in (0.6, 2.4)
    )
    points = np.vstack([near.reshape(-1, 3), far.reshape(-1, 3)[:200]]).astype(np.float32)
    sensor, camera = dataclasses.replace(XTION, focal_px=focal_px), np.zeros(3)
    config = SceneConfig(outlier_std_ratio=0.5)
    assert inliers(points, camera, sensor, config).all()
    assert not inliers(points, camera, dataclasses.replace(XTION, focal_px=2000.0), config).all()


def test_a_scene_uses_the_captures_own_focal_length() -> None:
    """The same view by a lens half as long finds the same things."""
    scene = drawn(4)
    found = []
    for focal_px, shape in ((525.0, (480, 640)), (262.5, (240, 320))):
        intrinsics = intrinsics_matrix(focal_px, shape)
        depth = cast(scene.primitives, intrinsics, scene.T_base_camera, shape).depth
        found.append(find_scene(Capture(depth, intrinsics, scene.T_base_camera), (), SPLIT))
    whole, half = found
    assert len(whole.objects) == len(half.objects)
    for one, other in zip(whole.objects, half.objects, strict=True):
        np.testing.assert_allclose(one.size_m, other.size_m, atol=0.012)


# The setting


@pytest.mark.parametrize("name", SENSORS)
def test_a_sensor_by_name(name: str) -> None:
    config = load_config({"scene": {"sensor": name}})
    assert config.scene.sensor_model is SENSORS[name]
    assert f"  sensor: {name}\n" in dump_config(config)


def test_the_default_is_the_xtion() -> None:
    assert load_config().scene.sensor == "xtion"
    assert load_config({"scene": {"sensor": {}}}).scene.sensor_model == XTION


def test_own_numbers_are_printed_read_back_and_hashed(tmp_path: object) -> None:
    own = {"noise_floor_m": 0.002, "focal_px": 610, "baseline_m": 0.0}
    config = load_config({"scene": {"sensor": own}})
    path = f"{tmp_path}/own.yaml"
    with open(path, "w", encoding="utf-8") as file:
        file.write(dump_config(config))
    assert load_config(path) == config
    sensor = read_yaml(path, ConfigError)["scene"]["sensor"]
    assert sensor == {**dataclasses.asdict(XTION), **own}
    hashes = {config_hash(load_config({"scene": {"sensor": of}})) for of in (own, *SENSORS, {})}
    assert len(hashes) == 5


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("kinect", "scene.sensor is 'kinect'; valid: xtion, realsense, tof or a section with"),
        (3, "scene.sensor is 3; valid: xtion, realsense, tof or a section with"),
        ([1], "scene.sensor is a list of 1; valid: xtion"),
        ({"noise_floor_m": -1}, "scene.sensor.noise_floor_m is -1; valid: a number at least 0"),
        ({"focal_px": float("nan")}, "scene.sensor.focal_px is nan; valid: a finite number"),
        ({"noise_by_focal": 3}, "scene.sensor.noise_by_focal is 3; valid: true or false"),
        ({"focal": 500}, "unknown key 'focal' in scene.sensor; valid: noise_floor_m"),
    ],
)
def test_what_is_no_sensor_is_one_line(given: object, said: str) -> None:
    with pytest.raises(ConfigError) as error:
        load_config({"scene": {"sensor": given}})
    assert str(error.value).startswith(f"configuration: {said}")
    assert "\n" not in str(error.value)
