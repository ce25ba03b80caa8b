"""Rubin/LSST ray by ray against batoid; see docs/validation/lsst.md."""

import numpy as np
import pytest

pytest.importorskip("batoid")

from validation.beside_batoid import LSST
from validation.tables import read, value

pytestmark = pytest.mark.validation

RAYS = 20_000
# 1°: the usual case. 1.6°: paths are clipped or lost, and light still clears the camera on its way from M2 to M3
FIELDS_DEG = (1.0, 1.6)


@pytest.fixture(scope="module", params=FIELDS_DEG)
def result(request):
    return request.param, LSST.compare(request.param, RAYS)


def test_every_path_of_batoid_and_no_other(result):
    """More are only those that come back to the camera by M3, which batoid's list of neighbours leaves out."""
    field, comparison = result
    assert not comparison.missing
    assert len(comparison.ghosts()) == {1.0: 34, 1.6: 32}[field]
    assert all(names.count("M3") > 1 for names in comparison.more)
    assert not [names for names in comparison.paths if names.count("M3") > 1]
    if field == 1.0:
        # one reflection, so that the list of two-reflection paths is batoid's exactly
        assert [comparison.order[names] for names in comparison.more] == [1]
    # Also of paths by M3: batoid itself, told to follow their surfaces, finds the same light
    agree(comparison.ghosts())
    agree(comparison.more)
    # A path that loses rays, each of which both programs must lose
    most = max(ours.rays for ours, _ in comparison.paths.values())
    assert sum(ours.rays < 0.95 * most for ours, _ in comparison.ghosts().values()) >= 15
    # Rounding of coordinates of metres blurs the image by less than a micrometre; the ghosts do not notice
    ours, theirs = comparison.image
    assert ours.rays == theirs.rays
    assert 0 <= ours.rms_mm**2 - theirs.rms_mm**2 < (1.5e-3) ** 2


MIRRORS, LEG_MM = 3, 11_000.0  # of the design path, and the longest way between two of them and back


def agree(pairs) -> None:
    """The same light, but for one ray on the edge of an aperture, within three RMS radii of the centroid; each mirror
    more is a leg over which single precision rounds a direction by 2^-24."""
    for names, (ours, theirs) in pairs.items():
        further = sum(name in ("M1", "M2", "M3") for name in names) - MIRRORS
        on_edge = abs(ours.rays - theirs.rays)
        assert on_edge <= 1
        share = on_edge / min(ours.rays, theirs.rays)
        assert abs(ours.flux / theirs.flux - 1) < 1e-6 + 1.001 * share
        apart = np.hypot(ours.x_mm - theirs.x_mm, ours.y_mm - theirs.y_mm)
        assert apart < 1e-3 + max(further, 0) * 2.0**-24 * LEG_MM + 3 * theirs.rms_mm * share
        assert abs(ours.rms_mm / theirs.rms_mm - 1) < 5e-5 + (3**2 - 1) / 2 * share


def test_the_camera_stands_in_the_way_beyond():
    """At 1.75° light on its way from M2 to M3 meets the side of the camera, which batoid does not know."""
    comparison = LSST.compare(1.75, RAYS)
    ours, theirs = comparison.image
    assert 0.001 < 1 - ours.rays / theirs.rays < 0.004


def test_the_report_holds_these_numbers(result):
    field, comparison = result
    rows = [row for row in read("lsst.md", "fields") if value(row["field °"])[0] == field]
    assert [int(row["found"]) for row in rows] == [len(comparison.ghosts()), len(comparison.more)]
    flux = 1e3 * sum(ours.flux for ours, _ in comparison.ghosts().values())
    assert value(rows[0]["flux ‰"])[0] == pytest.approx(flux, rel=0.02)
    if field == 1.0:
        found = {LSST.label(names): ours for names, (ours, _) in comparison.ghosts().items()}
        for row in read("lsst.md", "ghosts"):
            ours = found[row["turns at"]]
            assert value(row["flux ‰"])[0] == pytest.approx(1e3 * ours.flux, rel=0.01)
            assert value(row["y mm"])[0] == pytest.approx(ours.y_mm, abs=5 * ours.rms_mm / ours.rays**0.5)
            assert value(row["RMS radius mm"])[0] == pytest.approx(ours.rms_mm, rel=0.01)
