"""The simulated scenes: how they are drawn, and an independent look at some (3-1, 3-3-1)."""

from __future__ import annotations

import io
import json
from typing import Any

import numpy as np

from boxgrasp.errors import MissingExtraError
from boxgrasp.execution import finish
from boxgrasp.simulate.physics import mujoco_depth, settles
from boxgrasp.study.evaluation import obstacle_counts
from boxgrasp.study.intervals import share
from boxgrasp.study.report import Picture, Row, Section
from boxgrasp.study.study import Study
from boxgrasp.teaching.rows import RowConfig, scenario_of_row

_PART = 8
_SAME_DEPTH_M = 1e-3
_TILE_PX = (240, 180)


def scenes_section(study: Study) -> Section:
    """What stands is stable, and a second ray caster sees the same depth.

    Args:
        study: whose test scenes they are.

    Returns:
        The section.

    Raises:
        StoreError: the study's place cannot be read or written.
    """
    rows, words = _physics_rows(study)
    average = round(float(obstacle_counts(study.rows("tested")).mean()), 2)
    return Section(
        key="scenes",
        title="The simulated scenes",
        place="sections 3-1 and 3-3-1",
        words=(
            "A table of 80 cm, the target near its middle along the base's axes, one to four "
            "obstacles in 50 x 50 cm round it, lamps 20 to 30 cm up. Objects have the thesis's "
            "dimensions; those of mug, lamps and bar, the camera's pose and that 1 to 4 obstacles "
            "are equally likely are ours. Scenes without a feasible grasp are drawn again, as the "
            "thesis assumes one. Depth has no noise: the thesis tells of it "
            "for the real camera alone (3-5-2).",
            f"The first {study.scale.first} test scenes were checked in MuJoCo: what stands must "
            "stay, and its rays must meet what the ray caster's meet.",
            *words,
        ),
        rows=(*rows, Row("obstacles a scene, average", "at most 4", average)),
        pictures=(_picture(study),),
    )


def _physics_rows(study: Study) -> tuple[list[Row], tuple[str, ...]]:
    """What MuJoCo says of the first scenes; or why it says nothing."""
    config, first = study.sets()["tested"].rows, study.scale.first
    tasks = {
        f"physics/{k // _PART:05d}.json": (config, range(k, min(k + _PART, first)))
        for k in range(0, first, _PART)
    }
    try:
        finish(study.store, tasks, physics_part, study.workers, "physics")
    except MissingExtraError as error:
        return [], (f"Not checked in MuJoCo: {error}.",)
    found = [item for name in tasks for item in json.loads(study.store.read(name))]
    stable = sum(item["stable"] for item in found)
    off, pixels = (sum(item[name] for item in found) for name in ("off", "pixels"))
    return [
        Row("scenes that stand still for a second", None, share(stable, len(found))),
        Row("farthest that anything moved, mm", None, _most_mm(found, "moved_m")),
        Row("pixels that differ by more than 1 mm", None, f"{off} of {pixels}"),
        Row("largest difference of the others, mm", None, _most_mm(found, "depth_m")),
    ], ()


def physics_part(task: tuple[RowConfig, range]) -> bytes:
    """What MuJoCo says of some scenes; a task of its own.

    Args:
        task: how rows are made, and the scenes' numbers.

    Returns:
        JSON.

    Raises:
        MissingExtraError: MuJoCo is not installed.
    """
    config, numbers = task
    return json.dumps([_physics_of(config, number) for number in numbers]).encode()


def _physics_of(config: RowConfig, number: int) -> dict[str, Any]:
    scene = scenario_of_row(config, number).scene
    settled = settles(scene)
    depth, other = scene.view().depth, mujoco_depth(scene)
    differs = np.abs(depth - other)
    return {
        "stable": settled.stable,
        "moved_m": settled.moved_m,
        "pixels": int(depth.size),
        "off": int((differs > _SAME_DEPTH_M).sum()),
        "depth_m": float(differs[differs <= _SAME_DEPTH_M].max(initial=0.0)),
    }


def _most_mm(found: list[dict[str, Any]], name: str) -> float:
    return round(1000 * max(float(item[name]) for item in found), 3)


def _picture(study: Study) -> Picture:
    """Some scenes as the camera sees them, eight in a picture."""
    from PIL import Image

    config = study.sets()["tested"].rows
    width, height = _TILE_PX
    sheet = Image.new("RGB", (4 * width, 2 * height))
    for k in range(min(8, study.rows("tested").count)):
        view = scenario_of_row(config, k).scene.view(shading=0.4)
        tile = Image.fromarray(view.rgb).resize(_TILE_PX)
        sheet.paste(tile, (width * (k % 4), height * (k // 4)))
    out = io.BytesIO()
    sheet.save(out, format="PNG", optimize=True)
    return Picture(
        "scenes",
        "The first eight test scenes, one a target, as the camera sees them.",
        png=out.getvalue(),
        alt="Eight cluttered tables",
    )
