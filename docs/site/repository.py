"""Files outside of docs/ that pages link to, as pages of the site: Markdown as it is, others as highlighted text."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

ROOT = Path(__file__).parents[2]
# The target of a link or a picture that is no address and no place on the same page
LINK = re.compile(r"(?<=\]\()(?!https?:|mailto:|#)([^)#\s]+)(#[^)\s]*)?(?=\))")
CODE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
# A page of docs/ that a text names without a link
NAMED = re.compile(r"(?<![\w/`(\[])docs/([\w/]+\.md)\b(?!\]|`)")
LANGUAGES = {".py": "python", ".toml": "toml", ".xml": "xml", ".json": "json", ".txt": "text", ".csv": "text"}
PICTURES = (".png", ".svg")
# What stands for a file or a folder of the repository
MADE = {
    "README.md": "index.md",
    "mistray": "reference/index.md",
    "mistray/cli": "reference/commands.md",
    "notebooks": "gallery/index.md#notebooks",
    "scenes": "gallery/index.md",
}
READ_BESIDE = ("CONTRIBUTING.md", "CODE_OF_CONDUCT.md", "CHANGELOG.md", "SECURITY.md", "benchmarks/README.md")
TITLES = ("Contributing", "Code of conduct", "Changes", "Security", "Measured speed")


@dataclass(frozen=True)
class MadePage:
    """
    A page that is no file of docs/.

    Attributes
    ----------
    text : str
        Markdown; "" for a picture.
    origin : str
        The file in the repository to which its links are relative; "" where they are those of the site.
    """

    text: str
    origin: str = ""


class Repository:
    """Which file of the repository is which page of the site."""

    def __init__(self) -> None:
        self.origins: dict[str, str] = {}

    def navigation(self) -> list[dict[str, object]]:
        """The files that are worth reading by themselves."""
        pages = [{title: page_of(name)} for name, title in zip(READ_BESIDE, TITLES, strict=True)]
        return [{"Project": pages}]

    def follow(self, pages: Mapping[str, str], origins: Mapping[str, str]) -> dict[str, MadePage]:
        """
        Pages for the files that pages link to, and for those that these link to.

        Parameters
        ----------
        pages : mapping of str to str
            Pages of the site and their Markdown.
        origins : mapping of str to str
            Files in the repository to which the links of some pages are relative.
        """
        self.origins = {uri: origin for uri, origin in origins.items() if origin}
        made: dict[str, MadePage] = {}
        waiting = [self._target(uri, match[1]) for uri, text in pages.items() for match in links(text)]
        waiting += READ_BESIDE
        while waiting:
            file = waiting.pop()
            uri = page_of(file)
            if not uri or uri in made or file.startswith("docs/") or uri in pages or not (ROOT / file).is_file():
                continue
            if file.endswith(PICTURES):
                made[uri] = MadePage("", file)
                continue
            text = (ROOT / file).read_text(encoding="utf-8")
            if file.endswith(".md"):
                made[uri] = MadePage(text, file)
                self.origins[uri] = file
                waiting += [self._target(uri, match[1]) for match in links(text)]
            else:
                made[uri] = MadePage(source_page(file, text))
        return made

    def with_links(self, uri: str, text: str) -> str:
        """The Markdown of a page, its links to files of the repository turned to pages of the site."""
        if uri in self.origins:
            text = outside_code(text, lambda part: NAMED.sub(self._named(uri), part))

        def turned(match: re.Match[str]) -> str:
            target = page_of(self._target(uri, match[1]))
            if not target or (uri not in self.origins and not match[1].startswith("../")):
                return match[0]
            path, anchor, own = target.partition("#")
            return relative(path, uri) + (match[2] or anchor + own)

        return outside_code(text, lambda part: LINK.sub(turned, part))

    def _named(self, uri: str) -> Callable[[re.Match[str]], str]:
        def link(match: re.Match[str]) -> str:
            up = "../" * len(PurePosixPath(self.origins[uri]).parent.parts)
            return f"[{match[1].removesuffix('.md')}]({up}docs/{match[1]})"

        return link

    def _target(self, uri: str, link: str) -> str:
        """The file of the repository that a link of a page leads to."""
        base = PurePosixPath(self.origins.get(uri, f"docs/{uri}")).parent
        return os.path.normpath(base / link)


def links(text: str) -> list[re.Match[str]]:
    """Links of Markdown to files, outside of code."""
    return list(LINK.finditer(CODE.sub("", text)))


def outside_code(text: str, change: Callable[[str], str]) -> str:
    """Markdown with a change to all but its blocks of code."""
    parts = re.split(r"(^```.*?^```)", text, flags=re.MULTILINE | re.DOTALL)
    return "".join(part if k % 2 else change(part) for k, part in enumerate(parts))


def page_of(file: str) -> str:
    """Page of the site for a file or a folder of the repository; "" where there is none."""
    parts = PurePosixPath(file).parts
    if parts[:1] == ("docs",):
        return "/".join((*parts[1:], "index.md")) if (ROOT / file).is_dir() else "/".join(parts[1:])
    if file in MADE:
        return MADE[file]
    if parts[:1] == ("notebooks",):
        return f"notebooks/{PurePosixPath(file).stem}.md"
    if parts[:1] == ("scenes",) and parts[2:] in ((), ("SOURCE.md",)):
        return f"gallery/{parts[1]}.md"
    if not (ROOT / file).is_file():
        return ""
    return f"repository/{file}" if file.endswith((".md", *PICTURES)) else f"source/{file}.md"


def relative(target: str, uri: str) -> str:
    """Link from a page of the site to another one."""
    return os.path.relpath(target, PurePosixPath(uri).parent)


def source_page(file: str, text: str) -> str:
    """A file as a page."""
    language = LANGUAGES.get(PurePosixPath(file).suffix, "text")
    return f"# {PurePosixPath(file).name}\n\n`{file}`\n\n````{language}\n{text.rstrip()}\n````\n"
