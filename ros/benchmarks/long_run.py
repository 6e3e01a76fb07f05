"""Memory over many selections: within 10 % of what it was after the first hundred.

    .venv-ros/bin/python ros/benchmarks/long_run.py [--selections 2000]

The node runs in a process of its own; a client sends a cloud of 320 x 240 points with every
request, by service and by action in turn, every tenth one malformed. A request or goal whose answer
is lost on the way is sent again, and counted. Printed is what the node's process holds, MiB.
"""

from __future__ import annotations

import argparse
import random

import _node
import numpy as np

from boxgrasp import Capture


def main() -> None:
    """Ask and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--selections", type=int, default=2000)
    count = parser.parse_args().selections
    import malformed
    from boxgrasp_msgs.action import SelectGrasp as SelectGraspAction
    from boxgrasp_msgs.msg import View
    from boxgrasp_msgs.srv import SelectGrasp
    from rclpy.action import ActionClient
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from scenes import cloud, pixel_target, table, transform
    from tf2_msgs.msg import TFMessage
    from waiting import call, wait_for

    capture, rng = half(table()), random.Random(1)
    view, target = View(cloud=cloud(capture, 10**9)), pixel_target(capture)
    first, held, answered, lost = 100, {}, 0, 0
    with _node.running() as (process, client):
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        transforms = client.create_publisher(TFMessage, "/tf_static", latched)
        transforms.publish(transform(np.asarray(capture.T_base_camera), 0))
        select = client.create_client(SelectGrasp, "/grasp_selector/select")
        action = ActionClient(client, SelectGraspAction, "/grasp_selector/select")
        call(select, SelectGrasp.Request(view=view, target=target), 90)
        action.wait_for_server()
        for number in range(1, count + 1):
            while True:
                try:
                    if number % 10 == 0:
                        broken = malformed.random_view(rng)
                        wait_for(select.call_async(SelectGrasp.Request(view=broken)), 5)
                        break
                    if number % 2:
                        asked = SelectGrasp.Request(view=view, target=target)
                        reply = wait_for(select.call_async(asked), 5)
                    else:
                        goal = SelectGraspAction.Goal(view=view, target=target)
                        handle = wait_for(action.send_goal_async(goal), 5)
                        reply = wait_for(handle.get_result_async(), 5).result
                    answered += reply.status.code == 0
                    break
                except AssertionError:
                    lost += 1
            if number == first or number % 200 == 0 or number == count:
                held[number] = _node.resident_mib(process.pid)
                print(f"after {number:5d} selections {held[number]:7.1f} MiB", flush=True)
    print(f"answered {answered} of {count}, a tenth malformed; lost on the way {lost}")
    print(f"after {count} over after {first}: {held[count] / held[first]:.3f}")


def half(capture: Capture) -> Capture:
    """Every second row and column of a capture."""
    K = np.array(capture.intrinsics)
    K[:2] /= 2
    u, v = capture.target_pixel
    pixel = (u // 2, v // 2)
    depth, rgb = capture.depth[::2, ::2], capture.rgb[::2, ::2]
    return Capture(depth, K, capture.T_base_camera, rgb, target_pixel=pixel)


if __name__ == "__main__":
    main()
