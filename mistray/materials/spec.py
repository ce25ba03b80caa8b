"""Parts of a material string, parsed without any look-up."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

from mistray.errors import MistrayError
from mistray.ranges import ABBE_NUMBER, EXTINCTION, INDEX, INDEX_SHIFT, SCATTER_PER_MM

MITSUBA = "mitsuba/"  # before the name of a material of which Mitsuba has tables
LEAST_REAL = 0.99  # n without k: gases and vacuum may lie below the air that is 1 in a lens file
GAS_INDEX = 1.01  # below it a medium is no solid and no liquid
_NUMBER = r"(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_REAL = re.compile(rf"[-+]?{_NUMBER}")
_COMPLEX = re.compile(rf"([-+]?{_NUMBER})\s*([-+])\s*({_NUMBER})\s*[ij]")
_ND_VD = re.compile(rf"nd\s*=\s*([-+]?{_NUMBER})\s*[,;\s]\s*Vd\s*=\s*([-+]?{_NUMBER})", re.IGNORECASE)
_SAMPLE = rf"([nk])\(\s*({_NUMBER})\s*\)\s*=\s*({_NUMBER})"
_SAMPLES = re.compile(rf"{_SAMPLE}(?:[,;\s]\s*{_SAMPLE})*")
_ENTRY = re.compile(r"(.*\.(?:agf|dat)):(.+)", re.IGNORECASE)
_SUFFIX = re.compile(r"\s+(?:(extrapolate)|(k|shift|scatter|g)\s*=\s*(\S*))$", re.IGNORECASE)


@dataclass(frozen=True)
class Constant:
    """Material with the same n at every wavelength. k is None if the string does not state it, and then counts as 0."""

    n: float
    k: float | None


@dataclass(frozen=True)
class AbbeNumber:
    """Glass of which only the index nd at 587.6 nm and the Abbe number Vd are known."""

    nd: float
    vd: float


@dataclass(frozen=True)
class IndexSamples:
    """Material tabulated in its string: ascending pairs of wavelength, nm, and n; and of k, empty if not given."""

    points: tuple[tuple[float, float], ...]
    k_points: tuple[tuple[float, float], ...] = ()


@dataclass(frozen=True)
class UserFile:
    """File with n and k of a material: CSV table (no `entry`), or an entry of an AGF or Zemax coating file."""

    path: str
    entry: str | None


@dataclass(frozen=True)
class MitsubaData:
    """Material string that names a material of Mitsuba's own tables of n and k."""

    name: str


@dataclass(frozen=True)
class Name:
    """Material string that is a name in the catalogues of glasses and other materials."""

    name: str


Form = Constant | AbbeNumber | IndexSamples | UserFile | MitsubaData | Name


@dataclass(frozen=True)
class BulkScatter:
    """
    Scatter inside the volume of a material.

    Attributes
    ----------
    per_mm : float
        Scattering coefficient, 1/mm: fraction of the light that is scattered per length.
    g : float
        Asymmetry parameter of the Henyey-Greenstein phase function, its mean cosine, -1 < g < 1.

    Examples
    --------
    >>> haze = mistray.materials.BulkScatter(per_mm=0.002, g=0.9)
    >>> print(f"{1 - np.exp(-haze.per_mm * 10):.3f} of the light is scattered in 10 mm")
    0.020 of the light is scattered in 10 mm
    """

    per_mm: float = 0.0
    g: float = 0.0


@dataclass(frozen=True)
class Spec:
    """
    Parsed material string.

    Attributes
    ----------
    text : str
        String without leading and trailing spaces.
    form : Constant, AbbeNumber, IndexSamples, UserFile, MitsubaData or Name
        Material that the string names, without the suffixes.
    suffix : str
        Suffixes as they were written, with the space before them; "" without any.
    k : float or None
        Value of the suffix ``k=VALUE``; None without it.
    shift : float
        Value of the suffix ``shift=VALUE``, added to n; 0 without it.
    extrapolate : bool
        Whether the suffix ``extrapolate`` is given.
    bulk : BulkScatter
        Values of the suffixes ``scatter=PER_MM`` and ``g=G``, 0 without them.
    """

    text: str
    form: Form
    suffix: str
    k: float | None
    shift: float
    extrapolate: bool
    bulk: BulkScatter


@lru_cache(maxsize=1024)
def parse(material: str) -> Spec:
    """
    Return the parts of a material string.

    Raises
    ------
    MistrayError
        If a value is not a number or is out of its range, a suffix or k is given twice, ``g=`` has no ``scatter=``, n
        is missing, or a file of several materials is given without the name of one.
    """
    text = material.strip()
    body, given = text, dict[str, str]()
    while match := _SUFFIX.search(body):
        key, value = ("extrapolate", "") if match[1] else (match[2].lower(), match[3])
        if key in given:
            shown = key if match[1] else f"{key}="
            raise MistrayError(f"material '{text}': '{shown}' is given twice; give it once")
        given[key] = value
        body = body[: match.start()]
    k = _k(text, given["k"]) if "k" in given else None
    form = _form(text, body, k)
    if k is not None and isinstance(form, Constant) and form.k is not None:
        raise MistrayError(f"material '{text}': k is given twice; leave out 'k=' or the imaginary part")
    if k is not None and isinstance(form, IndexSamples) and form.k_points:
        raise MistrayError(f"material '{text}': k is given twice; leave out 'k=' or the points of k")
    shift = _shift(text, given["shift"]) if "shift" in given else 0.0
    return Spec(text, form, text[len(body) :], k, shift, "extrapolate" in given, _bulk(text, given))


def shifted(material: str, by: float) -> str:
    """
    Return the material string with `by` added to n at every wavelength, in its suffix ``shift=VALUE``.

    A total shift of 0 leaves no such suffix.

    Examples
    --------
    >>> melt = mistray.materials.shifted("N-BK7", 0.0005)
    >>> melt
    'N-BK7 shift=0.0005'
    >>> print(f"{mistray.materials.refractive_index(melt, 587.56):.4f}")
    1.5173
    """
    if not by:
        return material
    spec = parse(material)
    others = re.sub(r"\s+shift\s*=\s*\S*", "", spec.suffix, flags=re.IGNORECASE)
    total = float(spec.shift + by)
    return f"{spec.text[: len(spec.text) - len(spec.suffix)]}{others}{f' shift={total!r}' if total else ''}"


def _form(text: str, body: str, k: float | None) -> Form:
    if body.lower() in ("air", "vacuum"):
        return Constant(1.0, None)
    if _REAL.fullmatch(body):
        return Constant(_real_index(text, float(body)), None)
    if match := _COMPLEX.fullmatch(body):
        n, k = float(match[1]), float(match[3])
        if match[2] == "-" and k != 0:
            raise MistrayError(f"material '{text}': k is negative; an absorbing material is n+ki with k > 0 here")
        if k == 0:
            _real_index(text, n)
        return Constant(INDEX.check("index", n, f"material '{text}'"), _extinction(text, k))
    if match := _ND_VD.fullmatch(body):
        nd, vd = _real_index(text, float(match[1])), float(match[2])
        return AbbeNumber(nd, ABBE_NUMBER.check("Vd", vd, f"material '{text}'"))
    if _SAMPLES.fullmatch(body):
        return _samples(text, body, k)
    if match := _ENTRY.fullmatch(body):
        return UserFile(match[1].strip(), match[2].strip())
    if body.lower().endswith((".agf", ".dat")):
        raise MistrayError(f"material '{text}': which material of the file? Write '{body}:NAME'")
    if body.lower().endswith(".csv"):
        return UserFile(body, None)
    if body.startswith(MITSUBA):
        return MitsubaData(body.removeprefix(MITSUBA))
    return Name(body)


def _samples(text: str, body: str, given_k: float | None) -> IndexSamples:
    tables: dict[str, dict[float, float]] = {"n": {}, "k": {}}
    for name, wavelength, value in re.findall(_SAMPLE, body):
        nm, table = float(wavelength), tables[name]
        if nm <= 0:
            raise MistrayError(f"material '{text}': wavelength {nm:g} nm; it must be greater than 0")
        if nm in table:
            raise MistrayError(f"material '{text}': a wavelength is there twice; give it once")
        table[nm] = float(value)
    if not tables["n"]:
        raise MistrayError(f"material '{text}': it has k and no n; add n, as in 'n(550)=0.2 k(550)=3.1'")
    absorbs = bool(tables["k"]) or given_k is not None  # it may be a metal, whose n is small
    for value in tables["n"].values():
        INDEX.check("index", value, f"material '{text}'") if absorbs else _real_index(text, value)
    for value in tables["k"].values():
        _extinction(text, value)
    return IndexSamples(*(tuple(sorted(table.items())) for table in tables.values()))


def _real_index(text: str, index: float) -> float:
    if index < LEAST_REAL:
        raise MistrayError(f"material '{text}': index {index:g}; a real index is at least {LEAST_REAL:g}")
    return float(INDEX.check("index", index, f"material '{text}'"))


def _extinction(text: str, k: float) -> float:
    return float(EXTINCTION.check("k", k, f"material '{text}'"))  # n + ik, k > 0 absorbs


def _k(text: str, value: str) -> float:
    if not _REAL.fullmatch(value):
        raise MistrayError(f"material '{text}': k = '{value}' is not a number; write for instance 'k=0' or 'k=1e-7'")
    return _extinction(text, float(value))


def _shift(text: str, value: str) -> float:
    if not _REAL.fullmatch(value):
        raise MistrayError(f"material '{text}': shift = '{value}' is not a number; write for instance 'shift=-2e-4'")
    return float(INDEX_SHIFT.check("shift", float(value), f"material '{text}'"))


def _bulk(text: str, given: dict[str, str]) -> BulkScatter:
    if "scatter" not in given:
        if "g" in given:
            raise MistrayError(f"material '{text}': 'g=' without 'scatter='; give the scatter per mm as well")
        return BulkScatter()
    values = []
    for key in ("scatter", "g"):
        value = given.get(key, "0")
        if not _REAL.fullmatch(value):
            raise MistrayError(f"material '{text}': {key} = '{value}' is not a number; write for instance '{key}=0.01'")
        values.append(float(value))
    per_mm, g = values
    SCATTER_PER_MM.check("scatter", per_mm, f"material '{text}'")
    if not -1 < g < 1:
        raise MistrayError(f"material '{text}': g = {g:g}; the mean cosine of the scatter lies between -1 and 1")
    return BulkScatter(per_mm, g)
