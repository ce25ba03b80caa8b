"""Pages of reports: closed tags, unique ids, links within, rows as wide as their heads, nothing from a network."""

import re
from html.parser import HTMLParser

VOID = {"meta", "img", "input", "br", "path", "use", "rect"}


class Page(HTMLParser):
    """Notes ids and links; a tag that is not closed fails."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        attributes = dict(attrs)
        if tag not in VOID:
            self.open.append(tag)
        if "svg" not in self.open:
            self.ids += [attributes["id"] or ""] if "id" in attributes else []
            self.links += [attributes[key] or "" for key in ("href", "src") if key in attributes]

    def handle_endtag(self, tag: str) -> None:
        if tag not in VOID:
            assert self.open.pop() == tag


def check(text: str) -> None:
    """Fails where a page is not whole, or needs anything beside itself."""
    page = Page(text)
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert all(link.startswith(("data:", "#")) for link in page.links)
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    without_namespaces = re.sub(r'xmlns(:\w+)?="[^"]*"', "", text)
    assert not re.search(r'(src|href)="(https?:)?//', without_namespaces)
    assert not re.search(r"@import|url\(\s*['\"]?http|fetch\(|XMLHttpRequest", without_namespaces)
    for table in re.findall(r"<table.*?</table>", text, re.DOTALL):
        assert len({len(re.findall(r"<t[dh][ >]", row)) for row in re.findall(r"<tr>.*?</tr>", table, re.DOTALL)}) == 1


def table_of(text: str, name: str) -> str:
    found = re.search(rf'<table id="{name}".*?</table>', text, re.DOTALL)
    assert found, name
    return found[0]
