"""Parts whose cases run one after another in a worker: options, scenes, damaged files and bombs."""

import gzip
import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import fuzz_scenes
from fuzzing import DAMAGES, XML_DAMAGES, Damage, Nest, write_companions
from number_fuzz import NASTY, WORK, Try, Worker, complaint, tries

import mistray.scenes

THOUSAND = 1000  # damaged scenes
SCENES = Path(mistray.scenes.__file__).parent
DATA = Path(__file__).parents[1] / "data"
Cases = dict[str, Callable[[], str]]
OPTIONS = tries(fuzz_scenes.LINES, fuzz_scenes.ABOUT)


def prepare(folder: Path) -> None:
    """The files that the cases name."""
    fuzz_scenes.write(folder)
    write_companions(folder)


def _twice(worker: Worker, argv: tuple[str, ...], work: bool = False) -> dict[str, Any]:
    """The answer, where it is late that of a second time, when the kernels are there."""
    answer = worker.run(argv)
    return worker.run(argv) if not work and (answer["error"].startswith("late") or answer["code"] == 130) else answer


def options(worker: Worker, seed: int) -> Cases:
    """Nasty words of every option of every command."""
    usual: dict[str, set[str]] = {}

    def run(one: Try) -> str:
        answer = _twice(worker, one.argv, one.option in WORK)
        if answer["absent"] and one.command not in usual:
            usual[one.command] = fuzz_scenes.usual_of(worker, one.command)
        known = usual.get(one.command, ()) if one.value in NASTY else answer["absent"]
        return complaint(answer, known, one.option in WORK)

    return {f"{k} {one.command} {one.option}={one.value[:60]!r}": partial(run, one) for k, one in enumerate(OPTIONS)}


def scenes(worker: Worker, seed: int) -> Cases:
    """Nasty numbers of every parameter of every plugin, in scenes that are traced."""
    usual: set[str] = set()

    def run(one: Try) -> str:
        (worker.folder / fuzz_scenes.TRACED[1]).write_text(one.argv[0], encoding="utf-8")
        answer = _twice(worker, fuzz_scenes.TRACED)
        if answer["absent"] and not usual:
            usual.update(fuzz_scenes.usual_of(worker, fuzz_scenes.TRACED[0]))
        return complaint(answer, usual)

    places = enumerate(fuzz_scenes.scene_tries())
    return {f"{k} {one.command} {one.option}={one.value!r}": partial(run, one) for k, one in places}


@dataclass(frozen=True)
class Kind:
    """What of a kind of file is damaged, the job or command that reads FILE, what is deep, and how many of a sort."""

    samples: tuple[Path | bytes, ...]
    job: str
    nest: Nest
    count: int
    damages: tuple[Damage, ...] = DAMAGES


BRACKETS = Nest(b"(", b")", rb"\d+\.?\d*")
LAYERS = Nest(b"H .25 0 3\n", b"H .25 0 3\n", rb"^H .25$")
SURFACES = Nest(b"SURF 1\n  TYPE STANDARD\n", b"  DISZ 1\n", rb"^  CURV.*$")
CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + "f 1 2 4\nf 5 8 6\n"
COATING = "wavelength_nm,angle_deg,R,T\n" + "".join(f"{nm},{deg},0.01,0.99\n" for nm in (400, 700) for deg in (0, 45))
OSLO = b'// OSLO 6.1\nLEN NEW "a" 1.0 2\nEBR 1.0\nGTO\nTH 10\nNXT\nRD 50\nGLA BK7\nTH 5\nNXT\nEND\n'
YAML = b"""opticalSystem:
  type: CompoundOptic
  pupilSize: 1.0
  items:
  - {type: Mirror, name: M1, surface: {type: Plane}, obscuration: {type: ClearCircle, radius: 1.0}, inMedium: 1.0}
"""
IES = b"IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 3 1 1 2 0 0 0\n1 1 100\n0 45 90\n0\n100 50 0\n"
CLEAR = (".xml", ".dat", ".zmx", ".seq", ".step")  # of which each message says what to do
IMPORT = "import FILE -o damaged.xml --force"
# By the ending of its name
KINDS = {
    ".xml": Kind(
        tuple(SCENES / name / "scene.xml" for name in ("plate", "lens_and_reflector", "baffle_tube")), "load FILE",
        Nest(b'<bsdf type="interface">', b"</bsdf>", rb'<(?:float|string) name="[^"]*" value="[^"]*"/>'),
        THOUSAND // len(XML_DAMAGES) + 1, XML_DAMAGES,
    ),
    ".dat": Kind((DATA / "coating_sample.dat",), "coatings FILE", LAYERS, 13),
    ".zmx": Kind((DATA / "fuzz_lens.zmx",), IMPORT, SURFACES, 18),
    ".seq": Kind((DATA / "fuzz_lens.seq",), IMPORT, BRACKETS, 18),
    ".step": Kind((DATA / "vane_tube.step", DATA / "assembly_inch.step"), IMPORT, BRACKETS, 4),
    ".len": Kind((OSLO,), IMPORT, BRACKETS, 4),
    ".json": Kind((SCENES / "phone_camera" / "prescription.json",), IMPORT, Nest(b"[", b"]", rb"\d+\.\d+"), 4),
    ".yaml": Kind((YAML,), f"{IMPORT} --wavelength-nm 550", Nest(b"[", b"]", rb"\d+\.\d+"), 4),
    ".obj": Kind((CUBE.encode(),), IMPORT, BRACKETS, 4),
    ".ply": Kind((fuzz_scenes.BRACKET_PLY.encode(),), IMPORT, BRACKETS, 4),
    ".csv": Kind((COATING.encode(),), "coating FILE --json", BRACKETS, 4),
    ".toml": Kind((fuzz_scenes.STUDY.encode(),), "optimize plate FILE --steps 1 --json", Nest(b"[", b"]", rb"\d+"), 4),
    ".ies": Kind((IES,), "lamp FILE", BRACKETS, 4),
}  # fmt: skip


def read(worker: Worker, ending: str, name: str) -> str:
    """What is wrong with how a file of the worker's folder is read or refused; the libraries below print nothing."""
    words = KINDS[ending].job.replace("FILE", name).split()
    answer = worker.run(words, 25.0, strict=words[0] != "optimize")
    answer["said"] = answer["said"].replace("[ply.h:", "[")  # Mitsuba's reader of PLY files names its own line
    wrong = complaint(answer, answer["absent"]) or answer["chatter"]
    return "" if wrong.startswith("no clear line") and ending not in CLEAR else wrong


def files(worker: Worker, seed: int) -> Cases:
    """Files of every format that is read, damaged, and some that are large."""

    def run(ending: str, damage: Damage, number: int) -> str:
        name = "coating" if ending == ".dat" else ending[1:]
        rng = random.Random(f"{'' if seed == 1 else f'{seed} '}{name} {damage.__name__} {number}")
        sample = rng.choice(KINDS[ending].samples)
        data = sample if isinstance(sample, bytes) else sample.read_bytes()
        path = worker.folder / f"damaged{ending}"
        path.write_bytes(damage(data, rng, KINDS[ending].nest).replace(b"SELF", path.name.encode()))
        return read(worker, ending, path.name)

    def large(count: int) -> str:
        lines = ["SURF 0\n  TYPE STANDARD\n  DISZ INFINITY", "SURF 1\n  STOP\n  TYPE STANDARD\n  DISZ 0.1"]
        for k in range(2, count):
            glass = "\n  GLAS N-BK7 0 0 1.5168 64.17" if k % 2 else ""
            lines.append(f"SURF {k}\n  TYPE STANDARD\n  CURV 0.0001\n  DISZ 0.1{glass}")
        head = "MODE SEQ\nUNIT MM X W X CM MR CPMM\nENPD 8\nWAVM 1 0.5875618 1\nPWAV 1\n"
        (worker.folder / "large.zmx").write_text("\n".join([head, *lines, f"SURF {count}\n  DISZ 0\n"]))
        return read(worker, ".zmx", "large.zmx")

    cases = {
        f"{ending} {damage.__name__} {number}": partial(run, ending, damage, number)
        for number in range(max(kind.count for kind in KINDS.values()))
        for ending, kind in KINDS.items()
        for damage in (kind.damages if number < kind.count else ())
    }
    return cases | {f".zmx of {count} surfaces": partial(large, count) for count in (1000, 5000)}


def bombs(worker: Worker, seed: int) -> Cases:
    """Small files that ask for much: refused, or read within bounds of time and memory."""

    def run(name: str, content: bytes) -> str:
        worker.close()  # whose memory is measured
        (worker.folder / name).write_bytes(content)
        ending = Path(name).suffix
        job = "ghosts FILE --rays 20" if ending == ".xml" else KINDS[ending].job
        answer = worker.run(job.replace("FILE", name).split(), 30.0)
        large = answer.get("peak_MB", 0.0) > 2500.0
        return complaint(answer) or (f"took {answer['peak_MB']:.0f} MB" if large else "")

    return {f"{k} {name}": partial(run, name, content) for k, (name, content) in enumerate(_bombs())}


def _bombs() -> Iterator[tuple[str, bytes]]:
    head = '<scene version="3.0.0">'
    entities = "".join(f'<!ENTITY e{k + 1} "{f"&e{k};" * 20}">' for k in range(8))
    start = f'<!DOCTYPE scene [<!ENTITY e0 "1">{entities}]>'
    yield "entities.xml", f'{start}{head}<float name="a" value="&e8;"/></scene>'.encode()
    yield "wide.xml", (head + '<float name="a" value="1"/>' * 200_000 + "</scene>").encode()
    aliases = [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 10)]
    yield "aliases.yaml", "\n".join(["type: CompoundOptic", "a0: &a0 [x, x, x]", *aliases]).encode()
    yield "zipped.zmx", gzip.compress(b"\0" * 100_000_000)
