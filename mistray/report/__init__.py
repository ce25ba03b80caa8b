"""Reports: printed tables, CSV, pictures, path-sort text and one self-contained HTML file."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.analyses.export.run import StepExport, export_step
    from mistray.analyses.image.page import quality_text, write_quality
    from mistray.analyses.study.page import study_text, write_study
    from mistray.analyses.thermal.page import thermal_text, write_thermal
    from mistray.files.irradiance_files import IrradianceMap, read_irradiance, write_irradiance
    from mistray.files.parquet import write_parquet
    from mistray.report.baffle_plots import baffle_figure, cassegrain_figure
    from mistray.report.colour import ColourPictures, Look
    from mistray.report.figures.layout import layout, layout_figure, write_layout
    from mistray.report.figures.objects import objects_layout
    from mistray.report.figures.plots import ghost_image, levels_against_field, montage
    from mistray.report.formats import write_formats
    from mistray.report.ghosts.report import html_text, write_html
    from mistray.report.ghosts_output import write_all, write_png
    from mistray.report.objects_output import objects_text, write_objects
    from mistray.report.output import writable_directory
    from mistray.report.own_sections import remove_section, report_section
    from mistray.report.pst_output import write_pst
    from mistray.report.rays.path_rays import RayLine, rays_of_paths
    from mistray.report.rays.path_sort import SortedPath, parse_path_sort, path_sort_text
    from mistray.report.rays.ray_files import read_rays, write_rays
    from mistray.report.tables.ghosts import main_table
    from mistray.report.tables.ghosts_csv import write_csv
    from mistray.report.tables.pst import pst_text
    from mistray.report.tables.text import with_error
    from mistray.report.view3d.view import View, view

__all__ = lazy_package(
    __name__,
    {
        "baffle_plots": ("baffle_figure", "cassegrain_figure"),
        "colour": ("ColourPictures", "Look"),
        "tables.ghosts_csv": ("write_csv",),
        "formats": ("write_formats",),
        "ghosts.report": ("html_text", "write_html"),
        "mistray.files.irradiance_files": ("IrradianceMap", "read_irradiance", "write_irradiance"),
        "figures.layout": ("layout", "layout_figure", "write_layout"),
        "objects_output": ("objects_text", "write_objects"),
        "figures.objects": ("objects_layout",),
        "ghosts_output": ("write_all", "write_png"),
        "output": ("writable_directory",),
        "mistray.files.parquet": ("write_parquet",),
        "rays.path_rays": ("RayLine", "rays_of_paths"),
        "rays.path_sort": ("SortedPath", "parse_path_sort", "path_sort_text"),
        "figures.plots": ("ghost_image", "levels_against_field", "montage"),
        "own_sections": ("remove_section", "report_section"),
        "pst_output": ("write_pst",),
        "tables.pst": ("pst_text",),
        "rays.ray_files": ("read_rays", "write_rays"),
        "mistray.analyses.export.run": ("StepExport", "export_step"),
        "mistray.analyses.study.page": ("study_text", "write_study"),
        "tables.ghosts": ("main_table",),
        "tables.text": ("with_error",),
        "mistray.analyses.image.page": ("quality_text", "write_quality"),
        "mistray.analyses.thermal.page": ("thermal_text", "write_thermal"),
        "view3d.view": ("View", "view"),
    },
)
