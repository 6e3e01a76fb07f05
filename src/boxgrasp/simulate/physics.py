"""A scene in MuJoCo (extra `sim`): whether what stands stays, and its depth by other rays.

It takes the solids' poses and sizes from the scene and shares no geometry with the ray caster.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import MissingExtraError, SceneError
from boxgrasp.geometry.transforms import invert, quaternion_xyzw
from boxgrasp.simulate.camera import SHAPE
from boxgrasp.simulate.primitives import Box, Plane, Primitive
from boxgrasp.simulate.scenes import TARGET_ID, TableScene

STEP_S = 0.001
# In 400 drawn scenes of both shipped sets what stands sinks 0.016 mm into its support and turns by
# 0.04 mrad; a can that still holds 1 mm from the table's edge moves 0.12 mm and 1 mrad; what falls
# does so by centimeters. What is set down 1 mm too high counts as hanging.
STILL_M = 0.001
STILL_RAD = 0.01
_CUTOFF_M = 1e6  # farther surfaces are not seen


@dataclass(frozen=True)
class Settling:
    """The farthest that anything that stands has moved and turned, at any time.

    Attributes:
        moved_m: m.
        turned_rad: radians.
    """

    moved_m: float
    turned_rad: float

    @property
    def stable(self) -> bool:
        """Whether it stays within 1 mm and 10 mrad of where it was put."""
        return self.moved_m <= STILL_M and self.turned_rad <= STILL_RAD


def settles(scene: TableScene, seconds: float = 1.0) -> Settling:
    """What gravity does to a scene: each object that stands is one free body of equal density.

    What floats (gravity is off for the thesis's lamp, section 3-1), table and floor are fixed.

    Args:
        scene: any.
        seconds: how long, s.

    Returns:
        How far things moved.

    Raises:
        SceneError: seconds is not above 0.
        MissingExtraError: MuJoCo is not installed.
    """
    if not (np.isfinite(seconds) and seconds > 0):
        raise SceneError(f"seconds is {seconds}; valid: a time above 0 s")
    mujoco = _mujoco()
    model, data = _load(mujoco, scene)
    free = np.flatnonzero(model.body_dofnum == 6)
    places, turns = data.xipos[free].copy(), data.xquat[free].copy()
    moved, cosine = 0.0, 1.0
    for _ in range(max(1, round(seconds / STEP_S))):
        mujoco.mj_step(model, data)
        off = np.linalg.norm(data.xipos[free] - places, axis=1)
        moved = max(moved, float(off.max(initial=0.0)))
        same = np.abs(np.sum(data.xquat[free] * turns, axis=1))
        cosine = min(cosine, float(same.min(initial=1.0)))
    return Settling(moved, 2 * float(np.arccos(min(cosine, 1.0))))


def mujoco_depth(scene: TableScene, shape: tuple[int, int] = SHAPE) -> NDArray[np.float32]:
    """The scene's view by MuJoCo's rays, without OpenGL; the floor is seen from above alone.

    Args:
        scene: any.
        shape: height and width, px.

    Returns:
        (H, W) float32, z not range, m, 0 where nothing is.

    Raises:
        MissingExtraError: MuJoCo is not installed.
    """
    mujoco = _mujoco()
    model, data = _load(mujoco, scene)
    v, u = np.indices(shape)
    pixels = np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    T = scene.T_base_camera
    # Rays of length 1 along the camera's z: what comes back is z.
    rays = (T[:3, :3] @ np.linalg.inv(scene.intrinsics) @ pixels).T.ravel()
    geom = np.empty(u.size, dtype=np.int32)
    depth = np.empty(u.size)
    mujoco.mj_multiRay(
        model, data, pnt=T[:3, 3], vec=rays, geomgroup=None, flg_static=1, bodyexclude=-1,
        geomid=geom, dist=depth, normal=None, nray=u.size, cutoff=_CUTOFF_M,
    )  # fmt: skip
    return readonly(np.where(geom < 0, 0.0, depth).reshape(shape).astype(np.float32))


def _mujoco() -> Any:
    try:
        import mujoco
    except ImportError:
        raise MissingExtraError(
            "physics needs mujoco; install with: pip install 'boxgrasp[sim]'"
        ) from None
    return mujoco


def _load(mujoco: Any, scene: TableScene) -> tuple[Any, Any]:
    model = mujoco.MjModel.from_xml_string(_scene_xml(scene))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def _scene_xml(scene: TableScene) -> str:
    """The scene as MuJoCo's XML: a free body for each object that stands, the rest fixed."""
    bodies: dict[int, list[Primitive]] = {}
    for solid in scene.primitives:
        bodies.setdefault(solid.object_id, []).append(solid)
    lines = []
    for number, solids in bodies.items():
        free = number >= TARGET_ID and number not in scene.floating_ids
        # A body's frame is its first solid's; a fixed one's is the base's.
        T = solids[0].T_base_solid if free else np.eye(4)
        lines.append(f"<body {_pose(T)}>{'<freejoint/>' if free else ''}")
        lines += [_geom(solid, invert(T) @ solid.T_base_solid) for solid in solids]
        lines.append("</body>")
    # Contacts at more than one point, or cylinders wobble; five times stiffer than usual, or what
    # stands sinks in by 0.1 mm and leans at an edge.
    return (
        f'<mujoco><option timestep="{STEP_S}" integrator="implicitfast">'
        '<flag multiccd="enable"/></option><default><geom solref="0.004 1"/></default>'
        f"<worldbody>{''.join(lines)}</worldbody></mujoco>"
    )


def _geom(solid: Primitive, T: Floats) -> str:
    if isinstance(solid, Plane):
        return f'<geom type="plane" size="0 0 1" {_pose(T)}/>'
    kind = "box" if isinstance(solid, Box) else "cylinder"
    half = solid.half_size if isinstance(solid, Box) else solid.half_size[1:]
    return f'<geom type="{kind}" size="{_text(half)}" {_pose(T)}/>'


def _pose(T: Floats) -> str:
    x, y, z, w = quaternion_xyzw(T[:3, :3])
    return f'pos="{_text(T[:3, 3])}" quat="{_text((w, x, y, z))}"'


def _text(values: Any) -> str:
    return " ".join(repr(float(value)) for value in values)
