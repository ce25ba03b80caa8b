"""Two loaded scenes that are the same: shapes, parameters to the last bit, and what their surfaces say."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np


def assert_same(first: Any, second: Any) -> None:
    assert [shape.id() for shape in first.shapes()] == [shape.id() for shape in second.shapes()]
    a, b = mi.traverse(first), mi.traverse(second)
    assert list(a.keys()) == list(b.keys())
    for key in list(a.keys()):
        np.testing.assert_array_equal(np.array(a[key]), np.array(b[key]), err_msg=key)
    for one, other in zip(first.shapes(), second.shapes(), strict=True):
        assert str(one.bsdf()) == str(other.bsdf())
        assert [(one.part, one.space), str(one)] == [(other.part, other.space), str(other)]
    for one, other in zip(first.emitters(), second.emitters(), strict=True):
        assert str(one) == str(other)
