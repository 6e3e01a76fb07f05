"""From the cloud in a request to the reply: transport, conversion and `select` told apart.

    .venv-ros/bin/python ros/benchmarks/request_time.py [--requests 30]

An organized cloud of 640 x 480 points, 16 bytes each (4.9 MB), is sent with each request to the
node in another process. Printed are medians, ms: of the whole round, of the node's own time from
the callback's start to its end, of `select` in it (as the answer's `timings_ms` say), of what the
node adds to that (conversion before, message after), and of the transport, which is the rest. The
node's time over `select`'s is the figure to watch: at most 1.3.
"""

from __future__ import annotations

import argparse
import statistics
import time

import _node
import numpy as np


def main() -> None:
    """Ask and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--requests", type=int, default=30)
    count = parser.parse_args().requests
    from boxgrasp_msgs.msg import View
    from boxgrasp_msgs.srv import SelectGrasp
    from rclpy.qos import DurabilityPolicy, QoSProfile
    from scenes import cloud, pixel_target, table, transform
    from tf2_msgs.msg import TFMessage
    from waiting import call

    capture = table()
    message = cloud(capture, 10**9)
    with _node.running() as (_, client):
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        transforms = client.create_publisher(TFMessage, "/tf_static", latched)
        transforms.publish(transform(np.asarray(capture.T_base_camera), 0))
        select = client.create_client(SelectGrasp, "/grasp_selector/select")
        request = SelectGrasp.Request(view=View(cloud=message), target=pixel_target(capture))
        rows = []
        for _ in range(count + 3):  # the first ones warm up
            start = time.perf_counter()
            reply = call(select, request, 90)
            whole = (time.perf_counter() - start) * 1e3
            assert reply.status.code == 0, reply.status.message
            timings = dict(
                zip(reply.selection.timing_stages, reply.selection.timings_ms, strict=True)
            )
            rows.append((whole, reply.status.elapsed_ms, timings["total"]))
    whole, node, select_ms = (statistics.median(column) for column in zip(*rows[3:], strict=True))
    added = statistics.median(row[1] - row[2] for row in rows[3:])
    print(f"{len(message.data) / 1e6:.1f} MB a request, {count} requests, medians:")
    print(f"  whole round          {whole:7.1f} ms")
    print(f"  transport            {statistics.median(r[0] - r[1] for r in rows[3:]):7.1f} ms")
    print(f"  node                 {node:7.1f} ms")
    print(f"  of it select         {select_ms:7.1f} ms")
    print(f"  of it conversion     {added:7.1f} ms")
    print(f"node over select       {statistics.median(r[1] / r[2] for r in rows[3:]):7.2f}")


if __name__ == "__main__":
    main()
