"""A trace uses the tables of the one before as long as nothing has changed that they depend on."""

import gc
import weakref
from dataclasses import fields
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import pytest
import scene_dicts
import vectors
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import interface_xml, scene_text, shape_xml, write

import mistray
from mistray.execute.scene_task import fingerprint, kernel_arrays
from mistray.execute.tracer import Run, prepare
from mistray.kernel.scatter_tables import ScatterTables
from mistray.kernel.scattering import Scattering
from mistray.light import Light
from mistray.settings import Settings
from mistray.surfaces.intersect import Intersector
from mistray.surfaces.surfaces import SurfaceTable


def lens_text(glass: str = "1.5") -> str:
    """A lens with a coating and scatter, a stop, a wall, a mirror that does not say so, and the detector."""
    film = scattering_xml([bsdf_xml("thinfilm", layers="MgF2 90, 2.1 60")], "air", glass)
    scatter = scattering_xml([bsdf_xml("abg", A=1e-3, B=1e-3, g=2.0)], glass, "air")
    return scene_text(
        shape_xml("asphere", "front", 0.0, film, curvature=0.02, semi_diameter=8.0),
        shape_xml("asphere", "rear", 4.0, scatter, curvature=-0.02, semi_diameter=8.0),
        shape_xml("frustum", "stop", 6.0, None, r0=4.0, z0=0.0, r1=12.0, z1=0.0),
        shape_xml("frustum", "wall", 0.0, interface_xml(R=0.1), r0=12.0, z0=-2.0, r1=12.0, z1=19.0),
        shape_xml("asphere", "mirror", 30.0, interface_xml(R=0.9), semi_diameter=9.0),
        shape_xml("asphere", "detector", 20.0, sensor=True, half_width=3.0, half_height=3.0),
        radius=5.0,
    )


def prepared(scene: mi.Scene, field_deg: float = 0.0, **given: Any) -> Run:
    return prepare(scene, Settings.of(scene, rays=100, **given), Light(field_deg))[0]


def arrays(table: SurfaceTable, scattering: Scattering, intersector: Intersector) -> list[np.ndarray]:
    """All that the kernel reads; apertures are among the numbers of the search for hits."""
    numbers = [getattr(one, name.name) for one in intersector.numbers.values() for name in fields(one)[:-1]]
    return [*kernel_arrays(table, scattering), np.array([float(number[0]) for number in numbers])]


def of_run(run: Run) -> list[np.ndarray]:
    return arrays(run.table, run.scattering, run.intersector)


def made_anew(scene: mi.Scene, run: Run) -> list[np.ndarray]:
    table = SurfaceTable(scene, run.table.wavelength_nm, stokes=run.table.optics.stokes)
    table = table.with_mirrors(run.table.design_mirrors)
    return arrays(table, Scattering(ScatterTables(table, {})), Intersector(table))


def alike(some: list[np.ndarray], others: list[np.ndarray]) -> bool:
    return all(np.array_equal(a, b) for a, b in zip(some, others, strict=True))


@pytest.mark.parametrize("polarization", ["unpolarized", "stokes"])
def test_each_kind_of_change_is_seen(load_scene: Any, polarization: str) -> None:
    scene = load_scene(lens_text())
    params = mi.traverse(scene)
    for key, value in vectors.toml("tables.toml")["changes of a lens"].items():
        before = prepared(scene, polarization=polarization)
        assert prepared(scene, 3.0, polarization=polarization).table.optics is before.table.optics
        old, state = of_run(before), fingerprint([(before.table, before.scattering)])
        params[key] = value
        params.update()
        after = prepared(scene, polarization=polarization)
        assert not alike(old, of_run(after)), key
        assert state != fingerprint([(after.table, after.scattering)]), f"{key}: a saved run would go on with it"
        assert alike(of_run(after), made_anew(scene, after)), key
        assert after.scattering.tables.all_cases[0].rows.any()


def test_results_after_a_change_are_those_of_a_new_scene(load_scene: Any) -> None:
    """Back and forth, so that tables that were kept before would be met again."""

    def flux(scene: mi.Scene) -> list[float]:
        energy = mistray.trace(scene, rays=500, seed=1).energy
        return [energy.detected_W, energy.escaped_W, *(power for power, _ in energy.absorbed.values())]

    scene, other = load_scene(lens_text()), load_scene(lens_text())
    first = flux(scene)
    for given in (mi.traverse(scene), mi.traverse(other)):
        given["front.curvature"] = 0.03
        given.update()
    changed = flux(scene)
    assert changed == flux(other) != first
    params = mi.traverse(scene)
    params["front.curvature"] = 0.02
    params.update()
    assert flux(scene) == first


def test_modes_wavelengths_and_fields_share_what_they_can(load_scene: Any) -> None:
    scene = load_scene(lens_text())
    plain, stokes = (prepared(scene, polarization=mode) for mode in ("unpolarized", "stokes"))
    assert plain.table.shared is stokes.table.shared
    assert plain.intersector is stokes.intersector
    assert plain.table.optics is not stokes.table.optics
    again = prepared(scene, 2.0, polarization="unpolarized", seed=3)
    assert again.scattering is plain.scattering
    assert again.table.host is stokes.table.host
    # Another number of aimed rays is another scatter
    assert prepared(scene, aimed_rays=2, polarization="unpolarized").scattering is not plain.scattering


def test_a_changed_file_of_a_material_is_seen(tmp_path: Path) -> None:
    glass = tmp_path / "glass.csv"
    found = []
    for n in (1.5, 1.6):
        glass.write_text(f"wavelength_nm,n,k\n400,{n},0\n800,{n},0\n", encoding="utf-8")
        if not found:
            scene = mistray.load(write(tmp_path, lens_text("glass.csv")))
        table = prepared(scene).table
        found.append(table.optics.host_indices[table.ids.index("front"), 1])
    assert found == pytest.approx([1.5, 1.6])


def test_a_changed_mesh_is_seen() -> None:
    """Mitsuba's own shapes have no table of their own, so that nothing of their scene is kept."""
    wall = {"type": "rectangle", "bsdf": {"type": "interface", "R": 0.25, "T": 0.75}}
    screen = scene_dicts.detector(3, half_width=2.0, half_height=2.0)
    scene = scene_dicts.load(beam={"type": "collimated", "radius": 0.5}, wall=wall, detector=screen)
    params = mi.traverse(scene)
    assert mistray.trace(scene, rays=100).paths[0].events == "wall:T detector:A"
    params["wall.to_world"] = mi.ScalarTransform4f().translate([8, 0, 0])
    params.update()
    assert mistray.trace(scene, rays=100).paths[0].events == "detector:A"


@pytest.mark.long
def test_what_is_found_by_no_box_and_no_index(load_scene: Any) -> None:
    """A fold mirror that is tilted the other way has the same box, and a cloud of another asymmetry the same index."""
    place, runs = mi.ScalarTransform4d, []
    for tilt in (45.0, -45.0):
        fold = place().translate([0, 0, 10]).rotate([1, 0, 0], tilt).scale(2)
        mirror = {"type": "rectangle", "to_world": fold, "bsdf": {"type": "interface", "R": 0.9, "mirror": True}}
        places = (place().translate([0, y, 10]).rotate([1, 0, 0], 90.0) for y in (5, -5))
        up, down = (scene_dicts.detector(0, to_world=there, semi_diameter=2) for there in places)
        scene = scene_dicts.load(beam={"type": "collimated", "radius": 0.5}, mirror=mirror, up=up, down=down)
        assert mistray.trace(scene, rays=100).paths[0].kind == "direct"
        runs.append(prepared(scene))
    runs += [prepared(load_scene(lens_text(f"1.5 scatter=0.1 g={g}"))) for g in (0.1, 0.8)]
    assert len({fingerprint([(run.table, run.scattering)]) for run in runs}) == 4


def test_tables_go_with_their_scene(load_scene: Any) -> None:
    scene = load_scene(lens_text())
    prepared(scene, polarization="stokes"), prepared(scene)
    shapes = [weakref.ref(shape) for shape in scene.shapes()]
    del scene
    gc.collect()
    assert not any(shape() for shape in shapes)
