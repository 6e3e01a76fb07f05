"""Scenes and labels of tests, and a program that labels until nothing is left."""

from __future__ import annotations

import os
import signal
import sys
import uuid
from datetime import datetime, timedelta, timezone
from typing import Any

from boxgrasp.labeling.record import Record
from boxgrasp.labeling.words import LabelScene, OperatorLabel, TurnRules

START = datetime(2026, 3, 1, 8, 0, tzinfo=timezone.utc)
SOURCE = "set"


def after(seconds: float) -> datetime:
    return START + timedelta(seconds=seconds)


def new_id() -> str:
    return str(uuid.uuid4())


def scene(number: int) -> LabelScene:
    config = {"seed": 7, "recipe": {"noise": 0.002}}
    return LabelScene(
        f"scene-{number:04d}", "scenario", f"{number}", "yaw", 3, row_config=config, number=number
    )


def captured(number: int, **changes: Any) -> LabelScene:
    fields: dict[str, Any] = {"capture_sha256": f"{number:064x}", "target": {"pixel": [3, number]}}
    fields |= {"key": f"capture-{number}", "kind": "capture", "name": f"table {number}.npz"}
    return LabelScene(**(fields | {"box_kind": "aligned", "lines": 3} | changes))


def label(scene_key: str, operator: str = "ann", at: float = 0.0, **changes: Any) -> OperatorLabel:
    fields: dict[str, Any] = {"id": new_id(), "verdict": "candidate", "label": 4}
    fields |= {"labeled_at": after(at), "seconds": 2.5, "gripper": {"name": "wide", "open_m": 0.1}}
    fields |= {"box_kind": "yaw", "lines": 3, "version": "0.1.0"}
    return OperatorLabel(scene_key=scene_key, operator=operator, **(fields | changes))


def work(url: str, operator: str, most: int) -> None:
    """Label until nothing is left, or so many; a line each label, once it is kept."""
    with Record.open(url) as record:
        for _ in range(most):
            turn = record.next_turn(SOURCE, operator, TurnRules(), datetime.now(timezone.utc))
            if turn is None:
                print("done", flush=True)
                return
            made = label(turn.scene.key, operator, labeled_at=datetime.now(timezone.utc))
            record.save(made)
            print(f"kept {made.id} {made.scene_key}", flush=True)
        print("rests", flush=True)
        signal.pause()  # with the record open, until it is killed


if __name__ == "__main__":  # starts a worker at every line that it reads: importing takes a second
    print("ready", flush=True)
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            work(*sys.argv[1:3], int(line))
            os._exit(0)
        print(f"started {child}", flush=True)
        os.waitpid(child, 0)
