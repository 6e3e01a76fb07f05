"""URDF files: links with their geometry, joints with their range. Read by yourdfpy and trimesh."""

from __future__ import annotations

import importlib
import logging
import math
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from xml.parsers import expat

import numpy as np

from boxgrasp.arrays import Floats
from boxgrasp.errors import GripperError, MissingExtraError
from boxgrasp.geometry.transforms import transform

MESHES: Final = (".stl", ".obj", ".dae", ".ply", ".off", ".glb", ".gltf")
MOVING: Final = ("revolute", "continuous", "prismatic")
_SECTIONS: Final = 64  # of a cylinder: its polygon lies within 0.2 % of it

_log = logging.getLogger("boxgrasp.io.urdf")


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of a URDF.

    Attributes:
        name: of the joint.
        kind: `fixed`, `revolute`, `continuous`, `prismatic`, or another that does not move here.
        parent: name of the link that holds it.
        child: name of the link that it moves.
        range: lowest and highest value, m or rad; None without limits.
        master: name of the joint that it follows; its own where it follows none.
        axis: (3,) float64 unit vector, child's frame.
    """

    name: str
    kind: str
    parent: str
    child: str
    range: tuple[float, float] | None
    master: str
    axis: Floats

    @property
    def moves(self) -> bool:
        """Whether it is of a kind that moves."""
        return self.kind in MOVING


class UrdfFile:
    """A URDF that was read; nothing of it is changed.

    Attributes:
        path: of the file.
        name: of the robot in it.
        links: names of all links.
        joints: by the name of the link that each moves.
    """

    def __init__(self, path: str | os.PathLike[str], *, visual: bool = False) -> None:
        """Read a file.

        Args:
            path: of the URDF.
            visual: take the links' visual geometry instead of what they collide with.

        Raises:
            GripperError: it cannot be read, is no URDF, or its joints make no tree.
            MissingExtraError: yourdfpy or trimesh is not installed.
        """
        reader, self._trimesh = _reader()
        self.path, self._visual = Path(path), visual
        _refuse_damage(self.path)
        self._said: set[str] = set()
        try:
            with np.errstate(all="ignore"):  # what is not finite is refused below
                robot = reader.URDF.load(str(self.path), build_scene_graph=False).robot
            self.name = str(robot.name or self.path.stem)
            self._links = {str(link.name): link for link in robot.links}
            joints = [_joint(joint) for joint in robot.joints]
            self.links, self.joints = tuple(self._links), {joint.child: joint for joint in joints}
            self._refuse_loose(joints)
            self._model: Any = reader.URDF(robot=robot, load_meshes=False)
        except GripperError:
            raise
        except Exception as fault:  # the library's own errors are of any kind
            raise GripperError(
                f"{self.path}: {type(fault).__name__} in reading it: {_line(fault)}; valid: a URDF"
            ) from None

    def _refuse_loose(self, joints: Sequence[Joint]) -> None:
        """Refuse joints that make no tree of links that are there."""
        for joint in joints:
            for link in (joint.parent, joint.child):
                if link not in self._links:
                    raise GripperError(
                        f"{self.path}: joint {joint.name!r} holds {link!r}, which is no link; "
                        "valid: links that are there"
                    )
            if self.joints[joint.child] is not joint:
                raise GripperError(
                    f"{self.path}: two joints move {joint.child!r}; valid: a tree of links"
                )

    def validate_link(self, name: str) -> str:
        """Refuse a link that is not there.

        Args:
            name: of the link.

        Returns:
            The same name.

        Raises:
            GripperError: there is none, with those that are.
        """
        if name not in self._links:
            valid = ", ".join(self.links[:30]) + (", ..." if len(self.links) > 30 else "")
            raise GripperError(f"{self.path}: no link {name!r}; valid: {valid}")
        return name

    def way_up(self, link: str) -> Iterator[Joint]:
        """The joints from a link towards the root.

        Args:
            link: where it starts.

        Yields:
            The link's own joint first.

        Raises:
            GripperError: the joints go round in a circle.
        """
        met = set()
        while link in self.joints:
            if link in met:
                raise GripperError(f"{self.path}: joints go round from {link!r}; valid: a tree")
            met.add(link)
            yield self.joints[link]
            link = self.joints[link].parent

    def set_joints(self, values: Mapping[str, float]) -> None:
        """Move joints; those that follow others move with them, all others stand at 0.

        Args:
            values: m or rad, by name.
        """
        rest = {name: 0.0 for name in self._model.actuated_joint_names}
        self._model.update_cfg(rest | dict(values))

    def pose(self, link: str, base: str) -> Floats:
        """Where a link stands.

        Args:
            link: name.
            base: name of the link whose frame is asked for.

        Returns:
            (4, 4) float64 T_base_link, m.
        """
        return np.array(self._model.get_transform(link, base), np.float64)

    def triangles_m(self, link: str) -> Floats:
        """The surface of a link.

        Args:
            link: name.

        Returns:
            (N, 3, 3) float64 corners of triangles, link's frame, m; none where it has no geometry.

        Raises:
            GripperError: a mesh is missing or cannot be read.
        """
        element = self._links[link]
        pieces = element.visuals if self._visual else element.collisions
        if not pieces and not self._visual and element.visuals:
            pieces = element.visuals
            if link not in self._said:
                _log.warning("%s: %s collides with nothing; its looks are taken", self.path, link)
                self._said.add(link)
        found: list[Floats] = [np.zeros((0, 3, 3))]
        for piece in pieces or ():
            with np.errstate(all="ignore"):  # what is not finite is refused below
                corners = self._triangles(piece.geometry, link)
            T = np.eye(4) if piece.origin is None else np.asarray(piece.origin, np.float64)
            found.append(transform(T, corners))
        corners = np.concatenate(found)
        if not np.isfinite(corners).all():
            raise GripperError(f"{self.path}: geometry of {link!r} is not finite; valid: numbers")
        return corners

    def _triangles(self, geometry: Any, link: str) -> Floats:
        if geometry.mesh is not None:
            return self._mesh(geometry.mesh, link)
        make = self._trimesh.creation
        try:
            if geometry.box is not None:
                mesh = make.box(extents=geometry.box.size)
            elif geometry.cylinder is not None:
                shape = geometry.cylinder
                mesh = make.cylinder(radius=shape.radius, height=shape.length, sections=_SECTIONS)
            else:
                mesh = make.icosphere(subdivisions=4, radius=geometry.sphere.radius)
            return np.array(mesh.triangles, np.float64)
        except (AttributeError, TypeError, ValueError, ArithmeticError) as fault:
            raise GripperError(
                f"{self.path}: geometry of {link!r}: {_line(fault)}; valid: box, cylinder, sphere, "
                "mesh"
            ) from None

    def _mesh(self, element: Any, link: str) -> Floats:
        file = find_mesh(str(element.filename), self.path, link)
        try:
            mesh = self._trimesh.load(file, force="mesh", process=False)
            corners = np.array(mesh.triangles, np.float64).reshape(-1, 3, 3)
        except Exception as fault:  # the library's own errors are of any kind
            raise GripperError(
                f"{file}: mesh of {link!r} cannot be read ({type(fault).__name__}: {_line(fault)})"
            ) from None
        if not len(corners) or not np.isfinite(corners).all():
            raise GripperError(f"{file}: mesh of {link!r} has no surface; valid: triangles")
        scale = 1.0 if element.scale is None else np.asarray(element.scale, np.float64)
        return np.asarray(corners * scale)


def find_mesh(name: str, urdf: Path, link: str) -> Path:
    """The file of a mesh as a URDF names it.

    Args:
        name: a path, `file://PATH` or `package://PACKAGE/PATH`.
        urdf: the file that names it.
        link: that it belongs to, in messages.

    Returns:
        A file that exists.

    Raises:
        GripperError: there is none, or its kind is not read.
    """
    kind, _, rest = name.rpartition("://")
    if Path(rest).suffix.lower() not in MESHES:
        raise GripperError(f"{urdf}: mesh {name!r} of {link!r}; valid: {', '.join(MESHES)}")
    if kind in ("package", "model"):
        places = list(_in_packages(rest, urdf.resolve().parent))
        where = "beside the URDF, in a folder above it, or in AMENT_PREFIX_PATH"
    else:
        places, where = [urdf.parent / rest], "relative to the URDF"
    for place in places:
        if place.is_file():
            return place
    raise GripperError(f"{urdf}: mesh {name!r} of {link!r} is not there; valid: {where}")


def _in_packages(rest: str, folder: Path) -> Iterator[Path]:
    package, _, inside = rest.partition("/")
    for place in (folder, *folder.parents):
        yield place / rest
        if place.name == package or place == folder:
            yield place / inside
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share" / package / inside


def _reader() -> tuple[Any, Any]:
    try:
        reader: Any = importlib.import_module("yourdfpy")
        meshes: Any = importlib.import_module("trimesh")
    except ImportError:
        raise MissingExtraError("reading a URDF needs yourdfpy; install boxgrasp[urdf]") from None
    logging.getLogger("yourdfpy").addHandler(logging.NullHandler())
    return reader, meshes


def _refuse_damage(path: Path) -> None:
    """Refuse what is no sound XML of a URDF: yourdfpy reads as much of it as it can."""
    tags: list[str] = []
    parser = expat.ParserCreate()  # without name spaces: URDFs use prefixes that nobody declares
    parser.StartElementHandler = lambda tag, _attributes: tags.append(tag)
    try:
        parser.Parse(path.read_bytes(), True)
    except OSError as error:
        raise GripperError(f"{path}: {error.strerror or error}; valid: a URDF") from None
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise GripperError(f"{path}: no sound XML ({_line(error)}); valid: a URDF") from None
    if tags[0] != "robot":
        raise GripperError(f"{path}: root element is {tags[0][:60]!r}; valid: 'robot', a URDF")
    if any(tag.startswith("xacro:") for tag in tags):
        raise GripperError(f"{path}: is xacro; valid: a URDF, as the command xacro writes it")


def _joint(element: Any) -> Joint:
    limit = element.limit
    held = None
    if limit is not None and element.type in ("revolute", "prismatic"):
        held = (float(limit.lower or 0.0), float(limit.upper or 0.0))
        if not all(map(math.isfinite, held)):
            raise ValueError(f"limits of {element.name} are {held}")
    axis = np.array((1.0, 0.0, 0.0) if element.axis is None else element.axis, np.float64)
    if element.type in MOVING:
        length = float(np.linalg.norm(axis))
        if not (math.isfinite(length) and length > 0.0):
            raise ValueError(f"axis of {element.name} is {axis.tolist()}")
        axis /= length
    if element.origin is not None and not np.isfinite(element.origin).all():
        raise ValueError(f"origin of {element.name} is not finite")
    if element.mimic is not None:
        follows = (element.mimic.multiplier, element.mimic.offset)
        if not all(value is None or math.isfinite(value) for value in follows):
            raise ValueError(f"mimic of {element.name} is {follows}")
    master = element.mimic.joint if element.mimic is not None else element.name
    return Joint(
        str(element.name),
        str(element.type),
        str(element.parent),
        str(element.child),
        held,
        str(master),
        axis,
    )


def _line(fault: object) -> str:
    return " ".join(str(fault).split())[:120]
