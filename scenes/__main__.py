"""Writes scene.xml of every shipped scene from its prescription: ``python -m mistray.scenes``."""

from __future__ import annotations

import importlib
from pathlib import Path


def main() -> None:
    """Call ``build()`` of each ``<name>/prescription.py`` and write ``<name>/scene.xml`` beside it."""
    for module in sorted(Path(__file__).parent.glob("*/prescription.py")):
        folder = module.parent
        importlib.import_module(f"mistray.scenes.{folder.name}.prescription").build().to_xml(folder / "scene.xml")
        print(f"{folder.name}/scene.xml")


if __name__ == "__main__":
    main()
