"""Every chooser, bare and checked, by every measure; which one is the default, and why."""

from __future__ import annotations

import numpy as np

from boxgrasp.config import Config
from boxgrasp.study.evaluation import CHOOSERS, Board
from boxgrasp.study.intervals import Estimate, mean, share
from boxgrasp.study.plots import chooser_points
from boxgrasp.study.report import Picture, Row, Section, Table
from boxgrasp.study.study import Study

SOLVABLE_M = 0.025
COLUMNS = (
    "chooser", "answered", "score, visible", "score, exact", "strict score",
    "unobstructed, visible", "clear, exact", "good, exact", "into the table", "too wide",
)  # fmt: skip
SEEN = {
    "given": "target points and aligned box given",
    "found": "found by the package, its own box",
}


def choosers_section(study: Study) -> Section:
    """All choosers on the test scenarios, and the bars on the solvable ones."""
    board = study.board("tested")
    solvable = board.take(board.rows["best_m"] >= SOLVABLE_M)
    best = best_checked(board)
    worth = solvable.worth(best, "found", check=True)
    done, of = int(worth.answered.sum()), solvable.rows.count
    need = study.board("need").worth(best, "given", check=True)
    need_found = study.board("need").worth(best, "found", check=True)
    return Section(
        key="choosers",
        title="Every chooser, bare and checked",
        place="beyond the thesis",
        words=(
            "`visible` measures clearance to the visible cloud, as the thesis did; `exact` to "
            "exact surfaces, hidden sides included. The strict score counts only picks that fit, "
            "stay off the table and have a free approach, against the best there is; good ones are "
            "clear by 2 cm too. Scores and shares are of the answers.",
            f"Best without a grasp into the table (strict score over all scenarios, checked, "
            f"target found by the package): {best}. The package's default is {Config().chooser}. "
            "An SVM's first option that passes may be clear by little more than 2 cm; most room "
            "is what the score rewards.",
        ),
        rows=(
            Row(
                f"{best}, checked: answered, of {of} with a grasp clear by 2.5 cm",
                None,
                share(done, of),
            ),
            Row(f"{best}, checked: unobstructed", None, share(int(worth.unobstructed.sum()), done)),
            Row(
                f"{best}, checked: clear by 2 cm, exact", None, share(int(worth.clear.sum()), done)
            ),
            Row(f"{best}, checked: good, exact", None, share(int(worth.good.sum()), done)),
            Row(f"{best}, checked: score", None, mean(worth.score[worth.answered])),
            Row(f"{best}, checked: score, exact", None, mean(worth.exact_score[worth.answered])),
            Row(f"{best}, checked: strict score", None, mean(worth.strict_score[worth.answered])),
            Row(f"{best}, checked: into the table", None, int(worth.into_table.sum())),
            Row(
                f"{best}, checked: score, out-of-bias need, target given",
                "0.45 to 0.61 (cascade grid)",
                mean(need.score[need.answered]),
                f"{int(need.answered.sum())} of {len(need.answered)} answered",
            ),
            Row(
                f"{best}, checked: score, out-of-bias need, target found",
                None,
                mean(need_found.score[need_found.answered]),
                f"{int(need_found.answered.sum())} of {len(need_found.answered)} answered",
            ),
            Row(
                f"{best}, checked: the same, a request for help counted as 0",
                "0.45 to 0.61 (cascade grid)",
                mean(np.nan_to_num(need_found.score)),
            ),
        ),
        tables=tuple(
            Table(
                f"{'Checked' if check else 'Bare'}, {words}",
                COLUMNS,
                chooser_table(board, sight, check),
            )
            for sight, words in SEEN.items()
            for check in (False, True)
        ),
        pictures=(
            Picture(
                "choosers",
                "Strict score of every chooser, bare and checked, target found by the package.",
                svg=chooser_points(CHOOSERS, _strict(board, False), _strict(board, True)),
                alt="Points with intervals, two for each chooser",
            ),
        ),
    )


def best_checked(board: Board) -> str:
    """The chooser with the best strict score, checked, among those that never enter the table."""
    found = {name: board.worth(name, "found", check=True) for name in CHOOSERS}
    clean = [name for name in CHOOSERS if not found[name].into_table.any()] or list(CHOOSERS)
    return max(clean, key=lambda name: _of_all(found[name].strict_score))


def chooser_table(
    board: Board, sight: str, check: bool, choosers: tuple[str, ...] = CHOOSERS
) -> tuple[tuple[str | int | Estimate, ...], ...]:
    """A line a chooser, in the order of COLUMNS."""
    lines: list[tuple[str | int | Estimate, ...]] = []
    for name in choosers:
        worth = board.worth(name, sight, check)
        done = worth.answered
        count = int(done.sum())
        lines.append(
            (
                name,
                share(count, len(done)),
                mean(worth.score[done]),
                mean(worth.exact_score[done]),
                mean(worth.strict_score[done]),
                share(int(worth.unobstructed.sum()), count),
                share(int(worth.clear.sum()), count),
                share(int(worth.good.sum()), count),
                int(worth.into_table.sum()),
                int(worth.too_wide.sum()),
            )
        )
    return tuple(lines)


def _strict(board: Board, check: bool) -> tuple[Estimate, ...]:
    found = [board.worth(name, "found", check) for name in CHOOSERS]
    return tuple(mean(np.nan_to_num(worth.strict_score)) for worth in found)


def _of_all(score: np.ndarray) -> float:
    """The average with 0 for what was not answered."""
    return float(np.nan_to_num(score).mean())
