"""The hall: one view in, one checked gripper pose out. Reads as chapter 2 of the thesis."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from boxgrasp.arrays import Floats, readonly
from boxgrasp.config import Config, config_hash, load_config
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import invert, make_transform, quaternion_xyzw, transform
from boxgrasp.grasps import checks
from boxgrasp.grasps.candidates import FACES, candidates_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.mapping.local_map import LocalMap
from boxgrasp.mapping.octomap_leaves import MapCells, map_from_octomap
from boxgrasp.mapping.ray_insertion import Scan, build_local_map
from boxgrasp.mapping.unseen_space import unexplained_cells
from boxgrasp.perception.box_fit import fit_box
from boxgrasp.perception.scene import Scene, SceneObject, find_scene, scan_pose, with_pixels
from boxgrasp.perception.target import Target, TargetPoints, find_target
from boxgrasp.perception.truncation import Visibility, look
from boxgrasp.ranking.ranker import RankerSetup, Ranking, RankingContext, ranker_named
from boxgrasp.result import BoxReport, Candidate, Selection
from boxgrasp.sensing.capture import Capture
from boxgrasp.version import __version__

_DENSE = 150_000


@dataclass(frozen=True, eq=False)
class SceneAnalysis:
    """What one view tells of a target: scene, target points, candidates with numbers and verdict."""

    scene: Scene
    target_points: TargetPoints
    context: RankingContext
    verdict: checks.Verdict
    warnings: tuple[str, ...]


class GraspSelector:
    """Selects grasps by one configuration; safe from several threads."""

    def __init__(self, config: Config | Mapping[str, Any] | str | None = None) -> None:
        self.config = load_config(config)
        self._hash = config_hash(self.config)
        setup = RankerSetup(self.config.models, self.config.gripper, self.config.candidates.lines)
        self._ranker = ranker_named(self.config.ranker, setup)

    def select(
        self,
        capture: Capture,
        target: Target | None = None,
        scans: Sequence[Capture] = (),
        octomap: MapCells | None = None,
    ) -> Selection:
        """The grasp that is best and passes the check, or a request for help."""
        clock = Clock()
        # 1 to 4. The box, what surrounds it, and every candidate with its numbers (2-1, 2-2, 2-4).
        cells_m = self._ranker.resolutions_m
        analysis = self.analyze(capture, target, scans, octomap, cells_m=cells_m, clock=clock)
        # 5. The first by preference that passes, or a question (2-3, 6-1).
        ranking = self._ranker.rank(analysis.context)
        clock.lap("choose")
        return self._answer(analysis, ranking, clock)

    def analyze(
        self,
        capture: Capture,
        target: Target | None = None,
        scans: Sequence[Capture] = (),
        octomap: MapCells | None = None,
        *,
        scene: Scene | None = None,
        cells_m: Sequence[float] = (),
        clock: Clock | None = None,
    ) -> SceneAnalysis:
        """All that is known before a choice is made.

        scene: spares finding it again; cells_m: cell sizes of further local maps.
        """
        config = self.config
        clock = clock or Clock()
        # 1. The support plane and what stands on it (appendix A).
        scene = scene or self.scene(capture, scans)
        clock.lap("scene")
        # 2. A box round the target (2-1).
        target_points = find_target(scene, capture, target)
        box = fit_box(
            scene.points[target_points.target_mask], scene.plane, _heading(scene), config.box
        )
        seen = look(capture, scene, target_points.target_mask, box)
        clock.lap("box")
        # 3. What is occupied, free and unseen round it (2-2).
        maps, unexplained = self._occupancy(capture, scene, scans, octomap, box, cells_m)
        local_map = maps[config.mapping.resolution_m]
        clock.lap("mapping")
        # 4. Every candidate with its numbers (2-4, 3-4).
        candidates = candidates_of(box, config.gripper, config.candidates.lines)
        numbers = checks.measure(
            candidates,
            config.gripper,
            box,
            scene,
            target_points.obstacle_mask,
            unexplained,
            local_map,
            seen.width_known,
            config.checks,
        )
        verdict = checks.judge(
            candidates,
            numbers,
            config.gripper,
            scene,
            scene.labels[target_points.obstacle_mask],
            config.candidates.faces,
            config.checks,
        )
        clock.lap("check")
        warnings = (*capture.notes, *_warnings(scene, seen))
        return SceneAnalysis(
            scene, target_points, RankingContext(box, candidates, numbers, maps), verdict, warnings
        )

    def _occupancy(
        self,
        capture: Capture,
        scene: Scene,
        scans: Sequence[Capture],
        octomap: MapCells | None,
        box: Box,
        cells_m: Sequence[float],
    ) -> tuple[dict[float, LocalMap], tuple[Floats, Floats]]:
        """Local maps by cell size, and the occupied cells of a map file that no point explains."""
        T_base_map = box.T_base_map(self.config.mapping.center_above_plane_clearance_m)
        sizes = dict.fromkeys((self.config.mapping.resolution_m, *cells_m))
        configs = {size: replace(self.config.mapping, resolution_m=size) for size in sizes}
        if octomap is None:
            T_source_map = invert(scene.T_base_source) @ T_base_map
            rays = _rays(capture, scene, scans, self.config.mapping.stride)
            maps = {
                size: replace(build_local_map(rays, T_source_map, config), T_base_map=T_base_map)
                for size, config in configs.items()
            }
            return maps, (np.empty((0, 3)), np.empty(0))
        cells = octomap.occupied(self.config.mapping.occupied_above)
        maps = {
            size: map_from_octomap(octomap, T_base_map, config) for size, config in configs.items()
        }
        return maps, unexplained_cells(*cells, scene, box)

    def objects(self, capture: Capture) -> tuple[SceneObject, ...]:
        """The objects on the support plane, numbered from the nearest."""
        return with_pixels(self.scene(capture))

    def scene(self, capture: Capture, scans: Sequence[Capture] = ()) -> Scene:
        """The support plane and what stands on it (appendix A)."""
        return find_scene(capture, scans, self.config.scene)

    def warm_up(self) -> None:
        """Compile or load every kernel, so that the first select is as quick as the next."""
        self.select(_two_blocks(), Target(pixel=(80, 60)))

    def _answer(
        self,
        analysis: SceneAnalysis,
        ranking: Ranking,
        clock: Clock,
    ) -> Selection:
        config, scene, verdict = self.config, analysis.scene, analysis.verdict
        box, candidates, numbers = (
            analysis.context.box, analysis.context.candidates, analysis.context.numbers,
        )  # fmt: skip
        order = ranking.order.tolist()
        rank = np.argsort(ranking.order)
        passing = verdict.passing
        allowed = [FACES.index(face) + 1 for face in config.candidates.faces]
        chosen = next(
            (
                k
                for k in order
                if passing[k] or (config.unchecked and candidates.face[k] in allowed)
            ),
            None,
        )
        rejected = [k for k in order if not passing[k]]
        best = min(rejected, key=lambda k: (verdict.short_m[k], rank[k]), default=None)
        reports = tuple(
            Candidate(
                label=int(candidates.label[k]),
                face=int(candidates.face[k]),
                line=int(candidates.line[k]),
                T_base_gripper=readonly(candidates.T_base_gripper[k].copy()),
                width_m=float(candidates.width_m[k]),
                visible_clearance_m=float(numbers.visible_clearance_m[k]),
                unseen_distance_m=float(numbers.unseen_distance_m[k]),
                plane_clearance_m=float(numbers.plane_clearance_m[k]),
                approach_clearance_m=float(numbers.approach_clearance_m[k]),
                fits=bool(numbers.fits[k] and numbers.known[k]),
                rejected=verdict.rejected[k],
                ranking=int(rank[k]) + 1,
            )
            for k in range(len(order))
        )
        grasp: dict[str, Any] = dict.fromkeys(
            ("face", "line", "label", "T_base_gripper", "T_base_tcp", "T_base_pregrasp",
             "position_m", "quaternion_xyzw", "opening_m", "clearance_m")
        )  # fmt: skip
        blocking = None
        if chosen is not None:
            grasp = _grasp(reports[chosen], config.gripper, config.checks.pregrasp_distance_m)
            reason = "first by preference that passes" if passing[chosen] else "unchecked"
        else:
            assert best is not None
            blocking = verdict.rejected[best]
            reason = f"no candidate passes; the nearest to it, {reports[best].label}: {blocking}"
        clock.lap("answer")
        return Selection(
            status="ask" if chosen is None else "grasp",
            reason=reason,
            frame=scene.frame,
            T_base_camera=scene.T_base_camera,
            ranker=config.ranker,
            **grasp,
            box=BoxReport(box.T_base_box, box.dimensions_m),
            best_rejected=None if best is None else reports[best].label,
            blocking=blocking,
            candidates=reports,
            warnings=(*analysis.warnings, *self._ranker.notes),
            config_hash=self._hash,
            timings_ms=clock.timings_ms(),
            version=__version__,
        )


def _two_blocks() -> Capture:
    """A small view of two blocks that touch, in two colors: it visits every kernel."""
    v, u = np.mgrid[:120, :160]
    rays = np.stack(((u - 80) / 130, (v - 60) / 130, np.ones(u.shape)), axis=-1)
    down = np.array([0.0, 0.6, 0.8])  # the camera looks down by 53 degrees, 0.7 m over the table
    middle = (np.abs(u - 84) < 20) & (np.abs(v - 60) < 14)
    height = np.where(middle, np.where(u < 88, 0.10, 0.14), 0.0)
    depth = (0.7 - height) / (rays @ down)
    intrinsics = [[130, 0, 80], [0, 130, 60], [0, 0, 1]]
    red = np.where(middle, np.where(u < 88, 200, 60), 120)
    rgb = np.stack((red, np.full_like(red, 90), 255 - red), axis=-1).astype(np.uint8)
    return Capture(depth, np.array(intrinsics, dtype=np.float64), rgb=rgb)


class Clock:
    """Wall time stage by stage; the stages add up to the total."""

    def __init__(self) -> None:
        self._start = self._last = time.perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        now = time.perf_counter()
        self._laps[stage] = (now - self._last) * 1e3
        self._last = now

    def timings_ms(self) -> dict[str, float]:
        return {**self._laps, "total": (time.perf_counter() - self._start) * 1e3}


def _heading(scene: Scene) -> float:
    """Where the camera looks, as a turn about the base's z; 0 where it is unknown."""
    if scene.T_base_camera is None:
        return 0.0
    x = scene.T_base_table[:3, 0]
    return float(np.arctan2(x[1], x[0]))


def _rays(
    capture: Capture, scene: Scene, scans: Sequence[Capture], stride: int | None
) -> list[Scan]:
    """Points and eye of every view, in the first view's own frame: the whole cloud, table included.

    stride: as `MappingConfig.stride`.
    """
    T_source_base = invert(scene.T_base_source)
    rays: list[Scan] = []
    for view in (capture, *scans):
        shape = view.shape
        dense = stride is None and shape is not None and shape[0] * shape[1] > _DENSE
        points = view.valid_points(step=2 if dense else 1)[0][::stride]
        if view is capture:
            eye = None if scene.eye_m is None else transform(T_source_base, scene.eye_m[None])[0]
            rays.append((points, eye))
            continue
        eye = None if view.T_base_camera is None else view.T_base_camera[None, :3, 3]
        rays.append(
            (
                transform(T_source_base @ scan_pose(view), points),
                None if eye is None else transform(T_source_base, eye)[0],
            )
        )
    return rays


def _warnings(scene: Scene, seen: Visibility) -> list[str]:
    found = []
    if scene.frame == "support":
        found.append("no T_base_camera given: the base frame is the support plane's")
    if scene.T_base_camera is None:
        found.append("camera position unknown: no space is known to be free")
    if seen.cut:
        found.append("target is cut by the image border")
    for axis, known in zip("xy", seen.width_known, strict=True):
        if not known:
            found.append(f"target's width along its {axis} is a lower bound: an edge is hidden")
    return found


def _grasp(candidate: Candidate, gripper: Gripper, back_m: float) -> dict[str, Any]:
    T = candidate.T_base_gripper
    back = make_transform(np.eye(3), (-back_m, 0.0, 0.0))
    return {
        "face": candidate.face,
        "line": candidate.line,
        "label": candidate.label,
        "T_base_gripper": T,
        "T_base_tcp": readonly(T @ np.array(gripper.T_gripper_tcp)),
        "T_base_pregrasp": readonly(T @ back),
        "position_m": readonly(T[:3, 3].copy()),
        "quaternion_xyzw": readonly(quaternion_xyzw(T[:3, :3])),
        "opening_m": gripper.max_opening_m,
        "clearance_m": candidate.visible_clearance_m,
    }
