"""Code that depends on the Mitsuba release: the supported release and the names of mesh buffers.

Mitsuba is imported inside functions only, because libLLVM must be selected first (see `mistray._variant`). So is NumPy,
so that `mistray doctor` can report that it is missing.
"""

from __future__ import annotations

import contextlib
import importlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mistray._libatomic import provide_libatomic
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
    Import Mitsuba and check that it has the supported release.

    Returns
    -------
    module
        Module ``mitsuba``; this sets no variant.

    Raises
    ------
    MistrayError
        If Mitsuba is missing, broken or of another release.
    KeyboardInterrupt
        If a signal has come meanwhile; raised after the import.
    """
    if "HOME" not in os.environ:  # Dr.Jit asks nobody else where it keeps compiled kernels
        with contextlib.suppress(RuntimeError):
            os.environ["HOME"] = str(Path.home())  # of the user's entry
    provide_libatomic()
    try:
        with importing():
            mi = importlib.import_module("mitsuba")
    except (ImportError, NameError) as error:  # drjit 1.5 follows its ImportError by a NameError
        reason = str(error.__context__ or error)
        raise MistrayError(f"mitsuba cannot be imported ({reason}); {import_remedy(reason)}") from None
    check_release(mi.__version__)
    return mi


def import_remedy(reason: str) -> str:
    """Return advice for a failed import of Mitsuba or Dr.Jit, from the text of the ImportError."""
    if "libatomic" in reason:  # the wheel of drjit 1.5 needs it and does not bring it
        return "install libatomic: apt-get install libatomic1 (Debian, Ubuntu), dnf install libatomic (Fedora)"
    if "current_path" in reason:
        return "the working folder was deleted, change to one that exists"
    return f"run: pip install --force-reinstall 'mitsuba=={SUPPORTED_RELEASE}.*'"


def check_release(version: str) -> None:
    """Raise `MistrayError` unless a Mitsuba version such as "3.9.1" belongs to the supported release."""
    if not version.startswith(SUPPORTED_RELEASE + "."):
        raise MistrayError(
            f"mitsuba {version} is installed and mistray is written for {SUPPORTED_RELEASE}; "
            f"run: pip install 'mitsuba=={SUPPORTED_RELEASE}.*'"
        )


def own_folder_first(resolver: Any) -> None:
    """
    Make Mitsuba search its own folder first, so that it loads its own plugin libraries.

    By default Mitsuba searches the current folder first, and would run a library ``plugins/path.so`` in it.

    Parameters
    ----------
    resolver : mi.FileResolver
        Search path to change.
    """
    resolver.prepend(os.path.dirname(import_mitsuba().__file__))


def silence_warnings() -> None:
    """Suppress Mitsuba's log messages below errors, which go to stdout; a variant must be set."""
    mi = import_mitsuba()
    mi.set_log_level(mi.LogLevel.Error)


def build_mesh(mesh: Any, name: str, vertices: npt.ArrayLike, faces: npt.ArrayLike, props: Any) -> None:
    """
    Construct the `mi.Mesh` of a shape such that Mitsuba's loaders do not merge it.

    By default ``mi.load_file`` and ``mi.load_dict`` merge the meshes of a scene. Merging would replace the object by
    one of another class, and lose its formula, name and part. Meshes with attributes are not merged.

    Parameters
    ----------
    mesh : mi.Mesh
        Object whose constructor is running.
    name : str
        Id of the shape.
    vertices, faces
        Vertices (mm) and triangles, as in `write_mesh`.
    props : mi.Properties
        Properties of the shape.

    Raises
    ------
    MistrayError
        If the sensor of the shape is attached to another shape too.
    RuntimeError
        If Mitsuba refuses the mesh for another reason.
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
    Fill the buffers of a `mi.Mesh` and let Mitsuba update data derived from them.

    Parameters
    ----------
    mesh : mi.Mesh
        Mesh created with the same numbers of vertices and faces.
    vertices : (n, 3) float
        Positions in world space, mm.
    faces : (m, 3) int
        Vertex indices of each triangle, counter-clockwise about its normal.
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
        Vertex indices of each triangle.
    """
    import numpy as np

    buffers = import_mitsuba().traverse(mesh)
    vertices = np.array(buffers[_POSITIONS], dtype=np.float32).reshape(-1, 3)
    return vertices, np.array(buffers[_FACES], dtype=np.uint32).reshape(-1, 3)


def holds_numbers(value: Any) -> bool:
    """True if a value of ``mi.SceneParameters`` is an array of float32 or float64 numbers."""
    mi = import_mitsuba()
    return isinstance(value, mi.Float | mi.Float64)


def peek(params: Any, key: str) -> Any:
    """
    Return a value of ``mi.SceneParameters`` without marking it for change.

    ``params[key]`` marks the key as possibly changed, and `update` fails on it if `keep` has removed it.
    """
    value, kind, node, _ = params.properties[key]
    return value if kind is None else params.get_property(value, kind, node)


class _NoScene:
    """Stand-in for a scene, which is not told of changes."""

    def parameters_changed(self, keys: list[str]) -> None:
        pass


def without_scene_update(params: Any) -> Any:
    """
    Return scene parameters whose changes reach the plugins, but not the scene itself.

    Mitsuba's scene builds its tree of triangles again at each change of a mesh, which takes longer than a small trace.
    Traces do not use the tree. It and the bounding box of the scene stay as they were, so that such a scene serves for
    traces only.

    Parameters
    ----------
    params : mi.SceneParameters
        Parameters of a scene, from ``mi.traverse``.
    """
    found, nobody = params.copy(), _NoScene()
    (root,) = (node for node, (parent, _) in found.hierarchy.items() if parent is None)
    found.hierarchy = {
        node: (nobody if parent is root else parent, depth) for node, (parent, depth) in found.hierarchy.items()
    } | {nobody: (None, 0)}
    return found
