"""A rough paraboloid that images a star on a round detector in its focus, which takes no light from the beam."""

from .scatter_scenes import beam_xml, placed_xml, scatter_scene, scattering_xml

LINE = 632.8  # nm
FOCUS, RADIUS = 200.0, 5.0  # mm, of the beam: F/20


def paraboloid_text(*models: str, detector: float = 60.0, size: float = 1.0, radius: float = RADIUS) -> str:
    """All lengths times ``size``; nothing blocks the beam of 1 W, whose angles of incidence are below 0.8°."""
    f, r = FOCUS * size, radius * size
    figure = {"radius": 2 * f, "conic": -1.0, "semi_diameter": r}
    mirror = placed_xml("asphere", "mirror", scattering_xml(models, R=1.0, mirror=True), **figure)
    meter = placed_xml("asphere", "detector", at=(0, 0, f), pixels=16, semi_diameter=detector * size)
    return scatter_scene(beam_xml(r, power=1.0, along=(0, 0, -1), distance=0.25 * f, wavelength_nm=LINE), mirror, meter)
