"""A scene that is traced in a moment, explored."""

import pytest

from mistray.analyses.explorer.explorer import Explorer


@pytest.fixture(scope="module")
def explorer():
    found = Explorer("singlet_window_detector", field_deg=[0.0, 2.0], rays=2000, max_reflections=2)
    found.settle()
    return found


@pytest.fixture
def at_start(explorer):
    """The explorer with all controls as the scene says, traced."""
    explorer.reset()
    explorer.settle()
    return explorer
