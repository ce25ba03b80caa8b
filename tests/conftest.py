"""Order of the tests: two processes take whole files, so that those that take minutes come first."""

from __future__ import annotations

import pytest

LONG = (
    "test_notebooks.py",
    "test_readme.py",
    "test_triplet_ar.py",
    "test_fit.py",
    "test_docs.py",
    "test_phone_camera.py",
    "test_pst_adjoint_forward.py",
    "test_replay.py",
    "test_scatter_aiming.py",
)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files of `LONG` in their order, then all others as they come."""
    rank = {name: number for number, name in enumerate(LONG)}
    items.sort(key=lambda item: rank.get(item.path.name, len(rank)))
