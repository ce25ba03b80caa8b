"""The notebooks run, and are committed without what running them leaves behind."""

from __future__ import annotations

import re
from pathlib import Path

import nbformat
import peers
import pytest
from nbclient import NotebookClient
from tiers import slow_unless

NOTEBOOKS = sorted((Path(__file__).parents[1] / "notebooks").glob("*.ipynb"))
CELL_SECONDS = 300
# Run after the last cell of a notebook: its claims
CLAIMS = {
    "lens_bending": """
        assert peak_ratio.min() > 10
        spot = result.comparison.of("spot")
        assert 0.98 < spot.ratio < 1 / 0.98 and result.comparison.of("ghost").ratio > 10
        assert np.nanmin(radii[:, 1]) < 0.1 < 0.3 < np.nanmax(radii[:, 1])
    """,
    "fit_pst": """
        assert found.covers(TRUTH) and 1e-3 < found.probability
        assert np.all(found.standard_error / found.value < [0.2, 0.08, 0.1]) and found.correlation[0, 1] < -0.5
    """,
    "triplet_ar": """
        assert against_mgf2.total.ratio - 4.5 * against_mgf2.total.ratio_se > 3
        assert result.comparison.total.ratio - 4.5 * result.comparison.total.ratio_se > 1
        assert min(against_mgf2.rows, key=lambda row: row.ratio).wavelength_nm == 550
    """,
    # With 7 degrees of freedom 4.5 standard errors make a false pass as likely as 1.4e-3; the seeds are fixed
    "baffle_vanes": """
        stray, field = (result.comparison.of(name) for name in ("stray 20-80", "in field"))
        assert stray.ratio - 4.5 * stray.ratio_se > 10
        assert result.next_orders[0].taken
        assert rows["from the construction on"].ratio - 4.5 * rows["from the construction on"].ratio_se > 1
        assert light["from the construction on"].ratio + 4.5 * light["from the construction on"].ratio_se <= 1 / 0.99
        assert field.ratio + 4.5 * field.ratio_se <= 1 / 0.99
        assert slope["tube_vane_5.r1"] > 4.5 * error["tube_vane_5.r1"]
        assert (relative["half the width"].abs() < 4.5 * error).all()
    """,
    "mitsuba_adam": """
        assert losses[best] < 0.05 * losses[0] and 100 < layers[best][0] < 115
        assert ghosts["result"] < 0.9 * ghosts["quarter wave of MgF2"] < 0.1 * ghosts["start"]
    """,
    "phone_camera_ar": """
        assert (price.ratio - 4.5 * price.ratio_se > 1).all()
        assert price.designed.is_monotonic_decreasing
    """,
    "phone_camera_pst": """
        assert len(large) > 10 and 0.6 < ratio.min() < ratio.max() < 1.5
        assert len(in_both) >= 8
        expected = T_A_over_A * np.cos(np.radians(curve.field_deg[:9]))
        assert np.all(np.abs(direct[:9] - expected) < 4.5 * direct_se[:9] + 0.01 * expected)
        assert any(14 <= b.field_deg <= 20 for b in breaks(curve))
        assert once.loc[[20]].surface.iloc[0] == "barrel_4_cone" and once.loc[[20]].percent_of_first_level.iloc[0] > 35
        assert once.loc[[24]].surface.iloc[0] == "barrel_3_cone" and once.loc[[24]].percent_of_first_level.iloc[0] > 35
        assert abs(beam.scatter_surfaces(4.0).set_index("surface").power_W["window_front"] / 0.00512 - 1) < 0.2
        assert [angle for angle, rays in counts.items() if rays == 10**6][:4] == [10, 20, 30, 40]
    """,
    "first_ghost_table": """
        assert len(table) == 7 and (table.order == 2).sum() == 6 and table.kind[0] == "direct"
        assert abs(t.energy.closure) < 1e-5
        assert abs(ratio.value / expected - 1) < 1e-4  # R of the cone of light, up to 3° in the glass: 1e-5
        assert len(culprits) >= 1
        assert fall.value - 4.5 * fall.se > 2
        assert {"report.html", "paths.csv"} <= {file.name for file in files}
    """,
    "explorer": """
        assert best in ("L4", "L5") and table.percent[0] < -10 and len(table) == 7
        assert abs(off["percent"]) < 1 and np.all(np.abs(np.interp(checks, percent, curve) / values - 1) < 0.02)
        first, first_se = traced["stray_W"]
        assert abs(again.value - first) < 4.5 * np.hypot(again.se, first_se) < 0.02 * first
    """,
    "newtonian_webinar": """
        assert abs(field_deg + 20) < 1e-3 and np.allclose(along[1:], np.sin(np.radians([-20, 70])), atol=1e-5)
        assert np.allclose(np.hypot(*nodes[1:3, :2].T), tube, atol=1e-2) and np.allclose(to_eyepiece, 12.7, atol=1e-2)
        assert abs(t.energy.closure) < 1e-5 and "direct" not in by_kind.index
        assert near_scatters.idxmax() == 1 and by_parts.idxmax() == "eyepiece_tube"
        assert set(scatters.index) == set(slides.index) and scatters[2] > 3 * scatters[3] > 3
        assert far_by_parts.idxmax() == "tube, tube" and far_by_parts.max() > 50
        assert gap < 4.5 and 3 * relative["aimed"] < relative["at random"]
    """,
    "own_bsdf_plugin": """
        assert len([line for line in In[2].splitlines() if line.strip()]) <= 30
        assert "total is 1.2" in message and "\\n" not in message
        assert (abs(traced.ratio - 1) < 4.5 * traced.share_se / traced.share + 5e-3).all()
        assert (abs(traced.seen_ratio - 1) < 5e-3).all()
        assert abs(slope - slope_by_hand) < 4.5 * slope_se + 2e-3
    """,
    # Two samples of some 1e4 rays each: a flux of all rays differs by the rounding of vignetting, a radius by 1 %
    "lsst_ghosts": """
        assert len(two) == 34 and not missing
        assert (abs(both["flux ratio"] - 1) < 0.02).all() and (abs(both["radius ratio"] - 1) < 0.02).all()
        assert (abs(both["y difference"]) < 0.05 * both.rms_radius_mm).all()
        assert ours.index[0] == ("Filter_exit", "Filter_entrance")
        assert abs(ours.rms_radius_mm.iloc[0] / 7.91222 - 1) < 0.02
        assert len(again) == 1 and again.order.iloc[0] == 1 and abs(share_of_ghosts / 0.613 - 1) < 0.05
    """,
    # By hand is for normal incidence, from which the angles of these ghosts make 1 %
    "optiland": """
        assert faces == ["S1", "S3", "S5", "S7", "S9", "S11"]
        assert all(abs(fall.value / by - 1) < 0.02 + 4.5 * fall.se / by for fall, by in zip(falls, expected))
        assert total_fall.value - 4.5 * total_fall.se > 20
        assert [name for name in glass if coatings[name]] == faces and len(caught) == 6
        assert all(abs(coatings[name].reflectance / reflectance(name, FILM) - 1) < 1e-6 for name in faces)
        assert all(there[s.name].aperture.r_max == s.semi_diameter for s in lens.surfaces)
        assert check["largest difference [mm]"].max() < 1e-9
        assert (abs(check["flux of the chief ray"] / through - 1) < 1e-9).all()
        assert (check["chief y, as it came [mm]"] == check["back [mm]"]).all() and check["that the stop ends"][0] == 0
    """,
    "cooke_triplet_webinar": """
        assert len(traces[1e-3].paths) < len(traces[1e-4].paths) < len(traces[1e-6].paths)
        assert second == 1 and ghost.rms_radius_mm > 100 * bare.table(FIELD_DEG).rms_radius_mm.iloc[0]
        assert len(coarse.paths) > 10
        assert [path.kind for path in coarse_coated.paths] == ["direct"]
        assert fall.value - 4 * fall.se > 10
        assert whole[0].stray_W.value > 10 * whole[1].stray_W.value
    """,
}

# Run before the notebook of optiland, which the tests import without what it draws with
NOTED = re.compile(r".*MistrayWarning: .*\[[a-z-]+\]\n.*\n")  # a note of a result, and the line that has called
PEERS = f"import sys; sys.path.insert(0, {str(Path(__file__).parent)!r}); import peers; _ = peers.optiland('optic')"


def read(path: Path) -> nbformat.NotebookNode:
    return nbformat.read(path, as_version=4)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_committed_without_outputs_and_with_links_that_lead_somewhere(path):
    assert set(CLAIMS) <= {path.stem for path in NOTEBOOKS}
    notebook = read(path)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert (cell.outputs, cell.execution_count) == ([], None), f"{path.name}: clear the outputs"
    assert set(notebook.metadata) <= {"kernelspec", "language_info"}
    assert notebook.metadata.kernelspec.name == "python3"
    assert set(notebook.metadata.language_info) == {"name"}
    text = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    for target in re.findall(r"\]\((?!https?:)([^)#]+)", text):
        assert (path.parent / target).exists(), target
    for target in re.findall(r"\b(?:docs|examples)/[\w/]+\.(?:md|py)", text):  # also without a link
        assert (path.parents[1] / target).is_file(), target


# Their studies are those of examples/, which have tests of their own in tests/analyses/optimize
STUDIES = ("baffle_vanes", "phone_camera_ar", "triplet_ar")
RUN = [pytest.param(path, id=path.stem, marks=slow_unless(path.stem not in STUDIES)) for path in NOTEBOOKS]


@pytest.mark.long
@pytest.mark.parametrize("path", RUN)
def test_runs(path, tmp_path):
    notebook = read(path)
    if path.stem == "optiland":
        peers.need("optiland")
        notebook.cells.insert(0, nbformat.v4.new_code_cell(PEERS))
    claims = "\n".join(line.strip() for line in CLAIMS.get(path.stem, "").splitlines())
    notebook.cells.append(nbformat.v4.new_code_cell(claims))
    NotebookClient(notebook, timeout=CELL_SECONDS, resources={"metadata": {"path": str(tmp_path)}}).execute()
    outputs = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert any("image/png" in output.get("data", {}) for output in outputs), "no picture"
    widget = "application/vnd.jupyter.widget-view+json"
    assert any(widget in output.get("data", {}) for output in outputs) is (path.stem == "explorer")
    complaints = [output.text for output in outputs if output.output_type == "stream" and output.name == "stderr"]
    assert "".join(NOTED.sub("", text) for text in complaints) == ""
