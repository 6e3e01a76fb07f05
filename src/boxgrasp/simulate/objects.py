"""Object sets as data: the thesis's eight targets, mug and lamps, or a user's own file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from boxgrasp.errors import SceneError
from boxgrasp.simulate.primitives import Box, Colour, Cylinder, upright

SETS = ("known", "novel", "obstacle")


@dataclass(frozen=True)
class Part:
    """One solid of an object: size_m is x, y, z of a box, or radius and height of a cylinder."""

    shape: str
    size_m: tuple[float, ...]
    centre_m: tuple[float, float, float]
    colour: Colour | None


@dataclass(frozen=True)
class SimulatedObject:
    """A named object standing on its base, x away from the robot, z up (thesis section 3-1)."""

    name: str
    set: str
    colour: Colour
    parts: tuple[Part, ...]
    floats_m: tuple[float, float] | None = None

    def place(
        self,
        x: float,
        y: float,
        z: float,
        yaw_rad: float = 0.0,
        *,
        label: int = 0,
        colour: Colour | None = None,
    ) -> tuple[Box | Cylinder, ...]:
        """The object's solids with its base's centre at x, y, z m (base frame), turned about z."""
        T = upright(x, y, z, yaw_rad)
        solids: list[Box | Cylinder] = []
        for part in self.parts:
            own = colour if part.colour is None and colour is not None else None
            paint = own or part.colour or self.colour
            pose = T @ upright(*part.centre_m)
            if part.shape == "box":
                solids.append(Box(pose, part.size_m, paint, label))  # type: ignore[arg-type]
            else:
                solids.append(Cylinder(pose, part.size_m[0], part.size_m[1], paint, label))
        return tuple(solids)


def load_objects(path: str | Path | None = None) -> Mapping[str, SimulatedObject]:
    """Objects by name from a YAML file like `simulate/objects.yaml`, which is the default.

    Raises:
        SceneError: the file cannot be read, or an object in it is not as the default file's.
    """
    return _default_objects() if path is None else _parse(_read(Path(path)), str(path))


def names(group: str | None = None) -> tuple[str, ...]:
    """Names of the default objects of a set (known, novel, obstacle), or of all."""
    found = load_objects()
    return tuple(name for name, item in found.items() if group in (None, item.set))


@cache
def _default_objects() -> Mapping[str, SimulatedObject]:
    text = resources.files("boxgrasp.simulate").joinpath("objects.yaml").read_text("utf-8")
    return _parse(text, "objects.yaml")


def _read(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"object file {path} cannot be read: {error}") from None


def _parse(text: str, source: str) -> dict[str, SimulatedObject]:
    import yaml

    try:
        data = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise SceneError(f"{source} is not YAML: {str(error).splitlines()[0]}") from None
    if not isinstance(data, dict) or not isinstance(data.get("objects"), dict):
        raise SceneError(f"{source} has no mapping `objects`; valid: objects by name")
    return {str(name): _object(str(name), item, source) for name, item in data["objects"].items()}


def _object(name: str, item: Any, source: str) -> SimulatedObject:
    try:
        unknown = set(item) - {"set", "colour", "parts", "floats_m"}
        if unknown:
            raise ValueError(f"unknown key {sorted(unknown)[0]}")
        if item["set"] not in SETS:
            raise ValueError(f"set {item['set']!r} is not one of {', '.join(SETS)}")
        parts = tuple(_part(part) for part in item["parts"])
        if not parts:
            raise ValueError("no parts")
        floats = item.get("floats_m")
        return SimulatedObject(
            name,
            item["set"],
            _colour(item["colour"]),
            parts,
            None if floats is None else (float(floats[0]), float(floats[1])),
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise SceneError(f"object {name} of {source} is wrong: {error}") from None


def _colour(values: Any) -> Colour:
    r, g, b = (int(value) for value in values)
    if not all(0 <= value <= 255 for value in (r, g, b)):
        raise ValueError(f"colour {list(values)} is not within 0 to 255")
    return (r, g, b)


def _part(item: Any) -> Part:
    unknown = set(item) - {"shape", "dimensions_m", "radius_m", "height_m", "centre_m", "colour"}
    if unknown:
        raise ValueError(f"unknown key {sorted(unknown)[0]}")
    size: tuple[float, ...]
    if item["shape"] == "box":
        size = tuple(float(value) for value in item["dimensions_m"])
        if len(size) != 3:
            raise ValueError(f"dimensions_m has {len(size)} numbers, not 3")
    elif item["shape"] == "cylinder":
        size = (float(item["radius_m"]), float(item["height_m"]))
    else:
        raise ValueError(f"shape {item['shape']!r} is not box or cylinder")
    if min(size) <= 0:
        raise ValueError("a length is not above 0 m")
    x, y, z = (float(value) for value in item.get("centre_m", (0.0, 0.0, size[-1] / 2)))
    colour = _colour(item["colour"]) if "colour" in item else None
    return Part(item["shape"], size, (x, y, z), colour)
