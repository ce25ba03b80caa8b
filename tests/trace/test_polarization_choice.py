"""The mode of polarisation that a trace takes, and rays of coated lenses, against closed forms and field vectors."""

from dataclasses import replace
from math import prod
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
from oracles.closed_forms import fresnel
from oracles.glass import absorption_per_mm, refractive_index
from oracles.polarized import Hit, amplitudes, transport
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.skew_path import Face, skew_path
from oracles.small_scenes import plates_text, scene_text, shape_xml

import mistray
from mistray.events import EVENT_BITS, REFLECTED, TOTAL, TRANSMITTED
from mistray.execute.tracer import prepare
from mistray.kernel.targets import AimSet, Target
from mistray.light import AS_THE_SCENE, Light
from mistray.prescription import Coating
from mistray.scenes.cooke_triplet.prescription import build
from mistray.settings import Settings
from mistray.trace.host import polarization_choice
from mistray.trace.host.both_ways import follow, scattered_directions
from mistray.trace.host.polarization_choice import LEAST_CHANGE, PolarizationChoice, chosen_polarization

GLASS = 1.5
KINDS = {"T": TRANSMITTED, "R": REFLECTED, "I": TOTAL}


def choice(scene, beams=(AS_THE_SCENE,), **settings) -> PolarizationChoice:
    return chosen_polarization(scene, Settings.unresolved(scene, **settings), beams)


def film_powers(film: tuple[float, float], angle_deg: float = 45.0, n: float = GLASS) -> list[float]:
    """R of s and p of one film (index, nm) within glass, by Airy's sum (Born & Wolf, 7.6) at 550 nm."""
    c = np.cos(np.radians(angle_deg))
    inner = np.sqrt(1 - (n / film[0]) ** 2 * (1 - c * c))
    turn = np.exp(4j * np.pi * film[0] * film[1] * inner / 550.0)
    both = ((n * c, film[0] * inner), (film[0] * c, n * inner))
    r = np.array([(a - b) / (a + b) for a, b in both])
    return list(np.abs(r * (1 - turn) / (1 - r**2 * turn)) ** 2)


def ghost_factor(angle_deg: float) -> float:
    """First ghost of a plate, two refractions and two reflections in one plane, over that by means of s and p."""
    r_s, r_p = fresnel(angle_deg, GLASS)
    mean = (r_s + r_p) / 2
    return sum(((1 - r) * r) ** 2 for r in (r_s, r_p)) / 2 / ((1 - mean) * mean) ** 2


class TestPilot:
    @pytest.mark.parametrize(
        "faces",
        [
            [Face(35, 10, "T", 1.7), Face(30, 75, "T", 1.0), Face(50, 140, "T", 1.7)],
            [Face(40, 20, "T", 1.7), Face(25, 100, "R", 1.0), Face(30, 215, "R", 1.0), Face(20, 300, "T", 1.0)],
            [Face(45, 0, "T", 1.7), Face(50, 40, "I", 1.0), Face(60, 110, "I", 1.0), Face(30, 70, "T", 1.0)],  # a prism
            [Face(50, 0, "R", GLASS), Face(50, 90, "R", GLASS)],
            [Face(50, 0, "R", GLASS, ((1.38, 100.0),)), Face(40, 60, "T", GLASS, ((2.3, 60.0), (1.45, 95.0)))],
        ],
    )
    def test_skew_paths(self, load_scene, faces) -> None:
        """Both modes against field vectors, hit by hit for light that forgets its state; start rays are in float32."""
        path, limits = skew_path(faces), {"max_reflections": 4, "flux_threshold": 0.0}
        (run,) = prepare(load_scene(path.text), Settings(rays=64, polarization="unpolarized", **limits))
        codes = [run.table.ids.index(f"face_{k}") << EVENT_BITS | KINDS[hit.kind] for k, hit in enumerate(path.hits)]
        (found,) = [one for one in follow(run, 32)[0] if one.path[:-1] == tuple(codes)]
        launched = np.pi * 0.01**2
        flux, _ = transport(path.directions, path.hits, 550.0)
        steps = [transport(path.directions[k : k + 2], [hit], 550.0)[0][-1] for k, hit in enumerate(path.hits)]
        assert found.stokes / launched == pytest.approx(flux[-1], rel=5e-6)
        assert found.mean / launched == pytest.approx(prod(steps), rel=5e-6)

    def test_scattered_light(self, load_scene) -> None:
        """Behind four plates at Brewster's angle a screen gets, and scatters, (1 + s)/2 instead of ((1 + r)/2)⁸."""
        rough = scattering_xml([bsdf_xml("abg", A=0.01, B=0.1, g=2.0)], R=0.0, T=1.0)
        screen = shape_xml("asphere", "screen", 39.0, rough, semi_diameter=60.0)
        scene = load_scene(plates_text(4).replace("</scene>", f"{screen}</scene>"))
        brewster = float(np.degrees(np.arctan(GLASS)))
        (run,) = prepare(scene, Settings(max_reflections=0, polarization="unpolarized"), Light(field_deg=brewster))
        scattered = [one for one in follow(run, 64)[0] if one.scattered]
        r_s, _ = fresnel(brewster, GLASS)
        found = sum(one.stokes for one in scattered) / sum(one.mean for one in scattered)
        assert found == pytest.approx((1 + (1 - r_s) ** 8) / 2 / (1 - r_s / 2) ** 8, rel=1e-5)


class TestChoice:
    @pytest.mark.parametrize(("angle_deg", "factor"), [(30.0, 1.13), (45.0, 1.55), (55.0, 1.71)])
    def test_a_tilted_plate(self, load_text, angle_deg, factor) -> None:
        found = choice(load_text(plates_text(1))[0], [Light(angle_deg)])
        assert ghost_factor(angle_deg) == pytest.approx(factor, abs=0.005)
        assert (found.mode, found.change) == ("stokes", pytest.approx(ghost_factor(angle_deg) - 1, rel=1e-5))
        assert "p0_rear → p0_front" in found.reason

    @pytest.mark.parametrize("azimuth_deg", [0.0, 90.0, 35.0])
    @pytest.mark.parametrize("films", [((2.3, 60.0), (2.3, 60.0)), ((2.3, 60.0), (1.38, 150.0))])
    def test_two_cubes(self, load_scene, films, azimuth_deg) -> None:
        """Films within glass at 45° that reflect one after the other, in planes at an angle φ: 1 + D₁ D₂ cos 2φ."""
        cubes = [Face(45, turn, "R", GLASS, (film,)) for turn, film in zip((0.0, azimuth_deg), films, strict=True)]
        path = skew_path([Face(0, 0, "T", GLASS), *cubes, Face(0, 0, "T", 1.0)])
        across = [np.cross(path.directions[k], path.directions[k + 1]) for k in (1, 2)]
        cosine = across[0] @ across[1] / np.linalg.norm(across[0]) / np.linalg.norm(across[1])
        d = [(r_s - r_p) / (r_s + r_p) for r_s, r_p in map(film_powers, films)]
        found = choice(load_scene(path.text))
        assert (found.mode, found.change) == ("stokes", pytest.approx(d[0] * d[1] * (2 * cosine**2 - 1), rel=1e-4))

    def test_no_change(self, load_text) -> None:
        """Below 1 %, of the direct light alone, of surfaces that do not polarise and of no stray light at all."""
        scene = load_text(plates_text(1))[0]
        weak = choice(scene, [Light(10.0)])
        assert 0 < weak.change < LEAST_CHANGE
        assert weak.change == pytest.approx(ghost_factor(10.0) - 1, rel=1e-3)
        direct = choice(scene, [Light(45.0)], max_reflections=0)
        coated = choice(load_text(plates_text(1, R=0.1, T=0.9))[0], [Light(55.0)])
        bare = choice(load_text(scene_text(shape_xml("asphere", "detector", 10.0, sensor=True, semi_diameter=5.0)))[0])
        assert (coated.change, bare.change) == (0.0, 0.0)
        assert {one.mode for one in (weak, direct, coated, bare)} == {"unpolarized"}
        assert "direct" in direct.reason
        seeds = [choice(scene, [Light(20.0)], seed=seed, rays=10 + seed) for seed in range(2)]
        assert str(seeds[0]) == str(seeds[1])
        assert choice(scene, [Light(45.0)], polarization="unpolarized").mode == "unpolarized"

    def test_shipped_scenes(self) -> None:
        """On axis the triplet's ghosts change by 0.95 % at most; the display's double image by 60 %."""
        assert choice(mistray.load("cooke_triplet"), [Light(0.0)]).mode == "unpolarized"
        found = choice(mistray.load("head_up_display"))
        assert (found.mode, found.change) == ("stokes", pytest.approx(0.595, abs=0.005))


def test_the_same_light_is_tested_once(monkeypatch) -> None:
    scene, tested = mistray.load("cooke_triplet"), []
    monkeypatch.setattr(polarization_choice, "_known", {})  # of other tests in this process
    monkeypatch.setattr(polarization_choice, "follow", lambda *of: tested.append(of) or follow(*of))

    def tests(**light: float) -> int:
        tested.clear()
        choice(scene, [Light(**light)])
        return len(tested)

    # Between 7° and 7.5°, and at angles that are tested themselves
    assert tests(field_deg=7.25)
    assert not tests(field_deg=7.25)
    assert not tests(field_deg=7.375)
    for light in ({"field_deg": -7.25}, {"field_deg": 7.25, "azimuth_deg": 90.0}, {"field_deg": 7}, {"field_deg": 8}):
        assert tests(**light)
        assert not tests(**light)
    assert tests(field_deg=7.25, wavelength_nm=600.0)
    parameters = mi.traverse(scene)
    for key in ("L1_front.curvature", "L1_front.bsdf.n_back_shift"):
        parameters[key] += 1e-3
        parameters.update()
        assert tests(field_deg=7.25)
        assert not tests(field_deg=7.25)


def test_trace_and_ghosts_say_it(load_text) -> None:
    """A trace takes Stokes vectors at 45°; the fields of an analysis have one mode, that which any of them needs."""
    from mistray.report import main_table

    scene = load_text(plates_text(1))[0]
    t = mistray.trace(scene, rays=64, field_deg=45.0, flux_threshold=0.0)
    ghost = sum(((1 - r) * r) ** 2 for r in fresnel(45.0, GLASS)) / 2
    assert t.paths[1].power_W / t.energy.launched_W == pytest.approx(ghost, rel=1e-5)
    assert t.settings["polarization"] == "stokes"
    assert t.settings["polarization_change"] == pytest.approx(ghost_factor(45.0) - 1, rel=1e-5)
    assert t.settings["polarization_reason"].startswith("Stokes vectors change")
    beside = choice(scene, [Light(47.0)], flux_threshold=0.0)  # tested at 45° and 50°
    assert beside.change == pytest.approx(ghost_factor(50.0) - 1, rel=1e-5)
    assert "at 50 deg" in beside.reason
    report = mistray.ghosts(scene, field_deg=[0.0, 45.0], rays=64)
    assert {t.settings["polarization"] for t in report.values()} == {"stokes"}
    assert "at 45 deg" in main_table(report)


WAVELENGTH_NM = 520.0
# From the air side; the second one absorbs
STACKS = {
    "clear": ((1.38 + 0j, 95.0), (2.1 + 0j, 120.0), (1.63 + 0j, 80.0)),
    "absorbing": ((1.46 + 0j, 60.0), (2.3 + 0.05j, 40.0), (0.2 + 3.1j, 4.0), (1.8 + 0j, 150.0)),
}
SIDES = {s.name: (s.front, s.back) for s in build().surfaces}


@pytest.fixture(scope="module", params=list(STACKS))
def coated(request: pytest.FixtureRequest) -> tuple[Any, tuple[tuple[complex, float], ...]]:
    stack = STACKS[request.param]
    text = ", ".join(f"{n.real!r}+{n.imag!r}i {d!r}" for n, d in stack)
    prescription = build()
    surfaces = tuple(replace(s, coating=Coating(layers=text)) for s in prescription.surfaces)
    return replace(prescription, surfaces=surfaces).to_scene(), stack


def events_of(row: Any, ray: Any, stack: tuple[tuple[complex, float], ...]) -> tuple[list[Hit], np.ndarray]:
    """The hits of a recorded ray and what the glass leaves of the flux up to each of them and the detector."""
    lengths = np.linalg.norm(np.diff(ray[["x_mm", "y_mm", "z_mm"]].to_numpy(), axis=0), axis=1)
    hits, left, medium = [], [], "air"
    for (name, kind), length in zip((event.split(":") for event in row.events.split()), lengths, strict=True):
        left.append(np.exp(-absorption_per_mm(medium, WAVELENGTH_NM) * length))
        if kind == "A":
            break
        front, back = SIDES[name]
        other = back if medium == front else front
        index = [complex(refractive_index(m, WAVELENGTH_NM)) for m in (medium, other)]
        hits.append(Hit(kind, *index, layers=stack if medium == "air" else stack[::-1]))
        medium = other if kind == "T" else medium
    return hits, np.cumprod(left)


@pytest.mark.parametrize("polarization", ["unpolarized", "stokes"])
@pytest.mark.parametrize("field_deg", [0.0, 18.0])
def test_flux_along_the_way(coated, polarization, field_deg) -> None:
    """Each share to 1e-5, and R of a few 1e-4 to 4e-6: the tables are good to 1e-6, float32 angles do the rest."""
    scene, stack = coated
    t = mistray.trace(
        scene, rays=4000, field_deg=field_deg, wavelength_nm=WAVELENGTH_NM, polarization=polarization, flux_threshold=0
    )
    kinds = set()
    for row in t.paths[:8]:
        table = t.history(row.path_id, n=3).to_pandas()
        for number in table.ray.unique():
            ray = table[table.ray == number]
            directions = ray[["dx", "dy", "dz"]].to_numpy()[:-1]
            hits, left = events_of(row, ray, stack)
            if polarization == "stokes":
                flux, _ = transport(directions, hits, WAVELENGTH_NM)
            else:
                shares = []
                for hit, before, after in zip(hits, directions[:-1], directions[1:], strict=True):
                    reflected = hit.kind != "T"
                    normal = after - before if reflected else hit.n_out.real * after - hit.n_in.real * before
                    cosine = abs(float(before @ normal)) / np.linalg.norm(normal)
                    shares.append(np.mean(np.abs(amplitudes(hit, cosine, WAVELENGTH_NM)) ** 2))
                flux = np.cumprod(shares)
            measured = ray.flux_W.to_numpy()
            expected = np.concatenate([[1.0], flux]) * left
            shares = expected[1:] / expected[:-1]
            np.testing.assert_allclose(measured[2:] / measured[1:-1], shares, rtol=1e-5, atol=4e-6, err_msg=row.events)
            kinds.add(row.kind)
    assert kinds == {"direct", "ghost"}


@pytest.mark.parametrize("reverse", [False, True])
def test_the_pdf_of_scattered_light_counts_all_targets(reverse: bool) -> None:
    """The mean of 1/pdf is the solid angle of all targets, 2π(1 - cos θ) of the larger disc; false alarms 1e-5 each."""
    discs = [Target("ellipse", (0, 0, -5 if reverse else 5), (r, 0, 0), (0, r, 0), reverse=reverse) for r in (2, 1)]
    o, outward = np.zeros((40_000, 3)), np.tile([0.0, 0.0, 1.0], (40_000, 1))
    d, per_sr = scattered_directions(o, outward, AimSet.of(discs, 1, [3.0, 1.0]), np.random.default_rng(7))
    assert np.all(d[:, 2] >= 5 / np.hypot(5, 2) - 1e-12)
    error = np.std(1 / per_sr) / np.sqrt(len(o))
    assert abs(np.mean(1 / per_sr) - 2 * np.pi * (1 - 5 / np.hypot(5, 2))) < 4.4 * error
