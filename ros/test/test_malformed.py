"""The node survives whatever its messages' types allow; `ros/benchmarks` sends ten thousand."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Any

import malformed
from boxgrasp_msgs.msg import Status, View
from rig import NAMES, Rig
from scenes import camera_info, depth_image, pixel_target, table, transform

COUNT = 300  # of each kind
T0 = 5 * 10**9


def test_random_requests_and_messages_end_in_a_status(make_node: Callable[..., Any]) -> None:
    rig = Rig(make_node, wait_for_view_s=0.0, wait_for_transform_s=0.0)
    capture = table()
    rig.tell_transform(transform(capture.T_base_camera, T0), static=True)
    sound = View(depth=depth_image(capture, T0), camera_info=camera_info(capture, T0))
    before = rig.answer(sound, pixel_target(capture))
    counts = survived(rig.node, random.Random(7), COUNT)
    assert sum(counts.values()) == COUNT
    assert counts["FAILED"] == 0
    assert counts["SUCCEEDED"] < COUNT / 2 and counts["BAD_VIEW"] > 0 and counts["BAD_TARGET"] > 0
    after = rig.answer(sound, pixel_target(capture))
    assert after.pose == before.pose and after.candidates == before.candidates


def survived(node: Any, rng: random.Random, count: int) -> dict[str, int]:
    """How requests ended, each after a message on some topic; through the node's own callbacks."""
    from boxgrasp_msgs.srv import SelectGrasp

    takes = {
        subscription.topic_name.rsplit("/", 1)[1]: subscription.callback
        for subscription in node.subscriptions
    }
    counts = dict.fromkeys(NAMES.values(), 0)
    sound = transform(table().T_base_camera, T0)
    for _ in range(count):
        topic, message = malformed.random_message(rng)
        takes[topic](message)
        if rng.random() < 0.8:  # else most requests end for want of a pose
            takes["tf_static"](sound)
        request = SelectGrasp.Request(target=malformed.random_target(rng))
        if rng.random() < 0.8:
            request.view = malformed.random_view(rng)
        reply = node._on_select(request, SelectGrasp.Response())
        assert isinstance(reply.status, Status)
        assert reply.status.message.isprintable()
        counts[NAMES[reply.status.code]] += 1
    return counts
