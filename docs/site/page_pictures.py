"""Pictures of the pages of docs/ that no command and no example draws; `make_pictures` writes them to docs/images."""

from __future__ import annotations

import base64
import contextlib
import io
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
from matplotlib.figure import Figure
from page_code import BLOCK, ROOT

import mistray
from mistray.prescription import Prescription
from mistray.report import layout_figure
from mistray.toolkit.figures.palette import BLACK, BLUE, GREEN, ORANGE, PURPLE, VERMILION

DRAWN_MS = 4000  # a scene in three dimensions is drawn meanwhile, also without a graphics card
sys.path.insert(0, str(ROOT / "tests"))


def phone_camera_mitigation() -> Figure:
    """Stray light after five changes of the phone camera over that before, from the table of its page."""
    from validation.tables import read, value

    shown = {
        "lenses R 2 to 0.25 %": (VERMILION, "o"),
        "detector R 20 to 5 %": (ORANGE, "s"),
        "all cones to cylinders": (BLUE, "^"),
        "black bevels": (GREEN, "D"),
        "matt walls of 1 %": (PURPLE, "v"),
        "bevels, walls, cylinders, CL 200": (BLACK, "o"),
    }
    rows = {row["change"]: row for row in read("phone_camera_mitigation.md", "changes")}
    angles = [column.rstrip("°") for column in next(iter(rows.values())) if column.endswith("°")]
    figure = Figure(figsize=(6.8, 5.2), layout="constrained")
    axes = figure.subplots()
    for name, (colour, marker) in shown.items():
        found = [value(rows[name][f"{angle}°"]) for angle in angles]
        x, y = [float(angle) for angle in angles], [ratio for ratio, _ in found]
        axes.errorbar(x, y, [se for _, se in found], color=colour, marker=marker, ms=5, lw=1.3, capsize=2, label=name)
    axes.axhline(1, color="0.5", lw=0.8)
    axes.set(yscale="log", ylim=(0.018, 2), xlabel="field angle [deg]", ylabel="stray PST, after over before")
    axes.set_yticks([0.02, 0.05, 0.1, 0.2, 0.5, 1, 2], ["0.02", "0.05", "0.1", "0.2", "0.5", "1", "2"])
    axes.grid(axis="y", color="0.9")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside lower center", frameon=False, ncols=2)
    return figure


def shown(page: str, number: int = 0) -> dict[str, Any]:
    """The names that the first Python blocks of a page make, up to one of a number."""
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    made: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder), contextlib.redirect_stdout(None):
        for block in BLOCK.findall(text)[: number + 1]:
            exec(compile(block, page, "exec"), made)
    return made


def beam_splitter() -> Figure:
    """Section of the beam splitter with two detectors."""
    made = shown("detectors")
    return layout_figure(made["scene"], made["t"])


def probes() -> Figure:
    """Irradiance on a probe in a lens, and what the lens sends back to the sky."""
    made = shown("detectors", 2)
    stop, sky = made["stop"], made["sky"]
    figure = Figure(figsize=(10, 3.9), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.12)  # inches: the label of the bar is no part of the right panel
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.3))
    irradiance = stop.irradiance[0]
    picture = left.imshow(irradiance, origin="lower", extent=(-20, 20, -20, 20), cmap="inferno")
    left.set(xlabel="x of the probe [mm]", ylabel="y of the probe [mm]", title='probe "behind the stop"')
    figure.colorbar(picture, ax=left, label="irradiance [W/mm²]")
    value, se = (column[:, 0] for column in sky.intensity)
    edges = np.arange(90, 181, 5)
    middle = (edges[1:] + edges[:-1]) / 2
    lit = value > 0
    right.errorbar(middle[lit], value[lit], se[lit], fmt="o", ms=4, capsize=2, color=BLUE)
    right.set(yscale="log", xlim=(90, 180), xlabel="angle from the axis of the light [deg]", ylabel="intensity [W/sr]")
    right.set_title('far field "sky": light sent back')
    right.grid(color="0.9")
    return figure


def cube() -> Figure:
    """Section of the beam-splitter cube behind a plate with a hole."""
    made = shown("bodies")
    return layout_figure(made["scene"], made["t"])


def fold() -> Figure:
    """Section of the fold mirror whose path is declared."""
    made = shown("design_path")
    scene = Prescription(
        name="fold", surfaces=(made["fold"],), detector=made["camera"], source=made["source"]
    ).to_scene()
    return layout_figure(scene, made["t"])


def tube() -> Figure:
    """Section of a tube from a CAD file before a plate."""
    scene = shown("mechanics", 1)["scene"]
    return layout_figure(scene, mistray.trace(scene, rays=500, max_reflections=0))


def diffraction() -> Figure:
    """The ring along the edge of a stop, and the light that it sends aside beside the Airy pattern."""
    from scipy.special import j1

    from mistray.physics.diffraction import circular_aperture

    made = shown("diffraction")
    radius, nm = made["a"], 550e-6
    figure = Figure(figsize=(10, 3.9), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.3))
    for sign in (1, -1):
        left.plot([0, 0], [sign * radius, sign * 7.4], color=BLACK, lw=3)
        left.plot([0, 0], [sign * (radius - 0.45), sign * radius], color=VERMILION, lw=5, solid_capstyle="butt")
        for y in (1.0, 2.7):
            left.plot([-5, 8], [sign * y, sign * y], color=BLUE, lw=0.8)
        left.plot([-5, 0], [sign * 4.75, sign * 4.75], color=BLUE, lw=0.8)
        for slope in (-0.55, -0.3, -0.12, 0.0, 0.12, 0.3, 0.55):
            left.plot([0, 8], [sign * 4.75, sign * 4.75 + 8 * slope], color=VERMILION, lw=0.6)
    left.annotate("stop", (0, 6.6), (-4.4, 6.9), arrowprops={"arrowstyle": "-", "lw": 0.6})
    left.annotate("ring that\nscatters", (-0.1, -4.8), (-4.6, -7.9), arrowprops={"arrowstyle": "-", "lw": 0.6})
    left.set(xlim=(-5.2, 8), ylim=(-8.4, 8.4), aspect="equal", title="an edge as a ring (not to scale)")
    left.set_axis_off()
    theta = np.geomspace(2e-5, 0.3, 1500)
    v = 2 * np.pi * radius * np.sin(theta) / nm
    airy = np.pi * radius**2 / nm**2 * (2 * j1(v) / v) ** 2  # per watt through the opening
    right.loglog(theta, np.maximum(airy, 1e-12), color="0.75", lw=0.6, label="Airy pattern")
    far = theta[theta > 3e-4]
    right.loglog(far, circular_aperture(far, nm, radius), color=BLUE, label="mean over its rings")
    angles, found = [0.01, 0.03, 0.1, 0.25], []
    for angle in angles:
        scene = made["mistray"].load(turned(made, angle))
        energy = made["mistray"].trace(scene, rays=100_000, wavelength_nm=550.0).energy
        per = 4 * made["half"] ** 2 / made["far"] ** 2 * made["through"]
        found.append((energy.detected_W / per, energy.detected_se_W / per))
    value, se = np.array(found).T
    right.errorbar(angles, value, se, fmt="o", ms=5, color=VERMILION, capsize=2, label="traced")
    right.set(
        xlabel="θ [rad]", ylabel="intensity per watt [1/sr]", ylim=(1e-6, 1e9), title="opening of 10 mm at 550 nm"
    )
    right.legend(frameon=False)
    right.grid(color="0.92")
    return figure


def turned(made: dict[str, Any], angle: float) -> dict[str, Any]:
    """The scene of the page on diffraction with its detector at another angle, rad."""
    text = BLOCK.findall((ROOT / "docs" / "diffraction.md").read_text(encoding="utf-8"))[0]
    start = text.index("mistray.load(") + len("mistray.load(")
    return eval(text[start : text.index(")\nfound = ")].strip(), {**made, "theta": angle})


def freeform_terms() -> Figure:
    """Single terms of a sag over a round outline."""
    from mistray.physics.sags.terms import sag

    lengths = dict.fromkeys(("zernike_radius", "fringe_radius", "q_radius", "chebyshev_x", "chebyshev_y"), 1.0)
    names = ("a4", "xy_2_1", "zernike_6", "zernike_8", "fringe_9", "qbfs_1", "q2d_sin_2_1", "chebyshev_3_2")
    y, x = np.mgrid[-1:1:201j, -1:1:201j]
    inside = x**2 + y**2 <= 1
    figure = Figure(figsize=(10, 5.4), layout="constrained")
    for axes, name in zip(figure.subplots(2, 4).flat, names, strict=True):
        heights = np.where(inside, sag(x, y, {name: 1.0} | lengths), np.nan)
        most = np.nanmax(np.abs(heights))
        axes.imshow(heights, origin="lower", extent=(-1, 1, -1, 1), cmap="RdBu_r", vmin=-most, vmax=most)
        axes.set_title(name, family="monospace", fontsize=11)
        axes.set_axis_off()
    figure.supxlabel("sag over the outline: red up, blue down; x to the right, y upwards", fontsize=9, color="0.35")
    return figure


def start_rays(source: dict[str, Any]) -> list[np.ndarray]:
    """Rays of a source to a plane at z = 5 mm: first and last point of each, columns z and y, mm."""
    near = source["type"] != "distant_disc"
    half = 200.0 if near else 8.0
    plane = {
        "type": "asphere",
        "half_width": half,
        "half_height": half,
        "z": 5.0,
        "bsdf": {"type": "interface", "R": 0.0},
        "sensor": {"type": "irradiancemeter", "film": {"type": "hdrfilm", "rfilter": {"type": "box"}}},
    }
    placed = {"to_world": mi.ScalarTransform4f().translate([0, 0, -10])} if near else {}
    traced = mistray.trace(mistray.load({"type": "scene", "source": source | placed, "plane": plane}), rays=2000)
    table = traced.rays(n=36, events=True)
    rays = [rows[["z_mm", "y_mm"]].to_numpy() for _, rows in table.groupby("ray")]
    return (
        rays if near else [end + np.outer([18.0, 0.0], (first - end) / np.hypot(*(first - end))) for first, end in rays]
    )


def sources() -> Figure:
    """Rays of six kinds of sources."""
    kinds = {
        "beam": {"type": "collimated", "radius": 4.0},
        "point in a cone": {"type": "point_source", "half_angle_deg": 25.0},
        "surface, Lambertian": {"type": "surface_source", "radius": 2.0},
        "end of a fibre": {"type": "surface_source", "radius": 0.8, "half_angle_deg": 12.7},
        "laser, waist 2 µm": {"type": "gaussian_beam", "waist_x": 2e-3, "waist_y": 2e-3},
        "sun, 30 times as wide": {"type": "distant_disc", "diameter_deg": 16.0},
    }
    figure = Figure(figsize=(10, 5.2), layout="constrained")
    for axes, (name, source) in zip(figure.subplots(2, 3).flat, kinds.items(), strict=True):
        for ray in start_rays(source):
            axes.plot(*ray.T, color=BLUE, lw=0.6)
        axes.set(xlim=(-11, 5), ylim=(-8, 8), aspect="equal", title=name)
        axes.axis("off")
    return figure


def pst_of_the_camera() -> Figure:
    """The PST of the phone camera by classes of light."""
    from mistray.analyses.pst.figures import pst_curve

    return pst_curve(mistray.pst(mistray.load("phone_camera_scatter"), rays=20_000), "phone camera")


def image_quality() -> Figure:
    """MTF of the Cooke triplet at three fields."""
    from mistray.analyses.image.figures import mtf_figure

    return mtf_figure(mistray.image_quality(mistray.load("cooke_triplet"), [0, 14, 20]), "Cooke triplet")


def sensitivity() -> Figure:
    """What tolerances of the phone camera do to its ghosts."""
    from mistray.analyses.sensitivity.figures import ranking_figure
    from mistray.optimize import path_power

    metric = path_power(mistray.load("phone_camera"), "ghost", field_deg=[10], rays=3000)
    return ranking_figure(mistray.sensitivity(metric, check=False), "ghosts of a phone camera at 10°")


def vanes_by_gradients() -> Figure:
    """Half sections of the tube with the three sets of vanes of the table."""
    from validation.tables import DOCS

    rows = re.findall(r"(?m)^\| vane (\d) \|([^|]+)\|([^|]+)\|([^|]+)\|", (DOCS / "baffle_vanes.md").read_text())
    params = mi.traverse(mistray.load("baffle_tube"))
    figure = Figure(figsize=(10, 2.9), layout="constrained")
    for k, (axes, name) in enumerate(zip(figure.subplots(1, 3), ("start", "optimised", "by rays"), strict=True)):
        axes.plot([0, 102], [30, 30], color=BLACK, lw=1.5)
        for number, *radii in rows:
            z = float(params[f"tube_vane_{number}.z1"][0])
            axes.plot([z, z], [30, float(radii[k])], color=VERMILION, lw=1.5)
        axes.plot([102, 102], [0, 18], color=GREEN, lw=2)
        axes.set(title=name, xlim=(-3, 106), ylim=(0, 32), xlabel="z [mm]", ylabel="radius [mm]")
    figure.supxlabel("light from the left; orange: vanes; green: the lens", fontsize=9, color="0.35")
    return figure


def phone_camera_pst() -> Figure:
    """PST of the phone camera and of the study, from the table of its page."""
    from validation.tables import read, value

    rows = read("phone_camera_pst.md", "pst")
    figure = Figure(figsize=(9, 4.4), layout="constrained")
    axes = figure.subplots()
    for column, colour in (
        ("all light", BLACK), ("image", BLUE), ("straight shots", GREEN), ("ghosts", VERMILION),
        ("single scatter", PURPLE),
    ):  # fmt: skip
        found = [(float(row["angle °"]), *value(row[column])) for row in rows if row[column] != "–"]
        axes.errorbar(*np.array(found).T, color=colour, marker="o", ms=3, lw=1.2, capsize=2, label=column)
    study = [(float(row["angle °"]), float(row["Table 27"])) for row in rows if row["Table 27"] != "–"]
    axes.plot(*np.array(study).T, "x", color=ORANGE, ms=7, mew=2, label="the study's Table 27")
    axes.set(yscale="log", xlabel="field angle [deg]", ylabel="PST, normal")
    axes.grid(color="0.92")
    axes.spines[["top", "right"]].set_visible(False)
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def baffle_tube() -> Figure:
    """Section of the tube with vanes."""
    from mistray.report import baffle_figure

    return baffle_figure(shown("baffles")["tube"])


def two_stage_baffle() -> Figure:
    """Section of the baffle of two stages."""
    from mistray.report import baffle_figure

    return baffle_figure(shown("baffles", 4)["star_tracker"], exclusion_deg=40)


def cassegrain() -> Figure:
    """Section of a Cassegrain telescope with its baffles."""
    from mistray.report import cassegrain_figure

    made = shown("baffles", 5)
    return cassegrain_figure(made["telescope"], made["baffles"])


def transfer() -> Any:
    """The image of the phone camera at 10°, with its scatter and ghosts."""
    lens = mistray.load("phone_camera_scatter")
    return mistray.transfer(lens, 10.0, rays=30_000, max_reflections=2, pixel_mm=0.0014)[0]


def transfer_mtf() -> Figure:
    """MTF with and without stray light."""
    from mistray.analyses.transfer.figures import mtf_figure

    return mtf_figure(transfer(), "phone camera")


def transfer_spread() -> Figure:
    """Irradiance about the image, and encircled energy."""
    from mistray.analyses.transfer.figures import spread_figure

    return spread_figure(transfer(), "phone camera")


def ghosts_in_colour() -> Figure:
    """Ghosts of the Cooke triplet with a quarter wave of MgF2 on every surface."""
    from mistray.analyses.ghosts.colour import ColourPictures

    lens = mistray.coat("cooke_triplet", {"L?_*": "mgf2_quarter_wave"})
    lines = (430, 460, 490, 520, 550, 580, 610, 640, 670)
    return ColourPictures(mistray.ghosts(lens, 10, lines, rays=1_000_000)).figure(10.0)


def screenshot(command: str, page: str, height: int) -> bytes:
    """PNG of the top of a page that a command of mistray writes, 1280 pixels wide, by Chromium."""
    from analyses.explorer.chromium import SOFTWARE_WEBGL
    from analyses.explorer.chromium import page as browser

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        subprocess.run([sys.executable, "-m", "mistray", *command.split()], cwd=folder, check=True, capture_output=True)
        with browser(Path(folder) / "profile", SOFTWARE_WEBGL) as shown:
            shown.open((Path(folder) / page).as_uri(), 1280, height)
            shown.until("document.readyState === 'complete'")
            shown.run(f"new Promise((done) => setTimeout(done, {DRAWN_MS}))")
            return base64.b64decode(shown.ask("Page.captureScreenshot")["data"])


def report_page() -> bytes:
    """The top of a report."""
    return screenshot("ghosts phone_camera --field-deg 0 10 20 --rays 2e4 --out ghosts", "ghosts/report.html", 840)


def view_page() -> bytes:
    """The Cooke triplet in three dimensions."""
    return screenshot("view cooke_triplet --field-deg 10 --rays 4000 --out view.html", "view.html", 690)


def explorer_page() -> bytes:
    """The explorer of the phone camera, traced after its fourth lens has got a coating."""
    from analyses.explorer.test_browser import click, served, turn, until_traced

    from mistray.analyses.explorer.explorer import Explorer

    explorer = Explorer("phone_camera", field_deg=[10.0, 0.0, 20.0])
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder, served(explorer, Path(folder)) as page:
        page.ask("Emulation.setScrollbarsHidden", hidden=True)
        turn(page, "coating L4", "bbar4")
        until_traced(page)
        click(page, "table.paths td button")
        page.until("document.querySelector('svg.rays .ray')")
        page.until("!document.querySelector('.mistray-explorer').dataset.busy")
        clip = {"x": 0, "y": 0, "width": page.run("innerWidth"), "height": 1120, "scale": 1}
        return base64.b64decode(page.ask("Page.captureScreenshot", clip=clip)["data"])


PICTURES: dict[str, Callable[[], Figure | bytes]] = {
    "report_top": report_page,
    "view_triplet": view_page,
    "explorer": explorer_page,
    "detectors_beam_splitter": beam_splitter,
    "detectors_probes": probes,
    "bodies_cube": cube,
    "design_path_fold": fold,
    "mechanics_tube": tube,
    "baffle_tube": baffle_tube,
    "two_stage_baffle": two_stage_baffle,
    "cassegrain": cassegrain,
    "diffraction_ring": diffraction,
    "freeform_terms": freeform_terms,
    "sources_kinds": sources,
    "pst_phone_camera": pst_of_the_camera,
    "image_quality_mtf": image_quality,
    "phone_camera_transfer": transfer_mtf,
    "phone_camera_spread": transfer_spread,
    "triplet_mgf2_colour": ghosts_in_colour,
    "sensitivity_ranking": sensitivity,
    "baffle_vanes_sections": vanes_by_gradients,
    "phone_camera_pst": phone_camera_pst,
    "phone_camera_mitigation": phone_camera_mitigation,
}


def drawn(name: str) -> bytes:
    """A picture as PNG, as fine as a page shows it."""
    picture = PICTURES[name]()
    if isinstance(picture, bytes):
        return picture
    content = io.BytesIO()
    picture.savefig(content, format="png", dpi=150)
    return content.getvalue()
