"""What all operators at the page share: the scenes, the record, the robot's proposals."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Collection
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from typing import Final, Literal

from boxgrasp.config import Config
from boxgrasp.errors import BoxgraspError, ConfigError
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.learning import Learner
from boxgrasp.labeling.lessons import scene_config
from boxgrasp.labeling.record import Record
from boxgrasp.labeling.server.prepared import PreparedScene, prepare
from boxgrasp.labeling.sources import load_scene
from boxgrasp.labeling.words import LabelScene, Turn, TurnRules
from boxgrasp.selector import GraspSelector

Mode = Literal["label", "assist"]
_KEPT_SCENES: Final = 12  # prepared, of all operators; 2 MB each, 30 with their captures


@dataclass(frozen=True)
class DeskRules:
    """How the page behaves.

    Attributes:
        mode: `label`, the operator chooses unasked; `assist`, the robot proposes.
        turns: which scenes come twice, and for how long one is an operator's.
        operator: the name that the page starts with; empty asks for one.
    """

    mode: Mode = "label"
    turns: TurnRules = TurnRules()
    operator: str = ""


@dataclass(frozen=True, eq=False)
class Unshowable:
    """A scene that cannot be shown.

    Attributes:
        scene: that one.
        reason: one sentence.
    """

    scene: LabelScene
    reason: str


class Desk:
    """Scenes for operators; safe from several threads.

    Args:
        record: of the labels.
        source: name of the source, as its scenes were added to the record.
        captures: where the captures are kept.
        config: of the robot: hand, box, checks, ranker.
        rules: of the page.
        learner: trains from the labels; None where nothing is to be learned.

    Attributes:
        scenes: of the source, in its order.
    """

    def __init__(
        self,
        record: Record,
        source: str,
        captures: CaptureStore,
        config: Config,
        rules: DeskRules,
        learner: Learner | None = None,
    ) -> None:
        self.record, self.source, self.captures = record, source, captures
        self.rules, self.learner = rules, learner
        self.scenes = tuple(record.scenes(source))
        self._numbers = {scene.key: k for k, scene in enumerate(self.scenes, start=1)}
        self._config = config
        self._selectors: dict[tuple[str, str, int], GraspSelector] = {}
        self._prepared: OrderedDict[str, Future[PreparedScene | Unshowable]] = OrderedDict()
        self._lock = threading.Lock()
        # One thread: two preparations side by side would make both late, and one is awaited.
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="prepare")
        self._proposing = config if learner is None else learner.config_with(config)
        self._number = None if learner is None else learner.active

    def warm_up(self) -> None:
        """Compile or load every kernel, so that the first scene is as quick as the next."""
        GraspSelector(self._config).warm_up()

    def close(self) -> None:
        """Stop preparing and learning."""
        self._pool.shutdown(wait=False, cancel_futures=True)
        if self.learner is not None:
            self.learner.cancel()

    def number_of(self, key: str) -> int | None:
        """A scene's number in the source.

        Args:
            key: of the scene.

        Returns:
            From 1; None for one that is not of the source, as the robot's questions are.
        """
        return self._numbers.get(key)

    @property
    def configured(self) -> str:
        """The ranker that the user configured."""
        return self._config.ranker

    @property
    def model(self) -> str:
        """What proposes: the ranker's name, and the number of its models where they are learned."""
        ranker = self._proposing.ranker
        return ranker if self._number is None else f"{ranker} {self._number}"

    def propose_with(self, number: int | None) -> None:
        """Let models that were learned here propose from now on, or the user's own ranker again.

        Args:
            number: of the models; None for the user's own.

        Raises:
            BoxgraspError: no such models, or they cannot be used.
        """
        if self.learner is None:
            raise ConfigError("nothing is learned here; valid: the configured ranker")
        before = self.learner.active
        self.learner.activate(number)
        config = self.learner.config_with(self._config)
        try:
            GraspSelector(config)
        except BoxgraspError:
            self.learner.activate(before)
            raise
        with self._lock:
            self._proposing, self._number = config, number
            self._selectors.clear()
            self._prepared.clear()

    def selector(self, scene: LabelScene) -> GraspSelector:
        """The selector that answers a scene as it is labeled.

        Args:
            scene: to be shown.

        Returns:
            One for all scenes of the same kind.

        Raises:
            BoxgraspError: the ranker's models are for another number of lines.
        """
        key = (scene.kind, scene.box_kind, scene.lines)
        with self._lock:
            if key not in self._selectors:
                self._selectors[key] = GraspSelector(self._config_of(scene))
            return self._selectors[key]

    def _config_of(self, scene: LabelScene) -> Config:
        proposing = self._proposing
        labeled = scene_config(scene, self._config)
        return replace(labeled, ranker=proposing.ranker, models=proposing.models)

    def prepared(self, scene: LabelScene) -> Future[PreparedScene | Unshowable]:
        """A scene made ready, in the background.

        Args:
            scene: which one.

        Returns:
            What will be shown, or why it cannot be.
        """
        with self._lock:
            held = self._prepared.get(scene.key)
            if held is None:
                held = self._pool.submit(self._prepare, scene)
                self._prepared[scene.key] = held
            self._prepared.move_to_end(scene.key)
            while len(self._prepared) > _KEPT_SCENES:
                self._prepared.popitem(last=False)
            return held

    def _prepare(self, scene: LabelScene) -> PreparedScene | Unshowable:
        try:
            loaded = load_scene(scene, self.captures)
            return prepare(scene, loaded.capture, loaded.target, self.selector(scene))
        except BoxgraspError as error:
            return Unshowable(scene, str(error))

    def next_turn(self, operator: str, skip: Collection[str]) -> Turn | None:
        """The scene that an operator is to label next.

        Args:
            operator: whose turn it is.
            skip: keys of scenes that are passed over.

        Returns:
            The turn, or None where nothing is left.

        Raises:
            StoreError: the record cannot be read or written.
        """
        return self.record.next_turn(self.source, operator, self.rules.turns, now(), skip)


def now() -> datetime:
    """This moment, with its time zone.

    Returns:
        UTC.
    """
    return datetime.now(timezone.utc)
