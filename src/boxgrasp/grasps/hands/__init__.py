"""Hands by name: a YAML file each, with the source of every number."""

from __future__ import annotations

from pathlib import Path
from typing import Final

_FOLDER: Final = Path(__file__).parent
HANDS: Final[dict[str, Path]] = {path.stem: path for path in sorted(_FOLDER.glob("*.yaml"))}
