"""Jupyter widget that shows the explorer; needs the extra ``widget``."""

from __future__ import annotations

import threading
from typing import Any

import anywidget

from mistray.analyses.explorer.assets import asset
from mistray.analyses.explorer.calls import answer
from mistray.analyses.explorer.explorer import Explorer
from mistray.errors import MistrayError

PAUSE_S = 1.0  # in which its threads notice that it was closed


class ExplorerWidget(anywidget.AnyWidget):
    """
    Jupyter widget that shows an explorer.

    Traces run in a separate thread from the moment a page shows the widget until `close`.

    Parameters
    ----------
    explorer : Explorer
        Explorer of a scene.
    """

    _esm = asset("explore.js")
    _css = asset("explore.css")

    def __init__(self, explorer: Explorer) -> None:
        super().__init__()
        self.explorer = explorer
        self._ended = threading.Event()
        self._threads: list[threading.Thread] = []
        self.on_msg(self._answer)

    def close(self) -> None:
        """Stop the threads of the widget, and remove it from the page."""
        self._ended.set()
        super().close()

    def _answer(self, _: Any, asked: Any, __: Any) -> None:
        """Answer a message from the page; at the first message, start the widget's threads."""
        if not isinstance(asked, dict):
            return
        try:
            found = {"found": answer(self.explorer, asked.get("call"), asked.get("given", {}))}
        except MistrayError as error:
            found = {"error": str(error)}
        self.send({"id": asked.get("id"), **found})
        if not self._threads:
            self._threads = [threading.Thread(target=run, daemon=True) for run in (self._work, self._follow)]
            for thread in self._threads:
                thread.start()

    def _work(self) -> None:
        while not self._ended.is_set():
            self.explorer.work(PAUSE_S)

    def _follow(self) -> None:
        """Send each new state of the explorer to the page until the widget is closed."""
        version = -1
        while not self._ended.is_set():
            view = self.explorer.wait(version, PAUSE_S)
            if view["version"] > version and not self._ended.is_set():
                version = view["version"]
                self.send({"view": view})
