"""Calls of public functions, methods and constructors by one of their arguments that takes several values.

`ONE` has those for which a single value is a list of one, `FIXED` vectors and lists that cannot be single, `NAMED`
mappings. Each call takes the argument alone, most by its name, and returns what depends on it.
"""

from collections.abc import Callable, Iterable
from functools import cache, partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from result_calls import X, line

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
SEQ = "RDM\nLEN\nEPD 8\nDIM M\nWL 588\nYAN 0\nSO 0 1E20\nS 50 5 NBK7_SCHOTT\nSTO\nS -50 46\nSI 0 0\nGO\n"
scene = cache(lambda: mistray.load("plate"))
known = cache(lambda: optimize.parameters(scene()))
trace = cache(lambda: mistray.trace(scene(), rays=256))
history = cache(lambda: trace().history(0, 2))
ghosts = cache(lambda: mistray.ghosts(scene(), 0, rays=256))
pst = cache(lambda: mistray.pst(mistray.load("lens_and_window"), ANGLES, rays=500))
image = cache(lambda: mistray.image_quality(mistray.load("cooke_triplet"), 0, grid=32))
transfer = cache(lambda: mistray.transfer(mistray.load("cooke_triplet"), rays=500, frequencies_per_mm=[10, 20]))
gradient = cache(
    lambda: optimize.gradient(optimize.transmission(scene(), rays=256), mi.traverse(scene()), keys="plate_front.z")
)
body = cache(lambda: optimize.bodies(optimize.parameters(mistray.load("lens_and_window")))["window"])
walled = cache(lambda: mistray.load("plate_and_wall"))
bands = cache(lambda: optimize.PstBands(walled(), "polish.A", [10, 20], rays=500))
part = cache(lambda: mechanics.read_mechanics(Path(__file__).parent / "data" / "triangle.ply"))
explorer = cache(lambda: mistray.Explorer("plate", rays=64))
pst_sweep = cache(lambda: sweeps.sweep_pst(scene(), {"nearer": {"plate_front.z": -0.1}}, ANGLES, rays=300))


fitted = cache(lambda: optimize.fit(line, X, 0.1 * np.ones(3), {"a": 0.5}))

POLISH = prescription.Scatter("harvey_shack", {"rms_nm": 2.0, "l": 0.01, "s": -1.5})
LAYER = coatings.Layer("MgF2", 99.4)
QUARTER = coatings.Stack((LAYER,))
FRONT = prescription.Surface("f", semi_diameter=5.0)
RING = prescription.Structure("r", 5.0, 0.0, 8.0, 0.0)
GLASS = Row(1, radius=50.0, thickness=5.0, material="N-BK7", stop=True)
TUBE = prescription.vane_tube("hood", optic_radius=20, z_rear=0, length=150, wall_radius=40, field_deg=5)
TERM = {"kind": "path_power", "selection": "ghost", "goal": "minimise"}
SHIFT = {"parameters": ["window_front.y"], "low": -0.1, "high": 0.1}
STUDY = optimize.read_study({"term": [TERM], "variable": [SHIFT]})
COATED = optimize.CoatingGroup("ar", ("L1_front",), QUARTER, ((60.0, 150.0),))
TWO_STAGES = prescription.two_stage_baffle("baffle", optic_radius=20, z_rear=0, field_deg=5, exclusion_deg=40, depth=10)
FILMS = [thinfilm.amplitudes, thinfilm.reflectance_transmittance, thinfilm.amplitudes_and_shares]
POLYNOMIALS = [sag.polynomial, sag.polynomial_derivative, sag.polynomial_second_derivative]
LENS = {"name": "lens", "rows": (GLASS, Row(2, kind="image")), "aperture": 8}
CURVED = Sequential(**LENS | {"rows": (GLASS, Row(2, radius=-50.0, thickness=46.0), Row(3, kind="image"))})
FACE = {"name": "s", "semi_diameter": 5.0}
ENDS = {"radius": 4, "z_front": 10, "z_rear": 10.5, "outer_front": 12, "outer_rear": 12}


def written(name: str, text: str) -> str:
    Path(name).write_text(text, encoding="utf-8")
    return name


@cache
def catalogue() -> str:
    """A glass catalogue of one glass."""
    text = (
        "CC a test\nNM ODD 2 0 1.5168 64.17 0 1 -1\nCD 1.03961212 6.00069867E-03 0.231792344 0.0200179144 1.01046945 "
    )
    return written("odd.agf", f"{text}103.560653\nLD 0.3 2.5\n")


@cache
def zmx() -> str:
    """A singlet as a Zemax file."""
    prescription.write_zemax(CURVED, "singlet.zmx")
    return "singlet.zmx"


seq = cache(lambda: written("singlet.seq", SEQ))


def table(name: str, **given: Any) -> bytes:
    coatings.write_table(QUARTER, name, **({"wavelengths_nm": 550.0, "angles_deg": 0.0} | given))
    return Path(name).read_bytes()


@cache
def oslo() -> str:
    text = 'LEN NEW "Singlet" 49 3; EBR 4; ANG 1; UNI 1; AIR; TH 1e20; NXT; GLA N-BK7; RD 50; TH 5; AP 10; AST; '
    text += "NXT; AIR; RD -50; TH 46; AP 10; NXT; AIR; WV 0.588; WW 1; END 3"
    return written("singlet.len", text.replace("; ", "\n"))


nearer = cache(lambda: sweeps.Configuration("nearer", {"plate_front.z": -0.1}))


@cache
def cassegrain() -> Any:
    numbers = {"radius": -1000, "conic": -1, "semi_diameter": 100, "inner_semi_diameter": 26}
    primary = mistray.Surface("primary", mirror=True, **numbers)
    secondary = mistray.Surface("secondary", z=-370, radius=-346.67, conic=-2.78, semi_diameter=24, mirror=True)
    ends = {"field_deg": 0.28, "wall_depth": 4, "wall_rear": 26}
    return prescription.cassegrain_baffles(primary, secondary, Detector(z=150, semi_diameter=10), **ends)


ray = cache(lambda: report.rays_of_paths(trace(), 1, 1)[0])


def made(value: Any) -> Any:
    """What a cached function returns, when it is needed; any other value as it is."""
    return value() if hasattr(value, "cache_info") else value


def called(function: Call, argument: str, given: dict[str, Any], seen: Call, value: Any) -> Any:
    return seen(function(**{name: made(other) for name, other in given.items()} | {argument: value}))


def by(function: Any, names: str, /, seen: Call | None = None, module: str = "", **given: Any) -> dict[str, Call]:
    """Calls of a function by some of its arguments, with others given; of a class they return its attribute."""
    calls: dict[str, Call] = {}
    for name in names.split():
        attribute = (lambda found, name=name: getattr(found, name, found)) if isinstance(function, type) else made
        calls[f"{module}{function.__name__}({name})"] = partial(called, function, name, given, seen or attribute)
    return calls


def by_each(functions: Iterable[Any], names: str, /, **given: Any) -> dict[str, Call]:
    return {name: call for function in functions for name, call in by(function, names, **given).items()}


def of(owner: Callable[[], Any], kind: str, names: str, /, seen: Call = made, **given: Any) -> dict[str, Call]:
    """Calls of methods, as "method(argument)", of the object of a class that a function makes."""
    calls: dict[str, Call] = {}
    for name in names.split():
        method, _, argument = name[:-1].partition("(")
        bound = partial(lambda method, /, **words: getattr(owner(), method)(**words), method)
        calls[f"{kind}.{name}"] = partial(called, bound, argument, given, seen)
    return calls


def one(value: Any, *calls: dict[str, Call]) -> dict[str, tuple[Call, Any]]:
    return {name: (call, value) for named in calls for name, call in named.items()}


paths = cache(lambda: trace().paths)
observation = cache(lambda: optimize.Observation(trace()))
pst_observation = cache(lambda: optimize.PstObservation(pst()))
system = cache(lambda: paraxial.ParaxialSystem(0.01, 0.0, [1.0, 1.5]))
transmission = cache(lambda: optimize.transmission(scene(), rays=64))
field_image = cache(lambda: image()[0])
surface_transfer = cache(lambda: analysis.transfer_of_bsdf(ABg(0.0025, 0.001, 1.8), 550.0))


def coating_table() -> Any:
    table("t.csv")
    return coatings.CoatingTable.read("t.csv")


path_rows = cache(lambda: trace().paths.to_pandas())
params = cache(lambda: mi.traverse(scene()))


def heights(system: Any) -> list[float]:
    return [field.y for field in system.fields.fields]


def drawn(figure: Any) -> int:
    return len(figure.axes[0].lines)


def names_of(files: Any) -> list[str]:
    return [file.name for file in files]


IDS, POWER = "path_ids", attrgetter("power")
METRIC = {"scene": scene, "rays": 64}
NORMS = (optimize.peak_irradiance, optimize.ghost_rms_irradiance, optimize.ghost_focus)
LIGHT = (optimize.path_power, optimize.ghost_to_signal, *NORMS)
WAY = {"wavelength_nm": 550.0, "n_front": 1.0, "n_back": 1.5, "from_front": True}
TO_FIT = {"model": line, "observed": X, "noise": 0.1, "start": {"a": 0.5}}
PRISM = {"name": "p", "corners": [(0, 0), (10, 0), (0, 10)], "width": 10, "material": "N-BK7"}
FRESNEL = {"name": "f", "radius": -25, "semi_diameter": 5, "groove_mm": 1}
SPIDER = {"name": "s", "vanes": 3, "inner_radius": 5, "outer_radius": 9, "thickness": 1, "depth": 2, "z": 0}
HOOD = {"name": "h", "optic_radius": 20, "z_rear": 0, "length": 150, "field_deg": 5}
BANDS = {"scene": walled, "keys": "polish.A", "edges_deg": [10, 20], "rays": 500}
FILM = {"n_incident": 1.0, "n_layers": 1.38, "d_nm": 100.0, "n_substrate": 1.5, "wavelength_nm": 550.0}
PART = {"name": "r", "r0": 5.0, "z0": 0.0, "r1": 8.0, "z1": 0.0}
WRITTEN = {"formats": "npy", "directory": ".", "tables": {}, "maps": {}}
BACK, REAR = prescription.Surface(**FACE, back="N-BK7"), prescription.Surface(**FACE, z=2.0, front="N-BK7")

ONE: dict[str, tuple[Call, Any]] = {
    # Paths, surfaces and light of a trace
    **one(1, of(trace, "Trace", "irradiance_of(path_ids) maps(groups) light_cones(path_ids) sampled_rays(path_ids)")),
    **one(1, of(trace, "Trace", "each_map(groups)", list, with_noise=False)),
    **one(True, of(trace, "Trace", "each_map(with_noise)", list, groups=[1])),
    **one("detector", of(trace, "Trace", "rays_at(where)", n=5)),
    **one("detector", of(trace, "Trace", "surface_maps(surfaces)", azimuths=4, lengths=2)),
    **one("ghost", of(trace, "Trace", "surface_maps(selections)", surfaces="detector", azimuths=4, lengths=2)),
    **one(1, of(paths, "PathTable", "located(path_ids)", lambda found: [own.ids for own in found])),
    **one(1, of(paths, "PathTable", "check_ids(path_ids) power(path_ids) light(path_ids) numbers(groups)")),
    **one(1, of(paths, "PathTable", "columns_of(groups)")),
    **one(1, of(history, "RayHistory", "__getitem__(numbers)", attrgetter("rays"))),
    **one(600.0, by(mistray.trace, "wavelength_nm", attrgetter("energy"), **METRIC)),
    **one(2.0, by(mistray.trace, "weights", attrgetter("energy"), wavelength_nm=600.0, **METRIC)),
    **one("detector", by(mistray.trace, "detector", attrgetter("energy"), **METRIC)),
    **one(recorders.FluxSplit("x"), by(mistray.trace, "recorders", lambda found: found.recorders.keys(), **METRIC)),
    **one(1, by_each((report.rays_of_paths, analysis.path_analysis), "path_ids", trace=trace)),
    **one(1, by(report.layout, "path_ids", drawn, report=ghosts, field_deg=0.0)),
    **one(1, by(report.layout_figure, "path_ids", drawn, scene=scene, trace=trace)),
    **one(trace, by(report.layout_figure, "trace", drawn, scene=scene)),
    **one(trace, by(report.view, "trace", attrgetter("title"), scene=scene)),
    "GhostReport.map_light(selections)": (lambda v: (ghosts().map_light(v), ghosts().light_maps)[1], "ghost"),
    **one(1, of(ghosts, "GhostReport", f"check_ids({IDS}) path_maps({IDS}) rays_of_paths({IDS})", field_deg=0.0)),
    **one("plate_front", by_each((recorders.FluxSplit, recorders.SurfaceMaps), "surfaces", name="x")),
    # Results over field angle, frequency and light
    **one("stray", of(pst, "Pst", "samples(classes) estimates(classes) curve(classes) map(classes)")),
    **one("stray", of(pst, "Pst", "budget(classes)", field_deg=10.0)),
    **one("stray", of(pst_sweep, "PstSweep", "changed(classes)", configuration="nearer", field_deg=10.0)),
    **one("stray", of(pst_sweep, "PstSweep", "to_pandas(classes)")),
    **one("stray", of(pst_observation, "PstObservation", "cells(light) curve(light)")),
    **one("stray", of(pst_observation, "PstObservation", "weighted(light)", coefficients=np.ones((2, 1)))),
    **one("stray", of(pst_observation, "PstObservation", "value_at(light)", field_deg=10.0)),
    **one("stray", of(pst_observation, "PstObservation", "band(light)", low_deg=5.0, high_deg=10.0)),
    **one("stray", of(pst_observation, "PstObservation", "seen(light)", source=Disc(7.0, 1.0))),
    **one(10.0, of(field_image, "FieldImage", "otf(frequencies_per_mm) mtf(frequencies_per_mm)")),
    **one(10.0, of(field_image, "FieldImage", "diffraction_limit(frequencies_per_mm)")),
    **one(0.01, of(field_image, "FieldImage", "encircled_energy(radii_mm) line_spread(x_mm)")),
    **one(10.0, of(image, "ImageQuality", "to_pandas(frequencies_per_mm)")),
    **one(10.0, by(report.quality_text, "frequencies", found=image)),
    **one(10.0, by(report.write_quality, "frequencies", names_of, found=image, directory="q")),
    **one(0.01, of(lambda: transfer()[0], "FieldTransfer", "encircled_energy(radii_mm)")),
    **one(10.0, of(surface_transfer, "SurfaceTransfer", "at(frequencies_per_mm)", f_number=4.0, footprint_mm=10.0)),
    # Metrics, parameters and fits
    **one("plate_front.*", by(optimize.match, "patterns", known=known)),
    "gradient(keys)": (lambda v: [*optimize.gradient(transmission(), params(), keys=v).gradient], "plate_front.z"),
    **one("plate_front.z", of(gradient, "Gradient", "require(keys) covariance(keys)")),
    "Metric(field_deg)": (lambda v: optimize.transmission(scene(), rays=64, field_deg=v).field_deg, 1.0),
    "Metric(wavelength_nm)": (lambda v: optimize.transmission(scene(), rays=64, wavelength_nm=v).wavelength_nm, 600.0),
    "Metric(weights)": (lambda v: optimize.transmission(scene(), rays=64, wavelength_nm=600.0, weights=v).weights, 2.0),
    **one("ghost", by_each(LIGHT, "selection", seen=lambda metric: float(metric.value()), **METRIC)),
    **one("ghost", of(observation, "Observation", "power(selection) map(selection) peak(selection) chosen(selection)")),
    **one("ghost", of(observation, "Observation", "moments(selection) moments_of_each(selection)", POWER)),
    "pst_mask(field_deg)": (lambda v: optimize.pst_mask(scene(), v, 1e-3).views[0].arguments["field_deg"], 10.0),
    **one(1e-3, by(optimize.pst_mask, "limits", attrgetter("name"), scene=scene, field_deg=10.0)),
    **one("stray", by(optimize.pst_mask, "light", attrgetter("name"), scene=scene, field_deg=10.0, limits=1e-3)),
    **one("stray", by(optimize.pst_bin, "light", attrgetter("name"), scene=scene, field_deg=10.0)),
    **one("stray", by(optimize.pst_band, "light", attrgetter("name"), scene=scene, low_deg=5.0, high_deg=10.0)),
    **one("polish.A", by(optimize.PstBands, "keys", **BANDS)),
    **one(0.0, by(optimize.PstBands, "azimuths_deg", attrgetter("bands"), **BANDS)),
    **one("stray", by(optimize.PstBands, "light", attrgetter("bands"), **BANDS)),
    **one(0.01, of(bands, "PstBands", "observe(values)", lambda found: found.pst.value)),
    **one(0.01, of(bands, "PstBands", "measure(values) __call__(values)")),
    **one(0.1, by(optimize.fit, "low noise", **TO_FIT)),
    **one(2.0, by(optimize.fit, "high power", **TO_FIT)),
    **one(STUDY.terms[0], by(optimize.DesignStudy, "terms", name="s")),
    **one(STUDY.variables[0], by(optimize.DesignStudy, "variables", name="s", terms=STUDY.terms)),
    **one(COATED, by(optimize.DesignStudy, "coatings", name="s", terms=STUDY.terms)),
    **one(optimize.Moved("window_front.y"), by(optimize.VariableGroup, "parameters", name="v", low=0.0, high=1.0)),
    **one("L1_front", by(optimize.CoatingGroup, "surfaces", name="ar", start=QUARTER, bounds_nm=((60.0, 150.0),))),
    **one(0.0, by(mistray.Explorer, "field_deg", attrgetter("fields"), scene="plate", rays=64)),
    **one("plate_front.z", by(mistray.Explorer, "control", lambda found: [*found.controls], scene="plate", rays=64)),
    **one(RING, by(sweeps.Configuration, "block", name="c")),
    **one(nearer, by(sweeps.sweep, "configurations", attrgetter("rows"), field_deg=0, cache=False, **METRIC)),
    **one(nearer, by(sweeps.sweep_pst, "configurations", attrgetter("configurations"), field_deg=ANGLES, **METRIC)),
    # Coatings and materials
    **one(LAYER, by(coatings.Stack, "layers"), by(coatings.layer_text, "layers")),
    **one(550.0, by(coatings.spectrum, "wavelengths_nm", coating=QUARTER, angles_deg=[0.0])),
    **one(30.0, by(coatings.spectrum, "angles_deg", coating=QUARTER, wavelengths_nm=[550.0])),
    "write_table(wavelengths_nm)": (lambda v: table("t.csv", wavelengths_nm=v), 550.0),
    "write_table(angles_deg)": (lambda v: table("t.csv", angles_deg=v), 30.0),
    **one(0.5, of(coatings.Bare, "Bare", "response(cos_incident)", **WAY)),
    **one(0.5, of(lambda: coatings.Ideal(0.1, 0.8), "Ideal", "response(cos_incident)", **WAY)),
    **one(0.5, of(lambda: QUARTER, "Stack", "response(cos_incident)", **WAY)),
    **one(0.5, of(coating_table, "CoatingTable", "response(cos_incident)", **WAY)),
    **one(0.01, by(mistray.Coating, "n_shift k_shift", layers="MgF2 99")),
    # Prescriptions
    **one(1e-6, by(prescription.Surface, "coefficients", **FACE), by(Detector, "coefficients", semi_diameter=5.0)),
    **one(1e-6, by(Row, "coefficients", number=1), by(prescription.fresnel, "coefficients", **FRESNEL)),
    **one(POLISH, by(prescription.Surface, "scatter", **FACE), by(Detector, "scatter", semi_diameter=5.0)),
    **one(POLISH, by(mistray.Structure, "scatter", **PART), by(Stop, "scatter", **ENDS)),
    **one(POLISH, by(prescription.MeshStructure, "scatter", name="m", file="m.ply")),
    **one(POLISH, by(prescription.prism, "scatter", **PRISM), by(mechanics.Finish, "scatter")),
    **one(POLISH, by(prescription.box, "scatter", name="b", size=(1, 1, 1))),
    **one(POLISH, by(prescription.fresnel, "scatter", **FRESNEL), by(prescription.spider, "scatter", **SPIDER)),
    **one(POLISH, by(prescription.plate, "scatter", name="p", outline=prescription.circle(5.0), thickness=1.0)),
    **one(POLISH, of(lambda: TUBE, "BaffleTube", "structures(scatter) structures(wall_scatter)")),
    **one(POLISH, of(cassegrain, "CassegrainBaffles", "structures(scatter)")),
    **one(POLISH, of(lambda: TWO_STAGES, "TwoStageBaffle", "structures(scatter) structures(wall_scatter)")),
    **one(FRONT, by(mistray.Prescription, "surfaces", name="p")),
    **one(RING, by(mistray.Prescription, "structures", name="p", surfaces=())),
    **one(Detector(semi_diameter=5.0), by(mistray.Prescription, "more_detectors", name="p", surfaces=())),
    **one(600.0, by(mistray.Source, "wavelength_nm", radius=5.0), by(Sequential, "wavelengths_nm", **LENS)),
    **one(2.0, by(mistray.Source, "weights", radius=5.0), by(Sequential, "weights", **LENS)),
    **one(600.0, by(prescription.ObjectPoint, "wavelength_nm", distance=9.0)),
    **one(2.0, by(prescription.ObjectPoint, "weights", distance=9.0)),
    **one(prescription.Unread(1, "GLRS", "it draws"), by(Sequential, "unread", **LENS)),
    **one("a note", by(Sequential, "notes", **LENS)),
    **one(5.0, by(OutlineFigure, "sizes", kind="circle")),
    **one(OutlineFigure("circle", sizes=(5.0,)), by(Outline, "figures")),
    **one("1", by(prescription.prism, "mirrors", **PRISM)),
    **one(40.0, by(prescription.vane_tube, "wall_radius", **HOOD)),
    **one(FRONT, by(prescription.array, "faces", places=[(0, 0), (9, 0)])),
    **one(FRONT, by(prescription.barrel, "items"), by(prescription.moved_as_one, "faces", z=1.0)),
    **one(RING, by(mistray.scene.add_structures, "structures", Path.read_bytes, source="plate", target="more.xml")),
    **one("point:0,0,-500", by(mistray.load, "sources", lambda found: len(found.emitters()), source="plate")),
    **one("probe:0,0,5,half_width=2", by(mistray.load, "sensors", lambda found: len(found.sensors()), source="plate")),
    **one("point:0,0,-500", by(mistray.coat, "sources", lambda found: len(found.emitters()), system="plate")),
    **one("probe:0,0,5,half_width=2", by(mistray.coat, "sensors", lambda found: len(found.sensors()), system="plate")),
    # Files
    **one(catalogue, by_each((prescription.read_codev, prescription.from_codev), "glass_catalogues", path=seq)),
    **one(catalogue, by_each((prescription.read_zemax, prescription.from_zemax), "glass_catalogues", path=zmx)),
    **one(catalogue, by_each((prescription.read_oslo, prescription.from_oslo), "glass_catalogues", path=oslo)),
    **one(ray, by(report.write_rays, "rays", Path.read_bytes, path="rays.json")),
    **one("npy", by(report.write_formats, "formats", names_of, **WRITTEN)),
    **one(ABg(0.0025, 0.001, 1.8), by(analysis.transfer_of_bsdf, "models", attrgetter("plateau"), wavelength_nm=550.0)),
    **one(5.0, by(prescription.to_optiland, "field_deg", heights, prescription=triplet.build())),
    # Formulas
    **one("curvature", by(physics.sags.terms.check_names, "names", module="terms.", owner="sag")),
    **one(1e-6, by(physics.sags.terms.with_even, "coefficients", module="terms.", curvature=0.01, conic=0.0, more={})),
    "paraxial.ParaxialSystem(curvature)": (lambda v: paraxial.ParaxialSystem(v, [0.0], [1.0, 1.5]).efl, 0.01),
    "paraxial.ParaxialSystem(z)": (lambda v: paraxial.ParaxialSystem([0.01], v, [1.0, 1.5]).efl, 0.0),
    **one(0.04, of(system, "paraxial.ParaxialSystem", "ghosts(reflectance)", image_z=9.0, beam_radius_mm=1.0)),
    **one(1.38, by_each(FILMS, "n_layers", module="thinfilm.", cos_incident=1.0, **FILM)),
    **one(100.0, by_each(FILMS, "d_nm", module="thinfilm.", cos_incident=1.0, **FILM)),
    **one(1e-6, by_each(POLYNOMIALS, "coefficients", module="sag.", r2=4.0)),
    "sag.sag(coefficients)": (partial(sag.sag, 4.0, 0.01, 0.0), 1e-6),
    "sag.sag_derivative(coefficients)": (partial(sag.sag_derivative, 4.0, 0.01, 0.0), 1e-6),
    "sag.in_proportion(coefficients)": (lambda v: sag.in_proportion(v, 5.0), 1e-6),
    "sag.trimmed(terms)": (sag.trimmed, 1e-6),
}

# Vectors, pairs, and lists that cannot have one entry
FIXED: dict[str, Call] = {
    **of(trace, "Trace", "rays(box) rays(pixels)"),
    **by(recorders.FarField, "edges_deg axis up", name="far"),
    **by(recorders.Probe, "centre normal pixels up", name="p", centre=(0, 0, 1)),
    **by(analysis.DiskSource, "centre axis", centre=(0, 0, 0), radius=1.0, half_angle_deg=10.0),
    **by(report.write_pst, "maps_at", pst=pst, directory="pst"),
    **by(optimize.PstBands, "edges_deg", **BANDS),
    **by(optimize.fit, "observed", **TO_FIT),
    **of(body, "Body", "about(pivot) tilted(tilt_deg)"),
    **by(optimize.CoatingGroup, "bounds_nm", name="ar", surfaces=None, start=QUARTER),
    **by(optimize.Moved, "pivot", key="L1.tilt_x"),
    **by(prescription.Surface, "tilt_deg", **FACE),
    **by(mistray.Structure, "tilt_deg", **PART),
    **by(Detector, "tilt_deg pixels", semi_diameter=5.0),
    **by(mistray.Source, "tilt_deg stokes jones", radius=5.0),
    **by(mistray.Source, "band_nm", radius=5.0, spectrum="sun"),
    **by(prescription.ObjectPoint, "tilt_deg stokes jones", distance=9.0),
    **by(prescription.ObjectPoint, "band_nm", distance=9.0, spectrum="sun"),
    **by(prescription.Decentre, "tilt_deg"),
    **by(Sequential, "rows fields vignetting", **LENS),
    **of(lambda: CURVED, "Sequential", "with_rows(rows)"),
    **of(lambda: prescription.Grid, "Grid", "of(step) of(middle)", heights=np.zeros((5, 5)), step=(1.0, 1.0)),
    **by(prescription.box, "size centre", name="b", size=(1, 1, 1)),
    **by(prescription.prism, "corners faces", **PRISM),
    **by(prescription.polygon, "corners", lambda found: found.check("polygon")),
    **by(prescription.array, "places", faces=FRONT),
    **by(prescription.moved_as_one, "tilt_deg", faces=FRONT),
    **by(prescription.wall, "points", name="w"),
    **by(prescription.lens_edge, "contact_radii", first=BACK, second=REAR),
    **by(prescription.to_prescription, "detector_half_mm", sequential=CURVED),
    **by(paraxial.ParaxialSystem, "index", module="paraxial.", curvature=0.01, z=0.0),
    **by(physics.geometry.pose.fixed_turn, "angles_deg", module="pose."),
}

NAMED: dict[str, Call] = {
    **by(mistray.coat, "coatings paint scatter", system="plate"),
    **by(mistray.scene.Rules, "coatings paint scatter"),
    **by(sweeps.Configuration, "values paint coat", name="c"),
    **by(prescription.Surface, "sag", **FACE),
    **by(Detector, "sag", semi_diameter=5.0),
    **by(Row, "sag", number=1),
    **by(prescription.Scatter, "properties", kind="harvey_shack"),
    **of(lambda: mistray.Prescription(name="p", surfaces=FRONT), "Prescription", "with_scatter(rules)"),
    **by(prescription.prism, "coatings", **PRISM),
    **by(prescription.to_prescription, "coatings", sequential=CURVED),
    **by(prescription.from_zemax, "coatings glasses", path=zmx),
    **by(prescription.read_zemax, "glasses", path=zmx),
    **by_each((prescription.read_codev, prescription.from_codev), "glasses", path=seq),
    **by_each((prescription.read_oslo, prescription.from_oslo), "glasses", path=oslo),
    **by(mechanics.finish, "known", text="black"),
    **by_each((optimize.bodies, optimize.groups), "known"),
    **by(optimize.match, "known", patterns="plate_front.z"),
    **by(optimize.parameters, "params", scene=scene),
    **by_each((optimize.gradient, optimize.sensitivity), "params", metric=transmission),
    **of(gradient, "Gradient", "along(slopes)"),
    **of(body, "Body", "moved(amounts)"),
    **by(optimize.combine, "metrics", function=lambda values: values["a"]),
    **by(optimize.fit, "start", **TO_FIT),
    **of(fitted, "Fit", "distance(values) covers(values)"),
    **of(explorer, "Explorer", "move(values)"),
    **of(paths, "PathTable", "by_way(aliases)"),
    **of(ghosts, "GhostReport", "aliased(aliases)", field_deg=0.0),
    **of(history, "RayHistory", "with_facts(facts)"),
    **of(lambda: coatings.CoatingTable, "CoatingTable", "from_columns(columns)", name="t"),
    **by(report.write_formats, "tables maps facts", **WRITTEN),
    **by(report.write_parquet, "facts", table=path_rows, path="p.parquet"),
    **by(report.write_html, "pictures", report=ghosts, path="g.html"),
    **by(report.html_text, "pictures", report=ghosts),
    **by(mistray.scene.add_structures, "files", source="plate", structures=RING, target="more.xml"),
    **by_each((optimize.read_study, mistray.load), "source"),
    **by_each((optimize.budget, optimize.optimize), "study", scene="plate"),
    **by(report.IrradianceMap, "facts", irradiance=X[None], irradiance_se=X[None], extent=(0, 1, 0, 1)),
    **of(part, "Mechanics", "painted(paint) painted(space)"),
    **of(part, "Mechanics", "painted(known)", paint={"*": "black"}),
    **of(lambda: optimize.Levels((0, 1), {}), "Levels", "including(numbers) including(units)", numbers={}, units={}),
    **by(optimize.Term, "own traced", name="t", kind="path_power"),
    **by(sweeps.sweep, "scene", field_deg=0, rays=64, cache=False),
}
