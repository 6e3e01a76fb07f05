"""One depth view in, one checked gripper pose out."""

from __future__ import annotations

__version__ = "0.1.0"
