"""The simulated scenes: how they are drawn, and an independent look at some (3-1, 3-3-1)."""

from __future__ import annotations

import json

import numpy as np

from boxgrasp.errors import MissingExtraError
from boxgrasp.execution import finish
from boxgrasp.simulate.physics import mujoco_depth, settles
from boxgrasp.study.intervals import share
from boxgrasp.study.report import Picture, Row, Section
from boxgrasp.study.study import Study
from boxgrasp.teaching.rows import RowConfig, scenario_of_row

_PART = 8


def scenes_section(study: Study) -> Section:
    """What stands is stable, and a second ray caster sees the same depth."""
    config = study.sets()["tested"].rows
    first = study.scale.first
    tasks = {
        f"physics/{k // _PART:05d}.json": (config, range(k, min(k + _PART, first)))
        for k in range(0, first, _PART)
    }
    rows, words = [], []
    try:
        finish(study.store, tasks, physics_part, study.workers, "physics")
        found = [item for name in tasks for item in json.loads(study.store.read(name))]
        stable = sum(item["stable"] for item in found)
        off = sum(item["off"] for item in found)
        pixels = sum(item["pixels"] for item in found)
        rows = [
            Row("scenes that stand still for a second", None, share(stable, len(found))),
            Row("farthest that anything moved, mm", None, _mm(found, "moved_m")),
            Row("pixels that differ by more than 1 mm", None, f"{off} of {pixels}"),
            Row("largest difference of the others, mm", None, _mm(found, "depth_m")),
        ]
    except MissingExtraError as error:
        words = [f"Not checked in MuJoCo: {error}."]
    counts = np.array([len(json.loads(str(s))["obstacles"]) for s in study.rows("tested")["scene"]])
    rows.append(Row("obstacles a scene, average", "at most 4", round(float(counts.mean()), 2)))
    return Section(
        key="scenes",
        title="The simulated scenes",
        place="sections 3-1 and 3-3-1",
        words=(
            "A table of 80 cm, the target near its middle along the base's axes, up to four "
            "obstacles in 50 x 50 cm round it, lamps 20 to 30 cm up. Objects have the thesis's "
            "dimensions; those of mug, lamps and bar, the camera's pose and that 0 to 4 obstacles "
            "are equally likely are ours. Scenes without a feasible grasp are drawn again, as the "
            "thesis assumes one. Depth has the noise of an Xtion.",
            f"The first {first} test scenes were checked in MuJoCo: what stands must stay, and its "
            "rays must meet what the ray caster's meet.",
            *words,
        ),
        rows=tuple(rows),
        pictures=_pictures(study),
    )


def physics_part(task: tuple[RowConfig, range]) -> bytes:
    """MuJoCo's word on some scenes, as JSON."""
    config, numbers = task
    found = []
    for number in numbers:
        scene = scenario_of_row(config, number).scene
        settled = settles(scene)
        depth, other = scene.view().depth, mujoco_depth(scene)
        differs = np.abs(depth - other)
        found.append(
            {
                "stable": settled.stable,
                "moved_m": settled.moved_m,
                "pixels": int(depth.size),
                "off": int((differs > 1e-3).sum()),
                "depth_m": float(differs[differs <= 1e-3].max(initial=0.0)),
            }
        )
    return json.dumps(found).encode()


def _mm(found: list[dict[str, float]], name: str) -> float:
    return round(1000 * max(item[name] for item in found), 3)


def _pictures(study: Study) -> tuple[Picture, ...]:
    """Some scenes as the camera sees them, eight in a picture."""
    import io

    from PIL import Image

    config = study.sets()["tested"].rows
    sheet = Image.new("RGB", (4 * 240, 2 * 180))
    for k in range(min(8, study.rows("tested").count)):
        view = scenario_of_row(config, k).scene.view(shading=0.4)
        sheet.paste(Image.fromarray(view.rgb).resize((240, 180)), (240 * (k % 4), 180 * (k // 4)))
    out = io.BytesIO()
    sheet.save(out, format="PNG", optimize=True)
    return (
        Picture(
            "scenes",
            "The first eight test scenes, one a target, as the camera sees them.",
            png=out.getvalue(),
            alt="Eight cluttered tables",
        ),
    )
