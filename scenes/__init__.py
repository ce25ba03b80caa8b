"""Optical systems that ship with mistray: one folder each, with scene.xml, its prescription and SOURCE.md.

Every ``<name>/prescription.py`` has a function ``build()`` that returns the `mistray.prescription.Prescription`;
``python -m mistray.scenes`` writes the XML files from them. `mistray.load` takes a scene by its name, or as
``mistray.scenes.<name>``, which a prompt completes.
"""

import importlib
from pathlib import Path
from types import ModuleType

__all__ = sorted(file.parent.name for file in Path(__file__).parent.glob("*/scene.xml"))


def __getattr__(name: str) -> ModuleType:
    if name not in __all__:
        raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
    return importlib.import_module(f"{__name__}.{name}")


def __dir__() -> list[str]:
    return __all__
