"""What changes of the phone camera are worth; see docs/validation/phone_camera_mitigation.md."""

from __future__ import annotations

import numpy as np
import pytest
from validation import phone_camera_mitigation as changed
from validation.tables import read, value

pytestmark = pytest.mark.validation

REPEATED = ("lenses R 2 to 0.25 %", "black bevels", "all cones to cylinders")


@pytest.fixture(scope="module", name="rows")
def written() -> dict[str, dict[int, tuple[float, float]]]:
    """Ratios of the page and their errors by change and angle; 0 stands for the image."""
    return {
        row["change"]: {0: value(row["image"])} | {angle: value(row[f"{angle}°"]) for angle in changed.ANGLES_DEG}
        for row in read("phone_camera_mitigation.md", "changes")
    }


def test_what_the_page_says_stands_in_its_table(rows):
    """Bounds that are crossed by 4.5 standard errors."""

    def below(name: str, angle: int, bound: float) -> bool:
        ratio, se = rows[name][angle]
        return ratio + 4.5 * se < bound

    def above(name: str, angle: int, bound: float) -> bool:
        ratio, se = rows[name][angle]
        return ratio - 4.5 * se > bound

    coated, both = "lenses R 2 to 0.25 %", "the same and both coatings"
    assert rows[coated][0][0] == pytest.approx(changed.ALL_FACES, abs=6e-4)
    assert below(coated, 4, 0.6)
    for angle in (20, 30, 45, 60, 75):
        assert above(coated, angle, 1.02)
        assert below(coated, angle, changed.ALL_FACES)
        assert 0.88 < rows[coated][angle][0] / rows[coated][0][0] < 1
        assert abs(rows["detector R 20 to 5 %"][angle][0] - 1) < 0.01
    assert below("detector R 20 to 5 %", 4, 0.7)
    assert below("black bevels", 20, 0.34)
    assert below("black bevels", 45, 0.67)
    assert rows["black bevels"][0] == (1, 0)
    assert below("matt walls of 1 %", 30, 0.053)
    assert below("walls without gloss", 30, 0.11)
    for angle in (60, 75):
        assert 2 * rows["matt walls of 1 %"][angle][0] < rows["walls without gloss"][angle][0]
    assert below("bevels, walls, cylinders, CL 200", 20, 0.034)
    assert below("first cone to a cylinder", 45, 0.53)
    assert above("all cones to cylinders", 10, 1.15)
    assert above("stop 0.075 to 0.010 mm thick", 60, 1.05)
    assert below("stop 0.075 to 0.010 mm thick", 75, 0.96)
    assert below("all faces CL 200", 10, 0.91)
    assert below("all faces CL 200", 75, 0.99)
    assert below(both, 4, 0.3)
    assert set(rows) == {one.name for one in changed.read_configurations(changed.STUDY)}


@pytest.mark.long
def test_rows_of_the_page_come_again_and_no_wall_opens_a_gap(rows):
    """By 5 combined standard errors, and 2 % for errors that are themselves uncertain."""
    found = changed.swept(3000, REPEATED)
    assert not any(found.gaps.values())
    assert not [warning for warning in found.warnings if "first meets" in warning]
    for row in changed.ratios(found):
        for angle in changed.ANGLES_DEG:
            ratio, se = rows[row["change"]][angle]
            assert abs(row[f"at{angle}"] - ratio) < 5 * np.hypot(row[f"at{angle}_se"], se) + 0.02 * ratio, (row, angle)
    assert [row["path"] for row in changed.start(found)][3:5] == [f"reflected by barrel_{k}_cone" for k in (3, 1)]
