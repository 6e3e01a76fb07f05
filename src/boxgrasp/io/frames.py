"""Transforms between frames at a time, out of TF messages, whoever decoded them; needs no ROS.

As tf2 keeps them: a tree of frames, each with its own history under the parent of each sample.
"""

from __future__ import annotations

import math
import threading
import time
from bisect import bisect_left
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

import numpy as np

from boxgrasp.arrays import Floats, readonly
from boxgrasp.errors import CaptureError, TransformError
from boxgrasp.forks import held_at_fork
from boxgrasp.geometry.transforms import invert, make_transform, rotation_of
from boxgrasp.io.fields import field_of, frame_id_of, stamp_ns, text_of

_MOST_FRAMES: Final = 10_000
_MOST_SAMPLES: Final = 20_000  # of a frame: 2 kHz for 10 s
_LONGEST_NAME: Final = 1000  # characters
_FARTHEST_M: Final = 1e9  # beyond it a float64 leaves no tenth of a micrometer
_NORM_TOLERANCE: Final = 1e-2  # of a quaternion's length from 1
_HEALING: Final = ("unknown_frame", "not_connected", "too_new")  # what a later message may mend


class _Sample(NamedTuple):
    """Where a frame was at one time: T_parent_frame in parts."""

    parent: str
    translation: tuple[float, ...]
    rotation: tuple[float, ...]  # unit quaternion x, y, z, w

    def matrix(self) -> Floats:
        return make_transform(rotation_of(self.rotation), self.translation)


class _Failure(NamedTuple):
    """Where a way up the tree ended for want of a sample at the time asked for."""

    frame: str
    error: TransformError


class _History:
    """The samples of one frame in the order of their times, or the one that holds for all time."""

    def __init__(self, static: bool) -> None:
        self.static = static
        self.stamps: list[int] = []
        self.samples: list[_Sample] = []

    def put(self, stamp: int, sample: _Sample, keep_ns: int) -> None:
        if self.static or (self.stamps and stamp < self.stamps[-1] - keep_ns):  # time jumped back
            self.stamps, self.samples = [], []
        at = bisect_left(self.stamps, stamp)
        if at < len(self.stamps) and self.stamps[at] == stamp:
            self.samples[at] = sample
        else:
            self.stamps.insert(at, stamp)
            self.samples.insert(at, sample)
        oldest = bisect_left(self.stamps, self.stamps[-1] - keep_ns)
        oldest = max(oldest, len(self.stamps) - _MOST_SAMPLES)
        del self.stamps[:oldest], self.samples[:oldest]

    def at(self, frame: str, stamp: int) -> tuple[str, Floats]:
        """Parent and T_parent_frame at a time, never extrapolated."""
        after = bisect_left(self.stamps, stamp)
        if self.static or (after < len(self.stamps) and self.stamps[after] == stamp):
            sample = self.samples[0 if self.static else after]
            return sample.parent, sample.matrix()
        if after == 0:
            raise TransformError(
                "too_old", f"frame {frame!r:.60} is kept from {_seconds(self.stamps[0])} on"
            )
        if after == len(self.stamps):
            raise TransformError(
                "too_new", f"frame {frame!r:.60} is known up to {_seconds(self.stamps[-1])}"
            )
        old, new = self.samples[after - 1], self.samples[after]
        if old.parent != new.parent:
            return old.parent, old.matrix()
        share = (stamp - self.stamps[after - 1]) / (self.stamps[after] - self.stamps[after - 1])
        return old.parent, _between(old, new, share).matrix()


class TransformBuffer:
    """What the messages on /tf and /tf_static say, kept for a while; safe from several threads."""

    def __init__(self, keep_s: float = 10.0) -> None:
        """Start with no frame.

        Args:
            keep_s: how long a frame's samples are kept, s before its newest; a sample older than
                that is taken as a clock that was set back, and clears the frame's history.

        Raises:
            TransformError: no time above 0.
        """
        if not (math.isfinite(keep_s) and keep_s > 0):
            raise TransformError("malformed", f"keep_s is {keep_s}; valid: seconds above 0")
        self._keep_ns = round(keep_s * 1e9)
        self._histories: dict[str, _History] = {}
        self._changed = held_at_fork(threading.Condition())

    def add(self, message: Any, static: bool) -> None:
        """Take the transforms of a message; of one time and frame the last counts.

        Args:
            message: a tf2_msgs/TFMessage, any object with its fields.
            static: whether they hold for all time, as those on /tf_static do.

        Raises:
            TransformError: some of its transforms are malformed; the sound ones are taken.
        """
        faults: list[TransformError] = []
        found = list(_samples_of(message, static, faults))
        with self._changed:
            for child, stamp, sample in found:
                try:
                    self._put(child, stamp, sample, static)
                except TransformError as error:
                    faults.append(error)
            self._changed.notify_all()
        if faults:
            more = f" (and {len(faults) - 1} more)" if len(faults) > 1 else ""
            raise TransformError("malformed", f"{faults[0]}{more}")

    def lookup(self, target_frame: str, source_frame: str, stamp_ns: int) -> Floats:
        """Where a frame is in another at a time: translations lie between samples, turns by slerp.

        Args:
            target_frame: into which coordinates are mapped.
            source_frame: out of which.
            stamp_ns: the time, ns; nothing is extrapolated.

        Returns:
            (4, 4) float64 T_target_source, m, read-only.

        Raises:
            TransformError: it is not known; `code` says why.
        """
        with self._changed:
            return self._lookup(target_frame.lstrip("/"), source_frame.lstrip("/"), stamp_ns)

    def wait(self, target_frame: str, source_frame: str, stamp_ns: int, timeout_s: float) -> Floats:
        """As `lookup`, but wait for the messages that are still missing.

        Args:
            target_frame: into which coordinates are mapped.
            source_frame: out of which.
            stamp_ns: the time, ns.
            timeout_s: how long at most, s.

        Returns:
            (4, 4) float64 T_target_source, m, read-only.

        Raises:
            TransformError: it is not known in time, or no message can make it known.
        """
        end = time.monotonic() + timeout_s
        with self._changed:
            while True:
                try:
                    return self.lookup(target_frame, source_frame, stamp_ns)
                except TransformError as error:
                    left = end - time.monotonic()
                    if error.code not in _HEALING or not left > 0:
                        raise
                self._changed.wait(min(left, threading.TIMEOUT_MAX))

    def _put(self, child: str, stamp: int, sample: _Sample, static: bool) -> None:
        history = self._histories.get(child)
        if history is None and len(self._histories) >= _MOST_FRAMES:
            raise TransformError(
                "malformed", f"frame {child!r:.60} is one more than {_MOST_FRAMES}; valid: as many"
            )
        if self._leads_to(child, sample.parent, stamp, static):
            raise TransformError(
                "malformed", f"frame {child!r:.60} under {sample.parent!r:.60} closes a loop"
            )
        if history is None or history.static != static:
            history = self._histories[child] = _History(static)
        history.put(stamp, sample, self._keep_ns)

    def _leads_to(self, child: str, frame: str, stamp: int, static: bool) -> bool:
        """Whether the newest parents lead from a frame up to a child that would come over it."""
        seen = set()
        while frame not in seen:
            if frame == child:
                return True
            seen.add(frame)
            history = self._histories.get(frame)
            if history is None:
                return False
            gone = not static and not history.static and history.stamps[-1] + self._keep_ns < stamp
            if gone:
                return False
            frame = history.samples[-1].parent
        return False

    def _lookup(self, target: str, source: str, stamp: int) -> Floats:
        up_source, failed_source = self._way_up(source, stamp)
        up_target, failed_target = self._way_up(target, stamp)
        common = next((frame for frame in up_source if frame in up_target), None)
        if common is not None and (target != source or self._knows(target)):
            return readonly(invert(up_target[common]) @ up_source[common])
        failures = [failure for failure in (failed_source, failed_target) if failure is not None]
        raise self._refusal(target, source, stamp, failures)

    def _way_up(self, frame: str, stamp: int) -> tuple[dict[str, Floats], _Failure | None]:
        """T_ancestor_frame of every ancestor at a time, and why there is no higher one, if so."""
        T = np.eye(4)
        found = {frame: T}
        while (history := self._histories.get(frame)) is not None:
            try:
                parent, T_parent_frame = history.at(frame, stamp)
            except TransformError as error:
                return found, _Failure(frame, error)
            if parent in found:  # frames changed places, and late samples made a loop
                break
            T = T_parent_frame @ T
            found[parent] = T
            frame = parent
        return found, None

    def _knows(self, frame: str) -> bool:
        histories = self._histories
        return frame in histories or any(
            history.samples[-1].parent == frame for history in histories.values()
        )

    def _refusal(
        self, target: str, source: str, stamp: int, failures: list[_Failure]
    ) -> TransformError:
        """Why there is no transform: an unknown frame, two trees, or a sample that is wanting."""
        asked = f"from frame {source!r:.60} to {target!r:.60} at {_seconds(stamp)}"
        for frame in (target, source):
            if not self._knows(frame):
                known = ", ".join(sorted(self._histories)[:8]) or "none"
                return TransformError(
                    "unknown_frame",
                    f"no transform {asked}: frame {frame!r:.60} is unknown; known: {known:.200}",
                )
        below = self._below_the_common(target, source)
        wanting = [failure for failure in failures if failure.frame in below]
        wanting.sort(key=lambda failure: failure.error.code == "too_new")  # no wait mends the other
        if not wanting:
            return TransformError(
                "not_connected", f"no transform {asked}: nothing connects the two frames then"
            )
        error = wanting[0].error
        return TransformError(error.code, f"no transform {asked}: {error}")

    def _below_the_common(self, target: str, source: str) -> set[str]:
        """Frames on the way between two by the newest parents; none where there is no way."""
        ups = [list(self._newest_up(frame)) for frame in (target, source)]
        both = set(ups[0]) & set(ups[1])
        if not both:
            return set()
        return {frame for up in ups for frame in up if frame not in both}

    def _newest_up(self, frame: str) -> Iterator[str]:
        seen = set()
        while frame not in seen:
            yield frame
            seen.add(frame)
            history = self._histories.get(frame)
            if history is None:
                return
            frame = history.samples[-1].parent


def _samples_of(
    message: Any, static: bool, faults: list[TransformError]
) -> Iterator[tuple[str, int, _Sample]]:
    """Child, time and sample of each sound transform of a message; adds to `faults` the others'."""
    transforms = getattr(message, "transforms", None)
    try:
        listed = list(transforms)  # type: ignore[arg-type]
    except TypeError:
        faults.append(_malformed(f"transforms of type {type(transforms).__name__}; valid: a list"))
        return
    for stamped in listed:
        try:
            yield _sample_of(stamped, static)
        except TransformError as error:
            faults.append(error)
        except CaptureError as error:
            faults.append(TransformError("malformed", f"transform is malformed: {error}"))


def _sample_of(stamped: Any, static: bool) -> tuple[str, int, _Sample]:
    child, parent = text_of(stamped, "child_frame_id").lstrip("/"), frame_id_of(stamped)
    sound = all(name.isprintable() and 0 < len(name) <= _LONGEST_NAME for name in (child, parent))
    if not sound or child == parent:
        raise _malformed(f"frame {child!r:.60} in {parent!r:.60}; valid: two names")
    stamp = 0 if static else stamp_ns(stamped)
    moved = field_of(stamped, "transform")
    translation = _numbers(field_of(moved, "translation"), "xyz")
    rotation = _numbers(field_of(moved, "rotation"), "xyzw")
    near = all(abs(value) <= _FARTHEST_M for value in translation)  # false for NaN
    if not near or not all(map(math.isfinite, rotation)):
        raise _malformed(f"frame {child!r:.60} at {translation} m, turned by {rotation}")
    norm = math.hypot(*rotation)
    if abs(norm - 1) > _NORM_TOLERANCE:
        raise _malformed(f"frame {child!r:.60} with a quaternion of length {norm:.4g}; valid: 1")
    unit = tuple(value / norm for value in rotation)
    return child, stamp, _Sample(parent, translation, unit)


def _numbers(vector: Any, names: str) -> tuple[float, ...]:
    values = [field_of(vector, name) for name in names]
    try:
        return tuple(float(value) if math.isfinite(value) else math.nan for value in values)
    except (TypeError, ValueError, OverflowError):
        raise _malformed(f"{names} of {values!r:.60}; valid: numbers") from None


def _malformed(what: str) -> TransformError:
    return TransformError("malformed", f"message of transforms has {what}")


def _between(old: _Sample, new: _Sample, share: float) -> _Sample:
    """Linear in the translation; along the shorter arc, at a steady rate, in the rotation."""
    translation = tuple(
        (1 - share) * a + share * b for a, b in zip(old.translation, new.translation, strict=True)
    )
    p, q = np.array(old.rotation), np.array(new.rotation)
    if float(p @ q) < 0:
        q = -q
    half = 2 * math.atan2(float(np.linalg.norm(p - q)), float(np.linalg.norm(p + q)))
    if half < 1e-9:  # rad; sines are their angles
        turned = (1 - share) * p + share * q
    else:
        turned = (math.sin((1 - share) * half) * p + math.sin(share * half) * q) / math.sin(half)
    turned = turned / np.linalg.norm(turned)
    return _Sample(old.parent, translation, tuple(turned.tolist()))


def _seconds(stamp: int) -> str:
    return f"{stamp // 1_000_000_000}.{stamp % 1_000_000_000:09d} s"
