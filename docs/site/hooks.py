"""What mkdocs calls while it builds the site: pages that are made from the repository, and links that lead into it.

Made are the reference (`reference`), the gallery with a page for each scene and notebook (`gallery`), and a page for
each file outside of docs/ that a page links to (`repository`). All else is Markdown in docs/, listed in mkdocs.yml.
"""

from __future__ import annotations

import re
from typing import Any

import gallery
import reference
from formulas import with_formulas
from mkdocs.structure.files import File
from repository import ROOT, Repository

# How much a page counts in a search, by its folder or its name; questions are what people come with
BOOST = {
    "questions": 4.0, "index.md": 2.0, "coming_from.md": 2.0, "extending.md": 2.0, "glossary.md": 2.0, "guide.md": 1.5,
    "lens_files.md": 0.5, "validation": 0.5, "plugins": 0.6, "gallery": 0.6, "notebooks": 0.6, "reference": 0.4,
    "imported_files.md": 0.2, "repository": 0.2, "capabilities.md": 0.5, "commands.md": 0.5, "governance.md": 0.5,
    "releases.md": 0.5, "scenes_and_notebooks.md": 0.5, "support.md": 0.5, "support_matrix.md": 0.5,
}  # fmt: skip
REPOSITORY = Repository()


def on_config(config: Any) -> Any:
    """Complete the navigation by the pages that are made here."""
    for entry in config.nav:
        if "Gallery" in entry:
            entry["Gallery"] = gallery.navigation()
        if "Reference" in entry:
            entry["Reference"] = [*reference.navigation(), *REPOSITORY.navigation()]
    return config


def on_files(files: Any, *, config: Any) -> Any:
    """Add the pages that are made here, and those that pages link to."""
    made = gallery.pages() | reference.pages()
    for uri, page in made.items():
        files.append(File.generated(config, uri, content=page.text))
    known = {file.src_uri: file.content_string for file in files.documentation_pages()}
    for uri, page in REPOSITORY.follow(known, {uri: page.origin for uri, page in made.items()}).items():
        shown = {"content": page.text} if page.text else {"abs_src_path": str(ROOT / page.origin)}
        files.append(File.generated(config, uri, **shown))
    return files


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Turn links that leave docs/ to the pages that were made for them."""
    folder = page.file.src_uri.partition("/")[0]
    if folder == "source":
        page.meta["search"] = {"exclude": True}
    elif folder in BOOST:
        page.meta["search"] = {"boost": BOOST[folder]}
    if page.file.src_uri == "index.md":
        page.meta["hide"] = ["navigation"]
    return REPOSITORY.with_links(page.file.src_uri, markdown)


def on_page_content(html: str, **_: Any) -> str:
    """Formulas as MathML, results of notebooks in their places, numbers with their errors, nothing for Git alone."""
    html = re.sub(r"(?<=\d) ± (?=\d)", "\u00a0±\u00a0", html)
    page = with_formulas(re.sub(r"<!-- .*? -->\n?", "", html))
    return re.sub(r"<p>(notebook-output-[\w-]+)</p>", lambda found: gallery.OUTPUTS.get(found[1], ""), page)
