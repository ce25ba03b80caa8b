"""The gallery: all shipped scenes and notebooks with a picture, each with a page of its own."""

from __future__ import annotations

import json
import re
from pathlib import Path

from notebook_results import TOKEN, results
from notebook_results import names as notebooks
from notebook_results import shown as output_html
from page_code import scenes
from repository import MadePage

ROOT = Path(__file__).parents[2]
PICTURES = "images/gallery"
OUTPUTS: dict[str, str] = {}  # of cells as HTML, by the paragraph that stands for them in Markdown
INTRODUCTION = """\
# Gallery

All scenes and notebooks that come with mistray. A scene is loaded by its name, `mistray.load("plate")`, and
`mistray ghosts plate` takes the name as well. Its page says where its numbers come from.

"""


def navigation() -> list[object]:
    """The part of the navigation that the gallery is."""
    return [
        "gallery/index.md",
        {"Notebooks": [{title_of(name): f"notebooks/{name}.md"} for name in notebooks()]},
        {"Scenes": [{name: f"gallery/{name}.md"} for name in scenes()]},
    ]


def pages() -> dict[str, MadePage]:
    """The gallery and its pages."""
    made = {"gallery/index.md": MadePage(index())}
    made |= {f"gallery/{name}.md": MadePage(scene_page(name), f"scenes/{name}/SOURCE.md") for name in scenes()}
    made |= {f"notebooks/{name}.md": MadePage(notebook_page(name), f"notebooks/{name}.ipynb") for name in notebooks()}
    return made


def index() -> str:
    """All pictures, each a link to its page."""
    parts = [INTRODUCTION, "## Scenes\n"]
    parts.append(cards({f"{name}.md": (name, name, summary(source(name))) for name in scenes()}))
    parts.append("## Notebooks\n\nOpen them with Jupyter: `jupyter lab notebooks`.\n")
    parts.append(
        cards({f"../notebooks/{name}.md": (name, title_of(name), summary(prose(name))) for name in notebooks()})
    )
    return "\n".join(parts)


def cards(entries: dict[str, tuple[str, str, str]]) -> str:
    """A grid of pictures with titles and a sentence; keys are links, values names of pictures, titles and sentences."""
    lines = ['<div class="gallery" markdown>\n']
    for link, (name, title, text) in entries.items():
        lines.append(
            f"[![{title}](../{picture(name)}){{ loading=lazy }} **{title}** <span>{text}</span>]({link}){{ .card }}\n"
        )
    return "\n".join([*lines, "</div>\n"])


def picture(name: str) -> str:
    """File of the picture of a scene or a notebook, relative to docs/, for a link."""
    if not (ROOT / "docs" / PICTURES / f"{name}.png").is_file():
        raise FileNotFoundError(f"there is no picture of {name}; run: python docs/site/make_pictures.py")
    return f"{PICTURES}/{name}.png"


def source(name: str) -> str:
    """What SOURCE.md of a scene says."""
    return (ROOT / "scenes" / name / "SOURCE.md").read_text(encoding="utf-8")


def scene_page(name: str) -> str:
    """Picture of a scene, how to load it, and the sources of its numbers."""
    title, _, body = source(name).partition("\n")
    shown = f"![Layout of {name} with rays of its strongest paths](../../docs/{picture(name)}){{ .wide }}"
    use = f'```python\nscene = mistray.load("{name}")\n```\n\n```sh\nmistray view {name}\n```'
    files = ["scene.xml", "prescription.py"]
    named = [f"[{file}](../{name}/{file})" for file in files if (ROOT / "scenes" / name / file).is_file()]
    return f"{title}\n\n{shown}\n\n{use}\n\n## Source of the numbers\n\n{body.strip()}\n\nFiles: {', '.join(named)}.\n"


def cells(name: str) -> list[tuple[str, str]]:
    """Kinds and texts of the cells of a notebook."""
    content = json.loads((ROOT / "notebooks" / f"{name}.ipynb").read_text(encoding="utf-8"))
    return [(cell["cell_type"], "".join(cell["source"])) for cell in content["cells"]]


def title_of(name: str) -> str:
    """First heading of a notebook."""
    return cells(name)[0][1].partition("\n")[0].lstrip("# ")


def prose(name: str) -> str:
    """The first cell of a notebook, its title included."""
    return cells(name)[0][1]


def notebook_page(name: str) -> str:
    """A notebook with the picture that it makes, and the results of its cells if there are any of its present code."""
    (_, first), *rest = cells(name)
    found = results(name)
    title, _, body = first.partition("\n")
    shown = f"![A figure of this notebook](../docs/{picture(name)}){{ .wide }}"
    told = "shows its cells without their results" if found is None else "shows what its cells gave when it was built"
    parts = [title, shown, body.strip(), f"*To run it: `jupyter lab notebooks/{name}.ipynb`. This page {told}.*"]
    outputs = iter(found or [])
    for number, (kind, text) in enumerate(rest):
        of_cell = next(outputs, []) if kind == "code" else []
        if text:
            parts.append(f"```python\n{text}\n```" if kind == "code" else text)
        if of_cell:
            token = TOKEN.format(name=name, cell=number)
            OUTPUTS[token] = output_html(of_cell, f"figure {number} of this notebook")
            parts.append(token)
    return "\n\n".join(parts) + "\n"


def summary(text: str) -> str:
    """First sentence after the heading, without links and emphasis, at most 140 letters."""
    body = text.partition("\n")[2].strip().removeprefix("- ")
    flat = " ".join(re.split(r"\n\s*(?:\n|- )", body)[0].split())
    flat = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", flat)
    flat = re.sub(r"[*`]", "", re.split(r"(?<=[.:;])\s(?=[A-Z])", flat)[0])
    return flat if len(flat) <= 140 else flat[:140].rpartition(" ")[0].rstrip(",;:") + " …"
