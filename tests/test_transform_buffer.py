"""Transforms out of messages, against scipy's rotations; needs no ROS."""

from __future__ import annotations

import pickle
import threading
import time
import warnings
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

import boxgrasp.io.frames as frames
from boxgrasp.errors import BoxgraspError, TransformError
from boxgrasp.io.frames import TransformBuffer

S = 1_000_000_000
quick = settings(max_examples=80, deadline=None)
seeds = st.integers(0, 2**32 - 1)


def stamped(
    parent: str,
    child: str,
    stamp: int,
    xyz: Any = (0.0, 0.0, 0.0),
    quaternion: Any = (0.0, 0.0, 0.0, 1.0),
    *,
    ros1: bool = False,
) -> Message:
    names = ("secs", "nsecs") if ros1 else ("sec", "nanosec")
    return Message(
        header=Message(
            frame_id=parent, stamp=Message(**dict(zip(names, divmod(stamp, S), strict=True)))
        ),
        child_frame_id=child,
        transform=Message(
            translation=Message(**dict(zip("xyz", xyz, strict=True))),
            rotation=Message(**dict(zip("xyzw", quaternion, strict=True))),
        ),
    )


def told(*transforms: Message) -> Message:
    return Message(transforms=list(transforms))


def filled(*transforms: Message, static: bool = False, keep_s: float = 10.0) -> TransformBuffer:
    buffer = TransformBuffer(keep_s)
    buffer.add(told(*transforms), static)
    return buffer


def refused(call: Any, *given: Any) -> TransformError:
    with pytest.raises(TransformError) as caught:
        call(*given)
    said = str(caught.value)
    assert said.isprintable() and len(said) < 500
    return caught.value


def moved(xyz: Any, rotation: Rotation) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation.as_matrix(), xyz
    return T


# What messages say is what is found.


class Truth:
    """A random tree of frames with samples, kept by scipy."""

    def __init__(self, seed: int, count: int) -> None:
        rng = np.random.default_rng(seed)
        self.parents = [None, *(int(rng.integers(0, i)) for i in range(1, count))]
        self.static = [bool(rng.random() < 0.3) for _ in range(count)]
        self.stamps, self.xyz, self.turns = [], [], []
        for i in range(count):
            samples = 1 if self.static[i] else int(rng.integers(2, 6))
            inner = rng.integers(1, 3 * S, samples - 1)
            stamps = np.sort(np.append(inner, 3 * S)) if samples > 1 else np.array([0])
            if samples > 1:
                stamps[0] = 0
            self.stamps.append(stamps)
            self.xyz.append(rng.normal(0, 2, (samples, 3)))
            small = Rotation.random(random_state=seed % 2**31 + i)
            steps = Rotation.from_rotvec(
                rng.normal(0, rng.choice([1e-12, 1e-6, 0.1, 1]), (samples, 3))
            )
            self.turns.append(small * steps)
        self.rng = rng

    def messages(self) -> list[tuple[Message, bool]]:
        found = []
        for i, parent in enumerate(self.parents):
            if parent is None:
                continue
            for stamp, xyz, q in zip(
                self.stamps[i], self.xyz[i], self.turns[i].as_quat(), strict=True
            ):
                q = q * self.rng.choice([-1, 1]) * self.rng.uniform(0.995, 1.005)
                one = stamped(f"f{parent}", f"/f{i}", int(stamp) + 50 * S, xyz, q)
                found.append((told(one), self.static[i]))
        return [found[k] for k in self.rng.permutation(len(found))]

    def at(self, i: int, time_ns: int) -> np.ndarray:
        """T_parent_frame; samples all span 0 to 3 s."""
        if self.static[i]:
            return moved(self.xyz[i][0], self.turns[i][0])
        stamps = (self.stamps[i] / S).astype(float)
        t = time_ns / S
        turn = Slerp(stamps, self.turns[i])(t)
        return moved([np.interp(t, stamps, column) for column in self.xyz[i].T], turn)

    def in_root(self, i: int, time_ns: int) -> np.ndarray:
        T = np.eye(4)
        while self.parents[i] is not None:
            T = self.at(i, time_ns) @ T
            i = self.parents[i]
        return T


@quick
@given(seed=seeds, count=st.integers(2, 12), data=st.data())
def test_any_tree_gives_what_scipy_gives(seed, count, data):
    truth = Truth(seed, count)
    buffer = TransformBuffer()
    for message, static in truth.messages():
        buffer.add(message, static)
    for _ in range(4):
        target, source = (data.draw(st.integers(0, count - 1)) for _ in range(2))
        time_ns = data.draw(st.integers(0, 3 * S) | st.sampled_from([0, 3 * S]))
        found = buffer.lookup(f"f{target}", f"f{source}", 50 * S + time_ns)
        expected = np.linalg.inv(truth.in_root(target, time_ns)) @ truth.in_root(source, time_ns)
        np.testing.assert_allclose(found, expected, atol=1e-6)
        assert found.dtype == np.float64 and not found.flags.writeable
        np.testing.assert_allclose(found[:3, :3] @ found[:3, :3].T, np.eye(3), atol=1e-12)


@quick
@given(seed=seeds, share=st.floats(0, 1))
def test_turns_lie_on_the_shorter_arc_at_a_steady_rate(seed, share):
    two = Rotation.random(2, random_state=seed % 2**31)
    p, q = two.as_quat()
    time_ns = round(share * S)
    buffer = filled(stamped("a", "b", 0, quaternion=p), stamped("a", "b", S, quaternion=-q))
    expected = Slerp([0, 1], two)(time_ns / S).as_matrix()
    np.testing.assert_allclose(buffer.lookup("a", "b", time_ns)[:3, :3], expected, atol=1e-9)


def test_a_transform_maps_source_coordinates_into_the_target():
    turn = Rotation.from_euler("z", 90, degrees=True)
    buffer = filled(stamped("base", "camera", S, (1, 2, 3), turn.as_quat(), ros1=True))
    np.testing.assert_allclose(
        buffer.lookup("base", "camera", S) @ [1, 0, 0, 1], [1, 3, 3, 1], atol=1e-12
    )
    np.testing.assert_allclose(
        buffer.lookup("/camera", "/base", S) @ [1, 3, 3, 1], [1, 0, 0, 1], atol=1e-12
    )
    np.testing.assert_array_equal(buffer.lookup("base", "base", 7), np.eye(4))


# Time.


def test_static_transforms_hold_for_all_time_and_the_last_counts():
    buffer = filled(stamped("a", "b", 5 * S, (1, 0, 0)), static=True)
    for stamp in (0, 5 * S, 2**62):
        assert buffer.lookup("a", "b", stamp)[0, 3] == 1
    buffer.add(told(stamped("a", "b", S, (2, 0, 0))), True)
    assert buffer.lookup("a", "b", 0)[0, 3] == 2
    buffer.add(told(stamped("a", "b", S, (3, 0, 0))), False)  # now it moves
    assert buffer.lookup("a", "b", S)[0, 3] == 3
    assert refused(buffer.lookup, "a", "b", 0).code == "too_old"


def test_nothing_is_extrapolated():
    buffer = filled(*(stamped("a", "b", t, (t / S, 0, 0)) for t in (2 * S, 4 * S)))
    assert buffer.lookup("a", "b", 3 * S)[0, 3] == 1.5 * 2
    early = refused(buffer.lookup, "a", "b", 2 * S - 1)
    assert early.code == "too_old" and "'b' is kept from 2.000000000 s on" in str(early)
    assert "from frame 'b' to 'a' at 1.999999999 s" in str(early)
    late = refused(buffer.lookup, "a", "b", 4 * S + 1)
    assert late.code == "too_new" and "'b' is known up to 4.000000000 s" in str(late)
    one = filled(stamped("a", "b", 2 * S))
    assert refused(one.lookup, "a", "b", S).code == "too_old"
    assert refused(one.lookup, "a", "b", 3 * S).code == "too_new"


def test_samples_may_come_late_and_of_one_time_the_last_counts():
    buffer = filled(*(stamped("a", "b", t * S, (t, 0, 0)) for t in (1, 5, 3)))
    buffer.add(told(stamped("a", "b", 3 * S, (9, 0, 0))), False)
    assert buffer.lookup("a", "b", 3 * S)[0, 3] == 9
    assert buffer.lookup("a", "b", 4 * S)[0, 3] == 7


def test_history_is_kept_for_a_while():
    buffer = filled(*(stamped("a", "b", t * S) for t in range(31)), keep_s=10)
    buffer.lookup("a", "b", 20 * S)
    assert refused(buffer.lookup, "a", "b", 20 * S - 1).code == "too_old"
    assert len(buffer._histories["b"].stamps) == 11


def test_time_that_jumps_back_clears_the_frame():
    buffer = filled(stamped("a", "b", 100 * S, (1, 0, 0)), stamped("a", "b", 101 * S, (1, 0, 0)))
    buffer.add(told(stamped("a", "b", 5 * S, (2, 0, 0))), False)  # a bag begins anew
    assert buffer.lookup("a", "b", 5 * S)[0, 3] == 2
    assert refused(buffer.lookup, "a", "b", 100 * S).code == "too_new"


def test_histories_and_frames_are_bounded(monkeypatch):
    monkeypatch.setattr(frames, "_MOST_SAMPLES", 50)
    monkeypatch.setattr(frames, "_MOST_FRAMES", 3)
    buffer = TransformBuffer()
    for i in range(200):
        buffer.add(told(stamped("a", "b", i)), False)
    assert len(buffer._histories["b"].samples) == len(buffer._histories["b"].stamps) == 50
    buffer.lookup("a", "b", 150)
    many = told(*(stamped("a", f"c{i}", 0) for i in range(5)))
    error = refused(buffer.add, many, True)
    assert error.code == "malformed" and "one more than 3" in str(error)
    assert len(buffer._histories) == 3
    buffer.add(told(stamped("a", "b", 300)), False)  # those that are known go on


# The tree.


def test_a_frame_counts_under_the_parent_it_had_then():
    buffer = filled(
        *(stamped("room", "p", t * S, (1, 0, 0)) for t in (0, 9)),
        *(stamped("room", "q", t * S, (2, 0, 0)) for t in (0, 9)),
        stamped("p", "cup", 1 * S, (0.1, 0, 0)),
        stamped("p", "cup", 3 * S, (0.3, 0, 0)),
        stamped("q", "cup", 5 * S, (0.5, 0, 0)),
        stamped("q", "cup", 7 * S, (0.7, 0, 0)),
    )  # fmt: skip
    for t, x in ((2, 1.2), (3, 1.3), (4, 1.3), (5, 2.5), (6, 2.6)):  # at 4 it is still under p
        assert buffer.lookup("room", "cup", t * S)[0, 3] == pytest.approx(x)


def test_only_the_way_between_two_frames_needs_its_time():
    buffer = filled(
        stamped("map", "base", 1 * S),  # stale
        *(stamped("base", name, t * S, (1, 0, 0)) for name in ("arm", "eye") for t in (5, 6)),
    )
    np.testing.assert_array_equal(buffer.lookup("arm", "eye", 5 * S), np.eye(4))
    assert refused(buffer.lookup, "map", "eye", 5 * S).code == "too_new"
    # A wait does not help the eye, whatever is wanting above the base.
    buffer.add(told(*(stamped("map", "base", t * S) for t in (8, 9))), False)
    assert refused(buffer.lookup, "arm", "eye", 4 * S).code == "too_old"
    # It does help where what is too old lies above both.
    assert refused(buffer.lookup, "arm", "eye", 7 * S).code == "too_new"


def test_frames_that_are_not_there_or_not_connected_are_named():
    buffer = filled(stamped("a", "b", 0), stamped("x", "y", 0), static=True)
    error = refused(buffer.lookup, "a", "c", 0)
    assert error.code == "unknown_frame" and "frame 'c' is unknown; known: b, y" in str(error)
    assert refused(buffer.lookup, "nothing", "nothing", 0).code == "unknown_frame"
    assert refused(TransformBuffer().lookup, "a", "b", 0).code == "unknown_frame"
    error = refused(buffer.lookup, "a", "y", 0)
    assert error.code == "not_connected" and "from frame 'y' to 'a'" in str(error)
    buffer.add(told(stamped("b", "x", 5 * S)), False)
    assert refused(buffer.lookup, "a", "y", 0).code == "too_old"
    buffer.lookup("a", "y", 5 * S)


def test_a_loop_is_refused_until_what_makes_it_is_gone():
    buffer = filled(stamped("a", "b", 0), stamped("b", "c", 0))
    error = refused(buffer.add, told(stamped("c", "a", 0)), False)
    assert error.code == "malformed" and "'a' under 'c' closes a loop" in str(error)
    buffer.lookup("a", "c", 0)
    buffer.add(told(stamped("c", "a", 60 * S)), False)
    buffer.lookup("c", "a", 60 * S)


def test_a_loop_of_late_samples_ends():
    buffer = filled(stamped("p", "c", 1 * S), stamped("c", "p", 20 * S))
    assert refused(buffer.lookup, "p", "q", 1 * S).code == "unknown_frame"
    buffer = filled(stamped("r", "c", 9 * S), stamped("p", "c", 1 * S), stamped("c", "p", 1 * S))
    assert refused(buffer.lookup, "r", "p", 1 * S).code in ("too_old", "not_connected")


# Waiting.


def test_wait_returns_as_soon_as_the_transform_is_there():
    buffer = filled(stamped("a", "b", 0))

    def later() -> None:
        time.sleep(0.05)
        buffer.add(told(stamped("a", "b", S)), False)
        buffer.add(told(stamped("a", "b", 2 * S)), False)

    thread = threading.Thread(target=later)
    start = time.monotonic()
    thread.start()
    buffer.wait("a", "b", 1_500_000_000, 30.0)
    assert time.monotonic() - start < 10
    thread.join()


def test_wait_ends_in_time_and_at_once_where_waiting_cannot_help():
    buffer = filled(stamped("a", "b", 5 * S))
    start = time.monotonic()
    assert refused(buffer.wait, "a", "b", 6 * S, 0.05).code == "too_new"
    assert time.monotonic() - start >= 0.05
    assert refused(buffer.wait, "a", "z", 6 * S, 0.01).code == "unknown_frame"
    assert refused(buffer.wait, "a", "b", 0, float("inf")).code == "too_old"
    for never in (0.0, -1.0, float("nan")):
        assert refused(buffer.wait, "a", "b", 6 * S, never).code == "too_new"


def test_threads_may_add_and_look_up_at_once():
    buffer = TransformBuffer(keep_s=0.01)
    stop, faults = threading.Event(), []

    def reader() -> None:
        while not stop.is_set():
            for stamp in (0, 10_000_000, 25_000_000):
                try:
                    T = buffer.lookup("a", "c", stamp)
                except TransformError:
                    continue
                if abs(T[0, 3] - 2 * stamp / S) > 1e-9:
                    faults.append((stamp, T[0, 3]))

    threads = [threading.Thread(target=reader) for _ in range(3)]
    for thread in threads:
        thread.start()
    for i in range(2000):
        stamp = i * 20_000
        xyz = (stamp / S, 0, 0)
        buffer.add(told(stamped("a", "b", stamp, xyz), stamped("b", "c", stamp, xyz)), False)
    stop.set()
    for thread in threads:
        thread.join()
    assert not faults


# What is malformed is refused; the rest of its message counts.

BAD = {
    "not finite": ({"xyz": (np.nan, 0, 0)}, "'bad' at"),
    "infinite": ({"xyz": (0, np.inf, 0)}, "'bad' at"),
    "far": ({"xyz": (0, 0, 1e10)}, "'bad' at"),
    "a turn that is not finite": ({"quaternion": (np.nan, 0, 0, 1)}, "turned by"),
    "no turn": ({"quaternion": (0, 0, 0, 0)}, "quaternion of length 0; valid: 1"),
    "a long turn": ({"quaternion": (0, 0, 0, 1.011)}, "quaternion of length 1.011"),
    "a word": ({"xyz": ("1", 0, 0)}, "xyz of ['1', 0, 0]; valid: numbers"),
    "nothing": ({"xyz": (None, 0, 0)}, "valid: numbers"),
    "huge": ({"xyz": (10**400, 0, 0)}, "valid: numbers"),
    "no child": ({"child": ""}, "valid: two names"),
    "slashes": ({"child": "//"}, "valid: two names"),
    "no parent": ({"parent": ""}, "valid: two names"),
    "itself": ({"child": "a", "parent": "/a"}, "valid: two names"),
    "a long name": ({"child": "x" * 1001}, "valid: two names"),
    "no words": ({"child": "a\n\x1b[31m"}, "valid: two names"),
    "no name": ({"child": 3}, "child_frame_id of type int; valid: text"),
    "a stamp": ({"stamp": -1}, "sec -1"),
}


@pytest.mark.parametrize("name", BAD)
def test_malformed_transforms_are_refused_and_sound_ones_taken(name):
    changes, said = BAD[name]
    bad = stamped(**{"parent": "a", "child": "bad", "stamp": 0, **changes})
    buffer = TransformBuffer()
    error = refused(buffer.add, told(stamped("a", "b", 0), bad, stamped("b", "c", 0)), False)
    assert error.code == "malformed" and said in str(error)
    buffer.lookup("a", "c", 0)
    assert set(buffer._histories) == {"b", "c"}


@pytest.mark.parametrize("message", [None, 3, Message(), Message(transforms=7), told(None, 4)])
def test_what_is_no_message_of_transforms_is_refused(message):
    assert refused(TransformBuffer().add, message, False).code == "malformed"


def test_keep_s_is_a_time():
    for bad in (0, -1, float("nan"), float("inf")):
        assert refused(TransformBuffer, bad).code == "malformed"


def test_the_error_is_one_of_ours_and_travels():
    error = TransformError("too_new", "said")
    again = pickle.loads(pickle.dumps(error))
    assert isinstance(again, BoxgraspError) and (again.code, str(again)) == ("too_new", "said")


anything = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**80), 2**80),
    st.floats(),
    st.text(max_size=3),
    st.binary(max_size=3),
    st.lists(st.integers(), max_size=3),
)


@settings(max_examples=300, deadline=None)
@given(data=st.data(), static=st.booleans())
def test_any_message_is_taken_or_refused_as_malformed(data, static):
    """Few names and times, so that trees, loops and jumps arise; some fields are anything."""
    names = st.sampled_from(["a", "b", "/c", "d"])
    buffer = TransformBuffer()
    for _ in range(data.draw(st.integers(1, 8))):
        one = stamped(
            data.draw(names),
            data.draw(names),
            data.draw(st.integers(0, 40)) * S,
            data.draw(st.tuples(*[st.floats(-10, 10)] * 3)),
        )
        holders = [one, one.header, one.header.stamp, one.transform.rotation, one.transform]
        if data.draw(st.booleans()):
            holder = data.draw(st.sampled_from(holders))
            setattr(holder, data.draw(st.sampled_from(sorted(vars(holder)))), data.draw(anything))
        try:
            buffer.add(told(one), static)
        except TransformError as error:
            assert error.code == "malformed" and str(error).isprintable()
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            try:
                T = buffer.lookup(data.draw(names), data.draw(names), 20 * S)
            except TransformError as error:
                assert error.code != "malformed" and str(error).isprintable()
            else:
                assert np.isfinite(T).all()
