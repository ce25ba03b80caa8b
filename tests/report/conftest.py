"""The small scene of `view_scene` and a trace of it without a tracer."""

from __future__ import annotations

import pytest
from report.fake_trace import paths_at
from report.view_scene import SCENE, RayTrace

import mistray


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "scene.xml"
    path.write_text(SCENE, encoding="utf-8")
    return mistray.load(path)


@pytest.fixture(scope="module")
def trace():
    return RayTrace(paths_at(10.0), 10.0)
