"""Damaged files are read, or refused in one line: no traceback, no hang, no crash."""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import random
import resource
import signal
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fuzzing import DAMAGES, Damage, Nest

import mistray.scenes
from mistray.coatings import read_coating_file, spectrum
from mistray.errors import MistrayError
from mistray.scene import load

DATA = Path(__file__).parent / "data"
SCENES = Path(mistray.scenes.__file__).parent
LIMIT_S = 10
MEMORY = 8 << 30  # more than before, bytes; a file that asks for more is refused, not the machine halted
LONGEST = 600  # characters of a clear line


@dataclass(frozen=True)
class Kind:
    """
    A kind of file.

    Attributes
    ----------
    samples : tuple of Path
        What is damaged.
    read : callable
        Everything that a user's command does with such a file before it traces.
    nest : Nest
    count : int
        Damaged files of each sort.
    module : str
        Where the reader is; the kind is left out while that is not there.
    """

    samples: tuple[Path, ...]
    read: Callable[[Path], object]
    nest: Nest
    count: int
    module: str


def read_coatings(path: Path) -> None:
    file = read_coating_file(path)
    wrong = None
    for name in file:
        try:
            spectrum(file[name], [550.0], [0.0, 45.0], "air", "N-BK7")
        except MistrayError as error:  # the others are looked at all the same
            wrong = error
    if wrong is not None:
        raise wrong


def read_scene(path: Path) -> None:
    """A scene that loads has a place and a size."""
    box = load(path).bbox()
    if not (np.isfinite(np.array(box.min)).all() and np.isfinite(np.array(box.max)).all()):
        raise ArithmeticError(f"the scene reaches from {box.min} to {box.max}")


def sequential(module: str, function: str) -> Callable[[Path], object]:
    """Reads a lens and writes it as a scene."""

    def read(path: Path) -> None:
        lens = getattr(importlib.import_module(module), function)(path)
        build = importlib.import_module("mistray.prescription.build")
        build.to_prescription(lens).to_xml(path.with_suffix(".xml"))

    return read


def read_step(path: Path) -> None:
    mechanics = importlib.import_module("mistray.mechanics").read_mechanics(path)
    mechanics.to_xml(path.with_suffix(".xml"))


KINDS = {
    "xml": Kind(
        tuple(SCENES / name / "scene.xml" for name in ("plate", "lens_and_reflector", "baffle_tube")),
        read_scene,
        Nest(b'<bsdf type="interface">', b"</bsdf>", rb'<(?:float|string) name="[^"]*" value="[^"]*"/>'),
        13,
        "mistray.scene",
    ),
    "coating": Kind(
        (DATA / "coating_sample.dat",),
        read_coatings,
        Nest(b"H .25 0 3\n", b"H .25 0 3\n", rb"^H .25$"),
        13,
        "mistray.coatings.zemax",
    ),
    "zmx": Kind(
        (DATA / "fuzz_lens.zmx",),
        sequential("mistray.prescription.read_zemax", "read_zemax"),
        Nest(b"SURF 1\n  TYPE STANDARD\n", b"  DISZ 1\n", rb"^  CURV.*$"),
        18,
        "mistray.prescription.read_zemax",
    ),
    "seq": Kind(
        (DATA / "fuzz_lens.seq",),
        sequential("mistray.prescription.read_codev", "read_codev"),
        Nest(b"(", b")", rb"\d+\.\d+"),
        18,
        "mistray.prescription.read_codev",
    ),
    "step": Kind(
        (DATA / "vane_tube.step", DATA / "assembly_inch.step"), read_step, Nest(b"(", b")", rb"\d+\.\d*"), 4,
        "mistray.mechanics",
    ),
}  # fmt: skip
# A process for each STEP file
SLOW = ("step",)
FOUND = {name: kind for name, kind in KINDS.items() if importlib.util.find_spec(kind.module)}

NAMES = [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in FOUND]


@contextlib.contextmanager
def limits() -> Iterator[None]:
    """Ends what takes too long or asks for too much memory by an exception."""

    def late(number: int, frame: object) -> None:
        raise TimeoutError(f"no answer within {LIMIT_S} s")

    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, hard))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def complaint(read: Callable[[Path], object], path: Path) -> str | None:
    """What is wrong with the way in which a file is read or refused; None if nothing is."""
    try:
        with limits(), warnings.catch_warnings():
            warnings.simplefilter("error")
            read(path)
    except MistrayError as error:
        text = str(error)
        if "\n" in text or len(text) > LONGEST:
            return f"{len(text.splitlines())} lines, {len(text)} characters: {text[:200]!r}"
        return None if path.name in text or text[:1].isalpha() else f"no clear line: {text!r}"
    except Exception as error:
        return f"{type(error).__name__}: {str(error)[:200]}"
    return None


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
@pytest.mark.parametrize("name", NAMES)
def test_damaged_files(name: str, damage: Damage, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    kind = FOUND[name]
    complaints = []
    for seed in range(kind.count):
        rng = random.Random(f"{name} {damage.__name__} {seed}")
        sample = rng.choice(kind.samples)
        path = tmp_path / f"damaged_{seed}{sample.suffix}"
        path.write_bytes(damage(sample.read_bytes(), rng, kind.nest))
        found = complaint(kind.read, path)
        if found:
            complaints.append(f"seed {seed}, {sample.name}: {found}")
    assert not complaints, "\n".join(complaints)


@pytest.mark.parametrize("name", NAMES)
def test_the_files_themselves_are_good(name: str, tmp_path: Path) -> None:
    """What is damaged above can be read: otherwise the tests would show nothing."""
    for sample in FOUND[name].samples:
        path = tmp_path / sample.name
        path.write_bytes(sample.read_bytes())
        if name == "coating":
            assert len(read_coating_file(path)) > 5
        else:
            FOUND[name].read(path)


def test_there_are_five_hundred() -> None:
    assert sum(kind.count for kind in KINDS.values()) * len(DAMAGES) >= 500


def test_complaints_are_noticed(tmp_path: Path) -> None:
    """A traceback, a warning, several lines and a hang are found."""

    def raises(error: Exception) -> Callable[[Path], object]:
        def read(path: Path) -> object:
            raise error

        return read

    def warns(path: Path) -> None:
        warnings.warn("overflow", RuntimeWarning, stacklevel=1)

    path = tmp_path / "x"
    assert complaint(raises(KeyError("a")), path) == "KeyError: 'a'"
    assert complaint(raises(MistrayError("a\nb")), path).startswith("2 lines")
    assert complaint(warns, path) == "RuntimeWarning: overflow"
    assert complaint(raises(MistrayError("lens 'x': broken; mend it")), path) is None
    assert complaint(lambda path: None, path) is None
