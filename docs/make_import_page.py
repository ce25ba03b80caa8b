"""Writes docs/imported_files.md: what `mistray import` says of ten lens files of ray-optics and batoid.

    python docs/make_import_page.py

Both packages must be installed (``pip install --no-deps -r tests/peers.txt``); `tests/test_plugin_pages.py` keeps the
page current where they are.
"""

from __future__ import annotations

import contextlib
import io
import tempfile
from importlib.util import find_spec
from pathlib import Path

PAGE = Path(__file__).parent / "imported_files.md"
# File, further arguments, what it is
FILES: tuple[tuple[str, tuple[str, ...], str], ...] = (
    ("rayoptics/codev/tests/ag_dblgauss.seq", (), "a double Gauss, with a defocus"),
    ("rayoptics/codev/tests/questar35.seq", (), "a Maksutov-Cassegrain in inches"),
    ("rayoptics/codev/tests/threemir.seq", (), "an off-axis three-mirror telescope"),
    ("rayoptics/zemax/tests/US08011793-1.zmx", (), "an off-axis telescope of four mirrors"),
    ("rayoptics/zemax/tests/ASL5040-UV-Zemax(ZMX).zmx", (), "a vendor's lens with a Q asphere"),
    ("rayoptics/zemax/tests/HoO-V2C18Ex46.zmx", (), "a schiefspiegler with a toroid"),
    ("rayoptics/zemax/tests/zmax_37992.zmx", (), "a vendor's off-axis paraboloid"),
    ("rayoptics/zemax/tests/354710-C-Zemax(ZMX).zmx", (), "a moulded lens whose glass is in no catalogue here"),
    ("batoid/data/DECam/DECam.yaml", ("--wavelength-nm", "620"), "the Blanco telescope with DECam and its spider"),
    ("batoid/data/HSC/HSC.yaml", ("--wavelength-nm", "750"), "the Subaru telescope with HSC"),
)
INTRODUCTION = """\
<!-- Written by docs/make_import_page.py; change that. -->

# Ten lens files, and what the import says of them

Files of ray-optics 0.9 and batoid 0.9, as their packages hold them. `mistray import FILE -o lens.xml` prints what it
made and assumed; every line of a file that had no effect is listed, too. More files: [lens_files.md](lens_files.md).
"""


def page() -> str:
    """The page, Markdown."""
    parts = [INTRODUCTION]
    for name, more, what in FILES:
        file = path_of(name)
        command = " ".join(["mistray", "import", f"'{file.name}'" if "(" in file.name else file.name, *more])
        parts.append(
            f"## {what[0].upper() + what[1:]}\n\n    {command} -o lens.xml\n\n```text\n{said(file, more)}\n```\n"
        )
    return "\n".join(parts)


def path_of(name: str) -> Path:
    """A file of a package."""
    package, _, rest = name.partition("/")
    spec = find_spec(package)
    if spec is None or spec.submodule_search_locations is None:
        raise SystemExit(f"{package} is not installed: pip install --no-deps -r tests/peers.txt")
    return Path(next(iter(spec.submodule_search_locations))) / rest


def said(file: Path, more: tuple[str, ...]) -> str:
    """What the command prints, its notes after its result; without paths of this machine."""
    from mistray.cli.program import main

    printed, told = io.StringIO(), io.StringIO()
    with (
        tempfile.TemporaryDirectory() as folder,
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(told),
    ):
        main(["import", str(file), "-o", str(Path(folder) / "lens.xml"), *more])
        text = printed.getvalue() + told.getvalue()
        text = text.replace(str(Path(folder) / "lens.xml"), "lens.xml").replace(str(file), file.name)
    return "\n".join(line.rstrip() for line in text.splitlines())


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    print(PAGE)
