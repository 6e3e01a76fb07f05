"""Every result of the thesis, once, as `thesis.yaml` lists them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any, Final

import yaml

from boxgrasp.study.verdicts import Kind, Said

KINDS: Final[tuple[Kind, ...]] = (
    "count", "figure", "share", "difference", "above", "below", "alike", "open",
)  # fmt: skip
WORDS: Final = "words"  # a difference of which only the side is told


@dataclass(frozen=True)
class Result:
    """One result of the thesis.

    Attributes:
        key: names it.
        place: where the thesis has it.
        says: its words.
        said: what ours is held against.
        why_open: why it cannot be judged here; empty where it can.
    """

    key: str
    place: str
    says: str
    said: Said
    why_open: str = ""


@cache
def catalogue() -> tuple[Result, ...]:
    """All results of the thesis.

    Returns:
        In its order.

    Raises:
        ValueError: one is there twice, or is not said in one of the known ways.
    """
    text = files("boxgrasp.study").joinpath("thesis.yaml").read_text(encoding="utf-8")
    found = tuple(_result(item) for item in yaml.safe_load(text))
    keys = [item.key for item in found]
    twice = [key for k, key in enumerate(keys) if key in keys[:k]]
    if twice:
        raise ValueError(f"result {twice[0]!r} is there twice; valid: each key once")
    return found


def _result(item: Mapping[str, Any]) -> Result:
    kinds = [kind for kind in KINDS if kind in item]
    if len(kinds) != 1:
        raise ValueError(f"result {item['key']!r} has {kinds}; valid: one of {', '.join(KINDS)}")
    value: Any = item[kinds[0]]
    of: int | None = item.get("of")
    why_open = ""
    if kinds[0] == "open":
        value, why_open = None, str(value)
    if kinds[0] == "share":
        value, of = value
    if value == WORDS:
        value = None
    return Result(item["key"], item["place"], item["says"], Said(kinds[0], value, of), why_open)
