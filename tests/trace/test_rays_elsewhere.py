"""Rays at any surface, and out of the scene, against the ledger of energy."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from command_line import fails, succeeds

import mistray


@pytest.fixture(scope="module")
def traced() -> mistray.Trace:
    return mistray.trace(mistray.load("singlet_window_detector"), rays=60, field_deg=5.0)


def test_incident_rays_are_those_of_the_ledger(traced) -> None:
    """To the rounding of sums: each ray is one hit, and carries its flux."""
    for name in ("window_front", "barrel_1_wall", "detector"):
        (row,) = [row for row in traced.surfaces if row.id == name]
        table = traced.rays_at(row.id, n=None)
        assert len(table) == row.hits
        assert set(table.surface) == {row.id}
        assert table.flux_W.sum() == pytest.approx(row.incident_W, rel=1e-6)
        np.testing.assert_allclose((table[["dx", "dy", "dz"]] ** 2).sum(axis=1), 1, rtol=1e-6)


def test_blocked_and_escaped_light_is_that_of_the_ledger(traced) -> None:
    walls = sum(row.absorbed_W for row in traced.surfaces if row.id != "detector")  # they are black
    assert traced.rays_at("blocked", n=None).flux_W.sum() == pytest.approx(walls, rel=1e-6)
    escaped = traced.rays_at("escaped", n=None)
    # What misses the first lens altogether has no event: the launched light less what arrives at first surfaces
    nodes = traced.rays_at("*", n=None)
    missed = traced.energy.launched_W - nodes.flux_W[nodes.node == 1].sum()
    assert escaped.flux_W.sum() + missed == pytest.approx(traced.energy.escaped_W, rel=1e-5)
    returned = traced.rays_at("returned", n=None)
    assert len(returned) == (escaped.dz < 0).sum() > 0  # the light goes along z


def test_a_filter_and_a_number(traced) -> None:
    table = traced.rays_at("window_front", "R(window_rear)", n=7)
    assert len(table) == 7
    assert table.history.str.contains("window_rear:SpecRefl").all()
    nodes = traced.rays_at("escaped", n=5, events=True)
    assert nodes.ray.nunique() == 5
    assert set(nodes.intercept[nodes.node == 0]) == {"Emitted"}


def test_refusals(traced) -> None:
    for where, selection, words in (
        ("windw", "", "'window'"),
        ("blockd", "", "'blocked'"),
        ("window", "power_W > 1", "'power_W'"),
        (["escaped", "window"], "", "alone"),
    ):
        with pytest.raises(mistray.MistrayError, match=words):
            traced.rays_at(where, selection)


@pytest.mark.long
def test_the_command_writes_rays_that_arrive(tmp_path, capsys):
    """All rays of a surface carry its incident flux, in every format; a file of them is a source of that flux."""
    out = tmp_path / "out"
    command = ["ghosts", "plate_and_wall", "--rays", "500", "--max-scatters", "1", "--quiet"]
    for more, word in (
        (["--rays-at", "scren", "--out", str(out)], "screen"),
        (["--rays-at", "screen"], "--out"),
        (["--rays-at", "escaped", "screen", "--out", str(out)], "alone"),
        (["--rays-at", "screen", "--filter", "power_W > 1", "--out", str(out)], "power_W"),
        (["--formats", "dat", "--out", str(out)], "--rays-at"),
    ):
        assert word in fails(capsys, *command, *more)
    more = ["--rays-at", "screen", "--most-rays", "0", "--formats", "dat", "parquet"]
    succeeds(capsys, *command, *more, "--out", out)
    rays = pd.read_csv(out / "rays_at.csv")
    surfaces = pd.read_csv(out / "surfaces.csv")
    (incident,) = surfaces.incident_W[surfaces.id == "screen"]
    assert rays.flux_W.sum() == pytest.approx(incident, rel=1e-6)
    assert set(rays.surface) == {"screen"}
    assert set(rays.kind) >= {"single scatter"}
    assert len(pd.read_parquet(out / "rays_at.parquet")) == len(rays)
    scene = mistray.load("plate_and_wall", sources=[{"type": "ray_file", "filename": str(out / "rays_at_0deg.dat")}])
    assert mistray.trace(scene, rays=200, max_scatters=0).energy.launched_W == pytest.approx(incident, rel=1e-5)
