"""Hits close to rims and their coefficients, as `mistray.gradients.edges` finds them, for the oracle of distances."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from oracles.rim_distances import RimHits, bundles_of_hits

from mistray.execute.backward import BackwardTrace
from mistray.execute.tracer import Run, prepare
from mistray.gradients.edge_widths import widths_of
from mistray.gradients.edges import Edges
from mistray.light import Light
from mistray.recorders.adjoint import Adjoint
from mistray.recorders.path_events import INTERCEPTS
from mistray.recorders.path_key import EVENT_BITS, EVENT_MASK
from mistray.recorders.start_rays import StartRays
from mistray.settings import Settings
from mistray.surfaces.upload import upload


def edge_hits(edges: Edges, starts: list[StartRays], ids: list[str], adjoint: Adjoint) -> list[RimHits]:
    """All hits of some start rays, with both coefficients (the one for half the width in row 1)."""
    found: dict[str, list[Any]] = {}
    for pass_rays in starts:
        for start, events in edges.events(pass_rays, adjoint):
            row, paths = np.array(events.row), events.paths
            lane = np.array(paths.lane)[row] - int(np.array(start.lane)[0])
            nodes = np.array(paths.nodes).reshape(paths.capacity, paths.max_events, -1)
            portion = {
                "codes": np.array(paths.codes).reshape(paths.capacity, -1)[row],
                "lengths": np.array(paths.length)[row],
                "points": nodes[row, :, :3].astype(np.float64) + edges._table.centre,
                "origin": edges._table.download_points(start.o)[lane],
                "direction": np.array(start.d).T[lane].astype(np.float64),
                "rim": np.array(events.rim),
                "joined": np.array(events.joined),
                "batch": np.array(events.batch),
                "c": np.stack([np.array(c) for c in events.c], axis=1),
            }
            for name, values in portion.items():
                found.setdefault(name, []).append(values)
    if not found:
        return []
    whole = {name: np.concatenate(values) for name, values in found.items()}
    rest = {name: whole.pop(name) for name in ("rim", "joined", "batch")} | {"c": whole.pop("c").T}
    names = tuple(INTERCEPTS[k] for k in range(EVENT_MASK + 1))
    return bundles_of_hits(ids, names, **whole, rest=rest, event_bits=EVENT_BITS)


def traced_edges(scene: Any, width: float, pixel: np.ndarray | float = 1.0, **traced: Any) -> tuple[Run, list[RimHits]]:
    """Hits of a forward trace; `pixel` is the derivative of the metric by the flux in each pixel, (height, width)."""
    field_deg = traced.pop("field_deg", None)
    settings = Settings.of(scene, **traced)
    (run,) = prepare(scene, settings, Light(field_deg))
    film = run.make_film()
    by_pixel = run.unit * np.broadcast_to(pixel, (film.height, film.width))
    adjoint = Adjoint(0, film, upload(mi.Float, by_pixel))
    edges = Edges(run.scene, settings, widths_of(width))
    with dr.suspend_grad():
        return run, edge_hits(edges, [run.start_pass(k) for k in range(run.passes)], run.table.ids, adjoint)


def backward_edges(trace: BackwardTrace, derivative: np.ndarray, width: float) -> list[RimHits]:
    """Hits of the first wavelength of a backward trace; `derivative` is (CLASS_COUNT, n, m), by the sums of weights."""
    band = trace.bands[0]
    edges = Edges(trace.scene(band), trace.settings, widths_of(width))
    starts = [trace.start_pass(0, done, rays) for done, rays in enumerate(trace.pass_rays or [])]
    with dr.suspend_grad():
        return edge_hits(edges, starts, band.table.ids, trace.adjoint(derivative))
