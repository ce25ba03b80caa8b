"""Small scenes for the tests of gradients and designs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from oracles import small_scenes

import mistray


@pytest.fixture(scope="session")
def load_scene(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Any]:
    """XML text → Mitsuba scene."""

    def load(text: str) -> Any:
        return mistray.load(small_scenes.write(tmp_path_factory.mktemp("scene"), text))

    return load
