"""Terms of the field in the engine and the PST: private words for them do not come back."""

import io
import re
import tokenize
from pathlib import Path

import pytest
import vectors

ROOT = Path(__file__).parents[1] / "mistray"
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
    for file in sorted((ROOT / folder).rglob("*.py")):
        place = file.relative_to(ROOT).as_posix()
        text = file.read_text(encoding="utf-8")
        names = {t.string for t in tokenize.generate_tokens(io.StringIO(text).readline) if t.type == tokenize.NAME}
        for name in sorted(names):
            parts = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower().split("_")
            found += [
                f"{place}: {name}; write {PRIVATE[word]}"
                for word in parts
                if word in PRIVATE and (place, word) not in ALLOWED
            ]
            found += [f"{place}: {name}; write {LOCAL[name]}"] if name in LOCAL else []
    assert found == []


@pytest.mark.parametrize("folder", ENGINE)
def test_sentences(folder: str) -> None:
    """Rays are forward or backward; where light is said to arrive, it does so at a light vertex."""
    found, private = [], re.compile(rf"\b(?:{'|'.join(PROSE)})\b", re.IGNORECASE)
    for file in sorted((ROOT / folder).rglob("*.py")):
        text = re.sub(r"\s+#?\s*", " ", file.read_text(encoding="utf-8"))
        found += [f"{file.relative_to(ROOT)}: {phrase}" for phrase in PHRASES if phrase in text]
        found += [f"{file.relative_to(ROOT)}: {word}" for word in private.findall(text)]
    assert found == []
