"""Hollow and flat things, holes in the depth and the image's border, against cast truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from boxgrasp import Capture, GraspSelector, Target
from boxgrasp.errors import TargetError
from boxgrasp.kernels.table_cells import most_round
from boxgrasp.perception.scene import Scene
from boxgrasp.perception.target import find_target
from boxgrasp.simulate import cast
from boxgrasp.simulate.camera import intrinsics_matrix, look_at
from boxgrasp.simulate.noise import add_noise
from boxgrasp.simulate.primitives import Box, Cylinder, Plane, upright

TABLE_M = 0.80
TABLE_ID = 1
WALL_M = 0.004
Solids = list[Box | Cylinder]
TABLE = (
    Plane(0.0),
    Box(upright(0.9, 0.0, TABLE_M / 2), np.array((1.2, 1.6, TABLE_M)), object_id=TABLE_ID),
)


def block(number: int, at: Sequence[float], size: Sequence[float], yaw: float = 0.0) -> Solids:
    """A box on the table: x, y and perhaps the height of its foot over the table."""
    x, y, z = (*at, 0.0)[:3]
    pose = upright(x, y, TABLE_M + z + size[2] / 2, yaw)
    return [Box(pose, np.array(size), object_id=number)]


def hollow(
    number: int,
    at: Sequence[float],
    radius_m: float,
    height_m: float,
    floor_m: float = 0.004,
    gap_rad: float = 0.0,
) -> Solids:
    """A round thing open to the top: a ring of thin boxes on a disc, open towards the camera."""
    parts = 32
    disc = upright(at[0], at[1], TABLE_M + floor_m / 2)
    solids: Solids = [Cylinder(disc, radius_m - WALL_M / 2, floor_m, object_id=number)]
    across = 2.1 * np.pi * radius_m / parts
    for angle in np.arange(parts) * 2 * np.pi / parts:
        if abs(angle - np.pi) < gap_rad / 2:
            continue
        foot = (at[0] + radius_m * np.cos(angle), at[1] + radius_m * np.sin(angle))
        solids += block(number, foot, (WALL_M, across, height_m), float(angle))
    return solids


def handle(
    number: int, at: Sequence[float], radius_m: float, height_m: float, angle: float
) -> Solids:
    """The handle of a mug, 4 cm out to one side: two bars and an upright one."""
    out = 0.04
    solids: Solids = []
    for away, low_m, size in (
        (radius_m + out / 2, 0.12 * height_m, (out, 0.01, 0.008)),
        (radius_m + out / 2, 0.85 * height_m, (out, 0.01, 0.008)),
        (radius_m + out, 0.12 * height_m, (0.008, 0.01, 0.8 * height_m)),
    ):
        foot = (at[0] + away * np.cos(angle), at[1] + away * np.sin(angle), low_m)
        solids += block(number, foot, size, angle)
    return solids


def exact_places(solids: Solids, capture: Capture) -> np.ndarray:
    """(H, W, 3) what each pixel of a view truly shows, base frame, m."""
    assert capture.T_base_camera is not None and capture.intrinsics is not None
    depth = cast([*TABLE, *solids], capture.intrinsics, capture.T_base_camera).depth
    v, u = np.indices(depth.shape)
    rays = np.stack((u, v, np.ones_like(u)), axis=-1) @ np.linalg.inv(capture.intrinsics).T
    T = capture.T_base_camera
    return np.asarray(rays * depth[..., None] @ T[:3, :3].T + T[:3, 3])


def viewed(
    solids: Solids, seed: int | None, away_m: float = 0.8, pitch_deg: float = 45.0
) -> tuple[Capture, np.ndarray]:
    """A view of the table round its point (0.85, 0), and (H, W) the object that a pixel shows."""
    pitch = np.deg2rad(pitch_deg)
    place = (0.85 - away_m * np.cos(pitch), 0.0, TABLE_M + away_m * np.sin(pitch))
    T = look_at(place, (0.85, 0.0, TABLE_M))
    K = intrinsics_matrix()
    view = cast([*TABLE, *solids], K, T)
    depth = np.array(view.depth)
    if seed is not None:
        depth = add_noise(depth, np.random.default_rng(seed))
    return Capture(depth, K, T), np.asarray(view.object_ids)


def scene_of(capture: Capture, segmentation: str = "split") -> Scene:
    return GraspSelector({"scene": {"segmentation": segmentation}}).scene(capture)


def named(scene: Scene, capture: Capture, pixel: tuple[int, int]) -> int:
    """Number of the object that a pixel means."""
    own = find_target(scene, capture, Target(pixel=pixel)).target_mask
    numbers = np.unique(scene.object_numbers[own])
    assert len(numbers) == 1
    return int(numbers[0])


def drawn_from(mask: np.ndarray, count: int, seed: int = 0) -> list[tuple[int, int]]:
    """Pixels (u, v) of a mask."""
    v, u = np.nonzero(mask)
    some = np.random.default_rng(seed).choice(len(v), min(count, len(v)), replace=False)
    return [(int(u[k]), int(v[k])) for k in some]


MUGS = {"mug": (0.04, 0.095, 0.004), "bowl": (0.075, 0.06, 0.003), "pot": (0.10, 0.11, 0.006)}


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("kind", MUGS)
@pytest.mark.parametrize("pitch_deg", [40.0, 60.0, 75.0])
def test_a_pixel_in_a_hollow_thing_means_it(kind: str, pitch_deg: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    at = (0.85 + rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1))
    other = block(3, (0.85, at[1] + 0.25), (0.06, 0.08, 0.10), rng.uniform(0, 1.5))
    solids = hollow(2, at, *MUGS[kind]) + other
    capture, truth = viewed(solids, seed, rng.uniform(0.6, 0.9), pitch_deg)
    scene = scene_of(capture)
    assert len(scene.objects) == 2
    numbers = scene.object_image()
    mine = np.bincount(numbers[(truth == 2) & (numbers > 0)]).argmax()
    places = exact_places(solids, capture)
    # The foot of its outside vanishes in the table's noise, its inside does not.
    in_it = np.hypot(places[..., 0] - at[0], places[..., 1] - at[1]) < MUGS[kind][0]
    assert capture.depth is not None
    told = (truth == 2) & (in_it | (places[..., 2] > TABLE_M + 0.015)) & (capture.depth > 0)
    refused = 0
    for pixel in drawn_from(told, 100, seed):
        try:
            assert named(scene, capture, pixel) == mine
        except TargetError:  # a pixel or two on the rim, whose cell shows the table too
            refused += 1
    assert refused <= 2
    assert np.count_nonzero(numbers[told] == mine) > 0.95 * np.count_nonzero(told)


@pytest.mark.parametrize("segmentation", ["split", "euclidean"])
@pytest.mark.parametrize("radius_m", [0.06, 0.09])
def test_a_floor_is_told_where_the_near_rim_is_not(radius_m: float, segmentation: str) -> None:
    """A low near rim is lost in a camera's noise, so that the rim is a C."""
    solids = hollow(2, (0.85, 0.05), radius_m, 0.05, 0.003, gap_rad=1.0)
    capture, truth = viewed(solids, 0, 0.7, 50.0)
    scene = scene_of(capture, segmentation)
    assert len(scene.objects) == 1
    places = exact_places(solids, capture)
    off = np.hypot(places[..., 0] - 0.85, places[..., 1] - 0.05)
    floor = (truth == 2) & (places[..., 2] < TABLE_M + 0.004) & (off < 0.6 * radius_m)
    assert np.count_nonzero(floor) > 500
    assert np.mean(scene.object_image()[floor] == 1) > 0.9


def test_table_in_the_arms_of_a_square_thing_is_no_floor() -> None:
    """As a drill on its side holds some between its body, its handle and its foot."""
    solids = [
        *block(2, (0.95, 0.0), (0.05, 0.20, 0.06)),
        *block(2, (0.85, 0.08), (0.15, 0.04, 0.06)),
        *block(2, (0.85, -0.08), (0.15, 0.04, 0.06)),
    ]
    capture, truth = viewed(solids, 0, 0.8, 60.0)
    scene = scene_of(capture, "euclidean")
    places = exact_places(solids, capture)
    amid = (truth == TABLE_ID) & (np.abs(places[..., 0] - 0.88) < 0.03)
    amid &= np.abs(places[..., 1]) < 0.04
    assert len(scene.objects) == 1 and np.count_nonzero(amid) > 500
    assert (scene.object_image()[amid] == 0).all()


def test_most_round_agrees_with_a_walk_in_eight_directions() -> None:
    rng = np.random.default_rng(5)
    for _ in range(20):
        owner = np.maximum(rng.integers(-8, 3, (17, 23)), -1)
        most, sides = most_round(owner)
        for v, u in np.ndindex(*owner.shape):
            met = [first_met(owner, v, u, dv, du) for dv, du in WAYS] if owner[v, u] < 0 else []
            met = [one for one in met if one >= 0]
            best = max((met.count(one) for one in met), default=0)
            assert sides[v, u] == best
            assert most[v, u] == -1 if best == 0 else met.count(most[v, u]) == best


WAYS = [(dv, du) for dv in (-1, 0, 1) for du in (-1, 0, 1) if (dv, du) != (0, 0)]


def first_met(owner: np.ndarray, v: int, u: int, dv: int, du: int) -> int:
    """The first cell that is not free along a direction, -1 for none."""
    while 0 <= v < owner.shape[0] and 0 <= u < owner.shape[1]:
        if owner[v, u] >= 0:
            return int(owner[v, u])
        v, u = v + dv, u + du
    return -1


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("angle_deg", [-90.0, 90.0, 60.0])
def test_the_table_through_a_handle_is_refused(angle_deg: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    at, size = (0.85, rng.uniform(-0.1, 0.1)), MUGS["mug"][:2]
    solids = hollow(2, at, *MUGS["mug"]) + handle(2, at, *size, np.deg2rad(angle_deg))
    capture, truth = viewed(solids, seed, 0.6)
    scene = scene_of(capture)
    through = enclosed_table(truth)
    assert np.count_nonzero(through) > 100
    assert (scene.object_image()[through] == 0).all()
    for pixel in drawn_from(through, 20):
        with pytest.raises(TargetError, match="on the table"):
            named(scene, capture, pixel)


def enclosed_table(truth: np.ndarray) -> np.ndarray:
    """(H, W) table pixels that pixels of objects enclose, 4 px off them."""
    open_ = np.zeros(truth.shape, dtype=bool)
    open_[0] = open_[-1] = True
    open_[:, 0] = open_[:, -1] = True
    table = truth <= TABLE_ID
    for _ in range(2000):
        wide = open_.copy()
        for axis, by in ((0, 1), (0, -1), (1, 1), (1, -1)):
            wide |= np.roll(open_, by, axis) & table
        if (wide == open_).all():
            break
        open_ = wide
    inside = table & ~open_
    for _ in range(4):
        inside = inside & np.all([np.roll(inside, b, a) for a in (0, 1) for b in (1, -1)], axis=0)
    return np.asarray(inside)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_table_between_things_is_refused(seed: int) -> None:
    """A gap that two boxes close to the camera's eye, and a yard between four of them."""
    rng = np.random.default_rng(seed)
    x, y = 0.85 + rng.uniform(-0.05, 0.05), rng.uniform(-0.05, 0.05)
    solids = [
        *block(2, (x - 0.09, y), (0.03, 0.24, 0.05)),
        *block(3, (x + 0.09, y), (0.03, 0.24, 0.12)),
        *block(4, (x, y - 0.11), (0.14, 0.02, 0.09)),
        *block(5, (x, y + 0.11), (0.14, 0.02, 0.07)),
    ]
    capture, truth = viewed(solids, seed, 0.8, 55.0)
    yard = enclosed_table(truth)
    assert np.count_nonzero(yard) > 500
    for segmentation in ("split", "euclidean"):
        scene = scene_of(capture, segmentation)
        if len(scene.objects) == 4:
            for pixel in drawn_from(yard, 20):
                with pytest.raises(TargetError, match="on the table"):
                    named(scene, capture, pixel)
    assert len(scene_of(capture).objects) >= 3


def test_what_a_tray_holds_can_be_taken_out_of_it() -> None:
    """A floor as low as the table is no obstacle, however near the hand comes to it."""
    cube = block(2, (0.85, 0.0, 0.004), (0.05, 0.05, 0.09))
    tray = block(3, (0.85, 0.0), (0.50, 0.70, 0.004))
    for x, y, size in (
        (0.85, 0.35, (0.50, 0.006, 0.022)),
        (0.85, -0.35, (0.50, 0.006, 0.022)),
        (0.60, 0.0, (0.006, 0.70, 0.022)),
        (1.10, 0.0, (0.006, 0.70, 0.022)),
    ):
        tray += block(3, (x, y), size)
    capture, truth = viewed([*cube, *tray], 0, 0.9, 55.0)
    scene = scene_of(capture)
    pixel = drawn_from(truth == 2, 1)[0]
    points = find_target(scene, capture, Target(pixel=pixel))
    assert scene.floor_mask.any() and not (points.obstacle_mask & scene.floor_mask).any()
    assert not points.target_mask[scene.floor_mask].any()
    selection = GraspSelector().select(capture, Target(pixel=pixel))
    assert selection.grasp is not None and selection.grasp.clearance_m is not None
    assert selection.grasp.clearance_m > 0.06


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("radius_px", [8, 20])
def test_a_hole_in_the_depth_means_the_thing_round_it(radius_px: int, seed: int) -> None:
    """A dark label or a shiny lid; where two things close the hole both are named."""
    rng = np.random.default_rng(seed)
    left = block(2, (0.85, 0.0605), (0.10, 0.12, 0.16))
    right = block(3, (0.85, -0.0605), (0.10, 0.12, 0.13))
    capture, truth = viewed([*left, *right], seed, 0.7, 20.0)
    assert capture.depth is not None
    v, u = np.indices(truth.shape)
    one = truth == 2
    middle = (int(np.median(u[one])), int(np.median(v[one])))
    hole = np.hypot(u - middle[0], v - middle[1]) < radius_px
    assert (truth[hole] == 2).all()
    holed = Capture(np.where(hole, 0, capture.depth), capture.intrinsics, capture.T_base_camera)
    scene = scene_of(holed)
    mine = np.bincount(scene.object_image()[one & ~hole]).argmax()
    assert mine > 0
    for pixel in drawn_from(hole, 10, int(rng.integers(9))):
        assert named(scene, holed, pixel) == mine
    seam = int(u[one].max()) if np.median(u[one]) < np.median(u[truth == 3]) else int(u[one].min())
    both = (np.abs(u - seam) < radius_px) & (np.abs(v - middle[1]) < radius_px)
    holed = Capture(np.where(both, 0, capture.depth), capture.intrinsics, capture.T_base_camera)
    with pytest.raises(TargetError, match="between objects 1 and 2|between objects 2 and 1"):
        named(scene_of(holed), holed, (seam, middle[1]))


def test_a_hole_beside_a_thing_is_refused() -> None:
    """The shadow that a projector leaves beside a thing borders the table too."""
    capture, truth = viewed(block(2, (0.85, 0.0), (0.10, 0.12, 0.16)), 0)
    assert capture.depth is not None
    v, u = np.nonzero(truth == 2)
    row, edge = int(np.median(v)), int(u[v == int(np.median(v))].min())
    depth = np.array(capture.depth)
    depth[row - 30 : row + 30, edge - 30 : edge] = 0
    holed = Capture(depth, capture.intrinsics, capture.T_base_camera)
    with pytest.raises(TargetError, match="no depth near"):
        named(scene_of(holed), holed, (edge - 15, row))


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("away_m", [0.6, 0.8])
def test_a_marker_six_millimeters_high_is_found(away_m: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    at = (0.85 + rng.uniform(-0.08, 0.08), rng.uniform(-0.15, 0.15))
    marker = block(2, at, (0.13, 0.012, 0.006), rng.uniform(0, 3))
    beside = block(3, (0.95, 0.3 if at[1] < 0 else -0.3), (0.06, 0.06, 0.10))
    capture, truth = viewed([*marker, *beside], seed, away_m, 50.0)
    assert capture.depth is not None
    scene = scene_of(capture)
    assert len(scene.objects) == 2
    numbers, measured = scene.object_image(), capture.depth > 0
    mine = np.bincount(numbers[(truth == 2) & (numbers > 0)]).argmax()
    either = ((numbers == mine) | (truth == 2)) & measured
    assert np.count_nonzero((numbers == mine) & (truth == 2)) > 0.6 * np.count_nonzero(either)
    box = GraspSelector().select(capture, Target(object=int(mine))).box
    assert np.sort(box.dimensions_m[:2])[1] == pytest.approx(0.13, abs=0.012)
    assert box.dimensions_m[2] < 0.012


@pytest.mark.parametrize("wave_m", [0.0, 0.002, 0.004])
@pytest.mark.parametrize("length_m", [0.08, 0.12, 0.20])
def test_a_table_in_waves_has_no_flat_things(wave_m: float, length_m: float) -> None:
    """Stereo and structured light show a flat table in waves of several millimeters."""
    capture, _ = viewed(block(2, (0.95, 0.3), (0.06, 0.06, 0.10)), None, 0.8, 50.0)
    assert capture.depth is not None
    places = exact_places(block(2, (0.95, 0.3), (0.06, 0.06, 0.10)), capture)
    phase = 2 * np.pi / length_m
    waves = wave_m * np.sin(phase * places[..., 0]) * np.sin(phase * places[..., 1] + 1.0)
    depth = (capture.depth - waves).astype(np.float32)
    noisy = add_noise(depth, np.random.default_rng(0))
    scene = scene_of(Capture(noisy, capture.intrinsics, capture.T_base_camera))
    assert len(scene.objects) == 1


@pytest.mark.parametrize("side", ["left", "right", "bottom"])
def test_a_thing_that_the_border_cuts_is_a_lower_bound(side: str) -> None:
    """Its pixels at the border name it, and what is cut is said."""
    size = (0.10, 0.16, 0.12)
    capture, truth = viewed(block(2, (0.85, 0.0), size), 0, 0.7, 45.0)
    assert capture.depth is not None and capture.intrinsics is not None
    v, u = np.nonzero(truth == 2)
    rows, columns = slice(None), slice(None)
    if side == "left":
        columns = slice(int(np.median(u)), None)
    elif side == "right":
        columns = slice(None, int(np.median(u)))
    else:
        rows = slice(None, int(v.min() + 0.6 * np.ptp(v)))
    K = np.array(capture.intrinsics)
    K[0, 2] -= columns.start or 0
    cut = Capture(capture.depth[rows, columns], K, capture.T_base_camera)
    mask = (truth == 2)[rows, columns] & (cut.depth > 0)
    border = np.zeros(mask.shape, dtype=bool)
    border[{"left": np.s_[:, :2], "right": np.s_[:, -2:], "bottom": np.s_[-2:]}[side]] = True
    scene = scene_of(cut)
    high = exact_places(block(2, (0.85, 0.0), size), capture)[rows, columns][..., 2] > 0.82
    for pixel in drawn_from(border & mask & high, 10):
        assert named(scene, cut, pixel) == 1
    selection = GraspSelector().select(cut, Target(object=1))
    assert any(warning.code == "target_cut" for warning in selection.warnings), selection.warnings
    box = selection.box
    if side == "bottom":  # the whole top is seen
        np.testing.assert_allclose(box.dimensions_m, size, atol=0.008)
    else:
        at_most = box.dimensions_at_most_m[1]
        assert box.dimensions_m[1] < size[1] - 0.02
        assert at_most is None or at_most > size[1]


# Masks of hollow things


BOWL = (2, (0.85, 0.0), 0.075, 0.07)


@pytest.mark.parametrize("lost", [0.3, 0.4, 0.5])
@pytest.mark.parametrize("pitch_deg", [40.0, 55.0])
def test_a_mask_that_lost_the_near_wall_of_a_bowl_is_completed(
    lost: float, pitch_deg: float
) -> None:
    capture, ids = viewed(hollow(*BOWL), seed=1, pitch_deg=pitch_deg)
    scene = scene_of(capture, "network")
    true = ids == 2
    whole = find_target(scene, capture, Target(mask=true)).target_mask
    found = find_target(scene, capture, Target(mask=upper(true, lost)))
    assert np.count_nonzero(found.target_mask & whole) >= 0.98 * np.count_nonzero(whole)
    assert not (found.obstacle_mask & whole).any() and found.warnings == ()
    assert np.ptp(scene.points[found.target_mask][:, 0]) == pytest.approx(0.154, abs=0.008)


@pytest.mark.parametrize("side", [-1, 1])
def test_completing_a_bowl_takes_nothing_of_what_touches_it(side: int) -> None:
    beside = block(3, (0.85, side * 0.117), (0.08, 0.08, 0.07))
    capture, ids = viewed(hollow(*BOWL) + beside, seed=1)
    scene = scene_of(capture, "network")
    taken = find_target(scene, capture, Target(mask=upper(ids == 2, 0.4))).target_mask
    others = find_target(scene, capture, Target(mask=ids == 3)).target_mask
    assert np.count_nonzero(taken & others) <= 0.02 * np.count_nonzero(others)


def test_a_mask_of_what_lies_in_a_bowl_of_its_side_or_of_half_a_solid_thing_stays() -> None:
    solids = hollow(2, (0.85, -0.12), 0.075, 0.07) + block(3, (0.86, -0.12, 0.004), (0.04,) * 3)
    capture, ids = viewed(solids + block(4, (0.85, 0.15), (0.15, 0.15, 0.07)), seed=1)
    scene = scene_of(capture, "network")
    bowl = ids == 2
    side = bowl & (np.arange(bowl.shape[1]) < np.median(np.nonzero(bowl)[1]))
    for mask in (ids == 3, side, upper(ids == 4, 0.4)):
        found = find_target(scene, capture, Target(mask=mask)).target_mask
        assert not (found & ~scene.points_under(mask)).any()


def upper(mask: np.ndarray, lost: float) -> np.ndarray:
    """A mask without its lowest rows, as many as hold a share of its pixels."""
    rows = np.arange(mask.shape[0])[:, None]
    return np.asarray(mask & (rows < np.quantile(np.nonzero(mask)[0], 1 - lost)))
