"""Three telescopes ray by ray against batoid; see docs/validation/telescopes.md."""

from __future__ import annotations

import pytest

pytest.importorskip("batoid")

from validation.beside_batoid import Telescope

pytestmark = pytest.mark.validation

RAYS = 10_000
TELESCOPES = {
    "HSC": (Telescope("HSC_no_obsc.yaml", 750.0), (0.0, 0.3, 0.7)),
    "ComCam": (Telescope("ComCam_g.yaml", 480.0), (0.0, 0.2, 0.4)),
    "LSST": (Telescope("LSST_r.yaml", 620.0), (0.0, 1.0, 1.6)),
}
CASES = [(name, field) for name, (_, fields) in TELESCOPES.items() for field in fields]
FAINT = 1e-6  # of the star


@pytest.mark.long
@pytest.mark.parametrize(("name", "field_deg"), CASES)
def test_same_rays(name: str, field_deg: float) -> None:
    telescope = TELESCOPES[name][0]
    comparison = telescope.compare(field_deg, RAYS)
    ours, star = comparison.image
    assert ours.rays == star.rays
    assert abs(ours.rms_mm - star.rms_mm) < 2e-4  # single precision
    assert (ours.x_mm, ours.y_mm) == pytest.approx((star.x_mm, star.y_mm), abs=1e-3)
    assert not [
        names
        for names, sums in comparison.missing.items()
        if comparison.order[names] == 2 and sums.flux > FAINT * star.flux
    ]
    ghosts = {names: pair for names, pair in comparison.ghosts().items() if pair[1].flux > FAINT * star.flux}
    assert len(ghosts) > 30
    for names, (mine, theirs) in ghosts.items():
        given_up = telescope.unconverged(names, comparison) if mine.rays > theirs.rays else 0
        expected = theirs.flux * (1 + given_up / theirs.rays)  # all rays of a path have the same flux
        assert mine.flux == pytest.approx(expected, rel=3e-3), telescope.label(names)
