"""Public names for reports, pictures and files of results, re-exported."""

from mistray._lazy import lazy_package

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
        "mistray.toolkit.saved_result": ("load_result",),
        "mistray.toolkit.pages.own_sections": ("remove_section",),
        "mistray.toolkit.tables.text": ("with_error",),
    },
)
