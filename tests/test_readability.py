"""What people read: no long sentence, no old name in pages, help, messages; no private word for a term of the field."""

import io
import re
import tokenize
from pathlib import Path

import pytest
import vectors
from sentences import literals, of_text, pages, sentences, words

ROOT = Path(__file__).parents[1]
MOST = 30  # words of a sentence
PACKAGE = ROOT / "mistray"
FOLDERS = [PACKAGE, *sorted({source.parent for source in PACKAGE.glob("*/__init__.py")}), ROOT / "plugins"]
# Old names of arguments and options, and words that the glossary has another one for
OLD = re.compile(
    r"\bfields_deg\b|--pst-deg\b|--map-angles-deg\b|--fields-deg\b|\btop\(by=|\b(?:thrift|boost|offspring)\b"
    r"|walks? in reverse|rays with the light|rays against the light",
    re.IGNORECASE,
)
CODE = re.compile(r"[{};]\s*$|^\s*(import|from|const|let|for|return)\b|</\w+>", re.MULTILINE)


def test_what_counts_as_a_sentence() -> None:
    page = "# Title\n\nOne is short. `a.b`, `c` and `d` are\n[two](x.md#y.z).\n"
    page += "\n    code here\n\n| 1 | two. Three |\n"
    assert list(sentences(page + "```python\nx = 1\n```\n- an item\n  of two lines\n- another\n")) == [
        "Title", "One is short.", "Name are two.", "1", "two.", "Three", "an item of two lines", "another",
    ]  # fmt: skip
    assert words("rays are placed to 1e-3 mm … there") == 7
    assert list(literals('"""No."""\nx = f"a {1} b" + "c"\n')) == [(2, "a Name b"), (2, "c")]


@pytest.mark.parametrize("page", pages(ROOT), ids=lambda page: page.relative_to(ROOT).as_posix())
def test_pages(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert [sentence for sentence in sentences(text) if words(sentence) > MOST] == []
    assert OLD.findall(text) == []


@pytest.mark.parametrize("folder", FOLDERS, ids=lambda folder: folder.name)
def test_messages_and_help(folder: Path) -> None:
    """Of every literal with blanks in it that is no code of another language."""
    below = folder.glob("*.py") if folder.name == "mistray" else folder.rglob("*.py")
    found = [
        (f"{source.relative_to(ROOT)}:{line}", text)
        for source in sorted(below)
        for line, text in literals(source.read_text(encoding="utf-8"))
        if " " in text and not CODE.search(text)
    ]
    paragraphs = [(place, part) for place, text in found for part in re.split(r"\n\s*\n", text)]
    assert [f"{place}: {one}" for place, part in paragraphs for one in of_text(part) if words(one) > MOST] == []
    assert [f"{place}: {text}" for place, text in found if OLD.search(text)] == []


MODULES = Path(__file__).parents[1] / "mistray"
ENGINE = ("kernel", "recorders", "sampling", "execute", "gradients", "trace", "analyses/pst")
PRIVATE = {word: term for term, words in vectors.toml("terms.toml").items() for word in words.split()}
LOCAL = {"many": "the number of what"}  # a name by itself; `as_many` and `too_many` are plain English
# Words of comments, docstrings and messages; "by chance", "told apart" and "not worth" are plain English
PROSE = (
    "rivals?", "rivalry", "joints?", "births?", "clouds?", "clouded", "booked", "trunk", "stock", "wanted", "knows",
    "p_against", "w_against",
)  # fmt: skip
# Ordinary uses
ALLOWED = {
    ("analyses/pst/pilot.py", "odds"),  # p/(1 - p)
    ("recorders/directions.py", "opposite"),  # azimuth
    ("analyses/pst/page.py", "link"),  # of a page
    ("analyses/pst/next_order.py", "taken"),  # `NextOrder.taken`, a public name
}
PHRASES = ("with the light", "against the light", "points of light", "point of light")


@pytest.mark.parametrize("folder", ENGINE)
def test_identifiers(folder: str) -> None:
    found = []
    for file in sorted((MODULES / folder).rglob("*.py")):
        place = file.relative_to(MODULES).as_posix()
        text = file.read_text(encoding="utf-8")
        names = {t.string for t in tokenize.generate_tokens(io.StringIO(text).readline) if t.type == tokenize.NAME}
        for name in sorted(names):
            parts = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower().split("_")
            own = [word for word in parts if word in PRIVATE and (place, word) not in ALLOWED]
            found += [f"{place}: {name}; write {PRIVATE[word]}" for word in own]
            found += [f"{place}: {name}; write {LOCAL[name]}"] if name in LOCAL else []
    assert found == []


@pytest.mark.parametrize("folder", ENGINE)
def test_sentences(folder: str) -> None:
    """Rays are forward or backward; where light is said to arrive, it does so at a light vertex."""
    found, private = [], re.compile(rf"\b(?:{'|'.join(PROSE)})\b", re.IGNORECASE)
    for file in sorted((MODULES / folder).rglob("*.py")):
        text = re.sub(r"\s+#?\s*", " ", file.read_text(encoding="utf-8"))
        found += [f"{file.relative_to(MODULES)}: {phrase}" for phrase in PHRASES if phrase in text]
        found += [f"{file.relative_to(MODULES)}: {word}" for word in private.findall(text)]
    assert found == []
