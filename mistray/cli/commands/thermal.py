"""`mistray thermal`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from mistray.cli.arguments import pairs
from mistray.cli.command import Command, Group, Option
from mistray.cli.options import Options
from mistray.cli.shared import DETECTOR, SCATTER, SCENE, SURFACES, TABLE_FORMATS, TIME, flag, output, ray_tree
from mistray.errors import MistrayError
from mistray.ranges import BANDWIDTH_HZ, DETECTIVITY, LENGTH_UM, QUANTUM_EFFICIENCY, TEMPERATURE_K, WAVELENGTH_UM

if TYPE_CHECKING:
    from mistray.analysis.thermal.netd import DetectorNoise

# What --out writes
FILES = ("report.html", "thermal.*", "narcissus*.csv", "netd.csv")
PIXEL, NOISE = ("pixel_um", "bandwidth_hz"), ("detectivity", "quantum_efficiency")

# fmt: off
COMMAND = Command(
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
    (
        SCENE,
        Group("temperatures", (
            Option("--temperature-K", "of everything without one of its own, K (293)",
                   TEMPERATURE_K, "T", default=293.0),
            Option("--part", "of surfaces, parts or materials by name, with * and ?; the last holds",
                   pairs("no NAME=T, such as detector=77", TEMPERATURE_K), "NAME=T", "+", extends=True),
            Option("--scene-K", "of the blackbody around the system, K (--temperature-K)", TEMPERATURE_K, "T"),
        )),
        Group("band", (
            Option("--band-um", "of the detector, µm (8 12)", WAVELENGTH_UM, ("LOW", "HIGH"), 2, default=(8.0, 12.0)),
            Option("--wavelength-um", "where optics are traced, µm (so many that the band is known to 1 %)",
                   WAVELENGTH_UM, "UM", "+"),
            DETECTOR,
        )),
        Group("noise, for the NETD (a pixel, a bandwidth, and one or both of the others)", (
            Option("--pixel-um", "side of a square pixel, µm", LENGTH_UM, "UM"),
            Option("--bandwidth-hz", "of the noise, Hz; 1/(2t) for an integration time t", BANDWIDTH_HZ, "HZ"),
            Option("--detectivity", "D*, mean over the band, cm √Hz/W", DETECTIVITY, "D"),
            Option("--quantum-efficiency", "electrons per photon, mean over the band; for the noise of photons",
                   QUANTUM_EFFICIENCY, "QE"),
        )),
        ray_tree("rays from the detector, for each wavelength and twice (2e5)", TIME),
        SURFACES,
        SCATTER,
        output("report.html, CSV, JSON and PNG files", FILES, formats=TABLE_FORMATS),
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    options.start()
    from mistray.analysis.thermal.emission import thermal
    from mistray.report.thermal import thermal_record, thermal_report, thermal_text

    noise = _noise(options)
    scene = options.load()
    with options.tracing() as progress:
        found = thermal(
            scene,
            options.temperature_K,
            tuple(options.band_um),
            temperatures=dict(options.part or ()),
            scene_K=options.scene_K,
            wavelengths_um=options.wavelength_um,
            detector=options.detector,
            noise=noise,
            progress=progress,
            seconds=options.seconds_left(),
            **options.settings(),
        )
    files = options.write(lambda title, command: thermal_report(found, title, command))
    return options.show(lambda: thermal_record(found), lambda: thermal_text(found), files)


def _noise(options: Options) -> DetectorNoise | None:
    """Return the pixel and its noise as the options give them; None without any."""
    from mistray.analysis.thermal.netd import DetectorNoise

    given = options.given(*PIXEL, *NOISE)
    if not given:
        return None
    missing = [flag(name) for name in PIXEL if name not in given]
    if not any(name in given for name in NOISE):
        missing.append(" or ".join(map(flag, NOISE)))
    if missing:
        raise MistrayError(f"{flag(next(iter(given)))} alone gives no NETD; add {', '.join(missing)}")
    return DetectorNoise(**given)
