"""The stand-in operator: what it sees, what it likes, that it is steady."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from boxgrasp.geometry.box import Box
from boxgrasp.geometry.transforms import make_transform
from boxgrasp.grasps.candidates import TOP_PARALLEL, candidates_of
from boxgrasp.grasps.gripper import Gripper
from boxgrasp.teaching.operators import Shown
from boxgrasp.teaching.stand_in import StandIn

STEADY = StandIn(judgment_sigma_m=0.0, mood_sigma_m=0.0)


def shown(size: tuple[float, float, float], points: np.ndarray | None = None) -> Shown:
    box = Box(make_transform(np.eye(3), (0.8, 0.0, 0.8 + size[2] / 2)), np.array(size))
    cloud = np.empty((0, 3), np.float32) if points is None else points.astype(np.float32)
    return Shown(box, candidates_of(box, Gripper()), cloud, 0.8, Gripper())


def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def test_alone_it_takes_the_middle_of_the_front() -> None:
    assert STEADY.label(shown((0.08, 0.08, 0.23)), rng()).label == 5


def test_with_the_front_blocked_it_goes_to_the_top() -> None:
    wall = np.stack(
        np.meshgrid([0.70], np.linspace(-0.1, 0.1, 40), np.linspace(0.8, 1.0, 40)), axis=-1
    ).reshape(-1, 3)
    label = STEADY.label(shown((0.08, 0.08, 0.23), wall), rng()).label
    assert label is not None
    assert (label - 1) // 3 + 1 == TOP_PARALLEL


@pytest.mark.parametrize("size", [(0.20, 0.04, 0.15), (0.04, 0.20, 0.15), (0.05, 0.05, 0.05)])
def test_it_never_opens_wider_than_it_can(size: tuple[float, float, float]) -> None:
    scene = shown(size)
    for seed in range(20):
        label = StandIn(mood_sigma_m=0.5).label(scene, np.random.default_rng(seed)).label
        assert label is not None
        assert scene.candidates.width_m[label - 1] <= 0.12


def test_what_no_hand_holds_is_a_request_for_help() -> None:
    assert STEADY.label(shown((0.2, 0.2, 0.1)), rng()).label is None


def test_it_sees_a_hand_in_the_table() -> None:
    flat = shown((0.05, 0.08, 0.02))
    label = STEADY.label(flat, rng()).label
    assert label is not None
    assert label > 9  # from above: a hand 7 cm thick has no place beside a thing of 2 cm


def test_the_same_day_it_says_the_same() -> None:
    scene = shown((0.08, 0.08, 0.23))
    said = [StandIn().label(scene, np.random.default_rng(7)).label for _ in range(3)]
    assert len(set(said)) == 1
    moods = {
        replace(STEADY, mood_sigma_m=0.05).label(scene, np.random.default_rng(s)).label
        for s in range(30)
    }
    assert len(moods) > 1


def test_it_says_that_it_is_a_stand_in() -> None:
    assert STEADY.label(shown((0.08, 0.08, 0.23)), rng()).source == "stand-in"
