"""Live explorer: controls of a scene whose stray light is estimated at once and traced in the background."""

from typing import TYPE_CHECKING

from mistray._lazy import lazy_package

if TYPE_CHECKING:
    from mistray.explore.explorer import Explorer

__all__ = lazy_package(__name__, {"explorer": ("Explorer",)})
