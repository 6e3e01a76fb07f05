"""Every test has a ROS domain of its own, on this machine alone, whatever else runs beside it."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import setup_env
from domains import free_domain

try:
    import rclpy
    from rclpy.executors import MultiThreadedExecutor
    from rclpy.node import Node
except ImportError as error:  # told by pytest_sessionstart: a skip would pass unseen
    NO_ROS: str | None = str(error)
else:
    NO_ROS = None

# Left from the shell, they would let tests reach the network, or another middleware's settings.
FOREIGN = (
    *("ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS", "ROS_DISCOVERY_SERVER", "ROS_DOMAIN_ID"),
    *("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE", "RMW_IMPLEMENTATION"),
)


def pytest_configure(config: pytest.Config) -> None:
    """Keep quiet about a library of the wheels that Python has outgrown."""
    config.addinivalue_line("filterwarnings", "ignore:module 'sre_:DeprecationWarning:lark")


def pytest_sessionstart() -> None:
    """Stop where there is no ROS, and never test what an earlier source built."""
    if NO_ROS is not None:
        pytest.exit(f"the ROS tests need rclpy ({NO_ROS}): make test-ros", returncode=2)
    if Path(sys.prefix).resolve() == setup_env.ENV:  # else an installed ROS, and what it built
        held = setup_env.lock()
        if not setup_env.is_complete():
            pytest.exit(f"{setup_env.ENV.name} is out of date: make setup-ros", returncode=2)
        try:
            setup_env.refresh_packages()
        except setup_env.SetupError as error:
            pytest.exit(str(error), returncode=2)
        os.close(held)
        os.environ["AMENT_PREFIX_PATH"] = sys.prefix
    for name in FOREIGN:
        os.environ.pop(name, None)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["RCUTILS_COLORIZED_OUTPUT"] = "0"


@pytest.fixture(scope="session", autouse=True)
def log_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where ROS logs, instead of the home folder."""
    folder = tmp_path_factory.mktemp("ros-log")
    os.environ["ROS_LOG_DIR"] = str(folder)
    return folder


@pytest.fixture
def domain_id() -> Iterator[int]:
    """A ROS domain for this test alone."""
    domain, held = free_domain()
    yield domain
    os.close(held)


@pytest.fixture
def other_domain_id() -> Iterator[int]:
    """Another one, which the test's context does not hear."""
    domain, held = free_domain()
    yield domain
    os.close(held)


@pytest.fixture
def ros_env(domain_id: int) -> dict[str, str]:
    """The environment for a process that shall meet this test's nodes."""
    return {**os.environ, "ROS_DOMAIN_ID": str(domain_id), "PYTHONUNBUFFERED": "1"}


@pytest.fixture
def context(domain_id: int) -> Iterator[rclpy.Context]:
    """An initialized context in the test's domain."""
    context = rclpy.Context()
    rclpy.init(args=[], context=context, domain_id=domain_id)
    yield context
    context.try_shutdown()


@pytest.fixture
def make_node(context: rclpy.Context) -> Iterator[Callable[..., Node]]:
    """Make a node that spins in other threads until the test ends.

    What a callback raised fails the test at its end. `make(name, type=Node, **settings)` makes a
    `type(name, context=context, **settings)`; `make.executor.add_node` takes one made elsewhere.
    """
    executor = MultiThreadedExecutor(num_threads=4, context=context)
    raised: list[BaseException] = []
    nodes: list[Node] = []
    stop = threading.Event()

    def spin() -> None:
        while not stop.is_set() and context.ok():
            try:
                executor.spin_once(timeout_sec=0.05)
            except Exception as error:
                if not stop.is_set():
                    raised.append(error)

    def make(name: str, type: Callable[..., Any] = Node, **settings: Any) -> Any:
        node = type(name, context=context, **settings)
        nodes.append(node)
        executor.add_node(node)
        return node

    make.executor = executor  # type: ignore[attr-defined]
    thread = threading.Thread(target=spin, name="executor", daemon=True)
    thread.start()
    yield make
    stop.set()
    executor.wake()
    thread.join(10)
    executor.shutdown(timeout_sec=5)
    for node in nodes:
        node.destroy_node()
    if raised:
        raise raised[0]
