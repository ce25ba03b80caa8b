"""Pictures of the README, the pages and the gallery: none is older than what it is made of."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.insert(0, str(ROOT / "docs" / "site"))
import notebook_results  # noqa: E402
import page_code  # noqa: E402
import picture_record  # noqa: E402

pytestmark = pytest.mark.quick


def test_pictures_are_made_of_what_is_there():
    """`make docs` draws what a change of a scene, a notebook, a command, a page or the drawing code has made stale."""
    assert picture_record.stale() == [], "make docs draws them"
    assert set(picture_record.record()) == set(picture_record.inputs())
    assert picture_record.pictures() == sorted(picture_record.inputs()), "a picture that nothing draws would grow old"


def test_what_a_function_of_a_page_draws_from():
    """Blocks and tables of pages, scenes, modules of analyses, and for a screenshot what a page looks like."""
    made_of = {name: "\n".join(texts) for name, texts in page_code.page_functions().items()}
    for name, text in (
        ("bodies_cube.png", "beam_splitter_cube("),  # a block of its page
        ("diffraction_ring.png", "def turned("),  # a function that it calls
        ("phone_camera_pst.png", "| angle ° |"),
        ("image_quality_mtf.png", page_code.scene("cooke_triplet")),
        ("pst_phone_camera.png", "def pst_curve("),
        ("report_top.png", "prefers-color-scheme: dark"),
        ("view_triplet.png", "def surface_mesh("),
        ("explorer.png", ".mistray-explorer .grid"),
    ):
        assert text in made_of[name], name


def test_commands_of_pictures_and_outputs_of_cells():
    pages = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
    texts = [file.read_text(encoding="utf-8") for file in pages]
    words = " ".join(" ".join(texts).split())
    for name, (command, _) in picture_record.COMMANDS.items():
        assert f"images/{name}" in words
        call = re.sub(r" (--(out|plot|layout) )?\{folder\}.*", "", command)
        told = call if call.endswith(".py") else f"mistray {call}"
        assert told in words, told
    stream = {"output_type": "stream", "name": "stdout", "text": ["a <b>\n"] * 50}
    picture = {"output_type": "display_data", "data": {"image/png": "QQ==\n", "text/plain": "<Figure>"}}
    data = {"text/html": "<iframe srcdoc='x'></iframe>", "text/plain": "View"}
    view = {"output_type": "execute_result", "data": data}
    error = {"output_type": "stream", "name": "stderr", "text": "a warning"}
    page = notebook_results.shown([stream, picture, view, error], "a figure")
    assert page.count("a &lt;b&gt;") == 40
    assert "and 10 more lines" in page
    assert 'alt="a figure" src="data:image/png;base64,QQ=="' in page
    assert "iframe" not in page
    assert "a warning" not in page
    assert notebook_results.shown([], "") == ""
    assert notebook_results.results("no_such_notebook") is None
