"""Public names for reports, pictures and files of results, re-exported."""

# Written by tests/stubs.py from what the functions are when they run

from collections.abc import Iterable, Sequence
from pathlib import Path

import mitsuba as mi

from mistray.analyses.export.run import StepExport as StepExport
from mistray.analyses.ghosts.colour import ColourPictures as ColourPictures
from mistray.analyses.ghosts.figures.ghost_images import ghost_image as ghost_image
from mistray.analyses.ghosts.figures.ghost_images import levels_against_field as levels_against_field
from mistray.analyses.ghosts.figures.ghost_images import montage as montage
from mistray.analyses.ghosts.page.optional import report_section as report_section
from mistray.analyses.ghosts.page.output import write_all as write_all
from mistray.analyses.ghosts.page.output import write_png as write_png
from mistray.analyses.ghosts.page.report import html_text as html_text
from mistray.analyses.ghosts.page.report import write_html as write_html
from mistray.analyses.ghosts.path_sort_text import SortedPath as SortedPath
from mistray.analyses.ghosts.path_sort_text import parse_path_sort as parse_path_sort
from mistray.analyses.ghosts.path_sort_text import path_sort_text as path_sort_text
from mistray.analyses.ghosts.request import Look as Look
from mistray.analyses.ghosts.tables.ghosts_csv import write_csv as write_csv
from mistray.analyses.ghosts.tables.printed import main_table as main_table
from mistray.analyses.image.page import quality_text as quality_text
from mistray.analyses.image.page import write_quality as write_quality
from mistray.analyses.objects.figures import objects_layout as objects_layout
from mistray.analyses.objects.page import objects_text as objects_text
from mistray.analyses.objects.page import write_objects as write_objects
from mistray.analyses.pst.page import write_pst as write_pst
from mistray.analyses.pst.tables import pst_text as pst_text
from mistray.analyses.study.page import study_text as study_text
from mistray.analyses.study.page import write_study as write_study
from mistray.analyses.thermal.page import thermal_text as thermal_text
from mistray.analyses.thermal.page import write_thermal as write_thermal
from mistray.analyses.view.ray_files import read_rays as read_rays
from mistray.analyses.view.ray_files import write_rays as write_rays
from mistray.analyses.view.result import View as View
from mistray.files.irradiance_files import IrradianceMap as IrradianceMap
from mistray.files.irradiance_files import read_irradiance as read_irradiance
from mistray.files.irradiance_files import write_irradiance as write_irradiance
from mistray.files.parquet import write_parquet as write_parquet
from mistray.toolkit.drawings.baffles import baffle_figure as baffle_figure
from mistray.toolkit.drawings.baffles import cassegrain_figure as cassegrain_figure
from mistray.toolkit.drawings.path_polylines import RayLine as RayLine
from mistray.toolkit.drawings.path_polylines import rays_of_paths as rays_of_paths
from mistray.toolkit.drawings.section_layout import layout as layout
from mistray.toolkit.drawings.section_layout import layout_figure as layout_figure
from mistray.toolkit.drawings.section_layout import write_layout as write_layout
from mistray.toolkit.pages.formats import write_formats as write_formats
from mistray.toolkit.pages.output import writable_directory as writable_directory
from mistray.toolkit.pages.own_sections import remove_section as remove_section
from mistray.toolkit.progress_bar import ProgressBar as ProgressBar
from mistray.toolkit.saved_result import load_result as load_result
from mistray.toolkit.tables.text import with_error as with_error
from mistray.trace import Trace

__all__ = [
    "ColourPictures",
    "IrradianceMap",
    "Look",
    "ProgressBar",
    "RayLine",
    "SortedPath",
    "StepExport",
    "View",
    "baffle_figure",
    "cassegrain_figure",
    "export_step",
    "ghost_image",
    "html_text",
    "layout",
    "layout_figure",
    "levels_against_field",
    "load_result",
    "main_table",
    "montage",
    "objects_layout",
    "objects_text",
    "parse_path_sort",
    "path_sort_text",
    "pst_text",
    "quality_text",
    "rays_of_paths",
    "read_irradiance",
    "read_rays",
    "remove_section",
    "report_section",
    "study_text",
    "thermal_text",
    "view",
    "with_error",
    "writable_directory",
    "write_all",
    "write_csv",
    "write_formats",
    "write_html",
    "write_irradiance",
    "write_layout",
    "write_objects",
    "write_parquet",
    "write_png",
    "write_pst",
    "write_quality",
    "write_rays",
    "write_study",
    "write_thermal",
]

def export_step(
    scene: mi.Scene,
    path: str | Path,
    field_deg: float | Iterable[float] | None = None,
    *,
    wavelength_nm: float | None = None,
    paths: int = 0,
    rays: int = 20000,
    rays_per_path: int = 10,
    mirror_thickness_mm: float | None = None,
    freeform_tolerance_mm: float = 1e-05,
    name: str = "system",
) -> StepExport:
    r"""
    Write a scene as a STEP file (AP214, mm): lenses, mirrors, mechanics, clear beams and stray paths by their names.

    Closed volumes are written as solids: lenses with their edges, walls of a closed cross-section, boxes and prisms of
    flat faces. Everything else is written as sheets, each face with the id of its shape. Planes, cylinders, cones,
    spheres and conics are exact. Even aspheres are B-splines turned about the axis, within 1e-6 mm of the sag, or 1e-7
    of their size if that is less. Freeforms are B-splines within `freeform_tolerance_mm`.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    path : str or Path
        File to write; one that exists is replaced.
    field_deg : float | Iterable[float], optional
        Fields whose clear beams are written, degrees; none: no beams. > -90 … < 90 degrees.
    wavelength_nm : float, optional
        Wavelength of beams and stray paths (the scene's), nm. 10 … 1e7 nm.
    paths : int, optional
        Strongest stray paths of each field, as polylines; without fields of the scene's own. 0 … 1e6.
    rays : int, optional
        Start rays of the trace that finds them. 1 … 4294967295.
    rays_per_path : int, optional
        Most rays of each path. 1 … 100000.
    mirror_thickness_mm : float, optional
        Makes round mirrors without a body solids with a flat back, nowhere thinner than this, mm (sheets). 1e-15 …
        1e12 mm.
    freeform_tolerance_mm : float, optional
        Largest distance of a B-spline from a freeform, mm. 1e-15 … 1e12 mm.
    name : str
        Name of the assembly.

    Returns
    -------
    StepExport

    Raises
    ------
    MistrayError
        If a value is out of range, a field has no light on the detector, no surface can be written in STEP, or the file
        cannot be written. Also if mirrors shall have a thickness and no light of the source reaches the detector.

    Examples
    --------
    >>> found = mistray.export_step(mistray.load("lens_and_window"), "lens.step", 0, paths=2, rays=2000)
    >>> found.path.name, found.solids
    ('lens.step', ('L1', 'window'))
    >>> found.beams, found.paths
    (('beam 0 deg',), ('0 deg: detector → window_rear, 0.959 W', '0 deg: detector → window_front, 0.826 W'))
    """

def view(
    scene: mi.Scene,
    trace: Trace | Sequence[Trace] | None = None,
    *,
    paths: int = 8,
    path_ids: int | str | Sequence[int | str] | None = None,
    classes: str | Sequence[str] | None = None,
    selection: str = "",
    box: Sequence[float] | None = None,
    rays: int = 10,
    colour: str | None = None,
    cut_deg: float = 180.0,
    cut_mm: float = 0.0,
    title: str = "scene",
) -> View:
    r"""
    Return a view of a scene in three dimensions, cut open, with the rays of its strongest paths.

    Parameters
    ----------
    scene : mi.Scene
        Loaded scene.
    trace : Trace or sequence of Trace, optional
        Traces of this scene; none: no rays and no fluxes. Of several, such as several fields, the rays of
        each are drawn, and the fluxes are summed.
    paths : int, optional
        Paths to draw, strongest first, each at its strongest wavelength. 0 … 1e6.
    path_ids : int | str | Sequence[int | str], optional
        These rows instead, by number, by name, as 'L2_rear -> L1_front', or by a filter (docs/rays.md).
    classes : str | Sequence[str], optional
        Rays by class instead of paths: direct, ghost, stray, all … on the detector; blocked, escaped, returned, or
        surfaces at which they arrive; backward: from the detector (docs/view.md).
    selection : str, optional
        Strongest rows, or rays by class, that pass a filter, as 'G(lens*) & !S' (docs/rays.md).
    box : Sequence[float], optional
        Of rays by class only those that land there on the detector, x0, x1, y0, y1, mm. -1e12 … 1e12 mm.
    rays : int, optional
        Most rays of each path or class. 1 … 100000.
    colour : {"flux", "absorbed", "irradiance", "role"}, optional
        Colours of surfaces: by the flux that reaches them, by what they absorb of it, by place where the trace has
        surface maps, or by what they are. The default is place with these, else flux, without a trace role.
    cut_deg : float, optional
        Azimuth of the half that is taken away, degrees about z from x: 180 takes x < 0, 90 takes y > 0; none: the
        whole scene is shown. -360 … 360 degrees.
    cut_mm : float, optional
        Distance of the cut from the z axis along that direction, mm. -1e12 … 1e12 mm.
    title : str
        Name of the optical system.

    Returns
    -------
    View
        View, shown by Jupyter; ``write("view.html")`` writes it to a file.

    Raises
    ------
    MistrayError
        If plotly is missing, a value is out of range or needs a trace or surface maps, the trace is of another scene,
        or the cut leaves nothing. Also if there are several traces and one has surface maps.

    Examples
    --------
    >>> scene = mistray.load("cooke_triplet")
    >>> view = mistray.view(scene, mistray.trace(scene, rays=10_000), paths=2, rays=5)
    >>> len(view.rays)
    10
    >>> view.write("view.html").name
    'view.html'
    """
