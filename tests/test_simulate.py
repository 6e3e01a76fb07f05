"""The simulator against independent truth: naive rays, sampled surfaces, conventions by hand."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from boxgrasp.errors import BoxgraspError, SceneError
from boxgrasp.geometry.transforms import invert, make_transform, rotation_z
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.simulate import (
    Box,
    Cylinder,
    NoiseModel,
    Plane,
    add_noise,
    box_clearance,
    build_scene,
    candidate_truth,
    cast,
    demo_capture,
    demo_scene,
    draw_scene,
    load_objects,
    to_capture,
    true_box,
    true_candidates,
)
from boxgrasp.simulate.camera import intrinsics_matrix, look_at
from boxgrasp.simulate.distance import gap
from boxgrasp.simulate.noise import axial_sigma, color_noise, edge_pixels
from boxgrasp.simulate.scenes import PALETTE, TARGET_ID

K = intrinsics_matrix()
SHAPE = (480, 640)


def random_pose(rng: np.random.Generator, spread: float = 0.5) -> np.ndarray:
    return make_transform(
        Rotation.random(random_state=rng).as_matrix(), rng.uniform(-1, 1, 3) * spread
    )


def random_solids(rng: np.random.Generator, count: int) -> list[Box | Cylinder]:
    solids: list[Box | Cylinder] = []
    for k in range(count):
        T = random_pose(rng)
        if rng.random() < 0.5:
            solids.append(Box(T, rng.uniform(0.03, 0.3, 3), (k, 0, 0), 10 * k))
        else:
            radius, height = rng.uniform(0.02, 0.15), rng.uniform(0.03, 0.4)
            solids.append(Cylinder(T, radius, height, (k, 0, 0), 10 * k))
    return solids


def naive_hit(solid: Box | Cylinder | Plane, origin: np.ndarray, ray: np.ndarray) -> float:
    """Smallest positive t with origin + t ray on the solid, by its surfaces one by one."""
    T = invert(solid.T_base_solid)
    o, d = T[:3, :3] @ origin + T[:3, 3], T[:3, :3] @ ray
    found = []
    if isinstance(solid, Plane):
        found.append(-o[2] / d[2])
    elif isinstance(solid, Box):
        half = solid.dimensions_m / 2
        for axis in range(3):
            for side in (-1, 1):
                t = (side * half[axis] - o[axis]) / d[axis]
                if (np.abs(np.delete(o + t * d, axis)) <= np.delete(half, axis)).all():
                    found.append(t)
    else:
        roots = np.roots(
            [d[0] ** 2 + d[1] ** 2, 2 * (o[:2] @ d[:2]), o[:2] @ o[:2] - solid.radius_m**2]
        )
        found += [
            t.real for t in roots if t.imag == 0 and abs(o[2] + t.real * d[2]) <= solid.height_m / 2
        ]
        for side in (-1, 1):
            t = (side * solid.height_m / 2 - o[2]) / d[2]
            if np.hypot(*(o + t * d)[:2]) <= solid.radius_m:
                found.append(t)
    return min((t for t in found if t > 0), default=np.inf)


def sampled(solid: Box | Cylinder, step: float = 0.002) -> np.ndarray:
    """Points on every part of the surface, base frame, about `step` apart."""
    hx, hy, hz = solid.half_size

    def line(half: float) -> np.ndarray:
        return np.linspace(-half, half, int(2 * half / step) + 2)

    if isinstance(solid, Box):
        halves = np.array([hx, hy, hz])
        faces = []
        for axis in range(3):
            a, b = (axis + 1) % 3, (axis + 2) % 3
            ga, gb = np.meshgrid(line(halves[a]), line(halves[b]))
            for side in (-1, 1):
                face = np.empty((ga.size, 3))
                face[:, axis], face[:, a], face[:, b] = side * halves[axis], ga.ravel(), gb.ravel()
                faces.append(face)
        local = np.concatenate(faces)
    else:
        turn = np.linspace(0, 2 * np.pi, int(2 * np.pi * hx / step) + 2)
        t, z = (g.ravel() for g in np.meshgrid(turn, line(hz)))
        wall = np.stack([hx * np.cos(t), hx * np.sin(t), z], 1)
        t, r = (g.ravel() for g in np.meshgrid(turn, np.linspace(0, hx, int(hx / step) + 2)))
        lid = np.stack([r * np.cos(t), r * np.sin(t), np.full(t.size, hz)], 1)
        local = np.concatenate([wall, lid, lid * (1, 1, -1)])
    return local @ solid.T_base_solid[:3, :3].T + solid.T_base_solid[:3, 3]


def from_solid(solid: Box | Cylinder, points: np.ndarray) -> np.ndarray:
    """Distance of base-frame points from the solid, in closed form."""
    local = (points - solid.T_base_solid[:3, 3]) @ solid.T_base_solid[:3, :3]
    if isinstance(solid, Box):
        return np.linalg.norm(np.maximum(np.abs(local) - solid.dimensions_m / 2, 0), axis=1)
    radial = np.maximum(np.hypot(local[:, 0], local[:, 1]) - solid.radius_m, 0)
    return np.hypot(radial, np.maximum(np.abs(local[:, 2]) - solid.height_m / 2, 0))


# The caster


def test_cast_equals_naive_rays() -> None:
    rng = np.random.default_rng(0)
    for _ in range(6):
        solids = [Plane(-0.4, object_id=-5), *random_solids(rng, 8)]
        place = rng.uniform(0.9, 1.3) * Rotation.random(random_state=rng).as_matrix()[0]
        place[2] = abs(place[2])  # above the plane
        T = look_at(place, rng.uniform(-0.1, 0.1, 3))
        view = cast(solids, K, T)
        target = np.argwhere(view.solids > 0)
        pick = np.concatenate(
            [target[rng.integers(len(target), size=150)], rng.integers((0, 0), SHAPE, (60, 2))]
        )
        for v, u in pick:
            ray = T[:3, :3] @ ((u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], 1.0)
            hits = [naive_hit(solid, T[:3, 3], ray) for solid in solids]
            nearest = min(hits)
            if np.isinf(nearest):
                assert view.depth[v, u] == 0
                assert view.object_ids[v, u] == view.solids[v, u] == -1
                continue
            assert view.depth[v, u] == pytest.approx(nearest, rel=1e-6)
            k = view.solids[v, u]
            assert hits[k] == pytest.approx(nearest, abs=1e-9)
            assert view.object_ids[v, u] == solids[k].object_id
            assert tuple(view.rgb[v, u]) == solids[k].color


def test_rectangles_cut_nothing() -> None:
    rng = np.random.default_rng(1)
    whole = Cylinder(np.eye(4), 5.0, 1e-4)  # seen from within: its rectangle is the whole image
    for _ in range(10):
        solids = random_solids(rng, 3)
        T = look_at(rng.uniform(0.2, 1.0) * np.array([1.0, 0.3, 0.4]), rng.uniform(-0.3, 0.3, 3))
        near = cast(solids, K, T)
        # A camera with far more pixels to the side has other rectangles for the same rays.
        wide = K.copy()
        wide[:2, 2] += 200
        padded = cast(solids, wide, T, (SHAPE[0] + 400, SHAPE[1] + 400))
        inner = (slice(200, -200), slice(200, -200))
        np.testing.assert_allclose(near.depth, padded.depth[inner], atol=1e-6)
        np.testing.assert_array_equal(near.object_ids, padded.object_ids[inner])
    assert (cast([whole], K, look_at((1, 0, 2.0), (0, 0, 0))).object_ids == 0).all()


def test_axis_aligned_rays_meet_exact_depths() -> None:
    # The image's center ray is parallel to two slabs of the box, and to the cylinder's axis.
    odd = np.array([[500.0, 0, 100], [0, 500.0, 100], [0, 0, 1]])
    down = make_transform(np.diag([1.0, -1.0, -1.0]), (0, 0, 2.0))
    box = Box(make_transform(np.eye(3), (0, 0, 0.5)), (0.2, 0.2, 0.2))
    tube = Cylinder(make_transform(np.eye(3), (0, 0, 0.5)), 0.1, 0.3)
    assert cast([box], odd, down, (201, 201)).depth[100, 100] == np.float32(1.4)
    assert cast([tube], odd, down, (201, 201)).depth[100, 100] == np.float32(1.35)
    aside = make_transform(np.eye(3), (0.5, 0, 0.5))
    for solid in (Box(aside, (0.2, 0.2, 0.2)), Cylinder(aside, 0.1, 0.3)):
        assert cast([solid], odd, down, (201, 201)).depth[100, 100] == 0
    assert cast([Plane(3.0)], odd, down, (201, 201)).object_ids.max() == -1  # behind the camera


def test_depth_is_z_and_nearer_wins() -> None:
    view = cast(
        [Plane(0.0, object_id=3)], K, make_transform(np.diag([1.0, -1.0, -1.0]), (0, 0, 1.5))
    )
    np.testing.assert_array_equal(view.depth, np.full(SHAPE, 1.5, np.float32))
    scene = demo_scene()
    back = cast(scene.primitives[::-1], scene.intrinsics, scene.T_base_camera)
    np.testing.assert_array_equal(back.depth, scene.view().depth)
    assert (
        np.mean(back.object_ids != scene.view().object_ids) < 1e-4
    )  # only where two surfaces coincide
    assert (
        set(np.unique(back.object_ids)) == {-1, 0, 1, 2, 3, 4, 5, 6, 7, 8} - {-1}
        or -1 in back.object_ids
    )


def test_shading_changes_colors_alone() -> None:
    scene = demo_scene()
    flat, shaded = scene.view(), scene.view(shading=0.5)
    np.testing.assert_array_equal(flat.depth, shaded.depth)
    np.testing.assert_array_equal(flat.object_ids, shaded.object_ids)
    assert (shaded.rgb <= flat.rgb).all()
    assert len(np.unique(shaded.rgb[flat.object_ids == TARGET_ID], axis=0)) >= 2  # faces told apart
    for array in (flat.depth, flat.rgb, flat.object_ids, flat.solids):
        assert not array.flags.writeable


@pytest.mark.parametrize(
    "make",
    [
        lambda: Box(np.eye(4), (0.1, 0.0, 0.1)),
        lambda: Box(np.eye(4), (0.1, 0.1)),
        lambda: Box(np.diag([1.0, 1, -1, 1]), (0.1, 0.1, 0.1)),
        lambda: Cylinder(np.eye(4), np.nan, 0.1),
        lambda: Cylinder(np.eye(4), 0.1, -1.0),
        lambda: Plane(np.inf),
        lambda: cast([], K, np.eye(4)),
        lambda: cast([Plane(0.0)], K, np.eye(4), shading=2.0),
        lambda: look_at((0, 0, 1), (0, 0, 0)),
        lambda: NoiseModel(dropout=1.5),
        lambda: NoiseModel(sigma_m=-1.0),
        lambda: draw_scene(np.random.default_rng(0), "teapot"),
        lambda: draw_scene(np.random.default_rng(0), yaw="sideways"),
        lambda: draw_scene(np.random.default_rng(0), obstacles=(3, 1)),
        lambda: draw_scene(np.random.default_rng(0), obstacles=9, area_m=0.05),
        lambda: to_capture(demo_scene()),
        lambda: true_box(demo_scene(), mode="round"),
        lambda: build_scene({"target": {}}),
        lambda: load_objects("no such file.yaml"),
    ],
)
def test_wrong_input_is_one_line(make: object) -> None:
    with pytest.raises(BoxgraspError) as caught:
        make()  # type: ignore[operator]
    assert "\n" not in str(caught.value)


# Noise


def test_noise_has_the_stated_statistics() -> None:
    rng = np.random.default_rng(2)
    model = NoiseModel(step_m=0.0, dropout=0.0)
    for z in (0.5, 1.0, 2.0):
        depth = np.full(SHAPE, z, np.float32)
        errors = add_noise(depth, rng, model) - depth
        sigma = 0.0012 + 0.0019 * (z - 0.4) ** 2
        assert errors.std() == pytest.approx(sigma, rel=0.02)
        assert abs(errors.mean()) < 5 * sigma / np.sqrt(errors.size)
        assert axial_sigma(depth)[0, 0] == pytest.approx(sigma, rel=1e-5)


def test_noise_steps_and_drop_outs() -> None:
    rng = np.random.default_rng(3)
    scene = demo_scene()
    exact = scene.view().depth
    noisy = add_noise(exact, rng)
    steps = noisy.astype(float) * 1000
    assert np.abs(steps - np.rint(steps)).max() < 1e-3
    edge = edge_pixels(exact, 0.02)
    seen = (exact > 0) & (exact <= NoiseModel().range_m)
    lost = noisy == 0
    assert lost[edge & seen].mean() == pytest.approx(0.7, abs=0.03)
    assert lost[~edge & seen].mean() == pytest.approx(0.003, abs=0.001)
    assert lost[~seen].all()
    silhouette = np.zeros(SHAPE, bool)
    object_ids = scene.view().object_ids
    jump = np.abs(np.diff(exact, axis=1)) > 0.1
    silhouette[:, 1:] = jump & (object_ids[:, 1:] != object_ids[:, :-1]) & (exact[:, 1:] < 1.5)
    assert edge[silhouette & (exact < 1.5)].mean() > 0.99


def test_noise_can_be_switched_off() -> None:
    scene = demo_scene()
    capture, object_ids = to_capture(scene, noise=False)
    assert capture.depth is not None
    near = scene.view().depth <= 60
    np.testing.assert_array_equal(capture.depth[near], scene.view().depth[near])
    np.testing.assert_array_equal(object_ids, scene.view().object_ids)
    still = NoiseModel(0, 0, 0, 0.02, 0, 0, 100.0, 0)
    np.testing.assert_array_equal(
        add_noise(scene.view().depth, np.random.default_rng(0), still), scene.view().depth
    )


def test_color_noise_has_its_sigma() -> None:
    gray = np.full((200, 300, 3), 120, np.uint8)
    noisy = color_noise(gray, np.random.default_rng(4)).astype(float)
    assert noisy.std() == pytest.approx(4.0, rel=0.03)
    assert noisy.mean() == pytest.approx(120, abs=0.1)


# Objects and scenes


def test_objects_have_the_thesis_dimensions() -> None:
    sizes = {}
    for name, item in load_objects().items():
        if item.set != "obstacle":
            solid = item.place(0, 0, 0)[0]
            sizes[name] = tuple(np.round(2 * solid.half_size, 6).tolist())
            assert solid.T_base_solid[2, 3] == pytest.approx(solid.half_size[2])
    assert sizes == {
        "crisps_tube": (0.08, 0.08, 0.23),
        "biscuits_pack": (0.058, 0.058, 0.18),
        "cereal_x": (0.20, 0.04, 0.15),
        "cereal_y": (0.04, 0.20, 0.15),
        "cereal_z": (0.04, 0.15, 0.20),
        "beans_can": (0.10, 0.10, 0.10),
        "cigarettes": (0.08, 0.05, 0.02),
        "green_cube": (0.06, 0.06, 0.06),
    }
    groups = {name: item.set for name, item in load_objects().items() if item.set != "obstacle"}
    assert list(groups.values()) == ["known"] * 4 + ["novel"] * 4


@pytest.mark.parametrize(
    "text",
    [
        "objects: [1]",
        "{",
        "objects: {a: 3}",
        "objects: {a: {set: known, color: [1, 2, 3], parts: []}}",
        "objects: {a: {set: odd, color: [1, 2, 3], parts: [BRICK]}}",
        "objects: {a: {set: known, color: [1, 2, 3], part: 1, parts: [BRICK]}}",
        "objects: {a: {set: known, color: [1, 2, 999], parts: [BRICK]}}",
        "objects: {a: {set: known, color: [1, 2], parts: [BRICK]}}",
        "objects: {a: {set: known, color: [1, 2, 3], parts: [{shape: ball, radius_m: 1}]}}",
        "objects: {a: {set: known, color: [1, 2, 3], parts: [{shape: cylinder, radius_m: 1}]}}",
    ],
)
def test_wrong_object_files_are_refused(tmp_path, text: str) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(text.replace("BRICK", "{shape: box, dimensions_m: [1, 0.5, 1]}"))
    with pytest.raises(SceneError, match="mine.yaml"):
        load_objects(path)


def test_own_objects_can_be_drawn(tmp_path) -> None:
    path = tmp_path / "mine.yaml"
    part = "{shape: cylinder, radius_m: 0.05, height_m: 0.2}"
    path.write_text(f"objects: {{tin: {{set: novel, color: [9, 9, 9], parts: [{part}]}}}}")
    scene = draw_scene(np.random.default_rng(0), obstacles=2, objects=load_objects(path))
    assert set(scene.names.values()) == {"floor", "table", "tin"}


def test_scenes_keep_their_promises() -> None:
    rng = np.random.default_rng(5)
    counts = []
    for _ in range(40):
        scene = draw_scene(rng)
        counts.append(len(scene.obstacle_ids))
        center = scene.target[0].T_base_solid[:3, 3]
        assert np.abs(center[:2] - (0.85, 0)).max() <= 0.0201
        assert np.array_equal(
            np.round(scene.target[0].T_base_solid[:3, :3]), scene.target[0].T_base_solid[:3, :3]
        )
        assert min(from_lowest(s) for s in scene.target) == pytest.approx(0.80, abs=1e-9)
        objects = [scene.target] + [scene.solids_of((n,)) for n in scene.obstacle_ids]
        for i, one in enumerate(objects):
            for other in objects[:i]:
                assert min(gap(a, b) for a in one for b in other) > 0.002
        for number, solids in zip(scene.obstacle_ids, objects[1:], strict=True):
            place = solids[0].T_base_solid[:2, 3]
            assert np.abs(place - center[:2]).max() <= 0.2501
            low = min(from_lowest(s) for s in solids) - 0.80
            assert 0.1999 <= low <= 0.3001 if "lamp" in scene.names[number] else abs(low) < 1e-9
        assert np.count_nonzero(scene.view().object_ids == scene.target_id) >= 300
        position = scene.T_base_camera[:3, 3]
        assert (position >= (0, -0.15, 1.2)).all() and (position <= (0.2, 0.15, 1.45)).all()
    assert set(counts) == {0, 1, 2, 3, 4}


def from_lowest(solid: Box | Cylinder) -> float:
    return float(solid.T_base_solid[2, 3] - solid.half_size[2])


def test_same_seed_same_bytes_and_specs_rebuild() -> None:
    one, two = (np.random.default_rng(6) for _ in range(2))
    for _ in range(4):
        a, b = draw_scene(one), draw_scene(two)
        (ca, la), (cb, lb) = to_capture(a, one), to_capture(b, two)
        assert json.dumps(a.spec) == json.dumps(b.spec)
        assert ca.depth.tobytes() == cb.depth.tobytes()
        assert ca.rgb.tobytes() == cb.rgb.tobytes()
        assert la.tobytes() == lb.tobytes()
        assert ca.target_pixel == cb.target_pixel
        again = build_scene(json.loads(json.dumps(a.spec)))
        assert again.view().depth.tobytes() == a.view().depth.tobytes()
        for item in (a.spec["target"], *a.spec["obstacles"]):
            assert all(item[key] == round(item[key], 4) for key in ("x", "y", "z", "yaw"))


def test_target_pixel_is_on_the_visible_target() -> None:
    rng = np.random.default_rng(7)
    for _ in range(15):
        scene = draw_scene(rng, obstacles=4)
        capture, object_ids = to_capture(scene, rng)
        u, v = capture.target_pixel
        assert object_ids[v, u] == scene.target_id
        assert capture.depth[v, u] > 0
        rows, columns = np.nonzero(object_ids == scene.target_id)
        assert columns.min() <= u <= columns.max()


def test_yaw_modes() -> None:
    rng = np.random.default_rng(8)
    yaws = [draw_scene(rng, "cereal_x", 1, yaw="random").spec["target"]["yaw"] for _ in range(5)]
    assert len(set(yaws)) == 5
    none = draw_scene(rng, "cereal_x", 2, yaw="none")
    assert {item["yaw"] for item in (none.spec["target"], *none.spec["obstacles"])} == {0.0}


def test_colors_tell_neighbors_apart() -> None:
    scene = draw_scene(np.random.default_rng(9), obstacles=4)
    paints = [tuple(item["color"]) for item in (scene.spec["target"], *scene.spec["obstacles"])]
    assert len(set(paints)) == 5
    assert set(paints) <= set(PALETTE)


# Truth


def test_distance_equals_sampled_surfaces() -> None:
    rng = np.random.default_rng(10)
    meets, apart = 0, 0
    for k in range(120):
        dims = rng.uniform(0.05, 0.25, 3)
        box = Box(random_pose(rng, 0.02), dims)
        other = random_solids(rng, 1)[0]
        if k % 3 == 0:  # parallel faces and axes: the degenerate cases
            T = make_transform(
                rotation_z(rng.choice([0.0, np.pi / 2, 0.3])), rng.uniform(-0.3, 0.3, 3)
            )
            box = Box(make_transform(np.eye(3), rng.uniform(-0.01, 0.01, 3)), dims)
            other = Box(T, (0.1, 0.2, 0.05)) if rng.random() < 0.5 else Cylinder(T, 0.06, 0.2)
        found = box_clearance(box.T_base_solid[None], dims, [other])[0]
        step = 0.003
        surface = min(
            from_solid(other, sampled(box, step)).min(), from_solid(box, sampled(other, step)).min()
        )
        if found == 0:
            meets += 1
            assert surface <= step
        else:
            apart += 1
            assert found <= surface + 1e-7
            assert surface - found <= step**2 / found + 1e-4 or surface - found < step / 2
    assert meets > 8
    assert apart > 40


def test_distance_equals_a_convex_solver() -> None:
    rng = np.random.default_rng(11)
    checked = 0
    for _ in range(40):
        box = Box(random_pose(rng, 0.05), rng.uniform(0.05, 0.25, 3))
        other = random_solids(rng, 1)[0]
        found = box_clearance(box.T_base_solid[None], box.dimensions_m, [other])[0]
        if found < 0.002:
            continue
        half = box.dimensions_m / 2

        def away(x: np.ndarray, box=box, other=other) -> float:
            point = box.T_base_solid[:3, :3] @ x + box.T_base_solid[:3, 3]
            return float(from_solid(other, point[None])[0] ** 2)

        bounds = [(-h, h) for h in half]
        best = min(
            minimize(
                away,
                rng.uniform(-half, half),
                bounds=bounds,
                tol=1e-16,
                options={"maxiter": 500},
            ).fun
            for _ in range(3)
        )
        assert np.sqrt(best) == pytest.approx(found, abs=1e-4)
        assert found <= np.sqrt(best) + 1e-7
        checked += 1
    assert checked > 15


def test_distance_by_hand() -> None:
    dims = np.array([0.2, 0.1, 0.1])
    T = np.eye(4)[None]

    def at(x: float, y: float, z: float) -> np.ndarray:
        return make_transform(np.eye(3), (x, y, z))

    def d(solid: Box | Cylinder | Plane) -> float:
        return float(box_clearance(T, dims, [solid])[0])

    assert d(Box(at(0.2, 0, 0), (0.1, 0.3, 0.3))) == pytest.approx(0.05)
    assert d(Cylinder(at(0, 0.15, 0), 0.04, 0.5)) == pytest.approx(0.06)
    assert d(Cylinder(at(0.13, 0.09, 0), 0.01, 0.02)) == pytest.approx(0.04, abs=1e-7)
    assert d(Cylinder(at(0, 0, 0.15), 1.0, 0.1)) == pytest.approx(0.05)  # a lid wider than the box
    assert d(Cylinder(at(0, 0, 0.15), 0.01, 0.1)) == pytest.approx(0.05)
    assert d(Cylinder(at(0, 0, 0), 0.01, 1.0)) == 0  # a rod through two faces, no edge touched
    assert d(Cylinder(at(0, 0, 0), 0.01, 0.02)) == 0  # wholly inside the box
    assert d(Cylinder(at(0, 0, 0), 3.0, 3.0)) == 0  # the box wholly inside
    assert d(Box(at(0, 0, 0), (0.01, 1.0, 0.01))) == 0
    assert d(Plane(-0.12)) == pytest.approx(0.07)
    assert d(Plane(0.02)) == 0
    assert np.isinf(box_clearance(T, dims, [])[0])
    two = [Plane(-0.12), Box(at(0.2, 0, 0), (0.1, 0.3, 0.3))]
    assert box_clearance(T, dims, two)[0] == pytest.approx(0.05)


def test_gap_is_symmetric_and_knows_cylinders() -> None:
    a = Cylinder(make_transform(np.eye(3), (0, 0, 0.1)), 0.04, 0.2)
    b = Cylinder(make_transform(np.eye(3), (0.1, 0, 0.5)), 0.05, 0.3)
    assert gap(a, b) == gap(b, a) == pytest.approx(np.hypot(0.01, 0.15))
    c = Box(make_transform(np.eye(3), (0.2, 0, 0.1)), (0.1, 0.1, 0.1))
    assert gap(a, c) == gap(c, a) == pytest.approx(0.11)


def test_true_candidates_follow_the_conventions() -> None:
    scene = draw_scene(np.random.default_rng(12), "cereal_y", 0)
    candidates = true_candidates(scene)
    T_box, size = true_box(scene)
    np.testing.assert_allclose(size, (0.04, 0.20, 0.15), atol=1e-12)
    center = T_box[:3, 3]
    assert candidates.label.tolist() == list(range(1, 16))
    for k, (face, line, T) in enumerate(
        zip(candidates.face, candidates.line, candidates.T_base_gripper, strict=True)
    ):
        rel, (x, y, z) = T[:3, 3] - center, T[:3, :3].T
        strip = line - 2
        expected = {
            1: ((0, 0.20, strip * 0.05), (0, -1, 0), (1, 0, 0), 0.04),
            2: ((-0.12, 0, strip * 0.05), (1, 0, 0), (0, 1, 0), 0.20),
            3: ((0, -0.20, strip * 0.05), (0, 1, 0), (-1, 0, 0), 0.04),
            4: ((strip * 0.04 / 3, 0, 0.175), (0, 0, -1), (0, 1, 0), 0.20),
            5: ((0, strip * 0.20 / 3, 0.175), (0, 0, -1), (1, 0, 0), 0.04),
        }[int(face)]
        np.testing.assert_allclose(rel, expected[0], atol=1e-9)
        np.testing.assert_allclose(x, expected[1], atol=1e-9)
        np.testing.assert_allclose(y, expected[2], atol=1e-9)
        np.testing.assert_allclose(z, np.cross(x, y), atol=1e-9)
        assert candidates.width_m[k] == pytest.approx(expected[3])


def test_true_candidates_equal_the_packages_candidates() -> None:
    from boxgrasp.geometry.box import Box as TargetBox
    from boxgrasp.grasps.candidates import candidates_of

    rng = np.random.default_rng(13)
    for lines in (1, 3, 4):
        scene = draw_scene(rng, obstacles=0, yaw="random")
        mine = true_candidates(scene, lines=lines)
        theirs = candidates_of(TargetBox(*true_box(scene)), Gripper(), lines)
        np.testing.assert_array_equal(mine.label, theirs.label)
        np.testing.assert_allclose(mine.T_base_gripper, theirs.T_base_gripper, atol=1e-9)
        np.testing.assert_allclose(mine.width_m, theirs.width_m, atol=1e-9)


def test_true_box_turns_with_the_target() -> None:
    rng = np.random.default_rng(14)
    for _ in range(6):
        scene = draw_scene(rng, "cereal_x", 0, yaw="random")
        T, size = true_box(scene)
        yaw = np.arctan2(T[1, 0], T[0, 0])
        assert -np.pi / 4 < yaw <= np.pi / 4 + 1e-9
        assert sorted(np.round(size, 6)) == [0.04, 0.15, 0.20]
        aligned, wide = true_box(scene, mode="aligned")
        np.testing.assert_array_equal(aligned[:3, :3], np.eye(3))
        corners = sampled(scene.target[0], 0.02)
        np.testing.assert_allclose(wide, np.ptp(corners, axis=0), atol=1e-9)
        assert T[2, 3] - size[2] / 2 == pytest.approx(0.80)


def test_candidate_truth_numbers() -> None:
    spec = {
        "target": {
            "name": "green_cube",
            "x": 0.85,
            "y": 0.0,
            "z": 0.0,
            "yaw": 0.0,
            "color": [9, 9, 9],
        },
        "obstacles": [
            {"name": "crisps_tube", "x": 0.85, "y": 0.40, "z": 0.0, "yaw": 0.0, "color": [9, 9, 9]}
        ],
        "camera": {"position": [0.1, 0.0, 1.3], "gaze": [0.85, 0.0, 0.85]},
    }
    scene = build_scene(spec)
    candidates = true_candidates(scene)
    truth = candidate_truth(scene, candidates.T_base_gripper)
    left = 2  # left face, top line: the gripper reaches from y = 0.02 to 0.24
    assert truth.clearance_m[left] == pytest.approx(0.40 - 0.04 - 0.24)
    assert truth.approach_clearance_m[left] == pytest.approx(0.0)
    assert truth.plane_clearance_m[left] == pytest.approx(0.05 - 0.035)
    assert truth.plane_clearance_m[0] == pytest.approx(0.01 - 0.035)
    assert truth.fits.all()
    np.testing.assert_allclose(truth.width_m, 0.06, atol=1e-9)
    np.testing.assert_allclose(truth.off_center_m, 0.0, atol=1e-9)
    assert not truth.valid[left]
    assert not truth.valid[0]
    assert truth.valid[[5, 8]].all()
    assert truth.best_m == pytest.approx(truth.clearance_m[truth.valid].max())
    small = candidate_truth(
        scene, candidates.T_base_gripper, gripper=replace(Gripper(), max_opening_m=0.05)
    )
    assert not small.fits.any()
    turned = candidates.T_base_gripper[:1] @ make_transform(
        Rotation.from_euler("x", 0.3).as_matrix(), (0, 0.01, 0)
    )
    odd = candidate_truth(scene, turned)
    assert odd.width_m[0] == pytest.approx(0.06 * (np.cos(0.3) + np.sin(0.3)))
    # The cube's middle is 2 cm over line 1 of three.
    assert odd.off_center_m[0] == pytest.approx(0.02 * np.sin(0.3) - 0.01 * np.cos(0.3))


def test_truth_of_clutter_equals_sampled_surfaces() -> None:
    rng = np.random.default_rng(15)
    for _ in range(4):
        scene = draw_scene(rng, obstacles=(3, 4))
        candidates = true_candidates(scene)
        truth = candidate_truth(scene, candidates.T_base_gripper)
        points = np.concatenate([sampled(solid, 0.002) for solid in scene.obstacles])
        for k, T in enumerate(candidates.T_base_gripper):
            seen = from_solid(Box(T, (0.22, 0.17, 0.07)), points).min()
            if truth.clearance_m[k] >= 0.5:
                continue
            assert truth.clearance_m[k] <= seen + 1e-7
            assert seen - truth.clearance_m[k] < 0.0016
        assert (truth.approach_clearance_m <= truth.clearance_m + 1e-9).all()


# The demo


def test_demo_is_cluttered_solvable_and_steady() -> None:
    scene, capture = demo_scene(), demo_capture(3)
    truth = candidate_truth(scene, true_candidates(scene).T_base_gripper)
    assert 1 <= truth.valid.sum() <= 5
    assert truth.best_m > 0.05
    assert len(scene.obstacle_ids) >= 5
    assert capture.target_pixel is not None
    again = demo_capture(3)
    assert capture.depth is not None and again.depth is not None
    assert capture.depth.tobytes() == again.depth.tobytes()
    assert capture.depth.tobytes() != demo_capture(4).depth.tobytes()  # type: ignore[union-attr]
