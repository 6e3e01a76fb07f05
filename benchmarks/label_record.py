"""How long the record of labels takes. `python benchmarks/label_record.py [--database URL]`.

Most scenes of a large source have a label already, a tenth comes twice; an operator is given
scenes and saves labels. In a new SQLite file, or in an empty database of PostgreSQL.
"""

from __future__ import annotations

import argparse
import tempfile
import time
import uuid
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from pathlib import Path

import numpy as np

from boxgrasp.labeling.record import Record
from boxgrasp.labeling.record.labels import KeptLabel
from boxgrasp.labeling.words import LabelScene, OperatorLabel, TurnRules

START = datetime(2026, 3, 1, tzinfo=timezone.utc)
RULES = TurnRules(second_share=0.1, again_share=0.1)


def label(key: str, operator: str, seconds: float) -> OperatorLabel:
    """A label of a scene."""
    return OperatorLabel(
        str(uuid.uuid4()), key, operator, "candidate", 4, START + timedelta(seconds=seconds), 2.5,
        {"name": "hand"}, "yaw", 3, "0",
    )  # fmt: skip


def told(name: str, call: Callable[[], object], rounds: int) -> None:
    """Print the median and the longest time of a call."""
    took = []
    for _ in range(rounds):
        start = time.perf_counter()
        call()
        took.append(1e3 * (time.perf_counter() - start))
    print(f"{name:22} {np.median(took):7.1f} ms, at most {max(took):.1f}")


def measure(record: Record, scenes: int, rounds: int) -> None:
    """Print all times of a record that is empty."""
    given = [
        LabelScene(f"scene-{k}", "scenario", str(k), "yaw", 3, number=k) for k in range(scenes)
    ]
    record.add_scenes("set", given)
    done = given[: scenes - min(scenes // 2, 2 * rounds)]
    record.take_in([KeptLabel(label(s.key, "ann", 3 * k), s, {}) for k, s in enumerate(done)])
    now = [3.0 * scenes]
    for operator in ("ann", "bob"):
        keys: list[str] = []

        def ask(operator: str = operator, keys: list[str] = keys) -> None:
            now[0] += 3.0
            moment = START + timedelta(seconds=now[0])
            turn = record.next_turn("set", operator, RULES, moment, skip=keys)
            keys += [turn.scene.key] if turn else []

        def save(operator: str = operator, keys: list[str] = keys) -> None:
            record.save(label(keys.pop(), operator, now[0]))

        told(f"{operator}: next_turn", ask, rounds)
        told(f"{operator}: save", save, len(keys))

        def look(operator: str = operator) -> None:
            record.progress("set", operator, START + timedelta(seconds=now[0]))

        told(f"{operator}: progress", look, rounds)
    told("agreements", record.agreements, 3)


def main(argv: list[str] | None = None) -> None:
    """Print the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--database", metavar="URL", help="an empty one (default: a new file)")
    parser.add_argument("--scenes", type=int, default=5000)
    parser.add_argument("--rounds", type=int, default=100)
    args = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        with Record.open(args.database or str(Path(folder) / "labels.db")) as record:
            print(f"{record.name}: {args.scenes} scenes, nearly all labeled")
            measure(record, args.scenes, args.rounds)


if __name__ == "__main__":
    main()
