"""
Calls of public functions, methods and constructors by one of their arguments that takes several values.

`ONE` has those for which a single value is a list of one, `FIXED` vectors and lists that cannot be single, `NAMED`
mappings. Each call takes the argument alone and returns what depends on it.
"""

from collections.abc import Callable
from functools import cache, partial
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np

import mistray
from mistray import analysis, coatings, mechanics, optimize, physics, prescription, recorders, report, sweeps
from mistray.analyses.pst.glare.extended_source import Disc
from mistray.physics import thinfilm
from mistray.physics.geometry import sag
from mistray.physics.imaging import paraxial
from mistray.prescription import Detector, Outline, OutlineFigure, Row, Sequential, Stop
from mistray.scatter.abg import ABg
from mistray.scenes.cooke_triplet import prescription as triplet

Call = Callable[[Any], Any]
ANGLES = [5.0, 10.0]
AGF = "odd.agf"
SEQ = "RDM\nLEN\nEPD 8\nDIM M\nWL 588\nYAN 0\nSO 0 1E20\nS 50 5 NBK7_SCHOTT\nSTO\nS -50 46\nSI 0 0\nGO\n"
CORNERS = [(0, 0), (10, 0), (0, 10)]
X = np.arange(3.0)


@cache
def scene() -> Any:
    return mistray.load("plate")


@cache
def known() -> Any:
    return optimize.parameters(scene())


@cache
def trace() -> Any:
    return mistray.trace(scene(), rays=256)


@cache
def history() -> Any:
    return trace().history(0, 2)


@cache
def ghosts() -> Any:
    return mistray.ghosts(scene(), 0, rays=256)


@cache
def stray() -> int:
    return int(ghosts().top(0.0, 1).path_id.iloc[0])


@cache
def pst() -> Any:
    return mistray.pst(mistray.load("lens_and_window"), ANGLES, rays=500)


@cache
def image() -> Any:
    return mistray.image_quality(mistray.load("cooke_triplet"), 0, grid=32)


@cache
def transfer() -> Any:
    return mistray.transfer(mistray.load("cooke_triplet"), rays=500, frequencies_per_mm=[10, 20])


@cache
def gradient() -> Any:
    return optimize.gradient(optimize.transmission(scene(), rays=256), mi.traverse(scene()), keys=next(iter(known())))


@cache
def body() -> Any:
    return optimize.bodies(optimize.parameters(mistray.load("lens_and_window")))["window"]


@cache
def bands() -> Any:
    return optimize.PstBands(mistray.load("plate_and_wall"), "polish.A", [10, 20], rays=500)


@cache
def part() -> Any:
    return mechanics.read_mechanics(Path(__file__).parent / "data" / "triangle.ply")


@cache
def explorer() -> Any:
    return mistray.Explorer("plate", rays=64)


@cache
def pst_sweep() -> Any:
    return sweeps.sweep_pst(scene(), {"nearer": {"plate_front.z": -0.1}}, ANGLES, rays=300)


def line(values: np.ndarray) -> optimize.Modelled:
    return optimize.Modelled(values[0] * X, np.zeros((3, 3)), X[:, None])


@cache
def fitted() -> Any:
    return optimize.fit(line, X, 0.1 * np.ones(3), {"a": 0.5})


POLISH = prescription.Scatter("harvey_shack", {"rms_nm": 2.0, "l": 0.01, "s": -1.5})
LAYER = coatings.Layer("MgF2", 99.4)
QUARTER = coatings.Stack((LAYER,))
FRONT = prescription.Surface("f", semi_diameter=5.0)
RING = prescription.Structure("r", 5.0, 0.0, 8.0, 0.0)
IMAGE = Row(2, kind="image")
GLASS = Row(1, radius=50.0, thickness=5.0, material="N-BK7", stop=True)
TUBE = prescription.vane_tube("hood", optic_radius=20, z_rear=0, length=150, wall_radius=40, field_deg=5)
TERM = {"kind": "path_power", "selection": "ghost", "goal": "minimise"}
SHIFT = {"parameters": ["window_front.y"], "low": -0.1, "high": 0.1}
STUDY = optimize.read_study({"term": [TERM], "variable": [SHIFT]})
MOVED = optimize.Moved("window_front.y")
COATED = optimize.CoatingGroup("ar", ("L1_front",), QUARTER, ((60.0, 150.0),))
TWO_STAGES = prescription.two_stage_baffle("baffle", optic_radius=20, z_rear=0, field_deg=5, exclusion_deg=40, depth=10)
FILMS = [thinfilm.amplitudes, thinfilm.reflectance_transmittance, thinfilm.amplitudes_and_shares]
POLYNOMIALS = [sag.polynomial, sag.polynomial_derivative, sag.polynomial_second_derivative]
ENDS = {"radius": 4, "z_front": 10, "z_rear": 10.5, "outer_front": 12, "outer_rear": 12}


def lens(**given: Any) -> Sequential:
    return Sequential("lens", given.pop("rows", (GLASS, IMAGE)), aperture=8, **given)


def surface(**given: Any) -> prescription.Surface:
    return prescription.Surface("s", semi_diameter=5.0, **given)


def written(name: str, text: str) -> str:
    Path(name).write_text(text, encoding="utf-8")
    return name


def catalogue() -> str:
    """A glass catalogue of one glass."""
    text = (
        "CC a test\nNM ODD 2 0 1.5168 64.17 0 1 -1\nCD 1.03961212 6.00069867E-03 0.231792344 0.0200179144 1.01046945 "
    )
    return written("odd.agf", f"{text}103.560653\nLD 0.3 2.5\n")


def zmx(glass: str = "N-BK7") -> str:
    """A singlet as a Zemax file."""
    path = "singlet.zmx"
    prescription.write_zemax(lens(rows=(GLASS, Row(2, radius=-50.0, thickness=46.0), Row(3, kind="image"))), path)
    return path


def seq() -> str:
    return written("singlet.seq", SEQ)


def table(name: str, **given: Any) -> bytes:
    coatings.write_table(QUARTER, name, **({"wavelengths_nm": 550.0, "angles_deg": 0.0} | given))
    return Path(name).read_bytes()


def found(metric: Any) -> float:
    return float(metric.value())


def oslo() -> str:
    text = 'LEN NEW "Singlet" 49 3; EBR 4; ANG 1; UNI 1; AIR; TH 1e20; NXT; GLA N-BK7; RD 50; TH 5; AP 10; AST; '
    text += "NXT; AIR; RD -50; TH 46; AP 10; NXT; AIR; WV 0.588; WW 1; END 3"
    return written("singlet.len", text.replace("; ", "\n"))


def film(function: Call, n: Any, d: Any = 100.0) -> Any:
    return function(1.0, n, d, 1.5, 550.0, 1.0)


def disc() -> Any:
    return Disc(7.0, 1.0)


def nearer() -> Any:
    return sweeps.Configuration("nearer", {"plate_front.z": -0.1})


@cache
def cassegrain() -> Any:
    numbers = {"radius": -1000, "conic": -1, "semi_diameter": 100, "inner_semi_diameter": 26}
    primary = mistray.Surface("primary", mirror=True, **numbers)
    secondary = mistray.Surface("secondary", z=-370, radius=-346.67, conic=-2.78, semi_diameter=24, mirror=True)
    ends = {"field_deg": 0.28, "wall_depth": 4, "wall_rear": 26}
    return prescription.cassegrain_baffles(primary, secondary, Detector(z=150, semi_diameter=10), **ends)


ONE: dict[str, tuple[Call, Any]] = {
    # Paths, surfaces and light of a trace
    "Trace.irradiance_of(path_ids)": (lambda v: trace().irradiance_of(v), 1),
    "Trace.surface_maps(surfaces)": (lambda v: trace().surface_maps(v, azimuths=4, lengths=2), "detector"),
    "Trace.surface_maps(selections)": (lambda v: trace().surface_maps("detector", v, azimuths=4, lengths=2), "ghost"),
    "Trace.maps(groups)": (lambda v: trace().maps(v), 1),
    "Trace.each_map(groups)": (lambda v: list(trace().each_map(v, with_noise=False)), 1),
    "Trace.each_map(with_noise)": (lambda v: list(trace().each_map([1], with_noise=v)), True),
    "Trace.sampled_rays(path_ids)": (lambda v: trace().sampled_rays(v, 2), 1),
    "Trace.light_cones(path_ids)": (lambda v: trace().light_cones(v), 1),
    "Trace.rays_at(where)": (lambda v: trace().rays_at(v, n=5), "detector"),
    "PathTable.located(path_ids)": (lambda v: [own.ids for own in trace().paths.located(v)], 1),
    "PathTable.check_ids(path_ids)": (lambda v: trace().paths.check_ids(v), 1),
    "PathTable.power(path_ids)": (lambda v: trace().paths.power(v), 1),
    "PathTable.light(path_ids)": (lambda v: trace().paths.light(v), 1),
    "PathTable.numbers(groups)": (lambda v: trace().paths.numbers(v), 1),
    "PathTable.columns_of(groups)": (lambda v: trace().paths.columns_of(v), 1),
    "RayHistory.__getitem__(numbers)": (lambda v: history()[v].rays, 1),
    "trace(wavelength_nm)": (lambda v: mistray.trace(scene(), rays=64, wavelength_nm=v).energy, 600.0),
    "trace(weights)": (lambda v: mistray.trace(scene(), rays=64, wavelength_nm=600.0, weights=v).energy, 2.0),
    "trace(detector)": (lambda v: mistray.trace(scene(), rays=64, detector=v).energy, "detector"),
    "trace(recorders)": (
        lambda v: mistray.trace(scene(), rays=64, recorders=v).recorders.keys(),
        recorders.FluxSplit("x"),
    ),
    "rays_of_paths(path_ids)": (lambda v: report.rays_of_paths(trace(), v, 2), 1),
    "path_analysis(path_ids)": (lambda v: analysis.path_analysis(trace(), path_ids=v), 1),
    "layout(path_ids)": (lambda v: len(report.layout(ghosts(), 0.0, path_ids=v).axes[0].lines), 1),
    "layout_figure(trace)": (lambda v: len(report.layout_figure(scene(), v).axes[0].lines), lambda: trace()),
    "layout_figure(path_ids)": (lambda v: len(report.layout_figure(scene(), trace(), path_ids=v).axes[0].lines), 1),
    "GhostReport.map_light(selections)": (lambda v: (ghosts().map_light(v), ghosts().light_maps)[1], "ghost"),
    "GhostReport.check_ids(path_ids)": (lambda v: ghosts().check_ids(0.0, v), 1),
    "GhostReport.path_maps(path_ids)": (lambda v: ghosts().path_maps(0.0, v), 1),
    "GhostReport.rays_of_paths(path_ids)": (lambda v: ghosts().rays_of_paths(0.0, v), 1),
    "FluxSplit(surfaces)": (lambda v: recorders.FluxSplit("x", v).patterns, "plate_front"),
    "SurfaceMaps(surfaces)": (lambda v: recorders.SurfaceMaps("x", v).patterns, "plate_front"),
    # Results over field angle, frequency and light
    "Pst.samples(classes)": (lambda v: pst().samples(v), "stray"),
    "Pst.map(classes)": (lambda v: pst().map(v), "ghost"),
    "Pst.curve(classes)": (lambda v: pst().curve(v), "total"),
    "Pst.estimates(classes)": (lambda v: pst().estimates(v), "stray"),
    "Pst.budget(classes)": (lambda v: pst().budget(10.0, classes=v), "stray"),
    "PstSweep.changed(classes)": (lambda v: pst_sweep().changed("nearer", 10.0, v), "stray"),
    "PstSweep.to_pandas(classes)": (lambda v: pst_sweep().to_pandas(v), "stray"),
    "PstObservation.cells(light)": (lambda v: optimize.PstObservation(pst()).cells(v), "stray"),
    "PstObservation.curve(light)": (lambda v: optimize.PstObservation(pst()).curve(v), "stray"),
    "FieldImage.otf(frequencies_per_mm)": (lambda v: image()[0].otf(v), 10.0),
    "FieldImage.mtf(frequencies_per_mm)": (lambda v: image()[0].mtf(v), 10.0),
    "FieldImage.diffraction_limit(frequencies_per_mm)": (lambda v: image()[0].diffraction_limit(v), 10.0),
    "FieldImage.encircled_energy(radii_mm)": (lambda v: image()[0].encircled_energy(v), 0.01),
    "FieldImage.line_spread(x_mm)": (lambda v: image()[0].line_spread(v), 0.01),
    "ImageQuality.to_pandas(frequencies_per_mm)": (lambda v: image().to_pandas(v), 10.0),
    "quality_text(frequencies)": (lambda v: report.quality_text(image(), v), 10.0),
    "write_quality(frequencies)": (lambda v: [f.name for f in report.write_quality(image(), "q", frequencies=v)], 10.0),
    "FieldTransfer.encircled_energy(radii_mm)": (lambda v: transfer()[0].encircled_energy(v), 0.01),
    "SurfaceTransfer.at(frequencies_per_mm)": (
        lambda v: analysis.transfer_of_bsdf(ABg(0.0025, 0.001, 1.8), 550.0).at(v, 4.0, 10.0),
        10.0,
    ),
    # Metrics, parameters and fits
    "match(patterns)": (lambda v: optimize.match(known(), v), "plate_front.*"),
    "gradient(keys)": (
        lambda v: [*optimize.gradient(optimize.transmission(scene(), rays=64), mi.traverse(scene()), keys=v).gradient],
        "plate_front.z",
    ),
    "Gradient.require(keys)": (lambda v: gradient().require(v), next(iter(known()))),
    "Gradient.covariance(keys)": (lambda v: gradient().covariance(v), next(iter(known()))),
    "Metric(field_deg)": (lambda v: optimize.transmission(scene(), rays=64, field_deg=v).field_deg, 1.0),
    "Metric(wavelength_nm)": (lambda v: optimize.transmission(scene(), rays=64, wavelength_nm=v).wavelength_nm, 600.0),
    "Metric(weights)": (
        lambda v: optimize.transmission(scene(), rays=64, wavelength_nm=600.0, weights=v).weights,
        2.0,
    ),
    "path_power(selection)": (lambda v: found(optimize.path_power(scene(), v, rays=64)), "ghost"),
    "ghost_to_signal(selection)": (lambda v: found(optimize.ghost_to_signal(scene(), v, rays=64)), "ghost"),
    "peak_irradiance(selection)": (lambda v: found(optimize.peak_irradiance(scene(), v, rays=64)), "ghost"),
    "ghost_rms_irradiance(selection)": (lambda v: found(optimize.ghost_rms_irradiance(scene(), v, rays=64)), "ghost"),
    "ghost_focus(selection)": (lambda v: found(optimize.ghost_focus(scene(), v, rays=64)), "ghost"),
    "Observation.power(selection)": (lambda v: optimize.Observation(trace()).power(v), "ghost"),
    "Observation.moments(selection)": (lambda v: optimize.Observation(trace()).moments(v).power, "ghost"),
    "Observation.moments_of_each(selection)": (
        lambda v: optimize.Observation(trace()).moments_of_each(v).power,
        "ghost",
    ),
    "Observation.map(selection)": (lambda v: optimize.Observation(trace()).map(v), "ghost"),
    "Observation.peak(selection)": (lambda v: optimize.Observation(trace()).peak(v), "ghost"),
    "Observation.chosen(selection)": (lambda v: optimize.Observation(trace()).chosen(v), "ghost"),
    "pst_mask(field_deg)": (lambda v: optimize.pst_mask(scene(), v, 1e-3).views[0].arguments["field_deg"], 10.0),
    "pst_mask(limits)": (lambda v: optimize.pst_mask(scene(), 10.0, v).name, 1e-3),
    "PstBands(keys)": (
        lambda v: optimize.PstBands(mistray.load("plate_and_wall"), v, [10, 20], rays=500).keys,
        "polish.A",
    ),
    "PstBands(azimuths_deg)": (
        lambda v: optimize.PstBands(mistray.load("plate_and_wall"), "polish.A", [10, 20], azimuths_deg=v).bands,
        0.0,
    ),
    "PstBands.observe(values)": (lambda v: bands().observe(v).pst.value, 0.01),
    "PstBands.measure(values)": (lambda v: bands().measure(v), 0.01),
    "PstBands.__call__(values)": (lambda v: bands()(v), 0.01),
    "fit(low)": (lambda v: optimize.fit(line, X, 0.1, {"a": 0.5}, low=v), 0.0),
    "fit(high)": (lambda v: optimize.fit(line, X, 0.1, {"a": 0.5}, high=v), 2.0),
    "fit(power)": (lambda v: optimize.fit(line, X, 0.1, {"a": 0.5}, power=v), 1.0),
    "DesignStudy(terms)": (lambda v: optimize.DesignStudy("s", v).terms, STUDY.terms[0]),
    "DesignStudy(variables)": (lambda v: optimize.DesignStudy("s", STUDY.terms, v).variables, STUDY.variables[0]),
    "DesignStudy(coatings)": (lambda v: optimize.DesignStudy("s", STUDY.terms, coatings=v).coatings, COATED),
    "VariableGroup(parameters)": (lambda v: optimize.VariableGroup("v", v, low=0.0, high=1.0).parameters, MOVED),
    "CoatingGroup(surfaces)": (
        lambda v: optimize.CoatingGroup("ar", v, QUARTER, ((60.0, 150.0),)).surfaces,
        "L1_front",
    ),
    "Explorer(field_deg)": (lambda v: mistray.Explorer("plate", field_deg=v, rays=64).fields, 0.0),
    "Explorer(control)": (lambda v: [*mistray.Explorer("plate", control=v, rays=64).controls], "plate_front.z"),
    "Configuration(block)": (lambda v: sweeps.Configuration("c", block=v).block, RING),
    # Coatings and materials
    "Stack(layers)": (lambda v: coatings.Stack(v).layers, LAYER),
    "layer_text(layers)": (coatings.layer_text, LAYER),
    "spectrum(wavelengths_nm)": (lambda v: coatings.spectrum(QUARTER, v, [0.0]), 550.0),
    "spectrum(angles_deg)": (lambda v: coatings.spectrum(QUARTER, [550.0], v), 30.0),
    "write_table(wavelengths_nm)": (lambda v: table("t.csv", wavelengths_nm=v), 550.0),
    "write_table(angles_deg)": (lambda v: table("t.csv", angles_deg=v), 30.0),
    "Bare.response(cos_incident)": (lambda v: coatings.Bare().response(550.0, 1.0, 1.5, v, True), 0.5),
    "Ideal.response(cos_incident)": (lambda v: coatings.Ideal(0.1, 0.8).response(550.0, 1.0, 1.5, v, True), 0.5),
    "Stack.response(cos_incident)": (lambda v: QUARTER.response(550.0, 1.0, 1.5, v, True), 0.5),
    "CoatingTable.response(cos_incident)": (
        lambda v: (table("t.csv"), coatings.CoatingTable.read("t.csv").response(550.0, 1.0, 1.5, v, True))[1],
        0.5,
    ),
    "Coating(n_shift)": (lambda v: mistray.Coating(layers="MgF2 99", n_shift=v).n_shift, 0.01),
    "Coating(k_shift)": (lambda v: mistray.Coating(layers="MgF2 99", k_shift=v).k_shift, 0.01),
    # Prescriptions
    "Surface(coefficients)": (lambda v: surface(coefficients=v).coefficients, 1e-6),
    "Surface(scatter)": (lambda v: surface(scatter=v).scatter, POLISH),
    "Structure(scatter)": (lambda v: mistray.Structure("r", 5.0, 0.0, 8.0, 0.0, scatter=v).scatter, POLISH),
    "Detector(coefficients)": (lambda v: Detector(semi_diameter=5.0, coefficients=v).coefficients, 1e-6),
    "Detector(scatter)": (lambda v: Detector(semi_diameter=5.0, scatter=v).scatter, POLISH),
    "MeshStructure(scatter)": (lambda v: prescription.MeshStructure("m", "m.ply", scatter=v).scatter, POLISH),
    "Stop(scatter)": (lambda v: Stop(**ENDS, scatter=v).scatter, POLISH),
    "Finish(scatter)": (lambda v: mechanics.Finish(scatter=v).scatter, POLISH),
    "Prescription(surfaces)": (lambda v: mistray.Prescription(name="p", surfaces=v).surfaces, FRONT),
    "Prescription(structures)": (lambda v: mistray.Prescription(name="p", surfaces=(), structures=v).structures, RING),
    "Prescription(more_detectors)": (
        lambda v: mistray.Prescription(name="p", surfaces=(), more_detectors=v).more_detectors,
        Detector(semi_diameter=5.0),
    ),
    "Source(wavelength_nm)": (lambda v: mistray.Source(radius=5.0, wavelength_nm=v).wavelength_nm, 600.0),
    "Source(weights)": (lambda v: mistray.Source(radius=5.0, weights=v).weights, 2.0),
    "ObjectPoint(wavelength_nm)": (
        lambda v: prescription.ObjectPoint(distance=9.0, wavelength_nm=v).wavelength_nm,
        600.0,
    ),
    "ObjectPoint(weights)": (lambda v: prescription.ObjectPoint(distance=9.0, weights=v).weights, 2.0),
    "Row(coefficients)": (lambda v: Row(1, coefficients=v).coefficients, 1e-6),
    "Sequential(wavelengths_nm)": (lambda v: lens(wavelengths_nm=v).wavelengths_nm, 600.0),
    "Sequential(weights)": (lambda v: lens(weights=v).weights, 2.0),
    "Sequential(unread)": (lambda v: lens(unread=v).unread, prescription.Unread(1, "GLRS", "it draws")),
    "Sequential(notes)": (lambda v: lens(notes=v).notes, "a note"),
    "OutlineFigure(sizes)": (lambda v: OutlineFigure("circle", sizes=v).sizes, 5.0),
    "Outline(figures)": (lambda v: Outline(v).figures, OutlineFigure("circle", sizes=(5.0,))),
    "box(scatter)": (lambda v: prescription.box("b", (1, 1, 1), scatter=v), POLISH),
    "prism(mirrors)": (lambda v: prescription.prism("p", CORNERS, 10, material="N-BK7", mirrors=v), "1"),
    "prism(scatter)": (lambda v: prescription.prism("p", CORNERS, 10, material="N-BK7", scatter=v), POLISH),
    "fresnel(coefficients)": (
        lambda v: prescription.fresnel("f", radius=-25, semi_diameter=5, groove_mm=1, coefficients=v),
        1e-6,
    ),
    "fresnel(scatter)": (
        lambda v: prescription.fresnel("f", radius=-25, semi_diameter=5, groove_mm=1, scatter=v),
        POLISH,
    ),
    "plate(scatter)": (lambda v: prescription.plate("p", prescription.circle(5.0), 1.0, scatter=v), POLISH),
    "spider(scatter)": (
        lambda v: prescription.spider(
            "s", vanes=3, inner_radius=5, outer_radius=9, thickness=1, depth=2, z=0, scatter=v
        ),
        POLISH,
    ),
    "BaffleTube.structures(scatter)": (lambda v: TUBE.structures(scatter=v), POLISH),
    "BaffleTube.structures(wall_scatter)": (lambda v: TUBE.structures(wall_scatter=v), POLISH),
    "vane_tube(wall_radius)": (
        lambda v: prescription.vane_tube("h", optic_radius=20, z_rear=0, length=150, wall_radius=v, field_deg=5),
        40.0,
    ),
    "array(faces)": (lambda v: prescription.array(v, [(0, 0), (9, 0)]), FRONT),
    "moved_as_one(faces)": (lambda v: prescription.moved_as_one(v, z=1.0), FRONT),
    "barrel(items)": (prescription.barrel, FRONT),
    "add_structures(structures)": (lambda v: mistray.scene.add_structures("plate", v, "more.xml").read_bytes(), RING),
    "load(sources)": (lambda v: len(mistray.load("plate", sources=v).emitters()), "point:0,0,-500"),
    "load(sensors)": (lambda v: len(mistray.load("plate", sensors=v).sensors()), "probe:0,0,5,half_width=2"),
    "coat(sources)": (lambda v: len(mistray.coat("plate", sources=v).emitters()), "point:0,0,-500"),
    "coat(sensors)": (lambda v: len(mistray.coat("plate", sensors=v).sensors()), "probe:0,0,5,half_width=2"),
    # Files
    "read_codev(glass_catalogues)": (lambda v: prescription.read_codev(seq(), glass_catalogues=v), lambda: catalogue()),
    "read_zemax(glass_catalogues)": (lambda v: prescription.read_zemax(zmx(), glass_catalogues=v), lambda: catalogue()),
    "from_codev(glass_catalogues)": (lambda v: prescription.from_codev(seq(), glass_catalogues=v), lambda: catalogue()),
    "from_zemax(glass_catalogues)": (lambda v: prescription.from_zemax(zmx(), glass_catalogues=v), lambda: catalogue()),
    "write_rays(rays)": (
        lambda v: report.write_rays(v, "rays.json").read_bytes(),
        lambda: report.rays_of_paths(trace(), 1, 1)[0],
    ),
    "write_formats(formats)": (lambda v: [f.name for f in report.write_formats(v, ".", {}, {})], "npy"),
    "transfer_of_bsdf(models)": (lambda v: analysis.transfer_of_bsdf(v, 550.0).plateau, ABg(0.0025, 0.001, 1.8)),
    "read_oslo(glass_catalogues)": (lambda v: prescription.read_oslo(oslo(), glass_catalogues=v), lambda: catalogue()),
    "from_oslo(glass_catalogues)": (lambda v: prescription.from_oslo(oslo(), glass_catalogues=v), lambda: catalogue()),
    "to_optiland(field_deg)": (
        lambda v: [field.y for field in prescription.to_optiland(triplet.build(), v).fields.fields],
        5.0,
    ),
    "PstBands(light)": (
        lambda v: optimize.PstBands(mistray.load("plate_and_wall"), "polish.A", [10, 20], v, rays=500).bands,
        "stray",
    ),
    "PstObservation.weighted(light)": (
        lambda v: optimize.PstObservation(pst()).weighted(np.ones(pst().grid.shape), v),
        "stray",
    ),
    "PstObservation.value_at(light)": (lambda v: optimize.PstObservation(pst()).value_at(10.0, v), "stray"),
    "PstObservation.band(light)": (lambda v: optimize.PstObservation(pst()).band(5.0, 10.0, light=v), "stray"),
    "PstObservation.seen(light)": (lambda v: optimize.PstObservation(pst()).seen(disc(), v), "stray"),
    "pst_bin(light)": (lambda v: optimize.pst_bin(scene(), 10.0, light=v).name, "stray"),
    "pst_band(light)": (lambda v: optimize.pst_band(scene(), 5.0, 10.0, light=v).name, "stray"),
    "pst_mask(light)": (lambda v: optimize.pst_mask(scene(), 10.0, 1e-3, light=v).name, "stray"),
    "fit(noise)": (lambda v: optimize.fit(line, X, v, {"a": 0.5}), 0.1),
    "CassegrainBaffles.structures(scatter)": (lambda v: cassegrain().structures(scatter=v), POLISH),
    "TwoStageBaffle.structures(scatter)": (lambda v: TWO_STAGES.structures(scatter=v), POLISH),
    "TwoStageBaffle.structures(wall_scatter)": (lambda v: TWO_STAGES.structures(wall_scatter=v), POLISH),
    "view(trace)": (lambda v: report.view(scene(), v).title, lambda: trace()),
    "sweep(configurations)": (
        lambda v: sweeps.sweep(scene(), 0, configurations=v, rays=64, cache=False).rows,
        lambda: nearer(),
    ),
    "sweep_pst(configurations)": (
        lambda v: sweeps.sweep_pst(scene(), v, ANGLES, rays=64).configurations,
        lambda: nearer(),
    ),
    "terms.check_names(names)": (lambda v: physics.sags.terms.check_names(v, "sag"), "curvature"),
    "terms.with_even(coefficients)": (lambda v: physics.sags.terms.with_even(0.01, 0.0, v, {}), 1e-6),
    "paraxial.ParaxialSystem(curvature)": (lambda v: paraxial.ParaxialSystem(v, [0.0], [1.0, 1.5]).efl, 0.01),
    "paraxial.ParaxialSystem(z)": (lambda v: paraxial.ParaxialSystem([0.01], v, [1.0, 1.5]).efl, 0.0),
    "paraxial.ParaxialSystem.ghosts(reflectance)": (
        lambda v: paraxial.ParaxialSystem(0.01, 0.0, [1.0, 1.5]).ghosts(9.0, 1.0, v, 0.1),
        0.04,
    ),
    **{f"thinfilm.{f.__name__}(n_layers)": (partial(film, f), 1.38) for f in FILMS},
    **{f"thinfilm.{f.__name__}(d_nm)": (partial(film, f, 1.38), 100.0) for f in FILMS},
    **{f"sag.{f.__name__}(coefficients)": (partial(f, 4.0), 1e-6) for f in POLYNOMIALS},
    "sag.sag(coefficients)": (lambda v: sag.sag(4.0, 0.01, 0.0, v), 1e-6),
    "sag.sag_derivative(coefficients)": (lambda v: sag.sag_derivative(4.0, 0.01, 0.0, v), 1e-6),
    "sag.in_proportion(coefficients)": (lambda v: sag.in_proportion(v, 5.0), 1e-6),
    "sag.trimmed(terms)": (sag.trimmed, 1e-6),
}

# Vectors, pairs, and lists that cannot have one entry
FIXED: dict[str, Call] = {
    "Trace.rays(box)": lambda v: trace().rays(box=v),
    "Trace.rays(pixels)": lambda v: trace().rays(pixels=v),
    "FarField(edges_deg)": lambda v: recorders.FarField("far", edges_deg=v),
    "FarField(axis)": lambda v: recorders.FarField("far", axis=v),
    "FarField(up)": lambda v: recorders.FarField("far", up=v),
    "Probe(centre)": lambda v: recorders.Probe("p", v),
    "Probe(normal)": lambda v: recorders.Probe("p", (0, 0, 1), normal=v),
    "Probe(pixels)": lambda v: recorders.Probe("p", (0, 0, 1), pixels=v),
    "Probe(up)": lambda v: recorders.Probe("p", (0, 0, 1), up=v),
    "DiskSource(centre)": lambda v: analysis.DiskSource(v, 1.0, 10.0),
    "DiskSource(axis)": lambda v: analysis.DiskSource((0, 0, 0), 1.0, 10.0, axis=v),
    "write_pst(maps_at)": lambda v: report.write_pst(pst(), "pst", maps_at=v),
    "PstBands(edges_deg)": lambda v: optimize.PstBands(mistray.load("plate_and_wall"), "polish.A", v, rays=500),
    "fit(observed)": lambda v: optimize.fit(line, v, 0.1, {"a": 0.5}),
    "Body.about(pivot)": lambda v: body().about(v),
    "Body.tilted(tilt_deg)": lambda v: body().tilted(v),
    "CoatingGroup(bounds_nm)": lambda v: optimize.CoatingGroup("ar", None, QUARTER, v),
    "Moved(pivot)": lambda v: optimize.Moved("L1.tilt_x", pivot=v),
    "Surface(tilt_deg)": lambda v: surface(tilt_deg=v),
    "Structure(tilt_deg)": lambda v: mistray.Structure("r", 5.0, 0.0, 8.0, 0.0, tilt_deg=v),
    "Detector(tilt_deg)": lambda v: Detector(semi_diameter=5.0, tilt_deg=v),
    "Detector(pixels)": lambda v: Detector(semi_diameter=5.0, pixels=v),
    "Source(tilt_deg)": lambda v: mistray.Source(radius=5.0, tilt_deg=v),
    "Source(band_nm)": lambda v: mistray.Source(radius=5.0, spectrum="sun", band_nm=v),
    "Source(stokes)": lambda v: mistray.Source(radius=5.0, stokes=v),
    "Source(jones)": lambda v: mistray.Source(radius=5.0, jones=v),
    "ObjectPoint(tilt_deg)": lambda v: prescription.ObjectPoint(distance=9.0, tilt_deg=v),
    "ObjectPoint(band_nm)": lambda v: prescription.ObjectPoint(distance=9.0, spectrum="sun", band_nm=v),
    "ObjectPoint(stokes)": lambda v: prescription.ObjectPoint(distance=9.0, stokes=v),
    "ObjectPoint(jones)": lambda v: prescription.ObjectPoint(distance=9.0, jones=v),
    "Decentre(tilt_deg)": lambda v: prescription.Decentre(tilt_deg=v),
    "Sequential(rows)": lambda v: lens(rows=v),
    "Sequential(fields)": lambda v: lens(fields=v),
    "Sequential(vignetting)": lambda v: lens(vignetting=v),
    "Sequential.with_rows(rows)": lambda v: lens().with_rows(v),
    "Grid.of(step)": lambda v: prescription.Grid.of(np.zeros((5, 5)), v),
    "Grid.of(middle)": lambda v: prescription.Grid.of(np.zeros((5, 5)), (1.0, 1.0), v),
    "box(size)": lambda v: prescription.box("b", v),
    "box(centre)": lambda v: prescription.box("b", (1, 1, 1), centre=v),
    "prism(corners)": lambda v: prescription.prism("p", v, 10, material="N-BK7"),
    "prism(faces)": lambda v: prescription.prism("p", CORNERS, 10, material="N-BK7", faces=v),
    "polygon(corners)": lambda v: prescription.polygon(v).check("polygon"),
    "array(places)": lambda v: prescription.array(FRONT, v),
    "moved_as_one(tilt_deg)": lambda v: prescription.moved_as_one(FRONT, tilt_deg=v),
    "wall(points)": lambda v: prescription.wall("w", v),
    "lens_edge(contact_radii)": lambda v: prescription.lens_edge(
        surface(back="N-BK7"),
        prescription.Surface("t", semi_diameter=5.0, z=2.0, front="N-BK7"),
        contact_radii=v,
    ),
    "to_prescription(detector_half_mm)": lambda v: prescription.to_prescription(
        lens(rows=(GLASS, Row(2, radius=-50.0, thickness=46.0), Row(3, kind="image"))), detector_half_mm=v
    ),
    "paraxial.ParaxialSystem(index)": lambda v: physics.imaging.paraxial.ParaxialSystem(0.01, 0.0, v),
    "pose.fixed_turn(angles_deg)": lambda v: physics.geometry.pose.fixed_turn(v),
}

NAMED: dict[str, Call] = {
    "coat(coatings)": lambda v: mistray.coat("plate", v),
    "coat(paint)": lambda v: mistray.coat("plate", paint=v),
    "coat(scatter)": lambda v: mistray.coat("plate", scatter=v),
    "Rules(coatings)": lambda v: mistray.scene.Rules(coatings=v),
    "Rules(paint)": lambda v: mistray.scene.Rules(paint=v),
    "Rules(scatter)": lambda v: mistray.scene.Rules(scatter=v),
    "Configuration(values)": lambda v: sweeps.Configuration("c", v),
    "Configuration(paint)": lambda v: sweeps.Configuration("c", paint=v),
    "Configuration(coat)": lambda v: sweeps.Configuration("c", coat=v),
    "Surface(sag)": lambda v: surface(sag=v),
    "Detector(sag)": lambda v: Detector(semi_diameter=5.0, sag=v),
    "Row(sag)": lambda v: Row(1, sag=v),
    "Scatter(properties)": lambda v: prescription.Scatter("harvey_shack", v),
    "Prescription.with_scatter(rules)": lambda v: mistray.Prescription(name="p", surfaces=FRONT).with_scatter(v),
    "prism(coatings)": lambda v: prescription.prism("p", CORNERS, 10, material="N-BK7", coatings=v),
    "to_prescription(coatings)": lambda v: prescription.to_prescription(
        lens(rows=(GLASS, Row(2, radius=-50.0, thickness=46.0), Row(3, kind="image"))), coatings=v
    ),
    "from_zemax(coatings)": lambda v: prescription.from_zemax(zmx(), coatings=v),
    "read_zemax(glasses)": lambda v: prescription.read_zemax(zmx(), glasses=v),
    "read_codev(glasses)": lambda v: prescription.read_codev(seq(), glasses=v),
    "from_zemax(glasses)": lambda v: prescription.from_zemax(zmx(), glasses=v),
    "from_codev(glasses)": lambda v: prescription.from_codev(seq(), glasses=v),
    "finish(known)": lambda v: mechanics.finish("black", v),
    "bodies(known)": optimize.bodies,
    "groups(known)": optimize.groups,
    "match(known)": lambda v: optimize.match(v, "plate_front.z"),
    "parameters(params)": lambda v: optimize.parameters(scene(), v),
    "gradient(params)": lambda v: optimize.gradient(optimize.transmission(scene(), rays=64), v),
    "Gradient.along(slopes)": lambda v: gradient().along(v),
    "Body.moved(amounts)": lambda v: body().moved(v),
    "combine(metrics)": lambda v: optimize.combine(v, lambda values: values["a"]),
    "fit(start)": lambda v: optimize.fit(line, X, 0.1, v),
    "Fit.distance(values)": lambda v: fitted().distance(v),
    "Fit.covers(values)": lambda v: fitted().covers(v),
    "Explorer.move(values)": lambda v: explorer().move(v),
    "PathTable.by_way(aliases)": lambda v: trace().paths.by_way(v),
    "GhostReport.aliased(aliases)": lambda v: ghosts().aliased(0.0, v),
    "RayHistory.with_facts(facts)": lambda v: history().with_facts(v),
    "CoatingTable.from_columns(columns)": lambda v: coatings.CoatingTable.from_columns("t", v),
    "write_formats(tables)": lambda v: report.write_formats("npy", ".", v, {}),
    "write_formats(maps)": lambda v: report.write_formats("npy", ".", {}, v),
    "write_formats(facts)": lambda v: report.write_formats("npy", ".", {}, {}, v),
    "write_parquet(facts)": lambda v: report.write_parquet(trace().paths.to_pandas(), "p.parquet", v),
    "write_html(pictures)": lambda v: report.write_html(ghosts(), "g.html", pictures=v),
    "html_text(pictures)": lambda v: report.html_text(ghosts(), pictures=v),
    "add_structures(files)": lambda v: mistray.scene.add_structures("plate", RING, "more.xml", files=v),
    "read_study(source)": optimize.read_study,
    "budget(study)": lambda v: optimize.budget("plate", v),
    "IrradianceMap(facts)": lambda v: report.IrradianceMap(X[None], X[None], (0, 1, 0, 1), v),
    "Mechanics.painted(paint)": lambda v: part().painted(v),
    "Mechanics.painted(space)": lambda v: part().painted(space=v),
    "Mechanics.painted(known)": lambda v: part().painted({"*": "black"}, known=v),
    "Levels.including(numbers)": lambda v: optimize.Levels((0, 1), {}).including(v, {}),
    "Levels.including(units)": lambda v: optimize.Levels((0, 1), {}).including({}, v),
    "Term(own)": lambda v: optimize.Term("t", "path_power", "minimise", own=v),
    "Term(traced)": lambda v: optimize.Term("t", "path_power", "minimise", traced=v),
    "optimize(study)": lambda v: optimize.optimize("plate", v),
    "sensitivity(params)": lambda v: optimize.sensitivity(optimize.transmission(scene(), rays=64), v),
    "read_oslo(glasses)": lambda v: prescription.read_oslo(oslo(), glasses=v),
    "from_oslo(glasses)": lambda v: prescription.from_oslo(oslo(), glasses=v),
    "load(source)": mistray.load,
    "sweep(scene)": lambda v: sweeps.sweep(v, 0, rays=64, cache=False),
}
