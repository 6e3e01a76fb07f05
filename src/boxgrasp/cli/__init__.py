"""The command line: a file a command, everything heavy imported by the command that needs it."""

from __future__ import annotations
