"""A ROS domain for one run alone, whatever else runs on this machine."""

from __future__ import annotations

import fcntl
import itertools
import os
import tempfile
from pathlib import Path

# Above 101 a participant's ports lie where the system hands out its own.
DOMAINS = range(1, 102)

_turns = itertools.count(os.getpid())


def free_domain() -> tuple[int, int]:
    """A domain that no other run on this machine holds, and the file that holds it."""
    for _ in DOMAINS:
        domain = DOMAINS[next(_turns) % len(DOMAINS)]
        name = f"boxgrasp-ros-domain-{domain}.lock"
        try:
            held = os.open(Path(tempfile.gettempdir(), name), os.O_CREAT | os.O_RDWR, 0o666)
        except PermissionError:  # another user's
            continue
        try:
            fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(held)
        else:
            return domain, held
    raise RuntimeError("every ROS domain is held by another run of these tests")
