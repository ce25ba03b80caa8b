"""What people read: no sentence of the pages, the help and the messages is long, and no old name stands there."""

import re
from pathlib import Path

import pytest
from sentences import literals, of_text, pages, sentences, words

ROOT = Path(__file__).parents[1]
MOST = 30  # words of a sentence
PAGES = pages(ROOT)
PACKAGE = ROOT / "mistray"
FOLDERS = [PACKAGE, *sorted({source.parent for source in PACKAGE.glob("*/__init__.py")}), ROOT / "plugins"]
# Old names of arguments and options, and words that the glossary has another one for
OLD = re.compile(
    r"\bfields_deg\b|--pst-deg\b|--map-angles-deg\b|--fields-deg\b|\btop\(by=|\b(?:thrift|boost|offspring)\b"
    r"|walks? in reverse|rays with the light|rays against the light",
    re.IGNORECASE,
)
CODE = re.compile(r"[{};]\s*$|^\s*(import|from|const|let|for|return)\b|</\w+>", re.MULTILINE)


def messages(folder: Path) -> list[tuple[str, str]]:
    """Place and text of every literal of a folder with blanks in it that is no code of another language."""
    below = folder.glob("*.py") if folder.name == "mistray" else folder.rglob("*.py")
    return [
        (f"{source.relative_to(ROOT)}:{line}", text)
        for source in sorted(below)
        for line, text in literals(source.read_text(encoding="utf-8"))
        if " " in text and not CODE.search(text)
    ]


def test_what_counts_as_a_sentence() -> None:
    page = "# Title\n\nOne is short. `a.b`, `c` and `d` are\n[two](x.md#y.z).\n"
    page += "\n    code here\n\n| 1 | two. Three |\n"
    found = list(sentences(page + "```python\nx = 1\n```\n- an item\n  of two lines\n- another\n"))
    assert found == [
        "Title", "One is short.", "Name are two.", "1", "two.", "Three", "an item of two lines", "another",
    ]  # fmt: skip
    assert words("rays are placed to 1e-3 mm … there") == 7
    assert list(literals('"""No."""\nx = f"a {1} b" + "c"\n')) == [(2, "a Name b"), (2, "c")]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_pages(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert [sentence for sentence in sentences(text) if words(sentence) > MOST] == []
    assert OLD.findall(text) == []


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_messages_and_help(folder: Path) -> None:
    found = messages(folder)
    paragraphs = [(place, part) for place, text in found for part in re.split(r"\n\s*\n", text)]
    assert [f"{place}: {one}" for place, part in paragraphs for one in of_text(part) if words(one) > MOST] == []
    assert [f"{place}: {text}" for place, text in found if OLD.search(text)] == []
