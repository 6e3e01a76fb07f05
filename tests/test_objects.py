"""Object sets: the thesis's sizes, seeds that keep their scenes, and things that cannot stand."""

from __future__ import annotations

import hashlib
import json

import numpy as np
import pytest

from boxgrasp.errors import SceneError
from boxgrasp.simulate import build_scene, draw_scene, load_objects

# Of the scenes drawn before the objects moved to a folder of sets.
SPECS = "cb040dded740a34711f45dae6acf9585b71af375caaa8f245f8ea5e95de47067"


def test_seeds_keep_their_scenes() -> None:
    digest = hashlib.sha256()
    for seed in range(6):
        rng = np.random.default_rng(seed)
        scene = draw_scene(rng, obstacles=(2, 4), yaw=("thesis", "random")[seed % 2])
        digest.update(json.dumps(scene.spec).encode())
    assert digest.hexdigest() == SPECS


def test_default_is_the_simulated_set() -> None:
    assert load_objects() == load_objects("simulated") != load_objects("real")


def test_real_objects_have_the_thesis_dimensions() -> None:
    sizes = {}
    for name, item in load_objects("real").items():
        if item.set == "real":
            (solid,) = item.place(0, 0, 0)
            sizes[name] = (type(solid).__name__, *np.round(2 * solid.half_size, 6).tolist())
            assert solid.T_base_solid[2, 3] == pytest.approx(solid.half_size[2])
    assert sizes == {
        "crisps_tube": ("Cylinder", 0.075, 0.075, 0.23),
        "biscuits_pack": ("Cylinder", 0.05, 0.05, 0.18),
        "cereal_y": ("Box", 0.045, 0.22, 0.19),
        "cereal_x": ("Box", 0.22, 0.045, 0.19),
        "chickpeas_can": ("Cylinder", 0.05, 0.05, 0.11),
    }
    others = {n: item for n, item in load_objects("real").items() if item.set != "real"}
    assert {n: item.set for n, item in others.items()} == {
        "mug": "obstacle",
        "wooden_bar": "obstacle",
    }
    assert others["mug"] == load_objects()["mug"]
    assert others["mug"].floats_m is None and others["wooden_bar"].floats_m == (0.22, 0.32)


def test_scenes_of_the_real_set() -> None:
    objects = load_objects("real")
    rng = np.random.default_rng(1)
    seen = set()
    for _ in range(12):
        scene = draw_scene(rng, obstacles=4, objects=objects)
        assert objects[scene.names[scene.target_id]].set == "real"
        seen |= set(scene.names.values())
        floating = {n for n, name in scene.names.items() if name == "wooden_bar"}
        assert set(scene.floating_ids) == floating
        for number in scene.obstacle_ids:
            low = min(p.T_base_solid[2, 3] - p.half_size[2] for p in scene.solids_of((number,)))
            if number in floating:
                assert 0.2199 <= low - 0.80 <= 0.3201
            else:
                assert low == pytest.approx(0.80, abs=1e-9)
    assert "wooden_bar" in seen


def test_a_user_file_by_path(tmp_path) -> None:
    text = "objects: {tin: {set: novel, color: [9, 9, 9], parts: [PART]}}"
    part = "{shape: cylinder, radius_m: 0.05, height_m: %s}"
    path = tmp_path / "mine.yml"
    path.write_text(text.replace("PART", part % 0.2))
    assert load_objects(path) == load_objects(str(path))
    assert load_objects(path)["tin"].parts[0].size_m == (0.05, 0.2)
    path.write_text(text.replace("PART", part % 0.3))
    assert load_objects(path)["tin"].parts[0].size_m == (0.05, 0.3)  # an edited file is read anew


@pytest.mark.parametrize("source", ["reel", "no/such.yaml", "."])
def test_wrong_source_names_the_valid_ones(source: str) -> None:
    with pytest.raises(SceneError, match="simulated, real, or the path of a YAML file") as caught:
        load_objects(source)
    assert repr(source) in str(caught.value) and "\n" not in str(caught.value)


FOOT = "{shape: box, dimensions_m: [0.04, 0.04, 0.10]}"
DISC = "{shape: cylinder, radius_m: 0.02, height_m: 0.10}"
LOW = "{shape: box, dimensions_m: [0.04, 0.04, 0.10], center_m: [0, 0, 0.049]}"
HIGH = "{shape: box, dimensions_m: [0.04, 0.04, 0.10], center_m: [0, 0, 0.052]}"


def arm(x: float, y: float = 0.0) -> str:
    """A block as heavy as the foot, on top of it."""
    return f"{{shape: box, dimensions_m: [0.04, 0.04, 0.10], center_m: [{x}, {y}, 0.15]}}"


def load(tmp_path, *parts: str, floats: str = "") -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(
        f"objects: {{a: {{set: novel, color: [1, 2, 3], {floats}parts: {list(parts)}}}}}".replace(
            "'", ""
        )
    )
    load_objects(path)


@pytest.mark.parametrize(
    ("parts", "why"),
    [
        # The center of two equal blocks lies half-way: past the foot's edge at 20 mm from 40 mm on.
        ((FOOT, arm(0.042)), "topple.* 1.0 mm outside"),
        ((FOOT, arm(0.0, -0.05)), "topple.* 5.0 mm outside"),
        ((HIGH,), "hang 2.0 mm over"),
        ((LOW,), "1.0 mm below"),
        ((FOOT, LOW), "1.0 mm below"),
        # On a round foot, 4 / pi lighter, the edge at 20 mm is passed from 35.7 mm on, any way.
        ((DISC, arm(0.0255, 0.0255)), "topple"),
        ((DISC, arm(0.036)), "topple"),
    ],
)
def test_what_cannot_stand_is_refused(tmp_path, parts: tuple[str, ...], why: str) -> None:
    with pytest.raises(SceneError, match=f"object a of .*mine.yaml is wrong: it .*{why}"):
        load(tmp_path, *parts)


def test_what_can_stand_is_read(tmp_path) -> None:
    load(tmp_path, FOOT, arm(0.038))
    load(tmp_path, FOOT, arm(0.038, 0.038))  # over the corner of a square foot
    load(tmp_path, DISC, arm(0.0245, 0.0245))
    load(tmp_path, HIGH, floats="floats_m: [0.2, 0.3], ")
    # Two feet: the middle lies over neither, yet within their hull.
    left, right = (FOOT[:-1] + f", center_m: [0, {y}, 0.05]}}" for y in (-0.1, 0.1))
    load(tmp_path, left, right)


def test_floating_ids() -> None:
    item = {"x": 0.85, "y": 0.0, "z": 0.0, "yaw": 0.0, "color": [9, 9, 9]}
    spec = {
        "target": {**item, "name": "mug"},
        "obstacles": [
            {**item, "name": "lamp", "z": 0.25},
            {**item, "name": "green_cube", "y": 0.2, "z": 0.1},
        ],
        "camera": {"position": [0.1, 0.0, 1.3], "gaze": [0.85, 0.0, 0.85]},
    }
    assert build_scene(spec).floating_ids == (3,)
