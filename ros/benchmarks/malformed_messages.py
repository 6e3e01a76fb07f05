"""Random and malformed messages through the node's own callbacks; counts how requests ended.

    .venv-ros/bin/python ros/benchmarks/malformed_messages.py [--messages 10000] [--seed 1]

Half of them come on topics, half as requests. A traceback ends the run.
"""

from __future__ import annotations

import argparse
import random

import _node  # noqa: F401 - finds the tests' modules, and keeps to the loopback
import rclpy


def main() -> None:
    """Send and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--messages", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    from boxgrasp_ros.grasp_selector import GraspSelectorNode
    from rclpy.parameter import Parameter
    from test_malformed import survived

    rclpy.init(args=[])
    quick = [Parameter(f"wait_for_{what}_s", value=0.0) for what in ("view", "transform")]
    node = GraspSelectorNode(parameter_overrides=quick)
    counts = survived(node, random.Random(args.seed), args.messages // 2)
    node.destroy_node()
    rclpy.shutdown()
    print(f"{args.messages} messages survived, the requests among them ended as")
    for name, number in counts.items():
        print(f"  {name:18} {number:6d}")


if __name__ == "__main__":
    main()
