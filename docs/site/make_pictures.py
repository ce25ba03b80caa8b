"""Draws the pictures that the README, the pages and the gallery show, where what they are made of has changed.

    python docs/site/make_pictures.py [NAME ...]

`make docs` calls it. It draws layouts of the shipped scenes, figures of the notebooks, what commands of
`picture_record` draw, and what functions of `page_pictures` draw. A name is that of pictures, such as plate.
"""

from __future__ import annotations

import base64
import functools
import io
import subprocess
import sys
import tempfile
from pathlib import Path

from notebook_results import last_picture, names, results, run
from page_code import ROOT, page_functions, scenes
from picture_record import COMMANDS, inputs, keep, picture, stale
from PIL import Image

GALLERY_WIDTH, PAGE_WIDTH, COLOURS = 760, 1100, 256
RAYS = 4000


def draw(name: str) -> bytes | None:
    """Content of a picture; None if it cannot be drawn here."""
    stem = Path(name).stem
    if name in COMMANDS:
        return draw_command(name)
    if name in page_functions():
        from page_pictures import drawn

        return small(drawn(stem), PAGE_WIDTH)
    png = draw_scene(stem) if stem in scenes() else draw_notebook(stem)
    return small(png, GALLERY_WIDTH) if png is not None else None


def draw_command(name: str) -> bytes:
    """What a command or an example draws."""
    command, written = COMMANDS[name]
    return written_by(command)[written]


@functools.cache
def written_by(command: str) -> dict[str, bytes]:
    """The pictures that a command or an example writes, by the names of their files."""
    with tempfile.TemporaryDirectory() as folder:
        words = [word.format(folder=folder) for word in command.split()]
        if words[0].endswith(".py"):
            words[0] = str(ROOT / words[0])
        else:
            words = ["-m", "mistray", *words]
        subprocess.run([sys.executable, *words], check=True, stdout=subprocess.DEVNULL)
        return {file.name: file.read_bytes() for file in Path(folder).iterdir() if file.suffix in (".png", ".svg")}


def draw_scene(name: str) -> bytes:
    """Layout of a scene with the rays of its strongest paths, as `mistray view NAME --layout` draws it."""
    import mistray
    from mistray.report import layout_figure, write_layout

    scene = mistray.load(name)
    figure = layout_figure(scene, mistray.trace(scene, rays=RAYS))
    with tempfile.TemporaryDirectory() as folder:
        return write_layout(figure, Path(folder) / "layout.png").read_bytes()


def draw_notebook(name: str) -> bytes | None:
    """The last figure that a notebook makes when it runs; None if it cannot run here."""
    if results(name) is None and not run(name):
        return None
    png = last_picture(name)
    if png is None:
        raise SystemExit(f"notebooks/{name}.ipynb makes no figure; let it make one, which the gallery shows")
    return base64.b64decode(png)


def small(png: bytes, width: int) -> bytes:
    """A picture, at most so many pixels wide, with few colours."""
    image = Image.open(io.BytesIO(png)).convert("RGBA")
    on_white = Image.new("RGBA", image.size, "white")
    on_white.alpha_composite(image)
    shown = on_white.convert("RGB")
    if shown.width > width:
        shown = shown.resize((width, round(shown.height * width / shown.width)), Image.Resampling.LANCZOS)
    buffer = io.BytesIO()
    # The other methods split what there is much of, such as white paper, and join the blue and the green of thin curves
    shown.quantize(COLOURS, method=Image.Quantize.MAXCOVERAGE, kmeans=3).save(buffer, "PNG", optimize=True)
    return buffer.getvalue()


def main() -> int:
    """Draw what is named, or what is stale."""
    stems = {Path(name).stem for name in inputs()}
    asked = {Path(name).stem for name in sys.argv[1:]}
    if unknown := asked - stems:
        raise SystemExit(
            f"{', '.join(sorted(unknown))}: no picture of this name; give one of {', '.join(sorted(stems))}"
        )
    given = [name for name in inputs() if Path(name).stem in asked] if asked else stale()
    for name in sorted(given, key=lambda one: Path(one).stem in names()):  # notebooks take longest
        content = draw(name)
        if content is None:
            continue
        picture(name).parent.mkdir(exist_ok=True)
        picture(name).write_bytes(content)
        keep(name)
        print(f"docs/images/{name}: {len(content)} bytes", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
