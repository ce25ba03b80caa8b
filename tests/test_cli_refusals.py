"""What the commands themselves refuse: one line that names the option and the remedy, before anything is traced."""

import shlex
import sys
from pathlib import Path

import pytest
from command_line import Captured, Patch, fails
from test_every_command import INPUTS, STUDY

ABG = "abg --A 0.0025 --B 0.001 --g 1.8"
PST = "lens.xml --field-deg 0 20 40"
VIEW = "lens.xml --rays 1e9"
# By command: its arguments, and what the line says; the scene is of two faces, p0_front and p0_rear
REFUSED: dict[str, list[tuple[str, str]]] = {
    "": [("", "the following arguments are required: COMMAND; see 'mistray --help'"), ("goats x", "choice: 'goats'")],
    "ghosts": [
        ("", "the following arguments are required: SCENE; see 'mistray ghosts --help'"),
        ("x --splitting some", "argument --splitting: invalid choice: 'some'"),
        ("x --depth 2", "unrecognized arguments: --depth 2"),
        ("x --wavelength-nm 450 550 --weights 1", "--weights has 1 values for 2 of --wavelength-nm"),
        ("x --weights 1", "--weights without --wavelength-nm"),
        ("x --stops 2", "--stops is about colour pictures; add --colour, or leave it out"),
        ("x --colour", "--colour draws pictures; say with --out where they shall go"),
        ("x --formats fits", "--formats writes files; say with --out where they shall go"),
        ("x --out out --formats tiff", "argument --formats: invalid choice: 'tiff'"),
        ("lens.xml --out lens.xml", "is a file; name a directory"),
        ("lens.xml --colour --out out", "1 wavelength (550 nm)"),
        ("lens.xml --variant scalar_rgb", "variant 'scalar_rgb' cannot run the ray tree"),
    ],
    "import": [
        ("no_such_lens.json", "lens 'no_such_lens.json': No such file or directory; check the path"),
        ("media.yaml --wavelength-nm 620 --variant b", "batoid files hold no variants; leave it out"),
    ],
    "image": [("plate", "afocal"), *((f"x --field-deg {deg} --field-mm 2", "--field-mm") for deg in (0, 1))],
    "sweep": [
        ("lens.xml no.toml", "configurations 'no.toml': No such file or directory; check the path"),
        ("lens.xml --set p0_rear.bsdf.R", "'p0_rear.bsdf.R' is no KEY=VALUE, such as hood.z=-5"),
        ("lens.xml --set a=0.1 a=0.2", "--set: a is 0.1 and 0.2; give one value"),
        ("x --coating *=bare", "--coating is compared by its PST; give --pst-field-deg as well"),
        ("x --pst-field-deg 20", "give --set, --coating, --paint, a TOML file with them, or --rank"),
    ],
    "objects": [
        ("x --field-deg 10 --half-angle-deg 5", "two kinds of source"),
        ("x --azimuth-deg 10", "--azimuth-deg is about --field-deg"),
        ("x --formats parquet", "--formats writes files; say with --out where they shall go"),
    ],
    "pst": [
        ("x --field-deg 0:95:5", "argument --field-deg: 95 must lie between -90 and 90 degrees"),
        ("x --field-deg 0:80", "'0:80' is not a range; write first:last:step, such as 0:80:2"),
        ("x --field-deg 80:0:2", "'80:0:2' must go up: first:last:step"),
        ("x --field-deg 0:80:1e-6", "is more than 20000 numbers; give a larger step"),
        ("lens.xml --cell-deg 3", "cell_deg is 3; it must be at most the distance of two angles, 2 degrees"),
        (f"{PST} --map-field-deg 20", "--map-field-deg draws pictures; say with --out where they shall go"),
        (f"{PST} --map-field-deg 85 --out o", "angle 85° is in no cell; the nearest is that of 40°"),
        (f"{PST} --map-pixels 32", "--map-pixels is about --map-field-deg; give that too, or leave it out"),
        (f"{PST} --out o --formats npy", "--formats npy writes irradiance maps; say with --map-field-deg of which"),
        (f"{PST} --up-to-deg 60", "--up-to-deg is about --relative-error; give that too, or leave it out"),
        (f"{PST} --resume", "--resume needs the saved run; give --state FILE, or the --out DIR of that run"),
        (f"{PST} --resume --state none.npz", "there is no saved run 'none.npz'; run without --resume first"),
        (f"{PST} --resume --out none", "there is no saved run 'none/pst_state.npz'; run without --resume first"),
        (f"{PST} --resume --method forward", "--resume with --method forward, which cannot go on from a saved run"),
        (f"{PST} --state .", "--state . is a directory; name a file"),
    ],
    "study": [
        ("lens.xml --resume", "--resume needs the folder"),
        ("lens.xml --resume --out none", "there is no saved run"),
    ],
    "thermal": [
        ("x --formats fits", "argument --formats: invalid choice: 'fits'"),
        ("x --part tube", "'tube' is no NAME=T, such as detector=77"),
        ("lens.xml --quantum-efficiency 0.6", "--pixel-um, --bandwidth-hz"),
        ("lens.xml --pixel-um 15 --bandwidth-hz 500", "--detectivity or --quantum-efficiency"),
    ],
    "coating": [
        ("bbar3 --wavelength-nm 9000 --back N-BK7", "9000 nm is outside"),
        ("bbar3 --wavelength-nm 500:400:5", "'500:400:5' must go up: first:last:step, such as 400:700:5"),
        ("bbar3 --wavelength-nm 400:500", "--wavelength-nm: '400:500' is not a range; write first:last:step"),
        ("bbar3 --wavelength-nm red", "--wavelength-nm: 'red' is not a number"),
        ("bbar3 --wavelength-nm 400:500:1e-3", "is more than 20000 numbers; give a larger step"),
        ("bbar3 --angles-deg 95", "must lie between 0 and 90 degrees"),
        ("bbar3 --plot a.gif", "picture 'a.gif': its name must end in .png, .svg or .pdf"),
        ("cooke_triplet --back N-BK7", "--back has no meaning for a scene"),
    ],
    "bsdf": [
        ("abc", "scatter model 'abc' is unknown; use abg, "),
        ("abg --A 1", "B is missing; give A, B, g"),
        (f"{ABG} --level 300", "abg has no --level; its options are --A, --B, --g"),
        (f"{ABG} --rms-nm 5", "--rms-nm gives A, B and g; leave --A out"),
        (f"{ABG} --delta-n 2", "--delta-n is for parameters from a roughness"),
        ("abg --rms-nm 5", "abg from --rms-nm needs --correlation-um; --correlation-um is missing"),
        ("paint --preset flat_black --l 1", "paint: --l with a preset"),
        (f"{ABG} --plot-particles a.png", "abg has no particles; leave --plot-particles out"),
        ("nowhere.csv --A 1", "nowhere.csv has no --A; its options are --cosine-corrected, --beyond"),
        ("abg --A 0 --B 1 --g 0", "abg scatters nothing"),
        # Numbers that no surface has: totals are finite and at most 1, and the tables of a trace hold the values
        ("phong --b0 1e308 --exponent 10", ""),
        ("abg --A 0.0025 --B 0.001 --g 1e308", ""),
        ("harvey_shack --b0 1 --l 1e308 --s=-1.5", ""),
        ("gaussian_lobe --total 1e-308 --width 0.1", ""),
        ("particulate --level 300 --slope 1e308", ""),
        ("polynomial --coefficients c000=1e308", ""),
    ],
    "sensitivity": [
        ("lens.xml --kind scatter", "the scene has no parameter of kind scatter"),
        ("lens.xml --metric pst_band", "the metric pst_band needs --band-deg"),
        ("lens.xml --band-deg 20 80", "--band-deg is not about the metric path_power; it takes --paths"),
        ("lens.xml --tolerance 0.1", "'0.1' is no KEY=VALUE, such as L*_front.x=0.02"),
        ("lens.xml --resume", "give --state FILE"),
        ("lens.xml --resume --out none", "no saved run"),
    ],
    "budget": [("lens.xml no.toml", "budget 'no.toml': No such file or directory; check the path")],
    "optimize": [
        ("lens.xml study.toml --resume", "--resume needs the folder of the saved run; give --out"),
        ("lens.xml study.toml --resume --out none", "there is no saved run"),
        ("lens.xml study.toml --out study.toml", "is a file; name a directory"),
    ],
    "view": [
        ("lens.xml --no-trace --save-rays rays.ply", "--save-rays has no effect with --no-trace"),
        ("lens.xml --no-trace --seed 3", "--seed has no effect with --no-trace; leave it out"),
        ("lens.xml --no-trace --surface-maps", "--surface-maps has no effect with --no-trace"),
        ("lens.xml --layout lens.svg --cut-deg none", "--cut-deg has no effect without a page; give --out"),
        ("lens.xml --surface-maps --layout lens.svg", "--surface-maps has no effect without a page"),
        (f"{VIEW} --classes windw", "'windw'"),
        (f"{VIEW} --classes ghost --path-ids 1", "--path-ids is about paths"),
        (f"{VIEW} --classes backward --box -1 1 -1 1", "backward"),
        (f"{VIEW} --box -1 1 -1 1", "add --classes all"),
    ],
    "app": [
        ("lens.xml --control nothing --no-browser", "nothing"),
        ("x --port 70000", "70000"),
        ("x --seconds -1", "-1"),
    ],
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: Patch) -> Path:
    monkeypatch.chdir(tmp_path)
    for name, text in (("lens.xml", INPUTS["coated.xml"]), ("study.toml", STUDY), ("media.yaml", "")):
        Path(name).write_text(text)
    return tmp_path


@pytest.mark.parametrize("command", REFUSED)
def test_one_line_and_nothing_is_written(command: str, folder: Path, capsys: Captured) -> None:
    before = sorted(folder.rglob("*"))
    for arguments, words in REFUSED[command]:
        line = fails(capsys, *([command] if command else []), *shlex.split(arguments))
        assert words in line, arguments
    assert sorted(folder.rglob("*")) == before


@pytest.mark.usefixtures("folder")
def test_a_missing_package_is_told_before_the_trace(capsys: Captured, monkeypatch: Patch) -> None:
    monkeypatch.setattr("mistray.scene.load", None)
    for name in {"astropy", *(name for name in sys.modules if name.startswith("astropy."))}:  # other tests import it
        monkeypatch.setitem(sys.modules, name, None)
    assert "astropy" in fails(capsys, "ghosts", "x", "--out", "out", "--formats", "fits")
    monkeypatch.setitem(sys.modules, "plotly.graph_objects", None)
    assert "pip install 'mistray[view]'" in fails(capsys, "view", "x", "--out", "v.html")
    assert not Path("out").exists()
