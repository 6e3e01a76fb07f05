"""The whole thesis again: cast, label, train, judge, report. What is finished is not done again."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from boxgrasp import __version__
from boxgrasp.evaluate.report import Report, Section
from boxgrasp.evaluate.report_pages import write
from boxgrasp.evaluate.sections.captures import captures_section
from boxgrasp.evaluate.sections.chapter5 import chapter5_section
from boxgrasp.evaluate.sections.choosers import choosers_section
from boxgrasp.evaluate.sections.claims import claims
from boxgrasp.evaluate.sections.full import (
    curves_section,
    lines_section,
    mirror_section,
    network_section,
)  # fmt: skip
from boxgrasp.evaluate.sections.labels import labels_section
from boxgrasp.evaluate.sections.need import need_section, pooled_section
from boxgrasp.evaluate.sections.readings import readings_section
from boxgrasp.evaluate.sections.real import real_section
from boxgrasp.evaluate.sections.results import (
    agreement_section,
    results_section,
    scores_section,
)  # fmt: skip
from boxgrasp.evaluate.sections.samples import samples_section
from boxgrasp.evaluate.sections.scenes import scenes_section
from boxgrasp.evaluate.sections.training import training_section
from boxgrasp.evaluate.study import Study

NOTICE = (
    "The operator who labelled these scenes is a stand-in, not a human: a rule with a person's "
    "habits. The robot and its real table are a stand-in too: simulated scenes with strong noise."
)


def reproduce(study: Study, captures: Path | None = None) -> Report:
    """Do what is not done yet, and write report.html, report.md and report.json."""
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
        samples_section(),
        scenes_section(study),
        labels_section(study),
        training_section(study),
        results_section(study, study.scale.first),
        results_section(study),
        agreement_section(study),
        scores_section(study),
        readings_section(study),
        need_section(study),
        real_section(study),
        pooled_section(study),
        chapter5_section(study),
        choosers_section(study),
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
