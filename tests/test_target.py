"""Which object is meant: every way to point at one, and every way to point wrongly."""

from __future__ import annotations

import re
from functools import cache
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from helpers import TABLE_M, item, laid, seen
from PIL import Image

from boxgrasp import Capture, GraspSelector, Target, load_capture
from boxgrasp.errors import TargetError
from boxgrasp.kernels.table_cells import dilated
from boxgrasp.perception.find_scene import find_scene
from boxgrasp.perception.scene import Scene
from boxgrasp.perception.scene_config import SceneConfig
from boxgrasp.perception.target import find_target
from boxgrasp.simulate import cast, to_capture
from boxgrasp.simulate.camera import intrinsics_matrix, look_at
from boxgrasp.simulate.primitives import Box, Plane, upright

CUBE, TUBE, CAN = 2, 3, 4
LAID = laid(
    item("green_cube", 0.85, 0.0), item("crisps_tube", 0.95, 0.22), item("beans_can", 0.75, -0.2)
)
OBJECT_IDS = LAID.view().object_ids


@cache
def view() -> tuple[Capture, Scene]:
    capture = seen(LAID, 0)
    return capture, find_scene(capture, (), SceneConfig())


def plain(**changes: object) -> Capture:
    """The view without a target of its own."""
    capture = view()[0]
    parts = {"depth": capture.depth, "rgb": capture.rgb, **changes}
    depth, rgb = parts.pop("depth"), parts.pop("rgb")
    return Capture(depth, capture.intrinsics, capture.T_base_camera, rgb, **parts)  # type: ignore[arg-type]


def true_object(points: np.ndarray) -> int:
    """The object whose true middle is nearest to the points' middle, in plan."""
    middle = (points[:, :2].max(axis=0) + points[:, :2].min(axis=0)) / 2
    places = {CUBE: (0.85, 0.0), TUBE: (0.95, 0.22), CAN: (0.75, -0.2)}
    away = {number: float(np.hypot(*(middle - place))) for number, place in places.items()}
    nearest = min(away, key=lambda k: away[k])
    assert away[nearest] < 0.05
    return nearest


def chosen(target: Target | None, capture: Capture | None = None) -> int:
    scene = view()[1] if capture is None else find_scene(capture, (), SceneConfig())
    own = find_target(scene, capture or view()[0], target).target_mask
    assert own.dtype == bool and own.shape == (len(scene.points),) and own.any()
    return true_object(scene.points[own])


def middle_pixel(wanted: int) -> tuple[int, int]:
    v, u = np.nonzero(OBJECT_IDS == wanted)
    return int(np.median(u)), int(np.median(v))


@pytest.mark.parametrize("wanted", [CUBE, TUBE, CAN])
def test_by_pixel_point_mask_and_number(wanted: int) -> None:
    capture, scene = view()
    assert chosen(Target(pixel=middle_pixel(wanted))) == wanted
    assert chosen(Target(mask=wanted == OBJECT_IDS)) == wanted
    assert chosen(Target(mask=(wanted == OBJECT_IDS).astype(np.uint8) * 255)) == wanted
    middle = LAID.primitives[wanted].T_base_solid[:3, 3]  # type: ignore[union-attr]
    eye = LAID.T_base_camera[:3, 3]
    own = scene.points[find_target(scene, capture, Target(mask=wanted == OBJECT_IDS)).target_mask]
    nearest = own[np.argmin(np.linalg.norm(np.cross(own - eye, middle - eye), axis=1))]
    assert chosen(Target(point=tuple(nearest.tolist()))) == wanted
    assert chosen(Target(point=tuple((nearest + (0, 0, 0.02)).tolist()))) == wanted
    numbers = [k for k in (1, 2, 3) if chosen(Target(object=k)) == wanted]
    assert len(numbers) == 1


def test_every_pixel_of_an_object_means_it() -> None:
    capture, scene = view()
    assert capture.depth is not None
    rng = np.random.default_rng(0)
    for wanted in (CUBE, TUBE, CAN):
        base = OBJECT_IDS == wanted
        v, u = np.nonzero(base)
        # The lowest rows of an object vanish in the table's noise.
        low = v > v.min() + 0.8 * np.ptp(v)
        for k in rng.choice(np.flatnonzero(~low), 30, replace=False):
            own = find_target(scene, capture, Target(pixel=(int(u[k]), int(v[k])))).target_mask
            assert true_object(scene.points[own]) == wanted


def test_the_captures_own_target() -> None:
    assert chosen(None) == CUBE  # the target pixel
    mask, pixel = OBJECT_IDS == TUBE, middle_pixel(CAN)
    assert chosen(None, plain(mask=mask)) == TUBE
    assert chosen(None, plain(target_pixel=pixel)) == CAN
    both = plain(mask=mask, target_pixel=pixel)
    assert chosen(None, both) == TUBE  # a mask counts before a pixel
    assert chosen(Target(pixel=pixel), both) == CAN  # what the caller says counts before both
    assert chosen(Target(object=1), both) == chosen(Target(object=1))


@pytest.mark.parametrize("wanted", [CUBE, TUBE, CAN])
def test_a_pixel_without_depth_takes_the_nearest_with_it(wanted: int) -> None:
    u, v = middle_pixel(wanted)
    depth = np.array(view()[0].depth)
    depth[v - 3 : v + 4, u - 3 : u + 4] = 0
    assert chosen(Target(pixel=(u, v)), plain(depth=depth)) == wanted
    depth[v - 8 : v + 9, u - 8 : u + 9] = 0  # what shows round a larger hole is the same thing's
    assert chosen(Target(pixel=(u, v)), plain(depth=depth)) == wanted


def test_a_hole_at_the_edge_takes_the_object_and_not_the_table() -> None:
    """Left of the tube's edge: table is as near as the object, but was not pointed at."""
    v, u = np.nonzero(OBJECT_IDS == TUBE)
    row = int(np.median(v))
    edge = int(u[v == row].min())
    depth = np.array(view()[0].depth)
    depth[row - 6 : row + 7, edge - 4 : edge + 3] = 0
    pixel = (edge, row)  # table from 4 px to the left, tube from 3 px to the right
    assert chosen(Target(pixel=pixel), plain(depth=depth)) == TUBE


def test_a_mask_wins_over_the_segmentation() -> None:
    """Half of a box is half of it; the union of two things that touch is one target."""
    capture, scene = view()
    v, u = np.nonzero(OBJECT_IDS == TUBE)
    half = (OBJECT_IDS == TUBE) & (np.arange(OBJECT_IDS.shape[0])[:, None] < np.median(v))
    own = find_target(scene, capture, Target(mask=half)).target_mask
    whole = find_target(scene, capture, Target(mask=OBJECT_IDS == TUBE)).target_mask
    assert own.sum() < 0.7 * whole.sum()
    assert not (own & ~whole).any()

    pair = laid(item("green_cube", 0.85, -0.0305), item("green_cube", 0.85, 0.0305))
    pair_capture = seen(pair, 0)
    found = find_scene(pair_capture, (), SceneConfig())
    object_ids = pair.view().object_ids
    left, right, both = (
        find_target(found, pair_capture, Target(mask=np.isin(object_ids, wanted))).target_mask
        for wanted in ([2], [3], [2, 3])
    )
    assert np.ptp(found.points[left][:, 1]) < 0.066
    assert np.ptp(found.points[right][:, 1]) < 0.066
    assert np.ptp(found.points[both][:, 1]) == pytest.approx(0.121, abs=0.006)
    assert not (left & right).any()


def test_points_are_the_targets_or_in_its_way_but_a_masks_rim() -> None:
    capture, scene = view()
    for target in (None, Target(object=2), Target(pixel=middle_pixel(CAN))):
        found = find_target(scene, capture, target)
        in_the_way = ~found.target_mask & ~scene.floor_mask
        np.testing.assert_array_equal(found.obstacle_mask, in_the_way)
    found = find_target(scene, capture, Target(mask=OBJECT_IDS == CAN))
    assert not (found.target_mask & found.obstacle_mask).any()
    rim = scene.points[~(found.target_mask | found.obstacle_mask | scene.floor_mask)]
    target = scene.points[found.target_mask][::5]
    near = np.linalg.norm(rim[:, None] - target[None], axis=2).min(axis=1)
    assert near.max(initial=0.0) < 0.05


def test_a_masks_bleed_on_other_things_falls_off() -> None:
    mask = OBJECT_IDS == TUBE
    v, u = np.nonzero(OBJECT_IDS == CAN)
    bleed = mask.copy()
    bleed[v[:200], u[:200]] = True
    capture, scene = view()
    own = find_target(scene, capture, Target(mask=bleed)).target_mask
    assert true_object(scene.points[own]) == TUBE
    assert np.ptp(scene.points[own][:, 1]) < 0.09


def test_points_and_numbers_of_an_unorganized_cloud() -> None:
    scene = LAID
    points, _ = to_capture(scene, noise=False)[0].valid_points()
    cloud = Capture.from_cloud(points[::2])
    found = find_scene(cloud, (), SceneConfig())
    assert len(found.objects) == 3
    own = find_target(found, cloud, Target(object=2)).target_mask
    again = tuple(found.points[own][5].tolist())
    np.testing.assert_array_equal(own, find_target(found, cloud, Target(point=again)).target_mask)
    with pytest.raises(TargetError, match="no pixels"):
        find_target(found, cloud, Target(pixel=(3, 4)))
    with pytest.raises(TargetError, match="no target given"):
        find_target(found, cloud, None)


def test_mask_of_an_unorganized_cloud() -> None:
    capture = view()[0]
    points, pixels = capture.valid_points()
    marked = (OBJECT_IDS == CAN).reshape(-1)[pixels]
    assert capture.T_base_camera is not None
    order = np.random.default_rng(0).permutation(len(points))
    cloud = Capture.from_cloud(
        points[order], mask=marked[order], T_base_camera=capture.T_base_camera
    )
    found = find_scene(cloud, (), SceneConfig())
    own = find_target(found, cloud, None).target_mask
    assert true_object(found.points[own]) == CAN


# Masks as detectors give them


def grown(mask: np.ndarray, rings: int) -> np.ndarray:
    return np.asarray(dilated(mask, rings))


@pytest.mark.parametrize("wanted", [CUBE, TUBE, CAN])
@pytest.mark.parametrize("rings", [0, 3])
def test_a_mask_of_one_thing_is_not_warned_of(wanted: int, rings: int) -> None:
    capture, scene = view()
    found = find_target(scene, capture, Target(mask=grown(wanted == OBJECT_IDS, rings)))
    assert found.warnings == ()
    assert true_object(scene.points[found.target_mask]) == wanted


@pytest.mark.parametrize("wanted", list(combinations((CUBE, TUBE, CAN), 2)))
def test_a_mask_over_two_things_apart_is_refused_and_both_are_named(
    wanted: tuple[int, int],
) -> None:
    capture, scene = view()
    with pytest.raises(TargetError, match=r"two things \d+ cm apart") as caught:
        find_target(scene, capture, Target(mask=np.isin(OBJECT_IDS, wanted)))
    named = re.findall(r"object (\d)", str(caught.value))
    assert {chosen(Target(object=int(number))) for number in named} == set(wanted)


@pytest.mark.parametrize("wanted", [CUBE, TUBE, CAN])
@pytest.mark.parametrize("rings", [0, 3])
def test_an_inverted_mask_is_refused_and_its_object_is_named(wanted: int, rings: int) -> None:
    capture, scene = view()
    with pytest.raises(TargetError, match="inverted") as caught:
        find_target(scene, capture, Target(mask=~grown(wanted == OBJECT_IDS, rings)))
    (named,) = re.findall(r"all but object (\d)", str(caught.value))
    assert chosen(Target(object=int(named))) == wanted


@pytest.mark.parametrize("share", [0.7, 0.9, 1.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_mask_over_most_of_the_image_is_refused(share: float, axis: int) -> None:
    capture, scene = view()
    at = np.indices(OBJECT_IDS.shape)[axis]
    mask = at >= (1 - share) * OBJECT_IDS.shape[axis]
    with pytest.raises(TargetError, match="of the table and background") as caught:
        find_target(scene, capture, Target(mask=mask))
    assert f"{mask.mean():.0%} of the image" in str(caught.value)
    assert ("inverted" in str(caught.value)) <= (share < 1.0)


def cast_view(*solids: Box, place: tuple[float, float, float]) -> tuple[Capture, np.ndarray]:
    """A view of things on the plane z = 0 from a place towards the origin, and who is where."""
    T, K = look_at(place, (0.0, 0.0, 0.05)), intrinsics_matrix()
    cast_scene = cast([Plane(0.0), *solids], K, T)
    return Capture(np.array(cast_scene.depth), K, T), np.asarray(cast_scene.object_ids)


def block(number: int, at: tuple[float, float], size: tuple[float, float, float]) -> Box:
    return Box(upright(*at, size[2] / 2), np.array(size), object_id=number)


def test_a_thing_that_fills_most_of_the_image_is_answered() -> None:
    capture, ids = cast_view(block(1, (0.0, 0.0), (0.5, 0.5, 0.12)), place=(-0.25, 0.0, 0.62))
    mask = ids == 1
    assert mask.mean() > 0.5
    scene = find_scene(capture, (), SceneConfig())
    found = find_target(scene, capture, Target(mask=mask))
    assert found.warnings == ()
    with pytest.raises(TargetError, match="inverted"):
        find_target(scene, capture, Target(mask=~mask))


@pytest.mark.parametrize("hidden", [True, False])
def test_what_a_nearer_thing_parts_may_be_one_thing(hidden: bool) -> None:
    """A bar behind a post, and two bars with nothing before the gap between them."""
    halves = [block(1, (0.1, y), (0.05, 0.10, 0.06)) for y in (-0.09, 0.09)]
    bar = [block(1, (0.1, 0.0), (0.05, 0.28, 0.06)), block(2, (0.02, 0.0), (0.06, 0.06, 0.2))]
    capture, ids = cast_view(*(bar if hidden else halves), place=(-0.7, 0.0, 0.35))
    scene = find_scene(capture, (), SceneConfig())
    target = Target(mask=ids == 1)
    if hidden:
        assert find_target(scene, capture, target).warnings == ()
    else:
        with pytest.raises(TargetError, match="8 cm apart"):
            find_target(scene, capture, target)


def test_a_mask_over_two_things_that_touch_is_warned_of() -> None:
    pair = laid(item("crisps_tube", 0.85, -0.035), item("green_cube", 0.85, 0.035))
    capture, ids = seen(pair, 0), pair.view().object_ids
    scene = find_scene(capture, (), SceneConfig())
    assert len(scene.objects) == 2
    found = find_target(scene, capture, Target(mask=ids >= 2))
    assert [warning.code for warning in found.warnings] == ["mask_over_two"]
    assert "object 1" in str(found.warnings[0]) and "object 2" in str(found.warnings[0])
    answer = GraspSelector().select(capture, Target(mask=ids >= 2))
    assert "mask_over_two" in [warning.code for warning in answer.warnings]


def test_right_masks_of_labeled_captures_are_neither_refused_nor_warned_of(
    labeled_dir: Path,
) -> None:
    """Some of the things are cut in two by a nearer one."""
    folders = sorted(path.parent for path in labeled_dir.glob("*/labels.png"))[::5]
    for folder in folders:
        capture = load_capture(folder)
        scene = find_scene(capture, (), SceneConfig())
        labels = np.asarray(Image.open(folder / "labels.png"))
        for number in range(2, int(labels.max()) + 1):
            mask = labels == number
            if np.count_nonzero(mask) < 400:
                continue
            assert find_target(scene, capture, Target(mask=mask)).warnings == (), folder
            with pytest.raises(TargetError, match="of the table and background"):
                find_target(scene, capture, Target(mask=~mask))


@pytest.mark.parametrize("wanted", [CUBE, TUBE, CAN])
def test_by_a_detectors_box(wanted: int) -> None:
    v, u = np.nonzero(OBJECT_IDS == wanted)
    tight = (u.min(), v.min(), u.max(), v.max())
    assert chosen(Target(box=tight)) == wanted
    for off in ((-6, -4, 5, 8), (7, 7, 7, 7), (4, 3, -4, -3)):
        assert chosen(Target(box=tuple(np.add(tight, off)))) == wanted


def test_a_mask_without_depth_says_so() -> None:
    mask = np.zeros(OBJECT_IDS.shape, bool)
    mask[100:120, 100:120] = True
    depth = np.array(view()[0].depth)
    depth[mask] = 0
    holed = plain(depth=depth)
    scene = find_scene(holed, (), SceneConfig())
    with pytest.raises(TargetError, match="no pixel with depth"):
        find_target(scene, holed, Target(mask=mask))


EMPTY = np.zeros(OBJECT_IDS.shape, bool)
WRONG = {
    "two at once": lambda: Target(pixel=(1, 2), object=1),
    "all at once": lambda: Target((1, 2), EMPTY, (0.0, 0.0, 0.0), 1, (0, 0, 9, 9)),
    "box on nothing": lambda: Target(box=(2, 2, 40, 40)),
    "box of everything": lambda: Target(box=(0, 0, 639, 479)),
    "box outside": lambda: Target(box=(700, 10, 800, 40)),
    "box upside down": lambda: Target(box=(100, 80, 40, 120)),
    "box NaN": lambda: Target(box=(float("nan"), 2, 40, 40)),
    "box of three": lambda: Target(box=(1, 2, 3)),  # type: ignore[arg-type]
    "box of text": lambda: Target(box=("a", "b", "c", "d")),  # type: ignore[arg-type]
    "right of the image": lambda: Target(pixel=(640, 100)),
    "above the image": lambda: Target(pixel=(100, -1)),
    "pixel not a number": lambda: Target(pixel=("a", 2)),  # type: ignore[arg-type]
    "pixel NaN": lambda: Target(pixel=(float("nan"), 2)),  # type: ignore[arg-type]
    "pixel infinite": lambda: Target(pixel=(float("inf"), 2)),  # type: ignore[arg-type]
    "pixel of three": lambda: Target(pixel=(1, 2, 3)),  # type: ignore[arg-type]
    "pixel a number": lambda: Target(pixel=7),  # type: ignore[arg-type]
    "table": lambda: Target(pixel=(320, int(np.nonzero(OBJECT_IDS == 1)[0].max()) - 2)),
    "floor": lambda: Target(pixel=(2, 2)),
    "empty mask": lambda: Target(mask=EMPTY),
    "mask of another size": lambda: Target(mask=np.ones((48, 64), bool)),
    "flat mask": lambda: Target(mask=np.ones(480 * 640, bool)),
    "mask of numbers": lambda: Target(mask=EMPTY + 0.5),
    "mask of text": lambda: Target(mask="mask.png"),
    "mask on the table": lambda: Target(mask=_table_patch()),
    "mask of the table": lambda: Target(mask=OBJECT_IDS == 1),
    "mask of everything": lambda: Target(mask=np.ones(OBJECT_IDS.shape, np.uint8)),
    "mask of everything but a thing": lambda: Target(mask=OBJECT_IDS != CAN),
    "mask of all things": lambda: Target(mask=OBJECT_IDS > 1),
    "point in the air": lambda: Target(point=(0.85, 0.0, 1.4)),
    "point beyond all numbers": lambda: Target(point=(1e300, 0.0, 1.4)),
    "point on the table": lambda: Target(point=(0.60, 0.30, TABLE_M)),
    "point NaN": lambda: Target(point=(float("nan"), 0.0, 0.8)),
    "point of two": lambda: Target(point=(0.8, 0.0)),  # type: ignore[arg-type]
    "point of text": lambda: Target(point=("a", "b", "c")),  # type: ignore[arg-type]
    "object 0": lambda: Target(object=0),
    "object 4": lambda: Target(object=4),
    "object -1": lambda: Target(object=-1),
    "object True": lambda: Target(object=True),
    "object 1.5": lambda: Target(object=1.5),  # type: ignore[arg-type]
    "object 'one'": lambda: Target(object="one"),  # type: ignore[arg-type]
}


def _table_patch() -> np.ndarray:
    mask = np.zeros(OBJECT_IDS.shape, bool)
    v = int(np.nonzero(OBJECT_IDS == 1)[0].max())
    mask[v - 8 : v - 2, 300:340] = True
    return mask


@pytest.mark.parametrize("case", WRONG)
def test_wrong_targets_are_refused_in_one_line(case: str) -> None:
    capture, scene = view()
    with pytest.raises(TargetError) as caught:
        find_target(scene, capture, WRONG[case]())
    assert "\n" not in str(caught.value) and "valid" in str(caught.value)


def test_no_target_is_refused() -> None:
    with pytest.raises(TargetError, match="no target given"):
        GraspSelector().select(plain())


def test_numpy_numbers_are_numbers() -> None:
    assert chosen(Target(object=np.int64(1))) == chosen(Target(object=1))  # type: ignore[arg-type]
    u, v = middle_pixel(TUBE)
    assert chosen(Target(pixel=(np.int32(u), np.int64(v)))) == TUBE  # type: ignore[arg-type]
    assert chosen(Target(point=np.array(view()[1].points[0]))) in (CUBE, TUBE, CAN)  # type: ignore[arg-type]
