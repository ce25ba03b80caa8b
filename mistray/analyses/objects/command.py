"""Command `mistray objects`, which finds the critical, illuminated and common objects of a scene."""

from __future__ import annotations

from mistray.toolkit.command import AnalysisCommand, Group
from mistray.toolkit.field_options import group, options_of
from mistray.toolkit.shared_options import ELSE, MACHINE, SCENE, SURFACES, TABLE_FORMATS, TIME, output

COMMAND = AnalysisCommand(
    "objects",
    "critical, illuminated and common objects of a scene, and the light that they scatter",
    "Objects that the detector sees (critical), that light from outside reaches (illuminated), and\n"
    "both (common): surfaces only transmit, mirrors reflect, nothing is split or scattered. Light that common\n"
    "objects and optics send to the detector by one scatter event is estimated as flux x BSDF x pi GCF. Ways by\n"
    "which the detector sees the outside past the optics are reported as warnings.",
    (
        "mistray objects phone_camera --half-angle-deg 20 --out out",
        "mistray objects phone_camera_scatter --field-deg 0 10 20:40:5 --rays 3e5",
        "mistray objects phone_camera --disc -5.75 3.083 --view-half-angle-deg 45 --threshold 0 --json",
    ),
    lambda request: (
        SCENE,
        group(
            "light from outside (one of the first three)",
            request.ObjectsRequest,
            *("half_angle_deg", "field_deg", "disc_mm", "azimuth_deg", "wavelength_nm"),
        ),
        group("view of the detector", request.ObjectsRequest, "view_half_angle_deg", "light", "stop"),
        Group(
            f"rays {ELSE}",
            (
                *options_of(request.ObjectsRequest, "rays", "threshold", "ray_control", "total_reflection", "settings"),
                TIME,
                *MACHINE,
            ),
        ),
        SURFACES,
        output(
            "objects.html, CSV, JSON and PNG files",
            ("objects.*", "objects_*.csv"),
            *options_of(request.ObjectsTables, "rows"),
            formats=TABLE_FORMATS,
        ),
    ),
    __package__,
    request="ObjectsRequest",
    shown="ObjectsTables",
)
