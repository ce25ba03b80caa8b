"""The pages that scripts write are current; examples of the plugins load; tables of pages say what the code does."""

from __future__ import annotations

import importlib
import importlib.util
import re
from pathlib import Path
from typing import Any

import mitsuba as mi
import numpy as np
import peers
import pytest
import vectors
from example_scripts import DOCS, ROOT, script

from mistray._variant import plugin_modules
from mistray.mechanics.ply import ply_bytes
from mistray.metrics.parameters import parameters
from mistray.scatter.measured.zemax_bsdf import write_zemax_bsdf
from mistray.scatter.paint import Paint
from mistray.scatter.scan import table
from mistray.scene.messages import parameters as names_for_messages

PAGES = script("make_plugin_pages", DOCS)
MANUALS = PAGES.manuals()
BY_NAME = {manual.plugin: manual for manual in MANUALS}
CELLS = ("unit", "allowed", "usual", "doc", "moves")
every_plugin = pytest.mark.parametrize("manual", MANUALS, ids=lambda manual: manual.plugin)


@pytest.fixture
def files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A working folder with the files that the examples name."""
    monkeypatch.chdir(tmp_path)
    Path("lamp.csv").write_text("x_mm,y_mm,z_mm,dx,dy,dz,flux_W\n0,0,-5,0,0,1,1\n")
    Path("polish.csv").write_text("frequency_1_mm,psd_nm2_mm2\n1,1e-4\n1000,1e-9\n")
    write_zemax_bsdf(table(Paint(0.05), [0.0], "specular"), "black.bsdf")
    for name in ("bracket.ply", "camera_bracket.ply"):
        Path(name).write_bytes(ply_bytes(np.eye(3), np.array([[0, 1, 2]])))


def loaded(xml: str) -> Any:
    """A scene of an example; a BSDF without an id gets a shape, because Mitsuba passes it over otherwise."""
    if xml.startswith("<bsdf") and " id=" not in xml.split(">")[0]:
        xml = f'<shape type="asphere"><float name="semi_diameter" value="1"/>{xml}</shape>'
    return mi.load_string(f'<scene version="3.0.0">{xml}</scene>')


def names_of(manual: Any) -> list[str]:
    """Names of the parameters of a plugin, without nested objects."""
    return [name for name in manual.parameters if not name.startswith("(")]


def own_part(recipe: dict[str, Any]) -> dict[str, Any]:
    """The plugin in a recipe of an example: itself, or the BSDF of a stock shape."""
    return recipe if recipe["type"] in BY_NAME else recipe["bsdf"]


def strangers(names: set[str], told: set[str]) -> set[str]:
    """Those of `names` that `told` does not have, where ``xy_i_j`` stands for any numbers i and j."""
    forms = re.compile("|".join(re.sub(r"_[ijkmn](?=_|$)", r"_\\d+", name) for name in told) or "(?!)")
    return {name for name in names if not forms.fullmatch(name)}


def test_pages_are_current_and_every_plugin_has_one() -> None:
    """After a change of a docstring: python docs/make_plugin_pages.py."""
    written = {page.name: page.read_text(encoding="utf-8") for page in PAGES.PAGES.glob("*.md")}
    assert written == PAGES.pages()
    modules = [ROOT / "plugins" / f"{name.replace('.', '/').partition('plugins/')[2]}.py" for name in plugin_modules()]
    plugins = {file.stem for file in modules if "\nmi.register_" in file.read_text(encoding="utf-8")}
    assert {manual.plugin for manual in MANUALS} == {manual.file.stem for manual in MANUALS} == plugins
    for text in written.values():
        for target in re.findall(r"\]\(([^)#]+)", text):
            assert (PAGES.PAGES / target).resolve().is_file(), target
        for markup in ("``", ".. ", ":monosp:"):
            assert markup not in text.replace("```", "")


def test_the_page_of_imported_files_is_current() -> None:
    """After a change of a reader: python docs/make_import_page.py."""
    peers.need("rayoptics")
    pytest.importorskip("batoid")
    module = script("make_import_page", DOCS)
    assert module.PAGE.read_text(encoding="utf-8") == module.page()


@every_plugin
def test_table_is_complete_and_what_messages_suggest(manual: Any) -> None:
    """What is suggested for a misspelt property are the names of the table."""
    for name, row in manual.parameters.items():
        assert row.usual, f"{name}: no default; 'required' where there is none"
        assert row.unit, f"{name}: no unit; 1 for a number"
        assert row.allowed or row.unit not in ("mm", "nm", "um", "W/mm²", "1/sr", "%", "1"), f"{name}: no range"
        assert row.doc, f"{name}: no meaning"
    assert names_of(manual) == names_for_messages(manual.plugin)


@every_plugin
def test_pages_read_from_source_what_the_class_declares(manual: Any) -> None:
    """The page maker evaluates the declarations without importing them; `help` shows all of them."""
    module = importlib.import_module(f"mistray.plugins.{manual.kind}.{manual.plugin}")
    owner = next(
        one
        for one in vars(module).values()
        if "properties" in getattr(one, "__dict__", {}) and one.__module__ == module.__name__
    )
    assert list(owner.properties) == list(manual.parameters)
    for name, param in owner.properties.items():
        read = manual.parameters[name]
        assert [getattr(param, key) for key in CELLS] == [getattr(read, key) for key in CELLS], name
        assert param.doc in owner.__doc__
    owner.__doc__, shown = None, owner.__doc__  # as under python -OO
    assert names_for_messages(manual.plugin) == names_of(manual)
    owner.__doc__ = shown


@every_plugin
def test_examples_load(manual: Any, files: None) -> None:
    assert loaded(manual.example("xml")) is not None
    assert f'type="{manual.plugin}"' in manual.example("xml")
    recipe = eval(manual.example("python"))
    own = own_part(recipe)
    assert own["type"] == manual.plugin
    told = set(names_of(manual))
    assert not strangers({key for key, value in own.items() if not isinstance(value, dict)} - {"type"}, told)
    assert mi.load_dict(recipe, optimize=False) is not None


OTHER_RECIPES = vectors.toml("tables.toml")["recipes"]


@pytest.mark.parametrize(
    "recipe", [eval(manual.example("python")) for manual in MANUALS] + OTHER_RECIPES, ids=lambda recipe: recipe["type"]
)
def test_table_knows_what_is_differentiable(recipe: dict[str, Any], files: None) -> None:
    """What `mi.traverse` offers with a gradient is marked in the table, and the other way round."""
    recipe = own_part(recipe)
    if (recipe["type"], "semi_diameter" in recipe) == ("asphere", True):
        recipe = {"inner_semi_diameter": 1.0, **recipe}  # the radius of a hole has a derivative where there is one
    rows = BY_NAME[recipe["type"]].parameters
    marked, named = {name for name, row in rows.items() if row.moves}, set(rows)
    made = mi.load_dict(recipe, optimize=False)
    if not isinstance(made, (mi.BSDF, mi.Shape, mi.Emitter)):
        assert not marked
        return
    offered = mi.traverse(made)
    fixed = mi.ParamFlags.NonDifferentiable.value
    with_gradient = {key for key in offered.keys() if not offered.flags(key) & fixed}  # noqa: SIM118
    assert not strangers(with_gradient - strangers(with_gradient, named), marked), "not marked"
    assert {key for key in marked if key in offered} <= with_gradient, "marked, but it has no gradient"
    own = {key for key in with_gradient if "." not in key and not key.startswith("vertex_")}
    assert not strangers(own, named | {"thickness_nm"}), "not in the table"  # the thickness of layers is below it


TABLES = script("make_key_tables", DOCS)


@pytest.mark.parametrize("name", TABLES.PAGES)
def test_a_page_is_current(name: str) -> None:
    """After a change of a field: python docs/make_key_tables.py."""
    assert (TABLES.DOCS / name).read_text(encoding="utf-8") == TABLES.page(name)


def test_every_section_has_its_table() -> None:
    text = "".join(TABLES.page(name) for name in TABLES.PAGES)
    shown = [section for found in TABLES.TABLE.finditer(text) for section in found[2].split(", ")]
    assert shown == list(TABLES.SECTIONS)


PAGE = (Path(__file__).parents[1] / "docs" / "mitsuba.md").read_text(encoding="utf-8")


def test_each_key_of_the_table_is_a_parameter_in_its_unit() -> None:
    here: dict[str, Any] = {}
    code = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    exec(code[0].partition("scene = ")[0], here)
    exec(code[-1].partition("for key")[0], here)
    known, params = parameters(here["scene"]), mi.traverse(here["scene"])
    rows = re.findall(r"^\| `([\w.]+)` \| (\S+) \|", PAGE, re.MULTILINE)
    assert len(rows) == 20
    for key, unit in rows:
        assert key in params, key
        assert known[key].unit == unit, key
