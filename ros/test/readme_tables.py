"""Writes the tables of ros/README.md anew, from the code: `python ros/test/readme_tables.py`."""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "ros" / "README.md"
if __name__ == "__main__":
    sys.path.insert(0, str(ROOT / "ros" / "boxgrasp_ros"))

from boxgrasp_ros import interfaces, settings  # noqa: E402


def tables() -> dict[str, str]:
    """The tables by the names that stand over them."""
    return {
        "topics heard": interfaces.markdown_table(interfaces.HEARD),
        "topics told": interfaces.markdown_table(interfaces.TOLD),
        "services and the action": interfaces.markdown_table(interfaces.ANSWERED),
        "parameters": settings.markdown_table(),
    }


def refreshed(text: str) -> str:
    """The text with every table as the code has it."""
    for name, table in tables().items():
        start, end = re.escape(f"<!-- {name} -->"), re.escape("<!-- end -->")
        text, count = re.subn(
            rf"({start}\n).*?({end})", lambda m, t=table: m[1] + t + m[2], text, flags=re.DOTALL
        )
        if count != 1:
            raise ValueError(f"{README.name} has {count} places for the table {name!r}; valid: one")
    return text


if __name__ == "__main__":
    README.write_text(refreshed(README.read_text("utf-8")), "utf-8")
