"""Tiny scenes and studies on which `number_fuzz` tries its numbers, and the command lines that use them."""

import re
from pathlib import Path
from typing import Any

import vectors
from number_fuzz import NASTY_XML, Try, Worker
from oracles.small_scenes import interface_xml, shape_xml
from test_every_command import STUDY
from test_plugin_pages import MANUALS

from mistray.scatter.kinds import KINDS
from mistray.scatter.measured.zemax_bsdf import write_zemax_bsdf
from mistray.scatter.paint import Paint
from mistray.scatter.scan import table

BRACKET_PLY = (
    "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n"
    "property list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
)
DATA = vectors.toml("fuzz_scenes.toml")
NUMBERS: dict[str, dict[str, Any]] = DATA["numbers"]  # of plugins, as ordinary as can be
# Plugin and parameter → what stands there instead of the above, where the two do not go together
INSTEAD: dict[tuple[str, str], dict[str, Any]] = {
    (plugin, name): (NUMBERS[plugin] if how == "added" else {}) | numbers
    for how in ("added", "instead")
    for plugin, names, numbers in DATA["beside"][how]
    for name in names.split()
}
LAMP_CSV = "x_mm,y_mm,z_mm,dx,dy,dz,flux_W\n0,0,-5,0,0,1,1\n0.5,0,-5,0,0.01,1,1\n"
SOURCES, SENSORS = ({one.plugin for one in MANUALS if one.file.parent.name == kind} for kind in ("emitters", "sensors"))
PAINTS = ("paint", "tabulated")  # that scatter at the wall, not at the lens
ALONE = ("R", "T", "n_front_shift", "n_back_shift", "wavelength_nm")  # that a model has only by itself
# Numbers within texts, and those of stock plugins: object, name, kind, text
WITHIN: tuple[tuple[str, str, str], ...] = (
    *DATA["within"]["texts"],
    *((kind, "to_world", '<{} {}="{{}}"/>'.format(*move)) for kind in ("asphere", "frustum", "collimated", "rectangle")
      for move in (("translate", "z"), ("rotate", 'x="1" angle'), ("scale", "value"))),
)  # fmt: skip


def element(name: str, value: Any) -> str:
    if name == "to_world":
        return f'<transform name="to_world">{value}</transform>'
    kind = {bool: "boolean", int: "integer", float: "float"}.get(type(value), "string")
    return f'<{kind} name="{name}" value="{str(value).lower() if kind == "boolean" else value}"/>'


def scene_with(plugin: str, name: str = "", text: str = "", kind: str = "float") -> str:
    """The small scene in which an object of a plugin has a property with this text; none without a name."""
    used = dict.fromkeys(("asphere", "interface", "collimated", "straylight", "film", plugin))
    inside = {
        key: "".join(
            element(*item)
            for item in (INSTEAD.get((key, name), NUMBERS[key]) if key == plugin else NUMBERS[key]).items()
            if key != plugin or item[0] != name
        )
        for key in used
    }
    if name:
        inside[plugin] += element(name, text) if name == "to_world" else f'<{kind} name="{name}" value="{text}"/>'
    scatter = plugin if plugin in KINDS else ""
    at_wall = scatter in PAINTS or (scatter and name in ALONE)
    nested = f'<bsdf type="{scatter}">{inside[scatter]}</bsdf>' if scatter and not at_wall else ""
    film = f'<bsdf type="thinfilm">{inside["thinfilm"]}</bsdf>' if plugin == "thinfilm" else ""
    wall = f'<bsdf type="{scatter}">{inside[scatter]}</bsdf>' if at_wall else ""
    source = plugin if plugin in SOURCES else "collimated"
    own = inside[plugin]
    extra = {
        **{
            kind: f'<shape type="{kind}" id="wall">{own}{BLACK}</shape>'
            for kind in ("frustum", "part_mesh", "rectangle")
        },
        **{kind: f'<sensor type="{kind}" id="seen">{own}</sensor>' for kind in SENSORS},
        "freeform": f'<shape type="freeform" id="bent">{own}{interface_xml("air", "air")}</shape>',
        "target": f'<shape type="disk" id="aim"><bsdf type="target">{own}</bsdf></shape>',
    }.get(plugin, "")
    if at_wall:
        extra = shape_xml("frustum", "wall", bsdf=wall, r0=5.0, r1=5.0, z0=1.0, z1=9.0)
    return (
        f'<scene version="3.0.0"><integrator type="straylight">{inside["straylight"]}</integrator>'
        f'<emitter type="{source}">{inside[source]}</emitter>'
        f'<shape type="asphere" id="front">{inside["asphere"]}<bsdf type="interface">{inside["interface"]}'
        f"{film}{nested}</bsdf></shape>"
        + shape_xml("asphere", "rear", 3.0, interface_xml("1.5", "air"), semi_diameter=4.0)
        + shape_xml("asphere", "detector", 10.0, sensor=True, half_width=2.0, half_height=2.0).replace(
            '<integer name="width" value="64"/><integer name="height" value="64"/>', inside["film"]
        )
        + extra
        + "</scene>"
    )


# What the manual says of parameters that are numbers
NUMERIC = ("1", "1/mm", "1/sr", "mm", "mm^(1-order)", "mm^(1-i-j)", "deg", "degree", "nm", "um", "%", "W/mm²",
           "integer")  # fmt: skip
BLACK = '<bsdf type="interface"><float name="R" value="0"/></bsdf>'


def lens_text(source: str) -> str:
    """A lens of f/9 that has its focus on the detector, and another source of light."""
    front = shape_xml("asphere", "front", 0.0, interface_xml("air", "1.5"), semi_diameter=0.5, radius=4.5)
    rear = shape_xml("asphere", "rear", 3.0, interface_xml("1.5", "air"), semi_diameter=0.5)
    detector = shape_xml("asphere", "detector", 10.0, sensor=True, half_width=2.0, half_height=2.0)
    return f'<scene version="3.0.0"><integrator type="straylight"/>{source}{front}{rear}{detector}</scene>'


FAR = lens_text('<emitter type="collimated"><float name="radius" value="0.5"/></emitter>')
NEAR = lens_text(
    '<emitter type="point_source"><float name="half_angle_deg" value="0.05"/><float name="z" value="-500"/></emitter>'
)
SMALL = ("--rays", "200")
LINES = {command: tuple(line.split()) for command, line in DATA["lines"].items()}
# Further ordinary options of commands, which leave something unknown
MORE = {
    "ghosts": (
        ("--path-analysis", "power_W", "--least-share", "0.9"),
        *(("--rays", "60", "--seed", str(seed)) for seed in range(8)),  # paths of a single ray
    ),
    "thermal": (("--scene-K", "0"), ("--temperature-K", "0")),
}


# Command and option → what stands beside the option instead of the line of the command
ABOUT: dict[tuple[str, str], tuple[str, ...]] = {
    (command, option): tuple(line.replace("{line}", DATA["lines"][command]).split())
    for commands, options, line in DATA["beside"]["lines"]
    for command in commands.split()
    for option in options.split()
}
TRACED = ("ghosts", "try.xml", "--json", "--rays", "200")


def scene_tries() -> list[Try]:
    """Every number of every plugin with every nasty value; the only word of its arguments is the text of the scene."""
    places: list[tuple[str, str, str, str]] = [
        (manual.plugin, re.sub(r"_[ijkm](?=_|$)", lambda m: "_1" if m[0] == "_k" else "_5", name), "{}", "float")
        for manual in MANUALS
        if manual.plugin in NUMBERS
        for name, parameter in manual.parameters.items()
        if parameter.unit in NUMERIC
        if name != "to_world" and (manual.plugin, name) != ("target", "half_axes")
    ]
    places += [("film", name, "{}", "integer") for name in ("width", "height")]
    places += [("asphere", "space", "{}", "integer"), ("straylight", "rays", "{}", "integer")]
    places += [(plugin, name, text, "string") for plugin, name, text in WITHIN]
    return [
        Try(plugin, f"{name} {text}", value, (scene_with(plugin, name, text.format(value), kind),))
        for plugin, name, text, kind in places
        for value in NASTY_XML
    ]


def write(folder: Path) -> None:
    data = Path(__file__).parent / "data"
    (folder / "scene.xml").write_text(scene_with("abg"), encoding="utf-8")
    (folder / "lens.xml").write_text(FAR, encoding="utf-8")
    (folder / "near.xml").write_text(NEAR, encoding="utf-8")
    (folder / "dark.xml").write_text(scene_with("interface", "T", "0"), encoding="utf-8")
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    (folder / "budget.toml").write_text(vectors.text("fuzz_budget.toml"), encoding="utf-8")
    write_zemax_bsdf(table(Paint(0.05), [0.0], "specular"), folder / "black.bsdf")
    (folder / "bracket.ply").write_text(BRACKET_PLY, encoding="utf-8")
    (folder / "lamp.csv").write_text(LAMP_CSV, encoding="utf-8")
    (folder / "psd.csv").write_text("frequency_1_um,psd_um4\n0.001,1e-3\n0.1,1e-7\n2,1e-12\n", encoding="utf-8")
    (folder / "lens.zmx").write_bytes((data / "fuzz_lens.zmx").read_bytes())
    (folder / "tube.step").write_bytes((data / "vane_tube.step").read_bytes())


def usual_of(worker: Worker, command: str) -> set[str]:
    """Places of the output of a command where null stands with ordinary numbers too: few rays, no light, no stray."""
    line = LINES[command]
    answer: dict[str, Any] = worker.run((command, *line), limit_s=60.0)
    assert answer["code"] == 0, f"{command}: {answer}"
    found = set(answer["absent"])
    for other in (
        *((*line, "--rays", rays) for rays in ("2", "20", "60")),
        *((*line, *more) for more in MORE.get(command, ())),
        (*line, "--max-scatters", "0"),
        (*line, "--max-reflections", "0", "--max-scatters", "0"),
        tuple("dark.xml" if word == "scene.xml" else word for word in line),
    ):
        found |= set(worker.run((command, *other), limit_s=60.0)["absent"])
    return found
