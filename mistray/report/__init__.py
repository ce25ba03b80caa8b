"""Reports: printed tables, CSV, pictures, path-sort text and one self-contained HTML file."""

from mistray.report.baffle_plots import baffle_figure, cassegrain_figure
from mistray.report.colour import ColourPictures, Look
from mistray.report.csv_tables import write_csv
from mistray.report.html import html_text, write_html
from mistray.report.layout import layout
from mistray.report.objects_output import write_objects
from mistray.report.objects_plots import objects_layout
from mistray.report.objects_tables import objects_text
from mistray.report.output import writable_directory, write_all, write_png
from mistray.report.path_sort import SortedPath, parse_path_sort, path_sort_text
from mistray.report.plots import ghost_image, levels_against_field, montage
from mistray.report.pst_output import write_pst
from mistray.report.pst_tables import pst_text
from mistray.report.study_output import write_study
from mistray.report.study_tables import study_text
from mistray.report.tables import main_table, warnings
from mistray.report.text import with_error
from mistray.report.thermal import thermal_text, write_thermal

__all__ = [
    "ColourPictures",
    "Look",
    "SortedPath",
    "baffle_figure",
    "cassegrain_figure",
    "ghost_image",
    "html_text",
    "layout",
    "levels_against_field",
    "main_table",
    "montage",
    "objects_layout",
    "objects_text",
    "parse_path_sort",
    "path_sort_text",
    "pst_text",
    "study_text",
    "thermal_text",
    "warnings",
    "with_error",
    "writable_directory",
    "write_all",
    "write_csv",
    "write_html",
    "write_objects",
    "write_png",
    "write_pst",
    "write_study",
    "write_thermal",
]
