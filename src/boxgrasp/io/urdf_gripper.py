"""A gripper from a URDF: boxes from what its links collide with, the opening from the limits."""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass
from typing import Final

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.errors import GripperError
from boxgrasp.geometry.transforms import invert, make_transform, transform
from boxgrasp.grasps.gripper import Gripper, HandBox, Rows
from boxgrasp.io.hand_boxes import fit_boxes, slice_extents
from boxgrasp.io.urdf import Joint, UrdfFile

_SAME_M: Final = 0.002  # what counts as the same place on both sides: the bar for a hand's sizes
_STILL_M: Final = 0.001
_STEPS: Final = 41  # from open to shut, to find how far swinging fingertips reach
_MOST_MASTERS: Final = 4
_MOST_LINKAGE: Final = 3  # boxes a side of what moves behind the fingers
_DEPTH_M: Final = 0.02  # insertion at most: the pads of hands are longer, see grasps/hands
_CLEAR: Final = 0.9  # cosine of 26 degrees, from an axis of the palm to the fingertips


def gripper_from_urdf(
    path: str | os.PathLike[str],
    palm: str,
    fingers: tuple[str, str],
    *,
    flange: str | None = None,
    insertion_depth_m: float | None = None,
    visual: bool = False,
) -> Gripper:
    """The gripper of a URDF, its fingers as far apart as their joints let them.

    What hangs from the palm's link without a moving joint is the palm. A finger is all that moves
    with its link, as far as it stands outside of the opening; the rest of it, and all else that
    moves, is counted to the palm where it stands at full opening.

    Args:
        path: of the URDF.
        palm: name of the link that the fingers move against.
        fingers: names of both fingertips' links; the opening is what is free between all that
            passes the target's face with them.
        flange: name of a link fixed to the palm whose frame the arm's maker uses; None for the
            palm's own.
        insertion_depth_m: how far the fingertips pass the target's face, m; None for half of the
            fingertips' length, at most 2 cm.
        visual: take the links' visual geometry instead of what they collide with.

    Returns:
        The gripper, named as the robot of the URDF.

    Raises:
        GripperError: the URDF or a mesh cannot be read, a link is missing, the fingers do not move
            apart or not alike, or what results can hold nothing.
        MissingExtraError: yourdfpy or trimesh is not installed.
    """
    file = UrdfFile(path, visual=visual)
    for link in (palm, *fingers, *([flange] if flange else [])):
        file.validate_link(link)
    hand = _Links(file, palm, fingers)
    hand.open()
    axes = hand.axes()
    try:
        return _Sizes(hand, axes, insertion_depth_m).gripper(flange or palm)
    except GripperError as error:
        text = str(error)
        raise GripperError(text if text.startswith(str(file.path)) else f"{path}: {text}") from None


class _Links:
    """The links of a hand by what they move with, and where they stand."""

    def __init__(self, file: UrdfFile, palm: str, fingers: tuple[str, str]) -> None:
        self.file, self.palm, self.fingers = file, palm, fingers
        self.branches = {link: branch for link in file.links if (branch := self._branch(link))}
        for link in fingers:
            if self.branches.get(link, palm) == palm:
                raise self.fault(f"finger {link!r} does not move against {palm!r}; valid: it does")
        if self.branches[fingers[0]] == self.branches[fingers[1]]:
            raise self.fault(f"{fingers[0]!r} and {fingers[1]!r} move as one; valid: two fingers")
        self._surfaces = {link: file.triangles_m(link) for link in self.branches}
        for link in fingers:
            if not len(self._surfaces[link]):
                raise self.fault(f"finger {link!r} has no geometry; valid: collision or visual")

    def _branch(self, link: str) -> str | None:
        """Its first moving link below the palm, the palm for what is fixed to it, else None."""
        branch = self.palm
        if link == self.palm:
            return branch
        for joint in self.file.way_up(link):
            branch = joint.child if joint.moves else branch
            if joint.parent == self.palm:
                return branch
        return None

    def fault(self, text: str) -> GripperError:
        """An error with the file's name."""
        return GripperError(f"{self.file.path}: {text}")

    def surface_m(self, *links: str) -> Floats:
        """(N, 3, 3) triangles of links as they stand, palm's frame, m."""
        held = [transform(self.file.pose(link, self.palm), self._surfaces[link]) for link in links]
        return np.concatenate([np.zeros((0, 3, 3)), *held])

    def of_branch(self, branch: str) -> list[str]:
        """Links that move with one, or those fixed to the palm."""
        return [link for link, its in self.branches.items() if its == branch]

    def moving_joints(self, link: str) -> list[Joint]:
        """From the link up to the palm."""
        joints = itertools.takewhile(lambda j: j.child != self.palm, self.file.way_up(link))
        return [joint for joint in joints if joint.moves]

    def centers_m(self) -> Floats:
        """(2, 3) middles of both fingers' boxes, palm's frame, m."""
        boxes = [self.surface_m(link).reshape(-1, 3) for link in self.fingers]
        return np.array([(box.min(axis=0) + box.max(axis=0)) / 2 for box in boxes])

    def open(self) -> None:
        """Move the joints to those ends of their ranges that put the fingers farthest apart."""
        ranges = self._ranges()
        middle = {name: (low + high) / 2 for name, (low, high) in ranges.items()}
        self.file.set_joints(middle)
        self.at_middle_m = self.centers_m()
        apart = self.at_middle_m[0] - self.at_middle_m[1]
        best, farthest = middle, float(np.linalg.norm(apart))
        for ends in itertools.product(*ranges.values()):
            values = dict(zip(ranges, ends, strict=True))
            self.file.set_joints(values)
            centers = self.centers_m()
            between = centers[0] - centers[1]
            length = float(np.linalg.norm(between))
            if between @ apart > 0.0 and length > farthest + 1e-9:  # else they passed each other
                best, farthest = values, length
        self.file.set_joints(best)
        self.open_at = best
        self.shut_at = {name: sum(ranges[name]) - value for name, value in best.items()}

    def closing_advance_m(self, axes: Floats) -> float:
        """How much farther along the approach the fingertips get until they meet, m."""
        first, *reaches = (self._reach_m(axes, share) for share in np.linspace(0.0, 1.0, _STEPS))
        apart = itertools.takewhile(lambda reach: reach[1] > -_STILL_M, reaches)
        farthest = max((reach[0] for reach in apart), default=first[0])
        self.file.set_joints(self.open_at)
        return round(max(0.0, farthest - first[0]), 4)

    def _reach_m(self, axes: Floats, share: float) -> tuple[float, float]:
        """Foremost place of the fingertips and the gap between them, a share of the way shut."""
        between = {
            name: value + share * (self.shut_at[name] - value)
            for name, value in self.open_at.items()
        }
        self.file.set_joints(between)
        left, right = (self.surface_m(link).reshape(-1, 3) @ axes for link in self.fingers)
        gap = left[:, 1].min() - right[:, 1].max()
        return float(max(left[:, 0].max(), right[:, 0].max())), float(gap)

    def _ranges(self) -> dict[str, tuple[float, float]]:
        """Lowest and highest values of the joints that move the fingers, those that follow none."""
        named = {joint.name: joint for joint in self.file.joints.values()}
        moved = [joint for link in self.fingers for joint in self.moving_joints(link)]
        masters = list(dict.fromkeys(joint.master for joint in moved))
        ranges = {}
        for name in masters:
            joint = named.get(name)
            if joint is None or joint.range is None:
                raise self.fault(f"joint {name!r} of the fingers has no limits; valid: both")
            if joint.range[1] > joint.range[0]:
                ranges[name] = joint.range
        if not ranges:
            raise self.fault(f"joints {', '.join(masters)} have no range; valid: fingers that move")
        if len(ranges) > _MOST_MASTERS:
            raise self.fault(
                f"{len(ranges)} joints move the fingers ({', '.join(ranges)}); valid: up to "
                f"{_MOST_MASTERS}, the others follow them"
            )
        return ranges

    def axes(self) -> Floats:
        """(3, 3) the hand's axes in the palm's frame, as columns: approach, opening, the third."""
        centers = self.centers_m()
        moved = centers - self.at_middle_m
        way = moved[0] - moved[1]
        if np.linalg.norm(way) < _STILL_M:
            raise self.fault(f"{' and '.join(self.fingers)} do not move apart; valid: they do")
        opening = way / np.linalg.norm(way)
        apart = centers[0] - centers[1]
        uneven = max(
            float(np.linalg.norm(apart - (apart @ opening) * opening)),
            abs(float((moved[0] + moved[1]) @ opening)),
        )
        if uneven > _SAME_M:
            raise self.fault(
                f"{' and '.join(self.fingers)} differ by {1000 * uneven:.1f} mm in how they stand "
                f"or move; valid: alike to {1000 * _SAME_M:.0f} mm"
            )
        approach = self._approach(opening, centers.mean(axis=0))
        return np.stack((approach, opening, np.cross(approach, opening)), axis=1)

    def _approach(self, opening: Floats, tips_m: Floats) -> Floats:
        """(3,) from the palm to the fingertips: square to the hinges, or along the palm's axes."""
        palm = self.surface_m(*self.of_branch(self.palm)).reshape(-1, 3)
        start = (palm.min(axis=0) + palm.max(axis=0)) / 2 if len(palm) else np.zeros(3)
        ahead = tips_m - start
        ahead -= (ahead @ opening) * opening
        ahead /= max(float(np.linalg.norm(ahead)), 1e-9)
        hinges = [j for j in self.moving_joints(self.fingers[0]) if j.kind != "prismatic"]
        if hinges:
            axis = self.file.pose(hinges[0].child, self.palm)[:3, :3] @ hinges[0].axis
            choices = [np.cross(opening, axis)]
        else:
            choices = [row - (row @ opening) * opening for row in np.eye(3)]
        lengths = [float(np.linalg.norm(choice)) for choice in choices]
        near = [
            choice / length * np.sign(choice @ ahead)
            for choice, length in zip(choices, lengths, strict=True)
            if length > _CLEAR
        ]
        best = max(near, key=lambda choice: float(choice @ ahead), default=np.zeros(3))
        if best @ ahead < (0.5 if hinges else _CLEAR):
            raise self.fault(
                f"the fingertips lie along no axis of {self.palm!r}; valid: a palm that faces them"
            )
        return np.asarray(best)


@dataclass(frozen=True, eq=False)
class _Frame:
    """The hand's axes: where they begin in the palm's frame."""

    T_palm_hand: Floats

    def of(self, triangles_m: Floats) -> Floats:
        """(N, 3, 3) triangles of the palm's frame in the hand's."""
        return transform(invert(self.T_palm_hand), triangles_m)


class _Sizes:
    """A hand's boxes and lengths in its own axes."""

    def __init__(self, hand: _Links, axes: Floats, insertion_depth_m: float | None) -> None:
        self.hand = hand
        self.advance_m = hand.closing_advance_m(axes)
        turned = _Frame(make_transform(axes, np.zeros(3)))
        tips = [turned.of(hand.surface_m(link)).reshape(-1, 3) for link in hand.fingers]
        inner = tips[0][:, 1].min(), tips[1][:, 1].max()
        if inner[0] <= inner[1]:
            raise hand.fault(f"{' and '.join(hand.fingers)} overlap when open; valid: a free gap")
        palm = turned.of(hand.surface_m(*hand.of_branch(hand.palm))).reshape(-1, 3)
        behind = min(0.0, float(palm[:, 0].min())) if len(palm) else 0.0
        heights = np.concatenate(tips)[:, 2]
        middle = round(float(heights.min() + heights.max()) / 2, 4)
        start = axes @ (behind, float(inner[0] + inner[1]) / 2, middle)
        self.frame = _Frame(make_transform(axes, start))
        self._refuse_uneven()
        sides = zip(hand.fingers, (1.0, -1.0), strict=True)
        self.moved = np.concatenate([self._side_extents(link, side) for link, side in sides])
        reach = np.concatenate(tips)[:, 0]
        half = round(min(_DEPTH_M, float(np.ptp(reach)) / 2), 4)
        self.depth_m = half if insertion_depth_m is None else insertion_depth_m
        passing = self.moved[:, 1] > reach.max() - behind - self.depth_m - _STILL_M
        self.opening_m = 2 * float(self.moved[passing, 2].min())

    def _refuse_uneven(self) -> None:
        """Both fingers reach as far to their side and to the front."""
        reach = []
        for link, side in zip(self.hand.fingers, (1.0, -1.0), strict=True):
            points = self._side(link, side).reshape(-1, 3)
            reach.append(points.max(axis=0)[:2])
        uneven = float(np.abs(reach[0] - reach[1]).max())
        if uneven > _SAME_M:
            raise self.hand.fault(
                f"{' and '.join(self.hand.fingers)} reach {1000 * uneven:.1f} mm differently; "
                f"valid: alike to {1000 * _SAME_M:.0f} mm"
            )

    def _side(self, link: str, side: float) -> Floats:
        """(N, 3, 3) all that moves with a finger, that at -y mirrored to +y."""
        links = self.hand.of_branch(self.hand.branches[link])
        return np.asarray(self.frame.of(self.hand.surface_m(*links)) * (1.0, side, 1.0))

    def _side_extents(self, link: str, side: float) -> Floats:
        """(S, 6) extents of each link that moves with a finger, that at -y mirrored to +y."""
        own = self.hand.of_branch(self.hand.branches[link])
        rows = [slice_extents(self.frame.of(self.hand.surface_m(name))) for name in own]
        held = np.concatenate(rows)
        return held if side > 0.0 else _mirrored(held)

    def _boxes(self) -> tuple[tuple[HandBox, ...], tuple[HandBox, ...]]:
        """Boxes of the palm and of the finger at +y."""
        hand, frame, moved = self.hand, self.frame, self.moved
        fixed = slice_extents(frame.of(hand.surface_m(*hand.of_branch(hand.palm))))
        outside = moved[:, 2] >= self.opening_m / 2 - _STILL_M / 10
        rest = [moved[~outside], *self._others()]
        linkage = np.concatenate(rest)
        crossing = linkage[:, 2] < 0.0
        across = linkage[crossing]
        palm = fit_boxes(_ahead(np.concatenate((fixed, across, _mirrored(across)))))
        finger = fit_boxes(_not_within(_ahead(moved[outside]), palm))
        behind = _not_within(_ahead(linkage[~crossing]), (*palm, *finger))
        for box in fit_boxes(behind, _MOST_LINKAGE):
            palm = (*palm, box, HandBox(box.x_m, (-box.y_m[1], -box.y_m[0]), box.z_m))
        return palm, finger

    def _others(self) -> list[Floats]:
        """(S, 6) extents of what moves with neither finger, that at -y mirrored to +y."""
        own = {self.hand.branches[link] for link in self.hand.fingers} | {self.hand.palm}
        found = []
        for link, branch in self.hand.branches.items():
            if branch not in own:
                rows = slice_extents(self.frame.of(self.hand.surface_m(link)))
                found.append(np.where(rows[:, 3:4] <= 0.0, _mirrored(rows), rows))
        return found

    def gripper(self, flange: str) -> Gripper:
        """The gripper of these sizes."""
        palm, finger = self._boxes()
        if not finger:
            raise self.hand.fault("no part of the fingers stands beside the opening; valid: some")
        boxes = (*palm, *finger)
        length = max(box.x_m[1] for box in boxes)
        T = np.array(self.frame.T_palm_hand)
        T[:3, 3] = transform(T, np.array([(length / 2, 0.0, 0.0)]))[0]
        return Gripper(
            name=self.hand.file.name,
            length_m=length,
            width_m=2 * max(abs(y) for box in boxes for y in box.y_m),
            thickness_m=2 * max(abs(z) for box in boxes for z in box.z_m),
            max_opening_m=round(self.opening_m, 5),
            insertion_depth_m=self.depth_m,
            closing_advance_m=self.advance_m,
            palm=palm,
            finger=finger,
            T_flange_gripper=_rows(self._from_flange(flange) @ T),
        )

    def _from_flange(self, flange: str) -> Floats:
        """(4, 4) T_flange_palm of a link that is fixed to the palm, on either side of it."""
        file, palm = self.hand.file, self.hand.palm
        for low, high in ((palm, flange), (flange, palm)):
            fixed = [low]
            for joint in file.way_up(low):
                if joint.moves:
                    break
                fixed.append(joint.parent)
            if high in fixed:
                return file.pose(palm, flange)
        raise self.hand.fault(f"{flange!r} is not fixed to {palm!r}; valid: a flange that is")


def _ahead(rows: Floats) -> Floats:
    """Extents in front of the hand's origin."""
    held = np.array(rows[rows[:, 1] > 0.0])
    held[:, 0] = np.maximum(held[:, 0], 0.0)
    return held


def _mirrored(rows: Floats) -> Floats:
    return rows[:, (0, 1, 3, 2, 4, 5)] * (1.0, 1.0, -1.0, -1.0, 1.0, 1.0)


def _not_within(rows: Floats, boxes: tuple[HandBox, ...]) -> Floats:
    """Extents that no box holds."""
    free = np.ones(len(rows), bool)
    for box in boxes:
        low = np.array((box.x_m[0], box.y_m[0], box.z_m[0])) - _STILL_M
        high = np.array((box.x_m[1], box.y_m[1], box.z_m[1])) + _STILL_M
        free &= ~((rows[:, ::2] >= low) & (rows[:, 1::2] <= high)).all(axis=1)
    return np.asarray(rows[free])


def _rows(T: Floats) -> Rows:
    """A transform as a gripper holds it, its axes square to the last digit that is written."""
    rows = [tuple(round(float(value), 9) + 0.0 for value in row) for row in T]
    return (rows[0], rows[1], rows[2], rows[3])  # type: ignore[return-value]
