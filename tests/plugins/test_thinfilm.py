"""`thinfilm` alone and nested: parameters, errors, `mi.traverse`, and the delta lobes that stock integrators get."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
import tmm
from scipy.stats import chi2

import mistray
from mistray.coatings import Ideal, Layer, Stack, preset

SAMPLE = Path(__file__).parents[1] / "data" / "coating_sample.dat"
STACK = "1.38 120, 2.3+0.4i 15, 1.6 90"
LAYERS = [(1.38, 120.0), (2.3 + 0.4j, 15.0), (1.6, 90.0)]
T = mi.ScalarTransform4f


def load(**values: Any) -> Any:
    return mi.load_dict({"type": "thinfilm", "id": "ar", **values})


def nested(film: dict[str, Any], **values: Any) -> Any:
    return mi.load_dict({"type": "interface", "back": "1.5168", **values, "coating": {"type": "thinfilm", **film}})


def why(values: dict[str, Any]) -> str:
    with pytest.raises((mistray.MistrayError, RuntimeError)) as caught:
        mi.load_dict(values)
    return str(caught.value)


class TestParameters:
    def test_three_ways(self, tmp_path: Path) -> None:
        text = (
            '<bsdf version="3.0.0" type="thinfilm" id="ar"><string name="back" value="N-BK7"/>'
            '<string name="layers" value="MgF2 99.64, 2.1 0.5w"/><float name="design_nm" value="500"/></bsdf>'
        )
        (tmp_path / "bsdf.xml").write_text(text, encoding="utf-8")
        made = [
            mi.load_string(text),
            mi.load_file(str(tmp_path / "bsdf.xml")),
            load(back="N-BK7", layers="MgF2 99.64, 2.1 0.5w", design_nm=500.0),
        ]
        assert {str(bsdf) for bsdf in made} == {"ThinFilm[air | N-BK7, MgF2 99.64, 2.1 119.048 nm, first outside]"}
        for bsdf in made:
            assert [layer.material for layer in bsdf.coating.layers] == ["MgF2", "2.1"]
            np.testing.assert_allclose([x.thickness_nm for x in bsdf.coating.layers], [99.64, 250 / 2.1], rtol=1e-7)

    def test_presets(self) -> None:
        bsdf = load(preset="bbar3", design_nm=600.0)
        for own, wanted in zip(bsdf.coating.layers, preset("bbar3", 600.0).layers, strict=True):
            assert own.material == wanted.material
            assert own.thickness_nm == pytest.approx(wanted.thickness_nm, rel=1e-7)  # parameters are float32
        mirror = load(preset="protected_al")
        assert mirror.opaque
        assert mirror.coating.opaque

    def test_constant_shares(self) -> None:
        bsdf = load(R=0.1, T=0.8)
        assert bsdf.ideal
        assert isinstance(bsdf.coating, Ideal)
        np.testing.assert_allclose([bsdf.coating.R, bsdf.coating.T], [0.1, 0.8], rtol=1e-7)
        assert load(R=0.1).opaque

    def test_files(self, tmp_path: Path) -> None:
        (tmp_path / "ar.csv").write_text("wavelength_nm,angle_deg,R,T\n550,0,.1,.9\n")
        assert load(table=str(tmp_path / "ar.csv")).film is None
        zemax = load(table=f"{SAMPLE}:AR2")
        np.testing.assert_allclose(np.array(zemax.thickness_nm), [99.8185, 0.5 * 550 / 2.05, 10.0], rtol=1e-6)
        assert not zemax.opaque
        mirror = load(table=f"{SAMPLE}:ALUM", opaque=True)
        assert mirror.opaque
        assert mirror.coating.layers[-1].thickness_nm > 500

    def test_files_lie_beside_the_scene(self, tmp_path: Path) -> None:
        (tmp_path / "glass.csv").write_text("wavelength_nm,n,k\n500,1.5,0\n600,1.5,0\n")
        (tmp_path / "c.dat").write_text("MATE L\n0.55 1.38 0\nCOAT AR\nL .25\n")
        (tmp_path / "scene.xml").write_text(
            '<scene version="3.0.0"><shape type="asphere"><float name="semi_diameter" value="1"/>'
            '<bsdf type="interface"><string name="back" value="glass.csv"/><bsdf type="thinfilm">'
            '<string name="layers" value="glass.csv 0.25w"/></bsdf></bsdf></shape>'
            '<shape type="asphere"><float name="semi_diameter" value="1"/><transform name="to_world">'
            '<translate z="1"/></transform><bsdf type="interface"><string name="front" value="glass.csv"/>'
            '<bsdf type="thinfilm"><string name="table" value="c.dat:AR"/></bsdf></bsdf></shape></scene>'
        )
        one, other = (shape.bsdf() for shape in mistray.load(tmp_path / "scene.xml").shapes())
        assert one.complex_indices(550.0) == (1 + 0j, 1.5 + 0j)
        assert one.coating.layers[0].thickness_nm == pytest.approx(0.25 * 550 / 1.5)
        assert other.coating.layers[0].index(550.0) == 1.38

    def test_shifts(self) -> None:
        bsdf = load(layers="1.38 100, 2.1 50", n_shift="0.01, -0.02", k_shift="0 0.001")
        np.testing.assert_allclose(bsdf.coating.indices(550.0), [1.39, 2.08 + 0.001j], rtol=1e-7)

    @pytest.mark.parametrize(
        ("first", "front", "back", "order"),
        [
            ("outside", "air", "1.5", [0, 1, 2]),
            ("outside", "1.5", "air", [2, 1, 0]),
            ("front", "1.5", "air", [0, 1, 2]),
            ("back", "air", "1.5", [2, 1, 0]),
        ],
    )
    def test_first(self, first: str, front: str, back: str, order: list[int]) -> None:
        bsdf = load(layers=STACK, first=first, front=front, back=back)
        assert bsdf.coating.front_to_back(550.0, *bsdf.complex_indices(550.0))[2].tolist() == order

    @pytest.mark.parametrize(
        ("values", "message"),
        [
            ({}, "thinfilm 'ar': it has no coating; give one of layers, preset, table, or R and T"),
            ({"layers": "1.38 10", "preset": "bbar3"}, "thinfilm 'ar': it has layers and preset; give one of"),
            ({"layers": "1.38 10", "R": 0.1}, "it has layers and R; give one of"),
            ({"layers": "1.38 10", "T": 0.1}, "it has layers and T; give one of"),
            ({"T": 0.1}, "it has T; give one of"),
            ({"R": 0.6, "T": 0.5}, "thinfilm 'ar': R = 0.6 and T = 0.5; both must lie in 0 … 1 and R + T must not"),
            ({"preset": "bbar9"}, "coating preset 'bbar9' is unknown; did you mean 'bbar4'?"),
            ({"layers": "MgF2"}, "coating 'ar', layer 1: 'MgF2' has no material and thickness"),
            ({"layers": "MgF2 -5"}, "coating 'ar', layer 1 (MgF2): thickness_nm is -5; it must lie"),
            ({"layers": "MgF 5"}, "coating 'ar', layer 1: material 'MgF' is unknown"),
            ({"layers": "nd=1.5 Vd=50 5"}, "coating 'ar', layer 1: material 'nd=1.5 Vd=50': k is unknown"),
            (
                {"layers": "N-BK7 0.25w", "design_nm": 9000.0},
                "coating 'ar', layer 1: material 'N-BK7': 9000 nm is outside",
            ),
            ({"layers": "1.38 5", "design_nm": 0.0}, "design_nm is 0; it must lie"),
            ({"layers": "1.38 5", "first": "top"}, "coating 'ar': first = 'top'; it is outside, front or back"),
            ({"layers": "1.38 5, 2 5", "n_shift": "0.1"}, "thinfilm 'ar': n_shift has 1 numbers for 2 layers"),
            ({"layers": "1.38 5", "k_shift": "none"}, "thinfilm 'ar': k_shift: could not convert string to float"),
            ({"layers": "1.38 5", "k_shift": "-0.1"}, "coating 'ar', layer 1 (1.38): n = 1.38, k = -0.1 at 550 nm"),
            ({"R": 0.1, "first": "front"}, "thinfilm 'ar': first has no meaning without layers; remove it"),
            ({"R": 0.1, "design_nm": 600.0}, "thinfilm 'ar': design_nm has no meaning without layers; remove it"),
            ({"table": "ar.xlsx"}, "coating 'ar.xlsx' is no file that mistray knows"),
            ({"table": "nowhere.dat:AR"}, "coating file 'nowhere.dat': No such file"),
            ({"layers": "1.38 5", "inner": {"type": "diffuse"}}, "thinfilm 'ar': a BSDF is nested in it"),
            ({"layers": "1.38 5", "thickness": 5.0}, "thickness"),
            ({"layers": "1.38 5", "back": "N-BK8"}, "material 'N-BK8' is unknown; did you mean N-BK7"),
        ],
    )
    def test_errors(self, values: dict[str, Any], message: str) -> None:
        assert message in why({"type": "thinfilm", "id": "ar", **values})

    @pytest.mark.parametrize(
        ("film", "values", "message"),
        [
            ({"preset": "bbar3"}, {"R": 0.1}, "give R or a nested thinfilm, not both"),
            ({"preset": "bbar3"}, {"table": "a.csv"}, "give table or a nested thinfilm, not both"),
            (
                {"preset": "bbar3", "back": "1.6"},
                {},
                "its thinfilm 'bbar3' has back as well; give back at the interface",
            ),
            ({"preset": "bbar3", "mirror": True}, {}, "has mirror as well"),
        ],
    )
    def test_errors_of_nesting(self, film: dict[str, Any], values: dict[str, Any], message: str) -> None:
        inner = {"type": "thinfilm", **film}
        assert message in why({"type": "interface", "id": "face", **values, "coating": inner})

    def test_only_one_thinfilm_can_be_nested(self) -> None:
        text = why({"type": "interface", "id": "face", "coating": {"type": "diffuse"}})
        assert "interface 'face': SmoothDiffuse nested; nest one 'thinfilm', its coating" in text
        film = {"type": "thinfilm", "preset": "bbar3"}
        assert "interface 'face': 2 BSDFs nested" in why({"type": "interface", "id": "face", "a": film, "b": film})


LENS = """<scene version="3.0.0">
  <integrator type="straylight"><integer name="rays" value="2000"/></integrator>
  <emitter type="collimated" id="beam"><float name="radius" value="2"/></emitter>
  <bsdf type="thinfilm" id="ar"><string name="preset" value="bbar3"/></bsdf>
  <shape type="asphere" id="front"><float name="semi_diameter" value="5"/>
    <bsdf type="interface"><string name="back" value="1.5168"/><ref id="ar"/></bsdf></shape>
  <shape type="asphere" id="rear"><float name="semi_diameter" value="5"/>
    <transform name="to_world"><translate z="4"/></transform>
    <bsdf type="interface"><string name="front" value="1.5168"/><ref id="ar"/></bsdf></shape>
  <shape type="asphere" id="filter"><float name="semi_diameter" value="5"/>
    <transform name="to_world"><translate z="8"/></transform>
    <bsdf type="interface"><bsdf type="thinfilm"><string name="layers" value="1.5+0.01i 100"/></bsdf></bsdf></shape>
  <shape type="asphere" id="split"><float name="semi_diameter" value="5"/>
    <transform name="to_world"><translate z="12"/></transform>
    <bsdf type="thinfilm"><float name="R" value="0.1"/><float name="T" value="0.8"/></bsdf></shape>
  <shape type="asphere" id="detector"><float name="semi_diameter" value="5"/>
    <transform name="to_world"><translate z="20"/></transform>
    <bsdf type="interface"><float name="R" value="0"/></bsdf>
    <sensor type="irradiancemeter"><film type="hdrfilm"><rfilter type="box"/></film></sensor></shape>
</scene>"""
KEYS = {
    *(f"ar.{name}" for name in ("thickness_nm", "n_shift", "k_shift")),
    *(f"filter.bsdf.coating.{name}" for name in ("thickness_nm", "n_shift", "k_shift")),
    *(f"split.bsdf.{name}" for name in ("R", "T")),
    *(f"detector.bsdf.{name}" for name in ("R", "T")),
}


@pytest.fixture
def scene() -> mi.Scene:
    return mi.load_string(LENS, optimize=False, parallel=False)


def bsdf_of(scene: mi.Scene, name: str) -> Any:
    return next(shape.bsdf() for shape in scene.shapes() if shape.id() == name)


class TestTraverse:
    def test_keys_and_flags(self, scene: mi.Scene) -> None:
        params = mi.traverse(scene)
        ours = {key for key in params.keys() if key.rsplit(".")[-1] in ("thickness_nm", "n_shift", "k_shift", "R", "T")}  # noqa: SIM118
        assert ours == KEYS
        for key in KEYS:
            assert not params.flags(key) & mi.ParamFlags.NonDifferentiable.value, key
        np.testing.assert_allclose(np.array(params["ar.thickness_nm"]), [99.63768, 130.95238, 84.355828], rtol=1e-6)

    def test_a_shared_coating_is_one_object(self, scene: mi.Scene) -> None:
        front, rear = bsdf_of(scene, "front"), bsdf_of(scene, "rear")
        assert front.film is rear.film
        params = mi.traverse(scene)
        params["ar.thickness_nm"] = mi.Float([10.0, 20.0, 30.0])
        params.update()
        for bsdf in (front, rear):
            assert [layer.thickness_nm for layer in bsdf.coating.layers] == [10.0, 20.0, 30.0]

    def test_film_owns_what_traverse_hands_out(self, scene: mi.Scene) -> None:
        params = mi.traverse(scene)
        film = bsdf_of(scene, "front").film
        dr.enable_grad(params["ar.n_shift"])
        params.update()
        assert dr.grad_enabled(film.n_shift)
        assert not dr.grad_enabled(film.thickness_nm)
        params["ar.n_shift"] = params["ar.n_shift"] + 0.01
        params.update()
        assert dr.grad_enabled(film.n_shift)
        assert bsdf_of(scene, "rear").coating.layers[0].n_shift == pytest.approx(0.01)

    def test_owners(self, scene: mi.Scene) -> None:
        assert bsdf_of(scene, "split").film is bsdf_of(scene, "split")
        assert bsdf_of(scene, "detector").film is bsdf_of(scene, "detector")
        assert bsdf_of(scene, "filter").film is not bsdf_of(scene, "filter")
        assert mi.load_dict({"type": "interface"}).film is None

    def test_nested_constant_shares(self) -> None:
        bsdf = nested({"R": 0.1, "T": 0.8})
        params = mi.traverse(bsdf)
        assert set(params.keys()) == {"coating.R", "coating.T", "n_front_shift", "n_back_shift"}
        assert bsdf.ideal
        params["coating.R"] = mi.Float(0.2)
        params.update()
        assert float(bsdf.R[0]) == pytest.approx(0.2)
        np.testing.assert_allclose(bsdf.coating.R, 0.2, rtol=1e-7)

    def test_the_trace_sees_an_update(self, scene: mi.Scene) -> None:
        """Normal incidence on the shared coating, on both faces: T² times the filter's and the splitter's."""
        settings = {"rays": 2000, "max_reflections": 0}
        params = mi.traverse(scene)

        def expected(thickness: list[float]) -> float:
            layers = list(zip((1.38, 2.10, 1.63), thickness, strict=True))
            index, size = [1, *(n for n, _ in layers), 1.5168], [np.inf, *(d for _, d in layers), np.inf]
            window = tmm.coh_tmm("s", index, size, 0, 550.0)["T"] ** 2
            return window * tmm.coh_tmm("s", [1, 1.5 + 0.01j, 1], [np.inf, 100, np.inf], 0, 550.0)["T"] * 0.8

        before = mistray.trace(scene, **settings)
        assert before.energy.detected_W / before.energy.launched_W == pytest.approx(
            expected([99.63768, 130.95238, 84.355828]), rel=2e-6
        )
        params["ar.thickness_nm"] = mi.Float([20.0, 60.0, 90.0])
        params.update()
        after = mistray.trace(scene, **settings)
        assert after.energy.detected_W / after.energy.launched_W == pytest.approx(expected([20, 60, 90]), rel=2e-6)

    @pytest.mark.parametrize(
        ("changes", "message"),
        [
            ({"ar.thickness_nm": [10.0, -1.0, 30.0]}, r"coating 'ar', layer 2 \(2.10\): thickness_nm is -1; it must"),
            ({"ar.k_shift": [0.0, 0.0, -0.1]}, r"coating 'ar', layer 3 \(1.63\): n = 1.63, k = -0.1 at 550 nm; n must"),
            ({"ar.n_shift": [-2.0, 0.0, 0.0]}, r"coating 'ar', layer 1 \(1.38\): n = -0.62, k = 0 at 550 nm"),
            ({"ar.n_shift": [float("nan")] * 3}, "n_shift is nan"),
            ({"ar.thickness_nm": [1.0, 2.0]}, "thinfilm 'ar': thickness_nm has 2 entries; it must have 3 as before"),
            ({"ar.k_shift": [0.1] * 4, "ar.n_shift": [0.1] * 3}, "k_shift has 4 entries; it must have 3"),
            ({"split.bsdf.R": [0.5]}, r"R = 0.5 and T = 0.8; both must lie in 0 … 1 and R \+ T must not exceed 1"),
            ({"split.bsdf.T": [-0.1]}, "R = 0.1 and T = -0.1"),
        ],
    )
    def test_impossible_updates_leave_everything(
        self, scene: mi.Scene, changes: dict[str, list[float]], message: str
    ) -> None:
        params = mi.traverse(scene)
        before = {key: np.array(params[key]).copy() for key in KEYS}
        coatings = [bsdf_of(scene, name).coating for name in ("front", "split")]
        for key, values in changes.items():
            params[key] = mi.Float(values)
        with pytest.raises(mistray.MistrayError, match=message) as caught:
            params.update()
        assert "\n" not in str(caught.value)
        for key, values in before.items():
            np.testing.assert_array_equal(np.array(params[key]), values, err_msg=key)
        assert [bsdf_of(scene, name).coating for name in ("front", "split")] == coatings
        params["ar.thickness_nm"] = mi.Float([10.0, 20.0, 30.0])
        params.update()
        assert bsdf_of(scene, "front").coating.layers[1].thickness_nm == 20.0


def by_tmm(n_in: complex, layers: list[tuple[complex, float]], n_out: complex, cosine: float) -> tuple[float, float]:
    """R and T of unpolarised light at 550 nm."""
    index, thickness = [n_in, *(n for n, _ in layers), n_out], [np.inf, *(d for _, d in layers), np.inf]
    both = [tmm.coh_tmm(pol, index, thickness, np.arccos(cosine), 550.0) for pol in "sp"]
    return float(np.mean([one["R"] for one in both])), float(np.mean([one["T"] for one in both]))


def surface(cosine: np.ndarray) -> mi.SurfaceInteraction3f:
    """Interactions at which light looks out along wi with these signed cosines to the normal."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(cosine))
    si.wi = mi.Vector3f(np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine]).astype(np.float32))
    return si


COSINES = np.concatenate([-np.linspace(0.02, 1, 40), np.linspace(0.02, 1, 40)])  # wi at -z is in front


class TestStockProtocol:
    """Under stock integrators: a delta BSDF whose R and T are those of `tmm`."""

    @pytest.fixture(params=["absorbing", "total reflection", "on metal", "mirror", "bare metal"])
    def case(self, request: pytest.FixtureRequest) -> tuple[Any, np.ndarray, np.ndarray]:
        """A BSDF and its R and T at `COSINES`."""
        front, back, layers, opaque = {
            "absorbing": (1.0, 1.7, LAYERS, False),
            "total reflection": (1.5168, 1.0, LAYERS[::-1], False),  # the first layer is outside, at the back
            "on metal": (1.0, 0.958 + 6.69j, [(1.6, 171.875)], True),
            "mirror": (1.0, 1.5168, [(1.6, 171.875), (0.958 + 6.69j, 150.0)], True),
            "bare metal": (1.0, 0.958 + 6.69j, [], True),
        }[request.param]
        media = {"front": _text(front), "back": _text(back)}
        text = ", ".join(f"{_text(n)} {d}" for n, d in (layers if front == 1.0 else layers[::-1]))
        if layers:
            bsdf = nested({"layers": text, "opaque": request.param == "mirror"}, **media)
        else:
            bsdf = mi.load_dict({"type": "interface", **media})
        r, t = np.zeros(len(COSINES)), np.zeros(len(COSINES))
        for k, cosine in enumerate(COSINES):
            if cosine < 0:
                r[k], t[k] = by_tmm(front, layers, back, -cosine)
            elif np.iscomplex(back):  # no ray comes from a metal
                r[k] = np.nan
            else:
                r[k], t[k] = by_tmm(back, layers[::-1], front, cosine)
        return bsdf, r, 0 * t if opaque else t

    @pytest.mark.parametrize("mode", [mi.TransportMode.Radiance, mi.TransportMode.Importance])
    def test_weights_and_probabilities(self, case: tuple[Any, np.ndarray, np.ndarray], mode: Any) -> None:
        bsdf, r, t = case
        known = np.isfinite(r)
        indices = [n.real for n in bsdf.complex_indices(550.0)]
        for u in (0.0, 0.9999999):
            sample, weight = bsdf.sample(mi.BSDFContext(mode), surface(COSINES), mi.Float(u), mi.Point2f(0.5))
            share = r / (r + t)
            reflected = u <= share
            pdf = np.where(reflected, share, 1 - share)
            lit = known & (pdf > 1e-6)
            # the table's error is 1e-6 of R and T, the rest float32
            np.testing.assert_allclose((np.array(sample.pdf) * (r + t))[lit], (pdf * (r + t))[lit], atol=4e-6)
            eta = np.where(COSINES < 0, indices[0] / indices[1], indices[1] / indices[0])
            scale = np.where(reflected | (mode == mi.TransportMode.Importance), 1.0, eta**2)
            np.testing.assert_allclose(np.array(weight)[0][lit], ((r + t) * scale)[lit], atol=1e-5)

    def test_frequencies(self, case: tuple[Any, np.ndarray, np.ndarray]) -> None:
        """
        χ² of the reflected and transmitted counts against R and T, with a false-alarm probability of 1e-3.

        A distribution in which 3 % of the reflected light were transmitted instead must fail.
        """
        bsdf, r, t = case
        counts = 40_000
        at = np.flatnonzero(np.isfinite(r) & (r + t > 0))[::4]
        share = (r / (r + t))[at]
        rng = np.random.default_rng(7)
        u = mi.Float(rng.random(counts * len(at)).astype(np.float32))
        si = surface(np.repeat(COSINES[at], counts))
        context = mi.BSDFContext(mi.TransportMode.Importance)
        sample, _ = bsdf.sample(context, si, u, mi.Point2f(0.5))
        kinds = np.array(sample.sampled_component).reshape(len(at), counts)
        reflected = (kinds == 0).sum(axis=1)

        def p_value(expected: np.ndarray) -> float:
            certain = np.minimum(expected, 1 - expected) * counts < 5  # too few for χ²
            wrong = np.abs(reflected - expected * counts)[certain]
            if np.any(wrong > 30):
                return 0.0
            e, n = expected[~certain], reflected[~certain]
            statistic = np.sum((n - counts * e) ** 2 / (counts * e * (1 - e)))
            return float(chi2.sf(statistic, max(len(e), 1)))

        assert p_value(share) > 1e-3
        assert p_value(0.97 * share) < 1e-3

    def test_masks(self, case: tuple[Any, np.ndarray, np.ndarray]) -> None:
        bsdf, r, t = case
        known = np.isfinite(r)
        parts = []
        for component, kind in enumerate((mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission)):
            for restrict in ("component", "type_mask"):
                context = mi.BSDFContext(mi.TransportMode.Importance)
                setattr(context, restrict, component if restrict == "component" else kind)
                sample, weight = bsdf.sample(context, surface(COSINES), mi.Float(0.5), mi.Point2f(0.5))
                weight = np.array(weight)[0]
                lit = known & (weight > 0)
                np.testing.assert_allclose(np.array(sample.pdf)[lit], 1.0)
                assert set(np.array(sample.sampled_component)[lit]) <= {component}
                np.testing.assert_allclose(weight[known], (t if component else r)[known], atol=1e-5)
            parts.append(weight)
        context = mi.BSDFContext(mi.TransportMode.Importance)
        both = np.array(bsdf.sample(context, surface(COSINES), mi.Float(0.5), mi.Point2f(0.5))[1])[0]
        np.testing.assert_allclose((parts[0] + parts[1])[known], both[known], atol=1e-6)

    def test_delta_lobes_have_no_density(self, case: tuple[Any, np.ndarray, np.ndarray]) -> None:
        bsdf, _, _ = case
        wo = mi.Vector3f(0, 0, 1)
        assert dr.all(bsdf.eval(mi.BSDFContext(), surface(COSINES), wo) == 0, axis=None)
        assert dr.all(bsdf.pdf(mi.BSDFContext(), surface(COSINES), wo) == 0, axis=None)
        value, pdf = bsdf.eval_pdf(mi.BSDFContext(), surface(COSINES), wo)
        assert dr.all(value == 0, axis=None)
        assert dr.all(pdf == 0, axis=None)
        assert bsdf.component_count() == 2
        _, weight = bsdf.sample(mi.BSDFContext(), surface(COSINES), mi.Float(0.5), mi.Point2f(0.5), mi.Mask(False))
        assert dr.all(weight == 0, axis=None)

    def test_an_update_changes_the_samples(self) -> None:
        """Also through an interface that Mitsuba does not tell about the change of its shared coating."""
        bsdf = nested({"layers": "1.38 99.6377", "id": "ar"})
        si, context = surface(np.array([-1.0])), mi.BSDFContext(mi.TransportMode.Importance)
        context.component = 0
        params = mi.traverse(bsdf)
        for thickness in (99.6377, 0.0, 50.0):
            params["coating.thickness_nm"] = mi.Float([thickness])
            params.update()
            weight = np.array(bsdf.sample(context, si, mi.Float(0.5), mi.Point2f(0.5))[1])[0, 0]
            assert weight == pytest.approx(by_tmm(1.0, [(1.38, thickness)], 1.5168, 1.0)[0], abs=2e-6)

    def test_glass_without_known_absorption_is_transparent_for_stock_integrators(self) -> None:
        bsdf = nested({"layers": "1.38 99.6"}, back="nd=1.5168 Vd=64.2")
        with pytest.raises(mistray.MistrayError, match="k is unknown"):
            bsdf.complex_indices(550.0)
        sample, _ = bsdf.sample(mi.BSDFContext(), surface(np.array([-1.0])), mi.Float(0.5), mi.Point2f(0.5))
        assert float(sample.pdf[0]) > 0.98


def _text(n: complex) -> str:
    n = complex(n)
    return f"{n.real:g}" if n.imag == 0 else f"{n.real:g}+{n.imag:g}i"


def test_coatings_of_equal_parameters_are_one_key() -> None:
    """The tables of the ray tree are cached by coating."""
    one, other = load(layers=STACK), load(layers=STACK)
    assert one.coating == other.coating
    assert hash(one.coating) == hash(other.coating)
    assert one.coating == Stack(tuple(Layer(_text(n), d) for n, d in LAYERS), name="ar")


class TestTrace:
    """The ray tree sees what the coating says."""

    @staticmethod
    def fold(bsdf: dict[str, Any]) -> mi.Scene:
        """A beam along z, a mirror at 30°, a detector in the reflected beam."""
        return mistray.load(
            {
                "type": "scene",
                "beam": {"type": "collimated", "radius": 2.0, "distance": 20.0},
                "mirror": {
                    "type": "asphere", "semi_diameter": 10.0, "to_world": T().rotate([1, 0, 0], 30.0), "bsdf": bsdf,
                },
                "detector": {
                    "type": "asphere", "semi_diameter": 10.0,
                    "to_world": T().rotate([1, 0, 0], 60.0).translate([0, 0, -30]),
                    "bsdf": {"type": "interface", "R": 0.0},
                    "sensor": {"type": "irradiancemeter", "film": {"type": "hdrfilm", "rfilter": {"type": "box"}}},
                },
            }
        )  # fmt: skip

    @pytest.mark.parametrize("alone", [True, False])
    def test_a_mirror(self, alone: bool) -> None:
        film = {"type": "thinfilm", "preset": "protected_ag"}
        bsdf = {**film, "mirror": True} if alone else {"type": "interface", "mirror": True, "coating": film}
        energy = mistray.trace(self.fold(bsdf), rays=1000, wavelength_nm=600.0).energy
        cosine = np.cos(np.radians([30.0]))
        expected = preset("protected_ag").response(600.0, 1 + 0j, 1 + 0j, cosine, True)
        assert energy.detected_W / energy.launched_W == pytest.approx(expected.R.mean(), rel=3e-6)
        assert energy.absorbed["mirror"][0] / energy.launched_W == pytest.approx(expected.A.mean(), abs=3e-6)

    def test_a_table_of_a_coating_traces_as_the_coating(self, tmp_path: Path) -> None:
        """Written with 1° steps, the table differs from its layers by the interpolation over the angle only."""
        from mistray.coatings import write_table

        layers = "2.1+0.3i 20, 1.46 90"
        film = {"type": "thinfilm", "layers": layers}
        write_table(load(layers=layers).coating, tmp_path / "t.csv", [550.0], np.arange(0.0, 90.5, 1.0), back="air")
        found = []
        for bsdf in (
            film,
            {"type": "thinfilm", "table": str(tmp_path / "t.csv")},
            {"type": "interface", "table": str(tmp_path / "t.csv")},
        ):
            energy = mistray.trace(self.fold({**bsdf, "mirror": True}), rays=1000, wavelength_nm=550.0).energy
            found.append(energy.detected_W / energy.launched_W)
        assert found[1] == found[2]
        assert found[0] == pytest.approx(found[1], rel=1e-5)

    def test_the_side_of_incidence_matters(self) -> None:
        """An absorbing film between equal media: from the other side it reflects another share."""
        bsdf = {"type": "thinfilm", "layers": "2.1+0.3i 20, 1.46 90", "mirror": True}
        found = [
            mistray.trace(self.fold({**bsdf, "first": first}), rays=1000, wavelength_nm=550.0).energy.detected_W
            for first in ("front", "outside", "back")
        ]
        assert found[0] == found[1]
        assert abs(found[0] / found[2] - 1) > 0.1

    def test_wavelength_out_of_range(self) -> None:
        scene = self.fold({"type": "thinfilm", "layers": "N-BK7 100", "mirror": True})
        with pytest.raises(mistray.MistrayError, match=r"layer 1: material 'N-BK7': 5000 nm is outside") as caught:
            mistray.trace(scene, rays=10, wavelength_nm=5000.0)
        assert "\n" not in str(caught.value)


class TestMessages:
    """A scene that cannot be loaded says in one line which coating is wrong."""

    @pytest.mark.parametrize(
        ("film", "words"),
        [
            ({"layers": "MgF 5"}, "thinfilm of interface of asphere 'L1': coating 'MgF 5', layer 1: material 'MgF' is"),
            ({"R": 0.6, "T": 0.6}, "thinfilm of interface of asphere 'L1': R = 0.6 and T = 0.6; both must lie"),
            ({}, "thinfilm of interface of asphere 'L1': it has no coating; give one of layers"),
            (
                {"layer": "1.38 4"},
                "unknown parameter 'layer' = 1.38 4 of thinfilm of interface of asphere 'L1'; did you",
            ),
            ({"table": "c.dat:AR"}, "coating file 'c.dat': No such file"),
        ],
    )
    def test_nested(self, film: dict[str, Any], words: str) -> None:
        bsdf = {"type": "interface", "coating": {"type": "thinfilm", **film}}
        with pytest.raises(mistray.MistrayError) as caught:
            mistray.load({"type": "scene", "L1": {"type": "asphere", "semi_diameter": 1.0, "bsdf": bsdf}})
        assert words in str(caught.value)
        assert "\n" not in str(caught.value)
