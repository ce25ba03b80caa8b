"""Refusals: a `MistrayError` in one line, which names what is wrong."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import pytest

from mistray.errors import MistrayError


@contextmanager
def refused(match: str = "", *named: str) -> Iterator[pytest.ExceptionInfo[MistrayError]]:
    """The block is refused in one line that a regular expression is found in, and that holds these words."""
    with pytest.raises(MistrayError, match=match or None) as caught:
        yield caught
    text = str(caught.value)
    assert "\n" not in text, text
    assert [words for words in named if words not in text] == [], text


def each_refused(*cases: tuple[Any, ...], by: Callable[..., object] = lambda call: call(), pattern: str = "{}") -> None:
    """What each case gives is refused by a function, in a line with the words that end the case, within a pattern."""
    for *given, words in cases:
        try:
            with refused(pattern.format(words)):
                by(*given)
        except BaseException as error:
            error.add_note(f"the case is {given}, {words!r}")
            raise
