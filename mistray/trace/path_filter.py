"""Filters of paths and rays: expressions such as ``S(barrel*) & !G & flux_W > 1e-9``.

A flag is a letter and the name of a surface or part in brackets; in a name ``*`` stands for any letters, ``?`` for one.
A flag alone is for any surface. Flags are those of Zemax' filter strings where these have them:

====== =============================================================================================================
flag   the light
====== =============================================================================================================
H(x)   hits x, whatever happens there
M(x)   misses x
T(x)   is transmitted by x, neither scattered nor diffracted
R(x)   is reflected by x, specularly or totally
I(x)   is totally reflected within x
G(x)   is reflected by x as a ghost: neither at a mirror nor at structure nor totally
S(x)   is scattered by the surface x
B(x)   is scattered in the bulk of the material x
D(x)   is diffracted by the edge x
L(x)   meets x last before the detector
====== =============================================================================================================

``H(barrel) >= 2`` counts events. ``name operator value`` compares a column of the table, with ``= != < <= > >=``; text
needs quotation marks if it is more than a word, and may have ``*`` and ``?``: ``kind = "single scatter"``. A string in
quotation marks alone is a path: these events in this order, others between: ``"detector:R window_rear:R"``. There the
letters r and t are all scatter, also the aimed rays that the table has as j and i. Or it is the name of a path or of a
kind of paths in a report: ``"S22 -> S8" & power_W > 1e-9``. A filter that is nothing else needs no quotation marks, see
`mistray.trace.named_paths`.

A name with brackets or commas needs quotation marks of either kind: ``H("lens (1)")``. In a path a name with spaces
stands in marks of the other kind: ``"detector:R 'window rear':R"``. For a name that holds both kinds write ``?`` for
such a mark.

Terms are joined by ``!`` (not), ``&`` (and), ``^`` (either, not both), ``|`` (or), which bind in this order, and by
round brackets.
"""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import NoReturn

import numpy as np

from mistray.errors import MistrayError, nearest
from mistray.events import LETTERS, REFLECTED, TOTAL, TRANSMITTED
from mistray.recorders.path_events import Events, sampled_alike
from mistray.trace.filter_rows import Bounds, Rows, UnknownError, exactly, like, like_pattern, places
from mistray.trace.named_paths import KINDS, Kind, Named, Whole, read_events, read_name

FLAGS = "HMTRIGSBDL"
MOST_DEEP = 100  # brackets and ! within each other
MOST_SHOWN = 200  # letters of a filter in a message
# Operators of comparisons; a single = is as good as two
COMPARISONS: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "=": operator.eq,
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}
_TOKEN = re.compile(
    r"\s*(?:(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(?![\w.])|(?P<text>\"[^\"]*\"|'[^']*')"
    r"|(?P<compare>==|!=|<=|>=|=|<|>)|(?P<sign>[!&^|()])|(?P<word>[\w*?.:+-]+))"
)


class PathFilter:
    """
    Filter of paths and rays, parsed from an expression; `mistray.trace.path_filter` describes the language.

    Parameters
    ----------
    text : str
        Filter expression; empty: everything holds.

    Attributes
    ----------
    columns : frozenset of str
        Names of the columns that the filter compares.
    name : str
        Filter expression if all of it is the name of a path; else empty.

    Raises
    ------
    MistrayError
        If the expression is not in the language.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        parser = _Parser(text)
        # A name without quotation marks first: its arrows and brackets are no filter
        self._term: _Term = read_name(text) or parser.filter()
        # Columns that are compared by name, and those that a name of paths reads
        self.columns = frozenset(parser.columns | getattr(self._term, "columns", frozenset()))
        self.name = text.strip() if isinstance(self._term, Named) else ""

    @classmethod
    def in_order(cls, words: Sequence[str]) -> PathFilter:
        """
        Return a filter for light that meets these surfaces in this order, perhaps with others between.

        Each may end in an event letter, as ``lens:R``.
        """
        found = cls("")
        found.text, found._term = " ".join(words), _Sequence(tuple(words))
        return found

    def bounds(self, rows: Rows) -> Bounds:
        """
        Return masks of the table rows where the filter holds for all rays, and where it may hold for some.

        Raise `MistrayError` for unknown names and columns.
        """
        try:
            return self._term.bounds(rows)
        except UnknownError as error:
            raise MistrayError(f"filter '{self.text}': {error}") from None

    def holds(self, rows: Rows) -> np.ndarray:
        """Return a mask of the rows where the filter holds for every ray, (n,) bool; raise as `bounds` does."""
        return self.bounds(rows).certain

    def __repr__(self) -> str:
        return f"PathFilter({self.text!r})"


@dataclass(frozen=True)
class _Not:
    term: _Term

    def bounds(self, rows: Rows) -> Bounds:
        certain, possible = self.term.bounds(rows)
        # Negation exchanges the bounds
        return Bounds(~possible, ~certain)


@dataclass(frozen=True)
class _Join:
    sign: str
    terms: tuple[_Term, ...]

    def bounds(self, rows: Rows) -> Bounds:
        join = {"&": _both, "|": _any, "^": _either}[self.sign]
        return reduce(join, (term.bounds(rows) for term in self.terms))


def _both(a: Bounds, b: Bounds) -> Bounds:
    return Bounds(a.certain & b.certain, a.possible & b.possible)


def _any(a: Bounds, b: Bounds) -> Bounds:
    return Bounds(a.certain | b.certain, a.possible | b.possible)


def _either(a: Bounds, b: Bounds) -> Bounds:
    # Certain where one holds for certain and the other cannot; impossible where both hold, or neither can
    certain = (a.certain & ~b.possible) | (~a.possible & b.certain)
    return Bounds(certain, ~((a.certain & b.certain) | (~a.possible & ~b.possible)))


@dataclass(frozen=True)
class _Flag:
    """
    Flag of a filter, such as ``S(barrel)``: a kind of event, at any surface or at a named one.

    It compares a path's count of such events with a number; by default at least 1.
    """

    letter: str
    name: str
    compare: str = ">="
    value: float = 1.0

    def bounds(self, rows: Rows) -> Bounds:
        events = rows.events
        here = places(self.name, rows)[events.places]
        # M has no events to count
        if self.letter == "M":
            return exactly(~(events.inside & here).any(axis=1))
        count = (_HAPPENS[self.letter](events, rows.surfaces) & here).sum(axis=1)
        return exactly(COMPARISONS[self.compare](count, self.value))


def _last(events: Events, _: int) -> np.ndarray:
    return events.before_the_end & (np.arange(events.codes.shape[1]) == events.lengths[:, None] - 2)


_HAPPENS: dict[str, Callable[[Events, int], np.ndarray]] = {
    "H": lambda e, _: e.inside,
    "T": lambda e, _: e.happens(TRANSMITTED),
    "R": lambda e, _: e.happens(REFLECTED, TOTAL),
    "I": lambda e, _: e.happens(TOTAL),
    "G": lambda e, _: e.reflected & ~e.on_structure,
    "S": lambda e, surfaces: e.deflected & ~e.diffracted & (e.places < surfaces),
    "B": lambda e, surfaces: e.deflected & (e.places >= surfaces),
    "D": lambda e, _: e.diffracted,
    "L": _last,
}


@dataclass(frozen=True)
class _Compare:
    """Comparison of a column with a value: a number, or a string; `text` is the value as it is written."""

    column: str
    compare: str
    value: float | str
    text: str

    def bounds(self, rows: Rows) -> Bounds:
        # A path cannot decide: its rays differ in this column
        if self.column in rows.by_ray:
            count = len(rows.events)
            return Bounds(np.full(count, False), np.full(count, True))
        if self.column not in rows.columns:
            raise UnknownError(f"there is no column '{self.column}'{like(self.column, [*rows.columns, *rows.by_ray])}")

        # Text: equal or not, with patterns
        values = np.asarray(rows.columns[self.column])
        if values.dtype.kind in "OUT":
            if self.compare not in ("=", "==", "!="):
                raise UnknownError(f"'{self.column}' is text; compare it with = or !=")
            fits, known = like_pattern(self.text), rows.texts_of(self.column)
            if known and not any(map(fits, known)):
                raise UnknownError(f"'{self.column}' is never '{self.text}'{like(self.text, known)}")
            same = np.array([fits(str(value)) for value in values], dtype=bool)
            return exactly(~same if self.compare == "!=" else same)

        # Numbers
        if isinstance(self.value, str):
            raise UnknownError(f"'{self.column}' is a number; compare it with one, not with '{self.value}'")
        return exactly(np.asarray(COMPARISONS[self.compare](values, self.value)))


@dataclass(frozen=True)
class _Sequence:
    """Filter for light that meets given surfaces in order, each optionally with the letter of its event."""

    words: tuple[str, ...]

    def bounds(self, rows: Rows) -> Bounds:
        codes, inside = rows.events.codes, rows.events.inside
        after = np.zeros(len(codes), dtype=np.int64)  # events that are used up
        held = np.full(len(codes), True)
        letters = {letter: what for what, letter in LETTERS.items()}
        for word in self.words:
            ends = word[-2:-1] == ":" and word not in rows.events.ids  # an id may end like an event
            name, _, letter = word.rpartition(":") if ends else (word, "", "")
            if letter and letter not in letters:
                raise UnknownError(f"'{word}' ends in '{letter}'; a letter is one of {', '.join(letters)}")
            here = inside & places(name, rows)[rows.events.places]
            if letter:
                here &= rows.events.happens(*sampled_alike(letters[letter]))
            here &= np.arange(codes.shape[1]) >= after[:, None]
            held &= here.any(axis=1)
            # Greedy: the first event that fits leaves most events for the words to come
            after = np.pad(here, ((0, 0), (0, 1))).argmax(axis=1) + 1  # a table without a path has no column
        return exactly(held)


_Term = _Not | _Join | _Flag | _Compare | _Sequence | Kind | Whole | Named


class _Parser:
    """
    Recursive-descent parser that turns the text of a path filter into its terms.

    Attributes
    ----------
    columns : set of str
        Names of the columns that the text compares, as far as it is parsed.
    """

    def __init__(self, text: str) -> None:
        self._text, self._at, self._depth = text, 0, 0
        self.columns: set[str] = set()

    def filter(self) -> _Term:
        """
        Return the filter of the whole expression; a bare event list is accepted where it cannot be an expression.

        Empty text gives a filter that everything passes, and text outside the language raises `MistrayError`.
        """
        if not self._text.strip():
            return _Sequence(())  # everything holds
        try:
            return self.whole()
        except MistrayError:
            if (events := read_events(self._text)) is None:
                raise
            return events

    def whole(self) -> _Term:
        # Lowest precedence first: | then ^ then & then !
        term = self._join("|", lambda: self._join("^", lambda: self._join("&", self._not)))
        if self._look():
            self._fail(f"'{_short(self._text[self._at :].strip())}' is left over; join terms with & | or ^")
        return term

    def _join(self, sign: str, part: Callable[[], _Term]) -> _Term:
        terms = [part()]
        while self._take(sign):
            terms.append(part())
        return terms[0] if len(terms) == 1 else _Join(sign, tuple(terms))

    def _not(self) -> _Term:
        # Before Python's own recursion limit
        if self._depth > MOST_DEEP:
            self._fail(f"brackets and ! stand {self._depth} deep at character {self._at}; {MOST_DEEP} are the most")
        self._depth += 1
        term: _Term
        if self._take("!"):
            term = _Not(self._not())
        elif self._take("("):
            term = self._join("|", lambda: self._join("^", lambda: self._join("&", self._not)))
            self._need(")")
        else:
            term = self._one()
        self._depth -= 1
        return term

    def _one(self) -> _Term:
        found = self._look()
        if found is None or found.lastgroup not in ("word", "text"):
            self._fail(f"a term is missing before '{found[0].strip()}'" if found else "a term is missing at the end")
        self._at = found.end()
        if found["text"]:
            # Text in quotation marks: a name, a kind, or events in this order
            mark, path = found["text"][0], found["text"][1:-1]
            if named := read_name(path):
                self.columns |= named.columns
                return named
            inner = "'" if mark == '"' else '"'
            pieces = re.findall(rf"{inner}[^{inner}]*{inner}\S*|\S+", path)
            words = tuple(piece.replace(inner, "") if piece.startswith(inner) else piece for piece in pieces)
            return _Sequence(words) if words else self._fail("a path in quotation marks is empty; name its surfaces")

        # A flag, with an optional name and comparison
        word = found["word"]
        if word in FLAGS and len(word) == 1:
            name = self._name(word)
            if word == "M" and name is None:
                self._fail("M needs a name: M(x), light that misses x")
            compared = self._compared()
            if compared is None:
                return _Flag(word, name or "*")
            compare, value, _ = compared
            if word == "M" or isinstance(value, str):
                self._fail(f"{word}({name or '*'}) {compare} {value} compares nothing; a count is a number of events")
            return _Flag(word, name or "*", compare, float(value))

        # A comparison of a column, or a kind of paths
        compared = self._compared()
        if compared is None and word in KINDS:
            self.columns |= Kind.columns
            return Kind(word)
        if compared is None:
            self._fail(f"'{word}' is not a kind of path; {nearest(word, KINDS)} For a surface write H({word})")
        self.columns.add(word)
        return _Compare(word, *compared)

    def _name(self, letter: str) -> str | None:
        """
        Return the surface name in brackets after a flag letter; None if there are no brackets.

        Brackets without a name raise `MistrayError`.
        """
        if not self._take("("):
            return None
        rest = self._text[self._at :].lstrip()
        start = len(self._text) - len(rest)
        if rest[:1] in ("'", '"') and rest.find(rest[0], 1) > 0:
            end = start + rest.find(rest[0], 1) + 1
            self._at, name = end, self._text[start + 1 : end - 1]
        else:
            close = self._text.find(")", start)
            end = close if close >= 0 else len(self._text)
            self._at, name = end, self._text[start:end].strip()
        if not name:
            self._fail(f"{letter}() names nothing; give a surface or part, or leave the brackets out")
        self._need(")")
        return name

    def _compared(self) -> tuple[str, float | str, str] | None:
        """Return the next comparison: its sign, its value, and this value as it is written; None if there is none."""
        found = self._look()
        if found is None or not found["compare"]:
            return None
        self._at = found.end()
        value = self._look()
        if value is None or not (value["number"] or value["text"] or value["word"]):
            self._fail(f"a number or a text is missing after '{found['compare']}'")
        self._at = value.end()
        text = value["number"] or value["word"] or value["text"][1:-1]
        return found["compare"], float(text) if value["number"] else text, text

    def _look(self) -> re.Match[str] | None:
        """
        Return the next token of the filter text without consuming it; None at the end.

        A sign that means nothing in a filter raises `MistrayError`.
        """
        if not self._text[self._at :].strip():
            return None
        found = _TOKEN.match(self._text, self._at)
        if found is None:
            self._fail(f"'{self._text[self._at :].strip()[0]}' means nothing here; use ! & ^ | and round brackets")
        return found

    def _take(self, sign: str) -> bool:
        found = self._look()
        if found is None or found["sign"] != sign:
            return False
        self._at = found.end()
        return True

    def _need(self, sign: str) -> None:
        if not self._take(sign):
            self._fail(f"a '{sign}' is missing after '{_short(self._text[: self._at].strip())}'")

    def _fail(self, what: str) -> NoReturn:
        raise MistrayError(f"filter '{_short(self._text)}': {what}")


def _short(text: str) -> str:
    """Return a string cut to `MOST_SHOWN` characters for an error message."""
    return text if len(text) <= MOST_SHOWN else f"{text[:MOST_SHOWN]}…"
