"""An anisotropic BSDF in closed form, A + B (s_x² - s_y²) + C s_x s_y + D (t_x² - t_y²) of the tangential parts t of
the specular and s of the scattered direction in the sample's axes, and files of it in published formats."""

import itertools
from pathlib import Path

import numpy as np

A, B, C, D = 0.1, 0.05, 0.06, 0.02


def bsdf(specular: np.ndarray, scattered: np.ndarray, x_axis: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """BSDF, 1/sr, at unit vectors (…, 3) of any frame; the normal (3,) is on the side that the light comes from."""
    y_axis = np.cross(normal, x_axis)
    (tx, ty), (sx, sy) = (
        tuple(np.sum(v * axis, axis=-1) for axis in (x_axis, y_axis)) for v in (specular, scattered)
    )  # fmt: skip
    return A + B * (sx**2 - sy**2) + C * sx * sy + D * (tx**2 - ty**2)


def total(specular: np.ndarray, x_axis: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """∫ f cos θs dΩ over the hemisphere: π (A + D (t_x² - t_y²)), the other terms are odd or cancel."""
    return np.pi * (bsdf(specular, np.zeros(3), x_axis, normal))


def write_asymmetrical_4d(path: Path, rotations: np.ndarray, incidence: np.ndarray, kind: str = "BRDF") -> Path:
    """A Zemax tabular BSDF after R. Rykowski's description: light in x z, the sample's x axis is y turned by
    SampleRotation, ScatterAzimuth 0 points to the normal and goes counterclockwise for who looks at the sample."""
    azimuth, radial = np.arange(0.0, 360.5, 10.0), np.arange(0.0, 180.1, 4.0)
    lines = ["# independent writer", "Source\tMeasured", "Symmetry\tAsymmetrical4D", "SpectralContent\tMonochrome"]
    lines.append(f"ScatterType\t{kind}")
    for name, grid in (
        ("SampleRotation", rotations), ("AngleOfIncidence", incidence), ("ScatterAzimuth", azimuth),
        ("ScatterRadial", radial),
    ):  # fmt: skip
        lines += [f"{name}\t{len(grid)}", "\t".join(f"{angle:g}" for angle in grid)]
    lines += ["", "Monochrome", "DataBegin"]
    normal = np.array([0.0, 0.0, 1.0])
    for rotation in np.radians(rotations):
        x_axis = np.array([-np.sin(rotation), np.cos(rotation), 0.0])
        for theta in np.radians(incidence):
            centre = np.array([np.sin(theta), 0.0, np.cos(theta)])
            upward = np.array([-np.cos(theta), 0.0, np.sin(theta)])
            lines.append(f"TIS\t{total(centre, x_axis, normal):.6f}")
            for phi in np.radians(azimuth):
                away = np.cos(phi) * upward + np.sin(phi) * np.cross(centre, upward)
                alpha = np.radians(radial)[:, None]
                values = bsdf(centre, np.cos(alpha) * centre + np.sin(alpha) * away, x_axis, normal)
                lines.append("\t".join(f"{value:.6e}" for value in values))
    path.write_text("\n".join([*lines, "DataEnd"]) + "\n", encoding="utf-8")
    return path


def write_two_fold(path: Path, a: float, b: float, step: float = 5.0) -> Path:
    """A CSV table of a + b cos 2(φ - ρ), the azimuths of scatter and of the sample's x axis."""
    lines = ["rotation_deg,theta_i_deg,theta_s_deg,phi_deg,bsdf"]
    for rotation in np.arange(0.0, 360.0, 30.0):
        for phi in np.arange(0.0, 360.5, step):
            value = a + b * np.cos(2 * np.radians(phi - rotation))
            thetas = itertools.product((0, 40, 80), (0, 30, 60, 90))
            lines += [f"{rotation:g},{theta_i:g},{theta_s:g},{phi:g},{value:.9g}" for theta_i, theta_s in thetas]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path
