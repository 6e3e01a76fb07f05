"""What RViz would show: the markers that the node publishes for real captures, drawn.

    .venv-ros/bin/python ros/benchmarks/published_markers.py OUT CAPTURE [CAPTURE ...]

Each capture with a depth image is sent to the node in another process, with its objects as targets
until one is answered with a grasp. OUT gets a PNG a capture, drawn from the MarkerArray that came
back on ~/markers and nothing else.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import _node
import numpy as np


def main() -> None:
    """Ask, hear and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("captures", type=Path, nargs="+")
    args = parser.parse_args()
    from boxgrasp_msgs.msg import Target, View
    from boxgrasp_msgs.srv import SelectGrasp
    from marker_picture import picture
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from scenes import camera_info, color_image, depth_image, transform
    from tf2_msgs.msg import TFMessage
    from visualization_msgs.msg import MarkerArray
    from waiting import call, wait_until

    from boxgrasp import GraspSelector, load_capture

    args.out.mkdir(parents=True, exist_ok=True)
    latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    with _node.running() as (_, client):
        transforms = client.create_publisher(TFMessage, "/tf_static", latched)
        select = client.create_client(SelectGrasp, "/grasp_selector/select")
        for path in args.captures:
            capture = load_capture(path)
            if capture.depth is None:
                print(f"{path.name}: a cloud; only depth images are sent here")
                continue
            selector, frame = GraspSelector(), f"{path.name}_optical_frame"
            pose = np.asarray(selector.scene(capture).T_base_camera)
            transforms.publish(transform(pose, 0, child=frame))
            heard: list[MarkerArray] = []
            subscription = client.create_subscription(
                MarkerArray, "/grasp_selector/markers", heard.append, latched
            )
            numbers = [item.number for item in selector.objects(capture)]
            for number in numbers:
                stamp_ns = 10**9 + number  # tells the answers' markers apart
                view = View(
                    depth=depth_image(capture, stamp_ns, frame),
                    camera_info=camera_info(capture, stamp_ns, frame),
                )
                if capture.rgb is not None:
                    view.color = color_image(capture, stamp_ns, frame)
                target = Target(kind=Target.OBJECT, object=number)
                reply = call(select, SelectGrasp.Request(view=view, target=target), 90)
                if reply.status.code == 0 and reply.selection.status == "grasp":
                    break
            stamp, label = reply.selection.header.stamp, f"object {number}"
            wait_until(
                lambda heard=heard, s=stamp: heard and heard[-1].markers[-1].header.stamp == s
            )
            client.destroy_subscription(subscription)
            place = args.out / f"{path.name}.png"
            picture(heard[-1]).save(place)
            said = reply.selection.status if reply.status.code == 0 else reply.status.message
            print(f"{path.name}: {label}: {said}; {len(heard[-1].markers)} markers in {place}")


if __name__ == "__main__":
    main()
