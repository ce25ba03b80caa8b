"""The phone camera: its image beside the ``checks`` of its prescription, its ghosts beside the FRED study."""

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import vectors
from oracles import beams, scene_xml
from oracles.replay import Replay, replay

import mistray
from mistray.analyses.validate.packs.known import PACKS
from mistray.analysis import ghosts
from mistray.prescription import Prescription, from_json
from mistray.prescription.scene_file import xml_text

FILE = Path(__file__).parents[2] / "scenes" / "phone_camera" / "prescription.json"
D_LINE_NM = 587.5618
BEAM_RADIUS = 1.252  # of the study's source, mm
STEP_DEG = 0.05
EVEN_RAYS = 40_000
EVEN_POINTS = 400
NODES = 20_000
WINDOW = ("window_front", "window_rear")
FACES = [f"{part}_{face}" for part in ("L1", "L2", "L3", "L4", "L5", "filter") for face in ("front", "rear")]

DIRECT = [*((face, "SpecTran") for face in (*WINDOW, *FACES)), ("detector", "Absorbed")]


@dataclass(frozen=True)
class Ghost:
    """A path of the study: RMS irradiance (W/mm²), the same over that of the image, the surfaces if it names them."""

    field_deg: float
    path: int
    irradiance: float
    normalised: float
    surfaces: tuple[str, ...]


NOMINAL = 130432.0  # RMS irradiance of the image on axis, W/mm²
NOMINAL_RAYS = 10_000
REPORT = [
    Ghost(float(field), int(path), float(irradiance), float(normalised), tuple(surfaces.split()))
    for field, path, irradiance, normalised, surfaces in map(dict.values, vectors.rows("phone_camera_ghosts.csv"))
]
FIELDS_DEG = sorted({ghost.field_deg for ghost in REPORT})
THREE_REFLECTIONS = (20.0, 27.0)  # fields at which the study names paths with three


@cache
def checks() -> Mapping[str, Any]:
    return json.loads(FILE.read_text(encoding="utf-8"))["checks"]


@cache
def shipped() -> Prescription:
    return from_json(FILE, beam="exact")


def wide_open(barrel: bool) -> Prescription:
    """The camera for its image alone: as shipped but for the detector, or without barrel, so that only lenses clip."""
    p = shipped()
    detector = replace(p.detector, half_width=3.0, half_height=3.0)
    if barrel:
        structures = tuple(s for s in p.structures if s.part != "board")
        return replace(p, structures=structures, detector=detector, source=replace(p.source, radius=1.4, plane="axis"))
    surfaces = tuple(s for s in p.surfaces if s.part != "window")
    source = replace(p.source, radius=p.stop.radius, plane="axis", pattern="grid")
    return replace(p, surfaces=surfaces, structures=(), stop=None, detector=detector, source=source)


def image_path(t: mistray.Trace, window: bool) -> Any:
    faces = [*(WINDOW if window else ()), *FACES]
    wanted = " ".join([*(f"{name}:T" for name in faces), "detector:A"])
    return next(row for row in t.paths if row.events == wanted)


def image(rays: int) -> list[dict[str, float]]:
    """Spot, chief ray and relative illumination on the d line: the flux that passes, with the cosine of the tilted
    stop, times sin θ dθ / (y dy), by conservation of étendue."""
    rims = wide_open(barrel=False)
    scene, with_barrel = rims.to_scene(), wide_open(barrel=True).to_scene()
    thin = replace(rims, source=replace(rims.source, radius=1e-5)).to_scene()
    model = scene_xml.parse_scene(xml_text(rims))

    def chief(field_deg: float) -> float:
        t = mistray.trace(thin, rays=64, field_deg=field_deg, wavelength_nm=D_LINE_NM, max_reflections=0)
        return float(image_path(t, window=False).y_mm)

    def solid_angle(field_deg: float) -> float:
        y = {k: chief(field_deg + k * STEP_DEG) if field_deg + k * STEP_DEG else 0.0 for k in (-1, 0, 1)}
        slope = (y[1] - y[-1]) / np.radians(2 * STEP_DEG)
        return float(np.sin(np.radians(field_deg)) / (y[0] * slope))

    rows: list[dict[str, float]] = []
    barrel = checks()["relative_illumination_with_barrel"]["finite cylindrical stop wall (default)"]
    with_stop_wall = {row[0]: row[2] for row in barrel}
    for figure in checks()["performance_R13_5p727_d"]["rows"]:
        field = float(figure["field"])
        settings = {"field_deg": field, "wavelength_nm": D_LINE_NM, "max_reflections": 0}
        t = mistray.trace(scene, rays=rays, **settings)
        row, run = image_path(t, window=False), t.runs[0]
        full = image_path(mistray.trace(with_barrel, rays=8 * rays, **settings), window=True)
        traced = replay(model, *run.start_rays(np.arange(run.rays)), row.event_list, D_LINE_NM, first_hit=False)
        # Points that fill the stop evenly to its rim, as no square grid does
        d = np.tile(beams.field_direction(field), (EVEN_RAYS, 1))
        points = np.column_stack([beams.disc_points(EVEN_RAYS, shipped().stop.radius), np.zeros(EVEN_RAYS)])
        even = replay(model, points - 0.3 * d, d, row.event_list, D_LINE_NM, first_hit=False)
        cells = {"field_deg": field, "rms_um": 1e3 * row.rms_radius_mm, "rms_replayed_um": _rms_um(traced)}
        cells |= {"rms_even_um": _rms_um(even), "rms_figure_um": figure["rms_um"]}
        cells |= {"rays": row.rays, "rays_replayed": int(traced.valid.sum())}
        cells |= {"passed": row.rays / run.rays, "passed_figure": figure["passed"]}
        cells |= {"chief_mm": chief(field), "chief_figure_mm": figure["chief_mm"]}
        cells |= {"solid_angle": solid_angle(max(field, STEP_DEG)), "power_W": row.power_W}
        cells |= {"power_barrel_W": full.power_W, "relative_se_barrel": full.power_se_W / full.power_W}
        cells |= {"illumination_figure": figure["RI"], "barrel_figure": with_stop_wall[figure["field"]]}
        rows.append(cells)
    first = rows[0]
    for row in rows:
        share = row["solid_angle"] / first["solid_angle"]
        row["illumination"] = row["power_W"] / first["power_W"] * share
        row["barrel"] = row["power_barrel_W"] / first["power_barrel_W"] * share
        relative = np.hypot(row["relative_se_barrel"], first["relative_se_barrel"]) if row is not first else 0.0
        row["barrel_se"] = float(row["barrel"] * relative)
    return rows


def even_scene_irradiance(field_deg: float) -> float:
    """Relative irradiance of the image of an even scene where a chief ray lands: Σ |∂(direction cosines)/∂(place)| over
    points of the stop, each with the direction that reaches that place, by Newton's method in float64."""
    model = scene_xml.parse_scene(xml_text(wide_open(barrel=False)))
    events = [*((name, "T") for name in FACES), ("detector", "A")]
    points = np.column_stack([beams.disc_points(EVEN_POINTS, shipped().stop.radius), np.zeros(EVEN_POINTS)])

    def land(cosines: np.ndarray, points: np.ndarray) -> np.ndarray:
        d = np.column_stack([cosines, np.sqrt(1 - np.sum(cosines**2, axis=1))])
        traced = replay(model, points - 0.3 * d, d, events, D_LINE_NM, first_hit=False)
        assert traced.valid.all()
        return traced.end[:, :2]

    def jacobian(cosines: np.ndarray) -> np.ndarray:
        step = 1e-6
        columns = [land(cosines + e, points) - land(cosines - e, points) for e in step * np.eye(2)]
        return np.stack(columns, axis=2) / (2 * step)

    cosines = np.tile([0.0, np.sin(np.radians(field_deg))], (EVEN_POINTS, 1))
    target = land(cosines[:1], np.zeros((1, 3)))
    for _ in range(4):
        cosines = cosines + np.linalg.solve(jacobian(cosines), (target - land(cosines, points))[:, :, None])[:, :, 0]
    np.testing.assert_allclose(land(cosines, points), np.broadcast_to(target, (EVEN_POINTS, 2)), atol=1e-9)
    return float(np.sum(1 / np.abs(np.linalg.det(jacobian(cosines)))))


def _rms_um(traced: Replay) -> float:
    return 1e3 * float(np.sqrt(np.sum(np.var(traced.end[traced.valid], axis=0))))


def radial(
    events: list[tuple[str, str]],
    radius: float,
    wavelength_nm: float,
    stop: bool = True,
    camera: Prescription | None = None,
) -> tuple[float, ...]:
    """Power, RMS radius, RMS irradiance and its relative error times √rays of an on-axis path, by quadrature over the
    square of the height in a beam of 1 W/mm²; the faces of the stop clip, or nothing does."""
    r = radius * np.sqrt((np.arange(NODES) + 0.5) / NODES)
    origin = np.column_stack([0 * r, r, np.full_like(r, -3.0)])
    model = _with_stop(camera or shipped())
    traced = replay(model, origin, np.tile([0.0, 0.0, 1.0], (len(r), 1)), events, wavelength_nm, first_hit=False)
    good = traced.valid.copy()
    if stop:
        for start, end, direction in zip(traced.points[:-1], traced.points[1:], traced.directions, strict=True):
            length = np.linalg.norm(end - start, axis=1)
            for shape in model.shapes:
                if shape.part == "stop":
                    good &= ~(shape.first_hit(start, direction, np.zeros(len(r), dtype=bool)) < length)
    w = traced.flux[good] / NODES
    share = float(w.sum())
    second, fourth = (float(w @ traced.end[good, 1] ** k) / share for k in (2, 4))
    power = np.pi * radius**2 * share
    return power, float(np.sqrt(second)), power / (np.pi * second), float(np.sqrt(fourth / second**2 - 1))


@cache
def _with_stop(camera: Prescription) -> scene_xml.SceneModel:
    return scene_xml.parse_scene(xml_text(replace(camera, structures=())))


def readings() -> list[dict[Any, Any]]:
    def changed(part: str, material: str) -> Prescription:
        camera = shipped()
        inside = {f"{part}_front": {"back": material}, f"{part}_rear": {"front": material}}
        return replace(camera, surfaces=tuple(replace(s, **inside.get(s.name, {})) for s in camera.surfaces))

    cameras = {
        "as shipped": shipped(),
        "window nd = 1.5168 (its paraxial table)": changed("window", "nd=1.5168 Vd=64.1 k=0"),
        "filter nd = 1.5168 (its Table 5)": changed("filter", "nd=1.5168 Vd=64.1 k=0"),
        "R(S13) = 5.272 (published copy)": from_json(FILE, variant="R13=5.272", beam="exact"),
    }
    beams_and_lines = [(r, nm) for r in (shipped().stop.radius, BEAM_RADIUS) for nm in (D_LINE_NM, 550.0)]
    return [
        {"reading": name} | {(r, nm): radial(DIRECT, r, nm, stop=False, camera=camera)[2] for r, nm in beams_and_lines}
        for name, camera in cameras.items()
    ]


def on_axis(rays: int) -> list[dict[str, Any]]:
    scene = shipped().to_scene()
    unclipped = replace(shipped(), stop=replace(shipped().stop, radius=1.26)).to_scene()
    rows = []
    for name, radius, traced in (("stop", shipped().stop.radius, scene), ("beam", BEAM_RADIUS, unclipped)):
        for wavelength_nm in (D_LINE_NM, 550.0):
            t = mistray.trace(traced, rays=rays, wavelength_nm=wavelength_nm, max_reflections=0)
            row = image_path(t, window=True)
            power, rms, irradiance, spread = radial(DIRECT, radius, wavelength_nm, stop=name == "stop")
            cells = {"limit": name, "radius_mm": radius, "wavelength_nm": wavelength_nm}
            cells |= {"power_W": power, "rms_um": 1e3 * rms, "quadrature": irradiance}
            cells |= {"traced": row.rms_irradiance_W_mm2, "traced_se": row.rms_irradiance_se_W_mm2}
            cells |= {"study_se": irradiance * spread / np.sqrt(NOMINAL_RAYS), "million_se": irradiance * spread / 1e3}
            rows.append(cells)
    return rows


def ghost_pairs(table: pd.DataFrame) -> list[dict[str, Any]]:
    """The four ghosts of Table 22 on axis: traced (`ghost_table`), by quadrature, and with nothing that clips."""
    rows = []
    for ghost in REPORT[:4]:
        row = strongest(table, ghost.surfaces)
        events = [tuple(event.rsplit(":", 1)) for event in row.events.split()]
        _, rms, unclipped, spread = radial(events, BEAM_RADIUS, 550.0, stop=False)
        cells = {"surfaces": row.surfaces, "study": ghost.irradiance, "rms_um": 1e3 * row.rms_radius_mm}
        cells |= {"traced": row.rms_irradiance_W_mm2, "traced_se": row.rms_irradiance_se_W_mm2}
        cells |= {"quadrature": radial(events, shipped().stop.radius, 550.0)[2], "unclipped": unclipped}
        cells |= {"unclipped_rms_um": 1e3 * rms, "study_se": unclipped * spread / np.sqrt(NOMINAL_RAYS)}
        rows.append(cells)
    return rows


def beams_and_stops(rays: int) -> list[dict[str, Any]]:
    """Numbers of the pack with the study's beam and stop, a beam about the stop, and the stop of its Figure 6."""
    (pack,) = [one for one in PACKS if one.name == "phone_camera"]
    changes: dict[str, dict[str, None]] = {"studied": {}, "about_stop": {"pivot_mm": None}, "own_stop": {"set": None}}
    found = {name: pack.numbers(replace(pack.file, rays=rays, **change), None, 0) for name, change in changes.items()}
    rows: list[dict[str, Any]] = []
    for row in pack.file.rows:
        cells = {"name": row.name, "study": row.published, "study_se": row.uncertainty}
        for name, ours in found.items():
            value, se = ours(row)
            agree = abs(value - row.published) <= row.allowed(se, row.published, row.uncertainty)
            cells |= {name: value, f"{name}_se": se, f"{name}_agrees": agree}
        rows.append(cells)
    return rows


def ghost_table(scene: Any, field_deg: float, rays: int, max_reflections: int = 2) -> pd.DataFrame:
    """The stray paths of a field by falling RMS irradiance, of 30 rays at least, with their reflecting surfaces."""
    report = ghosts(scene, field_deg=[field_deg], rays=rays, max_reflections=max_reflections, flux_threshold=1e-8)
    table = report.table(field_deg)
    table = table[(table.rank_rms_irradiance > 0) & ~table.few_rays].sort_values("rank_rms_irradiance")
    names = [_label(events) for events in table.events]
    count: dict[str, int] = {}
    for i, name in enumerate(names):
        count[name] = count.get(name, 0) + 1
        names[i] = name if count[name] == 1 else f"{name} ({count[name]})"
    return table.assign(surfaces=names)


def _label(events: str) -> str:
    reflecting = re.findall(r"(\S+):R", events)
    return " → ".join(reflecting) or "through " + " and ".join(re.findall(r"(\S+_bevel_\d):T", events))


def strongest(table: pd.DataFrame, surfaces: tuple[str, ...]) -> Any:
    rows = table[table.surfaces == " → ".join(surfaces)]
    return rows.iloc[0] if len(rows) else None
