"""The replay differentiates in float32: surfaces of any size, turns that change nothing, and portions of rays."""

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from oracles.small_scenes import interface_xml, scene_text, shape_xml

import mistray
from mistray.events import KINDS, event_of, stays
from mistray.gradients.recorded_rays import ROOM, Portions
from mistray.optimize import Metric

ORDERS = range(4, 21, 2)
KEYS = [*(f"front.a{order}" for order in ORDERS), "front.curvature", "rear.z", "front.conic"]


def lens(size: float) -> str:
    """An asphere before a detector, all lengths times `size`, lit to its rim."""
    coefficients = {f"a{order}": 0.02 / order * size ** (1 - order) for order in ORDERS}
    front = shape_xml(
        "asphere", "front", size, interface_xml("air", "1.5", R=0.1, T=0.8), radius=3 * size, conic=-0.4,
        semi_diameter=1.1 * size, **coefficients,
    )  # fmt: skip
    rear = shape_xml("asphere", "rear", 1.6 * size, interface_xml("1.5", "air", R=0.1, T=0.8), semi_diameter=2 * size)
    end = shape_xml("asphere", "detector", 4 * size, sensor=True, half_width=2 * size, half_height=2 * size)
    return scene_text(front, rear, end, radius=size, field_deg=5.0)


def spread(size: float) -> Callable[[list[Any]], Any]:
    """Mean square radius of all light, in units of the size."""
    return lambda seen: sum(one.moments("all").variance for one in seen) / size**2


@pytest.mark.parametrize("size", [1e-3, 1e3])
def test_a_scaled_lens(load_scene, size: float) -> None:
    """
    Derivatives scale with the size as their parameters do, although r²⁰ and a₂₀ leave the range of float32.

    A lens of another size has the same numbers without units. In 1.0 mm and 1 m the largest is 1e57.
    """
    found = []
    for scale in (1.0, size):
        scene = load_scene(lens(scale))
        metric = Metric(scene, spread(scale), settings={"rays": 200, "max_reflections": 0})
        found.append(mistray.gradient(metric, mi.traverse(scene), KEYS, edges=False).gradient)
    powers = {"curvature": 1, "z": -1, "conic": 0} | {f"a{order}": order - 1 for order in ORDERS}
    for key in KEYS:
        expected = found[0][key] * size ** powers[key.rsplit(".", 1)[-1]]
        assert expected != 0
        np.testing.assert_allclose(found[1][key], expected, rtol=2e-4, err_msg=key)


def test_a_turn_about_the_own_axis(load_scene) -> None:
    """A surface of revolution turns into itself: exactly 0 for the lens, and not for the frame of the detector."""
    scene = load_scene(lens(1.0))
    # Not the variance: the whole picture turns with the frame
    metric = Metric(scene, lambda seen: sum(one.moments("all").x for one in seen), settings={"rays": 100})
    found = mistray.gradient(metric, mi.traverse(scene), ["*.tilt_z", "front.tilt_x", "front.tilt_y"], edges=False)
    assert found.gradient["front.tilt_z"] == found.gradient["rear.tilt_z"] == 0
    assert abs(found.gradient["detector.tilt_z"][0]) > 1e-3
    assert found.gradient["front.tilt_y"] != 0


@pytest.mark.parametrize(("records", "first"), [(4.0, 175), (0.5, 700), (1e6, 1)])
def test_the_first_portion(records: float, first: int) -> None:
    """It fills its share of the recorder, so that no trace is in vain."""
    traced: list[int] = []
    recorder = SimpleNamespace(capacity=1000, count=mi.UInt32(0), clear=lambda: None)

    def trace(start: Any, _: Any) -> None:
        traced.append(dr.width(start.lane))
        recorder.count = mi.UInt32(min(1000, int(records * traced[-1])))

    class Start(SimpleNamespace):
        def take(self, index: mi.UInt32) -> Any:
            return Start(lane=index)

    start = Start(lane=dr.arange(mi.UInt32, 1500))
    parts = [part for part, _ in Portions.filling(recorder, records, "{count} {capacity}").of(start, trace)]
    assert traced[0] == first == max(1, int(ROOM * 1000 / max(records, 1)))
    assert sum(dr.width(part.lane) for part in parts) == sum(traced) == 1500


def test_sides_of_incidence() -> None:
    """Reflected light stays there, totally reflected or scattered light too; as integers and as arrays."""
    expected = [kind.intercept in ("Absorbed", "SpecRefl", "TIR", "RandRefl", "ImpRefl") for kind in KINDS]
    events = [event_of(7, kind) for kind in range(len(KINDS))]
    assert [bool(stays(event)) for event in events] == expected
    assert stays(np.array(events)).tolist() == list(stays(mi.UInt32(events))) == expected
