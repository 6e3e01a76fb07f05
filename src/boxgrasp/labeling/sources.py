"""What there is to label: scenario sets, captures, or scenarios drawn as they are asked for."""

from __future__ import annotations

import hashlib
import json
import logging
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Bools
from boxgrasp.config import Config
from boxgrasp.errors import BoxgraspError, ConfigError, StoreError, TargetError, shown
from boxgrasp.execution import Store
from boxgrasp.execution.progress import progress
from boxgrasp.io import load_capture
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.words import LabelScene
from boxgrasp.perception.numbering import SceneObject
from boxgrasp.perception.scene import Scene
from boxgrasp.perception.target import Target, find_target
from boxgrasp.selector import GraspSelector
from boxgrasp.sensing.capture import Capture
from boxgrasp.sensing.validation import CloudFrame
from boxgrasp.simulate.scenario import Scenario
from boxgrasp.strict import build, plain
from boxgrasp.teaching.rows import FITS, RowConfig, ScenarioView, scenario_of_row, view_of_row
from boxgrasp.teaching.sets import SetConfig, read_set
from boxgrasp.version import __version__

SIMULATE: Final = "simulate"  # the word that stands for a set drawn on the fly
_SUFFIXES: Final = (".npz", ".pcd", ".ply", ".bag", ".db3", ".mcap")
_FOLDER_MARKS: Final = ("depth.png", "cloud.pcd", "cloud.ply", "metadata.yaml")
_VALID: Final = (
    "a set that `boxgrasp simulate` wrote, a capture, a folder of captures (folders with depth.png,"
    " .npz, .pcd, .ply, .bag, .db3 or .mcap), or the word `simulate`"
)
_NUMBER: Final = re.compile(r"(\d+)")
_log = logging.getLogger("boxgrasp.labeling")


class Source(Protocol):
    """Where scenes come from."""

    @property
    def name(self) -> str:
        """What tells it from other sources in the record."""

    def scenes(self) -> Sequence[LabelScene]:
        """Its scenes.

        Returns:
            In the order in which they are to be labeled.

        Raises:
            BoxgraspError: it cannot be read, or holds none.
        """


@dataclass(frozen=True, eq=False)
class LoadedScene:
    """A scene ready to be looked at.

    Attributes:
        scene: what was loaded.
        capture: the view.
        target: which thing of it; None for the capture's own.
        view: of a scenario, with its true objects and further frames; None for a capture.
        scenario: with its truth; None for a capture.
    """

    scene: LabelScene
    capture: Capture
    target: Target | None
    view: ScenarioView | None = None
    scenario: Scenario | None = None


def source_at(
    place: str,
    captures: CaptureStore,
    *,
    simulate: SetConfig | None = None,
    config: Config | None = None,
    cloud_frame: CloudFrame = "optical",
) -> Source:
    """The source that a command names.

    Args:
        place: a set's folder or URL, a capture, a folder of captures, or `simulate`.
        captures: where captures are kept.
        simulate: the set that the word `simulate` stands for.
        config: how objects are found in captures and their boxes are fitted; None for defaults.
        cloud_frame: as `load_capture`, of clouds among the captures.

    Returns:
        The source; nothing is read yet but what tells its kind.

    Raises:
        ConfigError: it is none of these.
        StoreError: a URL that cannot be reached.
        MissingExtraError: a URL, without fsspec.
    """
    if place == SIMULATE:
        if simulate is None:
            raise ConfigError("no set to simulate is given; valid: a count, targets and a seed")
        return DrawnSource(simulate)
    store = Store(place)
    if store.exists("set.json"):
        return SetSource(store)
    if store.folder is None:
        raise ConfigError(f"{store} holds no set; valid: {_VALID}")
    path = Path(store.folder)
    if not path.exists():
        raise ConfigError(f"{shown(place)}: no such file or folder; valid: {_VALID}")
    return CaptureSource(path, captures, Config() if config is None else config, cloud_frame)


@dataclass(frozen=True, eq=False)
class SetSource:
    """A set on disk or at a URL: the rows of it that have an answer.

    Attributes:
        store: where it is.
    """

    store: Store

    @property
    def name(self) -> str:
        """The set's place."""
        folder = self.store.folder
        return str(self.store) if folder is None else str(Path(folder).resolve())

    def scenes(self) -> Sequence[LabelScene]:
        """A scene a row.

        Returns:
            By their numbers.

        Raises:
            ConfigError: parts or rows are missing, or none has an answer.
            StoreError: the place cannot be read.
            MissingExtraError: pyarrow is not installed.
        """
        made, rows = read_set(self.store)
        errors = rows.columns.get("given_error", np.full(rows.count, ""))
        numbers = np.flatnonzero(errors == "").tolist()
        if not numbers:
            raise ConfigError(f"{self.store}: no scenario of the set shows its target; valid: some")
        return scenario_scenes(made, numbers)


@dataclass(frozen=True, eq=False)
class DrawnSource:
    """A set that is drawn as its scenes are asked for; nothing of it is written.

    Attributes:
        made: what it is made of.
    """

    made: SetConfig

    @property
    def name(self) -> str:
        """The word, the seed, and what tells the settings from others."""
        rows = self.made.rows
        said = _rows_sha256(plain(rows), self.made.objects_sha256)
        return f"{SIMULATE}-{rows.seed}-{said[:12]}"

    def scenes(self) -> Sequence[LabelScene]:
        """A scene a row.

        Returns:
            By their numbers.
        """
        return scenario_scenes(self.made, range(self.made.count))


@dataclass(frozen=True, eq=False)
class CaptureSource:
    """A capture, or a folder of them: each object found is a scene, or the capture's own target.

    Attributes:
        path: of the capture or folder.
        captures: where captures are kept.
        config: how objects are found.
        cloud_frame: as `load_capture`.
    """

    path: Path
    captures: CaptureStore
    config: Config
    cloud_frame: CloudFrame = "optical"

    @property
    def name(self) -> str:
        """The place."""
        return str(self.path.resolve())

    def scenes(self) -> Sequence[LabelScene]:
        """The things to label; what is no capture is passed over with a line in the log.

        Returns:
            By the captures' names, then the objects' numbers; none twice.

        Raises:
            ConfigError: nothing in the folder can be labeled.
            StoreError: captures cannot be kept.
        """
        paths = list(capture_paths(self.path))
        selector = GraspSelector(self.config)
        found: dict[str, LabelScene] = {}
        with progress("captures", len(paths), 0) as step:
            for path in paths:
                for scene in self._scenes_of(path, selector):
                    found.setdefault(scene.key, scene)
                step()
        if not found:
            raise ConfigError(f"{self.path}: nothing to label in {len(paths)} captures; valid: "
                              f"{_VALID}")  # fmt: skip
        return tuple(found.values())

    def _scenes_of(self, path: Path, selector: GraspSelector) -> list[LabelScene]:
        inside = path.relative_to(self.path).as_posix()
        name = self.path.name if inside == "." else inside
        try:
            capture = load_capture(path, cloud_frame=self.cloud_frame)
            sha256 = self.captures.add(capture)
            targets = self._targets(sha256, capture, selector)
        except StoreError:
            raise
        except BoxgraspError as error:
            if path == self.path:  # the one that was asked for
                raise ConfigError(str(error)) from None
            _pass_over("no_capture", path, str(error))
            return []
        return [
            capture_scene(sha256, target, _named(name, target), self.config) for target in targets
        ]

    def _targets(
        self, sha256: str, capture: Capture, selector: GraspSelector
    ) -> list[dict[str, Any]]:
        """Targets of a capture; those that were found before are read again."""
        said = {"scene": plain(self.config.scene), "version": __version__}
        name = f"targets/{sha256[:2]}/{sha256}-{_sha256(said)[:16]}.json"
        if self.captures.store.exists(name):
            try:
                kept = json.loads(self.captures.store.read(name))
            except ValueError:
                kept = None
            if isinstance(kept, list) and all(isinstance(item, dict) for item in kept):
                return kept
        targets = targets_in(capture, selector)
        self.captures.store.write(name, json.dumps(targets).encode())
        return targets


def scenario_scenes(made: SetConfig, numbers: Sequence[int]) -> tuple[LabelScene, ...]:
    """The scenes of some of a set's rows.

    Args:
        made: what the set is made of.
        numbers: of the rows.

    Returns:
        A scene a row, with the thesis's aligned box.
    """
    rows = json.loads(json.dumps(plain(made.rows)))  # as it comes back out of a database
    said = _rows_sha256(rows, made.objects_sha256)
    return tuple(
        LabelScene(
            key=f"{said}-{number}",
            kind="scenario",
            name=f"scenario {number}",
            box_kind=FITS["given"],
            lines=made.rows.lines,
            row_config=rows,
            number=number,
        )
        for number in numbers
    )


def capture_scene(
    sha256: str, target: Mapping[str, Any], name: str, config: Config | None = None
) -> LabelScene:
    """The scene of one thing in a capture.

    Args:
        sha256: what `CaptureStore.add` gave.
        target: `{"pixel": [u, v]}`, `{"point": [x, y, z]}` or `{"mask": true}`.
        name: what people call it.
        config: how its box is fitted and how many lines its faces have; None for defaults.

    Returns:
        The scene.
    """
    own = Config() if config is None else config
    box, lines = own.box.fit, own.candidates.lines
    return LabelScene(
        key=f"{sha256}-{_sha256(dict(target))[:12]}-{box}-{lines}",
        kind="capture",
        name=name,
        box_kind=box,
        lines=lines,
        capture_sha256=sha256,
        target=dict(target),
    )


def load_scene(scene: LabelScene, captures: CaptureStore) -> LoadedScene:
    """A scene's view and target, read or cast again.

    Args:
        scene: any that a source gave, whatever became of the source.
        captures: where captures are kept.

    Returns:
        The loaded scene.

    Raises:
        CaptureError: what is kept of the capture is damaged.
        ConfigError: a scene of other settings or objects than there are now.
        SceneError: a scenario that cannot be drawn.
        StoreError: the capture is not there, or cannot be read.
    """
    if scene.kind == "capture":
        if scene.capture_sha256 is None or scene.target is None:
            raise ConfigError(f"scene {scene.key} names no capture or no target; valid: both")
        return LoadedScene(scene, captures.read(scene.capture_sha256), target_of(scene.target))
    if scene.row_config is None or scene.number is None:
        raise ConfigError(f"scene {scene.key} has no settings or no number; valid: both")
    config = build(RowConfig, dict(scene.row_config), f"scene {scene.key}", ConfigError)
    made = SetConfig(config, count=scene.number + 1)
    if scenario_scenes(made, [scene.number])[0].key != scene.key:
        raise ConfigError(
            f"scene {scene.key} is of other settings or objects than there are now; valid: the "
            f"object set {config.recipe.objects} as it was labeled"
        )
    view = view_of_row(config, scene.number)
    scenario = scenario_of_row(config, scene.number // config.runs)
    mask = view.object_ids == scenario.scene.target_id
    return LoadedScene(scene, view.capture, Target(mask=mask), view, scenario)


def target_of(target: Mapping[str, Any]) -> Target | None:
    """The target that a scene's plain values name.

    Args:
        target: as `LabelScene.target`.

    Returns:
        The target; None for the capture's own mask.

    Raises:
        ConfigError: other values.
    """
    match dict(target):
        case {"pixel": [int(u), int(v)], **rest} if not rest:
            return Target(pixel=(u, v))
        case {
            "point": [int() | float() as x, int() | float() as y, int() | float() as z],
            **rest,
        } if not rest:
            return Target(point=(x, y, z))
        case {"mask": True, **rest} if not rest:
            return None
    raise ConfigError(f"a scene's target is {dict(target)!r:.60}; valid: a pixel, point or mask")


def targets_in(capture: Capture, selector: GraspSelector) -> list[dict[str, Any]]:
    """What there is to label in a capture: its own target, else each object that is found.

    Args:
        capture: the view.
        selector: whose scene settings find the objects.

    Returns:
        Plain values as `LabelScene.target`, each of which leads back to its object.

    Raises:
        SceneError: no support plane, or nothing on it.
    """
    if capture.mask is not None:
        return [{"mask": True}]
    if capture.target_pixel is not None:
        return [{"pixel": list(capture.target_pixel)}]
    scene = selector.scene(capture)
    image = scene.object_image() if scene.shape is not None else None
    told = [plain_target(scene, capture, item, image) for item in scene.objects_with_pixels()]
    return [target for target in told if target is not None]


def plain_target(
    scene: Scene, capture: Capture, item: SceneObject, image: NDArray[np.int32] | None
) -> dict[str, Any] | None:
    """Plain values that lead back to an object.

    Args:
        scene: that found it.
        capture: the view.
        item: the object, of `scene.objects_with_pixels()`.
        image: (H, W) of `scene.object_image()`; None without an image.

    Returns:
        As `LabelScene.target`; None where nothing leads back to it.
    """
    pixels = [] if image is None else [_deepest(image == item.number), item.pixel]
    ways: list[tuple[dict[str, Any], Target]] = [
        ({"pixel": list(pixel)}, Target(pixel=pixel)) for pixel in pixels if pixel is not None
    ]
    point = _point_on(scene, item.number)
    ways.append(({"point": list(point)}, Target(point=point)))
    return next((told for told, to in ways if _leads_to(scene, capture, to, item.number)), None)


def capture_paths(place: Path) -> Iterator[Path]:
    """The captures at a place: itself, those in it, and those in the folders in it.

    What is neither is passed over with a line in the log, as is what a symbolic link fetches from
    outside the place.

    Args:
        place: a capture, or a folder.

    Yields:
        Paths that `load_capture` may read, by their names, numbers in them in their order.

    Raises:
        ConfigError: the folder cannot be listed.
    """
    if _looks_like_capture(place):
        yield place
        return
    if not place.is_dir():
        raise ConfigError(f"{place}: no capture and no set; valid: {_VALID}")
    root = place.resolve()
    for entry in _listed(place):
        if not _is_inside(entry, root):
            _pass_over("outside", entry, "leads out of the folder, or cannot be listed")
        elif _looks_like_capture(entry):
            yield entry
        elif not entry.is_dir():
            _pass_over("no_capture", entry, f"valid: {', '.join(_SUFFIXES)}")
        else:
            inner = [e for e in _listed(entry) if _is_inside(e, root) and _looks_like_capture(e)]
            yield from inner
            if not inner:
                _pass_over("no_capture", entry, "a folder without captures")


def _looks_like_capture(path: Path) -> bool:
    if path.is_dir():
        return any((path / mark).is_file() for mark in _FOLDER_MARKS)
    return path.suffix.lower() in _SUFFIXES and path.is_file()


def _is_inside(path: Path, root: Path) -> bool:
    """Whether a path, and what a folder holds, stay inside, wherever symbolic links lead."""
    try:
        parts = [path, *path.iterdir()] if path.is_dir() else [path]
        return all(part.resolve().is_relative_to(root) for part in parts)
    except (OSError, RuntimeError):  # not to be listed; links in a circle, before Python 3.13
        return False


def _listed(folder: Path) -> list[Path]:
    """What is in a folder but hidden names, numbers in names in their order."""
    try:
        names = sorted(os.listdir(folder), key=_natural)
    except OSError as error:
        raise ConfigError(f"{folder}: {error.strerror or error}; valid: {_VALID}") from None
    return [folder / name for name in names if not name.startswith(".")]


def _natural(name: str) -> list[tuple[int, int, str]]:
    return [
        (0, int(part), part) if part.isdigit() else (1, 0, part)
        for part in _NUMBER.split(name)
        if part
    ]


def _pass_over(code: str, path: Path, why: str) -> None:
    said = " ".join(why.removeprefix(f"{path}: ").split())
    _log.warning("passed over (%s): %s: %s", code, path, said)


def _named(name: str, target: Mapping[str, Any]) -> str:
    match target:
        case {"pixel": [u, v]}:
            return f"{name}, pixel {u} {v}"
        case {"point": [x, y, z]}:
            return f"{name}, point {x:.3f} {y:.3f} {z:.3f}"
    return name


def _deepest(inside: Bools) -> tuple[int, int] | None:
    """(u, v) of the pixel that lies deepest inside, of equals the one nearest to their middle."""
    rows, columns = np.flatnonzero(inside.any(axis=1)), np.flatnonzero(inside.any(axis=0))
    if len(rows) == 0:
        return None
    left = np.pad(inside[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1], 1)
    while True:
        smaller = left.copy()
        for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
            smaller &= np.roll(left, shift, axis)
        if not smaller.any():
            break
        left = smaller
    v, u = np.nonzero(left)
    off = (u - u.mean()) ** 2 + (v - v.mean()) ** 2
    k = int(np.argmin(off))
    return int(u[k] - 1 + columns[0]), int(v[k] - 1 + rows[0])


def _point_on(scene: Scene, number: int) -> tuple[float, float, float]:
    """The object's own point that is nearest to the middle of them, base frame, m."""
    points = scene.points[scene.object_numbers == number].astype(np.float64)
    middle = np.median(points, axis=0)
    x, y, z = points[int(np.argmin(((points - middle) ** 2).sum(axis=1)))].tolist()
    return x, y, z


def _leads_to(scene: Scene, capture: Capture, target: Target, number: int) -> bool:
    try:
        found = find_target(scene, capture, target)
    except TargetError:
        return False
    return bool(np.array_equal(found.target_mask, scene.object_numbers == number))


def _rows_sha256(rows: Any, objects_sha256: str) -> str:
    return _sha256({"rows": rows, "objects": objects_sha256})


def _sha256(said: Any) -> str:
    return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()
