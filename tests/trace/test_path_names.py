"""Names of paths tell them apart, and are the same in every table."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Sequence

import numpy as np
import pytest
from report.fake_ledger import EDGE, GLASS, REFLECTOR, SENSOR, STRUCTURE, design_of, encode

import mistray
from mistray.analysis.pst.causes import stray_paths
from mistray.errors import MistrayWarning
from mistray.recorders.path_events import Events, describe_events
from mistray.report.tables.pst import path_frame
from mistray.scene.load import shipped_scenes

SURFACES = {"front": GLASS, "rear": GLASS, "mirror": REFLECTOR, "bevel": EDGE, "tube": STRUCTURE, "detector": SENSOR}
DESIGN = "front:T rear:T mirror:R detector:A"
NAMES = {
    DESIGN: "direct image",
    "front:T rear:T mirror:R detector:R mirror:R rear:R mirror:R detector:A": "detector → rear",
    "front:T rear:R front:R rear:T mirror:R detector:A": "rear → front",
    "front:T rear:t mirror:R detector:A": "scatter at rear",
    "front:T rear:T mirror:r detector:A": "scatter at mirror",
    "tube:R detector:A": "tube (structure)",
    "tube:r detector:A": "scatter at tube",
    "front:T rear:T tube:r detector:A": "front:T rear:T tube:r",
    "front:T rear:T tube:r mirror:R detector:A": "front:T rear:T tube:r mirror:R",
    "front:T rear:R front:R bevel:T mirror:R detector:A": "rear:R front:R bevel:T mirror:R",
    "front:T rear:T detector:A": "straight shot through front, rear",
    "rear:T mirror:R detector:A": "straight shot through rear, mirror:R",
    "detector:A": "straight shot past all surfaces",
    "mirror:R detector:R rear:R mirror:R detector:A": "mirror:R detector:R past rear:R",
    "front:I rear:T mirror:R detector:A": "front:I",
}


def names_of(events: Sequence[str], *design: str) -> list[str]:
    codes, lengths = encode(events, list(SURFACES))
    words = np.array(list(SURFACES.values()), dtype=np.uint32)
    events = Events(codes, lengths, list(SURFACES), words, design_of(SURFACES, *design))
    return describe_events(events)["label"].tolist()


def test_names_follow_from_the_events_of_a_path_alone() -> None:
    """Written down by hand; and the same for each path by itself as in a table with all others."""
    assert names_of(list(NAMES), DESIGN) == list(NAMES.values())
    assert [names_of([events], DESIGN)[0] for events in NAMES] == list(NAMES.values())


def test_different_paths_have_different_names() -> None:
    """Every event list of up to four events, 41 371 of them."""
    words = [f"{name}:{letter}" for name in ("front", "rear", "mirror", "tube") for letter in "TRtr"]
    words = [*(w for w in words if w not in ("mirror:T", "tube:T", "mirror:t", "tube:t")), "detector:R", "bevel:T"]
    lists = [" ".join([*some, "detector:A"]) for n in range(5) for some in itertools.product(words, repeat=n)]
    for design in ([DESIGN], []):
        assert len(set(names_of(lists, *design))) == len(lists)


@pytest.mark.long
@pytest.mark.parametrize("scene", ["phone_camera", "double_gauss_barrel", "cassegrain", "lens_and_reflector"])
def test_no_name_is_blank_or_given_twice_in_a_pst(scene: str) -> None:
    pst = mistray.pst(mistray.load(scene), [18.0, 20.0, 22.0, 24.0], rays=4_000)
    named: dict[str, str] = {}
    file = path_frame(pst)  # of pst_paths.csv
    assert (file.groupby("events")[["label", "key"]].nunique() == 1).all(axis=None)
    assert (file.groupby("key").events.nunique() == 1).all()
    for angle in pst.field_deg:
        rows = stray_paths(pst, angle)
        assert all(named.setdefault(*pair) == pair[1] for pair in zip(rows.events, rows.label, strict=True))
        assert rows.events.is_unique
        assert rows.label.is_unique
        assert rows.label.str.strip().astype(bool).all()


@pytest.mark.long
@pytest.mark.parametrize("scene", sorted(shipped_scenes()))
def test_every_path_of_a_trace_has_a_name_of_its_own(scene: str) -> None:
    """At two wavelengths, where the same events have the same name; in the ledger, its print and by ways."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MistrayWarning)  # of improbable scatter
        loaded = mistray.load(scene)
    paths = mistray.trace(loaded, field_deg=0.1, rays=512, wavelength_nm=[550.0, 600.0]).paths
    for table in (paths.to_pandas(), paths.by_way()):
        for _, rows in table.groupby(["source", "wavelength_nm"]):
            assert rows.label.is_unique
        assert table.groupby(["source", "events"]).label.nunique().max() == 1
        assert table.label.str.strip().astype(bool).all()
    for line, row in zip(str(paths).splitlines()[1:21], paths, strict=False):
        assert line.endswith(row.label)
