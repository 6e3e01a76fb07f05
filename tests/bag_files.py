"""ROS bags of all kinds, written with rosbags; imported only where that is installed."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np
from capture_files import HEIGHT, WIDTH, View
from PIL import Image
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

KINDS = ("ros1", "ros2_folder", "db3", "mcap")


class BagMaker:
    """Collects messages, then writes them; stamps in seconds."""

    def __init__(self, kind: str) -> None:
        self.ros1 = kind == "ros1"
        self.kind = kind
        self.store = get_typestore(Stores.ROS1_NOETIC if self.ros1 else Stores.ROS2_HUMBLE)
        for kind in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
            if kind not in self.store.types:
                text = "geometry_msgs/TransformStamped[] transforms"
                self.store.register(get_types_from_msg(text, kind))
        self.messages: list[tuple[str, str, float, Any]] = []

    def make(self, kind: str, /, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, stamp: float, frame_id: str) -> Any:
        seconds = int(stamp)
        time = self.make(
            "builtin_interfaces/msg/Time", sec=seconds, nanosec=round((stamp - seconds) * 1e9)
        )
        extra = {"seq": 0} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame_id, **extra)

    def add(self, topic: str, name: str, stamp: float, frame_id: str, **fields: Any) -> BagMaker:
        message = self.make(
            f"sensor_msgs/msg/{name}", header=self.header(stamp, frame_id), **fields
        )
        self.messages.append((topic, f"sensor_msgs/msg/{name}", stamp, message))
        return self

    def image(
        self,
        topic: str,
        stamp: float,
        pixels: np.ndarray,
        encoding: str,
        *,
        padding: int = 0,
        big: bool = False,
        frame_id: str = "camera_optical_frame",
    ) -> BagMaker:
        ordered = pixels.astype(pixels.dtype.newbyteorder(">" if big else "<"))
        rows = [row.tobytes() + bytes(padding) for row in ordered]
        return self.add(
            topic,
            "Image",
            stamp,
            frame_id,
            height=pixels.shape[0],
            width=pixels.shape[1],
            encoding=encoding,
            is_bigendian=int(big),
            step=len(rows[0]),
            data=np.frombuffer(b"".join(rows), np.uint8),
        )

    def compressed_depth(
        self, topic: str, stamp: float, millimeters: np.ndarray, packed: bytes = b""
    ) -> BagMaker:
        """As PNG, or as the RVL that is given."""
        png = io.BytesIO()
        Image.fromarray(millimeters).save(png, "PNG")
        return self.add(
            topic,
            "CompressedImage",
            stamp,
            "camera_optical_frame",
            format=f"16UC1; compressedDepth {'rvl' if packed else 'png'}",
            data=np.frombuffer(bytes(12) + (packed or png.getvalue()), np.uint8),
        )

    def tf(
        self,
        recorded: float,
        *transforms: tuple[str, str, float, Any, Any],
        static: bool = False,
        kind: str = "tf2_msgs/msg/TFMessage",
    ) -> BagMaker:
        """transforms are parent, child, stamp, translation, quaternion xyzw."""
        made = []
        for parent, child, stamp, xyz, quaternion in transforms:
            vector = self.make(
                "geometry_msgs/msg/Vector3",
                **{axis: float(value) for axis, value in zip("xyz", xyz, strict=True)},
            )
            turn = self.make(
                "geometry_msgs/msg/Quaternion",
                **{axis: float(value) for axis, value in zip("xyzw", quaternion, strict=True)},
            )
            made.append(
                self.make(
                    "geometry_msgs/msg/TransformStamped",
                    header=self.header(stamp, parent),
                    child_frame_id=child,
                    transform=self.make(
                        "geometry_msgs/msg/Transform", translation=vector, rotation=turn
                    ),
                )
            )
        message = self.make(kind, transforms=made)
        topic = "/tf_static" if static else "/tf"
        self.messages.append((topic, kind, recorded, message))
        return self

    def info(
        self,
        topic: str,
        stamp: float,
        K: np.ndarray,
        *,
        D: tuple[float, ...] = (0, 0, 0, 0, 0),
        size: tuple[int, int] = (WIDTH, HEIGHT),
    ) -> BagMaker:
        roi = self.make(
            "sensor_msgs/msg/RegionOfInterest",
            x_offset=0,
            y_offset=0,
            height=0,
            width=0,
            do_rectify=False,
        )
        matrices = {
            "d": np.array(D, float),
            "k": K.reshape(9).astype(float),
            "r": np.eye(3).reshape(9),
            "p": np.hstack([K, np.zeros((3, 1))]).reshape(12),
        }
        if self.ros1:
            matrices = {name.upper(): value for name, value in matrices.items()}
        return self.add(
            topic,
            "CameraInfo",
            stamp,
            "camera_optical_frame",
            height=size[1],
            width=size[0],
            distortion_model="plumb_bob",
            **matrices,
            binning_x=0,
            binning_y=0,
            roi=roi,
        )

    def cloud(
        self,
        topic: str,
        stamp: float,
        points: np.ndarray,
        *,
        rgb: np.ndarray | None = None,
        frame_id: str = "camera_optical_frame",
        padding: int = 0,
    ) -> BagMaker:
        """points (H, W, 3); x, y, z at 0, 4, 8, then a gap, colors at 16 as PCL has them."""
        height, width = points.shape[:2]
        cells = np.zeros((height, width, 20), np.uint8)
        cells[..., :12] = points.astype("<f4").view(np.uint8).reshape(height, width, 12)
        field = "sensor_msgs/msg/PointField"
        fields = [
            self.make(field, name=axis, offset=4 * i, datatype=7, count=1)
            for i, axis in enumerate("xyz")
        ]
        if rgb is not None:
            cells[..., 16:19] = rgb[..., ::-1]
            fields.append(self.make(field, name="rgb", offset=16, datatype=7, count=1))
        rows = [row.tobytes() + bytes(padding) for row in cells]
        return self.add(
            topic,
            "PointCloud2",
            stamp,
            frame_id,
            height=height,
            width=width,
            fields=fields,
            is_bigendian=False,
            point_step=20,
            row_step=len(rows[0]),
            data=np.frombuffer(b"".join(rows), np.uint8),
            is_dense=False,
        )

    def write(self, folder: Path) -> Path:
        """The path to load: a .bag, a folder with metadata, or the file inside it."""
        path = folder / ("view.bag" if self.ros1 else f"bag_{self.kind}")
        if self.ros1:
            writer: Any = Writer1(path)
        else:
            plugin = StoragePlugin.MCAP if self.kind == "mcap" else StoragePlugin.SQLITE3
            writer = Writer2(path, version=8, storage_plugin=plugin)
        with writer:
            known: dict[str, Any] = {}
            for topic, name, stamp, message in sorted(self.messages, key=lambda m: m[2]):
                if topic not in known:
                    known[topic] = writer.add_connection(topic, name, typestore=self.store)
                encode = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
                writer.write(known[topic], round(stamp * 1e9), encode(message, name))
        if self.kind in ("db3", "mcap"):
            return next(path.glob(f"*.{self.kind}"))
        return path


def depth_bag(kind: str, seen: View) -> BagMaker:
    """Three depth images a second apart, each 10 cm farther, their CameraInfo, and color."""
    maker = BagMaker(kind)
    millimeters = np.round(seen.depth * 1000).astype(np.uint16)
    for i in range(3):
        stamp = 100.0 + i
        moved = np.where(millimeters > 0, millimeters + 100 * i, 0).astype(np.uint16)
        maker.image("/camera/color/image_raw", stamp - 0.01, seen.rgb, "rgb8")
        maker.info("/camera/depth/camera_info", stamp, seen.intrinsics + np.diag([i, i, 0]))
        maker.image("/camera/depth/image_raw", stamp + 0.001, moved, "16UC1", padding=6)
    return maker
