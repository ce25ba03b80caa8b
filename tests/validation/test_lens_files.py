"""Every lens file of optiland, ray-optics and tests/data/lenses against their frozen focal lengths and rays."""

import functools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import peer_lenses
import peers
import pytest
import vectors
from refusals import refused

from mistray.materials import refractive_index
from mistray.prescription import Sequential, from_codev, from_zemax
from mistray.prescription.sequential.first_order import first_order, paraxial_system
from mistray.prescription.sequential.rays import to_world, trace

FILES = peer_lenses.files()
SAME_FOCUS = 1e-6  # relative, of focal lengths
SAME_RAY_MM = 1e-6
SAME_DIRECTION = 1e-7  # of direction cosines
PEERS = peer_lenses.PEERS
SUMMARY = {row["file"]: row for row in vectors.rows(peer_lenses.FIRST_ORDER.name)}
RAYS: dict[str, list[dict[str, str]]] = {}
for line in vectors.rows(peer_lenses.RAYS.name):
    RAYS.setdefault(line["file"], []).append(line)


def path_of(name: str) -> Path:
    file = next(file for file in SUMMARY if file == name or file.endswith(f"/{name}"))
    if not file.startswith("tests/"):
        peers.need(file.partition("/")[0])
    return FILES[file]


@functools.cache
def lens(name: str) -> Sequential:
    return peer_lenses.read(path_of(name))


def same(a: float, b: float) -> bool:
    return a == b or abs(a - b) <= SAME_FOCUS * min(abs(a), abs(b))


def ends(file: str, program: str) -> np.ndarray:
    return np.array([[float(row[f"{program}_{key}"]) for key in "xyzLMN"] for row in RAYS[file]])


def starts(file: str) -> tuple[np.ndarray, np.ndarray]:
    start, along = (np.array([[float(row[key]) for key in keys] for row in RAYS[file]]) for keys in ("xyz", "LMN"))
    return start, along


def our_ends(file: str) -> np.ndarray:
    hits, onward = trace(lens(file), *starts(file), float(RAYS[file][0]["wavelength_nm"]))
    return np.concatenate([hits[-1], onward[-1]], axis=1)


def check_rays(ours: np.ndarray, theirs: np.ndarray, *, directions: bool = True) -> None:
    assert ours[:, :3] == pytest.approx(theirs[:, :3], abs=SAME_RAY_MM)
    if directions:
        assert ours[:, 3:] == pytest.approx(theirs[:, 3:], abs=SAME_DIRECTION)


def test_the_table_holds_all_files_also_of_the_packages():
    own = {Path(file).name for file in SUMMARY if file.startswith("tests/")}
    assert {file.name for file in peer_lenses.OWN.iterdir() if file.is_file()} == own
    assert len(SUMMARY) == 43 + len(own)
    assert sum(row["mistray"] == "refused" for row in SUMMARY.values()) == len(REFUSED)
    for program in PEERS:
        peers.need(program)
    assert set(FILES) == set(SUMMARY)


REFUSED = {
    "CODV_65988.seq": r"line 32: 'DIF DOE' on surface 1: diffracting surfaces are not traced",
    "achroMangin.seq": r"line 3: glass 'SK19_Schott' is not in the catalogue of schott .*--glass",
    "354710-C-Zemax(ZMX).zmx": r"line \d+: glass 'D-ZK3M' is unknown",
    "US08427765-1.ZMX": r"line \d+: glass 'L-TIM28_MOLD' is unknown",
}


@pytest.mark.parametrize("file", SUMMARY)
def test_a_file_is_read_or_refused_with_its_reason(file):
    reason = REFUSED.get(file.rpartition("/")[2])
    assert SUMMARY[file]["mistray"] == ("refused" if reason else "read")
    if reason:
        with refused(reason):
            lens(file)
    else:
        found = lens(file)
        assert all(entry.reason and entry.text for entry in found.unread)
        assert first_order(found).epd > 0


# Where the two programs differ: which of them is right. Each reason is worked out in a test below
RIGHT = {
    # optiland takes A, B, … of CODE V for the coefficients of r², r⁴, …
    **dict.fromkeys(("CODV_49664.seq", "CODV_65988_noDOE.seq", "asp46.seq", "schmidt.seq"), "rayoptics"),
    # optiland leaves out the defocus, the thickness of SI
    **dict.fromkeys(("ag_dblgauss.seq", "questar35.seq"), "rayoptics"),
    # optiland leaves out DAR, REV and BEN, and turns ADE the other way
    **dict.fromkeys(("dec_rev_tilt_test.seq", "dec_test.seq", "dec_tilt_test.seq", "folded_lenses.seq"), "rayoptics"),
    **dict.fromkeys(("threemir.seq", "tilt_test.seq"), "rayoptics"),
    # Our own: coefficients and defocus; moves; a sequence that ray-optics cannot read
    **dict.fromkeys(("inch_doublet.seq", "folded.seq"), "rayoptics"),
    "turned.zmx": "optiland",
    # optiland reads curvatures without RDM as radii
    **dict.fromkeys(("landscape_lens.seq", "singlet.seq"), "rayoptics"),
    # ray-optics does not have B270 and SILICA, and takes J-LAFH3 for E-LAFH3
    **dict.fromkeys(("ACL3026U-Zemax(ZMX).zmx", "US05831776-1.zmx", "US05331467-1.zmx"), "optiland"),
    # ray-optics turns about x the other way, and counts the back focal length from coordinate breaks
    **dict.fromkeys(("HoO-V2C18Ex66.zmx", "HoO-V2C18Ex66NEW.zmx", "US08011793-1.zmx"), "optiland"),
    # neither; see the tests by their names
    **dict.fromkeys(("test.seq", "HoO-V2C18Ex27.zmx", "zmax_55278.zmx", "zmax_37992.zmx"), ""),
    **dict.fromkeys(("ASL5040-UV-Zemax(ZMX).zmx", "HoO-V2C18Ex46.zmx"), ""),
}
READ = [file for file, row in SUMMARY.items() if row["mistray"] == "read"]


@pytest.mark.parametrize("file", READ)
def test_focal_lengths_and_rays(file):
    name = file.rpartition("/")[2]
    row, found = SUMMARY[file], lens(file)
    ours = {
        program: first_order(found, float(row[f"{program}_wavelength_nm"]))
        for program in PEERS
        if row[f"{program}_efl"] not in ("", "nan")  # folded lenses are outside of optiland's first order
    }
    focal = {program: [float(row[f"{program}_{key}"]) for key in ("efl", "bfl")] for program in ours}
    end = {program: ends(file, program) for program in PEERS}
    hits = our_ends(file)
    assert np.isfinite(hits).all()
    same_focus = len(focal) == 2 and all(same(a, b) for a, b in zip(*focal.values(), strict=True))
    same_rays = np.abs(end["optiland"] - end["rayoptics"])[:, :3].max(axis=1) <= SAME_RAY_MM
    assert (name in RIGHT) == (not (same_focus and same_rays.all())), "RIGHT lists where the two programs differ"
    trusted = [RIGHT[name]] if RIGHT.get(name) else []
    for program in list(focal) if same_focus else [program for program in trusted if program in focal]:
        assert [ours[program].efl, ours[program].bfl] == pytest.approx(focal[program], rel=SAME_FOCUS)
    # Both leave out the turn of the image of zmax_37992, where the chief ray alone ends at the same point
    check_rays(hits[same_rays], end["rayoptics"][same_rays], directions=name != "zmax_37992.zmx")
    for program in trusted:
        check_rays(hits, end[program])


@pytest.mark.parametrize("file", READ)
def test_a_file_becomes_a_scene(file, tmp_path):
    found = (from_codev if file.endswith(".seq") else from_zemax)(path_of(file))
    found.to_xml(tmp_path / "lens.xml")
    text = (tmp_path / "lens.xml").read_text(encoding="utf-8")
    assert all(f'id="{surface.name}"' in text for surface in found.surfaces)
    bends = [row for row in lens(file).rows if row.mirror or row.material.removesuffix(" k=0") != "air"]
    assert bool(found.surfaces) == bool(bends)


def test_polynomials_and_schmidt_plates():
    """asp46.seq: z = -0.1 r⁴ + 0.1 r⁶ in front, plane behind, n = 1.5, thicknesses 1 and 2 mm."""
    n = lens("asp46.seq")
    index = 1.5 + (0.5 / 70 / (1 / 486.1327**2 - 1 / 656.2725**2)) * (1 / 587.6**2 - 1 / 587.5618**2)
    y = 0.7
    z, slope = -0.1 * y**4 + 0.1 * y**6, -0.4 * y**3 + 0.6 * y**5
    incidence = math.atan(slope)
    inside = math.asin(math.sin(incidence) / index) - incidence  # direction to the axis behind the first surface
    height = y + (1 - z) * math.tan(inside)
    outside = math.asin(index * math.sin(inside))
    hits, _ = trace(n, [(0, y, -1)], [(0, 0, 1)])
    assert hits[-1, 0, 1] == pytest.approx(height + 2 * math.tan(outside), abs=1e-8)
    # F/1.3 Schmidt: with A as r⁴ the spot on the axis is some µm, with a sphere it is 0.1 mm
    radii = []
    for name in ("schmidt.seq", "schmidt_sph.seq"):
        y = np.linspace(0, 37.5, 16)
        hits, _ = trace(lens(name), np.stack([0 * y, y, 0 * y - 5], axis=1), np.tile([0.0, 0.0, 1.0], (16, 1)))
        radii.append(float(np.sqrt(np.average(hits[-1][:, 1] ** 2, weights=y))))
    assert radii[0] < 0.01
    assert radii[1] > 10 * radii[0]


def spot(found: Sequential, radius: float) -> float:
    """Root-mean-square radius of the image of a round beam, mm."""
    grid = np.linspace(-1, 1, 21)
    start = radius * np.stack([axis.ravel() for axis in np.meshgrid(grid, grid)], axis=1)
    start = start[np.hypot(*start.T) <= radius]
    hits, _ = trace(found, np.column_stack([start, np.full(len(start), -50.0)]), np.tile([0, 0, 1.0], (len(start), 1)))
    return float(np.sqrt(np.var(hits[-1][:, :2], axis=0).sum()))


def test_q_aspheres_and_toroids():
    """f = 40 mm, 44 mm wide: Qbfs along the normals of the conic are within its Airy disc, none leave 0.1 mm."""
    found = lens("ASL5040-UV-Zemax(ZMX).zmx")
    assert found.wavelength_nm == 405.0
    assert spot(found, 22.0) < 1.22 * 405e-6 * 40 / 44
    assert spot(found.with_rows([replace(found.rows[0], sag={}), *found.rows[1:]]), 22.0) > 1e-1
    # Handbook of Optics, volume 2, chapter 18, example 46: a sphere of the same curvature in y leaves far more
    found = lens("HoO-V2C18Ex46.zmx")
    assert sum(bool(row.sag) for row in found.rows) == 1
    sharp, plain = spot(found, 10.0), spot(found.with_rows([replace(row, sag={}) for row in found.rows]), 10.0)
    assert sharp < 2e-3
    assert plain > 10 * sharp


@pytest.mark.parametrize(
    ("name", "defocus_mm"), [("ag_dblgauss.seq", -0.4002686453541377), ("questar35.seq", -0.05687840253417175 * 25.4)]
)
def test_a_defocus_moves_the_image_and_sharpens_it(name, defocus_mm):
    found = lens(name)
    *front, last, image = found.rows
    nominal = found.with_rows([*front, replace(last, thickness=last.thickness - defocus_mm), image])
    # optiland's ends are those of the nominal image
    file = next(file for file in READ if file.endswith(name))
    assert trace(nominal, *starts(file))[0][-1] == pytest.approx(ends(file, "optiland")[:, :3], abs=SAME_RAY_MM)
    spots = []
    for each in (found, nominal):
        y = np.linspace(0.3, 1, 15) * first_order(found).epd / 2
        hits, _ = trace(each, np.stack([0 * y, y, 0 * y - 300], axis=1), np.tile([0.0, 0.0, 1.0], (15, 1)))
        spots.append(float(np.sqrt(np.average(hits[-1][:, 1] ** 2, weights=y))))
    assert spots[0] < 0.8 * spots[1]


def straight(name: str, x: float, y: float) -> np.ndarray:
    return trace(lens(name), [(x, y, -10)], [(0, 0, 1)])[0][-1, 0]


def test_moves_folds_and_three_mirrors():
    """Plane dummies and plane mirrors, so that rays can be followed with a ruler. s = sin 45°."""
    # 100 along an axis that ADE 45 turns to +y, and back parallel by REV: the image lies 100 s higher
    assert straight("tilt_test.seq", 2, 3) == pytest.approx([2, 3 - 100 * math.sqrt(0.5), 0], abs=1e-9)
    # Up by 2, along the turned axis to (0, 4, 5); down again to (0, 2, 10), and REV takes the 2 back
    assert straight("dec_rev_tilt_test.seq", 2, 3) == pytest.approx([2, 3, 0], abs=1e-8)
    # 25 up, 75 down, 100 along an axis of 30° up: (0, 0, 186.6), parallel again; a mirror at 45° there sends light to
    # -y, where the image's y is -z: what came higher by y meets the mirror earlier by y
    assert straight("dec_test.seq", 2, 3) == pytest.approx([2, 3, 0], abs=1e-8)
    places = to_world(lens("dec_test.seq"), np.zeros((9, 1, 3)))[:, 0]
    assert places[-1] == pytest.approx([0, -200, 100 + 100 * math.cos(math.radians(30)) + 10], abs=1e-8)
    # Three mirrors that bend the axis: heights in the plane of the bends keep their size
    for name in ("dec_tilt_test.seq", "dar_test.seq"):
        assert np.abs(straight(name, 0.2, 0.3)) == pytest.approx([0.2, 0.3, 0], abs=1e-9)
    # folded_lenses.seq is unfolded_lenses_w_ape.seq with three plane mirrors
    folded, unfolded = first_order(lens("folded_lenses.seq")), first_order(lens("unfolded_lenses_w_ape.seq"))
    assert (folded.efl, folded.bfl) == pytest.approx((unfolded.efl, unfolded.bfl), rel=1e-12)
    for x, y in ((0.1, 0.3), (-0.2, 0.0), (0.3, -0.4)):
        ends_of = [np.abs(straight(name, x, y)) for name in ("folded_lenses.seq", "unfolded_lenses_w_ape.seq")]
        assert ends_of[0] == pytest.approx(ends_of[1], abs=1e-9)
    # With the opposite turns, without DAR or with the defocus behind the turn it is blurred, or 2 mm away or more
    found = lens("threemir.seq")
    grid = np.linspace(-1, 1, 9)
    aim = 20 * np.stack([axis.ravel() for axis in np.meshgrid(grid, grid)], axis=1)
    aim = aim[np.hypot(*aim.T) <= 20]
    start = np.concatenate([aim, np.zeros((len(aim), 1))], axis=1)
    along = np.tile([0.0, 0.0, 1.0], (len(aim), 1))
    for _ in range(12):  # Newton: rays through points of the stop, which is row 3
        at = trace(found, start, along)[0][2][:, :2]
        steps = [trace(found, start + shift, along)[0][2][:, :2] - at for shift in ([1e-3, 0, 0], [0, 1e-3, 0])]
        start[:, :2] += np.linalg.solve(np.stack(steps, axis=2) / 1e-3, (aim - at)[:, :, None])[:, :, 0]
    spot = trace(found, start, along)[0][-1][:, :2]
    assert np.abs(spot.mean(axis=0)).max() < 1e-3
    assert np.sqrt(((spot - spot.mean(axis=0)) ** 2).sum(axis=1).mean()) < 1.5e-3


def thick_lens(r1: float, r2: float, thickness: float, n: float) -> tuple[float, float]:
    """Focal length and back focal length of a lens in air (Born and Wolf, 4.4.3)."""
    power = (n - 1) * (1 / r1 - 1 / r2 + (n - 1) * thickness / (n * r1 * r2))
    return 1 / power, (1 - (n - 1) * thickness / (n * r1)) / power


def test_without_rdm_the_lenses_are_in_focus_as_curvatures():
    n_550, n_650 = 1.518522, 1.514521  # N-BK7, Schott's catalogue
    efl, bfl = thick_lens(1 / -0.2, 1 / -0.387040626, 0.22, n_550)
    found = first_order(lens("landscape_lens.seq"))
    assert (found.efl, found.bfl) == pytest.approx((efl, bfl), rel=1e-5)
    # The last thickness of the file; as a radius, 0.2 mm stops the beam
    assert bfl == pytest.approx(10.150245, rel=1e-5)
    efl, bfl = thick_lens(1 / 0.1, 1 / -0.05, 1.0, n_650)
    found = first_order(lens("singlet.seq"), 650.0)
    assert (found.efl, found.bfl) == pytest.approx((efl, bfl), rel=1e-5)


def test_glasses_by_hand_and_those_that_rayoptics_does_not_have():
    """BK7 is taken for N-BK7, F2 is Schott's; ray-optics has CDGM's F2 of nd 1.613. There is no SI."""
    n_bk7, n_f2 = refractive_index("schott/N-BK7", 650.0), refractive_index("schott/F2", 650.0)
    f1, b1 = thick_lens(10, -20, 1, n_bk7)
    f2, _ = thick_lens(1 / -0.07, 1 / 0.07, 0.25, n_f2)
    front = -f2 * (n_f2 - 1) * 0.25 / (n_f2 / 0.07)  # principal plane of the second lens behind its first vertex
    apart = 2 + (f1 - b1) + front
    combined = 1 / (1 / f1 + 1 / f2 - apart / (f1 * f2))
    found = lens("test.seq")
    assert first_order(found, 650.0).efl == pytest.approx(combined, rel=1e-9)
    assert [row.thickness for row in found.rows] == [1, 2, 0.25, 10, 0.001, 0]
    assert any("no SI" in note for note in found.notes)
    # Schott B270, n(587 nm) = 1.52303: a plano-convex lens
    found = first_order(lens("ACL3026U-Zemax(ZMX).zmx"))
    assert found.efl == pytest.approx(13.5511 / 0.52303, rel=1e-5)
    assert found.bfl == pytest.approx(13.5511 / 0.52303 - 11.9 / 1.52303, rel=1e-5)
    # Fused silica at 248 nm by Malitson (J. Opt. Soc. Am. 55, 1205 (1965)); the lens makes 4:1 images at its image
    w = 0.248**2
    terms = ((0.6961663, 0.0684043), (0.4079426, 0.1162414), (0.8974794, 9.896161))
    n = math.sqrt(1 + sum(b * w / (w - c * c) for b, c in terms))
    stepper = lens("US05831776-1.zmx")
    assert stepper.telecentric
    system, _ = paraxial_system(stepper)
    assert system.index[1] == pytest.approx(n, abs=2e-6)
    near, far = system.trace(stepper.object_distance, 1.0)[-1], system.trace(1.0, 0.0)[-1]
    assert abs(near[0]) < 0.01 * abs(near[1])  # mm: rays from a point of the object meet in the image
    assert abs(far[0]) == pytest.approx(0.25, abs=0.01)
    # E-LAFH3 is Hikari's, not today's J-LAFH3
    assert "hikari/E-LAFH3" in [row.material.removesuffix(" k=0") for row in lens("US05331467-1.zmx").rows]


def test_glasses_turns_back_focus_and_off_axis_parabolas():
    """zmax_55278: the file states its focal length, 52.24 mm, and the image stands at its focus."""
    assert "DBDT 0 55278 5.224E+01" in path_of("zmax_55278.zmx").read_text(encoding="utf-16")
    found = lens("zmax_55278.zmx")
    assert first_order(found).efl == pytest.approx(52.24, abs=0.005)
    assert first_order(found).bfl == pytest.approx(found.rows[-2].thickness, rel=1e-8)
    # HoO-V2C18Ex27 has glasses of nd and Vd alone: at 550 nm three formulas give three indices, 2e-4 apart at most
    file = "rayoptics/zemax/tests/HoO-V2C18Ex27.zmx"
    row, found = SUMMARY[file], lens("HoO-V2C18Ex27.zmx")
    efl = first_order(found).efl
    assert [float(row[f"{program}_efl"]) for program in PEERS] == pytest.approx([efl, efl], rel=1e-4)
    at_d = first_order(found, 587.5618)
    nd = [float(row.material.split()[0].removeprefix("nd=")) for row in found.rows if row.material.startswith("nd=")]
    assert nd == [1.489, 1.583, 1.489, 1.583]
    assert at_d.efl != efl
    # HoO-V2C18Ex66: the first mirror's normal is R_x(α) ẑ = (0, -sin α, cos α): light goes to (0, sin 2α, -cos 2α)
    found = lens("HoO-V2C18Ex66.zmx")
    places = to_world(found, np.zeros((len(found.rows), 1, 3)))[:, 0]
    mirrors = [k for k, row in enumerate(found.rows) if row.mirror]
    onward = places[mirrors[1]] - places[mirrors[0]]
    double = math.radians(2 * 16.44)
    assert onward == pytest.approx(71.21 * np.array([0, math.sin(double), -math.cos(double)]), abs=1e-9)
    # The other sense is the mirror image in y
    file = "rayoptics/zemax/tests/HoO-V2C18Ex66.zmx"
    chief = [0, 9, 12]  # through the middle of the pupil: the fields on the axis and at the sides
    check_rays(our_ends(file)[chief] * [1, -1, 1, 1, -1, 1], ends(file, "rayoptics")[chief])
    # ray-optics begins it at the last row, a coordinate break
    for name, behind in (("US08011793-1.zmx", 400.0), ("HoO-V2C18Ex66NEW.zmx", 121.4)):
        file = f"rayoptics/zemax/tests/{name}"
        assert first_order(lens(name)).bfl == pytest.approx(float(SUMMARY[file]["rayoptics_bfl"]) + behind, rel=1e-9)
    # zmax_37992: a parabola of f = 95.3 mm turns a beam 190.6 mm off its axis by 90° into a point
    found = lens("zmax_37992.zmx")
    y = np.linspace(-25, 25, 7)
    hits, _ = trace(found, np.stack([y / 2, y, 0 * y], axis=1), np.tile([0.0, 0.0, 1.0], (7, 1)))
    assert hits[-1] == pytest.approx(np.zeros((7, 3)), abs=1e-9)
    assert abs(trace(found, [(0, 0, 0)], [(0, 0, 1)])[1][-1, 0, 2]) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize(
    "file",
    ["rayoptics/codev/tests/ag_dblgauss.seq", "rayoptics/codev/tests/threemir.seq",
     "rayoptics/zemax/tests/HoO-V2C18Ex66.zmx", "rayoptics/zemax/tests/US00583336-2-scaled.zmx",
     *(f"tests/{name}" for name in ("asphere.zmx", "turned.zmx", "inch_doublet.seq", "folded.seq"))],
)  # fmt: skip
@pytest.mark.parametrize("program", PEERS)
def test_the_tables_are_what_the_programs_say(file, program):
    peers.need(program)
    found, failure = peer_lenses.peer(program, path_of(file))
    assert failure == SUMMARY[file][f"{program}_failure"]
    if found is None:
        return
    for key in ("efl", "bfl"):
        assert getattr(found, key) == pytest.approx(float(SUMMARY[file][f"{program}_{key}"]), rel=1e-9, nan_ok=True)
    for start, along, expected in zip(*starts(file), ends(file, program), strict=True):
        end = peer_lenses.end_of_ray(found, start, along, float(RAYS[file][0]["wavelength_nm"]))
        assert end == pytest.approx(expected, abs=1e-9, nan_ok=True)
