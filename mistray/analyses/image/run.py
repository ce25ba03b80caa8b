"""Image quality of a scene: wavefront, PSF, MTF and derived quantities at several field points."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import mitsuba as mi
import numpy as np

from mistray.analyses.image.field_geometry import ChiefRay, chief_ray, foci_beside, image_axes
from mistray.analyses.image.line_image import LineImage
from mistray.analyses.image.pupil_grid import ImageFrame, PupilSamples, sample_pupil
from mistray.analyses.image.request import ImageRequest
from mistray.analyses.image.result import FieldImage, ImageQuality
from mistray.errors import MistrayError
from mistray.interrupts import check
from mistray.light import Light
from mistray.ranges import PUPIL_CELLS
from mistray.sampling.design_path import DesignPath, find_design_path, sphere_of
from mistray.sampling.outlines import outline
from mistray.sampling.source import Sphere
from mistray.sampling.sources import field_of, scene_sources, spectrum_of
from mistray.surfaces.surfaces import SurfaceTable
from mistray.toolkit.analysis import analysis
from mistray.trace.host.bundle import PointBundle, field_bundle
from mistray.trace.host.design_light import check_sheets, design_light
from mistray.trace.host.stop import PupilStop, Region, find_stop, lit_region

FIRST_GRID, LAST_GRID = 64, 512  # where the grid is as fine as the wavefront asks for
STEEPEST = 0.25  # waves from one cell to the next that a grid may have
LEAST_WAVES = 4.0  # of the Fresnel number of the pupil, below which it is no place for a reference sphere
BLUR = 0.02  # of the pupil's distance, above which the blur is too large for that too
AXIS = "on the axis"

Progress = Callable[[float, float], None]


@dataclass(frozen=True)
class _System:
    """
    Scene prepared for image quality: design path at each wavelength, sphere about its first surface, aperture stop.

    `reference` is the index of the reference wavelength. `azimuth_deg` is None for that of the scene. `pupil` is the
    centre of the exit pupil on the axis, (3,), mm, None at infinity.
    """

    scene: Any
    paths: list[DesignPath]
    aperture: Sphere
    reference: int
    azimuth_deg: float | None
    stop: PupilStop
    pupil: np.ndarray | None

    @property
    def path(self) -> DesignPath:
        return self.paths[self.reference]

    def bundle(self, field_deg: float) -> PointBundle:
        return field_bundle(self.scene, field_deg, self.azimuth_deg, self.aperture)


def run(scene: mi.Scene, request: ImageRequest, *, progress: Progress | None = None) -> ImageQuality:
    """
    Compute the image quality of the direct light of a scene.

    Rays of its design path, in float64, fill the aperture that the scene leaves open. Stops, rims, barrels and vanes
    limit it; the size of a beam does not. Coatings and absorption weight the pupil. Image points are those of the chief
    ray at the wavelength of the largest weight; of several such the one nearest to the mean. Definitions:
    docs/image_quality.md.

    Parameters
    ----------
    scene : mi.Scene
        Scene with a source far away, or a `point_source` or `surface_source` in its object plane; of several the first.
    request : ImageRequest
    progress : callable, optional
        Called with the work done so far and the total work.

    Returns
    -------
    ImageQuality

    Raises
    ------
    MistrayError
        If no light reaches the detector by the design path, at a field or at all, or the light does not converge. Also
        if a surface on the way is a mesh, the source is neither far away nor a point, or rays miss the requested
        reference sphere.

    Examples
    --------
    >>> found = mistray.image_quality(mistray.load("ritchey_chretien"), [0, 0.1], grid=32)
    >>> for field in found:
    ...     print(f"{field.name}: RMS spot {1000 * field.rms_spot_mm():.1f} µm, Strehl ratio {field.strehl:.2f}")
    0°: RMS spot 0.1 µm, Strehl ratio 1.00
    0.1°: RMS spot 3.3 µm, Strehl ratio 0.88
    """
    began = time.monotonic()
    angles, names = _fields(scene, request)
    light, grid, reference_radius_mm = Light(**request.light), request.grid, request.reference_radius_mm
    azimuth_deg, detector = light.azimuth_deg, light.detector
    wavelengths, shares = spectrum_of(scene, light.wavelength_nm, light.weights)
    table = SurfaceTable(scene, float(wavelengths[0]), detector)
    found = find_design_path(table.on(table.detector), scene)
    if found is None or not found.has_optics:
        raise MistrayError(
            "the scene has no image: no lens or mirror sends light of its source to the detector; check their places"
        )
    check_sheets(found)
    mean = float(shares @ wavelengths)
    reference = min(range(len(shares)), key=lambda k: (-round(float(shares[k]), 12), abs(wavelengths[k] - mean)))
    paths = [found.at(float(wave)) for wave in wavelengths]
    aperture = sphere_of(outline(table.shapes[found.steps[0].surface]))
    axis = field_bundle(scene, 0.0, azimuth_deg, aperture)
    notes = _notes(scene)
    done, steps = 0, len(angles) * len(wavelengths)

    def step() -> None:
        nonlocal done
        done += 1
        check()
        if progress is not None:
            progress(done, steps)

    region = lit_region(paths[reference], axis, aperture)
    first = axis
    if region is None:  # a system for fields beside the axis
        first = field_bundle(scene, angles[0], azimuth_deg, aperture)
        region = lit_region(paths[reference], first, aperture)
        if region is None:
            raise MistrayError(f"{names[0]}: no light reaches the detector by the design path; choose other fields")
        notes.append("no light reaches the detector on the axis: relative illumination is over that of the first field")
    if first is axis and 0 not in angles:  # the field on the axis is the reference
        steps += len(wavelengths)
    rim = find_stop(paths[reference], first, region, request.stop)
    middle = chief_ray(paths[reference], axis, region, rim, AXIS)
    system = _System(scene, paths, aperture, reference, azimuth_deg, rim, middle.exit_pupil)
    images = [
        _field(system, angle, shares, grid, reference_radius_mm, name, notes, step)
        for angle, name in zip(angles, names, strict=True)
    ]
    base = next((f for f, angle in zip(images, angles, strict=True) if angle == 0 and first is axis), None)
    if base is None:
        base = images[0] if first is not axis else _field(
            system, 0.0, shares, min(grid or FIRST_GRID, FIRST_GRID), reference_radius_mm, AXIS, [], step
        )  # fmt: skip
    scale = middle.by_field[0]
    length = float(np.linalg.norm(scale))
    heights = np.array([_height(f, axis, system.bundle(f.angle)) for f in images])
    places = np.array([(f.chief.point - middle.point) @ scale / max(length, 1e-300) for f in images])
    some = heights != 0
    calibrated = float(heights[some] @ places[some] / (heights[some] @ heights[some])) if some.any() else np.nan
    results = tuple(
        _image(f, system, base, place, height, (length, calibrated), azimuth_deg)
        for f, place, height in zip(images, places, heights, strict=True)
    )
    facts: dict[str, Any] = {
        "wavelength_nm": wavelengths.tolist(),
        "weights": shares.tolist(),
        "reference_wavelength_nm": float(wavelengths[reference]),
        "detector": table.detector_names,
        "stop": rim.name,
        "stop_radius_mm": rim.radius,
        "grids": [len(f.samples[reference].pupil.alpha) for f in images],
        "reference_radius_mm": "exit pupil" if reference_radius_mm is None else reference_radius_mm,
        "calibrated_scale_mm": calibrated,
        "seconds": round(time.monotonic() - began, 3),
    }
    near = axis.near
    return ImageQuality(
        results, wavelengths, shares, rim.name,
        image_scale_mm=np.nan if near else length, magnification=length if near else np.nan,
        facts=facts, notes=tuple(dict.fromkeys(notes)),
    )  # fmt: skip


image_quality = analysis("image_quality", ImageRequest, run)


@dataclass(frozen=True)
class _Field:
    """Results of one field before they are related to the axis; `angle` is in degrees, `foci` see `foci_beside`."""

    angle: float
    bundle: PointBundle
    chief: ChiefRay
    frame: ImageFrame
    samples: list[PupilSamples]
    lines: tuple[LineImage, ...]
    foci: tuple[float, float]

    @property
    def illumination(self) -> float:
        """Irradiance of the image of a uniform scene per radiance, averaged over the wavelengths, sr."""
        return sum(line.weight * sampled.illumination for line, sampled in zip(self.lines, self.samples, strict=True))


def _field(
    system: _System, angle: float, shares: np.ndarray, grid: int | None, radius: float | None, name: str,
    notes: list[str], step: Callable[[], None],
) -> _Field:  # fmt: skip
    bundle = system.bundle(angle)
    nothing = f"{name}: no light reaches the detector by the design path; choose fields within the field of view"
    region = lit_region(system.path, bundle, system.aperture)
    if region is None:
        raise MistrayError(nothing)
    chief = chief_ray(system.path, bundle, region, system.stop, name)
    if not system.path.end.holds(chief.point[None])[0]:
        x, y = _on_detector(system.path, chief.point)
        notes.append(f"{name}: its image lies at ({x:.4g}, {y:.4g}) mm, beside the detector, whose edge is not counted")
    axes = image_axes(system.path, chief)
    distance = chief.distance_from(system.pupil) if radius is None else radius
    # All rays miss the sphere about a pupil at the image, see `_sampled`
    frame = ImageFrame(chief.point, axes, 1 / (distance or 1e-300))
    samples, lines = [], []
    for number, (path, share) in enumerate(zip(system.paths, shares, strict=True)):
        here = region if number == system.reference else lit_region(path, bundle, system.aperture)
        if here is None:
            raise MistrayError(nothing)
        sampled = _sampled(system, path, bundle, here, frame, chief, grid, radius, name, notes)
        frame = ImageFrame(chief.point, axes, sampled.pupil.curvature)
        wavelength = path.table.wavelength_nm
        samples.append(sampled)
        rays = sampled.spot, sampled.blur, sampled.stop, sampled.jacobian
        lines.append(LineImage(wavelength, float(share), sampled.pupil, *rays))
        step()
    foci = foci_beside(system.path, bundle, chief, axes, region.size)
    return _Field(angle, bundle, chief, frame, samples, tuple(lines), foci)


# More than 8 parameters: what a field is, and how it shall be sampled
def _sampled(
    system: _System, path: DesignPath, bundle: PointBundle, region: Region, frame: ImageFrame, chief: ChiefRay,
    grid: int | None, radius: float | None, name: str, notes: list[str],
) -> PupilSamples:  # fmt: skip
    """
    Return the light of a field at one wavelength on a grid of `grid` cells across.

    None stands for as many cells, up to 512, as the wavefront requires. `name` names the field in messages. With no
    `radius` of the reference sphere, mm, a plane takes its place where the pupil lies in the blur. This and a wavefront
    that is not resolved are added to `notes`.

    Raises
    ------
    MistrayError
        If the light does not converge on the detector, none reaches it, or rays miss a sphere of the given `radius`.
    """
    count = grid or FIRST_GRID
    plane = ImageFrame(frame.point, frame.axes, 0.0)
    in_blur = f"{name}: the exit pupil lies in the blur of the image; the reference sphere is a plane"
    seen = design_light(path, *bundle.rays(region.points))
    if np.any(np.isnan(frame.cosines(seen)[1]) & np.isfinite(seen.opl_mm)):
        if radius is not None:
            raise MistrayError(
                f"{name}: reference_radius_mm is {radius:g}, and rays of the image miss so small a sphere; give a "
                "larger one, or inf for a plane"
            )
        frame = plane
        notes.append(in_blur)
    while True:
        sampled = sample_pupil(path, bundle, region, frame, system.stop, chief.coordinates, count)
        if sampled is None:
            raise MistrayError(f"{name}: the light does not converge on the detector, so that it has no image (afocal)")
        if not sampled.pupil.total > 0:
            raise MistrayError(f"{name}: no light reaches the detector by the design path; choose other fields")
        if radius is None and frame.curvature and not _pupil_is_far(sampled, frame.curvature):
            frame = plane
            notes.append(in_blur)
            continue
        steepest = sampled.pupil.steepest
        # The steps of a smooth wavefront go with the size of the cells
        wanted = count * 2 ** math.ceil(math.log2(max(steepest / STEEPEST, 1.0)))
        if grid is None and count < wanted <= LAST_GRID:
            count = wanted
            continue
        if not sampled.pupil.resolved:
            remedy = f"give a grid of {wanted}" if wanted <= PUPIL_CELLS.high else "bring it to focus"
            notes.append(
                f"{name}: the wavefront rises by {steepest:.2g} waves from cell to cell of a grid of {count}, so that "
                f"there is no PSF and no MTF; {remedy}"
            )
        return sampled


def _pupil_is_far(sampled: PupilSamples, curvature: float) -> bool:
    """True if the exit pupil is so far from the blur that a reference sphere of `curvature`, 1/mm, can go through."""
    pupil = sampled.pupil
    half = 0.5 * float(np.hypot(np.ptp(pupil.alpha), np.ptp(pupil.beta)))
    blur = float(np.nanmax(np.abs(sampled.spot)))
    fresnel = half**2 / (abs(curvature) * pupil.wavelength_mm)
    return blur * abs(curvature) < BLUR and fresnel > LEAST_WAVES


def _image(
    f: _Field, system: _System, base: _Field, place: float, height: float, scales: tuple[float, float],
    azimuth_deg: float | None,
) -> FieldImage:  # fmt: skip
    """
    Return the image of a field, with its illumination relative to that of the field `base`.

    Distortion compares the image height `place`, mm, with each of the scales times the field's height, see `_height`.
    The two scales are that on the axis and the calibrated one, mm per unit of the field's height.
    """
    source = scene_sources(system.scene, field_deg=f.angle, azimuth_deg=azimuth_deg)[0]
    azimuth = source.emitter.azimuth_deg if azimuth_deg is None else azimuth_deg
    distortion = [100 * (place / (scale * height) - 1) if height and scale else np.nan for scale in scales]
    k = f.frame.curvature
    return FieldImage(
        field_deg=f.angle,
        azimuth_deg=float(azimuth),
        field_mm=height if f.bundle.near else np.nan,
        lines=f.lines,
        reference=system.reference,
        point_mm=f.chief.point,
        image_mm=_on_detector(system.path, f.chief.point),
        axes=f.frame.axes,
        pupil_distance_mm=1 / k if k else np.inf,
        chief_angle_deg=float(np.degrees(np.arccos(min(1.0, float(f.chief.direction @ f.chief.normal))))),
        distortion_percent=distortion[0],
        calibrated_distortion_percent=distortion[1],
        relative_illumination=f.illumination / base.illumination,
        tangential_focus_mm=f.foci[0],
        sagittal_focus_mm=f.foci[1],
    )


def _height(f: _Field, axis: PointBundle, bundle: PointBundle) -> float:
    """Return tan θ of a field point at infinity, or the height, mm, of a near object point."""
    if bundle.near:
        return float((bundle.origin - axis.origin) @ axis.along)
    return float(np.tan(np.radians(f.angle)))


def _on_detector(path: DesignPath, point: np.ndarray) -> np.ndarray:
    """Return the coordinates x, y, (2,), mm, of a world point, (3,), mm, in the detector's plane."""
    opening = outline(path.table.shapes[path.table.detector])
    return np.array([(point - opening.centre) @ (side / np.linalg.norm(side)) for side in (opening.u, opening.v)])


def _fields(scene: Any, request: ImageRequest) -> tuple[list[float], list[str]]:
    """Return the field angles, degrees, and the names of the fields for error messages."""
    if request.field_mm is None:
        angles = [0.0] if request.field_deg is None else list(request.field_deg)
        return angles, [f"field {angle:g}°" for angle in angles]
    return [field_of(scene, height) for height in request.field_mm], [f"field {mm:g} mm" for mm in request.field_mm]


def _notes(scene: Any) -> list[str]:
    names = list(dict.fromkeys(source.name for source in scene_sources(scene)))
    return [f"of {len(names)} sources the first, '{names[0]}', is imaged"] if len(names) > 1 else []
