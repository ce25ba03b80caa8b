"""Damaged files are read, or refused in one line: no traceback, no warning, no hang, no crash."""

from __future__ import annotations

import contextlib
import faulthandler
import io
import random
import resource
import signal
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from fuzzing import DAMAGES, LONGEST, XML_DAMAGES, Damage, Nest, unclear, write_companions

import mistray.scenes
from mistray._mitsuba_compat import silence_warnings
from mistray.cli import program
from mistray.coatings import read_coating_file, spectrum
from mistray.errors import MistrayError
from mistray.execute.tracer import prepare
from mistray.scene import load
from mistray.settings import Settings

DATA = Path(__file__).parent / "data"
SCENES = Path(mistray.scenes.__file__).parent
LIMIT_S = 10
STUCK_S = 60  # after which even what never comes back to Python is ended, and the tests with it
MEMORY = 8 << 30  # more than before, bytes; a file that asks for more is refused, not the machine halted
THOUSAND = 1000  # damaged scenes in the long tests


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
    damages : tuple of Damage
        The sorts.
    """

    samples: tuple[Path, ...]
    read: Callable[[Path], object]
    nest: Nest
    count: int
    damages: tuple[Damage, ...] = DAMAGES


def read_coatings(path: Path) -> None:
    file = read_coating_file(path)
    wrong = None
    for name in file:
        try:
            spectrum(file[name], [550.0], [0.0, 45.0], "air", "N-BK7")
        except MistrayError as error:  # the others are looked at all the same
            wrong = error if wrong is None or unclear(str(error)) else wrong
    if wrong is not None:
        raise wrong


def read_scene(path: Path) -> None:
    """All that comes before the first ray; a scene that gets so far has a place and a size."""
    silence_warnings()
    scene = load(path)
    prepare(scene, Settings.of(scene))
    box = scene.bbox()
    if not (np.isfinite(np.array(box.min)).all() and np.isfinite(np.array(box.max)).all()):
        raise ArithmeticError(f"the scene reaches from {box.min} to {box.max}")


def import_file(path: Path) -> None:
    """The command with all that it prints."""
    with contextlib.redirect_stdout(io.StringIO()):
        assert program._command(["import", str(path), "-o", str(path.with_suffix(".xml")), "--force"]) == 0


KINDS = {
    "xml": Kind(
        tuple(SCENES / name / "scene.xml" for name in ("plate", "lens_and_reflector", "baffle_tube")),
        read_scene,
        Nest(b'<bsdf type="interface">', b"</bsdf>", rb'<(?:float|string) name="[^"]*" value="[^"]*"/>'),
        7,
        XML_DAMAGES,
    ),
    "coating": Kind(
        (DATA / "coating_sample.dat",),
        read_coatings,
        Nest(b"H .25 0 3\n", b"H .25 0 3\n", rb"^H .25$"),
        13,
    ),
    "zmx": Kind(
        (DATA / "fuzz_lens.zmx",),
        import_file,
        Nest(b"SURF 1\n  TYPE STANDARD\n", b"  DISZ 1\n", rb"^  CURV.*$"),
        18,
    ),
    "seq": Kind(
        (DATA / "fuzz_lens.seq",),
        import_file,
        Nest(b"(", b")", rb"\d+\.\d+"),
        18,
    ),
    "step": Kind(
        (DATA / "vane_tube.step", DATA / "assembly_inch.step"),
        import_file,
        Nest(b"(", b")", rb"\d+\.\d*"),
        4,
    ),
}

CASES = [
    pytest.param(name, damage, id=f"{name}-{damage.__name__}")
    for name, kind in KINDS.items()
    for damage in kind.damages
]


class Late(BaseException):
    """No `except Exception` of a reader takes it for its own."""


@contextlib.contextmanager
def limits() -> Iterator[None]:
    """Ends what takes too long or asks for too much memory by an exception."""

    def late(number: int, frame: object) -> None:
        raise Late

    with open("/proc/self/statm") as file:
        used = int(file.read().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    before = signal.signal(signal.SIGALRM, late)
    signal.setitimer(signal.ITIMER_REAL, LIMIT_S)
    faulthandler.dump_traceback_later(STUCK_S, exit=True)
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, hard))
    try:
        yield
    finally:
        faulthandler.cancel_dump_traceback_later()
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def complaint(read: Callable[[Path], object], path: Path, capfd: pytest.CaptureFixture[str]) -> str | None:
    """What is wrong with the way in which a file is read or refused; None if nothing is."""
    start = time.monotonic()
    text = None
    try:
        with limits(), warnings.catch_warnings():
            warnings.simplefilter("error")
            read(path)
    except MistrayError as error:
        text = str(error)
    except (Exception, Late) as error:
        return f"{type(error).__name__}: {str(error)[:200]}"
    printed = "".join(capfd.readouterr())
    if printed:
        return f"prints {printed[:200]!r}"
    if time.monotonic() - start > LIMIT_S:
        return f"takes {time.monotonic() - start:.1f} s"
    return None if text is None else unclear(text)


@pytest.mark.long
@pytest.mark.parametrize(("name", "damage"), CASES)
def test_damaged_files(name: str, damage: Damage, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    check(name, damage, KINDS[name].count, tmp_path, capfd)


@pytest.mark.slow
@pytest.mark.parametrize("damage", XML_DAMAGES, ids=lambda damage: damage.__name__)
def test_a_thousand_scenes(damage: Damage, tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    check("xml", damage, THOUSAND // len(XML_DAMAGES) + 1, tmp_path, capfd)


def check(name: str, damage: Damage, count: int, folder: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Every file that is damaged in this way is read or refused in one clear line; those that are not stay there."""
    kind = KINDS[name]
    write_companions(folder)
    complaints = []
    for seed in range(count):
        rng = random.Random(f"{name} {damage.__name__} {seed}")
        sample = rng.choice(kind.samples)
        path = folder / f"damaged_{seed}{sample.suffix}"
        path.write_bytes(damage(sample.read_bytes(), rng, kind.nest).replace(b"SELF", path.name.encode()))
        found = complaint(kind.read, path, capfd)
        if found:
            complaints.append(f"seed {seed}, {sample.name}, {path}: {found}")
    assert not complaints, "\n".join(complaints)


@pytest.mark.parametrize("name", KINDS)
def test_the_files_themselves_are_good(name: str, tmp_path: Path) -> None:
    """What is damaged above can be read: otherwise the tests would show nothing."""
    for sample in KINDS[name].samples:
        path = tmp_path / sample.name
        path.write_bytes(sample.read_bytes())
        if name == "coating":  # it holds two that cannot be evaluated
            assert len(read_coating_file(path)) > 5
        else:
            KINDS[name].read(path)


def test_there_are_five_hundred() -> None:
    assert sum(KINDS[case.values[0]].count for case in CASES) >= 500


def test_complaints_are_noticed(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A traceback, a warning, several lines, something printed, no remedy, and a hang, even one that is hidden."""
    path = tmp_path / "x"

    def raises(error: Exception) -> str | None:
        def read(path: Path) -> object:
            raise error

        return complaint(read, path, capfd)

    def waits(path: Path) -> None:
        end = time.monotonic() + 1
        while time.monotonic() < end:
            pass

    def hides(path: Path) -> None:
        try:
            waits(path)
        except BaseException:
            raise MistrayError("lens 'x': it takes long; give another") from None

    assert complaint(lambda path: None, path, capfd) is None
    assert raises(MistrayError("lens 'x': broken; mend it")) is None
    assert raises(KeyError("a")) == "KeyError: 'a'"
    assert raises(MistrayError("lens: a\nb; c")).startswith("2 lines")
    assert raises(MistrayError("lens: \x1b[2Ja; b")).startswith("1 lines")
    assert raises(MistrayError(f"lens: {'a' * LONGEST}; b")).startswith("1 lines")
    assert raises(MistrayError("scene: Traceback (most recent call last): …; correct the file")).startswith(
        "the inside"
    )
    assert raises(MistrayError("lens 'x' is broken")).startswith("no clear line")
    assert complaint(lambda path: warnings.warn("overflow", RuntimeWarning, stacklevel=1), path, capfd) == (
        "RuntimeWarning: overflow"
    )
    assert complaint(lambda path: print("warning"), path, capfd) == "prints 'warning\\n'"
    monkeypatch.setitem(globals(), "LIMIT_S", 0.1)
    assert complaint(waits, path, capfd) == "Late: "
    assert complaint(hides, path, capfd).startswith("takes 0.1 s")
