"""The standard gives the verdicts that its words say; no result of the thesis is without one."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("sklearn", reason="extra train")
pytest.importorskip("onnxruntime", reason="extra svm")

from boxgrasp.study import catalogue as catalogues
from boxgrasp.study.answers import ANSWERS
from boxgrasp.study.answers.figures import mean_like
from boxgrasp.study.answers.samplings import table_in_lowest_cell
from boxgrasp.study.catalogue import catalogue
from boxgrasp.study.intervals import NOTHING, Estimate, less, mean, share
from boxgrasp.study.sections.declared import READINGS, declared_section
from boxgrasp.study.verdicts import STANDARD, Said, judge


def found(low: float, value: float, high: float, count: int = 100) -> Estimate:
    return Estimate(value, low, high, count)


@pytest.mark.parametrize(
    ("said", "ours", "verdict"),
    [
        (Said("difference", 0.28), found(0.02, 0.14, 0.26), "reproduced"),
        (Said("difference", 0.28), found(0.02, 0.13, 0.24), "weaker"),
        (Said("difference", 0.28), found(-0.01, 0.28, 0.57), "not reproduced"),
        (Said("difference", 0.28), found(-0.30, -0.20, -0.10), "not reproduced"),
        (Said("difference"), found(0.001, 0.01, 0.02), "reproduced"),
        (Said("difference"), found(0.0, 0.01, 0.02), "not reproduced"),
        (Said("above", 0.9), found(0.91, 0.93, 0.95), "reproduced"),
        (Said("above", 0.9), found(0.89, 0.91, 0.93), "weaker"),
        (Said("above", 0.9), found(0.80, 0.89, 0.95), "not reproduced"),
        (Said("below", 0.01), found(0.0, 0.001, 0.009), "reproduced"),
        (Said("below", 0.01), found(0.0, 0.0, 0.02), "weaker"),
        (Said("below", 0.01), found(0.005, 0.02, 0.03), "not reproduced"),
        (Said("alike", 0.04), found(-0.02, 0.01, 0.04), "reproduced"),
        (Said("alike", 0.04), found(-0.06, 0.01, 0.08), "weaker"),
        (Said("alike", 0.04), found(-0.16, -0.14, -0.12), "not reproduced"),
        (Said("figure", 0.55, 120), found(0.60, 0.62, 0.64, 2000), "reproduced"),
        (Said("figure", 0.55, 120), found(0.65, 0.67, 0.69, 2000), "higher"),
        (Said("figure", 0.84, 120), found(0.65, 0.67, 0.69, 2000), "lower"),
        (Said("share", 0, 16), share(0, 200), "reproduced"),
        (Said("share", 0, 16), share(100, 200), "higher"),
        (Said("share", 60, 120), share(2, 200), "lower"),
        (Said("count", 184), 184, "reproduced"),
        (Said("count", 184), 195, "not reproduced"),
        (Said("count", 7.5), 7.583, "not reproduced"),
        (Said("count", 7.2), 7.196, "reproduced"),
        (Said("count", "in part"), "in part", "reproduced"),
        (Said("count", 1), None, "cannot be judged here"),
        (Said("above", 0.9), NOTHING, "cannot be judged here"),
        (Said("open"), None, "cannot be judged here"),
    ],
)
def test_verdicts_by_the_standard_s_words(said: Said, ours: Estimate, verdict: str) -> None:
    assert judge(said, ours) == verdict


def test_a_figure_without_an_interval_is_no_evidence() -> None:
    with pytest.raises(ValueError, match="valid for a above: an estimate"):
        judge(Said("above", 0.9), 0.95)


@given(st.floats(-1, 1), st.floats(0, 1), st.floats(0, 1))
def test_only_the_thesis_s_side_is_ever_reproduced(value: float, down: float, up: float) -> None:
    ours = found(value - down, value, value + up)
    if judge(Said("difference", 0.2), ours) in ("reproduced", "weaker"):
        assert value - down > 0
    swapped = found(-value - up, -value, -value + down)
    both = {judge(Said("difference", 0.2), one) for one in (ours, swapped)}
    assert both & {"not reproduced"}


def test_the_joint_interval_holds_the_truth_as_often_as_it_says() -> None:
    """Shares of 42 and 120 scenes with one true share: apart by chance alone in about 5 %."""
    rng = np.random.default_rng(3)
    draws = rng.binomial(42, 0.8, 2000), rng.binomial(120, 0.8, 2000)
    same = [
        judge(Said("share", int(b), 120), share(int(a), 42)) for a, b in zip(*draws, strict=True)
    ]
    assert 0.93 <= np.mean([verdict == "reproduced" for verdict in same]) <= 0.975


def test_apart_is_newcombe_s_interval() -> None:
    gap = less(share(56, 70), share(48, 80))  # Newcombe 1998, example (a), method 10
    assert (gap.value, gap.low, gap.high) == pytest.approx((0.2, 0.0524, 0.3339), abs=5e-5)
    assert less(NOTHING, share(1, 2)) == less(share(1, 2), NOTHING) == NOTHING


def test_a_mean_at_other_numbers_of_obstacles() -> None:
    values, counts = np.array([1.0, 1.0, 0.0, 0.0]), np.array([1, 1, 2, 2])
    assert mean_like(values, counts, np.array([1, 2, 2, 2])).value == pytest.approx(0.25)
    assert mean_like(values, counts, np.array([1, 1])) == mean(values[:2])
    assert mean_like(values, counts, np.array([1, 3])) == NOTHING


def test_every_result_has_an_answer_or_says_why_not() -> None:
    results = catalogue()
    assert len(results) >= 165
    answered = {item.key for item in results if item.said.kind != "open"}
    assert answered == set(ANSWERS)
    for item in results:
        assert item.place and item.says, item.key
        named = re.findall(r"`([^`]+)`", item.why_open)
        assert set(named) <= answered, item.key
        assert bool(item.why_open) == (item.said.kind == "open"), item.key


@pytest.mark.parametrize(
    ("place", "numbers"),
    [
        ("table 4-1", ("0,60", "0,64", "0,78", "0,84", "0,50", "0,48", "0,55", "0,56", "0,81")),
        ("table 4-2", ("0,15", "0,48", "0,27", "0,32", "0,17", "0,45", "13", "3")),
        ("table 4-3", ("0,42", "0,87", "0,27", "0,61")),
        ("table 3-2", ("57", "60", "118", "120")),
        ("B-1", ("796", "793", "720", "725", "232", "151", "229", "266", "408", "392")),
        ("4-3", ("0,86", "2 scenarios", "0,87", "0,42")),
        ("figure 4-", tuple(f"figure-4-{k}" for k in range(1, 11))),
        ("figure 5-", ("5-1", "5-2", "5-3", *(f"figure-5-{k}" for k in range(4, 9)))),
        ("6, ", ("90%", "80%", "20%", "10.000")),
    ],
)
def test_no_table_figure_or_number_of_the_text_is_missing(
    place: str, numbers: tuple[str, ...]
) -> None:
    there = " ".join(
        f"{item.key} {item.says} {item.place} {item.said}"
        for item in catalogue()
        if place in item.place
    )
    for number in numbers:
        assert re.search(rf"(?<![\d,]){re.escape(number)}(?!\d)", there), (place, number)


def test_a_result_that_is_there_twice_or_said_in_no_way_is_refused(monkeypatch) -> None:
    twice = [{"key": "a", "place": "1", "says": "b", "count": 1}] * 2
    monkeypatch.setattr(catalogues.yaml, "safe_load", lambda _: twice)
    with pytest.raises(ValueError, match="'a' is there twice"):
        catalogue.__wrapped__()
    monkeypatch.setattr(catalogues.yaml, "safe_load", lambda _: [{"key": "a"}])
    with pytest.raises(ValueError, match="'a' has \\[\\]"):
        catalogue.__wrapped__()


def test_the_standard_names_every_verdict() -> None:
    words = " ".join(STANDARD)
    for verdict in (
        "reproduced", "weaker", "not reproduced", "higher", "lower", "cannot be judged here",
    ):  # fmt: skip
        assert f"`{verdict}`" in words


@pytest.mark.parametrize(("table_m", "shared"), [(0.80, False), (0.77, True), (0.845, True)])
def test_the_world_s_lattice_by_counting_cells(table_m: float, shared: bool) -> None:
    """Cells of 7 cm over the floor, one by one: which holds the top, and which the samples."""
    cells = [(0.07 * k, 0.07 * (k + 1)) for k in range(20)]

    def holds(height: float) -> int:
        return next(k for k, (low, high) in enumerate(cells) if low - 1e-9 <= height < high - 1e-9)

    assert (holds(table_m) == holds(table_m + 0.05)) is shared
    assert table_in_lowest_cell(0.07, table_m) is shared


def test_the_docs_declare_the_readings_that_the_report_does() -> None:
    page = (Path(__file__).resolve().parent.parent / "docs" / "thesis.md").read_text("utf-8")
    table = page.partition("## Where our reading differs from the print")[2].partition("\n## ")[0]
    lines = [line for line in table.splitlines() if line.startswith("| ")]
    assert lines[1:] == [f"| {' | '.join(reading)} |" for reading in READINGS]
    rows = {row.name: row.ours for row in declared_section().rows}
    assert list(rows.values()) == ["two cells", "two cells", "0.29 of all"]
