"""Scenarios of the thesis (section 3-3-1): a seed, a target, obstacles, a camera, and what is true.

Scenario `number` of a seed is the same whatever else is drawn: its scene, its noise and its
operator each have a generator of their own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from boxgrasp.arrays import Array
from boxgrasp.errors import SceneError
from boxgrasp.grasps.candidates import LINES
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.grasps.scoring import RED_BELOW_M
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.sensor_model import XTION
from boxgrasp.simulate.noise import NoiseModel
from boxgrasp.simulate.objects import SimulatedObject, load_objects
from boxgrasp.simulate.physics import settles
from boxgrasp.simulate.scenes import (
    Clutter,
    TableScene,
    build_scene,
    drawn_scenes,
    shows_target,
    to_capture,
)
from boxgrasp.simulate.truth import CandidateTruth, TrueCandidates, candidate_truth, true_candidates

SCENE, NOISE, OPERATOR = 0, 1, 2  # a generator each
NOISES: Mapping[str, NoiseModel | None] = {
    "none": None,
    "xtion": NoiseModel(),
    # Twice the Xtion's spread and steps, wider holes along edges: a poor sensor.
    "strong": NoiseModel(
        sigma_m=2 * XTION.noise_floor_m,
        sigma_growth_per_m=2 * XTION.noise_growth_per_m,
        step_m=0.003,
        edge_dropout=0.9,
        dropout=0.02,
        color_sigma=8.0,
    ),
}
WISHES = ("any", "feasible", "off-center", "no-central")


@dataclass(frozen=True)
class Recipe:
    """What a set's scenarios have in common.

    Attributes:
        targets: names of the targets, taken in turn.
        objects: a shipped set's name or a file.
        obstacles: least and most number.
        yaw: as `Clutter.yaw`.
        area_m: as `Clutter.area_m`, m.
        noise: name of the sensor's noise, one of `NOISES`; the thesis's Gazebo had none.
        mirrored: left and right exchanged.
        wish: `any` scene; `feasible`, the thesis's assumption of at least one feasible grasp
            (1-6); `off-center`, its out-of-bias need (4-2): one face alone has feasible
            candidates, and the best of them is not on its central line; `no-central`, stricter:
            candidates are valid, but none on a central line.
        physics: only scenes in which all that stands stays where it is in MuJoCo (extra `sim`).

    Raises:
        SceneError: no targets, or a noise, wish, yaw or number of obstacles that cannot be.
    """

    targets: tuple[str, ...]
    objects: str = "simulated"
    obstacles: tuple[int, int] = (1, 4)
    yaw: str = "thesis"
    area_m: float = 0.50
    noise: str = "none"
    mirrored: bool = False
    wish: str = "feasible"
    physics: bool = False

    def __post_init__(self) -> None:
        if not self.targets:
            raise SceneError("no targets; valid: at least one object's name")
        if self.noise not in NOISES:
            raise SceneError(f"noise is {self.noise!r}; valid: {', '.join(NOISES)}")
        if self.wish not in WISHES:
            raise SceneError(f"wish is {self.wish!r}; valid: {', '.join(WISHES)}")
        _ = self.clutter

    @property
    def clutter(self) -> Clutter:
        """How obstacles stand round the target."""
        return Clutter(self.obstacles, self.yaw, self.area_m)


@dataclass(frozen=True, eq=False)
class Scenario:
    """A scene with the exact numbers of its true, aligned box's candidates.

    Attributes:
        seed: of its set.
        number: in its set.
        scene: objects and camera.
        candidates: of the true box.
        truth: what is true of each of them.
    """

    seed: int
    number: int
    scene: TableScene
    candidates: TrueCandidates
    truth: CandidateTruth

    @property
    def target(self) -> str:
        """The target's name."""
        return self.scene.names[self.scene.target_id]

    @property
    def feasible(self) -> bool:
        """Whether a candidate that fits, stays off the table and gets there is clear by 2 cm."""
        return self.truth.best_m >= RED_BELOW_M

    def grants(self, wish: str) -> bool:
        """Whether the scene is as a recipe wishes.

        Args:
            wish: as `Recipe.wish`.

        Returns:
            Whether it is.
        """
        if wish == "any":
            return True
        lines = len(self.candidates.label) // 5
        clear = (self.truth.clearance_m >= RED_BELOW_M).reshape(5, lines)
        central = np.arange(lines) == (lines - 1) // 2
        if wish == "no-central":
            valid = clear & self.truth.valid.reshape(5, lines)
            return bool(valid.any() and not valid[:, central].any())
        if not self.feasible or wish == "feasible":
            return self.feasible
        clearance_m = np.where(
            clear & self.truth.fits.reshape(5, lines),
            self.truth.clearance_m.reshape(5, lines),
            -1.0,
        )
        faces = np.flatnonzero((clearance_m >= 0).any(axis=1))
        return len(faces) == 1 and not central[np.argmax(clearance_m[faces[0]])]

    def rng(self, stream: int, *more: int) -> np.random.Generator:
        """A generator of the scenario's own.

        Args:
            stream: `SCENE`, `NOISE` or `OPERATOR`.
            more: further numbers that it depends on.

        Returns:
            The same whatever else was drawn.
        """
        return np.random.default_rng((self.seed, self.number, stream, *more))

    def capture(self, noise: str = "xtion", run: int = 0) -> tuple[Capture, Array]:
        """The view as a capture, and what is true of it.

        Args:
            noise: one of `NOISES`.
            run: which drawing of the noise.

        Returns:
            The capture, and (H, W) int32 the true object of each pixel.
        """
        model = NOISES[noise]
        return to_capture(self.scene, self.rng(NOISE, run), model if model is not None else False)


def draw_scenario(
    recipe: Recipe, seed: int, number: int, *, lines: int = LINES, gripper: Gripper | None = None
) -> Scenario:
    """A scenario of a seed, drawn again until it is as the recipe wishes.

    Args:
        recipe: what the set's scenarios have in common.
        seed: of the set.
        number: in the set.
        lines: l, lines a face.
        gripper: the hand; None for the default one.

    Returns:
        The scenario.

    Raises:
        SceneError: a target that the objects do not have, or no such scene in 200 draws.
        MissingExtraError: `physics` without MuJoCo.
    """
    objects = load_objects(recipe.objects)

    def found(scene: TableScene) -> Scenario:
        return scenario_of(scene, seed, number, lines=lines, gripper=gripper)

    def accepted(scene: TableScene) -> bool:
        if not found(scene).grants(recipe.wish):
            return False
        return (not recipe.physics or settles(scene).stable) and shows_target(scene)

    drawn = drawn_scenes(
        np.random.default_rng((seed, number, SCENE)),
        recipe.targets[number % len(recipe.targets)],
        recipe.clutter,
        objects,
    )
    scene = next(scene for scene in drawn if accepted(scene))
    return found(build_scene(mirrored(scene.spec), objects) if recipe.mirrored else scene)


def scenario_of(
    scene: TableScene,
    seed: int,
    number: int,
    *,
    lines: int = LINES,
    gripper: Gripper | None = None,
) -> Scenario:
    """A scene with its truth.

    Args:
        scene: objects and camera.
        seed: of the set.
        number: in the set.
        lines: l, lines a face.
        gripper: the hand; None for the default one.

    Returns:
        The scenario.
    """
    candidates = true_candidates(scene, lines=lines, gripper=gripper, mode="aligned")
    truth = candidate_truth(scene, candidates.T_base_gripper, gripper=gripper)
    return Scenario(seed, number, scene, candidates, truth)


def mirrored(spec: Mapping[str, Any]) -> dict[str, Any]:
    """The spec of a scene with left and right exchanged: y and yaw change sign, camera too.

    Args:
        spec: as `build_scene` takes it.

    Returns:
        Another one.
    """

    def flip(item: Mapping[str, Any]) -> dict[str, Any]:
        return {**item, "y": 0.0 - item["y"], "yaw": 0.0 - item["yaw"]}

    camera = {name: [place[0], 0.0 - place[1], place[2]] for name, place in spec["camera"].items()}
    return {
        "target": flip(spec["target"]),
        "obstacles": [flip(item) for item in spec["obstacles"]],
        "camera": camera,
    }


def targets_of(group: str, objects: str | None = None) -> tuple[str, ...]:
    """Names of a set's targets.

    Args:
        group: `known`, `novel`, `real`, or `all` of them.
        objects: a shipped set's name or a file; None for the simulated one.

    Returns:
        Names in the set's order.

    Raises:
        SceneError: the set has none of that group.
    """
    known: Mapping[str, SimulatedObject] = load_objects(objects)
    groups: Sequence[str] = ("known", "novel", "real") if group == "all" else (group,)
    found = tuple(name for name, item in known.items() if item.set in groups)
    if not found:
        raise SceneError(f"no target of group {group!r} in {objects or 'simulated'}")
    return found
