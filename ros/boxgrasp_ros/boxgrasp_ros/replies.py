"""An answer as messages: field by field as its JSON (schema 2), poses for planners, the objects."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from boxgrasp_msgs import msg
from geometry_msgs.msg import Point, Pose, PoseArray, PoseStamped, Quaternion, Vector3
from std_msgs.msg import Header

from boxgrasp.arrays import Floats
from boxgrasp.geometry.transforms import quaternion_xyzw
from boxgrasp.perception.numbering import SceneObject
from boxgrasp.result import Candidate, CheckValue, Grasp, Selection

NO_OBJECT = -1  # of CheckResult.object


def selection_message(selection: Selection, header: Header) -> msg.GraspSelection:
    """An answer, field by field; its json holds the same once more.

    Args:
        selection: the answer.
        header: stamp of the view, and the frame of every pose.

    Returns:
        The message: NaN for what nobody measured, infinite where nothing bounds a dimension.
    """
    camera, box = selection.T_base_camera, selection.box
    message = msg.GraspSelection(
        header=header,
        status=selection.status,
        ranker=selection.ranker,
        has_camera_pose=camera is not None,
        passing=[candidate.label for candidate in selection.passing],
        candidates=[_candidate(candidate) for candidate in selection.candidates],
        box_pose=pose_message(box.T_base_box),
        box_dimensions_m=_vector(box.dimensions_m),
        box_dimensions_at_least_m=_vector(box.dimensions_at_least_m),
        box_dimensions_at_most_m=_vector(box.dimensions_at_most_m),
        warning_codes=[warning.code for warning in selection.warnings],
        warning_messages=[warning.message for warning in selection.warnings],
        config_hash=selection.config_hash,
        timing_stages=list(selection.timings_ms),
        timings_ms=list(selection.timings_ms.values()),
        version=selection.version,
        json=selection.to_json(),
    )
    if camera is not None:
        message.camera_pose = pose_message(camera)
    _tell_grasp(message, selection.grasp)
    if selection.refusal is not None:
        message.refusal_code = selection.refusal.code
        message.refusal_message = selection.refusal.message
        message.nearest_label = selection.refusal.nearest_label
        message.violations = [item.sentence for item in selection.refusal.violations]
    return message


def _tell_grasp(message: msg.GraspSelection, grasp: Grasp | None) -> None:
    """Fill in the grasp's fields; without one its numbers are unknown."""
    for name in ("opening_m", "width_m", "clearance_m", "clearance_at_least_m",
                 "probability_clear", "confidence"):  # fmt: skip
        setattr(message, name, _number(None if grasp is None else getattr(grasp, name)))
    if grasp is None:
        return
    message.label, message.face, message.line = grasp.label, grasp.face, grasp.line
    message.face_name = grasp.face_name
    message.pose = pose_message(grasp.T_base_gripper)
    message.tcp_pose = pose_message(grasp.T_base_tcp)
    message.pregrasp_pose = pose_message(grasp.T_base_pregrasp)
    message.has_flange_pose = grasp.T_base_flange is not None
    if grasp.T_base_flange is not None:
        message.flange_pose = pose_message(grasp.T_base_flange)


def pose_message(T: Floats) -> Pose:
    """A rigid transform as a pose.

    Args:
        T: (4, 4), m.

    Returns:
        Its position and unit quaternion, w not negative.
    """
    x, y, z, w = quaternion_xyzw(T[:3, :3]).tolist()
    return Pose(position=point_message(T[:3, 3]), orientation=Quaternion(x=x, y=y, z=z, w=w))


def point_message(place: Floats | Sequence[float]) -> Point:
    """A place as a point.

    Args:
        place: (3,), m.

    Returns:
        The point.
    """
    x, y, z = place
    return Point(x=float(x), y=float(y), z=float(z))


def poses(selection: Selection, header: Header) -> PoseArray:
    """The poses of the gripper's box that pass every check, for a planner to try in turn.

    Args:
        selection: the answer.
        header: stamp of the view, and the poses' frame.

    Returns:
        Best first; empty where a person is asked.
    """
    found = [pose_message(candidate.T_base_gripper) for candidate in selection.passing]
    return PoseArray(header=header, poses=found)


def grasp_pose(selection: Selection, header: Header) -> PoseStamped | None:
    """The pose of the gripper's box when it closes.

    Args:
        selection: the answer.
        header: stamp of the view, and the pose's frame.

    Returns:
        The pose, or None where a person is asked.
    """
    if selection.grasp is None:
        return None
    return PoseStamped(header=header, pose=pose_message(selection.grasp.T_base_gripper))


def object_messages(objects: Iterable[SceneObject]) -> list[msg.SceneObject]:
    """The objects on the support plane.

    Args:
        objects: as `GraspSelector.objects` gives them.

    Returns:
        A message each, in their order.
    """
    return [_scene_object(item) for item in objects]


def _scene_object(item: SceneObject) -> msg.SceneObject:
    u, v = item.pixel or (0, 0)
    return msg.SceneObject(
        number=item.number,
        center=point_message(item.center_m),
        size_m=_vector(item.size_m),
        distance_m=float(item.distance_m),
        points=item.points,
        has_pixel=item.pixel is not None,
        u=u,
        v=v,
    )


def _candidate(candidate: Candidate) -> msg.GraspCandidate:
    return msg.GraspCandidate(
        label=candidate.label,
        face=candidate.face,
        face_name=candidate.face_name,
        line=candidate.line,
        rank=candidate.rank,
        pose=pose_message(candidate.T_base_gripper),
        width_m=candidate.width_m,
        passed=candidate.passed,
        checks=[_check(name, said) for name, said in candidate.checks.items()],
        rejections=[item.sentence for item in candidate.rejections],
    )


def _check(name: str, said: CheckValue) -> msg.CheckResult:
    result = msg.CheckResult(
        name=name,
        value=said.value,
        limit=said.limit,
        unit=said.unit or "",
        passed=said.passed,
        object=NO_OBJECT if said.object is None else said.object,
    )
    if said.nearest_point_m is not None:
        result.has_nearest_point = True
        nearest = result.nearest_point
        nearest.x, nearest.y, nearest.z = said.nearest_point_m
    return result


def _vector(values: Floats) -> Vector3:
    x, y, z = values.tolist()
    return Vector3(x=x, y=y, z=z)


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)
