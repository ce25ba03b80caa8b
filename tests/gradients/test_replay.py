"""Every path of every scene in scenes/ against two float64 tracers: one replays events, the other finds all paths."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from oracles import nonsequential, scene_xml
from oracles.replay import replay
from tiers import slow_unless

import mistray
from mistray.events import EVENT_BITS, EVENT_MASK, INTERCEPTS
from mistray.scatter.kinds import KINDS
from mistray.trace.host.retrace import retrace

ROOT = Path(__file__).parents[2]
NUDGE = 1e-5
ROUNDING = 1e-6
REPLAYED = 8  # rays of each path that are replayed one event after the other
# scene → (field_deg, rays), in the field and outside of it; every scene not named here is traced at FIELDS
FIELDS = [(0.0, 300), (0.4, 300), (9.0, 300)]
SCENE_FIELDS = {
    "cooke_triplet": [(0.0, 300), (14.0, 300), (32.0, 300)],
    "double_gauss": [(0.0, 300), (14.0, 300), (30.0, 300)],
    "phone_camera": [(0.0, 60), (16.0, 60), (27.0, 60)],
    "rubin": [(1.0, 40)],  # the oracle takes a second for ten rays through its figure errors
    "offner_relay": [(0.0, 300), (0.4, 300), (2.0, 300)],  # its source is near: 2° are 14 mm in the object plane
}
# The oracle knows Snell's law only: scenes with scatter have their own, in test_scatter_tree.py
SCATTERS = re.compile(rf'<bsdf type="({"|".join(KINDS)})"')
SCENES = sorted(path for path in (ROOT / "scenes").glob("*/scene.xml") if not SCATTERS.search(path.read_text()))
CASES = [
    pytest.param(
        (path, field, rays),
        id=f"{path.parent.name}-{field:g}deg",
        marks=slow_unless((path.parent.name, field) not in [("phone_camera", 0.0), ("rubin", 1.0)]),
    )
    for path in SCENES
    for field, rays in SCENE_FIELDS.get(path.parent.name, FIELDS)
]


@dataclass
class Branches:
    """All rays of one path: numbers of their start rays, hits (n, k, 3), incident flux at the nodes (n, k)."""

    events: tuple[tuple[str, str], ...]
    codes: np.ndarray
    lanes: np.ndarray
    hits: np.ndarray
    flux: np.ndarray

    def some(self, count: int) -> Branches:
        """At most `count` of the rays, spread over all of them."""
        chosen = np.unique(np.linspace(0, len(self.lanes) - 1, count).astype(int))
        return Branches(self.events, self.codes, self.lanes[chosen], self.hits[chosen], self.flux[chosen])


def branches(t: Any) -> dict[tuple[tuple[str, str], ...], Branches]:
    """Every branch that ends in the detector, by path."""
    (run,) = t.runs
    count = sum(row.rays for row in t.paths)
    recorder = run.record(None, max(count, 1))
    assert int(recorder.count[0]) == count
    lanes, lengths = np.array(recorder.lane)[:count], np.array(recorder.length)[:count]
    codes = np.array(recorder.codes).reshape(recorder.capacity, -1)[:count]
    nodes = recorder.nodes_of(np.arange(count), recorder.max_events)
    slots: dict[bytes, list[int]] = {}
    for slot in np.argsort(lanes, kind="stable"):
        slots.setdefault(codes[slot, : lengths[slot]].tobytes(), []).append(slot)
    found = {}
    for chosen in slots.values():
        length = lengths[chosen[0]]
        path = codes[chosen[0], :length]
        events = tuple((run.table.ids[c >> EVENT_BITS], INTERCEPTS[int(c) & EVENT_MASK]) for c in path)
        hits = nodes[chosen, :length, :3] + run.table.centre
        found[events] = Branches(events, path, lanes[chosen], hits, nodes[chosen, :length, 6])
    return found


@dataclass
class Case:
    """A trace, the oracle's model of its scene, and the start rays of both."""

    t: Any
    model: scene_xml.SceneModel
    wavelength_nm: float
    size: float
    origin: np.ndarray
    direction: np.ndarray
    weight: np.ndarray  # of the start rays; 1 but where a source aims them
    by_path: dict[tuple[tuple[str, str], ...], Branches]

    @property
    def tolerance_mm(self) -> float:
        return max(1e-3, 1e-5 * self.size)

    def place_tolerance(self, path: Branches) -> float:
        """How far the end of a path may be off, mm: the rounding of every hit, magnified by what follows it."""
        o, d = self.origin[path.lanes], self.direction[path.lanes]
        step = 1e-7 * np.eye(3)[:2]
        ends = [replay(self.model, o + s, d, path.events, self.wavelength_nm, first_hit=False).points for s in step]
        exact = replay(self.model, o, d, path.events, self.wavelength_nm, first_hit=False).points
        moved = np.max([np.linalg.norm(end - exact, axis=2) for end in ends], axis=0)
        return max(self.tolerance_mm, ROUNDING * self.size * float(np.nanmax(moved[-1] / np.maximum(moved, 1e-9))))

    def nudged(self, lanes: np.ndarray) -> list[np.ndarray]:
        """Origins of start rays, moved sideways in eight directions and by two distances."""
        d = self.direction[lanes]
        across = np.cross(d, [1.0, 0.0, 0.0])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        up = np.cross(d, across)
        angles = np.arange(8) * np.pi / 4
        steps = [f * NUDGE * self.size * (np.cos(a) * across + np.sin(a) * up) for f in (0.1, 1.0) for a in angles]
        return [self.origin[lanes] + step for step in steps]


def traced(path: Path, field_deg: float, rays: int) -> Case:
    model = scene_xml.read_scene(path)
    t = mistray.trace(mistray.load(path), rays=rays, field_deg=field_deg, seed=7, polarization="unpolarized")
    (run,) = t.runs
    origin, direction = run.start_rays(np.arange(run.rays))
    weight = np.array(run.start_pass(0).w, dtype=np.float64)
    size = model.radius_about(model.emitters[0].to_world[:3, 3])
    return Case(t, model, run.source.wavelength_nm, size, origin, direction, weight, branches(t))


@pytest.fixture(scope="module", params=CASES)
def case(request: pytest.FixtureRequest) -> Case:
    """One trace for each scene and field, shared by the tests."""
    return traced(*request.param)


def test_paths_replay_sequentially(case: Case) -> None:
    (run,), (detector,) = case.t.runs, case.model.detectors
    share = 1 - float(case.model.by_id[detector].interface.reflectance or 0.0)
    assert {tuple(row.event_list) for row in case.t.paths} == set(case.by_path)
    accepted = total = 0
    for row in case.t.paths:
        b = case.by_path[tuple(row.event_list)]
        assert row.rays == len(b.lanes)
        b = b.some(REPLAYED)
        o, d = case.origin[b.lanes], case.direction[b.lanes]
        traced = replay(case.model, o, d, b.events, case.wavelength_nm)
        total += len(b.lanes)
        if not traced.valid.all():
            lost = b.lanes[~traced.valid]
            # A start ray is fragile that takes the path once it is moved slightly
            rest = case.direction[lost], b.events, case.wavelength_nm
            fragile = np.any([replay(case.model, at, *rest).valid for at in case.nudged(lost)], axis=0)
            assert fragile.all(), f"path {row.path_id} {row.events}: {traced.summary()}, start rays {lost[~fragile]}"
            accepted += len(lost)
        ok = traced.valid
        off = np.abs(traced.points[1:, ok].transpose(1, 0, 2) - b.hits[ok]).max(initial=0.0)
        if off > case.tolerance_mm:
            assert off < case.place_tolerance(b), f"path {row.path_id} {row.events}: off by {off:.2g} mm"
        absorbed = b.flux[ok, -1] * share
        np.testing.assert_allclose(absorbed, traced.flux[ok] * case.weight[b.lanes[ok]], rtol=1e-4, err_msg=row.events)
        # optical path length and position of the table of single rays
        codes, lengths = np.tile(b.codes, (len(b.lanes), 1)), np.full(len(b.lanes), len(b.codes))
        exact, leaving, opl = retrace(run.table, o[ok], d[ok], codes[ok], lengths[ok], b.hits[ok])
        np.testing.assert_allclose(opl[:, -1], traced.opl_mm[ok], rtol=1e-9)
        np.testing.assert_allclose(exact, traced.points[:, ok].transpose(1, 0, 2), rtol=0, atol=1e-9 * case.size)
        np.testing.assert_allclose(leaving[:, :-1], traced.directions[:, ok].transpose(1, 0, 2), rtol=0, atol=1e-9)
    print(f"{len(case.t.paths)} paths, {total} rays, {accepted} fragile")
    assert accepted <= max(2, 1e-2 * total), f"{accepted} of {total} rays are fragile"


def test_ledger_against_the_nonsequential_oracle(case: Case) -> None:
    (run,) = case.t.runs
    settings = {key: case.t.settings[key] for key in ("max_reflections", "max_events", "flux_threshold")}
    power = run.unit * case.weight

    def oracle(lanes: np.ndarray, origin: np.ndarray) -> nonsequential.Ledger:
        start = case.direction[lanes]
        return nonsequential.trace(case.model, origin, start, power[lanes], case.wavelength_nm, **settings)

    everything = np.flatnonzero(power)
    ledger = oracle(everything, case.origin[everything])
    theirs = {record.events: record for record in ledger.paths}
    mine = case.by_path
    # which start ray takes which path
    different: dict[int, set] = {}
    for events in set(theirs) | set(mine):
        a = set(everything[theirs[events].start_rays].tolist()) if events in theirs else set()
        b = set(mine[events].lanes.tolist()) if events in mine else set()
        for lane in a ^ b:
            different.setdefault(int(lane), set()).add(events)
    if different:
        lanes = np.array(sorted(different))
        before = {(e, int(k)) for e, r in theirs.items() for k in everything[r.start_rays] if int(k) in different}
        changed = set()
        for origin in case.nudged(lanes):
            nudged = oracle(lanes, origin)
            changed |= before ^ {(r.events, int(lanes[i])) for r in nudged.paths for i in r.start_rays}
        unexplained = {(e, lane) for lane, paths in different.items() for e in paths} - changed
        assert not unexplained, f"{len(unexplained)} differences, one is {next(iter(unexplained))}"
    assert len(different) <= max(2, 0.02 * run.rays), f"{len(different)} of {run.rays} start rays are fragile"
    fragile = set(different)
    print(f"{len(theirs)} paths, {run.rays} start rays, {len(fragile)} fragile")
    for row in case.t.paths:
        events = tuple(row.event_list)
        if events not in theirs or any(events in paths for paths in different.values()):
            continue
        record = theirs[events]
        assert (row.order + row.structure_bounces, row.rays) == (record.order, record.rays)
        assert row.power_W == pytest.approx(record.power_W, rel=1e-4)
        assert row.incident_W == pytest.approx(record.incident_W, rel=1e-4)
        off = max(abs(getattr(row, key) - getattr(record, key)) for key in ("x_mm", "y_mm", "rms_radius_mm"))
        if off > case.tolerance_mm:
            assert off < case.place_tolerance(mine[events]), f"path {row.path_id} {row.events}: off by {off:.2g} mm"
    # branches that do not reach the detector may graze a rim too: a tenth of one start ray
    slack = 1e-5 * ledger.launched_W + (len(fragile) + 0.1) * run.unit
    e = case.t.energy
    assert e.launched_W == pytest.approx(ledger.launched_W, rel=6e-8)  # of float32 weights, each half a unit
    assert e.detected_W == pytest.approx(ledger.detected_W, abs=slack)
    assert e.escaped_W == pytest.approx(ledger.escaped_W, abs=slack)
    for name, (watt, _) in e.absorbed.items():
        assert watt == pytest.approx(ledger.absorbed_W.get(name, 0.0), abs=slack), name
    assert set(e.absorbed_in) == set(ledger.absorbed_in_W)
    for name, (watt, _) in e.absorbed_in.items():
        assert watt == pytest.approx(ledger.absorbed_in_W[name], rel=1e-3, abs=slack), name
    for reason in ("max_reflections", "max_events", "flux_threshold"):
        assert e.cut[reason] == pytest.approx(ledger.cut_W.get(reason, 0.0), abs=slack), reason
    assert e.cut["roulette"] == 0
    dead = run.rays - len(everything)  # aimed to where the source does not shine; they end at their first surface
    off = abs(case.t.segments - ledger.segments - dead)
    if off > (1e-3 if fragile else 2e-5) * ledger.segments:  # branches that do not reach the detector, at a rim
        nudged = [oracle(everything, origin).segments for origin in case.nudged(everything)]
        assert off <= max(abs(count - ledger.segments) for count in nudged)
