"""Labels in a database, given from Python, and what they teach.

Needs the extra `label`. `boxgrasp label` serves the page on which a person gives them. Here a rule
stands in for the person: the most clear candidate, or `none` (I would help) in narrow places.
"""

import tempfile
import uuid
from datetime import datetime, timezone
from pathlib import Path

from boxgrasp import GraspSelector
from boxgrasp.execution import Store, local_workers
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.lessons import LessonConfig, lessons_of, scene_config
from boxgrasp.labeling.record import Record
from boxgrasp.labeling.sources import DrawnSource, load_scene
from boxgrasp.labeling.words import LabelScene, OperatorLabel
from boxgrasp.ranking.model_set import SVMS
from boxgrasp.simulate.scenario import Recipe, targets_of
from boxgrasp.strict import plain
from boxgrasp.teaching.rows import RowConfig
from boxgrasp.teaching.sets import SetConfig
from boxgrasp.teaching.train import train_svm
from boxgrasp.version import __version__

source = DrawnSource(SetConfig(RowConfig(Recipe(targets_of("known")), seed=1), count=30))
scenes = source.scenes()
lesson = LessonConfig()
selector = GraspSelector(scene_config(scenes[0], lesson.config))  # as the page shows a scene


def said_of(scene: LabelScene, captures: CaptureStore) -> OperatorLabel:
    """The label of a scene, as the page would keep it."""
    loaded = load_scene(scene, captures)
    answer = selector.select(loaded.capture, loaded.target)
    grasp = answer.grasp
    taken = grasp.label if grasp and (grasp.clearance_m or 0.0) >= 0.04 else None
    return OperatorLabel(
        id=str(uuid.uuid4()),
        scene_key=scene.key,
        operator="a rule",
        verdict="none" if taken is None else "candidate",
        label=taken,
        labeled_at=datetime.now(timezone.utc),
        seconds=None,
        gripper=plain(answer.gripper),
        box_kind=scene.box_kind,
        lines=scene.lines,
        version=__version__,
    )


with tempfile.TemporaryDirectory() as folder, local_workers(processes=1) as workers:
    captures = CaptureStore(Store(folder))  # of scenarios it keeps only what is learned from
    with Record.open(Path(folder) / "labels.sqlite") as record:
        record.add_scenes(source.name, scenes)
        for scene in scenes:
            record.save(said_of(scene, captures))  # kept when this returns
        lessons = lessons_of(record, captures, workers, lesson, title="")

print(f"{lessons.labels} labels of {lessons.scenes} scenes by {dict(lessons.operators)}")
rows, made_with = lessons.taught.rows, lessons.taught.provenance
single_grid = next(svm for svm in SVMS if svm.name == "single-grid")
model = train_svm(rows, single_grid, made_with).record
print(f"cross-validated accuracy {model.accuracy:.2f} over classes {model.classes}; 16 is none")
