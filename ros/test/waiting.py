"""Wait for what other threads and processes do."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, TypeVar

from rclpy.action.client import ClientGoalHandle
from rclpy.client import Client
from rclpy.task import Future

T = TypeVar("T")


def wait_until(done: Callable[[], T], seconds: float = 20.0, what: str = "") -> T:
    """What `done` returns, as soon as that is true; an AssertionError after `seconds`."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if result := done():
            return result
        time.sleep(0.01)
    raise AssertionError(f"{what or 'it'} did not happen within {seconds:g} s")


def wait_for(future: Future, seconds: float = 20.0) -> Any:
    """The result of a future that another thread's executor fulfills."""
    wait_until(future.done, seconds, "the answer")
    return future.result()


def result_of(handle: ClientGoalHandle, seconds: float = 40.0) -> Any:
    """What a goal ends with; asked again as a service is, see `call`."""
    until = time.monotonic() + seconds
    while True:
        try:
            return wait_for(handle.get_result_async(), min(5.0, seconds)).result
        except AssertionError:
            if time.monotonic() > until:
                raise


def call(client: Client, request: Any, seconds: float = 30.0) -> Any:
    """What a service answers.

    The first call after discovery can be lost, where the way back is not known yet; so it is
    asked again, as any client must.
    """
    assert client.wait_for_service(timeout_sec=seconds), f"nobody offers {client.srv_name}"
    until = time.monotonic() + seconds
    while True:
        future = client.call_async(request)
        try:
            return wait_for(future, min(5.0, seconds))
        except AssertionError:
            client.remove_pending_request(future)
            if time.monotonic() > until:
                raise
