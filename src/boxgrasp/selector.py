"""The pipeline: one view in, one checked gripper pose out. Reads as chapter 2 of the thesis."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import readonly
from boxgrasp.config import Config, load_config, loaded_hash
from boxgrasp.errors import (
    BoxgraspError,
    CaptureError,
    CodedWarning,
    ConfigError,
    MapError,
    SceneError,
    TargetError,
    require,
    shown,
)
from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import invert
from boxgrasp.grasps.candidates import FACES, Candidates, candidates_of
from boxgrasp.grasps.checks import Check, CheckContext, CheckResult, plugin_checks, shipped_checks
from boxgrasp.grasps.checks.check import validate_check, validate_result
from boxgrasp.grasps.refinement import moved_to_surface
from boxgrasp.kernels import rvl
from boxgrasp.mapping.local_map import LocalMap, MappingConfig
from boxgrasp.mapping.octomap_leaves import MapCells, map_from_octomap
from boxgrasp.mapping.ray_insertion import build_local_map
from boxgrasp.mapping.unseen_space import NO_MAP_OBSTACLES, MapObstacles, unexplained_cells
from boxgrasp.mapping.view_rays import view_rays
from boxgrasp.perception.box_fit import fit_box
from boxgrasp.perception.box_sides import PlacedBox, place_sides, unplaced
from boxgrasp.perception.find_scene import find_scene
from boxgrasp.perception.numbering import SceneObject
from boxgrasp.perception.scene import REACH_PX, Scene, TargetWindow
from boxgrasp.perception.standing import stand_target
from boxgrasp.perception.target import Target, TargetPoints, find_target
from boxgrasp.perception.truncation import Truncation, find_truncation
from boxgrasp.ranking.ranker import (
    Ranker,
    RankerSetup,
    Ranking,
    RankingContext,
    ranker_named,
    validate_ranker,
    validate_ranking,
)
from boxgrasp.result import (
    NO_CANDIDATE_PASSES,
    RANKER_ASKS,
    Candidate,
    CheckValue,
    Refusal,
    Selection,
    TargetBox,
    grasp_of,
)
from boxgrasp.sensing.capture import Capture
from boxgrasp.strict import build
from boxgrasp.version import __version__

OnStage = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class SceneAnalysis:
    """What one view tells of a target, before a choice is made.

    Attributes:
        scene: the support plane and what stands on it.
        target_points: which points are the target's, and which are in its way.
        context: the candidates with their check results and local maps.
        truncation: which edges of the box are hidden.
        warnings: what the user should know.
        clock: the time that each stage took.
    """

    scene: Scene
    target_points: TargetPoints
    context: RankingContext
    truncation: Truncation
    warnings: tuple[CodedWarning, ...]
    clock: Clock

    @property
    def passing(self) -> NDArray[np.bool_]:
        """(M,) whether each candidate passes every check."""
        results = [result.passed for result in self.context.check_results.values()]
        every = np.ones(len(self.context.candidates.label), dtype=np.bool_)
        return np.asarray(np.logical_and.reduce([every, *results]))


def default_checks(
    config: Config | Mapping[str, Any] | str | None = None,
) -> tuple[Check, ...]:
    """The checks of a configuration: those that ship, then the plugins that it names.

    Args:
        config: as `GraspSelector` takes it.

    Returns:
        One check a name; a list with more is what `GraspSelector(checks=...)` takes.

    Raises:
        ConfigError: as `load_config`, and a plugin that is not installed.
    """
    return _checks_of(load_config(config))


def _checks_of(config: Config) -> tuple[Check, ...]:
    return (
        *shipped_checks(config.checks, config.candidates.faces),
        *plugin_checks(config.checks),
    )


class GraspSelector:
    """Selects grasps by one configuration; safe from several threads."""

    def __init__(
        self,
        config: Config | Mapping[str, Any] | str | None = None,
        *,
        ranker: Ranker | None = None,
        checks: Sequence[Check] | None = None,
        map_resolutions_m: Sequence[float] = (),
    ) -> None:
        """Prepare ranker and checks.

        Args:
            config: a YAML file's path, nested names and values, a Config, or None for defaults.
            ranker: orders the candidates in place of the configuration's.
            checks: in place of `default_checks(config)`.
            map_resolutions_m: cell sizes of local maps that `analyze` makes beside those that the
                ranker and the checks read, m.

        Raises:
            ConfigError: a faulty configuration, what is no ranker or no check, or two checks of
                one name.
            ModelError: models that are missing, damaged, or do not fit the code's features.
            MissingExtraError: an SVM ranker without onnxruntime.
        """
        self.config = load_config(config)
        self._hash = loaded_hash(self.config)
        setup = RankerSetup(self.config.models, self.config.gripper, self.config.candidates.lines)
        self.ranker = (
            ranker_named(self.config.ranker, setup)
            if ranker is None
            else validate_ranker(ranker).prepared(setup)
        )
        own = _checks_of(self.config) if checks is None else checks
        require(own, (list, tuple), "checks", "a list of checks, or None", ConfigError)
        self.checks = tuple(validate_check(check) for check in own)
        self._map_resolutions_m = _validated_resolutions(map_resolutions_m)
        names = [check.name for check in self.checks]
        if len(set(names)) < len(names):
            raise ConfigError(f"checks are named {', '.join(names)}; valid: each name once")

    def select(
        self,
        capture: Capture,
        target: Target | None = None,
        scans: Sequence[Capture] = (),
        octomap: MapCells | None = None,
        *,
        on_stage: OnStage | None = None,
    ) -> Selection:
        """Choose the grasp that is ranked best and passes every check, or ask for help.

        Args:
            capture: the view.
            target: the object wanted; None for the capture's own mask or pixel.
            scans: further views of the same scene, each with its pose.
            octomap: a map of the scene in the base frame, in place of one of our own.
            on_stage: called with the name of each stage as it ends; what it raises ends the call.

        Returns:
            A grasp or a refusal, with its evidence.

        Raises:
            SceneError: no support plane, nothing on it, or a scan whose place is unknown.
            TargetError: the target cannot be found where it was pointed at.
            BoxgraspError: an argument of another type.
        """
        # 1 to 4. The box, what surrounds it, every candidate and every check (2-1, 2-2, 2-4).
        analysis = self.analyze(capture, target, scans, octomap, on_stage=on_stage)
        return self.choose(analysis).seen_in(capture)

    def choose(self, analysis: SceneAnalysis) -> Selection:
        """The second half of `select`, for whoever wants the analysis too.

        Args:
            analysis: of `analyze`.

        Returns:
            As `select`, without its picture.
        """
        # 5. The order of the candidates (2-3).
        require(analysis, SceneAnalysis, "analysis", "what analyze answered")
        context, clock = analysis.context, analysis.clock
        ranking = validate_ranking(
            self.ranker, self.ranker.rank(context), len(context.candidates.label)
        )
        clock.lap("rank")
        # 6. The first in this order that passes, or a question (6-1).
        selection = self._answer(analysis, ranking)
        clock.lap("answer")
        return replace(selection, timings_ms=clock.timings_ms())

    def analyze(
        self,
        capture: Capture,
        target: Target | None = None,
        scans: Sequence[Capture] = (),
        octomap: MapCells | None = None,
        *,
        scene: Scene | None = None,
        on_stage: OnStage | None = None,
    ) -> SceneAnalysis:
        """All that is known before a choice is made.

        Args:
            capture: as `select`.
            target: as `select`.
            scans: as `select`.
            octomap: as `select`.
            scene: spares finding it again; scans then go into the local map alone.
            on_stage: as `select`.

        Returns:
            The candidates with every check's result, and what they rest on.

        Raises:
            SceneError: as `select`.
            TargetError: as `select`.
            BoxgraspError: as `select`.
        """
        _validate_request(target, octomap, scene, on_stage)
        config = self.config
        clock = Clock(on_stage)
        # 1. The support plane and what stands on it (appendix A).
        if scene is None:
            scene = self.scene(capture, scans)
        else:
            _validate_views(capture, scans)
            scene = scene.with_scans(scans, config.scene.sensor_model)
        clock.lap("scene")
        # 2. A box round the target, and which of its edges are hidden (2-1).
        scene, points = stand_target(scene, _target_points(scene, capture, target))
        window = scene.target_window(points.target_mask, REACH_PX)
        placed = self._placed_box(scene, points.target_mask, window)
        box = placed.box
        truncation = find_truncation(capture, scene, window, box)
        clock.lap("box")
        # 3. What is occupied, free and unseen round it (2-2).
        maps, map_obstacles = self._maps(scene, octomap, box)
        clock.lap("mapping")
        # 4. Every candidate, and what each check says of it (2-4, 3-4).
        candidates = self._candidates(box, scene, points.target_mask)
        surroundings = CheckContext(
            candidates=candidates,
            gripper=config.gripper,
            box=box,
            box_noise_m=placed.noise_m,
            scene=scene,
            target_mask=points.target_mask,
            obstacle_mask=points.obstacle_mask,
            local_map=maps[config.mapping.resolution_m],
            local_maps=maps,
            map_obstacles=map_obstacles,
            width_known=truncation.width_known,
        )
        context = RankingContext(box, candidates, self._results(surroundings), maps)
        clock.lap("checks")
        found = (*scene_warnings(scene), *points.warnings, *_truncation_warnings(truncation))
        warnings = (*capture.warnings, *found)
        return SceneAnalysis(scene, points, context, truncation, warnings, clock)

    def objects(self, capture: Capture) -> tuple[SceneObject, ...]:
        """The objects on the support plane.

        Args:
            capture: the view.

        Returns:
            Numbered from the nearest, from 1.

        Raises:
            SceneError: no support plane, or nothing on it.
        """
        return self.scene(capture).objects_with_pixels()

    def segment(self, capture: Capture) -> NDArray[np.int32]:
        """The number of the object that each pixel shows.

        Args:
            capture: a view with an image: depth, or an organized cloud.

        Returns:
            (H, W) int32, 0 for no object.

        Raises:
            SceneError: no support plane, nothing on it, or a capture without an image.
        """
        return self.scene(capture).object_image()

    def scene(self, capture: Capture, scans: Sequence[Capture] = ()) -> Scene:
        """The support plane and what stands on it (appendix A).

        Args:
            capture: the view.
            scans: further views of the same scene, each with its pose.

        Returns:
            Points, objects, plane and frames.

        Raises:
            SceneError: no support plane, nothing on it, or a scan whose place is unknown.
        """
        _validate_views(capture, scans)
        return find_scene(capture, scans, self.config.scene)

    def warm_up(self) -> None:
        """Compile or load every kernel, so that the first select is as quick as the next.

        Also that of depth images sent as RVL, which reading the first would wait for.
        """
        rvl.unpack(np.zeros(1, np.uint32), np.zeros(1, np.uint16))
        self.select(_two_blocks(), Target(pixel=(80, 60)))

    def _placed_box(
        self, scene: Scene, target_mask: NDArray[np.bool_], window: TargetWindow | None
    ) -> PlacedBox:
        """The box round the target, its sides at the thing's own where an image shows them."""
        points = scene.points[target_mask]
        box = fit_box(points, scene.plane, _heading(scene), self.config.box)
        camera = scene.camera_position_m
        if self.config.box.fit == "aligned" or window is None or camera is None:
            return unplaced(box)
        return place_sides(box, window, camera, scene.sensor)

    def _candidates(self, box: Box, scene: Scene, target_mask: NDArray[np.bool_]) -> Candidates:
        """The box's candidates, moved to the target's own surface unless that is unwanted."""
        config = self.config
        candidates = candidates_of(box, config.gripper, config.candidates.lines)
        if config.candidates.refine == "none":
            return candidates
        return moved_to_surface(candidates, scene.points[target_mask], config.gripper, scene.plane)

    def _results(self, context: CheckContext) -> dict[str, CheckResult]:
        """What each check says, by its name."""
        count = len(context.candidates.label)
        return {
            check.name: validate_result(check, check.evaluate(context), count)
            for check in self.checks
        }

    def _maps(
        self,
        scene: Scene,
        octomap: MapCells | None,
        box: Box,
    ) -> tuple[dict[float, LocalMap], MapObstacles]:
        """Local maps by cell size, and the occupied cells of a map file that no point explains."""
        config = self.config.mapping
        needed = [getattr(check, "map_resolutions_m", ()) for check in self.checks]
        needed += [self.ranker.map_resolutions_m, self._map_resolutions_m]
        sizes = dict.fromkeys((config.resolution_m, *sum(needed, ())))
        configs = {size: replace(config, resolution_m=size) for size in sizes}
        T_base_map = box.T_base_map(config.center_above_support_m)
        if octomap is None:
            T_source_map = invert(scene.T_base_source) @ T_base_map
            rays = view_rays(scene.views, config.stride)
            maps = {
                size: replace(build_local_map(rays, T_source_map, own), T_base_map=T_base_map)
                for size, own in configs.items()
            }
            return maps, NO_MAP_OBSTACLES
        occupied = MapObstacles(*octomap.occupied(config.occupied_above))
        maps = {size: map_from_octomap(octomap, T_base_map, own) for size, own in configs.items()}
        return maps, unexplained_cells(occupied, scene, box)

    def _answer(self, analysis: SceneAnalysis, ranking: Ranking) -> Selection:
        """The first candidate in the order that passes; else the nearest, and why it fails.

        A ranker that asks is obeyed even where candidates pass, and where the checks are not
        asked: its operator would have taken over there (6-1).
        """
        config, scene, passing = self.config, analysis.scene, analysis.passing
        reports = _reports(analysis.context, ranking)
        allowed = [FACES.index(face) + 1 for face in config.candidates.faces]
        wanted = [] if ranking.asks else ranking.order.tolist()
        chosen = next(
            (
                row for row in wanted
                if passing[row] or (config.unchecked and reports[row].face in allowed)
            ),
            None,
        )  # fmt: skip
        return Selection(
            grasp=None
            if chosen is None
            else grasp_of(
                reports[chosen],
                config.gripper,
                config.checks.pregrasp_distance_m,
                float(ranking.confidence[chosen]),
            ),
            refusal=_refusal(analysis, reports, ranking) if chosen is None else None,
            candidates=reports,
            box=_target_box(analysis),
            gripper=config.gripper,
            ranker=self.ranker.name,
            frame=scene.frame,
            T_base_camera=scene.T_base_camera,
            warnings=(*analysis.warnings, *self.ranker.warnings),
            config_hash=self._hash,
            timings_ms={},
            version=__version__,
        )


def _validate_views(capture: Any, scans: Any) -> None:
    """Refuse what is no view, before anything is asked of it.

    Raises:
        CaptureError: one of them is no Capture.
    """
    valid = "a Capture (boxgrasp.load_capture reads one)"
    require(capture, Capture, "capture", valid, CaptureError)
    require(scans, (list, tuple), "scans", "a list of Captures", CaptureError)
    for scan in scans:
        require(scan, Capture, "scan", valid, CaptureError)


def _validate_request(target: Any, octomap: Any, scene: Any, on_stage: Any) -> None:
    """Refuse what is of another type than `analyze` says.

    Raises:
        BoxgraspError: by what it is.
    """
    none = type(None)
    require(target, (Target, none), "target", "a Target, or None", TargetError)
    valid = "MapCells (boxgrasp.io.octomap.read_octomap reads them), or None"
    require(octomap, (MapCells, none), "octomap", valid, MapError)
    require(scene, (Scene, none), "scene", "what GraspSelector.scene answered, or None", SceneError)
    if on_stage is not None and not callable(on_stage):
        raise BoxgraspError(f"on_stage is {shown(on_stage)}; valid: a function of a name, or None")


def _validated_resolutions(sizes_m: Any) -> tuple[float, ...]:
    """Cell sizes of maps, each within what the configuration allows.

    Raises:
        ConfigError: one of them is not.
    """
    require(sizes_m, (list, tuple), "map_resolutions_m", "a list of meters", ConfigError)
    for size_m in sizes_m:
        build(MappingConfig, {"resolution_m": size_m}, "map_resolutions_m", ConfigError)
    return tuple(sizes_m)


class Clock:
    """Wall time stage by stage; the stages add up to the total."""

    def __init__(self, on_stage: OnStage | None = None) -> None:
        """Start.

        Args:
            on_stage: called with the name of each stage that is counted.
        """
        self._on_stage = on_stage
        self._start = self._last = time.perf_counter()
        self._laps: dict[str, float] = {}

    def lap(self, stage: str) -> None:
        """Count the time since the last lap for a stage."""
        now = time.perf_counter()
        self._laps[stage] = (now - self._last) * 1e3
        self._last = now
        if self._on_stage is not None:
            self._on_stage(stage)

    def timings_ms(self) -> dict[str, float]:
        """Milliseconds by stage, and `total`."""
        return {**self._laps, "total": (time.perf_counter() - self._start) * 1e3}


def _target_points(scene: Scene, capture: Capture, target: Target | None) -> TargetPoints:
    """The target's points; where there are none, wrong frames may be why."""
    try:
        return find_target(scene, capture, target)
    except TargetError as error:
        if scene.frame_doubt is None:
            raise
        raise TargetError(f"{error}; {scene.frame_doubt.message}") from None


def _reports(context: RankingContext, ranking: Ranking) -> tuple[Candidate, ...]:
    candidates = context.candidates
    rank = np.argsort(ranking.order) + 1
    values = {name: _values_of(said) for name, said in context.check_results.items()}
    columns = (candidates.label, candidates.face, candidates.line, rank, candidates.width_m)
    rows = zip(*(column.tolist() for column in columns), strict=True)
    return tuple(
        Candidate(
            label=label,
            face=face,
            line=line,
            rank=place,
            T_base_gripper=readonly(candidates.T_base_gripper[k].copy()),
            width_m=width_m,
            checks={name: said[k] for name, said in values.items()},
        )
        for k, (label, face, line, place, width_m) in enumerate(rows)
    )


def _values_of(said: CheckResult) -> list[CheckValue]:
    """What a check says of each candidate."""
    columns = (said.value, said.limit, said.passed, said.objects, said.nearest_points_m)
    return [
        CheckValue(
            value=value,
            limit=limit,
            unit=said.unit,
            passed=passed,
            object=number if number >= 0 else None,
            nearest_point_m=None if math.isnan(point[0]) else tuple(point),
        )
        for value, limit, passed, number, point in zip(
            *(column.tolist() for column in columns), strict=True
        )
    ]


def _refusal(analysis: SceneAnalysis, reports: Sequence[Candidate], ranking: Ranking) -> Refusal:
    """Why a person is asked, and the candidate that comes nearest to a grasp."""
    passing = [report for report in reports if analysis.passing[report.label - 1]]
    if passing:
        best = min(passing, key=lambda report: report.rank)
        said = f"the ranker asks for help; the best that passes is {best.name}"
        return Refusal(RANKER_ASKS, said, best.label, ())
    nearest = _nearest(analysis.context, reports)
    reasons = "; ".join(item.sentence for item in nearest.rejections)
    said = f"no candidate passes; the nearest to it, {nearest.name}: {reasons}"
    code = NO_CANDIDATE_PASSES
    if ranking.asks:
        code, said = RANKER_ASKS, f"the ranker asks for help, and {said}"
    return Refusal(code, said, nearest.label, nearest.rejections)


def _nearest(context: RankingContext, reports: Sequence[Candidate]) -> Candidate:
    """The candidate that fails fewest checks, then those by the least share of their limits."""
    results = context.check_results.values()
    failed = np.sum([~said.passed for said in results], axis=0)
    violation = np.sum([said.violation for said in results], axis=0)
    return min(reports, key=lambda c: (failed[c.label - 1], violation[c.label - 1], c.rank))


def _target_box(analysis: SceneAnalysis) -> TargetBox:
    box = analysis.context.box
    known = np.array([*analysis.truncation.width_known, True])
    return TargetBox(
        T_base_box=box.T_base_box,
        dimensions_m=box.dimensions_m,
        dimensions_at_least_m=box.dimensions_m,
        dimensions_at_most_m=readonly(np.where(known, box.dimensions_m, np.inf)),
    )


def _heading(scene: Scene) -> float:
    """Where the camera looks, as a turn about the base's z; 0 where it is unknown."""
    if scene.T_base_camera is None:
        return 0.0
    x = scene.T_base_table[:3, 0]
    return float(np.arctan2(x[1], x[0]))


def scene_warnings(scene: Scene) -> tuple[CodedWarning, ...]:
    """What the user should know of a scene.

    Args:
        scene: any.

    Returns:
        Its own warnings, and that the base frame is not the robot's, or that the camera's place is
        unknown.
    """
    found = [*scene.warnings]
    if scene.frame == "support":
        found.append(
            CodedWarning(
                "base_from_support_plane",
                "no T_base_camera given: the base frame is the support plane's",
            )
        )
    if scene.T_base_camera is None:
        found.append(
            CodedWarning("camera_unknown", "camera position unknown: no space is known to be free")
        )
    return tuple(found)


def _truncation_warnings(truncation: Truncation) -> list[CodedWarning]:
    found = []
    if truncation.cut:
        found.append(CodedWarning("target_cut", "target is cut by the image border"))
    for axis, known in zip("xy", truncation.width_known, strict=True):
        if not known:
            found.append(
                CodedWarning(
                    f"width_{axis}_lower_bound",
                    f"target's width along its {axis} is a lower bound: an edge is hidden",
                )
            )
    return found


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
