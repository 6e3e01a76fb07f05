"""Readers and writers of files; `load_capture` reads every kind of capture."""

from __future__ import annotations

from boxgrasp.io.load import load_capture

__all__ = ["load_capture"]
