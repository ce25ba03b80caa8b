"""Hits close to rims: which are written down, what the metric gains from them, rays that go on from within a tree."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.scatter_scenes import placed_xml, wall_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml
from recorded_edges import backward_edges, traced_edges

import mistray
from mistray.errors import MistrayError
from mistray.events import EVENT_BITS
from mistray.execute.backward import BackwardTrace
from mistray.execute.tracer import Run, prepare
from mistray.gradients import edges
from mistray.gradients.edge_contacts import EdgeContacts
from mistray.gradients.rims import RimRecorder
from mistray.kernel.ray_tree import trace_tree
from mistray.light import Light
from mistray.optimize import path_power
from mistray.recorders.adjoint import Adjoint
from mistray.recorders.direction_recorder import CLASS_COUNT
from mistray.recorders.directions import DirectionGrid
from mistray.recorders.start_rays import StartRays
from mistray.settings import Settings
from mistray.surfaces.gradient_columns import HALF_WIDTH, HIGH, INNER, LOW, OUTER
from mistray.surfaces.upload import upload

ROUNDING = 1e-5  # of a sum of float32 weights


def executed(scene: Any, field_deg: float = 0.0, **settings: Any) -> Run:
    (run,) = prepare(scene, Settings.of(scene, **settings), Light(field_deg))
    run.execute(ledger=True, progress=None)
    return run


def random_metric(run: Run) -> Adjoint:
    """A metric with another derivative for each path and place."""
    assert run.ledger is not None
    coefficients = np.random.default_rng(0).normal(size=(run.ledger.capacity, 6)) * [1, 0.3, 0.3, 0.1, 0.1, 0.1]
    return Adjoint(0, run.make_film(), path=upload(mi.Float64, coefficients), ledger=run.ledger)


def walked(run: Run, start: StartRays, adjoint: Adjoint, rims: RimRecorder | None = None) -> np.ndarray:
    trace_tree(run.scene, start, run.settings, [rims, adjoint])
    dr.eval(adjoint.gain)
    dr.sync_thread()
    return np.array(adjoint.gain)


def read(book: RimRecorder) -> dict[str, np.ndarray]:
    """The book on the host."""
    n, paths = int(book.paths.count[0]), book.paths
    assert n <= paths.capacity
    rows = np.arange(n)
    length = np.array(paths.length)[:n]
    codes = np.array(paths.codes).reshape(paths.capacity, -1)[:n]
    points = np.array(paths.nodes).reshape(paths.capacity, paths.max_events, 3)[:n]
    return {
        "surface": codes[rows, length - 1] >> EVENT_BITS,
        "length": length,
        "lane": np.array(paths.lane)[:n],
        "p": points[rows, length - 1].astype(np.float64),
        "d": np.array(paths.heading).reshape(-1, 3)[:n],
        "w": np.array(paths.weight)[:n],
        "rim": np.array(book.columns["rim"])[:n],
        "delta": np.array(book.columns["delta"])[:n],
        "copies": np.array(book.columns["copies"])[:n],
        "gain": np.array(book.columns["gain"])[:n],
        **{name: np.array(values)[:n] for name, values in book.before.items()},
    }


def going_on(found: dict[str, np.ndarray], rng: mi.PCG32) -> StartRays:
    """Rays that have just arrived at the hits of a book."""
    before = {name: found[name] for name in ("depth", "medium", "reflections", "scatters", "aimed_from", "batch")}
    o, d = (mi.Vector3f(*found[name].astype(np.float32).T) for name in ("p", "d"))
    return StartRays(
        lane=mi.UInt32(found["lane"]),
        rng=rng,
        o=o,
        d=d,
        w=mi.Float(found["w"].astype(np.float32)),
        key=mi.UInt64(found["key"]),
        reference=mi.Float(found["reference"]),
        at=mi.UInt32(found["surface"].astype(np.uint32)),
        **{name: mi.UInt32(values.astype(np.uint32)) for name, values in before.items()},
    )


class TestRimRecorder:
    def test_hits_of_the_zones(self, load_scene) -> None:
        """All hits of a rectangle and of an annulus within their zones, none else, with their distances."""
        half = interface_xml(R=0.0, T=0.5)
        text = scene_text(
            shape_xml("asphere", "ring", 5.0, half, semi_diameter=4.0, inner_semi_diameter=1.0),
            shape_xml("asphere", "detector", 10.0, sensor=True, half_width=3.0, half_height=2.0),
            radius=5.0,
        )
        run = executed(load_scene(text), rays=20_000)
        book = RimRecorder(run.table, 0.05, 1 << 14, run.settings.max_events)
        start = run.start_pass(0)
        walked(run, start, random_metric(run), book)
        found = read(book)
        ring, plate = (run.table.ids.index(name) for name in ("ring", "detector"))
        x, y = np.array(start.o)[:2].astype(np.float64)  # the beam is parallel to the axis
        rho = np.hypot(x, y)
        lit = (np.abs(x) <= 3) & (np.abs(y) <= 2)
        for surface, rim, delta, zone in (
            (ring, 0, np.where(rho <= 4, 4 - rho, np.inf), 0.2),
            (ring, 1, np.where(rho >= 1, rho - 1, np.inf), 0.05),
            (plate, 2, np.where(lit, 3 - np.abs(x), np.inf), 0.15),
            (plate, 3, np.where(lit, 2 - np.abs(y), np.inf), 0.10),
        ):
            mine = (found["surface"] == surface) & (found["rim"] == rim)
            np.testing.assert_allclose(found["delta"][mine], delta[found["lane"][mine]], atol=2e-6)
            in_both = lit & (3 - np.abs(x) < 0.15) & (2 - np.abs(y) < 0.10)
            expected = np.flatnonzero((delta < zone - 2e-6) & ~(in_both & (surface == plate)))
            single = found["lane"][mine & (found["copies"] == 1)]
            assert set(expected) <= set(single)
            assert np.all(delta[single] < zone + 2e-6)
            assert len(single) == len(set(single))
        corners = np.flatnonzero(lit & (3 - np.abs(x) < 0.15) & (2 - np.abs(y) < 0.10))
        double = found["copies"] == 2
        assert set(found["lane"][double]) == set(corners)
        # One of the two by the toss of a coin: 6 standard deviations
        first = np.sum(found["rim"][double] == 2)
        assert abs(first - len(corners) / 2) < 3 * np.sqrt(len(corners))
        assert np.all(found["surface"][double] == plate)

    def test_zones_do_not_overlap(self, load_scene) -> None:
        text = scene_text(
            shape_xml("frustum", "narrow", 5.0, r0=3.0, z0=0.0, r1=3.1, z1=0.0),
            shape_xml("frustum", "short", 6.0, r0=3.0, z0=0.0, r1=2.0, z1=0.1),
            shape_xml("frustum", "tip", 7.0, r0=0.0, z0=0.0, r1=2.0, z1=9.0),
            shape_xml("asphere", "detector", 20.0, sensor=True, semi_diameter=3.0),
        )
        pieces = {p.index: p.zone_widths(0.1) for p in executed(load_scene(text), rays=32).table.pieces}
        detector, narrow, short, tip = (pieces[k] for k in range(4))
        assert detector == pytest.approx({OUTER: 0.3})
        assert narrow == pytest.approx({OUTER: 0.05, INNER: 0.05})
        assert short == pytest.approx({LOW: 0.05, HIGH: 0.05})
        assert tip == pytest.approx({HIGH: 0.2})

    @pytest.mark.parametrize("name", ["cooke_triplet", "double_gauss"])
    def test_gain_of_a_hit_is_that_of_the_rays_that_go_on_from_it(self, name: str) -> None:
        """
        Rays that start at the recorded hits, with all that was before, meet the same paths with the same flux.

        A few may pass a rim differently, because their points are rounded.
        """
        run = executed(mistray.load(name), 10.0, rays=3000)
        adjoint = random_metric(run)
        book = RimRecorder(run.table, 0.03, 1 << 14, run.settings.max_events)
        whole = walked(run, run.start_pass(0), adjoint, book)
        found = read(book)
        assert np.sum(found["length"] > 3) > 200
        first = (found["length"] == 1) & (found["copies"] == 1)
        np.testing.assert_allclose(found["gain"][first], whole[found["lane"][first]], rtol=1e-12)
        rng = mi.PCG32(size=len(found["w"]))
        gain = walked(run, going_on(found, rng), adjoint)
        scale = np.abs(found["gain"]) + ROUNDING * found["w"]
        same = np.abs(gain - found["gain"]) < 1e-3 * scale
        assert np.mean(same) > 0.99
        assert np.median(np.abs(gain - found["gain"]) / scale) < ROUNDING
        for wrong in ({"key": found["key"] + 1}, {"reflections": found["reflections"] + 1}):
            other = walked(run, going_on(found | wrong, mi.PCG32(size=len(found["w"]))), adjoint)
            assert np.mean((np.abs(other - found["gain"]) < 1e-3 * scale)[found["gain"] != 0]) < 0.9


def contact(table: Any, name: str, rim: int, at: Sequence[float], d: Sequence[float]) -> tuple[str | None, float, bool]:
    """What a ray along d meets beside the edge next to a point of the world: surface, factor, whether it is joined."""
    contacts, s = EdgeContacts(table), table.ids.index(name)
    p = mi.Vector3f(*(np.array(at, dtype=np.float64) - table.centre).tolist())
    along = mi.Vector3f(*(np.array(d) / np.linalg.norm(d)).tolist())
    corner, _ = contacts.past(mi.UInt32(s), mi.UInt32(rim), p, along, mi.Bool(False), mi.Bool(True))
    met = int(corner.at[0])
    return (
        table.ids[met] if met < table.count else None,
        float(corner.factor[0]),
        int(corner.joined[0]) < table.count,
    )


class TestContacts:
    def table(self, load_scene: Any) -> Any:
        text = scene_text(
            shape_xml("frustum", "front", 5.0, r0=3.0, z0=0.0, r1=10.0, z1=0.0),
            shape_xml("frustum", "land", 5.0, r0=3.0, z0=0.0, r1=3.0, z1=2.0),
            shape_xml("frustum", "tube", 0.0, r0=10.0, z0=0.0, r1=10.0, z1=20.0),
            shape_xml("frustum", "cone", 0.0, r0=10.0, z0=20.0, r1=9.0, z1=21.0),
            shape_xml("asphere", "lens", 8.0, curvature=-0.02, semi_diameter=10.0),
            shape_xml("asphere", "detector", 30.0, sensor=True, semi_diameter=10.001),
        )
        return executed(load_scene(text), rays=32).table

    def test_what_touches_what(self, load_scene) -> None:
        """Where both surfaces end, each counts half; beside a concave edge the other surface says where it is."""
        table = self.table(load_scene)

        def met(name: str, rim: int, at: Sequence[float], d: Sequence[float]) -> tuple[str | None, float, bool]:
            return contact(table, name, rim, at, d)

        assert met("front", INNER, (3.1, 0.0, 5.0), (-0.5, 0.0, 1.0)) == (None, 1.0, False)  # away from the land
        assert met("front", INNER, (3.1, 0.0, 5.0), (0.5, 0.0, 1.0)) == ("land", 0.5, False)
        assert met("land", LOW, (0.0, 3.0, 5.1), (0.0, 0.5, 1.0)) == ("front", 0.5, False)
        assert met("land", HIGH, (0.0, 3.0, 6.9), (0.0, 0.5, 1.0)) == (None, 1.0, False)
        assert met("front", OUTER, (0.0, 9.9, 5.0), (0.0, 0.5, 1.0)) == ("tube", pytest.approx(-1.0), True)
        assert met("front", OUTER, (0.0, 9.9, 5.0), (0.0, -0.5, 1.0)) == (None, 0.0, True)  # has come from the tube
        lens = met("lens", OUTER, (9.9, 0.0, 8.0 - 0.01 * 9.9**2), (0.5, 0.0, 1.0))
        assert lens[0] == "tube"
        assert lens[2]
        assert met("tube", HIGH, (10.0, 0.0, 19.9), (0.1, 0.0, 1.0)) == ("cone", pytest.approx(-0.5 * 2**0.5), True)
        assert met("tube", LOW, (10.0, 0.0, 0.1), (0.5, 0.0, -1.0)) == (None, 1.0, False)
        assert met("cone", HIGH, (9.05, 0.0, 20.95), (0.1, 0.0, 1.0)) == (None, 1.0, False)
        assert met("detector", OUTER, (9.9, 0.0, 30.0), (0.5, 0.0, 1.0)) == (None, 1.0, False)

    def test_a_shifted_circle_touches_where_it_does(self, load_scene) -> None:
        """A disc within a tube of twice its radius that touches it on one side, if at all: a point, and no edge."""
        moved = '<transform name="to_world"><translate x="5.0" z="5.0"/></transform>'
        disc = shape_xml("frustum", "disc", 5.0, r0=1.0, z0=0.0, r1=5.0, z1=0.0)
        disc = disc.replace('<transform name="to_world"><translate z="5.0"/></transform>', moved)
        tube = shape_xml("frustum", "tube", 0.0, r0=10.0, z0=0.0, r1=10.0, z1=20.0)
        text = scene_text(disc, tube, shape_xml("asphere", "detector", 30.0, sensor=True, semi_diameter=3.0))
        table = executed(load_scene(text), rays=32).table
        for turn in (0.3, 1.0, 3.0):
            at = (5.0 + 4.9 * np.cos(turn), 4.9 * np.sin(turn), 5.0)
            assert contact(table, "disc", OUTER, at, (np.cos(turn), np.sin(turn), 2.0)) == (None, 1.0, False)

    def test_part_of_a_side(self, load_scene) -> None:
        """A small black square stands with its side on the middle of the side of a large one."""
        large = placed_xml(
            "asphere", "large", at=(0.0, 0.0, 5.0), facing=(0.0, 0.0, 1.0), half_width=4.0, half_height=4.0
        )
        small = placed_xml(
            "asphere", "small", at=(4.0, 0.5, 7.0), facing=(1.0, 0.0, 0.0), half_width=2.0, half_height=2.0
        )
        text = scene_text(large, small, shape_xml("asphere", "detector", 30.0, sensor=True, semi_diameter=3.0))
        table = executed(load_scene(text), rays=32).table
        for y, d, expected in (
            (1.0, (-0.5, 0.0, 1.0), ("small", 0.5, False)),
            (-1.0, (-0.5, 0.0, 1.0), ("small", 0.5, False)),
            (3.0, (-0.5, 0.0, 1.0), (None, 1.0, False)),  # beyond the end of the small one
            (1.0, (0.5, 0.0, 1.0), (None, 1.0, False)),
        ):
            assert contact(table, "large", HALF_WIDTH, (3.9, y, 5.0), d) == expected, y


class TestPortions:
    TEXT = scene_text(
        shape_xml("frustum", "stop", 5.0, wall_xml(0.5), r0=3.0, z0=0.0, r1=8.0, z1=0.0),
        shape_xml("frustum", "tube", 5.0, wall_xml(0.5), r0=8.0, z0=0.0, r1=8.0, z1=20.0),
        shape_xml("asphere", "detector", 25.0, sensor=True, semi_diameter=6.0),
        radius=5.0,
    )

    def coefficients(self, load_scene: Any, **arguments: Any) -> tuple[np.ndarray, np.ndarray]:
        _, groups = traced_edges(load_scene(self.TEXT), 0.1, rays=30_000, **arguments)
        return np.concatenate([g.c for g in groups], axis=1), np.concatenate([g.batch for g in groups])

    def test_small_portions_find_the_same_hits(self, load_scene, monkeypatch) -> None:
        """The order of hits changes from run to run and with the portions; the hits and their coefficients do not."""
        whole, _ = self.coefficients(load_scene)
        for name, value in (("CAPACITY", 200), ("FIRST_LANES", 3000)):
            monkeypatch.setattr(edges, name, value)
        parts, _ = self.coefficients(load_scene)
        assert whole.shape == parts.shape
        assert whole.shape[1] > 1000
        for a, b in zip(whole, parts, strict=True):
            np.testing.assert_allclose(np.sort(a), np.sort(b), rtol=1e-6, atol=1e-9)

    def test_scattered_rays_past_a_rim_do_not_depend_on_the_order(self, load_scene, monkeypatch) -> None:
        """Random numbers go with the hit: twice the same, and in portions of another size."""
        text = scene_text(
            shape_xml("frustum", "tube", 0.0, wall_xml(0.6), r0=15.0, z0=0.0, r1=15.0, z1=40.0),
            shape_xml("frustum", "vane", 20.0, r0=6.0, z0=0.0, r1=15.0, z1=0.0),
            shape_xml("frustum", "detector", 40.0, sensor=True, r0=0.0, z0=0.0, r1=5.0, z1=0.0),
        )
        trace = BackwardTrace(load_scene(text), DirectionGrid.of([45.0], cell_deg=90.0), Settings(max_scatters=3))
        trace.advance(20_000)
        found = []
        for capacity in (edges.CAPACITY, edges.CAPACITY, 500):
            monkeypatch.setattr(edges, "CAPACITY", capacity)
            groups = backward_edges(trace, np.full((CLASS_COUNT, 1, 1), 1.0), 0.1)
            found.append(np.sort(np.concatenate([hits.c[0] for hits in groups])))
        assert len(found[0]) > 1000
        for other in found[1:]:
            np.testing.assert_allclose(other, found[0], rtol=1e-9, atol=1e-12)

    def test_a_ray_with_more_hits_than_can_be_kept(self, load_scene, monkeypatch) -> None:
        half = interface_xml(R=0.0, T=0.5)
        plates = [shape_xml("asphere", f"plate_{z}", float(z), half, semi_diameter=1.0) for z in (3, 4)]
        text = scene_text(*plates, shape_xml("asphere", "detector", 5.0, sensor=True, semi_diameter=1.0), radius=1.0)
        monkeypatch.setattr(edges, "CAPACITY", 2)
        with pytest.raises(MistrayError, match="a single start ray hits 3 times close to a rim, more than 2"):
            traced_edges(load_scene(text), 0.5, rays=32)

    def test_a_metric_that_gains_nothing(self, load_scene) -> None:
        _, groups = traced_edges(load_scene(self.TEXT), 0.1, pixel=0.0, rays=1000)
        assert groups == []


def test_the_kernel_has_unit_area_and_no_first_moment() -> None:
    x = np.linspace(0.0, 0.4, 40_001)
    k = np.array(edges.kernel(mi.Float64(x), mi.Float64(0.3)))
    assert np.trapezoid(k, x) == pytest.approx(1.0, rel=1e-4)
    assert np.trapezoid(k * x, x) == pytest.approx(0.0, abs=1e-4)
    assert np.all(k[x > 0.3] == 0)


def test_the_rim_of_a_hemisphere(load_scene) -> None:
    """It stands upright there, so that no distance across grows along it: 4 standard errors, false alarm 4e-4."""
    half = interface_xml(R=0.0, T=0.5)
    dome = shape_xml("asphere", "dome", 5.0, half, curvature=0.2, semi_diameter=5.0)
    detector = shape_xml("asphere", "detector", 30.0, sensor=True, semi_diameter=20.0)
    scene = load_scene(scene_text(dome, detector, radius=9.0))
    found = mistray.gradient(path_power(scene, "all", rays=30_000), mi.traverse(scene), keys=["dome.semi_diameter"])
    value, error = (float(v["dome.semi_diameter"][0]) for v in (found.gradient, found.standard_error))
    assert error < 0.01
    assert abs(value + 0.5 * 2 * 5 / 81) < 4 * error
