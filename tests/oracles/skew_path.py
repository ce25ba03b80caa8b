"""Scenes of planes along one ray whose planes of incidence all differ, with the ray in float64."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .polarized import Hit
from .small_scenes import interface_xml, scene_text, shape_xml


@dataclass(frozen=True)
class Face:
    """A plane by incidence and azimuth of its normal about the ray; T, R or I; index behind; layers (index, nm)."""

    incidence_deg: float
    azimuth_deg: float
    kind: str
    behind: complex
    layers: tuple[tuple[complex, float], ...] = ()


@dataclass(frozen=True)
class SkewPath:
    """A scene of ``face_0``, ``face_1``, … and the detector, the ray through its middle, first axis of the source."""

    text: str
    hits: list[Hit]
    directions: np.ndarray
    u: np.ndarray

    events = property(lambda self: [*(f"face_{k}:{hit.kind}" for k, hit in enumerate(self.hits)), "detector:A"])


def index_text(n: complex) -> str:
    n = complex(n)
    return f"{n.real!r}+{n.imag!r}i" if n.imag else repr(n.real)


def _plane(name: str, at: np.ndarray, normal: np.ndarray, bsdf: str, half: float, sensor: bool) -> str:
    helper = np.eye(3)[np.argmin(np.abs(normal))]
    x = np.cross(helper, normal) / np.linalg.norm(np.cross(helper, normal))
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([x, np.cross(normal, x), normal, at])
    text = shape_xml("asphere", name, 0.0, bsdf, sensor, half_width=half, half_height=half)
    return text.replace('<translate z="0.0"/>', f'<matrix value="{" ".join(map(repr, matrix.ravel().tolist()))}"/>')


def _bsdf(inside: complex, face: Face) -> str:
    plain = interface_xml(index_text(inside), index_text(face.behind))
    if not face.layers:
        return plain
    layers = ", ".join(f"{index_text(n)} {d!r}" for n, d in face.layers)
    film = f'<bsdf type="thinfilm"><string name="layers" value="{layers}"/><string name="first" value="front"/></bsdf>'
    return plain.replace("</bsdf>", film + "</bsdf>")


def skew_path(
    faces: Sequence[Face], gap: float = 20.0, field_deg: float = 0.0, azimuth_deg: float = 0.0, **light: float | str
) -> SkewPath:
    """Planes along a ray that starts in air, `gap` mm apart, and a black detector across its end."""
    theta, phi = np.radians([field_deg, azimuth_deg])
    spin = np.array([[np.cos(phi), -np.sin(phi), 0], [np.sin(phi), np.cos(phi), 0], [0, 0, 1.0]])
    d, u = spin @ [0.0, np.sin(theta), np.cos(theta)], spin[:, 0]
    point, inside = np.zeros(3), 1.0 + 0j
    shapes, hits, directions = [], [], [d]
    for number, face in enumerate(faces):
        incidence, azimuth = np.radians([face.incidence_deg, face.azimuth_deg])
        a = np.cross(d, np.eye(3)[np.argmin(np.abs(d))])
        a /= np.linalg.norm(a)
        across = np.cos(azimuth) * a + np.sin(azimuth) * np.cross(d, a)
        normal = np.cos(incidence) * d + np.sin(incidence) * across
        shapes.append(_plane(f"face_{number}", point, normal, _bsdf(inside, face), 5.0, False))
        hits.append(Hit(face.kind, inside, complex(face.behind), face.layers))
        cosine = d @ normal
        if face.kind == "T":
            eta = (inside / face.behind).real
            d = eta * d + (np.sqrt(1 - eta**2 * (1 - cosine**2)) - eta * cosine) * normal
            inside = complex(face.behind)
        else:
            d = d - 2 * cosine * normal
        directions.append(d)
        point = point + gap * d
    shapes.append(_plane("detector", point, d, interface_xml(R=0.0), 5.0, True))
    start = {"field_deg": float(field_deg), "azimuth_deg": float(azimuth_deg)}
    return SkewPath(scene_text(*shapes, radius=0.01, **start, **light), hits, np.array(directions), u)
