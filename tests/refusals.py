"""Refusals: a `MistrayError` in one line, which names what is wrong."""

from collections.abc import Iterator
from contextlib import contextmanager

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
