"""Critical rays: centre and rim of the beam that forms the image, as the trace has them, and where they go."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import fails, succeeds
from oracles.scatter_scenes import beam_xml, placed_xml, scatter_scene
from oracles.small_scenes import interface_xml

import mistray
from mistray.analysis.critical_rays import critical_rays

RADIUS, FOCUS = 4.0, 60.0  # of the stop; of the mirror


def test_the_rim_of_a_stop(load_scene: Callable[[str], Any]) -> None:
    """A parabolic mirror behind a stop: rim rays come through its edge, and in the axis all end in the focus."""
    text = scatter_scene(
        beam_xml(9.0),
        placed_xml("asphere", "stop", at=(0, 0, -70.0), semi_diameter=20.0, inner_semi_diameter=RADIUS),
        placed_xml("asphere", "mirror", interface_xml(R=0.9, mirror=True), radius=-2 * FOCUS, conic=-1.0,
                   semi_diameter=20.0),
        placed_xml("asphere", "detector", at=(0, 0, -FOCUS), half_width=0.5, half_height=0.5, pixels=4),
    )  # fmt: skip
    table = critical_rays(load_scene(text), [0.0], rim=4, rays=20_000)
    assert table.name.unique().tolist() == ["centre", "rim 0°", "rim 90°", "rim 180°", "rim 270°"]
    starts = table[table.node == 0].set_index("name")[["x_mm", "y_mm"]]
    expected = {"rim 0°": (1, 0), "rim 90°": (0, 1), "rim 180°": (-1, 0), "rim 270°": (0, -1)}
    for name, (x, y) in expected.items():
        along = starts.loc[name].to_numpy() @ (x, y)
        assert RADIUS * (1 - 3 / 20_000**0.5) < along <= RADIUS
    # The detector hides the middle
    assert np.linalg.norm(starts.loc["centre"]) < 0.5 * 2**0.5 + 0.1
    ends = table[table.intercept == "Absorbed"]
    np.testing.assert_allclose(ends[["x_mm", "y_mm"]], 0, atol=1e-9)
    assert np.ptp(ends.opl_mm) < 1e-9


def test_fields_and_wavelengths() -> None:
    scene = mistray.load("cooke_triplet")
    table = critical_rays(scene, [0.0, 8.0], wavelength_nm=[486.1, 656.3], rays=2000)
    assert set(zip(table.field_deg, table.wavelength_nm, strict=True)) == {
        (field, line) for field in (0.0, 8.0) for line in (486.1, 656.3)
    }
    names = table.groupby(["field_deg", "wavelength_nm"]).name.unique()
    assert all(group[0] == "centre" and 5 <= len(group) <= 9 for group in names)
    for _, ray in table.groupby("ray"):
        assert ray.intercept.tolist() == ["Emitted", *["SpecTran"] * 6, "Absorbed"]
        assert ray.node.tolist() == list(range(8))
        d = ray[["dx", "dy", "dz"]].iloc[0].to_numpy(np.float64)
        assert np.degrees(np.arctan2(d[1], d[2])) == pytest.approx(ray.field_deg.iloc[0], abs=1e-6)


def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = tmp_path / "critical.csv"
    record = json.loads(succeeds(capsys, "export", "cooke_triplet", "-o", file, "--field-deg", 0, 5, "--json"))
    with open(file, encoding="utf-8", newline="") as text:
        rows = list(csv.DictReader(text))
    assert record["rays"] == len({row["ray"] for row in rows})
    assert {float(row["field_deg"]) for row in rows} == set(record["fields_deg"]) == {0.0, 5.0}
    assert "field 80 deg" in fails(capsys, "export", "cooke_triplet", "-o", file, "--force", "--field-deg", 80)
    with pytest.raises(mistray.MistrayError, match="rim is 0"):
        critical_rays(mistray.load("cooke_triplet"), rim=0)
