"""Steps 1 and 2 of a stray-light study: optical and mechanical model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from mistray.analyses.study.first_order import FirstOrder, first_order
from mistray.analyses.study.step import Fact, StudyStep, count_of
from mistray.sampling.design_path import DesignPath
from mistray.sampling.sources import scene_sources
from mistray.surfaces.families.sag_surface import SagSurface
from mistray.surfaces.surfaces import SurfaceTable
from mistray.toolkit.tables.surface_optics import DETECTOR, OPTIC, role

UNDERFILL = 0.99  # radius of the source over that of the pupil, below which the source is said not to fill it


def optical_model(scene: Any, table: SurfaceTable, path: DesignPath | None) -> StudyStep:
    """
    Return step 1 of the study: surfaces in the order of the light, and first-order data.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    table : SurfaceTable
        Surfaces at the reference wavelength.
    path : DesignPath, optional
        Design path; None if no light of the source reaches the detector by design, and there are no first-order data.
    """
    text = (
        "The surfaces that the light of the source meets on its way to the detector, found by rays, and first-order "
        "numbers along this way."
    )
    width, height = (float(high - low) for low, high in np.reshape(table.film()[2], (2, 2)))
    facts = [Fact("detector width", width, "mm"), Fact("detector height", height, "mm")]
    if path is None:
        warning = (
            "on axis and at the field of the source, no ray reaches the detector as the design means it: there is no "
            "design path, and there are no first-order numbers"
        )
        return StudyStep.of("optical_model", text, facts=tuple(facts), warnings=(warning,))
    numbers = first_order(scene, path)
    frame = path_surfaces(path)
    warnings = []
    reach = scene_sources(scene, field_deg=0.0)[0].reach
    if reach < UNDERFILL * numbers.pupil_diameter_mm / 2:
        warnings.append(
            f"the source reaches {reach:.4g} mm from the axis, the entrance pupil {numbers.pupil_diameter_mm / 2:.4g} "
            "mm: ghosts of the outer zone are missing; make the source larger"
        )
    pupil = f"entrance pupil {numbers.pupil_diameter_mm:.5g} mm"
    if numbers.stop != "-":
        pupil += f" at '{numbers.stop}'"
    found = f"no focus; {pupil}"
    if math.isfinite(numbers.focal_length_mm):
        found = f"focal length {numbers.focal_length_mm:.5g} mm, {pupil}, f/{numbers.f_number:.3g}"
    field = numbers.field_deg["y"]
    if math.isfinite(field):
        found += f", field ±{field:.4g}° over the height of the detector"
    return StudyStep.of(
        "optical_model",
        text,
        facts=(*_first_order_facts(numbers), *facts),
        tables={"optical_surfaces": frame},
        findings=(f"{count_of(len(frame) - 1, 'optical surface')}: {found}.",),
        warnings=tuple(warnings),
        result=numbers,
    )


def _first_order_facts(n: FirstOrder) -> list[Fact]:
    facts = [
        Fact("wavelength", n.wavelength_nm, "nm"),
        Fact("focal length", n.focal_length_mm, "mm"),
        Fact("f-number", n.f_number),
        Fact("entrance pupil diameter", n.pupil_diameter_mm, "mm"),
        Fact("entrance pupil free area", n.pupil_area_mm2, "mm²"),
        Fact("stop", n.stop),
        Fact("back focus", n.back_focus_mm, "mm"),
        Fact("paraxial focus to detector", n.defocus_mm, "mm"),
    ]
    x, y = n.focal_lengths_mm
    if not math.isclose(x, y, rel_tol=1e-4):
        facts[1:2] = [Fact("focal length, 1st section", x, "mm"), Fact("focal length, 2nd section", y, "mm")]
    names = {"x": "half field, width", "y": "half field, height", "diagonal": "half field, corner"}
    return facts + [Fact(names[key], value, "°") for key, value in n.field_deg.items()]


def path_surfaces(path: DesignPath) -> pd.DataFrame:
    """
    Return a DataFrame of the surfaces of a design path in the order of the light.

    Columns: number (from 1), surface, part, does ("refracts", "reflects", "detects"), z_mm of the vertex in the world,
    radius_mm of curvature (inf: flat), conic, asphere (highest power of r, 0: none), semi_diameter_mm (NaN: a
    rectangle), distance_mm to the next surface along the base ray, material and index on the way there, and aperture
    ("mesh" or "") if a surface is a mesh.
    """
    table = path.table
    rows = []
    for number, step in enumerate(path.steps, start=1):
        bsdf = table.interfaces[step.surface]
        piece = table.pieces[step.surface] if step.surface < len(table.pieces) else None
        optic = piece if isinstance(piece, SagSurface) else None
        curvature, conic = (optic.curvature, optic.conic) if optic else (0.0, 0.0)
        last = step is path.steps[-1]
        after = path.steps[number].point - step.point if not last else np.full(3, np.nan)
        behind = step.to_back
        rows.append(
            {
                "number": number,
                "surface": table.ids[step.surface],
                "part": table.parts[step.surface],
                "does": "detects" if last else "reflects" if step.reflects else "refracts",
                "z_mm": float(table.vertices[step.surface][2]) if piece else float(step.point[2]),
                "radius_mm": 1 / curvature if curvature else math.inf,
                "conic": conic,
                "asphere": 2 + 2 * len(optic.coefficients) if optic and optic.coefficients else 0,
                "semi_diameter_mm": optic.outer if optic and optic.outer else math.nan,
                "distance_mm": float(np.linalg.norm(after)),
                "material": "-" if last else bsdf.back if behind else bsdf.front,
                "index": math.nan if last else float(table.optics.host_indices[step.surface][1 if behind else 0]),
                "aperture": "" if piece else "mesh",
            }
        )
    frame = pd.DataFrame(rows)
    return frame if (frame.aperture != "").any() else frame.drop(columns="aperture")


def mechanical_model(table: SurfaceTable, path: DesignPath | None) -> StudyStep:
    """
    Return step 2, the mechanics: all surfaces that are not optics, with extents in z and r, mm.

    Extents in z are those in the world, also of tilted parts. For shapes with a profile r is the radius about their own
    axis. For others it is the range of their bounding box.
    """
    rows = []
    for i in table.listed:
        kind = role(table, path, i)
        if kind in (OPTIC, DETECTOR):
            continue
        z, r, shape = _extent(table.shapes[i])
        rows.append((table.ids[i], table.parts[i], table.spaces[i], kind, shape, *z, *r))
    columns = ["surface", "part", "space", "role", "shape", "z_from_mm", "z_to_mm", "r_from_mm", "r_to_mm"]
    frame = pd.DataFrame(rows, columns=columns)
    parts = frame.part.value_counts(sort=True)
    named = ", ".join(f"{part} {count}" for part, count in parts.head(8).items())
    more = f" and {len(parts) - 8} more parts" if len(parts) > 8 else ""
    finding = (
        f"{count_of(len(frame), 'surface')} beside the optics of the design path: {named}{more}."
        if len(frame)
        else "There are no surfaces beside the optics: light that leaves them is lost, other than in a real housing."
    )
    spaces = sorted({int(space) for space in frame.space if space >= 0})
    facts = [Fact(f"surfaces: {kind}", float(count)) for kind, count in frame.role.value_counts().items()]
    if spaces:
        facts.append(Fact("optical spaces", f"{spaces[0]} … {spaces[-1]}"))
    return StudyStep.of(
        "mechanical_model",
        "Everything that light can meet besides the optics: structure, and edges and bevels of lenses.",
        facts=tuple(facts),
        tables={"structure": frame},
        findings=(finding,),
    )


def _extent(shape: Any) -> tuple[tuple[float, float], tuple[float, float], str]:
    """
    Return ranges of z and r in the world, mm, and the kind of the shape in words, which says if it is tilted.

    For a shape with a profile, r is the radius about its own axis. For any other shape they bound its box, with r the
    distance from the world's z axis.
    """
    low, high = (np.array(corner, dtype=np.float64) for corner in (shape.bbox().min, shape.bbox().max))
    z = low[2], high[2]
    if hasattr(shape, "profile"):
        r, along = shape.profile().T
        kind, upright = shape.figure, abs(shape.matrix[2, 2]) >= 1 - 1e-9
        ends = r.min(), shape.outer_radius
        if upright and r.max() == ends[1]:  # else, as for corners of a rectangle, the profile does not have its ends
            heights = shape.matrix[2, 3] + along * shape.matrix[2, 2]
            z = heights.min(), heights.max()  # exact, while the box is in float32
    else:
        kind, upright = getattr(shape, "figure", "mesh"), True
        nearest = np.maximum(np.maximum(low[:2], -high[:2]), 0.0)
        ends = np.hypot(*nearest), np.hypot(*np.maximum(np.abs(low[:2]), np.abs(high[:2])))
    return (float(z[0]), float(z[1])), (float(ends[0]), float(ends[1])), kind if upright else f"{kind}, tilted"
