"""Sections that users add to the reports of any result."""

import json
from pathlib import Path

import pandas as pd
from command_line import Captured, succeeds

import mistray
from mistray.analysis import ThermalReport
from mistray.report import remove_section, report_section, write_thermal
from mistray.toolkit.pages.model import Section, Table, columns


def test_a_section_of_thermal_emission(capsys: Captured, tmp_path: Path) -> None:
    """It stands on the page, among the tables, in the JSON of the folder, and in what is printed; not elsewhere."""

    @report_section(of=ThermalReport)
    def warmest(report: ThermalReport) -> Section:
        most = max(emitter.temperature_K for emitter in report.emitters)
        return Section("warmest", "Warmest", [Table(columns("warmest [K]"), [[f"{most:g}"]], "warmest")], "Warmest")

    out = tmp_path / "out"
    try:
        words = ("thermal", "plate", "--wavelength-um", "9", "--rays", "500")
        printed = succeeds(capsys, *words)
        write_thermal(mistray.thermal(mistray.load("plate"), wavelengths_um=9, rays=500), out)
        told = json.loads(succeeds(capsys, *words, "--json"))
        other = json.loads(succeeds(capsys, "image", "cooke_triplet", "--grid", "16", "--json"))
    finally:
        remove_section(warmest)
    assert "\nWarmest\n" in printed
    assert told["sections"]["warmest"]["warmest"] == [{"warmest_K": 293}]
    assert json.loads((out / "thermal.json").read_text(encoding="utf-8"))["sections"] == told["sections"]
    assert pd.read_csv(out / "warmest.csv").warmest_K.tolist() == [293]
    page = (out / "report.html").read_text(encoding="utf-8")
    assert page.index('<h2 id="warmest">') < page.index('id="settings"')
    assert "sections" not in other
