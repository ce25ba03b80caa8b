"""The interface as a Mitsuba BSDF, its delta lobes against Snell, Fresnel, tables and tmm; the beam of `collimated`."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
import tmm
from oracles.interface import CoatingTable, Interface, interact
from oracles.small_scenes import write
from refusals import refused

import mistray
from mistray.execute.tracer import prepare
from mistray.light import Light
from mistray.settings import Settings
from mistray.surfaces.surfaces import SurfaceTable

pytestmark = pytest.mark.quick

LAYERS = [(1.38, 120.0), (2.3 + 0.4j, 15.0), (1.6, 90.0)]
METAL = 0.958 + 6.69j
COSINES = np.concatenate([-np.linspace(0.02, 1, 40), np.linspace(0.02, 1, 40)])  # of wi; at -z it is in front
IMPORTANCE = mi.TransportMode.Importance


@dataclass(frozen=True)
class Case:
    bsdf: Any
    cosines: np.ndarray
    R: np.ndarray
    T: np.ndarray
    indices: tuple[float, float]
    accuracy: float = 4e-6

    @property
    def surface(self) -> mi.SurfaceInteraction3f:
        return surface(self.cosines)


def surface(cosines: np.ndarray) -> mi.SurfaceInteraction3f:
    si = dr.zeros(mi.SurfaceInteraction3f, len(cosines))
    sine, phi = np.sqrt(1 - cosines**2), np.linspace(0, 5, len(cosines))
    si.wi = mi.Vector3f(np.stack([sine * np.cos(phi), sine * np.sin(phi), cosines]).astype(np.float32))
    return si


def by_tmm(n_in: complex, layers: list[tuple[complex, float]], n_out: complex, cosine: float) -> tuple[float, float]:
    """R and T of unpolarised light at 550 nm."""
    index, thickness = [n_in, *(n for n, _ in layers), n_out], [np.inf, *(d for _, d in layers), np.inf]
    both = [tmm.coh_tmm(pol, index, thickness, np.arccos(cosine), 550.0) for pol in "sp"]
    return float(np.mean([one["R"] for one in both])), float(np.mean([one["T"] for one in both]))


def text(n: complex) -> str:
    n = complex(n)
    return f"{n.real:g}" if n.imag == 0 else f"{n.real:g}+{n.imag:g}i"


def of_oracle(folder: Path, cosines: np.ndarray = COSINES, **values: Any) -> Case:
    n = (1.2, 1.7)
    table = CoatingTable.read(Path(values["table"])) if "table" in values else None
    shares = (values["R"], values.get("T", 0.0)) if "R" in values else ()
    oracle = Interface("1.2", "1.7", *shares, table=table)
    wi = np.array(surface(cosines).wi, dtype=float).T
    out = interact(oracle, *n, 550.0, -wi, np.tile([0.0, 0.0, 1.0], (len(wi), 1)))
    bsdf = mi.load_dict({"type": "interface", "front": "1.2", "back": "1.7", **values})
    return Case(bsdf, cosines, out.reflectance, out.transmittance, n)


def of_layers(front: complex, back: complex, layers: list[tuple[complex, float]], opaque: bool = False) -> Case:
    outside = layers if front == 1.0 else layers[::-1]  # the first layer is outside
    film = {"type": "thinfilm", "layers": ", ".join(f"{text(n)} {d}" for n, d in outside), "opaque": opaque}
    nested = {"coating": film} if layers else {}
    bsdf = mi.load_dict({"type": "interface", "front": text(front), "back": text(back), **nested})
    r, t = np.full(len(COSINES), np.nan), np.zeros(len(COSINES))
    for k, cosine in enumerate(COSINES):
        if cosine < 0:
            r[k], t[k] = by_tmm(front, layers, back, -cosine)
        elif not np.iscomplex(back):  # no ray comes from a metal
            r[k], t[k] = by_tmm(back, layers[::-1], front, cosine)
    return Case(bsdf, COSINES, r, 0 * t if opaque or np.iscomplex(back) else t, (np.real(front), np.real(back)))


def tabled(folder: Path) -> Case:
    """At its nodes: between them the table is linear in the cosine, and the oracle's in the angle."""
    table = "wavelength_nm,angle_deg,R,T,R_back\n550,0,.1,.8,.15\n550,45,.2,.6,.25\n550,90,.9,.05,.9\n"
    rare = np.cos(np.radians([0.0, 45.0]))
    dense = np.sqrt(1 - (1.2 / 1.7) ** 2 * (1 - rare**2))
    found = of_oracle(folder, np.concatenate([-rare, dense]), table=str(write(folder, table, "coating.csv")))
    return replace(found, accuracy=1e-5)


CASES: dict[str, Callable[[Path], Case]] = {
    "bare": of_oracle,
    "ideal": lambda folder: of_oracle(folder, R=0.3, T=0.5),
    "opaque": lambda folder: of_oracle(folder, R=0.4),
    "tabled": tabled,
    "absorbing film": lambda _: of_layers(1.0, 1.7, LAYERS),
    "total reflection": lambda _: of_layers(1.5168, 1.0, LAYERS),
    "film on metal": lambda _: of_layers(1.0, METAL, [(1.6, 171.875)]),
    "mirror": lambda _: of_layers(1.0, 1.5168, [(1.6, 171.875), (METAL, 150.0)], opaque=True),
    "bare metal": lambda _: of_layers(1.0, METAL, []),
}


@pytest.fixture(params=CASES)
def case(request: pytest.FixtureRequest, tmp_path: Path) -> Case:
    return CASES[request.param](tmp_path)


@pytest.mark.parametrize("mode", [mi.TransportMode.Radiance, IMPORTANCE])
def test_directions_weights_and_probabilities(case: Case, mode: Any) -> None:
    wi = np.array(case.surface.wi, dtype=float).T
    total, front = case.R + case.T, case.cosines < 0
    eta = np.where(front, case.indices[0] / case.indices[1], case.indices[1] / case.indices[0])
    inside = np.sqrt(np.maximum(0, 1 - eta**2 * (1 - case.cosines**2)))
    refracted = np.column_stack([-eta[:, None] * wi[:, :2], np.where(front, inside, -inside)])
    share = case.R / np.maximum(total, 1e-30)
    # Next to the share itself the other event is drawn: frequencies are right
    for u in (0.0 * share, share - 1e-4, share + 1e-4, 0.9999999 + 0 * share):
        drawn = mi.Float(np.clip(np.nan_to_num(u), 0, 0.9999999).astype(np.float32))
        sample, weight = case.bsdf.sample(mi.BSDFContext(mode), case.surface, drawn, mi.Point2f(0.5))
        reflected = np.array(drawn) <= share
        pdf = np.where(reflected, share, 1 - share)
        lit = np.isfinite(case.R) & (total > 0) & (pdf > 1e-6)
        # A table's error is 1e-6 of R and T, the rest float32
        np.testing.assert_allclose((np.array(sample.pdf) * total)[lit], (pdf * total)[lit], atol=case.accuracy)
        scale = np.where(reflected | (mode == IMPORTANCE), 1.0, eta**2)
        np.testing.assert_allclose(np.array(weight)[0][lit], (total * scale)[lit], atol=2.5 * case.accuracy)
        wo = np.where(reflected[:, None], wi * [-1, -1, 1], refracted)
        np.testing.assert_allclose(np.array(sample.wo).T[lit], wo[lit], atol=3e-6)
        np.testing.assert_allclose(np.array(sample.eta)[lit], np.where(reflected, 1, 1 / eta)[lit], rtol=1e-6)
        kind = np.array(sample.sampled_type)
        assert set(kind[reflected & lit]) <= {int(mi.BSDFFlags.DeltaReflection)}
        assert set(kind[~reflected & lit]) <= {int(mi.BSDFFlags.DeltaTransmission)}


def test_masks_and_densities(case: Case) -> None:
    known = np.isfinite(case.R)
    for component, kind in enumerate((mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission)):
        for restrict in ({"component": component}, {"type_mask": kind}):
            context = mi.BSDFContext(IMPORTANCE)
            for key, value in restrict.items():
                setattr(context, key, value)
            sample, weight = case.bsdf.sample(context, case.surface, mi.Float(0.5), mi.Point2f(0.5))
            weight = np.array(weight)[0]
            lit = known & (weight > 0)
            np.testing.assert_allclose(np.array(sample.pdf)[lit], 1.0)
            assert set(np.array(sample.sampled_component)[lit]) <= {component}
            np.testing.assert_allclose(weight[known], (case.T if component else case.R)[known], atol=1e-5)
    # Delta lobes have no density
    context, wo = mi.BSDFContext(), mi.Vector3f(0, 0, 1)
    value, pdf = case.bsdf.eval_pdf(context, case.surface, wo)
    for found in (value, pdf, case.bsdf.eval(context, case.surface, wo), case.bsdf.pdf(context, case.surface, wo)):
        assert dr.all(found == 0, axis=None)
    both = mi.BSDFFlags.DeltaReflection.value | mi.BSDFFlags.DeltaTransmission.value
    assert (case.bsdf.component_count(), case.bsdf.flags() & both) == (2, both)
    _, weight = case.bsdf.sample(context, case.surface, mi.Float(0.5), mi.Point2f(0.5), mi.Mask(False))
    assert dr.all(weight == 0, axis=None)


def test_an_update_changes_the_samples() -> None:
    film = {"type": "thinfilm", "layers": "1.38 99.6377", "id": "ar"}
    bsdf = mi.load_dict({"type": "interface", "back": "1.5168", "coating": film})
    context, params = mi.BSDFContext(IMPORTANCE), mi.traverse(bsdf)
    context.component = 0
    for thickness in (99.6377, 0.0, 50.0):
        params["coating.thickness_nm"] = mi.Float([thickness])
        params.update()
        weight = bsdf.sample(context, surface(np.array([-1.0])), mi.Float(0.5), mi.Point2f(0.5))[1]
        assert float(weight[0][0]) == pytest.approx(by_tmm(1.0, [(1.38, thickness)], 1.5168, 1.0)[0], abs=2e-6)


def test_glass_without_known_absorption_is_transparent_and_samples_change_nothing() -> None:
    film = {"type": "thinfilm", "layers": "1.38 99.6"}
    bsdf = mi.load_dict({"type": "interface", "back": "nd=1.5168 Vd=64.2", "coating": film})
    with refused("k is unknown"):
        bsdf.complex_indices(550.0)
    sample, _ = bsdf.sample(mi.BSDFContext(), surface(np.array([-1.0])), mi.Float(0.5), mi.Point2f(0.5))
    assert float(sample.pdf[0]) > 0.98
    # A literal R of an opaque interface is not widened by the hits that it is asked for
    bsdf = mi.load_dict({"type": "interface", "R": 0.5, "T": 0.0})
    for component in (0, 1):
        context = mi.BSDFContext()
        context.component = component
        bsdf.sample(context, surface(np.ones(4)), mi.Float(0.3), mi.Point2f(0.5))
    values = mi.traverse(bsdf)
    assert (dr.width(values["R"]), dr.width(values["T"])) == (1, 1)


def test_defaults_and_nested_plugins() -> None:
    bsdf = mi.load_dict({"type": "interface"})
    assert (bsdf.front, bsdf.back, bsdf.mirror, bsdf.ideal, bsdf.opaque) == ("air", "air", False, False, False)
    bsdf = mi.load_dict({"type": "interface", "R": 0.9, "mirror": True, "back": "N-BK7"})
    assert (bsdf.opaque, bsdf.mirror) == (True, True)
    assert bsdf.indices(587.5618) == pytest.approx((1.0, 1.5168), abs=1e-5)
    film, polish = {"type": "thinfilm", "layers": "1.38 99"}, {"type": "abg", "A": 1e-4, "B": 1e-3, "g": 2.0}
    nested = mi.load_dict({"type": "interface", "back": "1.5", "coating": film, "polish": polish})
    keys = list(mi.traverse(nested).keys())
    assert [key for key in keys if "shift" in key and "coating" not in key] == ["n_front_shift", "n_back_shift"]
    assert {key for key in keys if "coating" in key} == {f"coating.{k}" for k in ("thickness_nm", "n_shift", "k_shift")}
    alone = mi.load_dict({"type": "thinfilm", "layers": "1.38 99", "back": "1.5", "n_back_shift": 0.25})
    assert alone.indices(550.0) == (1.0, 1.75)


SHIFT = 0.125  # exact in float32, as are the indices with it
COATINGS: dict[str, dict[str, Any]] = {
    "bare": {},
    "layers": {"coating": {"type": "thinfilm", "layers": "1.38 99, 2.1 60"}},
    "ideal": {"R": 0.04, "T": 0.9},
}


def plate(index: str, coating: dict[str, Any], **shifts: float) -> mi.Scene:
    bare = {"type": "interface", **coating}
    front, rear = (bare | {s: index} | {key: x for key, x in shifts.items() if s in key} for s in ("back", "front"))
    return scene_dicts.load(
        beam={"type": "collimated", "radius": 3.0, "field_deg": 10.0},
        front={"type": "asphere", "radius": 40.0, "semi_diameter": 6.0, "bsdf": front},
        rear={"type": "asphere", "semi_diameter": 6.0, "to_world": scene_dicts.at(6), "bsdf": rear},
        detector=scene_dicts.detector(20.0, semi_diameter=9.0, sensor=scene_dicts.meter(16)),
    )


def traced(scene: mi.Scene) -> mistray.Trace:
    return mistray.trace(scene, rays=3000, seed=2)


@pytest.mark.parametrize("name", COATINGS)
def test_it_is_another_index(name: str) -> None:
    there = traced(plate("1.625+1e-6i", COATINGS[name]))
    given = traced(plate("1.5+1e-6i", COATINGS[name], n_back_shift=SHIFT, n_front_shift=SHIFT))
    np.testing.assert_array_equal(given.irradiance, there.irradiance)
    assert given.energy.detected_W == there.energy.detected_W
    scene = plate("1.5+1e-6i", COATINGS[name])
    params = mi.traverse(scene)
    compiled, seen = [], []
    for value in (0.0, 0.25, SHIFT):
        params["front.bsdf.n_back_shift"] = params["rear.bsdf.n_front_shift"] = mi.Float(value)
        params.update()
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            seen.append(traced(scene).irradiance)
            compiled.append(sum(not k["cache_hit"] for k in dr.kernel_history([dr.KernelType.JIT])))
    np.testing.assert_array_equal(seen[-1], there.irradiance)
    assert np.any(seen[0] != there.irradiance)
    assert compiled[1:] == [0, 0]


def test_two_shifts_are_two_media_and_bad_updates_change_nothing() -> None:
    scene = plate("N-BK7", {})
    assert SurfaceTable(scene, 550.0).optics.media == ["unknown", "air", "N-BK7"]
    params = mi.traverse(scene)
    params["front.bsdf.n_back_shift"] = mi.Float(SHIFT)
    params.update()
    assert SurfaceTable(scene, 550.0).optics.media == ["unknown", "air", "N-BK7 shift=0.125", "N-BK7"]
    front, rear = (shape.bsdf() for shape in scene.shapes() if shape.id() in ("front", "rear"))
    assert front.indices(500.0)[1] == rear.indices(500.0)[0] + SHIFT
    assert front.complex_indices(500.0)[1] == rear.complex_indices(500.0)[0] + SHIFT
    bsdf = mi.load_dict({"type": "interface", "id": "face", "back": "1.5", "R": 0.1, "T": 0.8})
    params = mi.traverse(bsdf)
    for key, value, words in (
        ("R", 0.5, r"interface 'face': R = 0.5 and T = 0.8"),
        ("n_back_shift", float("nan"), r"interface 'face': n_back_shift is nan"),
        ("n_front_shift", [0.1, 0.2], r"give one number"),
        ("n_back_shift", -2.0, r"interface 'face': material '1.5 shift=-2.0': index -0.5"),
    ):
        before, params[key] = np.array(params[key]), mi.Float(value)
        with refused(words):
            params.update()
        assert bsdf.indices(550.0) == (1.0, 1.5)
        assert (bsdf.R[0], bsdf.T[0]) == pytest.approx((0.1, 0.8))
        np.testing.assert_array_equal(np.array(mi.traverse(bsdf)[key]), before)
    params["R"], params["n_back_shift"] = mi.Float(2.0), mi.Float(0.1)
    with refused(r"R = 2 and T = 0\.8"):
        params.update()
    assert (bsdf.indices(550.0), float(params["n_back_shift"][0])) == ((1.0, 1.5), 0.0)
    params["R"], params["T"] = mi.Float(0.5), mi.Float(0.5)
    params.update()
    assert (bsdf.R[0], bsdf.T[0]) == (0.5, 0.5)


def emitter(**values: Any) -> Any:
    return mi.load_dict({"type": "collimated", "id": "sun", **values})


def scene_with(values: dict[str, Any], z: float = 0.0) -> Any:
    sun = {"type": "collimated", **values}
    return scene_dicts.load(sun=sun, detector=scene_dicts.detector(z, half_width=50.0, half_height=50.0))


def start_rays(scene: Any, rays: int = 4000, **field: float) -> tuple[np.ndarray, np.ndarray]:
    (run,) = prepare(scene, Settings(rays=rays), Light(**field))
    return run.start_rays(np.arange(run.rays))


def test_power() -> None:
    """Of a disc, a ring and a rectangle."""
    ring, rectangle = {"radius": 2.0, "inner_radius": 1.0}, {"half_width": 2.0, "half_height": 0.5}
    for values, area in (({"radius": 2.0}, 4 * np.pi), (ring, 3 * np.pi), (rectangle, 4.0)):
        assert emitter(**values, irradiance=3.0, field_deg=60.0).power() == pytest.approx(3 * area, rel=1e-12)
        axis = emitter(**values, irradiance=3.0, field_deg=60.0, plane="axis")
        assert (axis.power(), axis.power(0.0)) == pytest.approx((1.5 * area, 3 * area), rel=1e-12)
        energy = mistray.trace(scene_with({**values, "field_deg": 60.0, "plane": "axis"}), rays=500).energy
        assert energy.launched_W == pytest.approx(area / 2, rel=1e-12), values
        assert energy.detected_W == pytest.approx(area / 2, rel=1e-6), values


@pytest.mark.parametrize("plane", ["beam", "axis"])
@pytest.mark.parametrize(("field_deg", "azimuth_deg"), [(0, 0), (20, 0), (-20, 0), (35, 90), (35, -60)])
def test_direction_and_cross_section(plane: str, field_deg: float, azimuth_deg: float) -> None:
    """Through the pivot, along Rz(azimuth) (0, sin θ, cos θ) of its turned frame, uniform in its plane."""
    pivot = np.array([1.0, -2.0, 3.0])
    to_world = mi.ScalarTransform4d().translate(pivot.tolist()).rotate([1, 0, 0], 15)
    turn = np.array(to_world.matrix)[:3, :3]
    scene = scene_with({"radius": 2.0, "plane": plane, "to_world": to_world}, z=9.0)
    origin, direction = start_rays(scene, field_deg=field_deg, azimuth_deg=azimuth_deg)
    theta, phi = np.radians(field_deg), np.radians(azimuth_deg)
    expected = turn @ [-np.sin(phi) * np.sin(theta), np.cos(phi) * np.sin(theta), np.cos(theta)]
    np.testing.assert_allclose(direction, np.tile(expected, (len(direction), 1)), atol=1e-7)
    # All start on one plane normal to the beam
    assert np.ptp((origin - pivot) @ expected) < 1e-5
    normal = expected if plane == "beam" else turn[:, 2]
    t = ((pivot - origin) @ normal) / (direction @ normal)
    place = origin + t[:, None] * direction - pivot
    assert np.abs(place @ normal).max() < 1e-5
    assert np.linalg.norm(place, axis=1).max() < 2.0 + 1e-5
    # A uniform disc: mean 0, mean square radius 2, each to 4 standard errors
    assert np.abs(place.mean(axis=0)).max() < 4 * 1.0 / np.sqrt(len(place))
    assert np.mean(np.sum(place**2, axis=1)) == pytest.approx(2.0, abs=4 * 2 / np.sqrt(3 * len(place)))


def test_annulus_rectangle_start_and_grid() -> None:
    """Uniform, outside of the scene, or at a distance that is given."""
    origin, _ = start_rays(scene_with({"radius": 2.0, "inner_radius": 1.5}))
    r = np.hypot(origin[:, 0], origin[:, 1])
    assert 1.5 - 1e-6 < r.min() < r.max() < 2 + 1e-6
    assert np.mean(r**2) == pytest.approx((2**2 + 1.5**2) / 2, abs=4 * 1.75 / np.sqrt(12 * len(r)))
    origin, _ = start_rays(scene_with({"half_width": 3.0, "half_height": 0.5}))
    assert np.abs(origin[:, :2]).max(axis=0) == pytest.approx([3.0, 0.5], rel=1e-2)
    assert np.mean(origin[:, 0] ** 2) == pytest.approx(3.0, abs=4 * 3 * np.sqrt(0.8 / len(origin)))
    for field in (0.0, 40.0, -75.0):
        origin, direction = start_rays(scene_with({"radius": 2.0}, z=-30.0), field_deg=field)
        corners = np.array([[x, y, -30.0] for x in (-50, 50) for y in (-50, 50)])
        assert (corners @ direction[0]).min() > (origin @ direction[0]).max()
    origin, _ = start_rays(scene_with({"radius": 2.0, "distance": 7.0}, z=9.0))
    np.testing.assert_allclose(origin[:, 2], -7.0, atol=1e-6)
    scene = scene_with({"half_width": 1.0, "half_height": 2.0, "pattern": "grid"})
    t = mistray.trace(scene, rays=1000)
    origin, _ = start_rays(scene, rays=1000)
    x, y = (np.unique(column.round(5)) for column in origin[:, :2].T)
    assert (t.settings["rays"], len(x), len(y)) == (31**2, 31, 31)
    np.testing.assert_allclose(x[[0, -1]], [-30 / 31, 30 / 31], atol=1e-5)
    assert t.energy.detected_W == pytest.approx(8.0, rel=1e-6)
    disc, _ = start_rays(scene_with({"radius": 2.0, "pattern": "grid"}), rays=10_000)
    assert np.mean(np.sum(disc[:, :2] ** 2, axis=1)) == pytest.approx(2.0, rel=1e-3)
    assert np.abs(disc[:, :2].mean(axis=0)).max() < 1e-5


def test_wavelengths() -> None:
    for given, wavelengths, weights in (
        ({"wavelength_nm": "486.1, 587.6,656.3", "weights": "1, 2, 1"}, [486.1, 587.6, 656.3], [0.25, 0.5, 0.25]),
        ({"wavelength_nm": 600.0}, [600.0], [1.0]),
        ({"wavelength_nm": "500 600"}, [500.0, 600.0], [0.5, 0.5]),
        ({}, [550.0], [1.0]),
    ):
        many = emitter(radius=1.0, **given)
        assert (many.wavelengths_nm.tolist(), many.weights.tolist()) == (wavelengths, weights)
    assert not mi.traverse(many).keys(), "none of its numbers is a Dr.Jit variable that an update could miss"
