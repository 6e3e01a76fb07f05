"""The package's own answers where there is a good grasp, bare and checked; the docs quote them."""

from __future__ import annotations

from boxgrasp.study.answers.figures import share_of
from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import mean
from boxgrasp.study.report import Row, Section
from boxgrasp.study.sections.need import CASCADE
from boxgrasp.study.sections.rankers import SOLVABLE_M
from boxgrasp.study.study import Study

KEY = "solvable"
DEFAULT = "clearance"


def solvable_section(study: Study) -> Section:
    """Good grasps and strict scores of cascade grid and of the default, and what chance gives.

    Args:
        study: whose test scenarios they are.

    Returns:
        The section.
    """
    tested = study.evaluation("tested")
    evaluation = tested.take(tested.rows["best_m"] >= SOLVABLE_M)
    chance = tested.chance
    grid = tested.metrics(CASCADE)
    return Section(
        key=KEY,
        title="The package where there is a good grasp",
        place="beyond the thesis",
        words=(
            f"{evaluation.rows.count} of the {tested.rows.count} test scenarios have a grasp clear "
            "by 2.5 cm. The target is found by the package. A good grasp is clear by 2 cm to exact "
            "surfaces, fits and stays off the table; shares of good grasps are of the answers, "
            "strict scores of the answers too.",
        ),
        rows=(
            *(row for name in (CASCADE, DEFAULT) for row in _rows(evaluation, name)),
            Row("score of a random candidate, all test scenarios", None, mean(chance.score)),
            Row(f"score of {CASCADE} by distance alone", None, mean(grid.clearance_score)),
            Row(
                "score of a random candidate by distance alone", None, mean(chance.clearance_score)
            ),
        ),
    )


def _rows(evaluation: Evaluation, name: str) -> list[Row]:
    rows = []
    for word, checked in (("bare", False), ("checked", True)):
        metrics = evaluation.metrics(name, "found", checked=checked)
        done = metrics.answered
        rows += [
            Row(f"{name}, {word}: answered", None, share_of(done)),
            Row(f"{name}, {word}: good grasps", None, share_of(metrics.good, done)),
            Row(f"{name}, {word}: strict score", None, mean(metrics.strict_score[done])),
        ]
    return rows
