"""Measure the makers' models of the hands in src/boxgrasp/grasps/hands.

    python -m venv V && V/bin/pip install 'trimesh[easy]'
    V/bin/pip download --no-deps --no-binary pybullet -d D \
        robosuite==1.5.2 hello-robot-stretch-urdf==0.1.2 pybullet==3.2.7
    V/bin/python tools/measure_hands.py D > tests/hand_measurements.json

Every part is put where it stands at full opening, in the hand's axes (x the approach, y the
opening, z = x cross y), and cut into slices of 4 mm along x. What sticks out behind x = 0 sits
inside the arm's flange and is left out. Lengths are mm.
"""

from __future__ import annotations

import io
import json
import math
import sys
import tarfile
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

Matrix = NDArray[np.float64]
SLICE_MM = 4.0

# The hand's axes from the model's: z forward and y the opening, z forward and x the opening.
Y_OPENS = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]], float)
X_OPENS = np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float)
# Of PAL's gripper: z backward and x the opening.
X_OPENS_BACKWARD = np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0]], float)


def turn(roll: float, pitch: float, yaw: float) -> Matrix:
    """A rotation of a URDF's rpy."""
    return np.asarray(trimesh.transformations.euler_matrix(roll, pitch, yaw, "sxyz"))


def at(x: float, y: float, z: float, rotation: Matrix | None = None) -> Matrix:
    """A transform of a URDF's origin, mm."""
    T = np.eye(4) if rotation is None else np.array(rotation)
    T[:3, 3] = (x, y, z)
    return T


@dataclass
class Part:
    """One piece of a hand: a mesh or a box, and the origins from the hand's link to it."""

    name: str
    side: str  # palm, or finger: of the finger at +y
    source: str  # the file in its package, or where a box's numbers are from
    mesh: Any
    origins: tuple[Matrix, ...] = ()


@dataclass
class Model:
    """All of a hand. `ahead_mm`: from the hand's origin to its link's origin, along x."""

    name: str
    package: str
    axes: Matrix
    ahead_mm: float
    parts: list[Part]


class Packages:
    """The files of the packages that pip downloaded, read where they are."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def mesh(self, package: str, file: str, scale: float = 1000.0) -> Any:
        """A mesh of a package, in mm."""
        data = io.BytesIO(self._read(package, file))
        mesh = trimesh.load(data, file_type=file.rpartition(".")[2].lower(), force="mesh")
        mesh.apply_scale(scale)
        return mesh

    def _read(self, package: str, file: str) -> bytes:
        (path,) = self._folder.glob(package.replace("-", "_") + "-*")
        if path.name.endswith(".tar.gz"):
            with tarfile.open(path) as archive:
                held = archive.extractfile(path.name.removesuffix(".tar.gz") + "/" + file)
                assert held is not None
                return held.read()
        with zipfile.ZipFile(path) as wheel:
            return wheel.read(file)


def box(size: tuple[float, float, float]) -> Any:
    """A box at the origin, mm."""
    return trimesh.creation.box(size)


def coupling() -> Part:
    """Robotiq's coupling between the arm and the gripper."""
    source = "11 mm: ros2_robotiq_gripper ur_to_robotiq_adapter; 75 mm: robotiq_arg2f_coupling.stl"
    return Part("coupling", "palm", source, box((75.0, 75.0, 11.0)), (at(0, 0, -5.5),))


def robotiq_85(packages: Packages) -> Model:
    """The joints of robotiq_gripper_85.xml at 0, all in the finger at +y."""
    folder = "robosuite/models/assets/grippers/meshes/robotiq_85_gripper/robotiq_arg2f_"
    knuckle = at(0, 30.6011, 54.904)
    finger = (knuckle, at(0, 31.5, -4.1))
    tip = (*finger, at(0, 6.1, 47.1))

    def part(name: str, *origins: Matrix) -> Part:
        file = f"{folder}85_{name}.stl"
        return Part(name, "finger", file, packages.mesh("robosuite", file, 1.0), origins)

    base = folder + "base_link.stl"
    pad = box((22.0, 6.35, 37.5))
    xml = "robosuite/models/assets/grippers/robotiq_gripper_85.xml"
    parts = [
        coupling(),
        Part("base", "palm", base, packages.mesh("robosuite", base)),
        part("outer_knuckle", knuckle),
        part("inner_knuckle", at(0, 12.7, 61.42)),
        part("outer_finger", *finger),
        part("inner_finger", *tip),
        Part("pad", "finger", xml, pad, (*tip, at(0, -22.0203, 32.42))),
    ]
    return Model("robotiq-2f-85", "robosuite 1.5.2", Y_OPENS, 11.0, parts)


def robotiq_140(packages: Packages) -> Model:
    """The joints of ROS-Industrial's robotiq_arg2f_140_model_macro.xacro at 0.

    Its pads leave 128.6 mm between them where the maker says 140: here they stand before the metal
    finger by the 1.3 mm of the 2F-85's, which leaves 140.
    """
    folder = "robosuite/models/assets/grippers/meshes/robotiq_140_gripper/robotiq_arg2f_"
    turned = turn(math.pi / 2 + 0.725, 0, math.pi)
    knuckle = at(0, 30.601, 54.905, turned)
    finger = (knuckle, at(0, 18.22, 26.0018))
    tip = (*finger, at(0, 81.7554, -28.2203, turn(-0.725, 0, 0)))

    def part(name: str, *origins: Matrix) -> Part:
        file = f"{folder}140_{name}.stl"
        return Part(name, "finger", file, packages.mesh("robosuite", file), origins)

    base = folder + "base_link.stl"
    pad = box((30.0, 70.0, 7.5))
    xml = "robosuite/models/assets/grippers/robotiq_gripper_140.xml"
    parts = [
        coupling(),
        Part("base", "palm", base, packages.mesh("robosuite", base)),
        part("outer_knuckle", knuckle),
        part("inner_knuckle", at(0, 12.7, 61.42, turned)),
        part("outer_finger", *finger),
        part("inner_finger", *tip),
        Part("pad", "finger", xml, pad, (*tip, at(0, 45.7554, -27.2203 + 5.7))),
    ]
    return Model("robotiq-2f-140", "robosuite 1.5.2", Y_OPENS, 11.0, parts)


def franka(packages: Packages) -> Model:
    """The joints of pybullet_data's franka_panda/panda.urdf; the hand reaches behind its flange."""
    folder = "robosuite/models/assets/grippers/meshes/panda_gripper/"
    hand, finger = (
        packages.mesh("robosuite", folder + name) for name in ("hand.stl", "finger.stl")
    )
    parts = [
        Part("hand", "palm", folder + "hand.stl", hand),
        Part("finger", "finger", folder + "finger.stl", finger, (at(0, 40, 58.4),)),
    ]
    return Model("franka-hand", "robosuite 1.5.2", Y_OPENS, 26.0, parts)


def wsg(packages: Packages) -> Model:
    """The poses of wsg50_one_motor_gripper_new.sdf, jaws 55 mm from the middle."""
    folder = "examples/pybullet/gym/pybullet_data/gripper/meshes/"
    half = turn(0, 0, math.pi)
    body, jaw, finger = (
        packages.mesh("pybullet", folder + name, scale)
        for name, scale in (("WSG50_110.stl", 1000), ("GUIDE_WSG50_110.stl", 1), ("WSG-FMF.stl", 1))
    )
    parts = [
        Part("body", "palm", folder + "WSG50_110.stl", body),
        Part("jaw", "finger", folder + "GUIDE_WSG50_110.stl", jaw, (at(55, 0, 0, half),)),
        Part("finger", "finger", folder + "WSG-FMF.stl", finger, (at(55, 0, 23, half),)),
    ]
    return Model("wsg-50", "pybullet 3.2.7", X_OPENS, 0.0, parts)


def xarm(packages: Packages) -> Model:
    """The joints of xarm7_gripper.xml at 0."""
    folder = "robosuite/models/assets/grippers/meshes/xarm7_gripper/"

    def part(name: str, side: str, *origins: Matrix) -> Part:
        file = f"{folder}{name}.stl"
        return Part(name, side, file, packages.mesh("robosuite", file), origins)

    knuckle = at(0, 35, 59.098)
    parts = [
        part("base_link", "palm"),
        part("left_outer_knuckle", "finger", knuckle),
        part("left_inner_knuckle", "finger", at(0, 20, 74.098)),
        part("left_finger", "finger", knuckle, at(0, 35.465, 42.039)),
    ]
    return Model("xarm-gripper", "robosuite 1.5.2", Y_OPENS, 0.0, parts)


def pal(packages: Packages) -> Model:
    """The joints of pal_gripper's gripper.urdf.xacro at 45 mm; robosuite has its meshes."""
    folder = "robosuite/models/assets/robots/tiago/meshes/grippers/"
    link, finger = (
        packages.mesh("robosuite", folder + name)
        for name in ("gripper_link.stl", "gripper_finger_link.stl")
    )
    flipped = finger.copy()
    flipped.apply_scale((1, -1, 1))  # the other finger is turned by 180 degrees, not mirrored
    file = folder + "gripper_finger_link.stl"
    parts = [
        Part("link", "palm", folder + "gripper_link.stl", link),
        Part("finger", "finger", file, finger, (at(45, 0, 10),)),
        Part("other finger", "finger", file, flipped, (at(45, 0, 10),)),
    ]
    return Model("pal-gripper", "robosuite 1.5.2", X_OPENS_BACKWARD, 10.0, parts)


def stretch(packages: Packages) -> Model:
    """The SG3 of stretch_description_SE3_eoa_wrist_dw3_tool_sg3.urdf, the left finger at +x.

    The URDF gives the fingers no range. They are swung open about their joints until the maker's
    aperture of 90 mm is between the fingertips.
    """
    folder = "stretch_urdf/SE3/meshes/link_SG3_gripper_"
    swung = at(24.5029, 0, 37.1909, turn(-math.pi / 2, -1.48789318734672, -math.pi))
    swung = swung @ turn(0, 0, -SWING_RAD)  # about the joint's axis, 0 0 -1
    tip = at(177.7845, -10.6722, 0, turn(math.pi / 2, 0, 2.87979326579064))

    def part(name: str, side: str, *origins: Matrix) -> Part:
        file = f"{folder}{name}.STL"
        return Part(name, side, file, packages.mesh("hello-robot-stretch-urdf", file), origins)

    parts = [
        part("body", "palm"),
        part("finger_left", "finger", swung),
        part("fingertip_left", "finger", swung, tip),
    ]
    return Model("stretch-gripper", "hello-robot-stretch-urdf 0.1.2", X_OPENS, 0.0, parts)


SWING_RAD = 0.273  # stretch_body: 90 mm aperture, 171 mm finger; 0.263 rad leave 86 mm

MODELS: tuple[Callable[[Packages], Model], ...] = (
    robotiq_85,
    robotiq_140,
    franka,
    wsg,
    pal,
    stretch,
    xarm,
)


def placed(part: Part, model: Model) -> Any:
    """The part in the hand's axes."""
    mesh = part.mesh.copy()
    for T in reversed(part.origins):
        mesh.apply_transform(T)
    mesh.apply_transform(
        at(
            model.ahead_mm,
            0,
            0,
            np.block([[model.axes, np.zeros((3, 1))], [np.zeros((1, 3)), 1.0]]),
        )
    )
    return mesh


def slices(mesh: Any) -> Iterator[list[float]]:
    """The extents of the mesh between planes of constant x: x, x, y, y, z, z of each slice."""
    low, high = mesh.bounds[:, 0]
    first, last = math.floor(max(low, 0.0) / SLICE_MM), math.ceil(high / SLICE_MM)
    for k in range(first, last):
        near, far = k * SLICE_MM, (k + 1) * SLICE_MM
        cut = mesh
        for x, side in ((near, 1.0), (far, -1.0)):
            cut = trimesh.intersections.slice_mesh_plane(cut, (side, 0, 0), (x, 0, 0))
        if len(cut.vertices):
            yield [round(float(value), 1) for value in cut.bounds.T.reshape(-1)]


def measured(model: Model) -> dict[str, Any]:
    """What the tests compare a preset with."""
    parts = []
    for part in model.parts:
        mesh = placed(part, model)
        parts.append(
            {
                "name": part.name,
                "side": part.side,
                "source": part.source,
                "hull_cm3": round(float(mesh.convex_hull.volume) / 1000, 1),
                "slices_mm": list(slices(mesh)),
            }
        )
    return {"package": model.package, "parts": parts}


def main() -> int:
    """Print the table as JSON."""
    packages = Packages(Path(sys.argv[1]))
    models = [build(packages) for build in MODELS]
    lines = []
    for model in models:
        lines.append(f"{json.dumps(model.name)}: {json.dumps(measured(model))}")
    print("{\n" + ",\n".join(lines) + "\n}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
