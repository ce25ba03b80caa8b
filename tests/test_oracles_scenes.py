"""The shipped scenes under the float64 oracles alone: closed energy, and no gaps between media."""

from __future__ import annotations

from pathlib import Path

import pytest
from oracles import beams, nonsequential, scene_xml

SCENES = sorted((Path(__file__).parents[1] / "scenes").glob("*/scene.xml"))
D_LINE_NM = 587.5618


@pytest.mark.long
@pytest.mark.parametrize("path", SCENES, ids=[path.parent.name for path in SCENES])
@pytest.mark.parametrize("field_deg", [0.0, 0.4, 9.0])
def test_energy_closes_and_media_fit(path: Path, field_deg: float) -> None:
    """Every ray meets each surface in the medium that the surface expects, and none ends inside of glass."""
    model = scene_xml.read_scene(path)
    rays = 40 if path.parent.name == "rubin" else 400  # its figure errors take the oracle long
    beam = beams.start(model, rays, field_deg)
    ledger = nonsequential.trace(
        model, beam.origin, beam.direction, beam.power, D_LINE_NM, max_reflections=1, max_events=64, flux_threshold=1e-6
    )
    assert abs(ledger.closure) < 1e-13
    open_plate = path.parent.name in ("plate", "lens_and_reflector")  # no edge: light leaves sideways
    leaks = {key: power for key, power in ledger.leaks_W.items() if not (open_plate and key[1] == "escape")}
    assert not leaks
    if field_deg == 0:
        assert ledger.detected_W > 0
        assert all(kind in ("SpecTran", "SpecRefl", "Absorbed") for _, kind in ledger.paths[0].events)
