"""The node in a process of its own, and a client of it; what the benchmarks share."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "ros" / "test"))
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"

import rclpy  # noqa: E402
import setup_env  # noqa: E402
from domains import free_domain  # noqa: E402
from rclpy.executors import SingleThreadedExecutor  # noqa: E402
from rclpy.node import Node  # noqa: E402

DOMAIN, _HELD = free_domain()  # held until the process ends
os.environ["ROS_DOMAIN_ID"] = str(DOMAIN)
if Path(sys.prefix).resolve() == setup_env.ENV:
    setup_env.refresh_packages()  # what is measured is what the sources say


@contextmanager
def running(*arguments: str) -> Iterator[tuple[subprocess.Popen[bytes], Node]]:
    """The console script with parameters, and a client node that a thread spins.

    Args:
        arguments: of ROS, as `-p name:=value`.

    Yields:
        The process and the client.
    """
    import threading

    script = Path(sys.prefix, "lib", "boxgrasp_ros", "grasp_selector")
    process = subprocess.Popen([str(script), "--ros-args", *arguments])
    rclpy.init(args=[])
    client = Node("benchmark")
    executor = SingleThreadedExecutor()
    executor.add_node(client)
    thread = threading.Thread(target=executor.spin, daemon=True)
    thread.start()
    try:
        yield process, client
    finally:
        process.terminate()
        process.wait()
        executor.shutdown()
        thread.join()
        client.destroy_node()
        rclpy.try_shutdown()


def resident_mib(pid: int) -> float:
    """Memory that a process holds now.

    Args:
        pid: of the process.

    Returns:
        MiB, as Linux counts what is resident.
    """
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 2**20
