"""Put a study's figures into the docs: `python tools/quote_study.py OUT`.

OUT is a folder that `boxgrasp reproduce` wrote. The figures that docs/results.md quotes are kept in
tests/study_figures.json, and the part of docs/results.md between its two marks is written anew from
them; a test holds the page, that file and the report together.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
FIGURES = ROOT / "tests" / "study_figures.json"
PAGE = ROOT / "docs" / "results.md"
BEGIN, END = "<!-- a study's figures: begin -->", "<!-- a study's figures: end -->"
# What the page quotes: results of the thesis by their keys, and a section of the package's own.
QUOTED = {
    "label-score": "average score of the labels",
    "label-sides": "side faces among the labels",
    "score-single-spiral-total": "score of the bare SVMs: single spiral",
    "score-cascade-spiral-total": "cascade spiral",
    "score-single-grid-total": "single grid",
    "score-cascade-grid-total": "cascade grid",
    "grid-better-single": "grid less spiral, single",
    "grid-better-cascade": "grid less spiral, cascade",
    "clear-simulation": "unobstructed, cascade grid, known and novel objects",
    "clear-novel": "the same, novel objects",
    "need-single-total": "score where a line off the center is needed: single grid",
    "need-cascade-total": "cascade grid",
    "need-cascade-safer": "cascade less single",
    "real-changes": "decisions that noise changes, one map that is never reset",
    "real-score": "stand-in for the robot's tests, score",
}
SECTION = "solvable"
MADE_WITH = ("boxgrasp", "seed", "sets")


def figures_of(report: dict[str, Any]) -> dict[str, Any]:
    """What the page quotes of a report.

    report: the object in report.json.
    """
    claims = {claim["key"]: claim for claim in report["claims"]}
    (section,) = (item for item in report["sections"] if item["key"] == SECTION)
    (training,) = (item for item in report["sections"] if item["key"] == "training")
    (b1,) = training["tables"]
    return {
        "made_with": {name: report["made_with"][name] for name in MADE_WITH},
        "verdicts": Counter(claim["verdict"] for claim in report["claims"]),
        "claims": [
            {name: claims[key][name] for name in ("key", "theirs", "ours", "verdict")}
            for key in QUOTED
        ],
        "commonest_answers": {
            str(line[0]).partition(". ")[2]: line[-1]["value"] for line in b1["rows"]
        },
        "rows": [{"name": row["name"], "ours": row["ours"]} for row in section["rows"]],
    }


def text_of(figures: dict[str, Any]) -> str:
    """The part of the page, with its marks."""
    made, verdicts = figures["made_with"], figures["verdicts"]
    counts = ", ".join(f"{count} {word}" for word, count in verdicts.items())
    lines = [
        BEGIN,
        f"From `boxgrasp reproduce OUT --seed {made['seed']}`, sets with their number of rows: "
        f"{made['sets']}.",
        "",
        f"Of {sum(verdicts.values())} results of the thesis: {counts}.",
        "",
        "| the thesis, again | thesis | measured, 95 % interval | verdict |",
        "|---|---|---|---|",
    ]
    for claim in figures["claims"]:
        words = f"{QUOTED[claim['key']]} | {claim['theirs']} | {_shown(claim['ours'])}"
        lines.append(f"| {words} | {claim['verdict']} |")
    lines += [
        "",
        "| the package, where there is a good grasp | measured, 95 % interval |",
        "|---|---|",
    ]
    lines += [f"| {row['name']} | {_shown(row['ours'])} |" for row in figures["rows"]]
    return "\n".join([*lines, END])


def _shown(ours: Any) -> str:
    if not isinstance(ours, dict):
        return "–" if ours is None else str(ours)
    if ours["value"] is None:
        return "–"
    return f"{ours['value']:.3f} ({ours['low']:.3f} to {ours['high']:.3f}; of {ours['count']:,})"


def replaced(page: str, text: str) -> str:
    """A page with its marked part written anew."""
    before, _, rest = page.partition(BEGIN)
    _, _, after = rest.partition(END)
    return before + text + after


def main() -> None:
    """Read the report, write the figures and the page."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path)
    report = json.loads((parser.parse_args().out / "report.json").read_text("utf-8"))
    figures = figures_of(report)
    FIGURES.write_text(json.dumps(figures, indent=1, ensure_ascii=False) + "\n", "utf-8")
    PAGE.write_text(replaced(PAGE.read_text("utf-8"), text_of(figures)), "utf-8")


if __name__ == "__main__":
    main()
