"""Every stage of an answer as RViz shows it (thesis figure C-1), a namespace each."""

from __future__ import annotations

import textwrap
from typing import Final

import numpy as np
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from boxgrasp.arrays import Floats
from boxgrasp.draw.palette import (
    BLOCKED,
    CATEGORY,
    FAINT,
    GRIPPER,
    HELD,
    OBSTACLE,
    RGB,
    RULE,
    WHITE,
)
from boxgrasp.draw.shapes import EDGES, Hand, contact_line, corners, face_point, fingers
from boxgrasp.draw.words import headline_of, look_of, visible_clearance
from boxgrasp.geometry.transforms import make_transform, transform
from boxgrasp.grasps.candidates import TOP_PERPENDICULAR
from boxgrasp.grasps.checks.check import measured
from boxgrasp.mapping.local_map import FREE, OCCUPIED, UNSEEN, LocalMap
from boxgrasp.ranking.sampling import RESOLUTION_M, sampling
from boxgrasp.result import Candidate, Selection, TargetBox
from boxgrasp.selector import SceneAnalysis
from boxgrasp_ros.marker_sheet import MarkerSheet, dashed
from boxgrasp_ros.seen import NO_NUMBER, Thing, surfaces, target_number, things

NAMESPACES: Final = (
    "table", "objects", "target_box", "lines", "samples", "candidates", "gripper", "clearance",
    "headline",
)  # fmt: skip

# Muted, so that obstacles stay behind what the answer says; neighbors differ.
_THINGS: Final[tuple[RGB, ...]] = (
    (139, 158, 178), (178, 158, 139), (150, 170, 150), (168, 150, 172), (172, 172, 148),
)  # fmt: skip
_MOST_DOTS: Final = 2000  # of all obstacles: a message each
_DOT_M: Final = 0.006
_SIZES: Final = {FREE: 0.004, UNSEEN: 0.010, OCCUPIED: 0.014}  # m, of samples
_COLORS: Final = {FREE: HELD, UNSEEN: RULE, OCCUPIED: OBSTACLE}
_ALPHAS: Final = {FREE: 0.5, UNSEEN: 0.35, OCCUPIED: 0.9}
_ARROW_M: Final = 0.05  # a candidate's arrow
_LONGER_M: Final = 0.085  # of the second top face, which crosses the first
_LABEL_M: Final = 0.012  # from its tail to its label
_WRAP: Final = 56  # letters a line
_HEADLINE_M: Final = 0.024  # height of its letters
_OVER_M: Final = 0.11  # the headline, over all that is near
_NEAR_M: Final = 0.30
_FAR_M: Final = 0.12  # from where the nearest obstacle is not worth a line


def marker_array(analysis: SceneAnalysis, selection: Selection, header: Header) -> MarkerArray:
    """An answer with all that it rests on.

    Args:
        analysis: of the view.
        selection: the answer that was chosen from it.
        header: stamp of the view, and the frame of every place: the base.

    Returns:
        Markers that replace those of the answer before.
    """
    sheet = MarkerSheet(header)
    _table(sheet, analysis)
    _objects(sheet, analysis)
    _target_box(sheet, selection)
    _lines(sheet, selection)
    _samples(sheet, analysis, selection)
    _candidates(sheet, selection)
    _gripper(sheet, selection)
    _clearance(sheet, selection)
    _headline(sheet, analysis, selection)
    return sheet.array()


def failed_markers(header: Header, sentence: str) -> MarkerArray:
    """What is shown where there is no answer.

    Args:
        header: stamp of the view, and the base frame.
        sentence: why.

    Returns:
        Markers that replace those of the answer before.
    """
    sheet = MarkerSheet(header)
    words = "\n".join(_wrapped(sentence)) or "no answer"
    sheet.text(("headline", 0), words, (0.5, 0.0, 0.3), BLOCKED, 0.03)
    return sheet.array()


def _table(sheet: MarkerSheet, analysis: SceneAnalysis) -> None:
    """The surfaces where they were seen: the target's own is 0 and 1."""
    for number, surface in enumerate(surfaces(analysis)):
        rim = surface.outline_base_m
        sheet.polygon(("table", 2 * number), rim, RULE, 0.18)
        sheet.outline(("table", 2 * number + 1), rim, (RULE, 0.8, 0.004))


def _objects(sheet: MarkerSheet, analysis: SceneAnalysis) -> None:
    """Some points of each obstacle, with its number over it."""
    found, target = things(analysis), target_number(analysis)
    count = sum(len(thing.points) for thing in found)
    step = max(1, -(-count // _MOST_DOTS))
    for thing in found:
        color = FAINT if thing.number == NO_NUMBER else _THINGS[thing.number % len(_THINGS)]
        sheet.dots(("objects", 2 * thing.number), thing.points[::step], color, _DOT_M)
        if thing.number not in (NO_NUMBER, target):
            words = str(thing.number)
            sheet.text(("objects", 2 * thing.number + 1), words, _over(thing), WHITE, 0.025)


def _over(thing: Thing) -> Floats:
    """(3,) a place over the middle of a thing."""
    low, high = thing.points.min(axis=0), thing.points.max(axis=0)
    middle = (low + high).astype(np.float64) / 2
    return np.array([middle[0], middle[1], float(high[2]) + 0.025])


def _target_box(sheet: MarkerSheet, selection: Selection) -> None:
    """The box; edges along a dimension of which only a bound was seen are thin and dashed."""
    box = selection.box
    sheet.box(("target_box", 0), box.T_base_box, box.dimensions_m, WHITE, 0.22)
    places = corners(box.T_base_box, box.dimensions_m)
    known = _known(box)
    seen: list[Floats] = []
    hidden: list[Floats] = []
    for a, b in EDGES:
        stroke = places[[a, b]]
        if known[{4: 0, 2: 1, 1: 2}[a ^ b]]:  # corners count z, then y, then x
            seen.append(stroke)
        else:
            hidden += dashed(stroke)
    sheet.lines(("target_box", 1), seen, (WHITE, 1.0, 0.003))
    sheet.lines(("target_box", 2), hidden, (WHITE, 0.9, 0.0015))


def _known(box: TargetBox) -> list[bool]:
    """Whether each of a box's dimensions is more than a lower bound."""
    known: list[bool] = (box.dimensions_at_most_m <= box.dimensions_m).tolist()
    return known


def _lines(sheet: MarkerSheet, selection: Selection) -> None:
    """Where the fingers close on the faces; the shown candidate's line is thicker."""
    shown = selection.shown
    others = [candidate for candidate in selection.candidates if candidate is not shown]
    strokes = [contact_line(candidate, selection.box) for candidate in others]
    colors = [_color_of(candidate) for candidate in others]
    sheet.lines(("lines", 0), strokes, (WHITE, 0.9, 0.002), colors)
    if shown is not None:
        line = contact_line(shown, selection.box)
        sheet.lines(("lines", 1), [line], (_color_of(shown), 1.0, 0.005))


def _color_of(candidate: Candidate) -> RGB:
    """Its clearance's color; gray where that is enough and another check fails."""
    color = look_of(candidate).color
    return color if candidate.passed or color == CATEGORY["red"] else FAINT


def _samples(sheet: MarkerSheet, analysis: SceneAnalysis, selection: Selection) -> None:
    """What the local map says at the places that the ranker samples, or at the grid's."""
    name = selection.ranker.rpartition("-")[2]
    name = name if name in RESOLUTION_M else "grid"
    local_map = _map_of(analysis, RESOLUTION_M[name])
    points = sampling(name)
    values = local_map.values_at(points)
    places = transform(local_map.T_base_map, points)
    for state in (FREE, UNSEEN, OCCUPIED):
        held = places[values == state / 2]
        key = ("samples", state)
        sheet.balls(key, held, _COLORS[state], _SIZES[state], alpha=_ALPHAS[state])


def _map_of(analysis: SceneAnalysis, resolution_m: float) -> LocalMap:
    """The local map of a cell size, or the one that is nearest to it."""
    maps = analysis.context.local_maps
    return maps[min(maps, key=lambda size: abs(size - resolution_m))]


def _candidates(sheet: MarkerSheet, selection: Selection) -> None:
    """An arrow to each candidate's line with its label; one that fails is thin."""
    for candidate in selection.candidates:
        if candidate is selection.shown:
            continue  # the gripper stands there
        ends = _way_to(candidate, selection.box)
        width_m, alpha = (0.006, 1.0) if candidate.passed else (0.003, 0.6)
        key = ("candidates", 2 * candidate.label)
        sheet.arrow(key, ends, _color_of(candidate), width_m, alpha=alpha)
        label = str(candidate.label)
        place = ends[0] - _LABEL_M * candidate.T_base_gripper[:3, 0]
        sheet.text(("candidates", 2 * candidate.label + 1), label, place, height_m=0.014)


def _way_to(candidate: Candidate, box: TargetBox) -> Floats:
    """(2, 3) tail and tip of a candidate's arrow."""
    approach, opening = candidate.T_base_gripper[:3, 0], candidate.T_base_gripper[:3, 1]
    tip = face_point(candidate, box)
    if approach[2] < -0.7:  # both top faces share their middle: step aside along the line
        tip = tip - opening * candidate.width_m * 0.5
    length_m = _LONGER_M if candidate.face == TOP_PERPENDICULAR else _ARROW_M
    return np.array((tip - length_m * approach, tip))


def _gripper(sheet: MarkerSheet, selection: Selection) -> None:
    """The hand where it closes and where its approach starts; in an ask the nearest, as a warning.

    Its box is 0, edges 1, fingers 2 and 3, pregrasp 4, way in 5, name 6; of each further box of a
    hand the box, its edges and the pregrasp's follow from 10 on.
    """
    hand = _hand(selection)
    if hand is None:
        return
    asks, T = selection.grasp is None, hand.T_base_gripper
    color = BLOCKED if asks else GRIPPER
    for k, solid in enumerate(hand.solids(T)):
        place, size_m = _solid(solid, T)
        sheet.box(("gripper", 7 + 3 * k if k else 0), place, size_m, color, 0.15 if asks else 0.25)
        edge = (color, 1.0, 0.002 if asks else 0.003)
        sheet.edges(("gripper", 8 + 3 * k if k else 1), place, size_m, edge)
    if not hand.gripper.palm:
        for number, finger in enumerate(fingers(T, hand.gripper), start=2):
            sheet.box(("gripper", number), *_solid(finger, T), color, 0.4 if asks else 0.9)
    back = hand.gripper.length_m / 2
    if hand.T_base_pregrasp is not None:
        for k, solid in enumerate(hand.solids(hand.T_base_pregrasp)):
            place, size_m = _solid(solid, hand.T_base_pregrasp)
            sheet.edges(("gripper", 9 + 3 * k if k else 4), place, size_m, (color, 0.45, 0.0015))
    if hand.approach_m > 0:
        ends = np.array([[-back - hand.approach_m, 0.0, 0.0], [-back, 0.0, 0.0]])
        sheet.arrow(("gripper", 5), transform(T, ends), color, 0.010)
    shown = selection.shown
    if shown is not None:
        beside = transform(T, np.array([[-back, 0.03, 0.0]]))[0] + (0.0, 0.0, 0.03)
        name = f"nearest: {shown.label}, rejected" if asks else str(shown.label)
        sheet.text(("gripper", 6), name, beside, color if asks else WHITE)


def _hand(selection: Selection) -> Hand | None:
    """The hand at the candidate that is shown."""
    if selection.grasp is not None:
        start, T = selection.grasp.T_base_pregrasp, selection.grasp.T_base_gripper
        return Hand(selection.gripper, T, start)
    shown = selection.shown
    return None if shown is None else Hand(selection.gripper, shown.T_base_gripper)


def _solid(places: Floats, T: Floats) -> tuple[Floats, Floats]:
    """Pose and size of a box by its corners, turned as T."""
    size_m = np.linalg.norm(places[[4, 2, 1]] - places[0], axis=1)
    return make_transform(T[:3, :3], places.mean(axis=0)), size_m


def _clearance(sheet: MarkerSheet, selection: Selection) -> None:
    """From the hand to the visible obstacle that is nearest, with the distance."""
    hand, shown = _hand(selection), selection.shown
    said = None if shown is None else visible_clearance(shown)
    if hand is None or said is None or said.nearest_point_m is None or said.value > _FAR_M:
        return
    obstacle = np.array(said.nearest_point_m)
    stroke = np.array((hand.nearest(obstacle), obstacle))
    color = CATEGORY["red"] if not said.passed else WHITE
    sheet.balls(("clearance", 0), obstacle[None], color, 0.012)
    if np.linalg.norm(stroke[1] - stroke[0]) > 0:
        sheet.lines(("clearance", 1), [stroke], (color, 1.0, 0.003))
    sheet.text(("clearance", 2), measured(said.value, said.unit), obstacle + (0.0, 0.0, 0.02))


def _headline(sheet: MarkerSheet, analysis: SceneAnalysis, selection: Selection) -> None:
    """The answer in words, over all that is near the target."""
    status, sentence = headline_of(selection)
    sides = zip(selection.box.dimensions_m.tolist(), _known(selection.box), strict=True)
    told = " x ".join(f"{'' if known else '>='}{100 * side:.1f}" for side, known in sides)
    number = target_number(analysis)
    name = "target" if number == NO_NUMBER else f"target {number}"
    rows = (status, *_wrapped(sentence), f"{name}: {told} cm")
    place = selection.box.T_base_box[:3, 3].copy()
    place[2] = _highest(analysis, selection) + _OVER_M + _HEADLINE_M * len(rows) / 2
    color = BLOCKED if selection.grasp is None else WHITE
    sheet.text(("headline", 0), "\n".join(rows), place, color, _HEADLINE_M)


def _wrapped(sentence: str) -> list[str]:
    return textwrap.wrap(sentence, _WRAP, break_on_hyphens=False)


def _highest(analysis: SceneAnalysis, selection: Selection) -> float:
    """How high reach the target, the hand and what is near, base frame, m."""
    box, hand = selection.box, _hand(selection)
    points = analysis.scene.points
    away = np.linalg.norm(points[:, :2] - box.T_base_box[:2, 3].astype(np.float32), axis=1)
    near = points[away < _NEAR_M, 2]
    solids = [corners(box.T_base_box, box.dimensions_m)]
    if hand is not None:
        back = make_transform(np.eye(3), (-hand.approach_m, 0.0, 0.0))
        solids += [corners(hand.T_base_gripper @ T, hand.size_m) for T in (np.eye(4), back)]
    return float(max(np.vstack(solids)[:, 2].max(), near.max(initial=-np.inf)))
