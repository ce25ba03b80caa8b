"""Sentences of Markdown pages, of the program's help and of its messages, and how many words they have."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

FENCED = re.compile(r"^( *)(```|~~~).*?^\1\2[^\n]*$", re.MULTILINE | re.DOTALL)
MARKUP = re.compile(r"<!--.*?-->|\$\$.*?\$\$", re.DOTALL)
BULLET = re.compile(r"(?:[-*]|\d+\.)\s+(.*)")
CODE = "Name"  # stands for a piece of inline code, a formula or a link of it


def sentences(page: str) -> Iterator[str]:
    """All sentences of a page without its code; headings, items and cells of tables begin anew."""
    for block in _blocks(MARKUP.sub("", FENCED.sub("\n\n", page))):
        yield from of_text(block)


def of_text(text: str) -> Iterator[str]:
    text = re.sub(r"`[^`]*`|\$[^$]*\$", CODE, text)
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(rf"{CODE}(?:,? (?:and |or )?{CODE})+", CODE, text)  # a list of names is no long sentence
    yield from re.split(r"(?<=[.!?])[\"')*_]*\s+(?=[^a-z])", text)


def words(sentence: str) -> int:
    return sum(any(letter.isalnum() for letter in word) for word in sentence.split())


def literals(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of each literal that reads as a sentence; what an f-string fills in counts as one word."""
    tree = ast.parse(source)
    documents = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    inner = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else CODE for part in node.values]
            yield node.lineno, "".join(map(str, parts))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in documents | inner:
            yield node.lineno, node.value


def _blocks(page: str) -> Iterator[str]:
    block: list[str] = []
    after_blank = True
    for line in [*page.splitlines(), ""]:
        text = line.strip()
        item = BULLET.match(text)
        apart = not text or text[0] in "|#" or item is not None
        if apart and block:
            yield " ".join(block)
            block = []
        if not (after_blank and line.startswith("    ")):  # indented code
            if text.startswith("|"):
                yield from (cell.strip() for cell in re.split(r"(?<!\\)\|", text.strip("|")))
            elif text.startswith("#"):
                yield text.lstrip("# ")
            elif text:
                block.append(item[1] if item else text)
        after_blank = not text


def pages(root: Path) -> list[Path]:
    """The pages that people read: those of the root and of docs/."""
    at_the_root = [root / name for name in ("README.md", "CONTRIBUTING.md", "CODE_OF_CONDUCT.md")]
    return [*at_the_root, *sorted((root / "docs").rglob("*.md"))]
