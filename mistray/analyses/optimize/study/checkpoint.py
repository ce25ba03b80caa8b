"""Checkpoint file with the state of an optimisation, rewritten whole after every evaluation of the merit."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from mistray.analyses.optimize.study.state import Evaluation, Start, State
from mistray.cache.fingerprint import file_fingerprint
from mistray.errors import MistrayError
from mistray.read_file import read_file
from mistray.replace_file import replace_file
from mistray.scene.files import scene_files

FORM = 3  # changes when the content does


class Checkpoint:
    """
    File that holds the state of an optimisation for later resumption.

    Parameters
    ----------
    path : Path
        File to write and read.
    scene : Path
        Scene file; its content, and that of all files it names, must be unchanged when the state is read back.
    study : str
        Fingerprint of the study.
    """

    def __init__(self, path: Path, scene: Path, study: str) -> None:
        self.path = path
        contents = "".join(map(file_fingerprint, scene_files(scene)))
        self.key = {"form": FORM, "scene": contents, "study": study}

    def write(self, state: State) -> None:
        """Write the state to the file; on an error the previous file stays."""
        content: dict[str, Any] = {
            **self.key,
            "left_out": state.left_out,
            "starts": [{"name": start.name, "x": start.x.tolist()} for start in state.starts],
            "evaluations": [[_plain(evaluation) for evaluation in search] for search in state.evaluations],
        }
        self.path.parent.mkdir(parents=True, exist_ok=True)
        replace_file(self.path, json.dumps(content), "checkpoint")  # floats come back as they were, to the last bit

    def read(self) -> State:
        """
        Return the state that the file holds.

        Raises
        ------
        MistrayError
            If there is no such file, it is damaged, or it belongs to another study, scene or version.
        """
        data = read_file(self.path, "checkpoint", "run without resuming", own=True)
        try:
            content = json.loads(data)
            found = {key: content[key] for key in self.key}
        except (ValueError, KeyError, TypeError, RecursionError):
            raise self._damaged() from None
        for key, what in (("form", "version of mistray"), ("scene", "scene"), ("study", "study")):
            if found[key] != self.key[key]:
                raise MistrayError(
                    f"checkpoint '{self.path}' belongs to another {what}; use another folder or run without resuming"
                )
        try:
            return State(
                [Start(str(start["name"]), np.array(start["x"], dtype=np.float64)) for start in content["starts"]],
                [[_evaluation(**item) for item in search] for search in content["evaluations"]],
                [str(text) for text in content["left_out"]],
            )
        except (ValueError, KeyError, TypeError, AttributeError):
            raise self._damaged() from None

    def _damaged(self) -> MistrayError:
        return MistrayError(f"checkpoint '{self.path}' is damaged; remove it and run without resuming")


def _plain(evaluation: Evaluation) -> dict[str, Any]:
    slopes = {name: slope.tolist() for name, slope in evaluation.slopes.items()}
    return {**vars(evaluation), "y": evaluation.y.tolist(), "slope": evaluation.slope.tolist(), "slopes": slopes}


def _evaluation(y: list[float], slope: list[float], slopes: dict[str, list[float]], **others: Any) -> Evaluation:
    return Evaluation(
        y=np.array(y, dtype=np.float64),
        slope=np.array(slope, dtype=np.float64),
        slopes={name: np.array(values, dtype=np.float64) for name, values in slopes.items()},
        **others,
    )
