"""Everything that changes between Mitsuba releases: the supported release and the names of mesh buffers.

Mitsuba is imported inside functions only, because libLLVM has to be settled before that (see `mistray._variant`); so is
numpy, so that `mistray doctor` can say that it is missing.
"""

from __future__ import annotations

import contextlib
import importlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray.errors import MistrayError
from mistray.interrupts import importing

if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

SUPPORTED_RELEASE = "3.9"

_POSITIONS = "vertex_positions"
_FACES = "faces"
_APART = "vertex_apart"  # attribute of our meshes; Mitsuba's loader merges meshes of equal BSDFs that have none


def import_mitsuba() -> Any:
    """
    Import Mitsuba and check that it is of the supported release.

    Returns
    -------
    module
        ``mitsuba``. No variant is set by this.

    Raises
    ------
    MistrayError
        Mitsuba is missing, broken or of another release.
    """
    if "HOME" not in os.environ:  # Dr.Jit asks nobody else where it keeps compiled kernels
        with contextlib.suppress(RuntimeError):
            os.environ["HOME"] = str(Path.home())  # of the user's entry
    try:
        with importing():
            mi = importlib.import_module("mitsuba")
    except (ImportError, NameError) as error:  # drjit 1.5 follows its ImportError by a NameError
        reason = str(error.__context__ or error)
        raise MistrayError(f"mitsuba cannot be imported ({reason}); {import_remedy(reason)}") from None
    check_release(mi.__version__)
    return mi


def import_remedy(reason: str) -> str:
    """Say what to do when Mitsuba or Dr.Jit cannot be imported, by the text of the ImportError."""
    if "libatomic" in reason:  # the wheel of drjit 1.5 needs it and does not bring it
        return "install libatomic: apt-get install libatomic1 (Debian, Ubuntu), dnf install libatomic (Fedora)"
    if "current_path" in reason:
        return "the working folder was deleted, change to one that exists"
    return f"run: pip install --force-reinstall 'mitsuba=={SUPPORTED_RELEASE}.*'"


def check_release(version: str) -> None:
    """Raise `MistrayError` unless a Mitsuba version such as "3.9.1" is of the supported release."""
    if not version.startswith(SUPPORTED_RELEASE + "."):
        raise MistrayError(
            f"mitsuba {version} is installed and mistray is written for {SUPPORTED_RELEASE}; "
            f"run: pip install 'mitsuba=={SUPPORTED_RELEASE}.*'"
        )


def own_folder_first(resolver: Any) -> None:
    """
    Let Mitsuba look in its own folder before any other, so that the libraries of its plugins are its own.

    As it comes it begins with the current folder, and a library ``plugins/path.so`` there would be run.

    Parameters
    ----------
    resolver : mi.FileResolver
    """
    resolver.prepend(os.path.dirname(import_mitsuba().__file__))


def silence_warnings() -> None:
    """Keep Mitsuba's log, which goes to stdout, out of the output of a program; a variant must be set."""
    mi = import_mitsuba()
    mi.set_log_level(mi.LogLevel.Error)


def build_mesh(mesh: Any, name: str, vertices: npt.ArrayLike, faces: npt.ArrayLike, props: Any) -> None:
    """
    Construct the `mi.Mesh` that a shape is, so that Mitsuba's loaders leave it alone.

    By default ``mi.load_file`` and ``mi.load_dict`` merge the meshes of a scene. A merged mesh is no longer an object
    of its class: its formula, its name and its part would be lost. Meshes with attributes are not merged.

    Parameters
    ----------
    mesh : mi.Mesh
        An object whose constructor runs.
    name : str
    vertices, faces
        As in `write_mesh`.
    props : mi.Properties

    Raises
    ------
    MistrayError
        If its sensor is attached to another shape as well.
    """
    import numpy as np

    mi = import_mitsuba()
    try:
        mi.Mesh.__init__(mesh, name, len(np.asarray(vertices)), len(np.asarray(faces)), props)
        write_mesh(mesh, vertices, faces)
    except RuntimeError as error:
        if "attached to a single shape" not in str(error):
            raise
        raise MistrayError(
            f"shape '{name}': its sensor is that of another shape too; give it one of its own. Mitsuba's loaders take "
            "equal sensors for one: load with optimize=False or mistray.load"
        ) from None
    mesh.add_attribute(_APART, 1, np.ones(mesh.vertex_count(), dtype=np.float32))


def write_mesh(mesh: Any, vertices: npt.ArrayLike, faces: npt.ArrayLike) -> None:
    """
    Fill the buffers of a `mi.Mesh` and let Mitsuba update what depends on them.

    Parameters
    ----------
    mesh : mi.Mesh
        Created with the same numbers of vertices and faces.
    vertices : (n, 3) float
        Positions in world space, mm.
    faces : (m, 3) int
        Vertex numbers of each triangle, counter-clockwise about its normal.
    """
    import numpy as np

    mi = import_mitsuba()
    buffers = mi.traverse(mesh)
    buffers[_POSITIONS] = mi.Float(np.ravel(np.asarray(vertices, dtype=np.float32)))
    buffers[_FACES] = mi.UInt32(np.ravel(np.asarray(faces, dtype=np.uint32)))
    buffers.update()


def mesh_arrays(mesh: Any) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.uint32]]:
    """
    Read the buffers of a `mi.Mesh`.

    Returns
    -------
    vertices : (n, 3) float32
        Positions in world space, mm.
    faces : (m, 3) uint32
        Vertex numbers of each triangle.
    """
    import numpy as np

    buffers = import_mitsuba().traverse(mesh)
    vertices = np.array(buffers[_POSITIONS], dtype=np.float32).reshape(-1, 3)
    return vertices, np.array(buffers[_FACES], dtype=np.uint32).reshape(-1, 3)


def holds_numbers(value: Any) -> bool:
    """Whether a value of ``mi.SceneParameters`` is an array of numbers, of float32 or, for their range, of float64."""
    mi = import_mitsuba()
    return isinstance(value, mi.Float | mi.Float64)


def peek(params: Any, key: str) -> Any:
    """
    A value of ``mi.SceneParameters`` as it is.

    ``params[key]`` notes the key as one that may be changed, and `update` fails on it when `keep` has taken it away.
    """
    value, kind, node, _ = params.properties[key]
    return value if kind is None else params.get_property(value, kind, node)
