"""Calls of all commands that together use every option: the forms of README and docs, with small scenes and few rays.

`same_outputs.py` runs them. A line is what stands behind `mistray COMMAND`; those of one command run in their order in
one folder, which holds `INPUTS`. {scenes} is the folder of the shipped scenes, {port} a free port.
"""

from __future__ import annotations

EXACT = ("doctor", "import", "coat", "image", "coating", "bsdf", "cache", "completion")
"""Commands that trace no random rays, or only to say that light arrives."""

# Options that no call uses, and why
EXCEPT: dict[str, str] = {
    "--request": "it stands for the options of all calls: tests/toolkit/test_command_request.py",
    "--schema": "what it prints is tested there, too",
}

ZMX = """UNIT MM X W X CM MR CPMM
ENPD 8
FTYP 0 0 1 1 0 0 0
XFLN 0
YFLN 0
WAVM 1 0.5875618 1
SURF 0
  DISZ INFINITY
SURF 1
  STOP
  CURV 0.02
  DISZ 5
  GLAS {glass}
SURF 2
  {coat}CURV -0.02
  DISZ 46
SURF 3
  DISZ 0
"""
CONFIGURATIONS = """MNUM 2 1
THIC 2 1 46 0 0 0 1 1 1 0 0 "" 0
THIC 2 2 45 0 0 0 1 1 1 0 0 "" 0
"""
SEQ = """LEN
TITLE 'Singlet'
EPD 8
DIM M
WL 587.5618
REF 1
XAN 0 0
YAN 0 3
SO 0 1E20
S 50 5 NBK7_SCHOTT
  STO
S -50 46
SI 0 0
GO
"""
AGF = """CC Glasses of one maker
NM MYCROWN 2 517642.251 1.5168 64.17 0 1 1
ED 7.1 8.3 2.51 -0.0009 0
CD 1.03961212E+00 6.00069867E-03 2.31792344E-01 2.00179144E-02 1.01046945E+00 1.03560653E+02 0 0 0 0
LD 0.3 2.5
IT 0.40 0.992 25.0
IT 0.70 0.998 25.0
"""
COATING_DAT = """MATE MGF2
0.400 1.3838 0
0.700 1.3761 0

COAT AR
MGF2 .25
"""
CORNERS = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
STL = "".join(
    [
        "solid wedge\n",
        *(
            "facet normal 0 0 0\nouter loop\n"
            + "".join(f"vertex {x} {y} {z}\n" for x, y, z in (CORNERS[k] for k in facet))
            + "endloop\nendfacet\n"
            for facet in ((0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3))
        ),
        "endsolid wedge\n",
    ]
)
BUDGET = """[[require]]
metric = "path_power"
selection = "single scatter"
limit = 1e-2
[[choose]]
surfaces = ["plate_front", "plate_rear"]
parameter = "A"
best = 1e-6
worst = 1e-3
[traced]
rays = 256
max_reflections = 0
[solver]
seeds = 2
iterations = 2
"""
STUDY = """[[term]]
name = "ghosts"
kind = "path_power"
goal = "minimise"
wavelength_nm = 550
rays = 64
[[coating]]
name = "AR"
surfaces = ["L1_front", "L1_rear"]
layers = "1.38 60"
thickness_nm = [20, 180]
[optimizer]
starts = 1
steps = 2
"""
STATES = """[[configuration]]
name = "as designed"
[[configuration]]
name = "detector back"
values = { "detector.z" = 0.5 }
"""
EDITS = """[[configuration]]
name = "darker screen"
values = { "grey.reflectance" = 0.05 }
"""
BATOID = """opticalSystem:
  type: CompoundOptic
  name: mirror
  pupilSize: 0.02
  items:
    - {type: Mirror, name: M1, surface: {type: Paraboloid, R: 0.4}, coordSys: {z: 0.0},
       obscuration: {type: ClearCircle, radius: 0.01}}
    - {type: Detector, name: D, surface: {type: Plane}, coordSys: {z: 0.2},
       obscuration: {type: ClearCircle, radius: 0.002}}
"""
# A sample whose BSDF depends on how it is turned: theta_i, theta_s, phi and a value, for two rotations
BRUSHED = "rotation_deg,theta_i_deg,theta_s_deg,phi_deg,bsdf\n" + "".join(
    f"{rotation},{theta_i},{theta_s},{phi},{0.15 if (phi - rotation) % 180 == 0 else 0.05}\n"
    for rotation in range(0, 360, 90)
    for phi in range(0, 361, 90)
    for theta_i in (0, 40, 80)
    for theta_s in (0, 30, 60, 90)
)
PSD = "frequency_1_mm,psd_nm2_mm2\n" + "".join(f"{2.0**k:g},{4e-5 / (1 + 4.0**k * 4e-4):.6g}\n" for k in range(10))

OWN = """
title = "Plate"
source = "closed form"
scene = "plate"
[[row]]
name = "ghost of both faces"
quantity = "share_percent"
path = ["plate_rear", "plate_front"]
published = 0.1597
tolerance = 0.0001
"""
INPUTS = {
    "lens.zmx": ZMX.format(glass="N-BK7 0 0 1.5168 64.17", coat=""),
    "other.zmx": ZMX.format(glass="MYCROWN 0 0 1.5168 64.17", coat="COAT AR\n  ") + CONFIGURATIONS,
    "named.zmx": ZMX.format(glass="MYGLASS 0 0 1.62 36.4", coat=""),
    "lens.seq": SEQ,
    "mirror.yaml": BATOID,
    "makers.agf": AGF,
    "COATING.DAT": COATING_DAT,
    "wedge.stl": STL,
    "budget.toml": BUDGET,
    "study.toml": STUDY,
    "states.toml": STATES,
    "edits.toml": EDITS,
    "brushed.csv": BRUSHED,
    "psd.csv": PSD,
    "own.toml": OWN,
}

# Run before the calls of a command, for the files that they make
PREPARED = {
    "import": ("export plate -o plate.step",),
    "coat": ("coating 'MgF2 99.64' --csv own.csv",),
    "bsdf": ("bsdf paint --reflectance 0.05 --table measured.bsdf --angles-deg 0 40 80",),
}

SURFACES = "--coating 'plate_*=mgf2_quarter_wave' --paint 'board*=flat_black' --scatter 'plate=harvey_shack rms_nm=4'"
MACHINE = "--variant llvm_ad_rgb --threads 1 --plugin mistray.plugins.bsdfs.abg"
LIMITS = (
    "--max-reflections 3 --max-generations 4 --max-events 32 --max-consecutive 8 --max-segments 2000 "
    "--flux-threshold 1e-9 --cut-below R=1e-7 --below-threshold roulette --seed 3"
)
TREE = f"{LIMITS} --splitting one --ray-control allow_all --polarization unpolarized {MACHINE}"
SCATTER = "--max-scatters 2 --max-optical-scatters 1 --scatter-rays 2 --aimed-rays 2 --aim none --scatter-threshold 0.2"
FORWARD = "--max-random-scatters 1 --cut-below-W t=1e-12"  # limits nothing in a backward trace
SPECTRUM = "--wavelength-nm 500 600 --weights 1 2"
WALL = "plate_and_wall"
ALL = f"{WALL} {TREE} {SCATTER} {SURFACES}"
NOWHERE = "--scheduler nonsense://x"
REFUSED = (NOWHERE, f"{FORWARD} --quiet")
"""What is read but refused: a scheduler that there is none at, and limits that backward traces have not."""

DRAWS = (
    "singlet_window_detector --field-deg 1 --rays 300 --parameter '*.curvature' '*.R' --together 'window*.curvature' "
    "--tolerance '*.R=0.01' --change '*.R' --factor 5 --reach 8 --monte-carlo 3 --edge-width 0.1 --out draws"
)

CALLS: dict[str, tuple[str, ...]] = {
    "doctor": ("",),
    "import": (
        "lens.zmx -o lens.xml",
        "lens.zmx -o lens.xml --force",
        "lens.zmx -o ground.xml --edges ground --beam exact --margin 0.05 --detector-half-mm 3 2 --wavelength-nm 600",
        "lens.zmx -o coated.xml --coating '*=bbar3' --paint 'barrel*=flat_black' --scatter 'L*=harvey_shack rms_nm=4'",
        "other.zmx -o other.xml --coatings COATING.DAT --glass-catalogue makers.agf --configuration 2",
        "named.zmx -o named.xml --glass 'MYGLASS=nd=1.62 Vd=36.4 k=0'",
        "lens.seq -o seq.xml --radius-mode yes",
        "mirror.yaml -o mirror.xml --wavelength-nm 620",
        "{scenes}/phone_camera/prescription.json -o phone.xml --variant R13=5.272 --beam exact",
        "wedge.stl --into plate -o both.xml --unit cm --move-mm 0 20 12 --tilt-deg 0 0 30 --space '*=1' "
        "--paint '*=flat_black' --most-analytic 2",
        "plate.step -o parts.xml --tolerance-mm 0.05 --time-limit-s 300",
    ),
    "coat": (
        "cooke_triplet 'L?_*=bbar3' -o triplet_coated.xml",
        "cooke_triplet 'L?_*=MgF2 99.64, Al2O3 80' 'L1_front=own.csv' -o own.xml",
        "plate 'plate_*=bare' --paint '*edge=flat_black' --scatter 'plate_front=harvey_shack rms_nm=2' -o rough.xml",
        "plate 'plate_*=bbar4 design_nm=940' -o rough.xml --force",
    ),
    "export": (
        "cooke_triplet -o triplet.zmx",
        "cooke_triplet -o critical.csv --field-deg 0 7 10",
        "lens_and_window -o lens.step --field-deg 0 --wavelength-nm 550 --paths 2 --rays 1e3 --rays-per-path 3 --force",
        "cassegrain -o cassegrain.step --field-deg 0 --mirror-thickness-mm 20 --freeform-tolerance-mm 1e-4",
    ),
    "view": (
        "phone_camera --field-deg 20 --rays 1e3 --out view.html",
        f"{ALL} {FORWARD} --rays 500 {SPECTRUM} --json --out all.html --path-ids 0 1 --surface-maps 'housing*' "
        "--colour absorbed",
        "phone_camera --field-deg 0 20 --azimuth-deg 30 --rays 500 --classes direct ghost --box -1 1 -1 1 "
        "--out classes.html --rays-per-path 3",
        "lens_and_window --rays 500 --filter 'G(window*)' --paths 2 --layout lens.svg "
        "--save-rays rays.json rays.ply --json",
        "lens_and_window --rays 500 --source point:0,0,-500 --cut-deg 90 --cut-mm 1 --out point.html --quiet --force",
        "lens_and_window --no-trace --out scene.html --json",
    ),
    "app": (
        f"singlet_window_detector --no-browser --field-deg 0 3 --wavelength-nm 550 --rays 500 --seconds 2 {TREE} "
        f"{SCATTER} {FORWARD} --control 'window*.curvature' --out explored --force",
        "singlet_window_detector --no-browser --field-deg 0 --rays 500 --seconds 1 --port {port} --quiet",
        "singlet_window_detector --no-browser --field-deg 0 --rays 500 --seconds 1 --json",
    ),
    "ghosts": (
        "phone_camera --field-deg 0 20 --rays 1e3 --contested-rays 0 --out out",
        f"{ALL} {FORWARD} --rays 500 {SPECTRUM} --azimuth-deg 20 --seconds 1e6 --per-wavelength "
        "--photometric --detector detector",
        "cooke_triplet --source point:0,0,-500 --field-mm 0 20 --rays 500",
        "cooke_triplet --source sun:field_deg=15,irradiance=1.361e-3 --rays 500",
        f"{WALL} --rays 500 --probe '0,0,17,half_width=20,half_height=20,id=behind' --far-field edges_deg=90:180:5 "
        "--surface-maps 'housing*' --flux-split 'plate*' board --maps ghost 'S(plate*)' --out maps --formats npy fits",
        "phone_camera --field-deg 20 --rays 1e3 --levels --alias part --path-analysis opl_mm --least-share 1e-3 "
        "--filter 'G(window*) & order = 2' --contested-rays 4e3 --rank peak",
        "phone_camera --field-deg 20 --rays 500 --rays-at 'barrel*' --most-rays 50 --filter G --out rays "
        "--formats dat parquet pdf --force",
        "cooke_triplet --wavelength-nm 450 550 650 --weights 1 2 1 --rays 1e3 --colour --stops 1 --reference direct "
        "--white D65 --block 2 --out colour",
        f"plate --rays 500 --quiet {NOWHERE}",
    ),
    "image": (
        "cooke_triplet --field-deg 0 14 --grid 32 --frequencies 20 40 --out out --formats pdf parquet",
        f"lens_and_window {MACHINE} --grid 16 {SPECTRUM} --field-deg 1 --azimuth-deg 90 --detector detector "
        "--coating 'L1*=bbar3' --paint 'barrel*=flat_black' --scatter 'L1=harvey_shack rms_nm=4'",
        "cooke_triplet --source point:0,0,-500 --field-mm 0 20 --grid 16",
        "lens_and_window --grid 16 --stop L1_front --out quiet --quiet --force",
    ),
    "sweep": (
        "lens_and_window states.toml --field-deg 0 2 --rays 500 --out out --formats parquet pdf",
        f"lens_and_window --field-deg 1 --azimuth-deg 20 --wavelength-nm 500 600 --rays 200 {TREE} "
        f"{SCATTER} {FORWARD} --set detector.z=0.5 --seconds 1e6 --no-cache",
        f"{WALL} edits.toml --pst-field-deg 20:40:20 --rays 2e3 --coating 'plate_*=bbar3' --paint 'board*=flat_black' "
        "--out edits --force",
        f"{WALL} --pst-field-deg 30 --rays 2e3 --rank --step 'position=0.5' '*reflectance=10%'",
        f"{WALL} --set screen.z=1 --write-scene moved.xml",
        f"{WALL} edits.toml --write-scene darker.xml --configuration 'darker screen'",
        f"{WALL} --rays 200 --quiet {NOWHERE}",
    ),
    "objects": (
        "phone_camera --half-angle-deg 20 --rays 2e3 --out out --formats parquet pdf",
        f"phone_camera --field-deg 0 20:40:10 --azimuth-deg 30 --rays 2e3 --rows 10 --wavelength-nm 500 "
        f"{MACHINE} --seed 3 --seconds 1e6 --max-events 32 --ray-control allow_all --detector detector "
        "--coating 'L1*=bbar3' --paint 'barrel*=flat_black' --scatter 'L1=harvey_shack rms_nm=4'",
        "phone_camera --disc -5.749 3.083 --view-half-angle-deg 45 --no-total-reflection --threshold 0 --rays 2e3 "
        "--stop stop --out quiet --quiet --force",
    ),
    "pst": (
        f"{WALL} --field-deg 0:80:20 --rays 2e3 --out out --formats pdf parquet",
        f"{WALL} --field-deg 20 40 --rays 2e3 --method adjoint --out maps --formats npy --map-field-deg 20 40 "
        "--map-azimuth-deg 90 --map-pixels 16",
        f"{WALL} --field-deg 0:80:20 --rays 4e3 --out out --resume",
        f"{ALL} {SPECTRUM} --field-deg 20 40 --rays 1e3 --seconds 1e6 --cell-deg 5 --azimuths-deg 0:270:90 "
        "--azimuth-cell-deg 20 --detector detector --convention projected --no-next-order --state run.npz",
        f"{WALL} --field-deg 0 10 20 --rays 500 --method forward --max-random-scatters 1 --paths-shown 2 "
        "--out forward --force",
        f"{WALL} --field-deg 20 40 --rays 4e4 --relative-error 0.3 --up-to-deg 30 --no-next-order",
        f"{WALL} --field-deg 20 --rays 200 --quiet --cut-below-W t=1e-12 {NOWHERE}",
    ),
    "study": (
        f"{WALL} --quick --field-deg 0 --pst-field-deg 0:40:20 --rays 2e3 --out out --formats pdf parquet",
        f"{WALL} --quick --field-deg 0 --pst-field-deg 0:40:20 --rays 4e3 --out out --resume",
        f"{ALL} {SPECTRUM} --field-deg 0 --pst-field-deg 20 40 --rays 1e3 --azimuth-deg 20 --convention projected "
        "--seconds 1e6 --no-next-order --relative-error 0.5 --source beam:radius=10,wavelength_nm=550",
        f"{WALL} --rays 1e3 --pst-field-deg 20 --field-deg 0 {FORWARD} --out quiet --quiet --force {NOWHERE}",
    ),
    "thermal": (
        "newtonian_scatter --wavelength-um 0.55 --rays 1e3 --out out --formats pdf parquet",
        f"{WALL} {LIMITS} --splitting one --ray-control allow_all {MACHINE} {SCATTER} {SURFACES} --rays 500 "
        "--temperature-K 300 --band-um 0.5 0.7 --wavelength-um 0.55 0.65 --scene-K 310 --seconds 1e6 "
        "--polarization unpolarized --detector detector --part 'board*=290' screen=320",
        f"{WALL} --wavelength-um 0.55 --rays 200 {FORWARD} --quiet",
        f"{WALL} --rays 500 --wavelength-um 0.55 --part detector=77 --pixel-um 15 --bandwidth-hz 1e4 "
        "--detectivity 1e11 --quantum-efficiency 0.6 --band-um 0.5 0.7 --out quiet --quiet --force",
    ),
    "coating": (
        "bbar3 --back N-LAK9 --angles-deg 0 20 40 --plot bbar3.png",
        "'MgF2 99.64, TiO2 20, Al2O3 80' --front 1.5 --from-back --wavelength-nm 400:700:50 --csv ar.csv",
        "bbar3 --design-nm 600 --csv ar.csv --force --json",
        "cooke_triplet",
        "COATING.DAT:AR",
        "protected_al --wavelength-nm 400:1000:100",
    ),
    "bsdf": (
        "abg --A 0.0025 --B 0.001 --g 1.8 --plot abg.png --csv abg.csv --table abg.bsdf --reference-nm 600",
        "abg --rms-nm 5 --correlation-um 100 --delta-n 1.9 --raw-integral 0.9 --wavelength-nm 500 --R 0.95",
        "abg --A 2e-5 --B 1e-6 --g 2 --event transmission --hit-deg 30 --hit-sr 4e-6 --hit-before 0.125",
        "harvey_shack --rms-nm 4 --event transmission --back 1.5333 --T 0.9 --from-back --front 1.2 --angles-deg 0 20",
        "harvey_shack --b0 0.1 --l 0.02 --s=-1.8 --angles-deg 0",
        "edge_diffraction --width-mm 0.1 --law heisenberg --angles-deg 0",
        "gaussian_lobe --total 0.01 --width 0.1 --angles-deg 0 30",
        "k_correlation --rms-nm 4 --B-um 20 --slope 2.5 --theory rayleigh_rice_vector --event reflection "
        "--substrate 1.2+7i --band-limited --angles-deg 0",
        "paint --preset flat_black --angles-deg 0 60 --csv abg.csv --force --json",
        "paint --spectrum 400:0.02,700:0.05 --wavelength-nm 600 --angles-deg 0",
        "paint --reflectance 0.05 --b0 0.1 --n 1.6 --angles-deg 0",
        "particulate --level 300 --plot-particles sizes.png --particle 1.53+0.002i --min-um 2 --max-um 200 "
        "--immersion 1.33 --angles-deg 0 --json",
        "particulate --coverage-percent 0.1 --slope 0.8 --angles-deg 0 --event transmission --back air",
        "phong --b0 0.1 --exponent 16 --angles-deg 0",
        "polynomial --coefficients c000=-0.5,c100=-0.4,l10=-0.7 --d 2e3 --angles-deg 0",
        "psd_table --file psd.csv --scale 1.2 --beyond slope --angles-deg 0",
        "brushed.csv --anisotropy keep --angles-deg 40 --rotations-deg 0 90 --cosine-corrected",
        "measured.bsdf --table copy.csv --angles-deg 0 40",
    ),
    "sensitivity": (
        "singlet_window_detector --rays 500 --kind share curvature --out out --formats pdf parquet --top 5",
        f"{ALL} {FORWARD} {SPECTRUM} --rays 200 --paths 'single scatter' --parameter 'plate*.curvature' --no-check "
        "--no-edges --seconds 1e6 --state run.npz --source beam:radius=10,wavelength_nm=550",
        f"{DRAWS} --quiet --force",
        f"{DRAWS} --resume --json",
        f"{WALL} --metric pst_band --band-deg 20 40 --light single_scatter --rays 1e3 --kind scatter --no-check",
        f"{WALL} --metric veiling_glare --patch-deg 5 --rays 1e3 --kind scatter --no-check",
        f"plate --rays 200 {NOWHERE}",
    ),
    "budget": (
        f"{WALL} budget.toml {MACHINE} --out out --formats pdf parquet",
        f"{WALL} budget.toml --out out --force --json",
        f"{WALL} budget.toml --quiet",
    ),
    "optimize": (
        f"lens_and_window study.toml --steps 1 --verification-seeds 2 {MACHINE} --seconds 1e6 "
        "--out out --formats pdf parquet",
        "lens_and_window study.toml --steps 2 --verification-seeds 2 --out out --resume --json",
        "lens_and_window study.toml --verification-seeds 2 --no-next-order --quiet --force",
    ),
    "validate": (
        f"--only 'phone_camera/*filter*0°' tracepro_abg {MACHINE} --rays 2e4 --seed 3 --out out --formats pdf parquet",
        "--only thin_films --out out --force --json",
        "--own own.toml --rays 2e4",
        "--only scatmech --quiet",
    ),
    "cache": ("info", "clear"),
    "completion": ("bash", "zsh", "fish"),
}

# Wrong input: each is one line on stderr
WRONG = (
    "ghosts platte",
    "ghosts plate --depth 2",
    "ghosts plate --wavelength-nm 450 550 --weights 1",
    "import no_such_lens.json",
    "import lens.zmx --radius-mode yes",
    "coat plate",
    "export plate -o plate.dwg",
    "image plate",
    "sweep plate --set plate_front.bsdf.Q=1",
    "objects plate --azimuth-deg 10",
    "pst plate --field-deg 80:0:2",
    "study plate --resume",
    "thermal plate --part tubes=3",
    "coating bbar5",
    "bsdf abg --A 1",
    "sensitivity plate --metric pst_bin",
    "optimize plate study.toml",
    "view plate --path-ids 99 --rays 100",
)
