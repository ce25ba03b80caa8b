"""Reading of configurations from TOML, with one-line errors that name file, key and remedy."""

from __future__ import annotations

from pathlib import Path

from mistray.analyses.sweep.configurations import Configuration
from mistray.prescription import Structure
from mistray.ranges import FINITE, SHARE, TEXT
from mistray.toolkit.toml_section import TomlSection


def read_configurations(source: str | Path) -> list[Configuration]:
    r"""
    Return configurations read from a TOML file.

    Parameters
    ----------
    source : str or Path
        A TOML file with sections ``[[configuration]]``, each with a ``name``, tables ``values``, ``paint`` and
        ``coat``, and a list ``block``; see docs/sweeps.md.

    Raises
    ------
    MistrayError
        If the file is missing or not TOML, a key is unknown or missing, a value is not a number, or there is no
        configuration.

    Examples
    --------
    >>> from pathlib import Path
    >>> lines = "[[configuration]]", 'name = "shifted"', "[configuration.values]", '"L2.y" = 0.1'
    >>> _ = Path("states.toml").write_text("\n".join(lines))
    >>> (state,) = mistray.sweeps.read_configurations("states.toml")
    >>> state.name, state.values
    ('shifted', {'L2.y': (0.1,)})
    """
    whole = TomlSection.of(source, "configurations")
    whole.known(("configuration",))
    found = [_configuration(section) for section in whole.tables("configuration")]
    if not found:
        raise whole.fail("configuration", "is missing; add at least one section [[configuration]]")
    return found


def _configuration(section: TomlSection) -> Configuration:
    section.known(Configuration.__dataclass_fields__)
    values, paint, coat = (section.table(key) for key in ("values", "paint", "coat"))
    return Configuration(
        section.value("name", TEXT),
        {key: values.numbers(key) for key in values.content},
        {key: paint.value(key, TEXT if isinstance(value, str) else SHARE) for key, value in paint.content.items()},
        {key: coat.value(key, TEXT) for key in coat.content},
        [_structure(item) for item in section.tables("block")],
    )


def _structure(section: TomlSection) -> Structure:
    """Return an absorbing frustum (radii and z in mm) from a TOML table; one z gives a flat ring, one radius a tube."""
    section.known(("name", "r0", "z0", "r1", "z1"))
    r0, z0, r1, z1 = (section.value(key, FINITE, None) for key in ("r0", "z0", "r1", "z1"))
    if r0 is None or z0 is None:
        raise section.fail("r0" if r0 is None else "z0", "is missing; give r0 and z0, and r1, z1 or both")
    return Structure(section.value("name", TEXT), r0, z0, r0 if r1 is None else r1, z0 if z1 is None else z1)
