"""The steps of a stray-light study as text and as values for JSON."""

from __future__ import annotations

from typing import Any

from mistray.analysis.estimate import Estimate
from mistray.analysis.study.eight_steps import Study
from mistray.analysis.study.step import Fact, StudyStep
from mistray.files.json_values import plain
from mistray.report.tables import ghosts as tables
from mistray.report.tables import pst as pst_tables
from mistray.report.tables.frames import value_text
from mistray.report.tables.text import ABSENT


def fact_text(fact: Fact) -> str:
    """A fact's value with its unit."""
    text = value_text(fact.value)
    apart = "" if fact.unit == "°" else " "
    return f"{text}{apart}{fact.unit}" if fact.unit and text != ABSENT else text


def step_warnings(study: Study, step: StudyStep) -> list[str]:
    """What a reader must know before trusting a step, also what the reports of its parts say."""
    found = list(step.warnings)
    if step.key == "analysis":
        # That scatter is not followed is meant so in the ghost analysis
        found += [f"ghosts, {text}" for text in tables.warnings(study.ghosts) if "max_scatters" not in text]
        found += [f"PST, {text}" for text in pst_tables.warnings(study.pst) if text not in found]
    return found


def study_warnings(study: Study) -> list[str]:
    """All warnings of a study, each with its step."""
    return [f"step {step.number}: {text}" for step in study.steps for text in step_warnings(study, step)]


def study_text(study: Study) -> str:
    """What `mistray study` prints: findings of every step, then warnings."""
    lines = [f"Stray-light study of '{study.name}'"]
    for step in study.steps:
        lines += ["", f"{step.number} {step.title}"]
        lines += [f"  {text}" for text in step.findings or ("nothing to report",)]
    warnings = study_warnings(study)
    if warnings:
        lines += ["", *(f"warning: {text}" for text in warnings)]
    return "\n".join(lines)


def study_record(study: Study) -> dict[str, Any]:
    """All of a study as values that JSON knows: name, settings, steps (with facts, tables, findings) and warnings."""
    steps = [
        {
            "number": step.number,
            "key": step.key,
            "title": step.title,
            "text": step.text,
            "facts": [
                {
                    "name": fact.name,
                    "value": fact.value.value if isinstance(fact.value, Estimate) else fact.value,
                    "se": fact.value.se if isinstance(fact.value, Estimate) else None,
                    "unit": fact.unit,
                }
                for fact in step.facts
            ],
            "tables": {name: frame.to_dict("records") for name, frame in step.tables.items()},
            "findings": list(step.findings),
            "warnings": step_warnings(study, step),
            "seconds": step.seconds,
        }
        for step in study.steps
    ]
    return dict(plain({"name": study.name, "settings": study.settings, "steps": steps}))
