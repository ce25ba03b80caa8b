"""`interface` as a Mitsuba BSDF: its parameters and errors, and what stock integrators get from it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.interface import Interface as Oracle
from oracles.interface import interact

import mistray

pytestmark = pytest.mark.quick

TABLE = "wavelength_nm,angle_deg,R,T,R_back\n550,0,.1,.8,.15\n550,45,.2,.6,.25\n550,90,.9,.05,.9\n"


def why(values: dict[str, Any]) -> str:
    with pytest.raises((mistray.MistrayError, RuntimeError)) as caught:
        mi.load_dict({"type": "interface", "id": "coat", **values})
    return str(caught.value)


class TestParameters:
    def test_three_ways(self, tmp_path: Path) -> None:
        text = (
            '<bsdf version="3.0.0" type="interface" id="coat"><string name="back" value="N-BK7"/>'
            '<float name="R" value="0.1"/><float name="T" value="0.8"/></bsdf>'
        )
        (tmp_path / "bsdf.xml").write_text(text, encoding="utf-8")
        made = [
            mi.load_string(text),
            mi.load_file(str(tmp_path / "bsdf.xml")),
            mi.load_dict({"type": "interface", "id": "coat", "back": "N-BK7", "R": 0.1, "T": 0.8}),
        ]
        assert {str(bsdf) for bsdf in made} == {"Interface[air | N-BK7, R = 0.1, T = 0.8]"}
        for bsdf in made:
            assert not bsdf.opaque
            assert bsdf.indices(587.5618) == pytest.approx((1.0, 1.5168), abs=1e-5)

    def test_defaults(self) -> None:
        bsdf = mi.load_dict({"type": "interface"})
        assert (bsdf.front, bsdf.back, bsdf.mirror, bsdf.ideal, bsdf.opaque) == ("air", "air", False, False, False)
        assert str(bsdf) == "Interface[air | air, Fresnel]"
        assert mi.load_dict({"type": "interface", "R": 0.3}).opaque
        assert "mirror" in str(mi.load_dict({"type": "interface", "R": 0.9, "mirror": True}))

    @pytest.mark.parametrize(
        ("values", "message"),
        [
            ({"R": 0.6, "T": 0.5}, "interface 'coat': R = 0.6 and T = 0.5; both must lie in 0 … 1 and R + T must not"),
            ({"R": -0.1}, "R is -0.1; it must"),
            ({"R": float("nan")}, "R is nan; it must"),
            ({"T": 0.5}, "interface 'coat': T is given without R; give both"),
            ({"R": 0.1, "table": "x.csv"}, "interface 'coat': give R and T or table, not both"),
            ({"back": "N-BK8"}, "material 'N-BK8' is unknown; did you mean N-BK7"),
            ({"front": "0.7"}, "index 0.7"),
            ({"table": "nowhere.csv"}, "coating table 'nowhere.csv': No such file"),
            ({"wavelength_nm": 0.0}, "wavelength_nm is 0; it must lie"),
        ],
    )
    def test_errors(self, values: dict[str, Any], message: str) -> None:
        assert message in why(values)

    def test_unknown_parameter(self) -> None:
        assert "reflectance" in why({"reflectance": 0.1})

    def test_traverse(self) -> None:
        params = mi.traverse(mi.load_dict({"type": "interface", "R": 0.1, "T": 0.8}))
        assert set(params.keys()) == {"R", "T", "n_front_shift", "n_back_shift"}
        bare = mi.traverse(mi.load_dict({"type": "interface", "back": "1.5"}))
        assert set(bare.keys()) == {"n_front_shift", "n_back_shift"}

    def test_update_changes_the_trace(self) -> None:
        scene = mistray.load("phone_camera")
        params = mi.traverse(scene)
        key = next(k for k in params.keys() if k.startswith("window_front") and k.endswith(".R"))  # noqa: SIM118
        before = mistray.trace(scene, rays=2000, max_reflections=0)
        params[key], params[key[:-1] + "T"] = mi.Float(0.3), mi.Float(0.6)
        params.update()
        after = mistray.trace(scene, rays=2000, max_reflections=0)
        ratio = after.paths[0].power_W / before.paths[0].power_W
        assert ratio == pytest.approx(0.6 / 0.99, rel=1e-6)
        assert after.energy.absorbed["window_front"][0] == pytest.approx(0.1 * after.energy.launched_W, rel=1e-5)

    def test_bad_update_leaves_everything(self) -> None:
        bsdf = mi.load_dict({"type": "interface", "id": "coat", "R": 0.1, "T": 0.8})
        params = mi.traverse(bsdf)
        params["R"] = mi.Float(0.5)
        with pytest.raises(mistray.MistrayError, match=r"interface 'coat': R = 0.5 and T = 0.8"):
            params.update()
        assert str(bsdf) == "Interface[air | air, R = 0.1, T = 0.8]"
        params["R"], params["T"] = mi.Float(0.5), mi.Float(0.5)
        params.update()
        assert str(bsdf) == "Interface[air | air, R = 0.5, T = 0.5]"


class TestStockProtocol:
    """Delta lobes against the oracle: directions, weights, probabilities, masks."""

    @pytest.fixture(params=["bare", "ideal", "opaque", "tabled"])
    def pair(self, request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Any, Oracle]:
        from oracles.interface import CoatingTable

        table = tmp_path / "coating.csv"
        table.write_text(TABLE, encoding="utf-8")
        media = {"front": "1.2", "back": "1.7"}
        own: dict[str, tuple[dict[str, Any], Oracle]] = {
            "bare": ({}, Oracle("1.2", "1.7")),
            "ideal": ({"R": 0.3, "T": 0.5}, Oracle("1.2", "1.7", 0.3, 0.5)),
            "opaque": ({"R": 0.4}, Oracle("1.2", "1.7", 0.4, 0.0)),
            "tabled": ({"table": str(table)}, Oracle("1.2", "1.7", table=CoatingTable.read(table))),
        }
        values, oracle = own[request.param]
        return mi.load_dict({"type": "interface", **media, **values}), oracle

    @staticmethod
    def surface(cosine: np.ndarray) -> mi.SurfaceInteraction3f:
        """Interactions at which light looks out along wi with these signed cosines to the normal."""
        si = dr.zeros(mi.SurfaceInteraction3f, len(cosine))
        sine = np.sqrt(1 - cosine**2)
        phi = np.linspace(0, 5, len(cosine))
        si.wi = mi.Vector3f(np.stack([sine * np.cos(phi), sine * np.sin(phi), cosine]).astype(np.float32))
        return si

    def test_sample(self, pair: tuple[Any, Oracle]) -> None:
        bsdf, oracle = pair
        # a table between its nodes is linear in the cosine here and in the angle there: only its nodes are compared
        n = 41
        cosine = np.linspace(-0.995, 0.995, n)
        cosine = cosine[np.abs(cosine) > 0.02]
        if oracle.table is not None:
            rare = np.cos(np.radians([0.0, 45.0]))
            dense = np.sqrt(1 - (1.2 / 1.7) ** 2 * (1 - rare**2))
            cosine = np.concatenate([-rare, dense])  # wi at -z is in front (rarer), at +z behind
        si = self.surface(cosine)
        wi = np.array(si.wi, dtype=float).T
        out = interact(oracle, 1.2, 1.7, 550.0, -wi, np.tile([0.0, 0.0, 1.0], (len(wi), 1)))
        total = out.reflectance + out.transmittance
        for mode in (mi.TransportMode.Radiance, mi.TransportMode.Importance):
            context = mi.BSDFContext(mode)
            for u in (0.0, 0.999999):
                sample, weight = bsdf.sample(context, si, mi.Float(u), mi.Point2f(0.5))
                share = out.reflectance / np.maximum(total, 1e-30)
                reflected = (u <= share) & (total > 0)
                pdf = np.where(reflected, share, 1 - share)
                ok = pdf > 1e-9
                np.testing.assert_allclose(np.array(sample.pdf)[ok], pdf[ok], atol=1e-4)
                wo = np.where(reflected[:, None], out.reflected, out.transmitted)
                np.testing.assert_allclose(np.array(sample.wo).T[ok], wo[ok], atol=3e-6)
                eta = np.where(out.from_front, 1.2 / 1.7, 1.7 / 1.2)
                scale = np.where(reflected | (mode == mi.TransportMode.Importance), 1.0, eta**2)
                np.testing.assert_allclose(np.array(weight)[0][ok], (total * scale)[ok], rtol=3e-4)
                kind = np.array(sample.sampled_type)[ok]
                assert set(kind[reflected[ok]]) <= {int(mi.BSDFFlags.DeltaReflection)}
                assert set(kind[~reflected[ok]]) <= {int(mi.BSDFFlags.DeltaTransmission)}
                np.testing.assert_allclose(np.array(sample.eta)[ok], np.where(reflected, 1, 1 / eta)[ok], rtol=1e-6)

    def test_masks(self, pair: tuple[Any, Oracle]) -> None:
        bsdf, _ = pair
        si = self.surface(np.array([-0.9, 0.9]))
        shares = []
        for component in (0, 1):
            context = mi.BSDFContext()
            context.component = component
            context.type_mask = mi.BSDFFlags.DeltaReflection if component == 0 else mi.BSDFFlags.DeltaTransmission
            sample, weight = bsdf.sample(context, si, mi.Float(0.5), mi.Point2f(0.5))
            lit = np.array(weight)[0] > 0
            assert set(np.array(sample.sampled_component)[lit]) <= {component}
            np.testing.assert_allclose(np.array(sample.pdf)[lit], 1.0)
            eta2 = np.array([(1.2 / 1.7) ** 2, (1.7 / 1.2) ** 2]) if component else 1.0
            shares.append(np.array(weight)[0] / eta2)
        importance = mi.BSDFContext(mi.TransportMode.Importance)
        both = np.array(bsdf.sample(importance, si, mi.Float(0.5), mi.Point2f(0.5))[1])[0]
        np.testing.assert_allclose(sum(shares), both, rtol=1e-5)

    def test_delta_lobes_have_no_density(self, pair: tuple[Any, Oracle]) -> None:
        bsdf, _ = pair
        si = self.surface(np.array([0.5, -0.5]))
        wo = mi.Vector3f(0, 0, 1)
        assert dr.all(bsdf.eval(mi.BSDFContext(), si, wo) == 0, axis=None)
        assert dr.all(bsdf.pdf(mi.BSDFContext(), si, wo) == 0, axis=None)
        value, pdf = bsdf.eval_pdf(mi.BSDFContext(), si, wo)
        assert dr.all(value == 0, axis=None)
        assert dr.all(pdf == 0, axis=None)
        assert bsdf.component_count() == 2
        assert bsdf.flags() & mi.BSDFFlags.DeltaReflection.value
        assert bsdf.flags() & mi.BSDFFlags.DeltaTransmission.value

    def test_inactive_lanes(self, pair: tuple[Any, Oracle]) -> None:
        bsdf, _ = pair
        si = self.surface(np.array([0.5, -0.5]))
        _, weight = bsdf.sample(mi.BSDFContext(), si, mi.Float(0.5), mi.Point2f(0.5), mi.Mask(False))
        assert dr.all(weight == 0, axis=None)
