"""The claims of chapter 6, each held against what came out here."""

from __future__ import annotations

from boxgrasp.study.evaluation import Evaluation
from boxgrasp.study.intervals import Estimate, difference, share
from boxgrasp.study.report import Claim, Verdict
from boxgrasp.study.sections.chapter5 import lost_candidates
from boxgrasp.study.sections.need import CASCADE, SINGLE
from boxgrasp.study.sections.real import changed_running, changed_scenes
from boxgrasp.study.study import Study

YES: Verdict = "reproduced"
NO: Verdict = "not reproduced"
OTHER: Verdict = "different"


def claims(study: Study) -> tuple[Claim, ...]:
    """Chapter 6 and the results that it rests on."""
    evaluation, real = study.evaluation("tested"), study.evaluation("real")
    clear, safe = unobstructed(evaluation), green(evaluation)
    once = real.take(real.rows["run"] == 0)  # the runs of a scene are no scenes of their own
    real_clear, real_safe = unobstructed(once), green(once)
    novel = unobstructed(evaluation.take(~evaluation.known))
    grid = difference(evaluation.metrics(CASCADE).score, evaluation.metrics("cascade-spiral").score)
    single = difference(evaluation.metrics(SINGLE).score, evaluation.metrics("single-spiral").score)
    need = study.evaluation("need")
    off_center = difference(need.metrics(CASCADE).score, need.metrics(SINGLE).score)
    whole = difference(evaluation.metrics(CASCADE).score, evaluation.metrics(SINGLE).score)
    runs = study.scale.runs
    by_scene = real.metrics(CASCADE).score.reshape(-1, runs).mean(axis=1)
    noise = difference(by_scene, study.evaluation("real-clean").metrics(CASCADE).score)
    changing, scenes = len(changed_scenes(real, runs)), real.rows.count // runs
    steady = len(changed_scenes(study.evaluation("real-fused"), runs))
    running = {noise: changed_running(study, noise)[0] for noise in ("xtion", "strong")}
    labels = study.rows("labels").count
    lost, lost_noisy = lost_candidates(evaluation), lost_candidates(once)
    return (
        Claim(
            "A few hundred labels suffice, 10 to 10,000 times fewer than the learnt planners "
            "compared with.",
            "chapter 6, first",
            YES if holds(clear, 0.90) else OTHER,
            f"{labels} labels give {percent(clear)} unobstructed picks with cascade grid. The "
            "other planners were not trained again here; the factor is the thesis's.",
        ),
        Claim(
            "More than 90 % unobstructed, in simulation and on the robot.",
            "chapter 6, second",
            YES if holds(clear, 0.90) and holds(real_clear, 0.90) else OTHER,
            f"Cascade grid, bare: {percent(clear)} in simulation, {percent(real_clear)} in the "
            "stand-in for the robot, clearance to the visible cloud as in the thesis.",
        ),
        Claim(
            "Safely distant in more than 80 %.",
            "chapter 6, second",
            YES if holds(safe, 0.80) and holds(real_safe, 0.80) else NO,
            f"Green: {percent(safe)} in simulation, {percent(real_safe)} in the stand-in.",
        ),
        Claim(
            "Novel shapes: still above 90 % unobstructed.",
            "chapter 6, third",
            YES if holds(novel, 0.90) else NO,
            f"{percent(novel)} with the four novel targets.",
        ),
        Claim(
            "From simulation to a noisy sensor nothing is lost.",
            "chapter 6, fourth",
            YES if contains(noise, 0.0) else OTHER,
            f"On the same scenes strong noise changes the score by {signed(noise)}.",
        ),
        Claim(
            "Coarse cells sampled whole beat fine cells sampled in part, by more than 20 %.",
            "chapter 6, fifth; table 4-1",
            by_size(grid, single),
            f"Grid over spiral: {signed(single)} (single), {signed(grid)} (cascade); thesis: "
            "0.26 and 0.28. Spiral misses small things here too (see there), but scores 0.2 more "
            "than the thesis's; what cost the thesis's spiral so much is not known.",
        ),
        Claim(
            "Cascade does better where a line off the center is needed.",
            "section 5-2-2, table 4-2",
            YES if above(off_center, 0.0) else OTHER if contains(off_center, 0.0) else NO,
            f"Cascade less single grid: {signed(off_center)} where it is needed (thesis 0.28), "
            f"{signed(whole)} over all test scenarios (thesis 0.03).",
        ),
        Claim(
            "A coarse map hides some unobstructed grasps.",
            "chapter 6, sixth; figure 5-8",
            YES if above(lost, 0.0) and above(lost_noisy, 0.0) else NO,
            f"Of the candidates that are feasible in truth, 7 cm cells show {percent(lost)} as "
            f"occupied in simulation and {percent(lost_noisy)} under strong noise.",
        ),
        Claim(
            "Noise changes few decisions: 2 of 42.",
            "section 5-2-3",
            YES if max(running.values()) <= round(2 * scenes / 42) else NO,
            f"With a map that runs on as the thesis's did: {running['strong']} of {scenes} under "
            f"strong noise, {running['xtion']} under an Xtion's. With a map begun anew for each "
            f"decision: {changing} with one frame, {steady} with ten. One stray point fills a "
            "cell, and a cell or two decide between candidates that are nearly as good.",
        ),
    )  # fmt: skip


def by_size(grid: Estimate, single: Estimate) -> Verdict:
    """Whether grid beats spiral by more than 0.20, or at all, in both versions."""
    if above(grid, 0.20) and above(single, 0.20):
        return YES
    return OTHER if above(grid, 0.0) and above(single, 0.0) else NO


def unobstructed(evaluation: Evaluation) -> Estimate:
    """Share of cascade grid's bare picks clear by 2 cm of the visible cloud."""
    clear = evaluation.metrics(CASCADE).unobstructed
    return share(int(clear.sum()), len(clear))


def green(evaluation: Evaluation) -> Estimate:
    """Share of green picks of cascade grid."""
    counts = evaluation.categories(CASCADE)
    return share(counts[2], sum(counts))


def holds(found: Estimate, at_least: float) -> bool:
    """Whether the share found is at least that."""
    return found.value is not None and found.value >= at_least


def above(found: Estimate, value: float) -> bool:
    """Whether the whole interval lies above."""
    return found.low is not None and found.low > value


def contains(found: Estimate, value: float) -> bool:
    """Whether the interval holds the value."""
    return found.low is not None and found.high is not None and found.low <= value <= found.high


def percent(found: Estimate) -> str:
    """A share in words."""
    if found.value is None or found.low is None or found.high is None:
        return "nothing"
    return f"{100 * found.value:.1f} % ({100 * found.low:.1f} to {100 * found.high:.1f})"


def signed(found: Estimate) -> str:
    """A difference in words."""
    if found.value is None or found.low is None or found.high is None:
        return "nothing"
    return f"{found.value:+.3f} ({found.low:+.3f} to {found.high:+.3f})"
