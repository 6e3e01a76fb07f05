"""How often rankers say what operators said: `python benchmarks/label_agreement.py DB [CAPTURES]`.

DB is the database of `boxgrasp label`, CAPTURES the place of its captures (default: beside it).
Each label that stands is held against each ranker twice: its first candidate, whatever the checks
say, and its answer, where a question is the same as `none`. Labels that say that the box is wrong
are counted and left out. Beside them stands what always the commonest label would be worth.
"""

from __future__ import annotations

import argparse
from collections import Counter
from dataclasses import replace

import numpy as np

from boxgrasp import BoxgraspError, GraspSelector
from boxgrasp.config import Config
from boxgrasp.execution import Store
from boxgrasp.labeling.captures import CaptureStore
from boxgrasp.labeling.lessons import scene_config
from boxgrasp.labeling.record import Record
from boxgrasp.labeling.sources import load_scene
from boxgrasp.labeling.words import LabelScene, OperatorLabel

RANKERS = (
    "single-spiral",
    "cascade-spiral",
    "single-grid",
    "cascade-grid",
    "clearance",
    "top-down",
)
NONE = 0  # stands for a request for help


def answers(scene: LabelScene, captures: CaptureStore, ranker: str) -> tuple[int, int]:
    """A ranker's first candidate, and its answer with the checks."""
    loaded = load_scene(scene, captures)
    selector = GraspSelector(replace(scene_config(scene, Config()), ranker=ranker))
    selection = selector.select(loaded.capture, loaded.target)
    first = min(selection.candidates, key=lambda item: item.rank)
    return first.label, NONE if selection.grasp is None else selection.grasp.label


def said(label: OperatorLabel) -> int:
    """What an operator said, as a number."""
    return NONE if label.label is None else label.label


def tell(
    operator: str, labels: list[OperatorLabel], found: dict[str, list[tuple[int, int]]]
) -> None:
    """One operator's table."""
    given = np.array([said(label) for label in labels])
    lines = np.array([label.lines for label in labels])
    taken = given != NONE
    common = Counter(given.tolist()).most_common(1)[0][1]
    print(f"{operator}: {len(given)} labels, {int((~taken).sum())} none; the commonest {common}")
    print("ranker            first: label  face  of    answer, none = ask: same  of")
    for ranker, pairs in found.items():
        first, answer = np.array(pairs).T
        same = (first == given)[taken].sum()
        face = ((first - 1) // lines == (given - 1) // lines)[taken].sum()
        print(
            f"{ranker:18}{same:12d}{face:6d}{taken.sum():4d}{(answer == given).sum():26d}"
            f"{len(given):4d}"
        )


def main() -> None:
    """Tell every operator's."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("database")
    parser.add_argument("captures", nargs="?")
    args = parser.parse_args()
    place = args.captures or f"{args.database.rsplit('.', 1)[0]}-captures"
    captures = CaptureStore(Store(place))
    with Record.open(args.database, create=False) as record:
        scenes = {scene.key: scene for scene in record.scenes()}
        standing = record.standing()
    known: dict[tuple[str, str], tuple[int, int]] = {}
    for operator in sorted({label.operator for label in standing}):
        own = [label for label in standing if label.operator == operator]
        kept = [label for label in own if label.verdict in ("candidate", "none")]
        print(f"{operator}: {len(own) - len(kept)} of {len(own)} labels say that the box is wrong")
        for ranker in RANKERS:
            for key in {label.scene_key for label in kept} - {k for k, r in known if r == ranker}:
                try:
                    known[key, ranker] = answers(scenes[key], captures, ranker)
                except BoxgraspError as error:
                    raise SystemExit(f"{scenes[key].name}: {error}") from None
        tell(operator, kept, {r: [known[x.scene_key, r] for x in kept] for r in RANKERS})


if __name__ == "__main__":
    main()
