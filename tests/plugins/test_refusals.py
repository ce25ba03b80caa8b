"""Parameters of plugins that do not go together: one line that names the object, the parameters and the remedy."""

from typing import Any

import mitsuba as mi
import pytest

import mistray

pytestmark = pytest.mark.quick

SCALED, MIRRORED = mi.ScalarTransform4f().scale(1.000012), mi.ScalarTransform4f().scale([-1, 1, 1])
SHEARED = mi.ScalarTransform4f([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
BEAM = {"type": "collimated", "radius": 1.0}
FACE = {"type": "asphere", "semi_diameter": 2.0}
RING = {"type": "frustum", "r0": 5.0, "z0": -1.0, "r1": 3.0, "z1": 4.0}
INTERFACE = {"type": "interface"}
FILM, LAYER = {"type": "thinfilm", "preset": "bbar3"}, {"type": "thinfilm", "layers": "1.38 5"}
TARGET = {"type": "target", "surfaces": "lens"}
CONE = TARGET | {"about": "point", "cone_deg": 1.0}
ABG = {"type": "abg", "A": 0.0025, "B": 0.001, "g": 1.8}
RR = {"type": "k_correlation", "rms_nm": 4.0, "B_um": 20.0, "slope": 2.5, "theory": "rayleigh_rice_vector"}
WRONG: list[tuple[dict[str, Any], str]] = [
    (BEAM | {"radius": float("nan")}, "source 'S': radius is nan"),
    (BEAM | {"inner_radius": 1.0}, "inner_radius is 1 mm; it must lie between 0 and radius = 1 mm"),
    (BEAM | {"radius": 0.0, "half_width": 1.0}, "half_height is missing"),
    (BEAM | {"half_width": 1.0, "half_height": 1.0}, "give radius or half_width and half_height"),
    (BEAM | {"plane": "disc"}, "plane is 'disc'; choose from beam, axis"),
    (BEAM | {"wavelength_nm": "green"}, "wavelength_nm is 'green'"),
    (BEAM | {"wavelength_nm": "500, nan"}, "wavelength_nm is nan"),
    (BEAM | {"weights": "1, 2"}, "2 weights for 1 wavelengths"),
    (BEAM | {"wavelength_nm": "500, 600", "weights": "0, 0"}, "give one above 0"),
    (BEAM | {"diameter": 2.0}, "diameter"),
    ({"type": "asphere"}, "shape 'S': give either semi_diameter or both half_width and half_height"),
    ({"type": "asphere", "half_width": 1.0}, "a rectangular clip needs half_width and half_height"),
    (FACE | {"half_width": 1.0, "half_height": 1.0}, "give either semi_diameter or both"),
    (FACE | {"inner_semi_diameter": 2.0}, "inner_semi_diameter is 2 mm; it must lie between 0 and semi_diameter"),
    (FACE | {"radius": 5.0, "curvature": 0.2}, "give radius or curvature"),
    (FACE | {"radius": 1.0}, "the conic ends at r = 1 mm, inside the aperture of 2 mm; reduce the aperture"),
    (FACE | {"radius": "5 mm"}, "radius is '5 mm'"),
    (FACE | {"conic": True}, "conic is True"),
    (FACE | {"curvatur": 1.0}, "curvatur"),
    (FACE | {"x": float("inf")}, "shape 'S': x is inf"),
    ({"type": "frustum", "r0": 1.0, "r1": 1.0}, "a frustum needs z0, z1 (mm)"),
    (RING | {"r0": 3.0, "z0": 4.0}, "r0 = r1 and z0 = z1; a frustum of no area"),
    (RING | {"r0": 0.0, "r1": 0.0}, "r0 = r1 = 0; a frustum of no area"),
    (RING | {"curvatur": 1.0}, "curvatur"),
    *((one | {"to_world": pose}, "to_world scales, shears or mirrors; use a rigid motion")
      for one in (BEAM, FACE, RING) for pose in (SCALED, MIRRORED, SHEARED)),
    (INTERFACE | {"R": 0.6, "T": 0.5}, "interface 'S': R = 0.6 and T = 0.5"),
    (INTERFACE | {"T": 0.5}, "T is given without R"),
    (INTERFACE | {"R": 0.1, "table": "x.csv"}, "give R and T or table, not both"),
    (INTERFACE | {"back": "N-BK8"}, "material 'N-BK8' is unknown; did you mean N-BK7"),
    (INTERFACE | {"reflectance": 0.1}, "reflectance"),
    (INTERFACE | {"R": 0.1, "coating": FILM}, "give R or a nested thinfilm, not both"),
    (INTERFACE | {"table": "a.csv", "coating": FILM}, "give table or a nested thinfilm, not both"),
    (INTERFACE | {"coating": FILM | {"back": "1.6"}}, "its thinfilm 'bbar3' has back as well"),
    (INTERFACE | {"coating": FILM | {"mirror": True}}, "has mirror as well"),
    (INTERFACE | {"coating": LAYER | {"n_back_shift": 0.1}}, "give n_back_shift at the interface only"),
    (INTERFACE | {"coating": {"type": "diffuse"}}, "interface 'S': SmoothDiffuse nested"),
    (INTERFACE | {"a": FILM, "b": FILM}, "interface 'S': 2 BSDFs nested"),
    ({"type": "thinfilm"}, "thinfilm 'S': it has no coating; give one of layers, preset, table, or R and T"),
    (LAYER | {"preset": "bbar3"}, "it has layers and preset; give one of"),
    ({"type": "thinfilm", "T": 0.1}, "it has T; give one of"),
    ({"type": "thinfilm", "R": 0.1, "first": "front"}, "first has no meaning without layers"),
    (LAYER | {"layers": "1.38 5, 2 5", "n_shift": "0.1"}, "thinfilm 'S': n_shift has 1 numbers for 2 layers"),
    (LAYER | {"k_shift": "none"}, "k_shift: could not convert string to float"),
    (LAYER | {"k_shift": "-0.1"}, "coating 'S', layer 1 (1.38): n = 1.38, k = -0.1 at 550 nm"),
    (LAYER | {"inner": {"type": "diffuse"}}, "thinfilm 'S': a BSDF is nested in it"),
    (LAYER | {"thickness": 5.0}, "thickness"),
    ({"type": "target"}, "surfaces is missing"),
    (TARGET | {"surfaces": " , "}, "surfaces is empty"),
    (TARGET | {"rays": "many"}, "rays is 'many'"),
    (TARGET | {"half_axes": "1, 2"}, "half_axes is '1, 2'; give three positive numbers"),
    (TARGET | {"half_axes": "1, b, 3"}, "half_axes is '1, b, 3'"),
    (TARGET | {"about": "point"}, "about without cone_deg"),
    (TARGET | {"cone_deg": 2.0}, "cone_deg without about"),
    (TARGET | {"entity": "lens", "hole": 0.5}, "entity and hole exclude each other"),
    (CONE | {"about": "axis"}, "about is 'axis'; use direction, point or specular"),
    (CONE | {"entity": "lens"}, "about and entity exclude each other"),
    (CONE | {"scale": 2.0}, "about and scale exclude each other"),
    ({"type": "abg", "A": 1.0, "B": 0.1}, "g is missing; give A, B, g"),
    (ABG | {"aa": 1.0}, "aa"),
    (ABG | {"in": ABG}, "a BSDF is nested in it; nest both in an 'interface' instead"),
    (INTERFACE | {"m": ABG | {"R": 0.5}}, "its abg 'm' has R as well; give R at the interface only"),
    (INTERFACE | {"m": ABG | {"n_front_shift": 0.1}}, "give n_front_shift at the interface only"),
    (RR | {"substrate": "x"}, "substrate is 'x'"),
    ({"type": "paint", "preset": "flat_black", "reflectance": 0.1}, "preset and reflectance given"),
    ({"type": "tabulated"}, "file is missing"),
]  # fmt: skip


@pytest.mark.parametrize(("values", "words"), WRONG)
def test_wrong_values(values: dict[str, Any], words: str) -> None:
    with pytest.raises((mistray.MistrayError, RuntimeError, TypeError)) as caught:
        mi.load_dict({**values, "id": "S"})
    assert words in str(caught.value)
    assert not isinstance(caught.value, mistray.MistrayError) or "\n" not in str(caught.value)
