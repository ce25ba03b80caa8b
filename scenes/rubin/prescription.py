"""The Rubin telescope with its camera in the r band, by batoid's file of its surfaces as they were measured."""

from __future__ import annotations

from typing import Any

from mistray.prescription import Coating, Detector, Prescription, Source, Structure, Surface

# Vertex in the world, mm, and turns about its x, y and z axes, degrees, as batoid adds its frames up
PLACES: dict[str, tuple[tuple[float, float, float], tuple[float, float, float]]] = {
    "M1": ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
    "M2": ((-0.023, 0.013, 6155.355062), (0.0005825, -0.000348, -3.54e-09)),
    "M3": ((-0.363, -0.169, -234.4), (-0.00134, 0.00252, -5.894e-08)),
    "L1_entrance": ((-0.928193, -0.219884, 3395.736636), (0.0074544997, 0.01057092429, 5.5945e-07)),
    "L1_exit": ((-0.913007, -0.230593, 3478.046634), (0.0074544997, 0.01057092429, 5.5945e-07)),
    "L2_entrance": ((-0.836889, -0.284271, 3890.617623), (0.0074544997, 0.01057092429, 5.5945e-07)),
    "L2_exit": ((-0.831345, -0.28818, 3920.667623), (0.0074544997, 0.01057092429, 5.5945e-07)),
    "Filter_entrance": ((-0.940745, -0.609428, 4266.904999), (0.00745449961, 0.00627092433, 0.0)),
    "Filter_exit": ((-0.938786, -0.611757, 4284.804999), (0.00745449961, 0.00627092433, 0.0)),
    "L3_entrance": ((-0.932874, -0.618785, 4338.824998), (0.00745449961, 0.00627092433, 0.0)),
    "L3_exit": ((-0.926298, -0.626602, 4398.904997), (0.00745449961, 0.00627092433, 0.0)),
    "detector": ((-0.923133, -0.630364, 4427.825997), (-0.00404150042, 0.00271092436, -4.6318e-07)),
}
# Standard Zernike terms 1 to 28 of three surfaces, nm, over circles of these radii, mm
FIGURES: dict[str, tuple[float, tuple[float, ...]]] = {
    "L1_entrance": (
        775,
        (
            -0.5099,
            0.09089,
            0.2151,
            41.71,
            4.549,
            -37.28,
            14.41,
            17.91,
            3.841,
            -16.84,
            -30.02,
            -12.49,
            -4.49,
            -7.715,
            1.197,
            7.78,
            -11.89,
            -1.902,
            5.311,
            -5.026,
            8.985,
            -13.21,
            -7.393,
            -9.319,
            -3.555,
            -5.699,
            -7.704,
            -18.6,
        ),
    ),
    "L2_entrance": (
        551,
        (
            8.408,
            1.927,
            1.502,
            -44.73,
            2.731,
            61.84,
            1.834,
            2.354,
            -34.4,
            -12.55,
            54.09,
            7.787,
            -3.49,
            -1.172,
            -4.626,
            4.564,
            3.556,
            3.987,
            5.803,
            -2.95,
            2.986,
            45.75,
            -0.9143,
            -0.5526,
            -4.372,
            -0.5158,
            1.471,
            1.916,
        ),
    ),
    "Filter_entrance": (
        378,
        (
            -0.9908,
            0.1208,
            -0.1371,
            -16.69,
            -59.83,
            18.33,
            22.77,
            -14.98,
            -15.68,
            13.1,
            73.53,
            17.01,
            4.004,
            2.868,
            -1.982,
            -6.538,
            17.61,
            1.26,
            -17.21,
            -12.68,
            0.03981,
            109.7,
            11.78,
            20.06,
            0.9898,
            -7.154,
            -39.35,
            15.17,
        ),
    ),
}
SILICA, AIR = "fused silica k=0", "vacuum"
BODY_RADIUS, BODY_END = 830.0, 4600.0  # of the camera, mm
WAVELENGTH_NM = 620.0
MIRROR, FACE, CCD, BLACK = Coating(R=1.0), Coating(R=0.02, T=0.98), Coating(R=0.02), Coating(R=0.0)


def build() -> Prescription:
    """Light of the sky travels towards -z to M1, whose vertex is the origin; the camera looks down at M3."""
    m1 = mirror("M1", -1.21502, (0.0, -1.381e-24), 19834.6, 4180.0, 2558.0)
    m2 = mirror("M2", -0.222, (0.0, 1.274e-20, 9.68e-28), 6790.05, 1710.0, 900.0)
    m3 = mirror("M3", 0.15497, (0.0, 4.5e-22, 8.15e-30), 8343.9, 2508.0, 550.0)
    lenses = (
        lens("L1", 775.0, {"radius": 2823.354}, {"radius": 5018.956}),
        lens("L2", 551.0, {"radius": -4.804e7}, {"radius": 2529.1, "conic": -1.57, "coefficients": (0.0, -1.656e-18)}),
        lens("Filter", 375.0, {"radius": 5632.0}, {"radius": 5606.0}),
        lens("L3", 361.0, {"radius": 3169.0, "conic": -0.962}, {"radius": -13360.0}),
    )
    faces = tuple(face for faces, _ in lenses for face in faces)
    x, y, _ = PLACES["L1_entrance"][0]
    front = faces[0].z + 120.0
    back_of_m2 = m2.z + 320.0
    camera: dict[str, Any] = {"coating": BLACK, "part": "camera", "x": x, "y": y}
    return Prescription(
        name="Rubin telescope v3.14, r band",
        surfaces=(m1, m2, m3, *faces),
        structures=(
            *(piece for _, pieces in lenses for piece in pieces),
            Structure("camera_body", BODY_RADIUS, front, BODY_RADIUS, BODY_END, **camera),
            Structure("camera_end", BODY_RADIUS, BODY_END, 0.0, BODY_END, **camera),
            Structure("M2_back", m2.outer_radius, back_of_m2, 0.0, back_of_m2, coating=BLACK),
        ),
        detector=Detector("detector", semi_diameter=400.0, pixels=(256, 256), coating=CCD, **place("detector")),
        source=Source(
            z=439.3899, tilt_deg=(0.0, 180.0, 0.0), radius=4180.0, inner_radius=2558.16, plane="axis",
            wavelength_nm=(WAVELENGTH_NM,),
        ),
        provenance="Rubin_v3.14_r.yaml of batoid 0.9 (BSD-2-Clause); see SOURCE.md.",
    )  # fmt: skip


def place(name: str) -> dict[str, Any]:
    """Where a surface stands."""
    (x, y, z), tilt_deg = PLACES[name]
    return {"x": x, "y": y, "z": z, "tilt_deg": tilt_deg}


def mirror(
    name: str, conic: float, coefficients: tuple[float, ...], radius: float, outer: float, inner: float
) -> Surface:
    """A mirror with a hole."""
    return Surface(
        name, radius=radius, conic=conic, coefficients=coefficients, semi_diameter=outer, inner_semi_diameter=inner,
        front=AIR, back=AIR, coating=MIRROR, mirror=True, **place(name),
    )  # fmt: skip


def lens(
    name: str, semi_diameter: float, entrance: dict[str, Any], exit_: dict[str, Any]
) -> tuple[tuple[Surface, Surface], tuple[Structure, Structure]]:
    """Both faces, the black edge between their rims, and the black ring from there to the wall of the camera."""
    faces = []
    for side, shape, front, back in (("entrance", entrance, AIR, SILICA), ("exit", exit_, SILICA, AIR)):
        radius, terms = FIGURES.get(f"{name}_{side}", (0.0, ()))
        sag = {f"zernike_{k}": round(nm * 1e-6, 16) for k, nm in enumerate(terms, start=1)}
        sag |= {"zernike_radius": radius} if terms else {}
        faces.append(Surface(
            f"{name}_{side}", **place(f"{name}_{side}"), **shape, sag=sag, semi_diameter=semi_diameter, front=front,
            back=back, coating=FACE, part=name,
        ))  # fmt: skip
    first, second = faces
    own = place(f"{name}_entrance")
    # Both faces lie on one axis: their distance along it is that of their vertices
    z0, z1 = (face.z_at(semi_diameter) - first.z for face in faces)
    frame: dict[str, Any] = {**own, "coating": BLACK, "part": name}
    edge = Structure(f"{name}_edge", semi_diameter, z0, semi_diameter, z1, front=SILICA, back=AIR, **frame)
    ring = Structure(f"{name}_cell", semi_diameter, z0, BODY_RADIUS + 2.0, z0, **frame)
    return (first, second), (edge, ring)
