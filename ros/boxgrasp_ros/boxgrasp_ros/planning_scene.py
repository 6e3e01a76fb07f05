"""What was seen as collision objects for MoveIt, where its messages are installed."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np
from geometry_msgs.msg import Pose
from std_msgs.msg import Header

from boxgrasp.arrays import Floats
from boxgrasp.geometry.transforms import make_transform, transform
from boxgrasp.perception.box_fit import BoxConfig, fit_box
from boxgrasp.result import Selection
from boxgrasp.selector import SceneAnalysis
from boxgrasp_ros.replies import pose_message
from boxgrasp_ros.seen import NO_NUMBER, Surface, surfaces, target_number, things

try:
    from moveit_msgs.msg import CollisionObject
    from shape_msgs.msg import SolidPrimitive
except ImportError:  # a robot without MoveIt
    AVAILABLE = False
else:
    AVAILABLE = True

TABLE = "boxgrasp_table"
TARGET = "boxgrasp_target"
OBJECT = "boxgrasp_object_"

# An obstacle's sparse parts are in the way too; a point or two a side may be stray.
_FIT = BoxConfig(slab_share=0.0)
_TABLE_M = 0.02  # thickness, all of it below the plane


def collision_objects(
    analysis: SceneAnalysis,
    selection: Selection,
    header: Header,
    previous: Collection[str] = (),
) -> list[Any]:
    """The table, the target and every other object as boxes.

    The target is apart, so that a planner can allow the hand to touch it and attach it. Obstacles
    that are no numbered object are left out: an octomap tells of them.

    Args:
        analysis: of the view.
        selection: the answer that was chosen from it.
        header: stamp of the view, and the boxes' frame: the base.
        previous: ids of the answer before; those that are gone are removed.

    Returns:
        moveit_msgs/CollisionObject each: `boxgrasp_table` (further level surfaces
        `boxgrasp_table_2`, ...), `boxgrasp_object_3`, `boxgrasp_target`, then removals.
    """
    found = [
        _box(_table_id(number), *_table(surface), header)
        for number, surface in enumerate(surfaces(analysis), start=1)
    ]
    target = target_number(analysis)
    for thing in things(analysis):
        if thing.number in (NO_NUMBER, target):
            continue
        box = fit_box(thing.points, analysis.scene.plane, 0.0, _FIT)
        found.append(_box(f"{OBJECT}{thing.number}", box.T_base_box, box.dimensions_m, header))
    own = selection.box
    found.append(_box(TARGET, own.T_base_box, own.dimensions_m, header))
    present = {item.id for item in found}
    return found + [_removed(name, header) for name in previous if name not in present]


def _table_id(number: int) -> str:
    return TABLE if number == 1 else f"{TABLE}_{number}"


def _table(surface: Surface) -> tuple[Floats, Floats]:
    """Pose and size of a thin box under a surface where it was seen."""
    low, high = surface.outline_m.min(axis=0), surface.outline_m.max(axis=0)
    middle = np.array([[*((low + high) / 2), -_TABLE_M / 2]])
    R = surface.T_base_surface[:3, :3]
    T = make_transform(R, transform(surface.T_base_surface, middle)[0])
    return T, np.array([*(high - low), _TABLE_M])


def _box(name: str, T: Floats, size_m: Floats, header: Header) -> Any:
    solid = SolidPrimitive(type=SolidPrimitive.BOX, dimensions=size_m.tolist())
    return CollisionObject(
        header=header,
        id=name,
        pose=pose_message(T),
        primitives=[solid],
        primitive_poses=[Pose()],  # beside its own pose; w is 1 by default
        operation=CollisionObject.ADD,
    )


def _removed(name: str, header: Header) -> Any:
    return CollisionObject(header=header, id=name, operation=CollisionObject.REMOVE)
