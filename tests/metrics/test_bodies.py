"""Bodies that are displaced and tilted as a whole: the same as parts that are built there, exactly."""

from __future__ import annotations

from typing import Any

import mitsuba as mi
import numpy as np
import pytest

import mistray
from mistray.analyses.optimize.study.variables import Variables, find_variables
from mistray.analyses.sweep.configurations import Configuration, resolve
from mistray.errors import MistrayError
from mistray.gradients.geometry_gradient import column_derivatives
from mistray.metrics.bodies import Body
from mistray.metrics.scene_values import changed
from mistray.optimize import bodies, parameters, path_power, read_study
from mistray.physics.geometry.pose import moved
from mistray.prescription import Detector, Prescription, Source, Structure, Surface, moved_as_one, prism
from mistray.surfaces.gradient_columns import GEOMETRY, POSE


def scene() -> Any:
    """A prism, whose faces point to different sides, and a lens that is turned as a whole, with its edge."""
    lens = moved_as_one(
        (
            Surface("front", radius=30.0, semi_diameter=5.0, back="1.5", part="L"),
            Surface("rear", radius=-30.0, semi_diameter=5.0, z=4.0, front="1.5", part="L"),
            Structure("edge", 5.0, 0.5, 5.0, 3.5, front="1.5", part="L"),
        ),
        z=30.0,
        tilt_deg=(0.0, 20.0, 0.0),
    )
    faces = prism("P", [(0, 0), (10, 10), (-10, 10)], 20.0, material="1.5")
    surfaces = tuple(face for face in (*faces, *lens) if isinstance(face, Surface))
    return Prescription(
        name="bodies", surfaces=surfaces, structures=lens[2:], source=Source(radius=5.0),
        detector=Detector(z=60.0, half_width=9.0, half_height=9.0),
    ).to_scene()  # fmt: skip


@pytest.fixture(scope="module")
def here() -> Any:
    return scene()


@pytest.fixture(scope="module")
def known(here: Any) -> dict[str, Body]:
    return bodies(parameters(here))


def frames(here: Any) -> dict[str, np.ndarray]:
    return {shape.id(): np.array(shape.matrix) for shape in here.shapes()}


class TestBody:
    def test_what_is_one(self, known: dict[str, Body]) -> None:
        assert list(known) == ["P", "L"]
        assert len(known["P"].frames) == 5
        np.testing.assert_allclose(known["P"].axes, np.eye(3))
        np.testing.assert_allclose(known["P"].pivot, (0.0, 0.0, 7.5), atol=1e-9)
        own = known["L"].axes
        np.testing.assert_allclose(own[:, 2], (np.sin(np.radians(20)), 0.0, np.cos(np.radians(20))), atol=1e-6)
        # The edge begins 0.5 mm behind the vertex of the front: the vertices of the faces are the outermost
        np.testing.assert_allclose(known["L"].pivot, np.array([0.0, 0.0, 30.0]) + 2 * own[:, 2], atol=1e-5)

    @pytest.mark.parametrize("part", ["P", "L"])
    def test_it_is_rigid(self, here: Any, known: dict[str, Body], part: str) -> None:
        """Large tilts and displacements at once: every frame moves as if it were fixed to the others."""
        body = known[part].about((1.0, -2.0, 3.0))
        amounts = {"x": 0.3, "y": -0.2, "z": 0.7, "tilt_x": 11.0, "tilt_y": -23.0, "tilt_z": 40.0}
        before = frames(here)
        params = mi.traverse(here)
        with changed(params, {key: np.array([change]) for key, change in body.moved(amounts).items()}):
            after = frames(here)
        turn, to_axes = moved(np.eye(4), 0, 0, 0, 11.0, -23.0, 40.0), np.eye(4)
        to_axes[:3, :3], to_axes[:3, 3] = body.axes, body.pivot
        motion = to_axes @ turn @ np.linalg.inv(to_axes)
        motion[:3, 3] += body.axes @ (0.3, -0.2, 0.7)
        for surface in body.frames:
            np.testing.assert_allclose(after[surface], motion @ before[surface], atol=2e-5)  # in single precision
            np.testing.assert_allclose(frames(here)[surface], before[surface], atol=1e-12)

    def test_on_top_of_what_a_surface_has(self, here: Any) -> None:
        """A lens whose front is decentred and a wedge already."""
        params = mi.traverse(here)
        with changed(params, {"front.x": np.array([0.1]), "front.tilt_y": np.array([3.0])}):
            body = bodies(parameters(here))["L"]
            before = frames(here)
            changes = body.tilted((5.0, 0.0, -7.0))
            values = {key: np.array([change + float(params[key][0])]) for key, change in changes.items()}
            with changed(params, values):
                after = frames(here)
        relative = [np.linalg.inv(place["front"]) @ place["rear"] for place in (before, after)]
        np.testing.assert_allclose(relative[1], relative[0], atol=2e-5)

    def test_slopes_lead_to_columns(self, here: Any, known: dict[str, Body]) -> None:
        """A tilt by one degree: each vertex moves by the angle times its arm, and its frame turns by the angle."""
        body, shapes = known["P"], {shape.id(): shape for shape in here.shapes()}
        slopes = body.slopes("tilt_x")
        axis = np.radians(1.0) * np.array([1.0, 0.0, 0.0])
        for surface in body.frames:
            shape = shapes[surface]
            moves = sum(slopes.get(f"{surface}.{name}", 0.0) * column_derivatives(shape, name) for name in POSE)
            frame = np.asarray(shape.vertex_frame(shape.values, shape.matrix))
            to_local = frame[:3, :3].T
            columns = [GEOMETRY.index(name) for name in POSE]
            expected = [*to_local @ np.cross(axis, frame[:3, 3] - body.pivot), *to_local @ axis]
            np.testing.assert_allclose(moves[columns], expected, atol=1e-8)


class TestStudy:
    def variables(self, here: Any, *sections: dict[str, Any]) -> Variables:
        bounded = [{"low": -9, "high": 9} | section for section in sections]
        content = {"term": [{"kind": "path_power", "goal": "minimise"}], "variable": bounded}
        params = mi.traverse(here)
        return find_variables(read_study(content), params, parameters(here, params), {})

    def test_tilts_and_displacements_of_one_body(self, here: Any, known: dict[str, Body]) -> None:
        found = self.variables(
            here,
            {"parameters": "L.tilt_x"},
            {"parameters": [{"key": "L.tilt_y", "factor": -2.0}]},
            {"parameters": "L.z", "low": -1, "high": 1},
            {"name": "roll", "parameters": [{"key": "P.tilt_z", "pivot": [0, 1, 0]}], "low": -1, "high": 1},
        )
        assert found.names == ("L.tilt_x", "L.tilt_y", "front.z", "roll")
        assert [variable.unit for variable in found.variables] == ["deg", "deg", "mm", "deg"]
        np.testing.assert_allclose(found.start, 0.0)
        values = found.parameters([3.0, 2.0, 0.5, 0.25])
        expected = known["L"].moved({"tilt_x": 3.0, "tilt_y": -4.0, "z": 0.5})
        expected |= known["P"].about((0, 1, 0)).moved({"tilt_z": 0.25})
        assert set(values) == set(expected)
        for key, change in expected.items():
            assert values[key] == pytest.approx([change], abs=1e-9), key

    def test_chain_rule(self, here: Any) -> None:
        """Against central differences of all numbers of the surfaces, far from the start."""
        found = self.variables(here, *({"parameters": key} for key in (["L.tilt_x", "P.tilt_x"], "P.y", "L.tilt_z")))
        rng, x, h = np.random.default_rng(0), np.array([4.0, -1.0, 6.0]), 1e-4
        gradient = {key: rng.normal(size=1) for key in found.keys}
        slope = found.slope(gradient, x)
        for k, step in enumerate(h * np.eye(3)):
            more, less = found.parameters(x + step), found.parameters(x - step)
            expected = sum(float(gradient[key][0] * (more[key] - less[key])[0]) for key in gradient) / (2 * h)
            assert slope[k] == pytest.approx(expected, rel=1e-6)

    def test_refusals(self, here: Any) -> None:
        one, two = {"parameters": "L.tilt_x", "low": 1, "high": 2}, {"parameters": "L.tilt_x"}
        for sections, message in (
            ([one], "L.tilt_x starts with 0"),
            ([one | {"scale": "log"}], "L.tilt_x starts with 0"),
            ([{"parameters": [{"key": "L.tilt_x", "pivot": [1, 2]}]}], r"'L' is \[1.0, 2.0\]; give x, y and z"),
            ([{"parameters": [{"key": "front.radius", "pivot": [1, 2, 3]}]}], "it has no pivot"),
            ([{"parameters": ["L.tilt_x", "L.z"]}], "units deg, mm"),
            ([two | {"name": name} for name in "ab"], r"'a' and 'b' both move L\.tilt_x"),
        ):
            with pytest.raises(MistrayError, match=message):
                self.variables(here, *sections)


def test_configuration(here: Any, known: dict[str, Body]) -> None:
    """A tilt, and a displacement, which is a value of the surfaces' own."""
    (found,) = resolve(here, mi.traverse(here), [Configuration("bent", {"L.tilt_x": 2.0, "L.z": 0.5, "P.y": 1.0})])
    expected = known["L"].moved({"tilt_x": 2.0, "z": 0.5}) | known["P"].moved({"y": 1.0})
    assert {key: float(value[0]) for key, value in found.values.items()} == pytest.approx(expected, abs=1e-5)


def test_derivative_by_several_numbers(here: Any, known: dict[str, Body]) -> None:
    """Its error comes from the batches of the sum; what the gradient lacks is refused."""
    slopes = known["L"].slopes("tilt_x")
    found = mistray.gradient(path_power(here, "all", rays=2000), mi.traverse(here), keys=slopes)
    along = found.along(slopes)
    parts = sum(slope * found.batches[key][:, 0] for key, slope in slopes.items())
    assert along.value == pytest.approx(float(np.sum(parts)))
    assert along.se == pytest.approx(float(np.std(parts, ddof=1) * np.sqrt(32)))
    with pytest.raises(MistrayError, match=r"the gradient has no 'front\.curvature'"):
        found.along({**slopes, "front.curvature": 1.0})
