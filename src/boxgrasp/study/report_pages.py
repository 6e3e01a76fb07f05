"""The report's two pages: one HTML file that needs nothing else, and Markdown beside pictures."""

from __future__ import annotations

import base64
import math
import re
from collections import Counter
from collections.abc import Sequence
from importlib.resources import files
from typing import Final, Protocol

from boxgrasp.errors import MissingExtraError
from boxgrasp.study.intervals import Estimate
from boxgrasp.study.report import Cell, Claim, Picture, Report, Row, Table, to_json
from boxgrasp.study.verdicts import Verdict

DASH: Final = "–"
ASIDE: Final = {
    "": "",
    "within": "within",
    "higher": "▲ thesis higher",
    "lower": "▼ thesis lower",
}
COLUMNS: Final = ("figure", "thesis", "ours", "95 % interval", "of", "thesis's figure", "note")
CLAIM_COLUMNS: Final = (
    "result",
    "where",
    "thesis",
    "ours",
    "95 % interval",
    "verdict",
    "how and why",
)
VERDICTS: Final[dict[Verdict, str]] = {
    "reproduced": "✓",
    "weaker": "≈",
    "not reproduced": "✗",
    "higher": "▲",
    "lower": "▼",
    "cannot be judged here": "○",
}
_CODE = re.compile(r"`([^`\n]+)`")


class Writes(Protocol):
    """A place to keep named bytes."""

    def write(self, name: str, data: bytes) -> None:
        """Keep bytes under a name.

        Args:
            name: relative path.
            data: the bytes.
        """


def write(report: Report, store: Writes) -> None:
    """Keep report.html (all in one file), report.md, report.json, and pictures/* beside them.

    Args:
        report: any.
        store: where to.

    Raises:
        MissingExtraError: jinja2 is not installed.
    """
    for picture in report.pictures():
        store.write(picture.file, picture.data)
    store.write("report.json", to_json(report))
    store.write("report.md", markdown(report).encode())
    store.write("report.html", html(report).encode())


def html(report: Report) -> str:
    """The report as one page: pictures inlined, no script, nothing from elsewhere.

    Args:
        report: any.

    Returns:
        HTML.

    Raises:
        MissingExtraError: jinja2 is not installed.
    """
    try:
        import jinja2
        from markupsafe import Markup, escape
    except ImportError:
        raise MissingExtraError(
            "the report needs jinja2; install with: pip install 'boxgrasp[train]'"
        ) from None

    def said(words: str) -> Markup:
        # Escaped first, so the only tags are ours.
        return Markup(_CODE.sub(r"<code>\1</code>", str(escape(words))))

    source = files("boxgrasp.study").joinpath("report.html.j2").read_text(encoding="utf-8")
    pages = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    pages.filters |= {"said": said, "cell": cell, "source": _source, "number": _is_number}
    pages.filters["interval"] = _interval
    pages.tests["interval"] = _has_interval
    return pages.from_string(source).render(
        report=report,
        columns=COLUMNS,
        line=row_cells,
        claim_columns=CLAIM_COLUMNS,
        claim_line=claim_cells,
        aside=ASIDE,
        verdicts=VERDICTS,
        summary=summary(report),
    )


def markdown(report: Report) -> str:
    """The report as a page whose pictures are files beside it.

    Args:
        report: any.

    Returns:
        Markdown.
    """
    lines = [f"# {_md(report.title)}", "", f"> {_md(report.notice)}", ""]
    lines += [*(part for words in summary(report) for part in (_md(words), "")), "## Made with", ""]
    lines += [f"- {_md(key)}: {_md(str(value))}" for key, value in report.made_with.items()]
    if report.claims:
        lines += ["", "## How results are judged", ""]
        lines += [part for words in report.standard for part in (_md(words), "")]
        lines += ["## Every result of the thesis", ""]
        lines += _md_table(CLAIM_COLUMNS, [claim_cells(claim) for claim in report.claims])
    for section in report.sections:
        lines += ["", f"## {_md(section.title)}", ""]
        lines += [_md(section.place), ""] if section.place else []
        lines += [part for words in section.words for part in (_md(words), "")]
        if section.rows:
            lines += _md_table(COLUMNS, [row_cells(row) for row in section.rows], numbers=(1, 5))
        for table in section.tables:
            lines += ["", f"### {_md(table.title)}", ""]
            lines += _md_table(table.columns, [_cells(table, row) for row in table.rows])
        for picture in section.pictures:
            lines += ["", f"![{_md(picture.alt)}]({picture.file})", "", _md(picture.caption)]
    return "\n".join(lines) + "\n"


def summary(report: Report) -> tuple[str, ...]:
    """What the whole comes to, in sentences that are counted, not written.

    Args:
        report: any.

    Returns:
        Paragraphs.
    """
    if not report.claims:
        return ()
    parts = {
        "Counted without chance": ("count",),
        "Figures and shares": ("figure", "share"),
        "Differences, levels and words": ("difference", "above", "below", "alike"),
        "Kept in no text": ("open",),
    }
    said = [f"Of {len(report.claims)} results of the thesis: {_counts(report.claims)}."]
    by_kind = [
        (words, [claim for claim in report.claims if claim.kind in kinds])
        for words, kinds in parts.items()
    ]
    said += [f"{words}, {len(own)}: {_counts(own)}." for words, own in by_kind if own]
    said.append(
        "The mark beside a row further below says only where the thesis's figure lies of our own "
        "interval; its verdict, with the thesis's sampling error too, is in this list."
    )
    return tuple(said)


def _counts(claims: Sequence[Claim]) -> str:
    """How many claims have each verdict."""
    found = Counter(claim.verdict for claim in claims)
    return ", ".join(f"{found[word]} {word}" for word in VERDICTS if found[word])


def row_cells(row: Row) -> tuple[str, ...]:
    """A row as text.

    Args:
        row: any.

    Returns:
        A text for each of `COLUMNS`; a dash where there is nothing.
    """
    ours = row.ours
    interval = count = ""
    if isinstance(ours, Estimate):
        interval, count = _interval(ours), f"{ours.count:,}"
        ours = ours.value if ours.value is None else _decimals(ours.value)
    return (row.name, theirs(row.thesis), cell(ours), interval, count, ASIDE[row.aside], row.note)


def claim_cells(claim: Claim) -> tuple[str, ...]:
    """A result of the thesis as text.

    Args:
        claim: any.

    Returns:
        A text for each of `CLAIM_COLUMNS`.
    """
    ours, interval = claim.ours, ""
    if isinstance(ours, Estimate):
        interval = _interval(ours)
        interval += f" (of {ours.count:,})" if ours.low is not None else ""
        ours = None if ours.value is None else _decimals(ours.value)
    verdict = f"{VERDICTS[claim.verdict]} {claim.verdict}"
    return claim.text, claim.place, claim.theirs, cell(ours), interval, verdict, claim.reason


def theirs(value: float | int | str | None) -> str:
    """The thesis's figure as text.

    Args:
        value: a number or words, or None.

    Returns:
        With the digits that the thesis prints, at least two after the point.
    """
    if not isinstance(value, float) or not math.isfinite(value):
        return cell(value)
    text = f"{value:.4f}".rstrip("0")
    return f"{value:.2f}" if len(text.partition(".")[2]) < 2 else text


def cell(value: Cell) -> str:
    """Any cell as text.

    Args:
        value: number, estimate or words, or None.

    Returns:
        An estimate with its interval; a dash for what is missing or no number.
    """
    if isinstance(value, Estimate):
        if value.value is None:
            return DASH
        return f"{_decimals(value.value)} ({_interval(value)})"
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return DASH
    if isinstance(value, str):
        return value
    return f"{value:.6g}" if isinstance(value, float) else f"{value:,}"


def _interval(value: Estimate) -> str:
    if value.low is None or value.high is None:
        return DASH
    return f"{_decimals(value.low)} to {_decimals(value.high)}"


def _decimals(value: float) -> str:
    return f"{value:.3f}" if math.isfinite(value) else DASH


def _has_interval(value: Cell) -> bool:
    return isinstance(value, Estimate) and value.low is not None


def _is_number(value: Cell) -> bool:
    return not isinstance(value, str)


def _cells(table: Table, row: tuple[Cell, ...]) -> tuple[str, ...]:
    return tuple(cell(value) for value in row)


def _source(picture: Picture) -> str:
    """A picture as a data URI: an image, so nothing in it acts or meets another's ids."""
    kind = "svg+xml" if picture.png is None else "png"
    return f"data:image/{kind};base64,{base64.b64encode(picture.data).decode()}"


def _md(words: str) -> str:
    """Words as Markdown that says just them; `code` stays."""
    parts = _CODE.split(" ".join(words.split()))
    # Odd parts are what stood between backticks; in a table a bar would end the cell even there.
    said = [
        f"`{part}`" if k % 2 and "|" not in part else re.sub(r"([\\`*_\[\]<>|&])", r"\\\1", part)
        for k, part in enumerate(parts)
    ]
    # What opens a list, heading or rule at the start of a line is words here too.
    text = re.sub(r"^(#|[-+](?=[\s-]|$))", r"\\\1", "".join(said))
    return re.sub(r"^(\d+)([.)])(?=\s|$)", r"\1\\\2", text)


def _md_table(
    columns: tuple[str, ...], rows: list[tuple[str, ...]], numbers: tuple[int, int] = (0, 0)
) -> list[str]:
    """Lines of a table; columns from `numbers[0]` and before `numbers[1]` are set to the right."""
    marks = ["--:" if numbers[0] <= k < numbers[1] else "---" for k in range(len(columns))]
    texts = [[_md(text) for text in row] for row in (columns, *rows)]
    return [f"| {' | '.join(row)} |" for row in (texts[0], marks, *texts[1:])]
