"""Real depth captures with their noise resampled: decisions that change, and pictures (5-2-4)."""

from __future__ import annotations

import hashlib
import io
import json
import re
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from boxgrasp.draw import draw_selection
from boxgrasp.errors import BoxgraspError
from boxgrasp.io import load_capture
from boxgrasp.perception.target import Target
from boxgrasp.ranking.model_set import SVMS
from boxgrasp.selector import GraspSelector
from boxgrasp.sensing.capture import Capture
from boxgrasp.simulate.noise import NoiseModel, axial_sigma
from boxgrasp.study.report import Picture, Row, Section, Table
from boxgrasp.study.sections.need import CASCADE
from boxgrasp.study.study import Study

MOST_TARGETS = 4
PICTURE_PX = 1100
KINDS = ("bare", "checked")


@dataclass(frozen=True)
class _Resampling:
    """How a capture's noise is drawn anew, and who answers."""

    selectors: Mapping[str, GraspSelector]
    runs: int
    seed: int


def captures_section(study: Study, folder: Path) -> Section:
    """Every depth capture of a folder, decided by the study's cascade grid.

    Args:
        study: whose models decide, and where decisions are kept.
        folder: of captures.

    Returns:
        The section.

    Raises:
        StoreError: the study's place cannot be read or written.
    """
    lines, pictures, skipped = [], [], []
    changed = dict.fromkeys(KINDS, 0)
    for path in _paths(folder):
        key, found = _decided(study, path)
        if "skipped" in found:
            skipped.append(f"{path.stem}: {found['skipped']}")
            continue
        for item in found["targets"]:
            lines.append((path.stem, item["target"], *(item[kind] for kind in KINDS)))
            for kind in KINDS:
                changed[kind] += item[f"{kind}_changes"]
        pictures.append(_picture(study, path, key, found["targets"][0]["target"]))
    return Section(
        key="captures",
        title="Real captures, their noise resampled",
        place="section 5-2-4",
        words=(
            "Real depth images; to each, axial noise of such a sensor is added anew ten times. "
            "Nobody measured the truth of these scenes, so decisions are counted, not scored.",
            *(f"Left out: {'; '.join(skipped)}." for _ in range(bool(skipped))),
        ),
        rows=tuple(
            Row(
                f"targets whose decision changes, cascade grid, {kind}",
                "2 of 42" if kind == "bare" else None,
                f"{count} of {len(lines)}",
            )
            for kind, count in changed.items()
        ),
        tables=(Table("Decisions in ten runs", ("capture", "target", *KINDS), tuple(lines)),),
        pictures=tuple(pictures),
    )


def _paths(folder: Path) -> list[Path]:
    found = (p for p in folder.iterdir() if p.is_dir() or p.suffix in (".npz", ".pcd", ".ply"))
    return sorted(found)


def _decided(study: Study, path: Path) -> tuple[str, dict[str, Any]]:
    """A capture's key, and its decisions, made where they are not kept yet."""
    key = f"{re.sub('[^A-Za-z0-9._-]', '-', path.stem)}-{_digest(path)}"
    name = f"captures/{key}"
    if not study.store.exists(f"{name}.json"):
        picture, found = _judge(path, _Resampling(_selectors(study), study.scale.runs, study.seed))
        if picture:
            study.store.write(f"{name}.png", picture)
        study.store.write(f"{name}.json", json.dumps(found).encode())
    return key, json.loads(study.store.read(f"{name}.json"))


def _digest(path: Path) -> str:
    """Eight hexadecimal digits of what is in a file, or in the files of a folder."""
    files = sorted(p for p in path.iterdir() if p.is_file()) if path.is_dir() else [path]
    found = hashlib.sha256()
    for file in files:
        found.update(file.name.encode() + file.read_bytes())
    return found.hexdigest()[:8]


def _selectors(study: Study) -> dict[str, GraspSelector]:
    """Cascade grid, bare and checked, with the study's models; a URL's are copied here first."""
    with tempfile.TemporaryDirectory() as folder:
        for svm in SVMS:
            name = f"{svm.name}.onnx"
            (Path(folder) / name).write_bytes(study.store.read(f"models/{name}"))
        config = {"ranker": CASCADE, "models": folder}
        return {
            "bare": GraspSelector(
                {**config, "unchecked": True, "candidates": {"refine": "none"}}  # the thesis
            ),
            "checked": GraspSelector(config),
        }


def _judge(path: Path, resampling: _Resampling) -> tuple[bytes | None, dict[str, object]]:
    try:
        capture = load_capture(path)
        if capture.depth is None:
            return None, {"skipped": "a cloud, without an image's noise"}
        checked = resampling.selectors["checked"]
        targets = _targets(capture, checked)
        if not targets:
            return None, {"skipped": "no target"}
        items = [_decisions(capture, target, resampling) for target in targets]
        picture = _drawn(capture, checked, targets[0])
    except BoxgraspError as error:
        return None, {"skipped": str(error)}
    return picture, {"targets": items}


def _targets(capture: Capture, selector: GraspSelector) -> Sequence[Target | None]:
    if capture.mask is not None or capture.target_pixel is not None:
        return [None]
    pixels = [item.pixel for item in selector.objects(capture)[:MOST_TARGETS]]
    return [Target(pixel=pixel) for pixel in pixels if pixel is not None]


def _decisions(
    capture: Capture, target: Target | None, resampling: _Resampling
) -> dict[str, object]:
    item: dict[str, object] = {
        "target": "its own target" if target is None else f"pixel {target.pixel}"
    }
    for kind, selector in resampling.selectors.items():
        said = Counter(
            _decision(selector, _again(capture, resampling.seed, run), target)
            for run in range(resampling.runs)
        )
        item[kind] = "; ".join(f"{name} ({count})" for name, count in said.most_common())
        item[f"{kind}_changes"] = int(len(said) > 1)
    return item


def _decision(selector: GraspSelector, capture: Capture, target: Target | None) -> str:
    try:
        grasp = selector.select(capture, target).grasp
    except BoxgraspError:
        return "no target found"
    return "asks" if grasp is None else f"candidate {grasp.label}"


def _again(capture: Capture, seed: int, run: int) -> Capture:
    """The capture with axial noise added anew; what is missing stays missing."""
    assert capture.depth is not None
    rng = np.random.default_rng((seed, run))
    draws = rng.standard_normal(capture.depth.shape, dtype=np.float32)
    noisy = capture.depth + draws * axial_sigma(capture.depth, NoiseModel())
    return Capture(
        np.where(capture.depth > 0, np.maximum(noisy, 1e-3), 0.0).astype(np.float32),
        capture.intrinsics,
        capture.T_base_camera,
        capture.rgb,
        capture.mask,
        target_pixel=capture.target_pixel,
    )


def _drawn(capture: Capture, selector: GraspSelector, target: Target | None) -> bytes:
    """The answer to a capture as a small PNG."""
    image = draw_selection(capture, selector.select(capture, target))
    image.thumbnail((PICTURE_PX, PICTURE_PX))
    out = io.BytesIO()
    image.convert("RGB").quantize(128).save(out, format="PNG", optimize=True)
    return out.getvalue()


def _picture(study: Study, path: Path, key: str, target: str) -> Picture:
    return Picture(
        f"capture-{key}",
        f"{path.stem}: cascade grid, checked, {target}.",
        png=study.store.read(f"captures/{key}.png"),
        alt=f"Chosen grasp on the real capture {path.stem}",
    )
