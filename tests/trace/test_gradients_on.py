"""A scene whose parameters are to be differentiated traces as any other."""

import drjit as dr
import mitsuba as mi
import numpy as np
import pytest
from lit_detector import BLACK, lit, square

import mistray
from mistray import pst

T = mi.ScalarTransform4f


def scene() -> mi.Scene:
    turned = T().translate([0, 14, -10]).rotate([1, 0, 0], 60)
    white = BLACK | {"scatter": {"type": "abg", "A": 0.2, "B": 1.0, "g": 0.0}}
    plate = {"type": "asphere", "half_width": 15.0, "half_height": 15.0, "to_world": turned, "bsdf": white}
    light = {"type": "area", "radiance": {"type": "spectrum", "value": 2.0}}
    place = T().translate([0, -6, -40]).scale([4, 7, 1])
    lamp = {"type": "rectangle", "to_world": place, "bsdf": BLACK, "emitter": light}
    return lit(lamp, plate=plate, detector=square(5.0, 2))


@pytest.mark.parametrize("name", ["plate.vertex_positions", "plate.z", "lamp.emitter.radiance.value"])
def test_a_trace_and_a_pst(name: str) -> None:
    plain, attached = scene(), scene()
    parameters = mi.traverse(attached)
    dr.enable_grad(parameters[name])
    parameters.update()
    settings = {"rays": 20_000, "max_scatters": 2, "seed": 3}
    one, other = (mistray.trace(s, **settings) for s in (plain, attached))
    assert one.energy.detected_W > 0
    assert np.array_equal(one.irradiance, other.irradiance)
    first, second = (pst(s, [0, 30], method="adjoint", **settings) for s in (plain, attached))
    assert first.to_pandas().pst_total.all()
    assert first.to_pandas().equals(second.to_pandas())
