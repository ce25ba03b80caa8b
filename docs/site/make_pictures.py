"""Draws the pictures of the gallery: the layout of each shipped scene, and a figure that each notebook makes.

    python docs/site/make_pictures.py [NAME ...]

Without names it draws what has no picture yet. A scene takes seconds, a notebook runs as a whole. The pictures are
small PNG files in docs/images/gallery, and the site is not built without them.
"""

from __future__ import annotations

import base64
import io
import sys
import tempfile
from pathlib import Path

from gallery import ROOT, notebooks, picture_file, scenes
from PIL import Image

WIDTH, COLOURS = 760, 96
RAYS = 4000


def draw_scene(name: str) -> bytes:
    """Layout of a scene with the rays of its strongest paths, as `mistray view NAME --layout` draws it."""
    import mistray
    from mistray.report import layout_figure, write_layout

    scene = mistray.load(name)
    figure = layout_figure(scene, mistray.trace(scene, rays=RAYS))
    with tempfile.TemporaryDirectory() as folder:
        return write_layout(figure, Path(folder) / "layout.png").read_bytes()


def draw_notebook(name: str) -> bytes:
    """The last figure that a notebook makes when it runs."""
    import nbformat
    from nbclient import NotebookClient

    notebook = nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", as_version=4)
    with tempfile.TemporaryDirectory() as folder:
        client = NotebookClient(notebook, timeout=3000, kernel_name="python3", resources={"metadata": {"path": folder}})
        client.execute()
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    figures = [output["data"]["image/png"] for output in outputs if "image/png" in output.get("data", {})]
    return base64.b64decode(figures[-1])


def save_small(file: Path, png: bytes, width: int = WIDTH) -> None:
    """Write a picture, at most so many pixels wide, with few colours."""
    image = Image.open(io.BytesIO(png)).convert("RGBA")
    on_white = Image.new("RGBA", image.size, "white")
    on_white.alpha_composite(image)
    small = on_white.convert("RGB")
    if small.width > width:
        small = small.resize((width, round(small.height * width / small.width)), Image.Resampling.LANCZOS)
    file.parent.mkdir(exist_ok=True)
    small.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE).save(file, optimize=True)
    print(file.relative_to(ROOT), file.stat().st_size, "bytes", flush=True)


def main() -> int:
    """Draw what is named, or what is missing."""
    drawn = dict.fromkeys(scenes(), draw_scene) | dict.fromkeys(notebooks(), draw_notebook)
    names = sys.argv[1:] or [name for name in drawn if not picture_file(name).exists()]
    if unknown := set(names) - set(drawn):
        raise SystemExit(f"{', '.join(sorted(unknown))}: neither a scene nor a notebook")
    for name in names:
        save_small(picture_file(name), drawn[name](name))
    return 0


if __name__ == "__main__":
    sys.exit(main())
