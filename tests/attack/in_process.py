"""Parts whose cases run one after another in a worker: options, scenes, numbers, files, bombs and cache entries."""

from __future__ import annotations

import gzip
import hashlib
import io
import json
import random
import re
import struct
import zipfile
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr
from pathlib import Path

from fuzzing import DAMAGES, Nest

import mistray.scenes
from attack.parts import Answer, Case, finite, some
from attack.worker import Worker
from mistray.cli.program import COMMANDS, _parser
from mistray.errors import MistrayError

SCENES = Path(mistray.scenes.__file__).parent
DATA = Path(__file__).parents[1] / "data"
SMALL = ("plate", "singlet_window_detector", "baffle_tube")
STUDY = """[[term]]
kind = "path_power"
goal = "minimise"
[trace]
rays = 50
[[coating]]
name = "AR"
surfaces = "all"
layers = "1.38 60"
thickness_nm = [20, 180]
"""
SWEEP = '[[configuration]]\nname = "a"\n"detector.z" = 0.1\n'
CUBE = "".join(f"v {x} {y} {z}\n" for x in (0, 1) for y in (0, 1) for z in (0, 1)) + "f 1 2 4\nf 5 8 6\n"
COATING = "wavelength_nm,angle_deg,R,T\n" + "".join(f"{nm},{deg},0.01,0.99\n" for nm in (400, 700) for deg in (0, 45))
BASES = {
    "ghosts": ["plate", "--rays", "50", "--seconds", "5", "--json"],
    "pst": ["plate", "--rays", "200", "--seconds", "5", "--no-next-order", "--json"],
    "objects": ["plate", "--rays", "50", "--seconds", "5", "--json"],
    "sweep": ["plate", "--rays", "50", "--seconds", "5", "--no-cache", "--json"],
    "image": ["plate", "--grid", "16", "--json"],
    "study": ["plate", "--quick", "--rays", "50", "--seconds", "5", "--no-next-order", "--json"],
    "thermal": ["plate", "--rays", "50", "--seconds", "5", "--json"],
    "sensitivity": ["plate", "--rays", "50", "--no-check", "--json"],
    "budget": ["plate", "budget.toml", "--json"],
    "optimize": ["plate", "study.toml", "--steps", "1", "--seconds", "5", "--no-next-order", "--json"],
    "view": ["plate", "--rays", "20", "--out", "view.html", "--force"],
    "coating": ["table.csv", "--json"],
    "bsdf": ["abg", "--A", "0.01", "--B", "0.01", "--g", "2", "--json"],
    "coat": ["plate", "*=R=0.1", "-o", "coated.xml", "--force"],
    "export": ["cooke_triplet", "-o", "lens.zmx", "--force"],
    "import": ["cube.obj", "-o", "cube.xml", "--force"],
}
NASTY = (
    "", " ", "--", "nan", "inf", "-inf", "0", "-0", "-1", "1e-320", "1e308", "-1e308", "1e999", "9" * 20, "0x10", "1,5",
    "1:2", "½", "a" * 5000, "\x1b[2J", "../../etc/passwd",
)  # fmt: skip
LEAVE_OUT = ("--scheduler", "--port", "--variant", "--state")  # they wait for other machines, or are of the machine


def prepare(folder: Path) -> None:
    """The files that the commands name."""
    for name, text in (("study.toml", STUDY), ("budget.toml", STUDY), ("sweep.toml", SWEEP), ("cube.obj", CUBE),
                       ("table.csv", COATING)):  # fmt: skip
        (folder / name).write_text(text)


def options(worker: Worker, seed: int) -> list[Case]:
    """Nasty values of every option: all are parsed, and of those that are taken 853 are run."""
    taken = []
    for module in COMMANDS:
        command = module.COMMAND.name
        for option in module.COMMAND.options if command in BASES else ():
            for word in option.name.split():
                if word.startswith("--") and word not in LEAVE_OUT and option.type is not bool:
                    taken += [(command, f"{word}={value}") for value in NASTY if _parses(command, f"{word}={value}")]

    def case(command: str, given: str) -> Case:
        def run() -> str:
            base = BASES[command]
            wide = [*base, "--seconds", "5"] if given.startswith("--seconds") and "--seconds" in base else base
            answer = worker.ask("command", [command, *wide, given])
            wrong = answer.failure()
            return wrong or (finite(answer.out) if "--json" in base and answer.code == 0 and answer.out else "")

        return Case(f"{command} {given[:60]!r}", run)

    dashes = [case(command, f"{option}=--") for command, option in _option_kinds()]
    return dashes + some([case(*one) for one in taken], 853 - len(dashes), seed)


def _option_kinds() -> list[tuple[str, str]]:
    kinds = {
        (module.COMMAND.name, str(option.type)): (module.COMMAND.name, option.name.split()[-1])
        for module in COMMANDS
        for option in module.COMMAND.options
        if module.COMMAND.name in BASES and option.name.startswith("-") and option.type is not bool
    }
    return list(kinds.values())


def _parses(command: str, given: str) -> bool:
    """Whether the parser takes a value; it must not raise anything else than it does for a wrong one."""
    try:
        with redirect_stderr(io.StringIO()):
            _parser().parse_args([command, *BASES[command], given])
    except MistrayError:
        return False
    return True


WORDS = (
    "", " ", "nan", "-inf", "0", "-0.0", "-1", "1e-320", "1e39", "-1e39", "1e308", "1e999", "99999999999999999999",
    "0x1F",
    "1..2", "1,5", "5x", "½", "1 2",
)  # fmt: skip
NO_DIGITS = ("", " ")
VALUE = re.compile(r'<(?:float|integer) name="(?P<name>[^"]*)" value="(?P<value>[^"]*)"/>')


def xml(worker: Worker, seed: int) -> list[Case]:
    """Values of attributes of three scenes: 780 are loaded, and traced if they load."""
    cases = []
    for scene in SMALL:
        text = (SCENES / scene / "scene.xml").read_text(encoding="utf-8")
        for match in VALUE.finditer(text):
            for word in WORDS:
                changed = text[: match.start("value")] + word + text[match.end("value") :]
                name = f"{scene} {match['name']} at {match.start()} = {word!r}"
                cases.append(Case(name, _scene_case(worker, changed, word in NO_DIGITS)))
    return some(cases, 780, seed)


def _scene_case(worker: Worker, text: str, refused: bool = False) -> Callable[[], str]:
    def run() -> str:
        answer = worker.ask("scene", text, "scene.xml", seconds=60)
        return answer.failure() or ("it was read" if refused and answer.code == 0 else "")

    return run


MATRICES = {
    "w 0": "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 0", "w 2": "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 2",
    "fifteen": "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0",
    "nan": "nan 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1", "null": " ".join("0" * 16), "shear": "1 1 0 0 0 1 0 0 0 0 1 0 0 0 0 1",
    "perspective": "1 0 0 0 0 1 0 0 0 0 1 0 0 0 1 1", "empty": "", "huge": "1e30 0 0 0 0 1e30 0 0 0 0 1e30 0 0 0 0 1",
}  # fmt: skip
REFUSED_MATRICES = ("w 0", "fifteen", "nan", "null", "perspective", "empty")


def numbers(worker: Worker, seed: int) -> list[Case]:
    """Numbers and transforms that are none, in the places where they hurt."""
    text = (SCENES / "singlet_window_detector" / "scene.xml").read_text(encoding="utf-8")
    cases = []
    for name in ("radius", "semi_diameter", "half_width"):
        match = re.search(rf'<float name="{name}" value="([^"]*)"', text)
        for word in ("", " ", "\t", "\n", "٣", "1e39", "5x", "1_0") if match else ():
            changed = text[: match.start(1)] + word + text[match.end(1) :]
            cases.append(Case(f"{name} = {word!r}", _scene_case(worker, changed, not word.strip())))
    place = re.search(r'<translate [^>]*?z="([^"]*)"', text)
    for word in ("", " ", "5x", "nan", "1e39", "-inf"):
        changed = text[: place.start(1)] + word + text[place.end(1) :]
        cases.append(Case(f"translate z = {word!r}", _scene_case(worker, changed, not word.strip())))
    whole = re.search(r"<translate [^>]*/>", text)
    for name, matrix in MATRICES.items():
        changed = text[: whole.start()] + f'<matrix value="{matrix}"/>' + text[whole.end() :]
        cases.append(Case(f"matrix: {name}", _scene_case(worker, changed, name in REFUSED_MATRICES)))
    for extra in ('<rotate x="1" angle=""/>', '<rotate x="0" y="0" z="0" angle="5"/>', '<scale value="0"/>'):
        changed = text[: whole.end()] + extra + text[whole.end() :]
        cases.append(Case(extra, _scene_case(worker, changed, True)))
    return cases[:42]


def files(worker: Worker, seed: int) -> list[Case]:
    """Hostile files of every format that is read."""
    samples = {
        ".zmx": (DATA / "fuzz_lens.zmx").read_bytes(), ".seq": (DATA / "fuzz_lens.seq").read_bytes(),
        ".len": b"// OSLO 6.1\nLEN NEW \"a\" 1.0 2\nEBR 1.0\nGTO\nTH 10\nNXT\nRD 50\nGLA BK7\nTH 5\nNXT\nEND\n",
        ".json": b'{"surfaces": [{"radius_mm": 5.0, "thickness_mm": 1.0, "material": "N-BK7"}], "depth": 1.0}',
        ".yaml": b"type: CompoundOptic\nitems:\n- type: Lens\n  coordSys: {x: 0, y: 0, z: 0.1}\n  inSize: 1.0\n",
        ".agf": b"NM N-BK7 2 517642 1.5168 64.17 0\nCD 1.03961212 0.00600069867 0.231792344 0.0200179144\nLD 0.3 2.5\n",
        ".step": (DATA / "assembly_inch.step").read_bytes(), ".obj": CUBE.encode(), ".csv": COATING.encode(),
        ".stl": b"\0" * 80 + struct.pack("<I", 1) + struct.pack("<12fH", *[0.0] * 12, 0), ".toml": STUDY.encode(),
        ".ply": b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
                b"element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
        ".ies": b"IESNA:LM-63-2002\nTILT=NONE\n1 1000 1 3 1 1 2 0 0 0\n1 1 100\n0 45 90\n0\n100 50 0\n",
        ".dat": (DATA / "coating_sample.dat").read_bytes(),
    }  # fmt: skip
    cases = []
    for ending, data in samples.items():
        hostile = {
            "empty": b"",
            "zeros": b"\0" * 5000,
            "deep": b"[(" * 50_000,
            "huge": re.sub(rb"\d+\.\d*", b"1e999", data),
        }
        hostile["digits"] = re.sub(rb"(?<=[ =:])\d+", b"9" * 5000, data, count=3)
        for name, content in hostile.items():
            cases.append(Case(f"{ending} {name}", _file_case(worker, content, ending)))
    lens = (DATA / "fuzz_lens.zmx").read_text(encoding="utf-8", errors="replace")
    for count in (1000, 5000):
        cases.append(Case(f".zmx of {count} surfaces", _file_case(worker, _long_lens(count), ".zmx", 25.0)))
    cases.append(Case(".zmx as UTF-32", _file_case(worker, lens.encode("utf-32"), ".zmx")))
    damaged = [Case(f".zmx {damage.__name__}", _damage_case(worker, damage, seed)) for damage in DAMAGES]
    return some(cases[:-3], 60 - 3, seed) + cases[-3:] + damaged


def _long_lens(count: int) -> bytes:
    head = (
        "MODE SEQ\nUNIT MM X W X CM MR CPMM\nENPD 8\nFTYP 0 0 1 1 0 0 0\nXFLN 0\nYFLN 0\nWAVM 1 0.5875618 1\nPWAV 1\n"
    )
    lines = ["SURF 0\n  TYPE STANDARD\n  DISZ INFINITY"]
    for k in range(1, count):
        glass = "\n  GLAS N-BK7 0 0 1.5168 64.17" if k % 2 else ""
        lines.append(f"SURF {k}\n  {'STOP' if k == 1 else ''}\n  TYPE STANDARD\n  CURV 0.0001\n  DISZ 0.1{glass}")
    return (head + "\n".join([*lines, f"SURF {count}\n  TYPE STANDARD\n  DISZ 0\n"])).encode()


def _damage_case(worker: Worker, damage: Callable[..., bytes], seed: int) -> Callable[[], str]:
    nest = Nest(b"SURF 1\n  TYPE STANDARD\n", b"  DISZ 1\n", rb"^  CURV.*$")
    data = damage((DATA / "fuzz_lens.zmx").read_bytes(), random.Random(seed), nest)
    return _file_case(worker, data, ".zmx")


def _file_case(worker: Worker, data: bytes, ending: str, seconds: float = 25.0) -> Callable[[], str]:
    def run() -> str:
        name = f"hostile{ending}"
        (worker.folder / name).write_bytes(data)
        if ending in (".csv", ".dat"):
            answer = worker.ask("command", ["coating", name, "--json"], seconds=seconds)
        elif ending == ".toml":
            answer = worker.ask("command", ["optimize", "plate", name, "--steps", "1", "--json"], seconds=seconds)
        elif ending == ".ies":
            answer = worker.ask("reader", "mistray.files.intensities:read_intensities", name, seconds=seconds)
        elif ending == ".agf":
            lens = (DATA / "fuzz_lens.zmx").read_text(encoding="utf-8", errors="replace")
            (worker.folder / "with_glass.zmx").write_text(f"GCAT hostile\n{lens}")
            answer = worker.ask(
                "command", ["import", "with_glass.zmx", "-o", "hostile.xml", "--force"], seconds=seconds
            )
        else:
            answer = worker.ask("command", ["import", name, "-o", "hostile.xml", "--force"], seconds=seconds)
        return answer.failure(seconds)

    return run


def bombs(worker: Worker, seed: int) -> list[Case]:
    """Small files that ask for much: refused, or read within bounds of time and memory."""
    return [Case(name, _bomb_case(worker, made)) for name, made in _bombs()]


def _bomb_case(worker: Worker, made: Callable[[Path], list[str]]) -> Callable[[], str]:
    def run() -> str:
        words = made(worker.folder)
        answer: Answer = worker.ask("command", words, seconds=30, fresh=True)
        return answer.failure(30.0, 2500.0)

    return run


def _bombs() -> Iterator[tuple[str, Callable[[Path], list[str]]]]:
    head, ghosts = '<scene version="3.0.0">', ["ghosts", "bomb.xml", "--rays", "20"]

    def scene(inside: str, before: str = "") -> Callable[[Path], list[str]]:
        def made(folder: Path) -> list[str]:
            (folder / "bomb.xml").write_text(f"{before}{head}{inside}</scene>", encoding="utf-8")
            return ghosts

        return made

    def includes(width: int, depth: int) -> Callable[[Path], list[str]]:
        def made(folder: Path) -> list[str]:
            for k in range(depth):
                inside = f'<include filename="bomb{k + 1}.xml"/>' * width if k < depth - 1 else ""
                (folder / f"bomb{k}.xml").write_text(f"{head}{inside}</scene>")
            return ["ghosts", "bomb0.xml", "--rays", "20"]

        return made

    for count in (20, 24, 26, 200):
        lines = "".join(f'<default name="p{k + 1}" value="$p{k}$p{k}"/>' for k in range(count))
        yield f"parameters {count}", scene(f'<default name="p0" value="ab"/>{lines}<float name="$p{count}" value="1"/>')
    for width, depth in ((6, 13), (2, 14), (40, 4), (1, 100)):
        yield f"includes {width} wide, {depth} deep", includes(width, depth)
    entities = "".join(f'<!ENTITY e{k + 1} "{f"&e{k};" * 20}">' for k in range(8))
    yield "entities", scene('<float name="a" value="&e8;"/>', f'<!DOCTYPE scene [<!ENTITY e0 "1">{entities}]>')
    yield "deep", scene('<bsdf type="interface">' * 20_000 + "</bsdf>" * 20_000)
    yield "wide", scene('<float name="a" value="1"/>' * 200_000)

    def archive(shape: str, size: int) -> Callable[[Path], list[str]]:
        def made(folder: Path) -> list[str]:
            header = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".ljust(117).encode() + b"\n"
            with zipfile.ZipFile(folder / "grid.npz", "w", zipfile.ZIP_DEFLATED) as file:
                data = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + b"\0" * size
                for name in ("x", "y", "sag", "x_mm", "y_mm", "sag_mm"):
                    file.writestr(f"{name}.npy", data)
            text = (SCENES / "plate" / "scene.xml").read_text(encoding="utf-8")
            grid = (
                '<shape type="asphere"><string name="grid" value="grid.npz"/><bsdf type="interface"/></shape></scene>'
            )
            (folder / "bomb.xml").write_text(text.replace("</scene>", grid), encoding="utf-8")
            return ghosts

        return made

    yield "grid of 0.4 GB", archive("(50000000,)", 400_000_000)
    yield "grid that says 27 GB", archive("(60000, 60000)", 8)

    def yaml(folder: Path) -> list[str]:
        lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
        lines += [f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9)}]" for k in range(1, 10)]
        (folder / "bomb.yaml").write_text("\n".join(["type: CompoundOptic", *lines]))
        return ["import", "bomb.yaml", "-o", "bomb.xml", "--force"]

    def state(folder: Path) -> list[str]:
        (folder / "out").mkdir(exist_ok=True)
        with zipfile.ZipFile(folder / "out" / "pst_state.npz", "w", zipfile.ZIP_DEFLATED) as file:
            file.writestr("hits.npy", b"\0" * 200_000_000)
        return ["pst", "plate", "--rays", "200", "--resume", "--out", "out"]

    def zipped(folder: Path) -> list[str]:
        (folder / "bomb.zmx").write_bytes(gzip.compress(b"\0" * 100_000_000))
        return ["import", "bomb.zmx", "-o", "bomb.xml", "--force"]

    yield "YAML aliases", yaml
    yield "a state", state
    yield "a zipped lens", zipped


CONTENTS = (
    b"", b"null", b"[]", b"{}", b"7", b"-1", b"NaN", b"1e999", b'""', b'"row"', b"true", b"\xff\xfe", b"\0", b"[" *
    100_000,
    b"{" * 100_000, b'{"a":' * 9, b'{"stray_W": 1}', b"[[]]", b"9" * 5000, b"\xef\xbb\xbf{}", b"{}{}", b"' OR 1",
    b"STRAY:1e999", b"STRAY:NaN", b'STRAY:"1"', b"STRAY:true", b"STRAY:null", b"STRAY:[]", b"STRAY:{}",
    b"rays:-Infinity",
    b"worst_path:3", b"worst_events:[]", b"first_light:null", b"first_light:{}", b"first_light:[1]", b"polarization:5",
    b"launched_W:{}",
)  # fmt: skip
TAKEN = (b"STRAY:NaN",)  # a number may not be known


def entries(worker: Worker, seed: int) -> list[Case]:
    """Entries of the cache whose sum agrees, and which are no results: named, removed and made again."""
    return [Case(repr(content[:30]), _entry_case(worker, content)) for content in CONTENTS]


def _entry_case(worker: Worker, content: bytes) -> Callable[[], str]:
    def run() -> str:
        kept = worker.folder / "cache"
        words = ["sweep", "plate", "--rays", "50", "--field-deg", "0", "--wavelength-nm", "500", "--json"]
        worker.ask("command", words)
        (path,) = kept.glob("*.result")
        magic, key, _, old = path.read_bytes().split(b"\n", 3)
        name, _, value = content.replace(b"STRAY", b"stray_W").partition(b":")
        made = content
        if re.fullmatch(rb"[a-zA-Z_]+", name) and value:
            made = json.dumps({**json.loads(old), name.decode(): "HERE"}).encode().replace(b'"HERE"', value)
        path.write_bytes(b"\n".join((magic, key, hashlib.sha256(made).hexdigest().encode(), made)))
        answer = worker.ask("command", words)
        path.unlink(missing_ok=True)
        told = "is damaged" in answer.err
        return answer.failure() or ("" if told or content in TAKEN else f"it was believed: {answer.err[:200]}")

    return run
