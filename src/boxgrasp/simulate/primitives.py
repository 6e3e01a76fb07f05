"""The solids that a simulated scene is made of, each with a color and its object's number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import SceneError
from boxgrasp.geometry.transforms import make_transform, rotation_z, validate_transform
from boxgrasp.kernels.raycast import BOX, CYLINDER, PLANE

Color = tuple[int, int, int]


def _require_positive(**lengths: float) -> None:
    for name, value in lengths.items():
        if not (np.isfinite(value) and value > 0):
            raise SceneError(f"{name} is {value}; valid: a finite length above 0 m")


@dataclass(frozen=True, eq=False)
class Box:
    """A solid box.

    Attributes:
        T_base_box: (4, 4) pose of its center.
        dimensions_m: (3,) full lengths along its axes, m.
        color: red, green, blue, 0 to 255.
        object_id: number of the object that it is a part of.

    Raises:
        SceneError: a length is not positive.
        BoxgraspError: T_base_box is not rigid.
    """

    T_base_box: Floats
    dimensions_m: Floats
    color: Color = (128, 128, 128)
    object_id: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "T_base_box", validate_transform(self.T_base_box, "T_base_box"))
        size = np.array(self.dimensions_m, dtype=np.float64)
        if size.shape != (3,):
            raise SceneError(f"dimensions_m has shape {size.shape}; valid: (3,)")
        _require_positive(x=size[0], y=size[1], z=size[2])
        object.__setattr__(self, "dimensions_m", readonly(size))

    @property
    def T_base_solid(self) -> Floats:
        """(4, 4) pose of the center."""
        return self.T_base_box

    @property
    def half_size(self) -> Floats:
        """(3,) m, half lengths of the box that holds the solid, in its own frame."""
        return self.dimensions_m / 2


@dataclass(frozen=True, eq=False)
class Cylinder:
    """A solid cylinder.

    Attributes:
        T_base_cylinder: (4, 4) pose of its center, its axis along the local z.
        radius_m: m.
        height_m: m.
        color: red, green, blue, 0 to 255.
        object_id: number of the object that it is a part of.

    Raises:
        SceneError: a length is not positive.
        BoxgraspError: T_base_cylinder is not rigid.
    """

    T_base_cylinder: Floats
    radius_m: float
    height_m: float
    color: Color = (128, 128, 128)
    object_id: int = 0

    def __post_init__(self) -> None:
        T = validate_transform(self.T_base_cylinder, "T_base_cylinder")
        object.__setattr__(self, "T_base_cylinder", T)
        _require_positive(radius_m=self.radius_m, height_m=self.height_m)

    @property
    def T_base_solid(self) -> Floats:
        """(4, 4) pose of the center."""
        return self.T_base_cylinder

    @property
    def half_size(self) -> Floats:
        """(3,) m, half lengths of the box that holds the solid, in its own frame."""
        return np.array([self.radius_m, self.radius_m, self.height_m / 2])


@dataclass(frozen=True)
class Plane:
    """An infinite level plane, seen from both sides.

    Attributes:
        height_m: its z in the base frame, m.
        color: red, green, blue, 0 to 255.
        object_id: its number as an object.

    Raises:
        SceneError: the height is not finite.
    """

    height_m: float
    color: Color = (60, 62, 66)
    object_id: int = -1

    def __post_init__(self) -> None:
        if not np.isfinite(self.height_m):
            raise SceneError(f"height_m is {self.height_m}; valid: a finite height")

    @property
    def T_base_solid(self) -> Floats:
        """(4, 4) pose of the plane's point under the base's origin."""
        return make_transform(np.eye(3), (0.0, 0.0, self.height_m))

    @property
    def half_size(self) -> Floats:
        """(3,) m, without an end along x and y."""
        return np.array([np.inf, np.inf, 0.0])


Primitive = Box | Cylinder | Plane


@dataclass(frozen=True, eq=False)
class Solids:
    """P solids and shells of any kind that is ray cast; read-only arrays.

    Attributes:
        kinds: (P,) int32, of `kernels.raycast`.
        T_base_solid: (P, 4, 4) float64.
        sizes: (P, 3) float64, as `raycast` takes them, m.
    """

    kinds: NDArray[np.int32]
    T_base_solid: Floats
    sizes: Floats

    def __post_init__(self) -> None:
        for name, shape, dtype in (
            ("kinds", (-1,), np.int32),
            ("T_base_solid", (-1, 4, 4), np.float64),
            ("sizes", (-1, 3), np.float64),
        ):
            array = np.array(getattr(self, name), dtype=dtype, order="C").reshape(shape)
            object.__setattr__(self, name, readonly(array))

    @staticmethod
    def of(primitives: Sequence[Primitive]) -> Solids:
        """The primitives as arrays.

        Args:
            primitives: base frame.

        Returns:
            One solid a primitive, in their order.
        """
        return Solids(
            np.array([_kind(p) for p in primitives], dtype=np.int32),
            np.array([p.T_base_solid for p in primitives]),
            np.array([p.half_size for p in primitives]),
        )


def _kind(primitive: Primitive) -> int:
    if isinstance(primitive, Box):
        return BOX
    return CYLINDER if isinstance(primitive, Cylinder) else PLANE


def upright(x: float, y: float, z: float, yaw_rad: float = 0.0) -> Floats:
    """The pose of what stands, rounded so that every machine has the same.

    Args:
        x: base frame, m.
        y: base frame, m.
        z: base frame, m.
        yaw_rad: turn about z.

    Returns:
        (4, 4) float64.
    """
    return make_transform(np.round(rotation_z(yaw_rad), 12), np.round((x, y, z), 6))
