"""The report says what it was given, to people and machines, and asks nothing of the network."""

import html.parser
import json
import math
import re
import sys

import numpy as np
import pytest

from boxgrasp.errors import MissingExtraError, StoreError
from boxgrasp.study.intervals import Estimate, mean, share
from boxgrasp.study.report import Claim, Picture, Report, Row, Section, Table, read, to_json
from boxgrasp.study.report_pages import cell, markdown, row_cells, theirs, write
from boxgrasp.study.report_pages import html as page

SVG = '<svg xmlns="http://www.w3.org/2000/svg" width="4" height="4"><circle r="2"/></svg>'
PNG = bytes.fromhex(
    "89504e470d0a1a0a0000000d4948445200000001000000010804000000b51c0c02"
    "0000000b4944415478da63fcff1f0003030200efbfa7db0000000049454e44ae426082"
)
HOSTILE = '<script>alert("x")</script> & "quoted" | ](http://evil.example) `a|b`\n# no'


class Kept(dict):
    """A store in memory."""

    def write(self, name, data):
        self[name] = data

    def read(self, name):
        return self[name]


class Tags(html.parser.HTMLParser):
    """Every tag with its attributes, every text, and whether all that opens is closed."""

    EMPTY = {"meta", "img", "br", "link", "hr", "input"}

    def __init__(self, text):
        super().__init__()
        self.tags, self.open, self.texts = [], [], []
        self.feed(text)
        assert not self.open

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs)))
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.texts.append(data)

    def of(self, tag):
        return [attrs for name, attrs in self.tags if name == tag]


def sample():
    return Report(
        title="The thesis again",
        made_with={"seed": "1", "boxgrasp": "0.1"},
        sections=(
            Section(
                key="results",
                title="Four versions",
                place="section 4-2, table 4-1",
                words=("By `visible` clearance.", "Second paragraph."),
                rows=(
                    Row("inside", 0.84, Estimate(0.85, 0.82, 0.88, 2000)),
                    Row("too high", 0.9, Estimate(0.85, 0.82, 0.88, 2000)),
                    Row("too low", 0.6, Estimate(0.85, 0.82, 0.88, 2000), "a note"),
                    Row("words", "more than 0.90", share(110, 120)),
                    Row("none of theirs", None, mean([0.2, 0.4])),
                    Row("nothing measured", 0.17, mean([])),
                    Row("a count", 408, 401),
                    Row("no number", 1.5, math.nan),
                ),
                tables=(
                    Table(
                        "Numbers", ("what", "n", "score"), (("a", 1, share(1, 3)), ("b", 2, None))
                    ),
                ),
                pictures=(
                    Picture("one", "First.", svg=SVG, alt="a circle"),
                    Picture("two", "Second.", png=PNG, alt="a dot"),
                ),
            ),
            Section(key="empty", title="Nothing"),
        ),
        claims=(
            Claim(
                "grid",
                "Grid over spiral",
                "4-2",
                "difference",
                "+0.26",
                share(3, 9),
                "reproduced",
                "seen",
            ),
            Claim(
                "order",
                "Order of scores",
                "3-4",
                "count",
                "all",
                "3 of 6",
                "not reproduced",
                "ties",
            ),
            Claim("bars", "Bars", "figure 4-3", "open", "–", None, "cannot be judged here", "lost"),
        ),
    )


def hostile():
    row = Row(HOSTILE, HOSTILE, HOSTILE, HOSTILE)
    return Report(
        HOSTILE,
        {HOSTILE: HOSTILE},
        (
            Section(
                "s", HOSTILE, HOSTILE, (HOSTILE,), (row,),
                (Table(HOSTILE, (HOSTILE,), ((HOSTILE,),)),),
                (Picture("p", HOSTILE, svg=f"<svg><!--{HOSTILE}--></svg>", alt=HOSTILE),),
            ),
        ),
        (Claim("c", HOSTILE, HOSTILE, "above", HOSTILE, HOSTILE, "weaker", HOSTILE),),
        HOSTILE,
    )  # fmt: skip


def kept(report):
    store = Kept()
    write(report, store)
    return store


def test_every_file_is_written_and_the_pictures_are_the_bytes_given():
    store = kept(sample())
    assert set(store) == {
        "report.html", "report.md", "report.json", "pictures/one.svg", "pictures/two.png",
    }  # fmt: skip
    assert store["pictures/one.svg"] == SVG.encode()
    assert store["pictures/two.png"] == PNG


@pytest.mark.parametrize("report", [hostile(), Report("Bare")], ids=["hostile", "bare"])
def test_what_is_read_is_what_was_written(report):
    assert read(kept(report)) == report


def test_a_number_that_is_none_is_null_and_reads_as_missing():
    store = kept(sample())
    again = read(store)
    assert again.sections[0].rows[-1] == Row("no number", 1.5, None)
    assert again.sections[0].rows[:-1] == sample().sections[0].rows[:-1]
    assert again.claims == sample().claims and again.made_with == sample().made_with
    assert b"NaN" not in store["report.json"]
    assert read(kept(again)) == again


def test_json_has_stable_keys_and_names_pictures_by_file():
    found = json.loads(to_json(sample()))
    assert list(found) == [
        "schema", "title", "made_with", "sections", "claims", "notice", "standard",
    ]  # fmt: skip
    assert found["claims"][0] == {
        "key": "grid", "text": "Grid over spiral", "place": "4-2", "kind": "difference",
        "theirs": "+0.26",
        "ours": {"value": share(3, 9).value, "low": share(3, 9).low, "high": share(3, 9).high,
                 "count": 9},
        "verdict": "reproduced", "reason": "seen",
    }  # fmt: skip
    row = found["sections"][0]["rows"][1]
    assert row == {
        "name": "too high",
        "thesis": 0.9,
        "ours": {"value": 0.85, "low": 0.82, "high": 0.88, "count": 2000},
        "note": "",
    }
    assert found["sections"][0]["pictures"][0] == {
        "name": "one", "caption": "First.", "alt": "a circle", "file": "pictures/one.svg",
    }  # fmt: skip


def test_numpys_numbers_are_numbers():
    report = Report(
        "t",
        sections=(
            Section("s", "s", rows=(Row("r", np.float64(0.5), np.int64(1234)),)),
        ),
    )  # fmt: skip
    again = read(kept(report)).sections[0].rows[0]
    assert (again.thesis, again.ours) == (0.5, 1234)
    assert row_cells(report.sections[0].rows[0])[1:3] == ("0.50", "1,234")


@pytest.mark.parametrize(
    "damage",
    [
        b"", b"[]", b"{", b"{}", b'{"schema": 2}',
        to_json(sample()).replace(b'"schema": 2', b'"schema": 1'),
        to_json(sample()).replace(b'"reproduced"', b'"proved"'),
        to_json(sample()).replace(b"pictures/one.svg", b"../../etc/passwd"),
        to_json(sample()).replace(b'"name": "one"', b'"name": "../one"'),
    ],
)  # fmt: skip
def test_a_damaged_report_is_refused_in_one_line(damage):
    store = kept(sample())
    store["report.json"] = damage
    with pytest.raises(StoreError, match=r"^report\.json is no report: .+") as caught:
        read(store)
    assert "\n" not in str(caught.value)


def test_the_same_report_gives_the_same_bytes():
    assert kept(sample()) == kept(sample())


def test_the_page_needs_nothing_from_elsewhere():
    for report in (sample(), hostile()):
        text = kept(report)["report.html"].decode()
        tags = Tags(text)
        assert {tag for tag, _ in tags.tags}.isdisjoint(
            {"script", "link", "iframe", "object", "embed", "base", "form", "svg"}
        )
        for _, attrs in tags.tags:
            assert not any(name.startswith("on") for name in attrs)
            for name in ("src", "href", "srcset", "action", "poster", "data"):
                assert attrs.get(name, "#").startswith(("#", "data:image/"))
        style = re.findall(r"<style>(.*?)</style>", text, re.S)
        assert len(style) == 1 and "url(" not in style[0] and "@import" not in style[0]


def test_hostile_text_is_shown_and_does_nothing():
    text = page(hostile())
    assert "<script" not in text and '"quoted"' not in text
    shown = "".join(Tags(text).texts)
    assert shown.count('<script>alert("x")</script>') >= 12
    assert Tags(text).of("img")[0]["alt"] == HOSTILE


def test_hostile_text_stays_inside_its_markdown():
    text = markdown(hostile())
    bare = re.sub(r"\\.", "", text)
    assert "<script" not in bare and "](http" not in bare
    table = [line for line in text.splitlines() if line.startswith("|")]
    bars = {len(re.findall(r"(?<!\\)\|", line)) for line in table}
    assert bars == {2, 8}  # tables of 1 and 7 columns, no cell broken
    assert not [line for line in text.splitlines() if line.startswith("# no")]


def test_a_list_or_heading_in_a_paragraph_is_words():
    section = Section("s", "s", words=("1. one", "# two", "- three", "0.84", "---"))
    lines = markdown(Report("t", sections=(section,))).splitlines()
    assert {"1\\. one", "\\# two", "\\- three", "0.84", "\\---"} <= set(lines)


def test_a_missing_estimate_is_a_dash():
    row = row_cells(Row("nothing measured", 0.17, mean([])))
    assert row == ("nothing measured", "0.17", "–", "–", "0", "", "")
    assert row_cells(Row("x", None, math.nan))[1:3] == ("–", "–")
    assert cell(mean([])) == cell(None) == cell(math.inf) == "–"
    for text in (page(sample()), markdown(sample())):
        assert not re.search(r"\bnan\b|\bNone\b|\binf\b", text)


def test_the_thesis_outside_our_interval_is_marked_and_only_there():
    marks = {row.name: row_cells(row)[5] for row in sample().rows()}
    assert marks == {
        "inside": "within", "too high": "▲ thesis higher", "too low": "▼ thesis lower",
        "words": "", "none of theirs": "", "nothing measured": "", "a count": "", "no number": "",
    }  # fmt: skip
    tags = Tags(page(sample()))
    assert [a["class"] for a in tags.of("td") if a.get("class") in ("higher", "lower")] == [
        "higher", "lower",
    ]  # fmt: skip
    assert "▲ thesis higher" in markdown(sample())
    counts = "Of 3 results of the thesis: 1 reproduced, 1 not reproduced, 1 cannot be judged here."
    assert counts in page(sample()) and counts in markdown(sample())
    assert "Counted without chance, 1: 1 not reproduced." in page(sample())
    assert "Kept in no text, 1: 1 cannot be judged here." in page(sample())


def test_numbers_are_written_with_the_digits_they_have():
    assert theirs(0.6) == "0.60" and theirs(174.8532) == "174.8532" and theirs(0.0035) == "0.0035"
    assert theirs(408) == "408" and theirs("often") == "often" and theirs(None) == "–"
    assert cell(Estimate(0.5, 0.25, 0.75, 9)) == "0.500 (0.250 to 0.750)"
    assert cell(2256) == "2,256" and cell(0.0012345678) == "0.00123457"


def test_contents_lead_to_every_section():
    tags = Tags(page(sample()))
    ids = {attrs.get("id") for _, attrs in tags.tags}
    links = [attrs["href"] for attrs in tags.of("a")]
    contents = [link for link in links if "-one" not in link and "-two" not in link]
    assert contents == ["#standard", "#claims", "#section-results", "#section-empty", "#made-with"]
    assert {link[1:] for link in links} <= ids
    assert "not a human" in page(sample()) and "not a human" in markdown(sample())


def test_a_picture_opens_and_closes_by_links_and_is_held_once():
    text = page(sample())
    tags = Tags(text)
    links = [(attrs.get("class"), attrs["href"]) for attrs in tags.of("a")]
    for name in ("one", "two"):
        opens, closes = f"#full-{name}", f"#picture-{name}"
        assert links.count(("open", opens)) == links.count(("enlarge", opens)) == 1
        assert links.count(("close", closes)) == 1
    sources = [attrs["src"] for attrs in tags.of("img")]
    assert len(sources) == 2 and all(text.count(source) == 1 for source in sources)
    style = re.findall(r"<style>(.*?)</style>", text, re.S)[0]
    for rule in (".full:target {", ".full:target img {", ".close {", ".full:target .close {"):
        assert rule in style


def test_a_wide_table_says_that_it_scrolls_and_a_narrow_one_does_not():
    def said(columns):
        table = Table("t", tuple(map(str, range(columns))), (tuple(range(columns)),))
        tags = Tags(page(Report("t", sections=(Section("s", "s", tables=(table,)),))))
        return [attrs["class"] for attrs in tags.of("p") if "scrolls" in attrs.get("class", "")]

    assert [said(n) for n in (2, 3, 4, 9, 10)] == [
        [], [], ["scrolls"], ["scrolls"], ["scrolls many"],
    ]  # fmt: skip


def test_what_cannot_be_a_report_is_refused():
    with pytest.raises(ValueError, match="an SVG or a PNG"):
        Picture("a", "b")
    with pytest.raises(ValueError, match="name of a picture is '../a'"):
        Picture("../a", "b", svg=SVG)
    with pytest.raises(ValueError, match="has 1 cells; valid: 2"):
        Table("t", ("a", "b"), (("c",),))
    with pytest.raises(ValueError, match="section 's' is there twice"):
        Report("t", sections=(Section("s", "a"), Section("s", "b")))
    claim = Claim("c", "", "", "open", "", None, "cannot be judged here")
    with pytest.raises(ValueError, match="claim 'c' is there twice"):
        Report("t", claims=(claim, claim))
    with pytest.raises(ValueError, match="name of a claim is 'a b'"):
        Claim("a b", "", "", "open", "", None, "cannot be judged here")
    with pytest.raises(ValueError, match="picture 'p' is there twice"):
        twice = (Picture("p", "", svg=SVG), Picture("p", "", svg=SVG))
        Report("t", sections=(Section("s", "a", pictures=twice),))


def test_without_jinja_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "jinja2", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'boxgrasp\[train\]'"):
        page(sample())


def test_the_standard_stands_before_the_results_and_they_before_all_sections():
    for text in (page(sample()), markdown(sample())):
        words = re.sub(r"<[^>]+>|[\\`]", "", text)
        order = [
            words.index("A difference is reproduced where our 95 % interval excludes 0"),
            words.index("Grid over spiral"),
            words.rindex("Four versions"),
        ]
        assert order == sorted(order)
    shown = page(sample())
    assert "0.121 to 0.646 (of 9)" in shown and "✗ not reproduced" in shown
