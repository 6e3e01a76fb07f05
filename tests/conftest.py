from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

# Where a shell started the suite in the background, Ctrl-C is ignored here and by every child.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

_BESIDE = Path(__file__).resolve().parents[2] / "shared"
_FORKS = "test_concurrency.py"


@pytest.fixture(scope="session")
def captures_dir() -> Path:
    """The folder of real captures, which do not ship with the package."""
    folder = Path(os.environ.get("BOXGRASP_CAPTURES", _BESIDE / "captures"))
    if not folder.is_dir():
        pytest.skip(f"no real captures in {folder} (set BOXGRASP_CAPTURES)")
    return folder


@pytest.fixture(scope="session")
def labeled_dir() -> Path:
    """The folder of real captures with true labels, which do not ship with the package."""
    folder = Path(os.environ.get("BOXGRASP_LABELED", _BESIDE / "osd"))
    if not folder.is_dir():
        pytest.skip(f"no labeled captures in {folder} (set BOXGRASP_LABELED)")
    return folder


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """The file that forks comes first, before another one leaves threads that a fork loses.

    Then those with slow tests, or one process would wait for the other at the end.
    """
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: (item.path.name != _FORKS, item.path not in slow))
