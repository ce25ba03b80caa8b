"""Loading of scenes from files, dicts and names of shipped scenes."""

from __future__ import annotations

import difflib
import os
import os.path
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

import mitsuba as mi

from mistray._mitsuba_compat import own_folder_first
from mistray._variant import ensure_variant, reading_threads
from mistray.errors import MistrayError, MistrayWarning
from mistray.materials.mate import shown
from mistray.ranges import OfType, Several
from mistray.replace_file import refuse_read
from mistray.scene.allowed_plugins import RESOURCES, check_dict, check_file
from mistray.scene.check import check_overlaps, check_values
from mistray.scene.depth import check_source
from mistray.scene.improbable import improbable
from mistray.scene.messages import explain, is_interrupt
from mistray.scene.mitsuba_bsdfs import translate_bsdfs
from mistray.scene.other_sensors import sensor_dicts
from mistray.scene.other_sources import source_dicts, with_parts
from mistray.scene.source import remember
from mistray.scene.xml_file import with_whole_paths
from mistray.spectra.spectrum import DEFAULT_NM

LONGEST_NAME = 400  # characters of a path that a message repeats
Part = str | Mapping[str, Any]
Parts = Part | Sequence[Part] | None
PARTS = Several(OfType(str | Mapping, "must be text as 'point:0,0,-500', a dict of Mitsuba, or several"), least=0)
NAMES_OFFERED = 5  # shipped scenes that are nearest to one that does not exist


def load(
    source: str | Path | ModuleType | dict[str, Any],
    sources: Parts = None,
    sensors: Parts = None,
) -> mi.Scene:
    """
    Load an optical system as a Mitsuba scene.

    Parameters
    ----------
    source : str, Path, module or dict
        A scene XML file, a shipped scene such as ``"phone_camera"`` or ``mistray.scenes.phone_camera``, or a Mitsuba
        scene dict.
    sources : str, dict or sequence of them, optional
        Sources instead of the emitters of the scene, such as ``"point:0,0,-500"`` or ``"sun:field_deg=30"``, see
        docs/sources.md; shapes that carry an emitter keep it. By default the scene keeps its emitters.
    sensors : str, dict or sequence of them, optional
        Further sensors beside those of the scene, such as ``"probe:0,0,17,half_width=20"``, see docs/detectors.md.

    Returns
    -------
    mi.Scene
        Loaded and checked scene.

    Raises
    ------
    MistrayError
        If the file is missing, nested too deeply, or too large with its includes, or Mitsuba cannot read it. It is also
        raised if a number, an id, a part, a source or a sensor is invalid, surfaces overlap, or a command is to replace
        a file that it has read. The message is one line.
    KeyboardInterrupt
        On Ctrl-C while Mitsuba builds the scene.

    Warns
    -----
    MistrayWarning
        If a scatter model or source has improbable numbers, one warning for each; see `mistray.scene.improbable`.

    Examples
    --------
    >>> scene = mistray.load("cooke_triplet")
    >>> [shape.id() for shape in scene.shapes()][:3]
    ['L1_front', 'L1_rear', 'L2_front']
    >>> sunlit = mistray.load("cooke_triplet", sources="sun:field_deg=30")
    >>> sunlit.emitters()[0].id()
    'source'
    """
    ensure_variant()
    return _loaded(source if isinstance(source, dict) else find(source), None, sources, sensors)


def load_text(path: Path, text: str, sources: Parts = None, sensors: Parts = None) -> mi.Scene:
    """
    Load a scene from a string as if it were the content of a file.

    Parameters
    ----------
    path : Path
        Path of the file; it need not exist, but its folder must.
    text : str
        Scene XML.
    sources, sensors
        Other sources and further sensors, as in `load`, which also documents the errors.
    """
    ensure_variant()
    return _loaded(path, text, sources, sensors)


def _loaded(given: Path | dict[str, Any], text: str | None, sources: Parts, sensors: Parts) -> mi.Scene:
    """
    Load a scene from a dict, a file, or a string in place of a file's content, and warn of improbable numbers.

    Raise as `load` does.
    """
    others = [] if sources is None else list(PARTS.check("sources", sources))
    more = [] if sensors is None else list(PARTS.check("sensors", sensors))
    with reading_threads():
        scene = _read(given, text, others, more)
    for line in improbable(scene):
        warnings.warn(line, MistrayWarning, stacklevel=3)
    remember(scene, given, others, more, text)
    refuse_read()
    return scene


def _read(given: Path | dict[str, Any], text: str | None, others: list[Any], more: list[Any]) -> mi.Scene:
    """
    Read and check a scene from a file, its text or a dict. Raise as `load` does.

    Sources `others`, if there are any, replace its own; the sensors `more` are added.
    """
    if isinstance(given, Path):
        check_source(given, text)
        name = _utf8(given)
        text = None if text is None else with_whole_paths(name, text)
    try:
        scene = _from_dict(given) if isinstance(given, dict) else _from_file(name, text)
    except Exception as error:  # Mitsuba raises RuntimeError and TypeError with text of many lines
        if is_interrupt(error):
            raise KeyboardInterrupt from None
        raise MistrayError(explain(error, given, text)) from None
    if not isinstance(scene, mi.Scene):
        raise MistrayError(f'scene: the dict describes a {type(scene).__name__}; add "type": "scene" at its top')
    if others or more:
        scene = _with_parts(scene, others, more)
    _light_interfaces(scene)
    check_overlaps(scene)
    return scene


def _light_interfaces(scene: mi.Scene) -> None:
    """
    Set the reference wavelength of every interface: the first wavelength, nm, of the scene's first source.

    It is `DEFAULT_NM` if that source states none. Without a source nothing is set.
    """
    lines = [getattr(emitter, "wavelengths_nm", (DEFAULT_NM,)) for emitter in scene.emitters()]
    for shape in scene.shapes():
        if lines and hasattr(shape.bsdf(), "lit_by"):
            shape.bsdf().lit_by(float(lines[0][0]))


def _with_parts(scene: mi.Scene, sources: Sequence[Part], sensors: Sequence[Part]) -> mi.Scene:
    """
    Return the scene with its sources replaced, if `sources` holds any, and further sensors added.

    Raise `MistrayError` if one is not valid, and KeyboardInterrupt on Ctrl-C.
    """
    light, seen = source_dicts(sources), sensor_dicts(sensors)
    try:
        check_values(mi.parser.parse_dict(_config(), {"type": "scene"} | light | seen))
    except (MistrayError, RuntimeError, TypeError) as error:
        raise MistrayError(explain(error, light | seen)) from None
    try:
        return with_parts(scene, light, seen)
    except (RuntimeError, TypeError) as error:
        if is_interrupt(error):
            raise KeyboardInterrupt from None
        raise MistrayError(explain(error, light | seen)) from None


def _from_file(name: str, text: str | None) -> Any:
    """
    Build the scene in a file, or in a string that replaces it; includes are first searched in its folder.

    Raise `MistrayError` as `check_file` does, and what Mitsuba raises.
    """
    with _search(os.path.dirname(name)):
        state = mi.parser.parse_file(_config(), name) if text is None else mi.parser.parse_string(_config(), text)
        check_file(state)
        return _built(state)


def _from_dict(given: dict[str, Any]) -> Any:
    """
    Build the object that a scene dict describes, after checking its plugins.

    Raise `MistrayError` if a folder of ``resources`` does not exist, or as `check_dict` does, and what Mitsuba raises.
    """
    folders = {
        key: str(item.get("path", ""))
        for key, item in given.items()
        if isinstance(item, dict) and item.get("type") == RESOURCES
    }
    for key, folder in folders.items():
        if not os.path.isdir(folder):
            raise MistrayError(f"scene: '{key}': no folder '{folder}'; correct the path")
    with _search(*folders.values()):
        described = {key: item for key, item in given.items() if key not in folders}
        check_dict(described)
        return _built(mi.parser.parse_dict(_config(), described))


def _config() -> Any:
    """
    Return the settings for Mitsuba's scene parser, without merging and without parallel loading.

    Merging is off, because merged shapes lose their names. Parallel loading is off: a thread that waits for Dr.Jit
    while it builds one of our shapes would begin the next one inside that wait. This has crashed the process.
    """
    config = mi.parser.ParserConfig(mi.variant())
    config.parallel = config.merge_equivalent = config.merge_meshes = False
    return config


@contextmanager
def _search(*folders: str) -> Iterator[None]:
    """Search further folders for files in a `with` block, the last one first after Mitsuba's own."""
    usual = mi.file_resolver()
    mi.set_file_resolver(resolver := mi.FileResolver(usual))
    for folder in folders:
        resolver.prepend(folder)
    own_folder_first(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(usual)


def _built(state: Any) -> Any:
    """
    Return the scene built from a parsed description, after checks and the translation of Mitsuba's BSDFs.

    Raise `MistrayError` as these do, and what Mitsuba raises.
    """
    check_values(state)
    config = _config()
    mi.parser.transform_all(config, state)
    translate_bsdfs(state)
    own_folder_first(mi.file_resolver())  # elements <path> came before
    return mi.parser.instantiate(config, state)


def _utf8(path: Path) -> str:
    """
    Return a file path as the UTF-8 text that Mitsuba expects, whatever the encoding of the locale.

    Raise `MistrayError` if its bytes are not UTF-8.
    """
    try:
        return os.fsencode(path).decode("utf-8")
    except UnicodeDecodeError:
        raise MistrayError(f"scene '{shown([str(path)])}': its name is not UTF-8; rename it, or its folder") from None


def shipped_scenes() -> dict[str, Path]:
    """Return the files of the scenes that come with mistray, by name."""
    from mistray import scenes

    return {name: Path(scenes.__path__[0]) / name / "scene.xml" for name in scenes.__all__}


def find(source: str | Path | ModuleType) -> Path:
    """
    Return the file of a scene.

    Parameters
    ----------
    source : str, Path or module
        An existing file, a folder with a scene.xml, or a shipped scene: its name, or ``mistray.scenes.<name>``.

    Raises
    ------
    MistrayError
        If `source` is none of these.

    Examples
    --------
    >>> mistray.scene.find("cooke_triplet").name
    'scene.xml'
    """
    if isinstance(source, ModuleType):
        source = source.__path__[0] if hasattr(source, "__path__") else source.__name__
    try:
        path, text = Path(source), str(source)
    except TypeError:
        known = "give a scene XML file, the name of a shipped scene, or a dict of Mitsuba"
        raise MistrayError(f"scene is of type {type(source).__name__}; {known}") from None
    # os.path.exists, because that of Path raises for text that is too long for a name; its reader refuses a pipe
    if os.path.exists(path) and not os.path.isdir(path):
        return path
    shipped = shipped_scenes()
    if text in shipped:
        return shipped[text]
    if os.path.isfile(path / "scene.xml"):
        return path / "scene.xml"
    if text.lstrip("\ufeff \t\r\n").startswith("<"):
        raise MistrayError(f"scene '{shown(text.split())}': this is XML text; write it to a file and give its path")
    name = text if text.isprintable() and len(text) <= LONGEST_NAME else shown([text])
    nearest = ", ".join(difflib.get_close_matches(text, shipped, n=NAMES_OFFERED, cutoff=0.0))
    raise MistrayError(f"scene '{name}': no such file; give a scene XML file or a shipped scene, such as {nearest}")
