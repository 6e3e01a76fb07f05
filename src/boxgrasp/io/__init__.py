"""Readers: files to captures. An outer room; the core never imports it but in `Capture.load`."""

from __future__ import annotations

from boxgrasp.io.load import load_capture

__all__ = ["load_capture"]
