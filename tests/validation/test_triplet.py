"""The webinar's Cooke triplet: bare, and with a three-layer coating on every lens surface."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import mistray
from mistray.prescription import Coating
from mistray.scenes.cooke_triplet.prescription import build

FIELDS_DEG = (0.0, 10.0, 20.0)

pytestmark = pytest.mark.validation


def triplet(**coating: Any) -> Any:
    prescription = build()
    if not coating:
        return prescription.to_scene()
    surfaces = tuple(replace(s, coating=Coating(**coating)) for s in prescription.surfaces)
    return replace(prescription, surfaces=surfaces).to_scene()


def ghost_share(scene: Any, field_deg: float, **more: Any) -> tuple[float, float]:
    paths = mistray.trace(scene, rays=20_000, field_deg=field_deg, **more).paths
    direct = sum(row.power_W for row in paths if row.kind == "direct")
    power, se = paths.power(np.flatnonzero(paths.column("kind") == "ghost"))
    return power / direct, se / direct


@pytest.mark.parametrize("field_deg", FIELDS_DEG)
@pytest.mark.parametrize("wavelength_nm", [486.1, 587.6, 650.0])
def test_three_layers_lower_the_ghosts_tenfold(field_deg, wavelength_nm) -> None:
    bare, bare_se = ghost_share(triplet(), field_deg, wavelength_nm=wavelength_nm)
    coated, coated_se = ghost_share(triplet(preset="bbar3"), field_deg, wavelength_nm=wavelength_nm)
    assert bare - 5 * bare_se > 10 * (coated + 5 * coated_se)


@pytest.mark.parametrize("field_deg", FIELDS_DEG)
def test_only_the_design_path_is_left(field_deg) -> None:
    """Flux threshold 1e-3, as in the webinar: bare, ghosts reach the detector; coated, none does."""
    more = {"rays": 20_000, "field_deg": field_deg, "flux_threshold": 1e-3}
    assert {row.kind for row in mistray.trace(triplet(), **more).paths} >= {"direct", "ghost"}
    coated = mistray.trace(triplet(preset="bbar3"), **more)
    assert {row.kind for row in coated.paths} == {"direct"}
    assert coated.energy.cut["flux_threshold"] > 0
