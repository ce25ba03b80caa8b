"""Saving a state of the explorer as a scene with its coatings and parameters, or as a study that continues from it."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

from mistray._mitsuba_compat import peek
from mistray.analyses.explorer.controls import COATING, LAYERS, NUMBER, VALUES, Control, coatings_of
from mistray.analyses.explorer.looks import scaled
from mistray.analyses.explorer.request import SCENE_FILE, STUDY_FILE
from mistray.analyses.optimize.toml.read_study import read_study
from mistray.coatings import PRESETS, Stack, layer_text
from mistray.errors import MistrayError
from mistray.replace_file import draft_folder, replace_file
from mistray.scene import Rules, load
from mistray.scene.coat import coated_text
from mistray.scene.load import load_text
from mistray.scene.rewrite import rewritten

NOTE = "turned in the live explorer"
OF_OPTIMIZER = ("seed", "polarization")  # settings of traces that it chooses, or cannot differentiate
THICKNESS = 0.5, 2.0  # bounds of the layers of a study, over those of its start


class Saving:
    """
    Writer of explorer states as scene and study files.

    Parameters
    ----------
    path : Path
        Scene file that was explored; never overwritten.
    controls : mapping of str to Control
        Controls of the explorer, by name.
    settings : mapping
        Settings of the explorer's traces, which a study has as well, by name.
    folder : Path
        Folder of the files, created when something is saved.
    force : bool
        Whether to replace existing files.
    """

    def __init__(
        self,
        path: Path,
        controls: Mapping[str, Control],
        settings: Mapping[str, Any],
        folder: Path = Path(),
        force: bool = False,
    ) -> None:
        self._path, self._controls, self._settings = path, controls, settings
        self.folder, self.force = folder, force
        self._own: set[Path] = set()  # files that were written here, which a later state may replace

    def scene(self, state: Mapping[str, VALUES]) -> Path:
        """
        Write a scene with the coatings and parameters of a state, without field and wavelength, and return its path.

        Raises
        ------
        MistrayError
            If the file exists and is not to be replaced, or cannot be written.
        """
        target = self._target(SCENE_FILE)
        text = self._scene_text(state)
        load_text(target, text)
        return self._write(target, text, "scene file")

    def study(self, state: Mapping[str, VALUES], field_deg: float | None) -> Path:
        """
        Write a study for ``mistray optimize`` whose variables are the moved controls, and return its path.

        `field_deg` is the field angle of its term in degrees, or None for that of the scene.

        Raises
        ------
        MistrayError
            For the reasons given at `scene`; also if no control that a study can vary was moved.
        """
        target = self._target(STUDY_FILE)
        text = "\n".join(self._study_lines(state, field_deg)) + "\n"
        with draft_folder(self.folder) as draft:
            (draft / STUDY_FILE).write_text(text, encoding="utf-8")
            read_study(draft / STUDY_FILE)  # what cannot be read is no study
        return self._write(target, text, "study")

    def _write(self, target: Path, text: str, what: str) -> Path:
        replace_file(target, text, what)
        self._own.add(target)
        return target

    def _target(self, name: str) -> Path:
        target = self.folder / name
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise MistrayError(f"folder '{self.folder}' cannot be made: {error.strerror}; name another one") from None
        if os.path.exists(target) and os.path.samefile(target, self._path):
            raise MistrayError(f"'{target}' is the scene that is explored; save into another folder")
        if os.path.lexists(target) and not self.force and target not in self._own:
            raise MistrayError(f"'{target}' exists; move it away, or start the explorer with --force")
        return target

    def _scene_text(self, state: Mapping[str, VALUES]) -> str:
        rules = Rules(coatings=coatings_of(self._controls, state))
        text = coated_text(self._path, rules, self._path.parent)[0] if rules else None
        params = mi.traverse(load(self._path) if text is None else load_text(self._path, text))
        return rewritten(self._path, self._values(state, params), self.folder, NOTE, text)

    def _values(self, state: Mapping[str, VALUES], params: mi.SceneParameters) -> dict[str, np.ndarray]:
        found = {
            key: np.array([float(state[name])])
            for name, one in self._controls.items()
            for key in one.keys
            if state[name] != one.start and key in params
        }
        if state.get("layers", 100.0) != 100.0:
            for key in params.keys():  # noqa: SIM118  (mi.SceneParameters iterates over pairs)
                if key.endswith("thickness_nm"):
                    found[key] = np.array(peek(params, key), dtype=np.float64) * float(state["layers"]) / 100
        return found

    def _study_lines(self, state: Mapping[str, VALUES], field_deg: float | None) -> Iterator[str]:
        turned = [one for name, one in self._controls.items() if state[name] != one.start]
        coated = [one for one in turned if one.kind == COATING and state[one.name] in PRESETS]
        numbers = [one for one in turned if one.kind == NUMBER]
        if not coated and not numbers:
            raise MistrayError("no control is turned that a study can vary; choose a coating with layers, or a number")
        yield f"# The controls that were {NOTE}, as variables for the least stray light."
        yield "# mistray optimize takes it with the scene that was explored, and with the one that was saved."
        for one in turned:
            if one not in coated and one not in numbers and one.kind in (COATING, LAYERS):
                yield f"# Not among them: {one.label}, {state[one.name]}."
        yield from ["", "[[term]]", 'name = "stray light"', 'kind = "path_power"', 'goal = "minimise"',
                    'selection = "stray"']  # fmt: skip
        if field_deg is not None:
            yield f"field_deg = [{field_deg!r}]"
        if "wavelength" in state:
            yield f"wavelength_nm = [{float(state['wavelength'])!r}]"
        yield "rays = 5000"
        yield from (f"{name} = {json.dumps(one)}" for name, one in self._settings.items() if name not in OF_OPTIMIZER)
        factor = float(state.get("layers", 100.0)) / 100
        low, high = THICKNESS
        number = 0
        for one in coated:
            on: dict[str, tuple[Stack, list[str]]] = {}  # by material: each has layers of its own
            for (surface, coating), body in zip(one.coatings(str(state[one.name])).items(), one.bodies, strict=True):
                assert isinstance(coating, Stack)
                on.setdefault(body, (scaled(coating, factor), []))[1].append(surface)
            for stack, names in on.values():
                number += 1
                bounds = ", ".join(
                    f"[{low * layer.thickness_nm:.6g}, {high * layer.thickness_nm:.6g}]" for layer in stack.layers
                )
                surfaces = ", ".join(map(_text, names))
                yield from ["", "[[coating]]", f'name = "explored_{number}"', f"surfaces = [{surfaces}]",
                            f"layers = {_text(layer_text(stack.layers))}", f"thickness_nm = [{bounds}]"]  # fmt: skip
        for one in numbers:
            keys = ", ".join(map(_text, one.keys))
            yield from ["", "[[variable]]", f"parameters = [{keys}]", f"low = {one.low!r}",
                        f"high = {one.high!r}", *(['scale = "log"'] if one.log else [])]  # fmt: skip


def _text(value: str) -> str:
    """Return a value as a quoted TOML string, escaped as in JSON."""
    return json.dumps(value, ensure_ascii=False)
