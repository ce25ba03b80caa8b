"""Random optical systems by number: the same number gives the same scene, files and settings on every machine.

A `Structure` is what shapes a kernel: how many bodies and of what surfaces, which kinds of coatings and of scatter,
walls, stop, detector, and the settings that change the code. The numbers of a scene are data: curvatures, conics,
aspheric terms, thicknesses, tilts, decentres, materials, coatings, roughness, fields, wavelengths, limits. So many
scenes share a kernel, which is compiled once for each structure.

Bodies are closed: every face ends in a rim or a flat collar, and a cylinder joins them. Bodies of a scene lie in slabs
along the axis that do not overlap, whatever their tilts are. Light that is in glass leaves it through a surface only.

``python tests/random_scenes.py NUMBER FOLDER`` writes a scene with its files and settings.
"""

from __future__ import annotations

import itertools
import json
import math
import random
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from oracles.scatter_scenes import bsdf_xml, scattering_xml
from oracles.small_scenes import interface_xml, meter_xml


def _change(old: str = "", new: str = "", **settings: Any) -> Callable[[Scene], None]:
    """Replaces some text of the XML, which must be there, and sets arguments of the trace."""

    def change(made: Scene) -> None:
        if old not in made.text:
            raise ValueError(f"scene {made.number} has no {old!r}")
        made.text = made.text.replace(old, new, 1)
        made.settings.update(settings)

    return change


# Each of these changes must be refused, in one clear line
NONSENSE: dict[str, Callable[[Scene], None]] = {
    "no detector": _change("irradiancemeter", "thin"),
    "no source": _change('<emitter type="collimated">', '<emitter type="constant">'),
    "ids": _change('id="detector"', 'id="L0_0"'),
    "more than all": _change('id="detector">', 'id="detector"><float name="R" value="1.5"/>'),
    "a beam of nothing": _change('name="irradiance" value="', 'name="irradiance" value="-'),
    "a beam away": _change('<emitter type="collimated">', '<emitter type="collimated"><transform name="to_world">'
                            '<translate x="1e7"/></transform>'),
    "a size of nothing": _change('name="semi_diameter" value="', 'name="semi_diameter" value="-'),
    "a number that is none": _change('name="semi_diameter" value="', 'name="semi_diameter" value="nan'),
    "beyond the conic": _change('name="semi_diameter" value="', 'name="curvature" value="1e9"/><float '
                                 'name="semi_diameter" value="'),
    "wavelength": _change(wavelength_nm=-550.0),
    "no wavelength": _change(wavelength_nm=float("nan")),
    "rays": _change(rays=0),
    "reflections": _change(max_reflections=-1),
    "threshold": _change(flux_threshold=float("nan")),
    "events": _change(max_events=1001),
    "field": _change(field_deg=90.0),
}  # fmt: skip
STRUCTURES = 36
TABULATED = (2, 10, 20)  # structures in which surfaces may scatter as measured tables say
FACES = ("plane", "conic", "conic", "asphere", "asphere")
COATINGS = ("bare", "ideal", "films", "preset", "table")
ORACLE_COATINGS = ("bare", "ideal", "table")  # those that tests/oracles know
LENS_SCATTER = ("abg", "harvey_shack", "rough", "k_correlation", "gaussian_lobe", "particulate", "tabulated", "paint")
WALL_SCATTER = ("paint", "flat_black", "tabulated", "abg_incident", "none")
PRESETS = ("mgf2_quarter_wave", "v_coat", "bbar3", "bbar4")
GLASSES = ("N-BK7", "N-SF11", "N-LAK9", "fused silica k=0", "nd=1.544 Vd=56.1 k=0", "1.5", "1.9", "1.62+1e-7i",
           "1.5+2e-6i")  # fmt: skip
ORACLE_GLASSES = ("nd=1.544 Vd=56.1 k=0", "1.5", "1.9", "1.62+1e-7i", "1.5+2e-6i", "N-BK7 k=1e-8")
FILMS = ("MgF2", "Ta2O5 k=0", "SiO2 k=0", "1.7", "2.2", "2.1+0.001i", "1.3")
SAMPLES = 257  # radii at which faces are compared


@dataclass(frozen=True)
class Face:
    """An optical surface: its form, coating and scatter, and whether a flat collar leads from its rim to the edge."""

    form: str
    coating: str
    scatter: tuple[str, ...] = ()
    collar: bool = False


@dataclass(frozen=True)
class Body:
    """A lens, plate or cemented doublet of these faces; `turned` bodies are tilted and decentred."""

    faces: tuple[Face, ...]
    turned: bool
    cloudy: bool = False


@dataclass(frozen=True)
class Structure:
    """What shapes the kernel of a scene; see the module."""

    number: int
    bodies: tuple[Body, ...]
    ball: bool
    tube: str
    stop: str
    vanes: bool
    detector: str
    end: str
    sources: int
    wavelengths: int
    by_oracle: bool
    settings: dict[str, Any]


@dataclass
class Scene:
    number: int
    text: str
    files: dict[str, str]  # contents of the files that the XML names
    settings: dict[str, Any]  # arguments of `mistray.trace`
    nonsense: str  # what makes no sense of it and must be refused; empty: the scene is sound
    structure: Structure

    def write(self, folder: Path) -> Path:
        """Write everything into a folder; gives the path of the scene."""
        folder.mkdir(parents=True, exist_ok=True)
        for name, content in self.files.items():
            (folder / name).write_text(content, encoding="utf-8")
        (folder / "settings.json").write_text(json.dumps({**self.settings, "number": self.number}), encoding="utf-8")
        path = folder / "scene.xml"
        path.write_text(self.text, encoding="utf-8")
        return path


def structure(number: int) -> Structure:
    """One of the structures; every third is what tests/oracles can trace."""
    rng = random.Random(f"structure {number}")
    by_oracle = number % 3 == 0
    coatings = ORACLE_COATINGS if by_oracle else COATINGS
    # The totals of a table take two seconds for each pair of materials
    lens_scatter, wall_scatter = (
        kinds if number in TABULATED else tuple(kind for kind in kinds if kind != "tabulated")
        for kinds in (LENS_SCATTER, WALL_SCATTER)
    )

    def face() -> Face:
        models = ()
        if not by_oracle and rng.random() < 0.6:
            models = tuple(rng.sample(lens_scatter, rng.choice((1, 1, 2))))
        return Face(rng.choice(FACES), rng.choice(coatings), models, collar=rng.random() < 0.3)

    bodies = []
    for _ in range(rng.choice((1, 1, 1, 1, 2))):
        count = rng.choice((2, 2, 2, 3))
        faces = [face() for _ in range(count)]
        if count == 3:
            faces[1] = Face(faces[1].form, "bare" if by_oracle else faces[1].coating, faces[1].scatter)
        bodies.append(Body(tuple(faces), rng.random() < 0.4, not by_oracle and rng.random() < 0.15))
    choice = rng.choice
    settings: dict[str, Any] = {"polarization": "unpolarized"} if by_oracle else {
        "splitting": choice(("split", "split", "one")),
        "below_threshold": choice(("cut", "cut", "roulette")),
        "polarization": choice(("unpolarized", "unpolarized", "stokes")),
        "max_events": choice((64, 64, 20, 7, 1)),
    }  # fmt: skip
    return Structure(
        number,
        tuple(bodies),
        ball=rng.random() < 0.15,
        tube=choice(("none", "black") if by_oracle else ("none", *wall_scatter)),
        stop=choice(("none", "stop") if by_oracle else ("none", "stop", "edge")),
        vanes=rng.random() < 0.3,
        detector=choice(("rectangle", "disc", "curved") if by_oracle else ("rectangle", "disc", "curved", "stock")),
        end=choice(("detector", "detector", "mirror")),
        sources=1 if by_oracle else choice((1, 1, 2)),
        wavelengths=1 if by_oracle else choice((1, 1, 2, 3)),
        by_oracle=by_oracle,
        settings=settings,
    )


def scene(number: int) -> Scene:
    """The random scene of this number; the scenes take turns with the structures."""
    return _Builder(structure(number % STRUCTURES), number).scene()


@dataclass
class _Builder:
    plan: Structure
    number: int
    rng: random.Random = field(init=False)
    files: dict[str, str] = field(default_factory=dict)
    parts: list[str] = field(default_factory=list)
    radius: float = 0.0  # that no body reaches beyond

    def __post_init__(self) -> None:
        self.rng = random.Random(f"scene {self.plan.number} {self.number}")

    def scene(self) -> Scene:
        u = self.rng.uniform
        scale = 10 ** u(-1, 2)  # mm
        z = 0.0
        gaps = []
        for k, body in enumerate(self.plan.bodies):
            size = scale * u(0.5, 1.0)
            z += scale * 10 ** u(-2, 0.3)
            gaps.append(z)
            z = self._body(f"L{k}", body, size, z)
        if self.plan.ball:
            r = scale * u(0.1, 0.6)
            z += scale * 10 ** u(-2, 0)
            self._ball(r, z + r)
            z += 2 * r
        self.radius = max(self.radius, scale) * u(1.05, 1.5)
        end = z + scale * 10 ** u(-0.5, 0.7)
        self._mechanics(scale, gaps, end)
        self._end(scale, z, end)
        sources = "".join(self._source(scale, k) for k in range(self.plan.sources))
        text = f'<scene version="3.0.0"><integrator type="straylight"/>{sources}{"".join(self.parts)}</scene>'
        settings, nonsense = self._settings(), ""
        made = Scene(self.number, text, self.files, settings, nonsense, self.plan)
        if self.rng.random() < 0.06:
            name = self.rng.choice(sorted(NONSENSE))
            NONSENSE[name](made)
            made.nonsense = name
        return made

    # ---- bodies

    def _body(self, name: str, body: Body, size: float, z: float) -> float:
        """A body whose foremost point lies behind z; gives the place that nothing of it lies behind."""
        u, rng = self.rng.uniform, self.rng
        r = np.linspace(0.0, size, SAMPLES)
        faces, heights, rims, place = [], [], [], 0.0
        for k, face in enumerate(body.faces):
            clear = size * u(0.6, 0.95) if face.collar else size
            numbers = self._form(face.form, clear)
            height = _sag(np.minimum(r, clear), numbers)
            if k:
                place = float(np.max(heights[-1] - height)) + size * 10 ** u(-2.3, 0)
            faces.append({"semi_diameter": clear, **numbers})
            heights.append(place + height)
            rims.append(place)
        low, high = min(float(h.min()) for h in heights), max(float(h.max()) for h in heights)
        tilt = [u(-12, 12), u(-12, 12)] if body.turned else [0.0, 0.0]
        shift = [size * u(-0.1, 0.1), size * u(-0.1, 0.1)] if body.turned else [0.0, 0.0]
        lean = sum(math.sin(math.radians(abs(t))) for t in tilt)
        reach = lean * (size + high - low)
        z += reach - low
        pose = (*tilt, *shift, z)
        self.radius = max(self.radius, size + reach + max(map(abs, shift)))
        media = ["air", *(self._glass(body) for _ in faces[1:]), "air"]
        for k, (face, numbers) in enumerate(zip(body.faces, faces, strict=True)):
            front, back = media[k], media[k + 1]
            bsdf = self._interface(f"{name}_{k}", face, front, back)
            self._shape("asphere", f"{name}_{k}", pose, bsdf, rims[k], **numbers)
            if face.collar:
                rim = float(heights[k][-1])
                ends = {"r0": numbers["semi_diameter"], "z0": rim, "r1": size, "z1": rim}
                self._shape("frustum", f"{name}_{k}_collar", pose, interface_xml(front, back, **self._edge()), **ends)
        for k in range(len(faces) - 1):
            plain = interface_xml(media[k + 1], "air", **self._edge())
            ends = {"r0": size, "z0": float(heights[k][-1]), "r1": size, "z1": float(heights[k + 1][-1])}
            self._shape("frustum", f"{name}_{k}_edge", pose, plain, **ends)
        return z + high + reach + size * 10 ** rng.uniform(-2, -0.5)

    def _edge(self) -> dict[str, float]:
        return {"R": 0.0} if self.rng.random() < 0.4 else {} if self.rng.random() < 0.5 else {"R": self.rng.random()}

    def _form(self, form: str, clear: float) -> dict[str, float]:
        u = self.rng.uniform
        if form == "plane":
            return {}
        steep = self.rng.choice((0.2, 0.6, 0.9)) * u(0.1, 1.0) * self.rng.choice((-1, 1))
        conic = u(-3, 1) if self.rng.random() < 0.6 else 0.0
        if (1 + conic) * steep**2 > 0.95:
            conic = 0.0
        numbers = {"curvature": steep / clear, "conic": conic}
        if form == "asphere":
            strong = 10 ** u(-3, -1)
            for order in (4, 6, 8):
                numbers[f"a{order}"] = strong * u(-1, 1) * clear ** (1 - order)
        return numbers

    def _glass(self, body: Body) -> str:
        if body.cloudy:
            u = self.rng.uniform
            return f"{u(1.3, 1.8):.3f} scatter={10 ** u(-5, 0):.3g} g={u(-0.5, 0.95):.2f}"
        return self.rng.choice(ORACLE_GLASSES if self.plan.by_oracle else GLASSES)

    def _ball(self, r: float, z: float) -> None:
        """A glass ball, Mitsuba's own sphere; its normals point outwards, so that the glass is in front of them."""
        bsdf = interface_xml(self._glass(Body((), False)), "air")
        self._shape("sphere", "ball", (0.0, 0.0, 0.0, 0.0, z), bsdf, radius=r)
        self.radius = max(self.radius, r)

    # ---- surfaces

    def _interface(self, name: str, face: Face, front: str, back: str) -> str:
        values, nested = self._coating(name, face.coating)
        models = "".join(self._scatter(name, kind) for kind in face.scatter)
        return scattering_xml([nested, models], front, back, **values)

    def _coating(self, name: str, kind: str) -> tuple[dict[str, Any], str]:
        u, rng = self.rng.uniform, self.rng
        if kind == "ideal":
            total, R = rng.choice((1.0, u(0.5, 1.0))), rng.choice((0.013, u(0, 1)))
            return {"R": total * R, "T": total * (1 - R)}, ""
        if kind == "films":
            layers = ", ".join(f"{rng.choice(FILMS)} {u(1, 300):.2f}" for _ in range(rng.randint(1, 6)))
            return {}, bsdf_xml("thinfilm", layers=layers)
        if kind == "preset":
            return {}, bsdf_xml("thinfilm", preset=rng.choice(PRESETS))
        if kind == "table":
            self.files[f"{name}.csv"] = self._table()
            return {"table": f"{name}.csv"}, ""
        return {}, ""

    def _table(self) -> str:
        """R and T over wavelength and angle: smooth, R up to 1 at grazing incidence, some of the rest absorbed."""
        u = self.rng.uniform
        start, absorbed, tint = u(0, 0.5), u(0, 0.3), u(-0.1, 0.1)
        rows = ["wavelength_nm,angle_deg,R,T"]
        for nm, angle in itertools.product((400, 550, 700), range(0, 91, 3)):
            R = start + (1 - start) * (1 - math.cos(math.radians(angle))) ** 3
            R *= 1 + tint * (nm - 550) / 150 * (1 - R)
            rows.append(f"{nm},{angle},{R:.9f},{(1 - R) * (1 - absorbed):.9f}")
        return "\n".join(rows) + "\n"

    def _scatter(self, name: str, kind: str) -> str:
        u, rng = self.rng.uniform, self.rng
        share = 10 ** u(-4, -1)
        if kind in ("abg", "abg_incident"):
            B, g = 10 ** u(-6, -1), u(0.3, 3.0)
            more = {"relative_to": "incident"} if kind == "abg_incident" else {}
            return bsdf_xml("abg", A=share / _total(lambda r: 1 / (B + r**g)), B=B, g=g, **more)
        if kind == "harvey_shack":
            knee, s = 10 ** u(-3, -0.5), u(-3.0, -0.5)
            b0 = share / _total(lambda r: (1 + (r / knee) ** 2) ** (s / 2))
            return bsdf_xml("harvey_shack", b0=b0, l=knee, s=s)
        if kind == "rough":
            return bsdf_xml("harvey_shack", rms_nm=10 ** u(-1, 0.9), l=10 ** u(-3, -1), s=u(-3.0, -1.2))
        if kind == "k_correlation":
            return bsdf_xml("k_correlation", rms_nm=10 ** u(-1, 0.5), B_um=10 ** u(0.5, 2.5), slope=u(2.05, 4.0))
        if kind == "gaussian_lobe":
            return bsdf_xml("gaussian_lobe", total=share, width=10 ** u(-2.5, 0.3))
        if kind == "particulate":
            return bsdf_xml("particulate", level=rng.choice((100.0, 300.0, 600.0)))  # three: Mie takes its time
        if kind == "tabulated":
            file = f"{name}.csv" if f"{name}.csv" not in self.files else f"{name}_bsdf.csv"
            self.files[file] = self._bsdf_table(share)
            return bsdf_xml("tabulated", file=file, relative_to="specular")
        if kind == "flat_black":
            return bsdf_xml("paint", preset="flat_black")
        if kind == "paint":
            lens = name.startswith("L")
            more = {"event": "transmission", "relative_to": "specular"} if lens else {}
            return bsdf_xml("paint", reflectance=share if lens else u(0, 0.95), **more)
        raise ValueError(kind)

    def _bsdf_table(self, share: float) -> str:
        bend = self.rng.uniform(0, 2)
        rows = ["theta_i_deg,theta_s_deg,phi_deg,bsdf"]
        for i, s, phi in itertools.product((0, 30, 60), range(0, 91, 10), range(0, 181, 30)):
            away = abs(s - i) / 90 + phi / 180
            rows.append(f"{i},{s},{phi},{share / math.pi * math.exp(-bend * away):.9g}")
        return "\n".join(rows) + "\n"

    # ---- mechanics, detector, light

    def _wall(self, name: str) -> str:
        kind = {"black": "none"}.get(self.plan.tube, self.plan.tube)
        if kind == "none":
            return interface_xml(R=self.rng.choice((0.0, self.rng.uniform(0, 0.3))))
        models = self._scatter(name, kind)
        if kind == "tabulated":
            models = models.replace("specular", "incident")
        return scattering_xml([models], R=0.0)

    def _mechanics(self, scale: float, gaps: Sequence[float], end: float) -> None:
        u, axis = self.rng.uniform, (0.0, 0.0, 0.0, 0.0, 0.0)
        front = -scale * u(0.2, 3.0)
        if self.plan.tube != "none":
            ends = {"r0": self.radius * u(1.0, 1.2), "z0": front, "r1": self.radius, "z1": end}
            self._shape("frustum", "tube", axis, self._wall("tube"), **ends)
        if self.plan.stop != "none":
            a, z = max(scale * u(0.1, 0.9), 0.1), front * u(0.0, 1.0)  # a ring needs 25 wavelengths
            self._shape("frustum", "stop", axis, self._wall("stop"), r0=a, z0=z, r1=self.radius, z1=z)
            if self.plan.stop == "edge":
                w = scale * 10 ** u(-3, -1) * 0.1 + 0.02
                inner = max(a - w, 0.5 * a)
                width = (a * a - inner * inner) / (2 * a)
                ring = scattering_xml([bsdf_xml("edge_diffraction", width_mm=width)], R=0.0, T=1.0)
                self._shape("frustum", "stop_edge", axis, ring, r0=inner, z0=z, r1=a, z1=z)
        if self.plan.vanes:
            for k, z in enumerate(gaps):  # just before the slab of each body
                z -= scale * 1e-3
                ends = {"r0": self.radius * u(0.5, 0.99), "z0": z, "r1": self.radius, "z1": z}
                self._shape("frustum", f"vane_{k}", axis, self._wall(f"vane_{k}"), **ends)

    def _end(self, scale: float, z: float, end: float) -> None:
        """The detector, at the end or before a mirror there."""
        u = self.rng.uniform
        if self.plan.end == "mirror":
            r = self.radius * u(0.5, 0.95)
            numbers = self._form("conic", r)
            numbers["curvature"] = -abs(numbers["curvature"])
            depth = float(-_sag(np.array([r]), numbers)[0])
            bsdf = interface_xml(R=u(0.5, 1.0), mirror=True)
            self._shape("asphere", "mirror", (0.0, 0.0, 0.0, 0.0, end + depth), bsdf, semi_diameter=r, **numbers)
        at = z + (end - z) * (u(0.3, 0.9) if self.plan.end == "mirror" else u(0.5, 0.999))
        size = scale * 10 ** u(-0.7, 0.2)
        values: dict[str, Any] = {"R": self.rng.choice((0.0, u(0, 0.5)))}
        meter = meter_xml(16)
        pose = (0.0, 0.0, 0.0, 0.0, at)
        bsdf = interface_xml(**values)
        if self.plan.detector == "stock":
            self._shape("rectangle", "detector", pose, bsdf, extra=meter, scale=(size, size * u(0.3, 1.0)))
        elif self.plan.detector == "rectangle":
            self._shape("asphere", "detector", pose, bsdf, extra=meter, half_width=size, half_height=size * u(0.3, 1.0))
        else:
            bent = {"curvature": u(-0.5, 0.5) / size} if self.plan.detector == "curved" else {}
            room = 0.3 * size if bent else 0.0
            pose = (0.0, 0.0, 0.0, 0.0, max(at - room, z + room) if end - z > 2 * room else at)
            self._shape("asphere", "detector", pose, bsdf, extra=meter, semi_diameter=size, **bent)

    def _source(self, scale: float, k: int) -> str:
        u, rng = self.rng.uniform, self.rng
        field_deg = rng.choice((0.0, u(-5, 5), u(-15, 15), u(-40, 40)))
        values: dict[str, Any] = {"irradiance": 10 ** u(-3, 3), "field_deg": field_deg}
        values["azimuth_deg"] = u(-180, 180)
        size = scale * 10 ** u(-1.5, 0.1)
        if k == 0:
            values["radius"] = size
        else:
            values |= {"half_width": size, "half_height": size * u(0.2, 1.0)}
        nm = ", ".join(f"{u(420, 680):.1f}" for _ in range(self.plan.wavelengths))
        kind = "string" if "," in nm else "float"
        spectrum = f'<{kind} name="wavelength_nm" value="{nm}"/>'
        return bsdf_xml("collimated", **values).replace("<bsdf", "<emitter").replace("</bsdf>", spectrum + "</emitter>")

    def _settings(self) -> dict[str, Any]:
        u, rng = self.rng.uniform, self.rng
        settings: dict[str, Any] = {
            "rays": rng.choice((64, 200, 500)),
            "max_reflections": rng.choice((0, 1, 2, 2, 3)),
            "flux_threshold": rng.choice((0.0, 1e-8, 1e-5, 1e-3)),
            "seed": rng.randrange(2**32),
        }
        if not self.plan.by_oracle:
            settings |= {
                "max_scatters": rng.choice((0, 1, 1, 2)),
                "max_generations": rng.choice((1, 3, 30)),
                "max_optical_scatters": rng.choice((0, 1, 9)),
                "max_random_scatters": rng.choice((0, 1, 9)),
                "scatter_rays": rng.choice((1, 1, 3)),
                "aimed_rays": rng.choice((0, 1, 1, 2)),
                "aim": rng.choice(("auto", "auto", "targets", "none")),
                "scatter_threshold": rng.choice((0.0, 0.1, 0.9)),
                "ray_control": rng.choice(("allow_all",) * 9 + ("transmit_specular", "reflect_specular", "halt_all")),
                "flux_threshold": rng.choice((1e-8, 1e-6, 1e-4, 1e-2)),
            }
            if settings["max_scatters"] == 2:
                settings |= {"scatter_rays": 1, "max_reflections": min(settings["max_reflections"], 1)}
            if u(0, 1) < 0.1:
                settings["field_deg"] = u(-60, 60)
        return settings | self.plan.settings

    def _shape(
        self, kind: str, name: str, pose: Sequence[float], bsdf: str, z: float = 0.0, extra: str = "",
        scale: Sequence[float] = (), **numbers: float,
    ) -> None:  # fmt: skip
        """A shape at (0, 0, z) of a frame that is tilted (degrees, about x and then y) and moved to (x, y, z) mm."""
        tilt_x, tilt_y, *move = pose
        floats = "".join(f'<float name="{key}" value="{value!r}"/>' for key, value in numbers.items())
        steps = [f'<scale x="{scale[0]!r}" y="{scale[1]!r}"/>'] if scale else []
        steps += [f'<translate z="{z!r}"/>'] if z else []
        steps += [f'<rotate {axis}="1" angle="{t!r}"/>' for axis, t in (("x", tilt_x), ("y", tilt_y)) if t]
        steps.append('<translate x="{!r}" y="{!r}" z="{!r}"/>'.format(*move))
        place = f'<transform name="to_world">{"".join(steps)}</transform>'
        self.parts.append(f'<shape type="{kind}" id="{name}">{floats}{place}{bsdf}{extra}</shape>')


def _sag(r: np.ndarray, numbers: dict[str, float]) -> np.ndarray:
    c, k = numbers.get("curvature", 0.0), numbers.get("conic", 0.0)
    z = c * r**2 / (1 + np.sqrt(1 - (1 + k) * (c * r) ** 2))
    return z + sum(numbers.get(f"a{order}", 0.0) * r**order for order in (4, 6, 8))


def _total(profile: Callable[[np.ndarray], np.ndarray]) -> float:
    """Total scatter at normal incidence of a profile over |β - β0|; grazing light has less."""
    r = np.concatenate([[0.0], np.geomspace(1e-6, 1.0, 400)])
    return float(2 * np.pi * np.trapezoid(profile(r) * r, r))


if __name__ == "__main__":
    print(scene(int(sys.argv[1])).write(Path(sys.argv[2])))
