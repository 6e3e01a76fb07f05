"""The report as a value: the thesis's figures beside ours; kept as HTML, Markdown and JSON."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, Protocol

import msgspec

from boxgrasp.errors import StoreError
from boxgrasp.study.intervals import Estimate
from boxgrasp.study.verdicts import STANDARD, Kind, Verdict

SCHEMA: Final = 2
STAND_IN: Final = (
    "Wherever this report says operator, it is a stand-in, not a human: a rule with habits. "
    "Wherever it says real world, it is a stand-in, not a robot: simulated scenes, strong noise."
)
Cell = Estimate | int | float | str | None
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]*")


@dataclass(frozen=True)
class Row:
    """One figure of the thesis beside ours.

    Attributes:
        name: what is counted.
        thesis: its number or words; None where it has none.
        ours: our number, estimate or words.
        note: what to add.
    """

    name: str
    thesis: float | int | str | None
    ours: Cell
    note: str = ""

    @property
    def aside(self) -> Literal["", "within", "higher", "lower"]:
        """Where the thesis's number lies of our interval; empty where either is missing."""
        if not isinstance(self.ours, Estimate) or isinstance(self.thesis, str | None):
            return ""
        low, high = self.ours.low, self.ours.high
        if low is None or high is None:
            return ""
        if low <= self.thesis <= high:
            return "within"
        return "higher" if self.thesis > high else "lower"


@dataclass(frozen=True)
class Table:
    """A table; each of its rows has a cell for each column.

    Attributes:
        title: over it.
        columns: their names.
        rows: cells.

    Raises:
        ValueError: a row of another length.
    """

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(
                    f"a row of table {self.title!r} has {len(row)} cells; "
                    f"valid: {len(self.columns)}, one a column"
                )


@dataclass(frozen=True)
class Picture:
    """A picture, SVG or PNG.

    Attributes:
        name: of its file, without the ending.
        caption: below it.
        svg: as text, or None.
        png: as bytes, or None.
        alt: what it shows, for who cannot see it.

    Raises:
        ValueError: not one of SVG and PNG, or a name that is no file's.
    """

    name: str
    caption: str
    svg: str | None = None
    png: bytes | None = None
    alt: str = ""

    def __post_init__(self) -> None:
        if (self.svg is None) == (self.png is None):
            raise ValueError(f"picture {self.name!r}: valid: an SVG or a PNG, one of them")
        _validate_name("picture", self.name)

    @property
    def file(self) -> str:
        """Where the picture lies beside the Markdown page."""
        return f"pictures/{self.name}.{'svg' if self.png is None else 'png'}"

    @property
    def data(self) -> bytes:
        """The file's bytes."""
        return (self.svg or "").encode() if self.png is None else self.png


@dataclass(frozen=True)
class Section:
    """One part of the report.

    Attributes:
        key: tells it from the others.
        title: over it.
        place: where the thesis has it.
        words: paragraphs.
        rows: figures beside the thesis's.
        tables: below them.
        pictures: below them.

    Raises:
        ValueError: a key that is no name.
    """

    key: str
    title: str
    place: str = ""
    words: tuple[str, ...] = ()
    rows: tuple[Row, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()

    def __post_init__(self) -> None:
        _validate_name("section", self.key)


@dataclass(frozen=True)
class Claim:
    """One result of the thesis, and whether it came out here.

    Attributes:
        key: names it, here and in the list of the thesis's results.
        text: what the thesis says.
        place: where.
        kind: by which rule of the standard it is judged.
        theirs: its figure, bar or side, in words.
        ours: our number, estimate or words; None where it cannot be judged here.
        verdict: by the report's standard.
        reason: how ours was found, and why it is so, as far as can be seen.

    Raises:
        ValueError: a key that is no name.
    """

    key: str
    text: str
    place: str
    kind: Kind
    theirs: str
    ours: Cell
    verdict: Verdict
    reason: str = ""

    def __post_init__(self) -> None:
        _validate_name("claim", self.key)


@dataclass(frozen=True)
class Report:
    """The whole report.

    Attributes:
        title: over it.
        made_with: by what it can be made again: seed, versions, counts.
        sections: its parts.
        claims: every result of the thesis, each once.
        notice: what every reader must know.
        standard: how the claims are judged.

    Raises:
        ValueError: two sections, two pictures or two claims of one name.
    """

    title: str
    made_with: Mapping[str, str] = field(default_factory=dict)
    sections: tuple[Section, ...] = ()
    claims: tuple[Claim, ...] = ()
    notice: str = STAND_IN
    standard: tuple[str, ...] = STANDARD

    def __post_init__(self) -> None:
        _validate_once("section", [section.key for section in self.sections])
        _validate_once("picture", [picture.name for picture in self.pictures()])
        _validate_once("claim", [claim.key for claim in self.claims])

    def pictures(self) -> Iterator[Picture]:
        """Every picture.

        Yields:
            In order.
        """
        for section in self.sections:
            yield from section.pictures

    def rows(self) -> Iterator[Row]:
        """Every row.

        Yields:
            In order.
        """
        for section in self.sections:
            yield from section.rows


class Reads(Protocol):
    """A place that keeps named bytes."""

    def read(self, name: str) -> bytes:
        """What is kept under a name.

        Args:
            name: relative path.

        Returns:
            Its bytes.
        """


def to_json(report: Report) -> bytes:
    """The report as JSON.

    Args:
        report: any.

    Returns:
        All its figures; of the pictures their files' names. NaN is null.
    """
    found = msgspec.json.decode(msgspec.json.encode(report, enc_hook=_plain))
    for section in found["sections"]:
        for picture in section["pictures"]:
            kind = "svg" if picture["png"] is None else "png"
            picture["file"] = f"pictures/{picture['name']}.{kind}"
            del picture["svg"], picture["png"]
    found = {"schema": SCHEMA, **found}
    return (json.dumps(found, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def read(store: Reads) -> Report:
    """The report that `write` kept at a place.

    Args:
        store: the place.

    Returns:
        The report.

    Raises:
        StoreError: what is kept there is no report.
    """
    try:
        found = json.loads(store.read("report.json"))
        if found.pop("schema") != SCHEMA:
            raise ValueError(f"another schema than {SCHEMA}")
        for section in found["sections"]:
            section["pictures"] = [_picture(item, store) for item in section["pictures"]]
        return msgspec.convert(found, Report)
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        what = " ".join(str(error).split()) or type(error).__name__
        raise StoreError(f"report.json is no report: {what}; valid: one of `write`") from None


def _plain(value: Any) -> Any:
    """numpy's numbers as Python's."""
    return value.item()


def _picture(item: dict[str, Any], store: Reads) -> Picture:
    file = str(item.pop("file"))
    _validate_name("picture", item["name"])
    if file == f"pictures/{item['name']}.svg":
        return Picture(svg=store.read(file).decode(), **item)
    if file == f"pictures/{item['name']}.png":
        return Picture(png=store.read(file), **item)
    raise ValueError(f"picture {item['name']!r} is in {file!r}")


def _validate_name(what: str, name: str) -> None:
    if not _NAME.fullmatch(name):
        raise ValueError(f"name of a {what} is {name!r}; valid: letters, digits, . _ - in it")


def _validate_once(what: str, names: list[str]) -> None:
    twice = [name for k, name in enumerate(names) if name in names[:k]]
    if twice:
        raise ValueError(f"{what} {twice[0]!r} is there twice; valid: each name once")
