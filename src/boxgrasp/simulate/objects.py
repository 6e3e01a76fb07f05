"""Object sets as data: the thesis's simulated and real objects, or a user's own file."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.errors import SceneError
from boxgrasp.simulate.primitives import Box, Color, Cylinder, upright

SHIPPED = ("simulated", "real")
SETS = ("known", "novel", "real", "obstacle")
_TOUCH_M = 1e-6  # parts this near to the base's plane stand on it
_RENAMED = {"colour": "color", "centre_m": "center_m"}


@dataclass(frozen=True)
class Part:
    """One solid of an object.

    Attributes:
        shape: `box` or `cylinder`.
        size_m: x, y, z of a box, or radius and height of a cylinder, m.
        center_m: (3,) in the object's frame, m.
        color: red, green, blue, 0 to 255; None for the object's own.
    """

    shape: str
    size_m: tuple[float, ...]
    center_m: tuple[float, float, float]
    color: Color | None

    @property
    def half_size_m(self) -> Floats:
        """(3,) m, half lengths of the box that holds the part."""
        if self.shape == "cylinder":
            return np.array([self.size_m[0], self.size_m[0], self.size_m[1] / 2])
        return np.array(self.size_m) / 2

    @property
    def volume_m3(self) -> float:
        """Volume of the part."""
        flat = math.pi / 4 if self.shape == "cylinder" else 1.0
        return float(flat * np.prod(2 * self.half_size_m))


@dataclass(frozen=True)
class SimulatedObject:
    """A named object standing on its base, x away from the robot, z up (thesis section 3-1).

    Attributes:
        name: in its set.
        set: `known`, `novel` or `real` (may be a target), or `obstacle`.
        color: red, green, blue, 0 to 255.
        parts: its solids.
        floats_m: least and most height of the base over the table of what does not stand, m.
    """

    name: str
    set: str
    color: Color
    parts: tuple[Part, ...]
    floats_m: tuple[float, float] | None = None

    def place(
        self,
        x: float,
        y: float,
        z: float,
        yaw_rad: float = 0.0,
        *,
        object_id: int = 0,
        color: Color | None = None,
    ) -> tuple[Box | Cylinder, ...]:
        """The object's solids at a place.

        Args:
            x: of the base's center, base frame, m.
            y: likewise.
            z: likewise.
            yaw_rad: turn about z.
            object_id: number that the solids carry.
            color: in place of the object's own.

        Returns:
            One solid a part.
        """
        T = upright(x, y, z, yaw_rad)
        solids: list[Box | Cylinder] = []
        for part in self.parts:
            own = color if part.color is None and color is not None else None
            paint = own or part.color or self.color
            pose = T @ upright(*part.center_m)
            if part.shape == "box":
                solids.append(Box(pose, part.size_m, paint, object_id))  # type: ignore[arg-type]
            else:
                solids.append(Cylinder(pose, part.size_m[0], part.size_m[1], paint, object_id))
        return tuple(solids)


def load_objects(source: str | Path | None = None) -> Mapping[str, SimulatedObject]:
    """The objects of a set.

    A file is YAML like the shipped ones in `simulate/object_sets/`. What has no `floats_m` must
    stand: its lowest point on its base, its center of mass (solids of equal density) over its foot.

    Args:
        source: a shipped set (`simulated`, the default, or `real`), or the path of a file.

    Returns:
        Objects by name, read-only.

    Raises:
        SceneError: no such set or file, or an object in it is wrong, hangs or would topple.
    """
    if source is None or source in SHIPPED:
        file = f"{source or 'simulated'}.yaml"
        folder = resources.files("boxgrasp.simulate") / "object_sets"
        return _parse((folder / file).read_text("utf-8"), file)
    try:
        text = Path(source).read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        why = getattr(error, "strerror", None) or "not text"
        raise SceneError(
            f"objects {str(source)!r} cannot be read ({why}); "
            f"valid: {', '.join(SHIPPED)}, or the path of a YAML file"
        ) from None
    return _parse(text, str(source))


@cache  # by content, so that an edited file is read anew
def _parse(text: str, source: str) -> Mapping[str, SimulatedObject]:
    import yaml

    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise SceneError(f"{source} is not YAML: {str(error).splitlines()[0]}") from None
    if not isinstance(data, dict) or not isinstance(data.get("objects"), dict):
        raise SceneError(f"{source} has no mapping `objects`; valid: objects by name")
    items = data["objects"].items()
    return MappingProxyType({str(name): _object(str(name), item, source) for name, item in items})


def _object(name: str, item: Any, source: str) -> SimulatedObject:
    try:
        _validate_keys(item, {"set", "color", "parts", "floats_m"})
        if item["set"] not in SETS:
            raise ValueError(f"set {item['set']!r} is not one of {', '.join(SETS)}")
        parts = tuple(_part(part) for part in item["parts"])
        if not parts:
            raise ValueError("no parts")
        floats = item.get("floats_m")
        if floats is None:
            _validate_stands(parts)
        return SimulatedObject(
            name,
            item["set"],
            _color(item["color"]),
            parts,
            None if floats is None else (float(floats[0]), float(floats[1])),
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise SceneError(f"object {name} of {source} is wrong: {error}") from None


def _validate_stands(parts: tuple[Part, ...]) -> None:
    """Whether the lowest parts are on the base's plane and the center of mass over their hull.

    Parts are of equal density; where two overlap, both count.

    Raises:
        ValueError: they are not.
    """
    centers = np.array([part.center_m for part in parts])
    halves = np.array([part.half_size_m for part in parts])
    lowest = centers[:, 2] - halves[:, 2]
    if lowest.min() > _TOUCH_M:
        raise ValueError(f"it would hang {1000 * lowest.min():.1f} mm over its base; give floats_m")
    if lowest.min() < -_TOUCH_M:
        raise ValueError(f"it reaches {-1000 * lowest.min():.1f} mm below its base")
    masses = np.array([part.volume_m3 for part in parts])
    middle = masses @ centers / masses.sum()
    # How far the hull reaches from the center of mass in 720 directions: it is within if all are
    # above 0.
    turn = np.linspace(0, 2 * np.pi, 720, endpoint=False)
    way = np.stack([np.cos(turn), np.sin(turn)])
    reach = [
        (center - middle)[:2] @ way
        + (half[0] if part.shape == "cylinder" else half[:2] @ np.abs(way))
        for part, center, half, low in zip(parts, centers, halves, lowest, strict=True)
        if low <= _TOUCH_M
    ]
    margin = float(np.max(reach, axis=0).min())
    if margin <= _TOUCH_M:
        raise ValueError(
            f"it would topple: its center of mass is {-1000 * margin:.1f} mm outside its foot"
        )


def _validate_keys(item: Any, known: set[str]) -> None:
    for key in sorted(set(item) - known):
        if key in _RENAMED:
            raise ValueError(f"{key} is now {_RENAMED[key]}")
        raise ValueError(f"unknown key {key}")


def _color(values: Any) -> Color:
    r, g, b = (int(value) for value in values)
    if not all(0 <= value <= 255 for value in (r, g, b)):
        raise ValueError(f"color {list(values)} is not within 0 to 255")
    return (r, g, b)


def _part(item: Any) -> Part:
    _validate_keys(item, {"shape", "dimensions_m", "radius_m", "height_m", "center_m", "color"})
    size: tuple[float, ...]
    if item["shape"] == "box":
        size = tuple(float(value) for value in item["dimensions_m"])
        if len(size) != 3:
            raise ValueError(f"dimensions_m has {len(size)} numbers, not 3")
    elif item["shape"] == "cylinder":
        size = (float(item["radius_m"]), float(item["height_m"]))
    else:
        raise ValueError(f"shape {item['shape']!r} is not box or cylinder")
    if not all(0.0 < length < np.inf for length in size):
        raise ValueError(f"a length is not above 0 m: {list(size)}")
    x, y, z = (float(value) for value in item.get("center_m", (0.0, 0.0, size[-1] / 2)))
    if not np.isfinite((x, y, z)).all():
        raise ValueError(f"center_m is not finite: {[x, y, z]}")
    color = _color(item["color"]) if "color" in item else None
    return Part(item["shape"], size, (x, y, z), color)
