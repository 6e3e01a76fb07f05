"""The whole thesis again: cast, label, train, judge, report. What is finished is not done again."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from boxgrasp.study.report import Report, Section
from boxgrasp.study.report_pages import write
from boxgrasp.study.sections.appendix_a import appendix_section
from boxgrasp.study.sections.captures import captures_section
from boxgrasp.study.sections.causes import causes_section
from boxgrasp.study.sections.chapter5 import chapter5_section
from boxgrasp.study.sections.claims import claims
from boxgrasp.study.sections.declared import declared_section
from boxgrasp.study.sections.figures_discussion import discussion_section
from boxgrasp.study.sections.figures_method import method_section
from boxgrasp.study.sections.figures_results import decisions_section
from boxgrasp.study.sections.full import (
    curves_section,
    lines_section,
    mirror_section,
    network_section,
)
from boxgrasp.study.sections.labels import labels_section
from boxgrasp.study.sections.need import need_section, pooled_section
from boxgrasp.study.sections.rankers import rankers_section
from boxgrasp.study.sections.readings import readings_section
from boxgrasp.study.sections.real import real_section
from boxgrasp.study.sections.results import agreement_section, results_section, scores_section
from boxgrasp.study.sections.samples import samples_section
from boxgrasp.study.sections.scenes import scenes_section
from boxgrasp.study.sections.solvable import solvable_section
from boxgrasp.study.sections.training import training_section
from boxgrasp.study.sections.variants import variants_section
from boxgrasp.study.study import Study
from boxgrasp.version import __version__

NOTICE = (
    "The operator who labeled these scenes is a stand-in, not a human: a rule with a person's "
    "habits. The robot and its real table are a stand-in too: simulated scenes with strong noise."
)


def reproduce(study: Study, captures: Path | None = None) -> Report:
    """Do what is not done yet, and write report.html, report.md and report.json.

    Args:
        study: where and how much.
        captures: a folder of real captures to decide on too, or None.

    Returns:
        The report.

    Raises:
        ConfigError: the place holds a study made otherwise.
        StoreError: the place cannot be read or written.
        WorkError: workers were lost.
        MissingExtraError: a part of the extra `train` is not installed.
    """
    study.cast()
    report = Report(
        title="Learning autonomous grasping strategies: the thesis beside this package",
        made_with=_made_with(study),
        sections=tuple(_sections(study, captures)),
        claims=claims(study),
        notice=NOTICE,
    )
    write(report, study.store)
    return report


def _sections(study: Study, captures: Path | None) -> list[Section]:
    sections = [
        declared_section(),
        samples_section(),
        scenes_section(study),
        labels_section(study),
        training_section(study),
        results_section(study, study.scale.first),
        results_section(study),
        agreement_section(study),
        scores_section(study),
        variants_section(study),
        readings_section(study),
        causes_section(study),
        need_section(study),
        real_section(study),
        appendix_section(study),
        pooled_section(study),
        chapter5_section(study),
        rankers_section(study),
        solvable_section(study),
        method_section(study),
        decisions_section(study),
        discussion_section(study),
    ]
    if captures is not None:
        sections.append(captures_section(study, captures))
    if study.scale.full:
        sections += [
            lines_section(study),
            network_section(study),
            curves_section(study),
            mirror_section(study),
        ]
    return sections


def _made_with(study: Study) -> dict[str, str]:
    made = {
        "boxgrasp": __version__,
        "python": platform.python_version(),
        "machine": platform.machine(),
        "seed": str(study.seed),
        "sets": ", ".join(f"{name} ({c.count})" for name, c in study.sets().items()),
    }
    for name in ("numpy", "scikit-learn", "onnxruntime", "mujoco"):
        try:
            made[name] = version(name)
        except PackageNotFoundError:
            made[name] = "not installed"
    return made
