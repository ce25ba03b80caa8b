"""Command `mistray thermal`: irradiance that warm optics and structure put on their own detector."""

from __future__ import annotations

from mistray.toolkit.command import AnalysisCommand
from mistray.toolkit.field_options import group
from mistray.toolkit.shared_options import SCATTER, SCENE, SURFACES, TABLE_FORMATS, TIME, output, ray_tree

COMMAND = AnalysisCommand(
    "thermal",
    "irradiance that warm optics and structure put on their own detector",
    "Trace a scene backwards from its detector, and add up what every surface and medium emits towards it.\n"
    "That is π L of a blackbody at its temperature, times the share that it absorbs: 1 - R - T - scatter.",
    (
        "mistray thermal scene.xml --temperature-K 293 --band-um 8 12 --out out",
        "mistray thermal scene.xml --band-um 3 5 --part detector=77 'baffle_*=150' --scene-K 300",
        "mistray thermal scene.xml --band-um 8 12 --wavelength-um 2 --max-scatters 3 --json",
        "mistray thermal scene.xml --part detector=77 --pixel-um 15 --bandwidth-hz 1e4 --detectivity 1e11",
    ),
    lambda request: (
        SCENE,
        group("temperatures", request.ThermalRequest, "temperature_K", "temperatures", "scene_K"),
        group("band", request.ThermalRequest, "band_um", "wavelengths_um", "detector"),
        group(
            "noise, for the NETD (a pixel, a bandwidth, and one or both of the others)", request.ThermalRequest, "noise"
        ),
        ray_tree("rays from the detector, for each wavelength and twice (2e5)", TIME),
        SURFACES,
        SCATTER,
        output(
            "report.html, CSV, JSON and PNG files",
            ("report.html", "thermal.*", "narcissus*.csv", "netd.csv"),
            formats=TABLE_FORMATS,
        ),
    ),
    __package__,
    request="ThermalRequest",
)
