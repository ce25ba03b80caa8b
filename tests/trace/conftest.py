"""Scenes for the tests of the kernel: one XML text feeds the program and the float64 oracles alike."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from oracles import scene_xml, small_scenes

import mistray

LoadText = Callable[[str], tuple[Any, scene_xml.SceneModel]]


@pytest.fixture(scope="session")
def load_text(tmp_path_factory: pytest.TempPathFactory) -> LoadText:
    """XML text → (Mitsuba scene, model of the oracles)."""

    def load(text: str) -> tuple[Any, scene_xml.SceneModel]:
        path = small_scenes.write(tmp_path_factory.mktemp("scene"), text)
        return mistray.load(path), scene_xml.read_scene(path)

    return load


@pytest.fixture(scope="session")
def load_scene(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Any]:
    """XML text → Mitsuba scene, for scenes with shapes that the oracles do not read."""

    def load(text: str) -> Any:
        return mistray.load(small_scenes.write(tmp_path_factory.mktemp("scene"), text))

    return load
