"""Reports: printed tables, CSV, pictures, path-sort text and one self-contained HTML file."""

from mistray.report.colour import ColourPictures, Look
from mistray.report.csv_tables import write_csv
from mistray.report.html import html_text, write_html
from mistray.report.layout import layout
from mistray.report.output import writable_directory, write_all, write_png
from mistray.report.path_sort import SortedPath, parse_path_sort, path_sort_text
from mistray.report.plots import ghost_image, levels_against_field, montage
from mistray.report.tables import main_table, warnings
from mistray.report.text import with_error

__all__ = [
    "ColourPictures",
    "Look",
    "SortedPath",
    "ghost_image",
    "html_text",
    "layout",
    "levels_against_field",
    "main_table",
    "montage",
    "parse_path_sort",
    "path_sort_text",
    "warnings",
    "with_error",
    "writable_directory",
    "write_all",
    "write_csv",
    "write_html",
    "write_png",
]
