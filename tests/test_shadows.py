"""Edges beside holes in the depth: a projector's shadow is explained, other holes are unknown."""

from __future__ import annotations

import numpy as np
import pytest
from helpers import drawn

from boxgrasp import Capture, GraspSelector, Selection, Target
from boxgrasp.geometry.transforms import invert, make_transform, transform
from boxgrasp.sensing.sensor_model import XTION
from boxgrasp.simulate import Box, Plane, Primitive, cast
from boxgrasp.simulate.camera import intrinsics_matrix, look_at
from boxgrasp.simulate.noise import NoiseModel, add_noise

K = intrinsics_matrix()
CAMERA = look_at((0.0, 0.0, 0.55), (0.8, 0.0, 0.05))
LOWER_BOUNDS = {"width_x_lower_bound", "width_y_lower_bound"}


def block(x: tuple[float, float], y: tuple[float, float], high: float, low: float = 0.0) -> Box:
    """A box from its bounds, m; it may float over the table."""
    size = np.array([x[1] - x[0], y[1] - y[0], high - low])
    middle = (sum(x) / 2, sum(y) / 2, (low + high) / 2)
    return Box(make_transform(np.eye(3), middle), size, (200, 60, 50), 0)


def shadowed(solids: list[Primitive], T: np.ndarray, offset_m: tuple[float, float]) -> np.ndarray:
    """The view's depth, 0 where a projector beside the camera does not see the surface.

    offset_m: of the projector along the image's u and v.
    """
    depth = cast(solids, K, T).depth
    T_camera_projector = make_transform(np.eye(3), (*offset_m, 0.0))
    lit = cast(solids, K, T @ T_camera_projector).depth
    v, u = np.nonzero(depth > 0)
    z = depth[v, u]
    points = np.column_stack(((u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z))
    x, y, far = transform(invert(T_camera_projector), points).T
    pu, pv = (np.rint(K[k, k] * of / far + K[k, 2]).astype(int) for k, of in ((0, x), (1, y)))
    inside = (pu >= 0) & (pu < 640) & (pv >= 0) & (pv < 480)
    hit = lit[np.clip(pv, 0, 479), np.clip(pu, 0, 639)]
    dark = inside & (hit > 0) & (hit < far - 0.01)
    out = depth.copy()
    out[v[dark], u[dark]] = 0.0
    return out


def answer(depth: np.ndarray, T: np.ndarray, pixel: tuple[int, int], seed: int) -> Selection:
    noisy = add_noise(depth, np.random.default_rng(seed), NoiseModel())
    return GraspSelector().select(Capture(noisy, K, T), Target(pixel=pixel))


def bounds_of(found: Selection) -> set[str]:
    return {warning.code for warning in found.warnings} & LOWER_BOUNDS


BOX = block((0.76, 0.84), (-0.05, 0.05), 0.16)
ON_BOX = (320, 215)


@pytest.mark.parametrize("offset_m", [(0.075, 0.0), (-0.075, 0.0), (0.0, 0.075), (0.0, -0.075)])
def test_the_projectors_shadow_hides_no_edge(offset_m: tuple[float, float]) -> None:
    """Beside a thing and behind it, wider than the holes that are bridged; the box is right."""
    solids = [Plane(0.0), BOX]
    depth = shadowed(solids, CAMERA, offset_m)
    plain = cast(solids, K, CAMERA).depth
    assert np.count_nonzero((depth == 0) & (plain > 0)) > 700
    found = answer(depth, CAMERA, ON_BOX, 1)
    assert bounds_of(found) == set() and found.status == "grasp"
    np.testing.assert_allclose(np.sort(found.box.dimensions_m), [0.08, 0.10, 0.16], atol=0.008)


def test_shadows_on_drawn_tables_cost_few_answers() -> None:
    """Lone things and crowded ones: next to no edge is unknown that was known without shadows."""
    plain = shaded = 0
    for seed in range(10):
        scene = drawn(seed, (0, 3))
        depth = cast(scene.primitives, K, scene.T_base_camera).depth
        own = cast(scene.primitives, K, scene.T_base_camera).object_ids == scene.target_id
        dark = shadowed(list(scene.primitives), scene.T_base_camera, (0.075, 0.0))
        v, u = np.nonzero(own & (dark > 0))
        middle = np.argmin((u - u.mean()) ** 2 + (v - v.mean()) ** 2)
        pixel = (int(u[middle]), int(v[middle]))
        plain += len(bounds_of(answer(depth, scene.T_base_camera, pixel, seed)))
        shaded += len(bounds_of(answer(dark, scene.T_base_camera, pixel, seed)))
    assert shaded <= plain + 2


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("shadows", [False, True])
def test_a_thing_that_goes_on_without_depth_is_not_gripped_by_what_is_seen(
    side: int, shadows: bool
) -> None:
    """24 cm wide, of which 6 are measured: as a box of two materials, one of them black."""
    half = 0.12
    thing = block((0.77, 0.83), (-half, half), 0.14)
    solids: list[Primitive] = [Plane(0.0), thing]
    exact = cast(solids, K, CAMERA).depth
    depth = shadowed(solids, CAMERA, (0.075, 0.0)) if shadows else exact.copy()
    own = cast(solids, K, CAMERA).object_ids == 0
    v, u = np.nonzero(own)
    left = u.min() + (u.max() - u.min()) / 4
    right = u.max() - (u.max() - u.min()) / 4
    seen = u < left if side > 0 else u > right
    depth[v[~seen], u[~seen]] = 0.0
    pixel = (int(np.median(u[seen])), int(np.median(v[seen])))
    found = answer(depth, CAMERA, pixel, 2)
    across = int(np.argmax(np.abs(found.box.T_base_box[1, :2])))  # the box's axis along y
    assert found.box.dimensions_m[across] < 0.10
    assert np.isinf(found.box.dimensions_at_most_m[across])
    if found.grasp is not None:  # it closes the other way
        finger = found.grasp.T_base_gripper[:3, 1]
        assert abs(finger[1]) < 0.5


def test_a_hole_of_a_centimeter_is_bridged() -> None:
    """A strip without depth all round a thing, as edges lose it, leaves its edges known."""
    solids: list[Primitive] = [Plane(0.0), BOX]
    view = cast(solids, K, CAMERA)
    depth, own = view.depth.copy(), view.object_ids == 0
    ring = own.copy()
    for _ in range(7):
        for axis in (0, 1):
            ring |= np.roll(ring, 1, axis) | np.roll(ring, -1, axis)
    depth[ring & ~own] = 0.0
    assert bounds_of(answer(depth, CAMERA, ON_BOX, 3)) == set()


def test_the_bound_goes_with_the_baseline() -> None:
    """What an Xtion's baseline explains a sensor with one eye does not."""
    solids: list[Primitive] = [Plane(0.0), block((0.66, 0.74), (-0.05, 0.05), 0.35, 0.20)]
    depth = shadowed(solids, CAMERA, (0.075, 0.0))
    noisy = add_noise(depth, np.random.default_rng(1), NoiseModel())
    told = []
    for baseline_m in (XTION.baseline_m, 0.0):
        config = {"scene": {"sensor": {"baseline_m": baseline_m}}}
        target = Target(pixel=(320, 90))
        told.append(bounds_of(GraspSelector(config).select(Capture(noisy, K, CAMERA), target)))
    assert told[0] == set() and told[1] != set()


def test_an_organized_cloud_knows_the_same_edges() -> None:
    """In the optical and in the base frame, as its depth image."""
    depth = shadowed([Plane(0.0), BOX], CAMERA, (0.075, 0.0))
    wide = depth.copy()
    wide[:, 330:] = 0.0
    for image in (depth, wide):
        noisy = add_noise(image, np.random.default_rng(1), NoiseModel())
        capture = Capture(noisy, K, CAMERA)
        points = np.full((480, 640, 3), np.nan, dtype=np.float32)
        own, pixels = capture.valid_points()
        points.reshape(-1, 3)[pixels] = own
        optical = Capture.from_cloud(points, T_base_camera=CAMERA)
        moved = transform(CAMERA, points)
        base = Capture.from_cloud(moved, T_base_camera=CAMERA, cloud_frame="base")
        told = [
            bounds_of(GraspSelector().select(of, Target(pixel=(310, 215))))
            for of in (capture, optical, base)
        ]
        assert told[0] == told[1] == told[2]
        assert bool(told[0]) == (image is wide)
