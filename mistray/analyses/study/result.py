"""Result of a stray-light study: its eight steps, objects, ghosts, PST and images."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mistray.analyses.ghosts.result import GhostReport
from mistray.analyses.objects.result import Objects
from mistray.analyses.pst.result import Pst
from mistray.analyses.study.first_order import FirstOrder
from mistray.analyses.study.step import STEPS, StudyStep
from mistray.analyses.transfer.result import Transfer
from mistray.errors import UnknownKeyError
from mistray.result import KeyNumber, Result


def step_warnings(study: Study, step: StudyStep) -> list[str]:
    """
    Return the warnings of a step, including the notes of the ghost analysis and the PST in step 8.

    Those of the ghost analysis that name ``max_scatters`` are left out.
    """
    found = list(step.warnings)
    if step.key == "analysis":
        # That scatter is not followed is meant so in the ghost analysis
        found += [f"ghosts, {text}" for text in study.ghosts.notes if "max_scatters" not in text]
        found += [f"PST, {text}" for text in study.pst.notes if text not in found]
    return found


@dataclass(frozen=True, eq=False, repr=False)
class Study(Mapping[str, StudyStep], Result, table=".page:findings_table", figure=".page:curve_of_study"):
    """
    Result of `study`: a mapping from the key of a step (see `mistray.analyses.study.step.STEPS`) to its result.

    Attributes
    ----------
    scene : mi.Scene
        Loaded scene.
    name : str
        Name of the system.
    steps : tuple of StudyStep
        The eight steps in order.
    settings : dict
        Arguments of the study, plain values.
    first_order : FirstOrder or None
        First-order data of step 1; None without a design path.
    objects : Objects
        Critical, illuminated and common objects of the steps 3 to 5.
    ghosts : GhostReport
        The ghost analysis of step 8.
    pst : Pst
        The point source transmittance of step 8.
    images : Transfer or None
        Images of points with their stray light of step 8; None if there are none, for a reason that the step states.

    Examples
    --------
    >>> found = mistray.study(mistray.load("newtonian_scatter"), [10, 30], [0], rays=2000)
    >>> list(found)[:3]
    ['optical_model', 'mechanical_model', 'critical_objects']
    >>> print(f"focal length {found.first_order.focal_length_mm:.0f} mm")
    focal length 1270 mm
    >>> found.pst.field_deg
    array([10., 30.])
    """

    scene: Any
    name: str
    steps: tuple[StudyStep, ...]
    settings: dict[str, Any]
    first_order: FirstOrder | None
    objects: Objects
    ghosts: GhostReport
    pst: Pst
    images: Transfer | None

    def key_numbers(self) -> dict[str, KeyNumber]:
        """Return the number of findings and of warnings, and the key numbers of the PST that have a unit, by label."""
        counts = {"findings": len(self.findings), "warnings": len(self.warnings)}
        return counts | {name: value for name, value in self.pst.key_numbers().items() if "[" in name}

    def __getitem__(self, key: str) -> StudyStep:
        found = next((step for step in self.steps if step.key == key), None)
        if found is None:
            raise UnknownKeyError(f"a study has no step '{key}'; its steps are {', '.join(name for name, _ in STEPS)}")
        return found

    def __iter__(self) -> Iterator[str]:
        return iter(step.key for step in self.steps)

    def __len__(self) -> int:
        return len(self.steps)

    @property
    def findings(self) -> list[str]:
        """Findings of the study, one sentence each, in the order of the steps."""
        return [text for step in self.steps for text in step.findings]

    @property
    def warnings(self) -> list[str]:
        """Warnings of the steps and notes of the ghost analysis and the PST, one line each; empty if all is well."""
        return [f"step {step.number}: {text}" for step in self.steps for text in step_warnings(self, step)]

    def write(self, directory: str | Path, command: str = "") -> list[Path]:
        """
        Write report.html, which contains the whole study, and every table as CSV.

        Parameters
        ----------
        directory : str or Path
            Created if it is missing. Files of the same names are replaced.
        command : str
            Command line, quoted in the report.

        Returns
        -------
        list of Path
            Files written.
        """
        from mistray.analyses.study.page import write

        return write(self, directory, command)

    def __str__(self) -> str:
        lines = [f"Study of '{self.name}'"]
        lines += [f"{step.number} {step.title}: {text}" for step in self.steps for text in step.findings]
        return "\n".join(lines + [f"warning: {text}" for text in self.warnings])
