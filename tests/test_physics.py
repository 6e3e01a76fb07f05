"""MuJoCo's view of drawn scenes, and whether they stay; what falls is known by hand."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from boxgrasp.errors import MissingExtraError, SceneError
from boxgrasp.geometry.transforms import make_transform
from boxgrasp.simulate import Box, Plane, TableScene, build_scene, draw_scene, load_objects
from boxgrasp.simulate.physics import Settling, mujoco_depth, settles

CAMERA = {"position": [0.1, 0.0, 1.3], "gaze": [0.85, 0.0, 0.85]}


def item(name: str, x: float, y: float, z: float = 0.0) -> dict[str, Any]:
    return {"name": name, "x": x, "y": y, "z": z, "yaw": 0.3, "color": [9, 9, 9]}


def scene_of(*items: dict[str, Any]) -> TableScene:
    return build_scene({"target": items[0], "obstacles": items[1:], "camera": CAMERA})


def silhouettes(solids: np.ndarray) -> np.ndarray:
    """(H, W) bool, pixels with another solid among their eight neighbors."""
    wide = np.pad(solids, 1, mode="edge")
    height, width = solids.shape
    shifted = [wide[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    return np.any([other != solids for other in shifted], axis=0)


def test_missing_extra_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    scene = scene_of(item("mug", 0.85, 0.0))
    for ask in (settles, mujoco_depth):
        with pytest.raises(MissingExtraError, match=r"pip install 'boxgrasp\[sim\]'"):
            ask(scene)


@pytest.fixture
def mujoco() -> None:
    pytest.importorskip("mujoco", reason="needs mujoco (extra sim)")


@pytest.mark.usefixtures("mujoco")
class TestDepth:
    @pytest.mark.parametrize("name", ["simulated", "real"])
    def test_equals_the_caster(self, name: str) -> None:
        other = 0
        for seed in range(4):
            scene = draw_scene(np.random.default_rng(seed), obstacles=4, objects=load_objects(name))
            view, depth = scene.view(), mujoco_depth(scene)
            assert depth.dtype == np.float32 and depth.shape == (480, 640)
            off = np.abs(view.depth.astype(float) - depth)
            assert off[~silhouettes(view.solids)].max() < 1e-5
            other += np.count_nonzero(off > 1e-3)
        assert other <= 4 * depth.size * 1e-5

    def test_knows_a_moved_thing(self) -> None:
        one, two = (scene_of(item("mug", x, 0.0)) for x in (0.850, 0.852))
        off = np.abs(one.view().depth.astype(float) - mujoco_depth(two))
        assert np.count_nonzero(off > 1e-3) > 1000

    def test_by_hand(self) -> None:
        # Straight down: z is the height over each surface, whatever the range; 0 off the table.
        table = Box(make_transform(np.eye(3), (0, 0, 0.78)), (0.6, 0.4, 0.04), object_id=1)
        cube = Box(make_transform(np.eye(3), (0, 0, 0.85)), (0.1, 0.1, 0.1), object_id=2)
        scene = replace(
            scene_of(item("mug", 0.85, 0.0)),
            primitives=(table, cube),
            T_base_camera=make_transform(np.diag([1.0, -1.0, -1.0]), (0.0, 0.0, 1.8)),
        )
        depth = mujoco_depth(scene)
        np.testing.assert_array_equal(np.unique(depth), np.float32([0.0, 0.9, 1.0]))
        assert (depth == np.float32(0.9)).sum() == round(0.1 / 0.9 * 525) ** 2
        floor = replace(scene, primitives=(Plane(0.0, object_id=0), *scene.primitives))
        assert (mujoco_depth(floor)[depth == 0] == np.float32(1.8)).all()


@pytest.mark.usefixtures("mujoco")
class TestSettles:
    @pytest.mark.parametrize("name", ["simulated", "real"])
    def test_drawn_scenes_stay(self, name: str) -> None:
        rng = np.random.default_rng(7)
        for _ in range(8):
            found = settles(draw_scene(rng, obstacles=4, objects=load_objects(name)))
            assert found.stable
            # Far below the thresholds, so that these are not what makes scenes pass.
            assert found.moved_m < 0.0001 and found.turned_rad < 0.001

    @pytest.mark.parametrize("name", [n for n, i in load_objects().items() if i.floats_m is None])
    def test_over_the_edge(self, name: str) -> None:
        # The table ends at y = 0.60; the mug's handle moves its center by less than 2 mm.
        assert settles(scene_of(item("mug", 0.85, 0.0), item(name, 0.85, 0.595))).stable
        fallen = settles(scene_of(item("mug", 0.85, 0.0), item(name, 0.85, 0.605)))
        assert not fallen.stable and fallen.moved_m > 0.1

    def test_towers(self) -> None:
        # A cube of 6 cm on another: straight or 2.5 cm aside it stays, 3.5 cm aside it falls.
        def tower(aside: float) -> Settling:
            cube = "green_cube"
            items = [item(cube, 0.85, 0.0), item(cube, 0.85, aside, 0.06)]
            return settles(scene_of(*({**i, "yaw": 0.0} for i in items)))

        assert tower(0.0).stable and tower(0.025).stable
        assert not tower(0.035).stable and tower(0.035).turned_rad > 0.5

    def test_hanging_falls_by_its_height(self) -> None:
        found = settles(scene_of(item("beans_can", 0.85, 0.0, 0.05)))
        assert not found.stable
        assert found.moved_m == pytest.approx(0.05, abs=0.002)  # 1 mm a step when it lands
        # Free fall before it lands: g t^2 / 2.
        short = settles(scene_of(item("beans_can", 0.85, 0.0, 0.05)), seconds=0.05)
        assert short.moved_m == pytest.approx(9.81 * 0.05**2 / 2, rel=0.03)

    def test_what_floats_is_fixed(self) -> None:
        lamp = item("lamp", 0.85, 0.15, 0.25)
        alone = settles(scene_of(item("lamp", 0.85, 0.0, 0.25)))
        assert alone == Settling(0.0, 0.0)
        assert settles(scene_of(item("mug", 0.85, 0.0), lamp)).stable

    @pytest.mark.parametrize("seconds", [0.0, -1.0, float("nan"), float("inf")])
    def test_wrong_time(self, seconds: float) -> None:
        with pytest.raises(SceneError, match="above 0 s"):
            settles(scene_of(item("mug", 0.85, 0.0)), seconds)


def test_thresholds() -> None:
    assert Settling(0.0005, 0.005).stable
    assert not Settling(0.002, 0.0).stable
    assert not Settling(0.0, 0.02).stable
