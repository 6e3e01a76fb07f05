"""One depth view in, one checked gripper pose out (docs/conventions.md has the words)."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from boxgrasp.version import __version__

if TYPE_CHECKING:
    from boxgrasp.config import Config, load_config
    from boxgrasp.errors import BoxgraspError
    from boxgrasp.grasps.gripper import Gripper
    from boxgrasp.io.load import load_capture
    from boxgrasp.perception.target import Target
    from boxgrasp.result import Selection
    from boxgrasp.selector import GraspSelector, default_checks
    from boxgrasp.sensing.capture import Capture

__all__ = [
    "BoxgraspError",
    "Capture",
    "Config",
    "GraspSelector",
    "Gripper",
    "Selection",
    "Target",
    "__version__",
    "default_checks",
    "load_capture",
    "load_config",
]

_HOMES = {
    "BoxgraspError": "errors",
    "Capture": "sensing.capture",
    "Config": "config",
    "GraspSelector": "selector",
    "Gripper": "grasps.gripper",
    "Selection": "result",
    "Target": "perception.target",
    "default_checks": "selector",
    "load_capture": "io.load",
    "load_config": "config",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first asked for, so that `--version` pays for none."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
