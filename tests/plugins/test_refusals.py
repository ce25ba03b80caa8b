"""Parameters of plugins that do not go together: one line that names the object, the parameters and the remedy."""

from typing import Any

import mitsuba as mi
import pytest
import vectors

import mistray

pytestmark = pytest.mark.quick

SCALED, MIRRORED = mi.ScalarTransform4f().scale(1.000012), mi.ScalarTransform4f().scale([-1, 1, 1])
SHEARED = mi.ScalarTransform4f([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
MOVED = (
    {"type": "collimated", "radius": 1.0},
    {"type": "asphere", "semi_diameter": 2.0},
    {"type": "frustum", "r0": 5.0, "z0": -1.0, "r1": 3.0, "z1": 4.0},
)
WRONG = [
    *vectors.toml("plugin_refusals.toml")["alone"],
    *((one | {"to_world": pose}, "to_world scales, shears or mirrors; use a rigid motion")
      for one in MOVED for pose in (SCALED, MIRRORED, SHEARED)),
]  # fmt: skip


@pytest.mark.parametrize(("values", "words"), WRONG)
def test_wrong_values(values: dict[str, Any], words: str) -> None:
    with pytest.raises((mistray.MistrayError, RuntimeError, TypeError)) as caught:
        mi.load_dict({**values, "id": "S"})
    assert words in str(caught.value)
    assert not isinstance(caught.value, mistray.MistrayError) or "\n" not in str(caught.value)
