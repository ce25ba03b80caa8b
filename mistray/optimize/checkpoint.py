"""The state of an optimisation in a file, written whole after every step."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mistray.errors import MistrayError
from mistray.optimize.designs import Design
from mistray.replace_file import replace_file

FORM = 1  # changes when the content does


@dataclass(frozen=True)
class Step:
    """
    One step of the search.

    Attributes
    ----------
    start : int
        Number of the start design that the search began with.
    step : int
        0 is the start design itself.
    evaluations : int
        Gradients computed so far, all searches together.
    value, value_se : float
        The metric and its standard error.
    gradient_norm : float
        Root of the sum of squares of d log(metric)/d thickness over the layers that are free to move, 1/nm.
    seconds : float
        Since the beginning, interruptions left out.
    thickness_nm : dict
        Name of the coating → thicknesses, nm.
    """

    start: int
    step: int
    evaluations: int
    value: float
    value_se: float
    gradient_norm: float
    seconds: float
    thickness_nm: dict[str, list[float]]


@dataclass
class State:
    """
    All that is needed to go on.

    Attributes
    ----------
    designs : list of Design
        The start designs.
    steps : list of Step
    ended : dict
        Number of a start → why its search ended.
    """

    designs: list[Design] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    ended: dict[int, str] = field(default_factory=dict)

    def last(self, start: int) -> Step:
        """The last step of one search."""
        return next(step for step in reversed(self.steps) if step.start == start)

    def best(self) -> Step:
        """The step with the smallest metric."""
        return min(self.steps, key=lambda step: step.value)


class Checkpoint:
    """
    A file with the state of an optimisation.

    Parameters
    ----------
    path : Path
    scene : Path
        Scene file; its content is part of what must agree.
    study : str
        Fingerprint of the study.
    """

    def __init__(self, path: Path, scene: Path, study: str) -> None:
        self.path = path
        self.key = {"form": FORM, "scene": hashlib.sha256(scene.read_bytes()).hexdigest(), "study": study}

    def write(self, state: State) -> None:
        """Replace the file; on an error the old one stays."""
        content: dict[str, Any] = {
            **self.key,
            "designs": [
                {"name": d.name, "thickness_nm": {k: list(map(float, v)) for k, v in d.thickness_nm.items()}}
                for d in state.designs
            ],
            "ended": {str(start): reason for start, reason in state.ended.items()},
            "steps": [asdict(step) for step in state.steps],
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(self.path, json.dumps(content, indent=1), "checkpoint")

    def read(self) -> State:
        """
        Read the state back.

        Raises
        ------
        MistrayError
            If there is no such file, it is damaged, or it belongs to another study, scene or version.
        """
        try:
            content = json.loads(self.path.read_text(encoding="utf-8"))
            found = {key: content[key] for key in self.key}
            state = State(
                [
                    Design(d["name"], {k: np.array(v, dtype=np.float64) for k, v in d["thickness_nm"].items()})
                    for d in content["designs"]
                ],
                [Step(**step) for step in content["steps"]],
                {int(start): str(reason) for start, reason in content["ended"].items()},
            )
        except OSError as error:
            raise MistrayError(f"checkpoint '{self.path}': {error.strerror}; run without resuming") from None
        except (ValueError, KeyError, TypeError, AttributeError):
            raise MistrayError(f"checkpoint '{self.path}' is damaged; remove it and run without resuming") from None
        for key, what in (("form", "version of mistray"), ("scene", "scene"), ("study", "study")):
            if found[key] != self.key[key]:
                raise MistrayError(
                    f"checkpoint '{self.path}' belongs to another {what}; use another folder or run without resuming"
                )
        return state
