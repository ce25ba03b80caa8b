"""The documentation site builds without a warning, its links lead somewhere, and its search answers questions."""

import html
import inspect
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest
import stubs
import vectors

from mistray.ranges import doc_of
from mistray.toolkit.fields import flat_fields

ROOT = Path(__file__).parents[1]
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-component-update",
    "--disable-background-networking", "--disable-sync", "--virtual-time-budget=60000", "--dump-dom",
)  # fmt: skip
QUESTIONS = vectors.toml("site_questions.toml")
# The site's own worker and index, asked as its search box asks them
DRIVER = vectors.text("site_search.html")
pytestmark = pytest.mark.long


class Page(HTMLParser):
    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.unnamed: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        of = {name: value or "" for name, value in attrs}
        self.ids |= {of[name] for name in ("id", "name") if name in of}
        if tag == "a" and "href" in of:
            self.links.append(of["href"])
        elif tag == "link" and of.get("rel") not in ("canonical", "prev", "next"):
            self.loaded.append(of["href"])
        elif "src" in of:
            self.loaded.append(of["src"])
        if tag == "img" and not of.get("alt"):
            self.unnamed.append(of.get("src", ""))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("material", reason="the site needs the dependency group docs")
    pytest.importorskip("mkdocstrings")
    folder = tmp_path_factory.mktemp("site") / "docs"
    done = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT, capture_output=True, text=True, timeout=300, env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
    )  # fmt: skip
    told = [line for line in done.stderr.splitlines() if not line.startswith("INFO")]
    assert done.returncode == 0, "\n".join(told)
    assert not told
    return folder


@pytest.fixture(scope="module")
def pages(site: Path) -> dict[str, Page]:
    found = {file.relative_to(site).as_posix(): Page(file.read_text(encoding="utf-8")) for file in site.rglob("*.html")}
    del found["404.html"]  # made for a server, which knows where the site is
    return found


def targets(page: str, links: list[str]) -> Iterator[tuple[str, str]]:
    """Files and anchors, relative to the site, that the links of a page lead to within the site."""
    for link in links:
        parts = urlsplit(link)
        if not parts.scheme and not parts.netloc:
            path = os.path.normpath(Path(page).parent / unquote(parts.path)) if parts.path else page
            yield path, unquote(parts.fragment)


def test_links_lead_somewhere_and_nothing_comes_from_the_network(site: Path, pages: dict[str, Page]) -> None:
    missing = []
    for name, page in pages.items():
        for path, anchor in targets(name, page.links + page.loaded):
            if not (site / path).is_file() or (anchor and path in pages and anchor not in pages[path].ids):
                missing.append(f"{name}: {path}#{anchor}")
    assert len(pages) > 120
    assert not missing
    assert not [(name, url) for name, page in pages.items() for url in page.unnamed]  # pictures without words
    assert not [(name, url) for name, page in pages.items() for url in page.loaded if re.match(r"(https?:)?//", url)]
    for sheet in site.rglob("*.css"):
        assert not re.search(r"(url\(|@import )['\"]?(https?:)?//", sheet.read_text(encoding="utf-8")), sheet


def test_every_public_name_is_there(pages: dict[str, Page]) -> None:
    import mistray

    documented = {name for page in pages.values() for name in page.ids}
    for name in set(mistray.__all__) - {"__version__"}:  # a text that every package has
        thing = getattr(mistray, name)
        if isinstance(thing, type) or callable(thing):
            places = {f"{home}.{name}" for home in (thing.__module__, mistray._homes.get(name))}
            assert places & documented, name
        elif name == "scenes":
            assert {f"gallery/{scene}.html" for scene in thing.__all__} <= set(pages)
        else:
            assert f"reference/{name}.html" in pages, name


def test_analyses_have_the_keywords_and_sentences_of_help(site: Path) -> None:
    missing = []
    for name in stubs.analyses():
        package, function = name.rpartition(".")[0], stubs.named(name)
        page = (site / "reference" / f"{package.partition('.')[2]}.html").read_text(encoding="utf-8")
        part = page.partition(f'id="{name}"')[2].partition("<h2 id=")[0]
        text = " ".join(html.unescape(re.sub(r"<[^>]+>", "", part)).split())
        sentences = [doc_of(field).replace("`", "") for field, _ in flat_fields(function.request)]
        wanted = [*inspect.signature(function).parameters, *(text[:1].upper() + text[1:] for text in sentences)]
        missing += [f"{name}: {words}" for words in wanted if words not in text]
    assert not missing


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium to search in; install chromium")
def test_questions_are_answered(site: Path, tmp_path: Path) -> None:
    assert len(QUESTIONS) == 20
    (worker,) = site.glob("assets/javascripts/workers/search.*.js")
    page = site / "driver.html"
    page.write_text(DRIVER % (worker.relative_to(site).as_posix(), json.dumps(list(QUESTIONS))), encoding="utf-8")
    done = subprocess.run(
        [str(CHROMIUM), *FLAGS, f"--user-data-dir={tmp_path}", page.as_uri()],
        capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    page.unlink()
    match = re.search(r'data-found="([^"]*)"', done.stdout)
    assert match, done.stderr[-2000:]
    found = json.loads(html.unescape(match[1]))
    wrong = {}
    for question, wanted in QUESTIONS.items():
        hits = [location.partition("#")[0].removesuffix(".html") for location in found[question]]
        if not set(hits[:2]) & set(wanted):
            wrong[question] = hits
    assert not wrong
