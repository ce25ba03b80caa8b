"""Names of reports, pictures and files of results, re-exported."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.analyses.export.run import StepExport, export_step
    from mistray.analyses.ghosts.colour import ColourPictures
    from mistray.analyses.ghosts.figures.ghost_images import ghost_image, levels_against_field, montage
    from mistray.analyses.ghosts.page.optional import report_section
    from mistray.analyses.ghosts.page.output import write_all, write_png
    from mistray.analyses.ghosts.page.report import html_text, write_html
    from mistray.analyses.ghosts.path_sort import SortedPath, parse_path_sort, path_sort_text
    from mistray.analyses.ghosts.request import Look
    from mistray.analyses.ghosts.tables.ghosts import main_table
    from mistray.analyses.ghosts.tables.ghosts_csv import write_csv
    from mistray.analyses.image.page import quality_text, write_quality
    from mistray.analyses.objects.figures import objects_layout
    from mistray.analyses.objects.page import objects_text, write_objects
    from mistray.analyses.pst.page import write_pst
    from mistray.analyses.pst.tables import pst_text
    from mistray.analyses.study.page import study_text, write_study
    from mistray.analyses.thermal.page import thermal_text, write_thermal
    from mistray.analyses.view.ray_files import read_rays, write_rays
    from mistray.analyses.view.result import View
    from mistray.analyses.view.run import view
    from mistray.files.irradiance_files import IrradianceMap, read_irradiance, write_irradiance
    from mistray.files.parquet import write_parquet
    from mistray.toolkit.drawings.baffles import baffle_figure, cassegrain_figure
    from mistray.toolkit.drawings.layout import layout, layout_figure, write_layout
    from mistray.toolkit.drawings.path_rays import RayLine, rays_of_paths
    from mistray.toolkit.pages.formats import write_formats
    from mistray.toolkit.pages.output import writable_directory
    from mistray.toolkit.pages.own_sections import remove_section
    from mistray.toolkit.tables.text import with_error

__all__ = lazy_package(
    __name__,
    {
        "mistray.analyses.export.run": ("StepExport", "export_step"),
        "mistray.analyses.ghosts.colour": ("ColourPictures",),
        "mistray.analyses.ghosts.page.output": ("write_all", "write_png"),
        "mistray.analyses.ghosts.page.optional": ("report_section",),
        "mistray.analyses.ghosts.page.report": ("html_text", "write_html"),
        "mistray.analyses.ghosts.path_sort": ("SortedPath", "parse_path_sort", "path_sort_text"),
        "mistray.analyses.ghosts.request": ("Look",),
        "mistray.analyses.ghosts.tables.ghosts": ("main_table",),
        "mistray.analyses.ghosts.tables.ghosts_csv": ("write_csv",),
        "mistray.analyses.image.page": ("quality_text", "write_quality"),
        "mistray.analyses.objects.figures": ("objects_layout",),
        "mistray.analyses.objects.page": ("objects_text", "write_objects"),
        "mistray.analyses.pst.page": ("write_pst",),
        "mistray.analyses.pst.tables": ("pst_text",),
        "mistray.analyses.study.page": ("study_text", "write_study"),
        "mistray.analyses.thermal.page": ("thermal_text", "write_thermal"),
        "mistray.analyses.view.ray_files": ("read_rays", "write_rays"),
        "mistray.analyses.view.result": ("View",),
        "mistray.analyses.view.run": ("view",),
        "mistray.files.irradiance_files": ("IrradianceMap", "read_irradiance", "write_irradiance"),
        "mistray.files.parquet": ("write_parquet",),
        "mistray.toolkit.drawings.baffles": ("baffle_figure", "cassegrain_figure"),
        "mistray.toolkit.drawings.layout": ("layout", "layout_figure", "write_layout"),
        "mistray.toolkit.drawings.path_rays": ("RayLine", "rays_of_paths"),
        "mistray.analyses.ghosts.figures.ghost_images": ("ghost_image", "levels_against_field", "montage"),
        "mistray.toolkit.pages.formats": ("write_formats",),
        "mistray.toolkit.pages.output": ("writable_directory",),
        "mistray.toolkit.pages.own_sections": ("remove_section",),
        "mistray.toolkit.tables.text": ("with_error",),
    },
)
