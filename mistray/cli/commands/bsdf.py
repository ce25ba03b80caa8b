"""`mistray bsdf`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.cli import bsdf_models
from mistray.cli.options import Options
from mistray.cli.progress import working
from mistray.errors import MistrayError
from mistray.ranges import AZIMUTH_DEG, CHANCE, FIELD_DEG, POLAR_DEG, SHARE, SOLID_ANGLE_SR, WAVELENGTH_NM
from mistray.toolkit.command import Command, Group, Option
from mistray.toolkit.shared_options import FORCE

if TYPE_CHECKING:
    from mistray.scatter import LobeModel
    from mistray.scatter.chance import Chance
    from mistray.scatter.scan import IncidentLight, Scan

DEFAULT_ROTATIONS = (0.0, 90.0)
DEFAULT_ANGLES = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0)
EVENTS = ("reflection", "transmission")
# The way from a roughness to A, B and g: text, attribute, unit of the text, name in JSON
SHEET = (
    ("As", "psd_amplitude_um4", "µm⁴", "psd_amplitude_um4"),
    ("Bs", "psd_length_um", "µm", "psd_length_um"),
    ("C", "psd_slope", "", "psd_slope"),
    ("D", "bsdf_per_psd", "µm⁻⁴", "bsdf_per_psd_per_um4"),
    ("BSDF(0)", "bsdf_0", "1/sr", "bsdf_0_1_sr"),
    ("Bennett and Porteus TIS", "tis", "", "tis"),
    ("correction", "correction", "", "correction"),
    ("shortest wavelength", "shortest_wavelength_um", "nm", "shortest_wavelength_um"),
    ("A", "a", "1/sr", "A_1_sr"),
    ("B", "b", "", "B"),
    ("g", "g", "", "g"),
)


# fmt: off
COMMAND = Command(
    "bsdf",
    "BSDF and total scatter of a scatter model",
    "Evaluate a scatter model: its BSDF against |β - β0| and against the angle of scatter, and the\n"
    "light that it scatters (TIS) at several angles of incidence. Pictures, curves and tables.",
    (
        "mistray bsdf abg --A 0.0025 --B 0.001 --g 1.8 --plot abg.png",
        "mistray bsdf abg --rms-nm 5 --correlation-um 100 --wavelength-nm 500 --R 0.95",
        "mistray bsdf harvey_shack --rms-nm 4 --event transmission --back 1.5333 --plot polished.png",
        "mistray bsdf particulate --level 300 --event transmission --plot dust.png",
        "mistray bsdf paint --preset flat_black --json",
        "mistray bsdf measured.bsdf --table copy.csv",
        "mistray bsdf abg --A 2e-5 --B 1e-6 --g 2 --event transmission --hit-deg 30 --hit-sr 4e-6 --hit-before 0.125",
    ),
    (
        bsdf_models.model_argument,
        Option("--angles-deg", "angles of incidence (0 15 30 45 60 75)",
               POLAR_DEG, "DEG", "+", default=list(DEFAULT_ANGLES)),
        Option("--rotations-deg", "anisotropic tables: azimuths of the sample's x axis from that of the specular "
               "direction (0 90)", AZIMUTH_DEG, "DEG", "+"),
        Option("--event", "what is drawn and written (what the model scatters first)", EVENTS),
        Option("--wavelength-nm", "wavelength (550)", WAVELENGTH_NM, "NM", default=550.0),
        Option("--front", "material in front (air)", metavar="MATERIAL", default="air"),
        Option("--back", "material behind (N-BK7)", metavar="MATERIAL", default="N-BK7"),
        Option("--from-back", "light comes from behind", bool),
        Option("--R", "what the coating reflects (1: BSDF of the reflected beam)", SHARE, "SHARE", default=1.0),
        Option("--T", "what it transmits (1: BSDF of the transmitted beam)", SHARE, "SHARE", default=1.0),
        Option("--plot", "write a picture: .png, .svg or .pdf", Path, "FILE", writes=()),
        Option("--plot-particles", "particulate: write a picture of the sizes and of the covered area", Path, "FILE",
               writes=()),
        Option("--csv", "write the curves in the plane of incidence", Path, "FILE", writes=()),
        Option("--table", "write a table over the hemisphere, for scenes: .bsdf (Zemax) or .csv", Path, "FILE",
               writes=()),
        FORCE,
        Option("--json", "print JSON instead of the tables, with the curves", bool),
        Group("a world without importance sampling: rays until one finds a small detector", (
            Option("--hit-deg", "angle of the detector with the normal, at the first angle of incidence",
                   FIELD_DEG, "DEG"),
            Option("--hit-sr", "its solid angle as seen from the surface", SOLID_ANGLE_SR, "SR"),
            Option("--hit-before", "chance that a ray gets to the surface (1)", CHANCE, "SHARE"),
        )),
        bsdf_models.parameter_options,
    ),
)
# fmt: on


def run(options: Options) -> int:
    """Run the command."""
    from mistray.scatter.scan import scan

    options.check_pictures("plot", "plot_particles")
    if options.table is not None and options.table.suffix.lower() not in (".bsdf", ".csv"):
        raise MistrayError(f"table '{options.table}': its name must end in .bsdf (Zemax) or .csv")
    if options.plot_particles is not None and options.model != "particulate":
        raise MistrayError(f"{options.model} has no particles; leave --plot-particles out")
    written = options.claim()
    model, light = bsdf_models.model_of(options), _light(options)
    lobes = model.lobes(light.wavelength_nm, light.n_in, light.n_out, light.from_front)
    events = [event for event in EVENTS if any(lobe.event == event for lobe in lobes)]
    if not events:
        raise MistrayError(f"{options.model} scatters nothing from this side; raise its amount or turn --from-back")
    event = options.event or events[0]
    turned = any(lobe.anisotropic for lobe in lobes)
    if options.rotations_deg is not None and not turned:
        raise MistrayError(f"{options.model} scatters alike however the sample is turned; leave --rotations-deg out")
    rotations = (options.rotations_deg or DEFAULT_ROTATIONS) if turned else (0.0,)
    lights = [replace(light, rotation_deg=rotation) for rotation in rotations]
    with working("evaluating the model"):
        curves = [one for lit in lights for one in scan(model, options.angles_deg, event, lit)]
        totals = [row for lit in lights for row in _total_rows(model, options.angles_deg, events, lit, turned)]
    unaimed = _chance(options, model, event, lights[0])
    title = _title(options, model)
    if options.plot is not None:
        from mistray.analyses.bsdf.figures import bsdf_figure
        from mistray.toolkit.figures.plots import write_figure

        write_figure(bsdf_figure(curves, title, _knee(model, event, light)), options.plot)
    if options.plot_particles is not None:
        from mistray.analyses.bsdf.figures import particles_figure
        from mistray.toolkit.figures.plots import write_figure

        particles: Any = model
        write_figure(particles_figure(particles.cleanliness, particles.slope), options.plot_particles)
    if options.csv is not None:
        _write_curves(curves, options.csv, options.command_line, turned)
    if options.table is not None:
        _write_table(model, options, event, light)
    sides = f"{title}: {options.front} | {options.back}, {light.wavelength_nm:g} nm"
    return options.tell(
        lambda: _record(options, title, model, totals, curves, light, unaimed),
        lambda: f"{sides}\n" + "\n\n".join([*_notes(model), *_sheet(options), _totals(totals), *_hits(unaimed)]),
        written,
    )


def _record(
    options: Options,
    title: str,
    model: LobeModel,
    totals: list[dict[str, Any]],
    curves: list[Scan],
    light: IncidentLight,
    unaimed: Chance | None,
) -> dict[str, Any]:
    """Return the record that --json prints: notes, A, B and g from a roughness, totals of all events, curves of one."""
    from mistray.files.json_values import plain

    sheet = bsdf_models.roughness_sheet(options)
    roughness = None
    if sheet is not None:
        roughness = {name: getattr(sheet, attribute) for _, attribute, _, name in SHEET}
    record = {
        "model": title,
        "front": options.front,
        "back": options.back,
        "from_front": light.from_front,
        "wavelength_nm": light.wavelength_nm,
        "notes": _notes(model),
        "from_roughness": roughness,
        "without_importance_sampling": {name: value for name, _, value in _hit_rows(unaimed)} if unaimed else None,
        "totals": totals,
        "event": curves[0].event,
        "curves": [
            {
                **({"rotation_deg": one.rotation_deg} if "rotation_deg" in totals[0] else {}),
                "incidence_deg": one.incidence_deg,
                "theta_s_deg": one.theta_s_deg,
                "distance": one.distance,
                "bsdf_1_sr": one.values,
            }
            for one in curves
        ],
    }
    return dict(plain(record))


def _chance(options: Options, model: LobeModel, event: str, light: IncidentLight) -> Chance | None:
    """Return the chance of a hit by rays that nobody aims, if it is requested."""
    from mistray.scatter.chance import chance

    if options.hit_deg is None and options.hit_sr is None:
        if options.hit_before is not None:
            raise MistrayError("--hit-before goes with --hit-deg and --hit-sr; give both")
        return None
    if options.hit_deg is None or options.hit_sr is None:
        raise MistrayError("--hit-deg and --hit-sr go together: where the detector is, and its solid angle")
    before = 1.0 if options.hit_before is None else options.hit_before
    incidence_deg = options.angles_deg[0]
    return chance(
        model, options.hit_deg, options.hit_sr, incidence_deg=incidence_deg, event=event, light=light, before=before
    )


def _hit_rows(unaimed: Chance) -> tuple[tuple[str, str, float], ...]:
    """Return the rows of a result of `_chance`: name in JSON, text and value."""
    return (
        ("of_scatter", "chance of this scatter", unaimed.of_scatter),
        ("total", "and of getting there", unaimed.total),
        ("rays_for_one_hit", "rays for one hit in the mean", unaimed.rays_for_one_hit),
        ("rays_for_50_percent", "rays for a hit in 50 % of runs", unaimed.rays_for(0.5)),
    )


def _hits(unaimed: Chance | None) -> list[str]:
    """Return the rows of `_hit_rows` as text; empty without a chance."""
    lines = [f"{text:<31} {value:.5g}" for _, text, value in _hit_rows(unaimed)] if unaimed else []
    return ["\n".join(["without importance sampling", *lines])] if lines else []


def _total_rows(
    model: LobeModel, angles_deg: list[float], events: list[str], light: IncidentLight, turned: bool
) -> list[dict[str, Any]]:
    """Return scattered shares and losses of the specular beam by event and angle; None where nothing is transmitted."""
    from mistray.scatter.scan import scan

    rows = []
    for event in events:
        for angle in angles_deg:
            row = {"event": event, "incidence_deg": angle, "scattered": None, "loss": None, "peak_1_sr": None}
            row |= {"rotation_deg": light.rotation_deg} if turned else {}
            if event != "transmission" or not light.is_totally_reflected(angle):
                (one,) = scan(model, [angle], event, light)
                row |= {"scattered": one.scattered, "loss": one.loss, "peak_1_sr": one.values[one.distance.argmin()]}
            rows.append(row)
    return rows


def _light(options: Options) -> IncidentLight:
    from mistray.materials import refractive_index
    from mistray.scatter.scan import IncidentLight

    sides = [refractive_index(material, options.wavelength_nm) for material in (options.front, options.back)]
    n_in, n_out = sides[::-1] if options.from_back else sides
    return IncidentLight(options.wavelength_nm, n_in, n_out, not options.from_back, options.R, options.T)


def _title(options: Options, model: LobeModel) -> str:
    """The model and the numbers it was given."""
    given = bsdf_models.given(options)
    parts = [f"{key} = {value:g}" if isinstance(value, float) else f"{key} {value}" for key, value in given.items()]
    name = options.model if options.model in bsdf_models.models() else Path(options.model).name
    return ", ".join([f"{name} {parts[0]}" if parts else name, *parts[1:]])


def _knee(model: LobeModel, event: str, light: IncidentLight) -> float | None:
    """|β - β0| at which the BSDF of a polished surface bends."""
    from mistray.scatter.abg import ABg
    from mistray.scatter.harvey_shack import HarveyShack

    if isinstance(model, ABg) and model.g > 0 and model.reference_nm is None:
        return float(model.B ** (1 / model.g))
    if isinstance(model, HarveyShack):
        return model.parameters(light.wavelength_nm, event, light.n_in, light.n_out)[1]
    return None


def _notes(model: LobeModel) -> list[str]:
    """Return notes on unusual parameters."""
    advice = getattr(model, "advice", lambda: None)()
    return [f"note: {advice}"] if advice else []


def _sheet(options: Options) -> list[str]:
    """The steps from a roughness to A, B and g."""
    sheet = bsdf_models.roughness_sheet(options)
    if sheet is None:
        return []
    values = [
        (text, getattr(sheet, attribute) * (1e3 if unit == "nm" else 1), unit) for text, attribute, unit, _ in SHEET
    ]
    return ["\n".join(f"{text:<24} {value:.9g} {unit}".rstrip() for text, value, unit in values)]


def _totals(found: list[dict[str, Any]]) -> str:
    """Table of what is scattered, and what the specular beams lose."""
    from mistray.toolkit.pages.model import Table, columns
    from mistray.toolkit.tables.text import ABSENT, table_text

    places = dict.fromkeys((row.get("rotation_deg"), row["incidence_deg"]) for row in found)
    heads, cells = ["incidence [deg]"], [[f"{angle:g}" for _, angle in places]]
    if any(rotation is not None for rotation, _ in places):
        heads, cells = ["rotation [deg]", *heads], [[f"{rotation:g}" for rotation, _ in places], *cells]
    for event in dict.fromkeys(row["event"] for row in found):
        rows = [row for row in found if row["event"] == event]
        heads += [f"{event} [TIS %]", "[loss %]", "[peak 1/sr]"]
        for key, scale in (("scattered", 100), ("loss", 100), ("peak_1_sr", 1)):
            cells.append([ABSENT if row[key] is None else f"{scale * row[key]:.4g}" for row in rows])
    text = table_text(Table(columns(*heads), list(zip(*cells, strict=True))))
    return f"{text}\nTIS: share of the incident light; loss: share of the specular beam that it loses"


def _write_curves(scans: list[Scan], path: Path, command: str, turned: bool) -> None:
    from mistray.replace_file import replace_file

    lines = [f"# {command}", ("rotation_deg," if turned else "") + "theta_i_deg,theta_s_deg,distance,bsdf"]
    for one in scans:
        rotation = f"{one.rotation_deg:.9g}," if turned else ""
        for angle, r, value in zip(one.theta_s_deg, one.distance, one.values, strict=True):
            lines.append(f"{rotation}{one.incidence_deg:.9g},{angle:.9g},{r:.9g},{value:.9g}")
    replace_file(path, "\n".join(lines) + "\n", "curves")


def _write_table(model: LobeModel, options: Options, event: str, light: IncidentLight) -> None:
    from mistray.scatter.measured.bsdf_csv import write_bsdf_csv
    from mistray.scatter.measured.zemax_bsdf import write_zemax_bsdf
    from mistray.scatter.scan import table

    zemax = options.table.suffix.lower() == ".bsdf"
    samples = table(model, options.angles_deg, "specular" if zemax else "normal", event, light)
    (write_zemax_bsdf if zemax else write_bsdf_csv)(samples, options.table, options.command_line)
