"""Memory over many selections: within 10 % of what it was after the first hundred.

    .venv-ros/bin/python ros/benchmarks/long_run.py [--selections 2000]

The node runs in a process of its own; a client sends a cloud with every request, by service and by
action in turn, every tenth one malformed. Printed is what the process holds, MiB.
"""

from __future__ import annotations

import argparse
import random

import _node
import numpy as np


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

    capture, rng = table(), random.Random(1)
    view, target = View(cloud=cloud(capture, 10**9)), pixel_target(capture)
    first = 100
    with _node.running() as (process, client):
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        transforms = client.create_publisher(TFMessage, "/tf_static", latched)
        transforms.publish(transform(np.asarray(capture.T_base_camera), 0))
        select = client.create_client(SelectGrasp, "/grasp_selector/select")
        action = ActionClient(client, SelectGraspAction, "/grasp_selector/select")
        held, answered = {}, 0
        call(select, SelectGrasp.Request(view=view, target=target), 90)
        action.wait_for_server()
        for number in range(1, count + 1):
            if number % 10 == 0:
                asked = SelectGrasp.Request(view=malformed.random_view(rng), target=target)
                call(select, asked)
            elif number % 2:
                reply = call(select, SelectGrasp.Request(view=view, target=target))
                answered += reply.status.code == 0
            else:
                goal = SelectGraspAction.Goal(view=view, target=target)
                handle = wait_for(action.send_goal_async(goal))
                result = wait_for(handle.get_result_async()).result
                answered += result.status.code == 0
            if number in (first, count) or number % 500 == 0:
                held[number] = _node.resident_mib(process.pid)
                print(f"after {number:5d} selections {held[number]:7.1f} MiB", flush=True)
    print(f"answered {answered} of {count}, a tenth malformed")
    print(f"after {count} over after {first}: {held[count] / held[first]:.3f}")


if __name__ == "__main__":
    main()
